#!/usr/bin/env bash
# Builds the wheel, installs it alone into an empty environment, and uses it from another folder.
# Protects: nothing is missing from the wheel or from its declared dependencies, it puts nothing
# but `ggbench` at the top level of site-packages, and site-packages does not grow unnoticed. Other
# versions of Python that are on this machine get it, too, and fly once; the sdist holds the tests.
#
# usage: tests/check_wheel.sh PYTHON    (a Python that has `build` and setuptools)
set -euo pipefail

repo=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
python=$(cd "$(dirname "$1")" && pwd)/$(basename "$1")
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
unset PYTHONPATH
MOST_MEGABYTES=850

fail() {
    echo "check_wheel: $*" >&2
    exit 1
}

# The sdist is built first and the wheel from it, so no leftover of build/ gets in.
"$python" -m build --no-isolation --outdir "$work/dist" "$repo" >"$work/build.log" 2>&1 ||
    { cat "$work/build.log" >&2; fail "the build failed"; }

"$python" - "$work"/dist/*.whl "$repo" <<'EOF'
import sys
import zipfile
from pathlib import Path

wheel, repo = Path(sys.argv[1]), Path(sys.argv[2])
names = set(zipfile.ZipFile(wheel).namelist())
top_level = {name.split("/")[0] for name in names}
strangers = {t for t in top_level if t != "ggbench" and not t.endswith(".dist-info")}
if strangers:
    sys.exit(f"check_wheel: at the top level of the wheel: {sorted(strangers)}")

installed_as = {"ggbench": "ggbench", "estimators": "ggbench/estimators", "scenarios": "ggbench/scenarios"}
wanted = {
    f"{package}/{path.relative_to(repo / folder).as_posix()}"
    for folder, package in installed_as.items()
    for path in (repo / folder).rglob("*")
    if path.suffix in {".py", ".toml", ".npz", ".md", ".png", ".html", ".css", ".js", ".j2"} or path.name == "py.typed"
}
if missing := wanted - names:
    sys.exit(f"check_wheel: not in the wheel: {sorted(missing)}")
print(f"{wheel.name}: {len(names)} files, {wheel.stat().st_size / 1e6:.1f} MB")
EOF

"$python" -m venv "$work/venv"
"$work/venv/bin/python" -m pip install --quiet --disable-pip-version-check \
    --constraint "$repo/requirements.lock" "$work"/dist/*.whl

site_packages=$("$work/venv/bin/python" -c 'import sysconfig; print(sysconfig.get_path("purelib"))')
for name in benchmarks docs estimators scenarios studies tests; do
    [[ ! -e $site_packages/$name ]] || fail "site-packages holds a top-level $name"
done
# docs/start.md says where it goes.
megabytes=$(du -sm "$site_packages" | cut -f1)
echo "site-packages: $megabytes MB, most of it $(du -sm "$site_packages"/* | sort -rn | head -n 6 |
    awk '{n = split($2, part, "/"); printf "%s %d, ", part[n], $1}')..."
((megabytes < MOST_MEGABYTES)) || fail "site-packages has more than $MOST_MEGABYTES MB"

mkdir "$work/elsewhere"
cd "$work/elsewhere"
ggbench=$work/venv/bin/ggbench
for command in "list" "validate wang2013" "run wang2013 -n 2 -e ekf -o out" \
    "show out" "report out" "compare out out" "keys imu" \
    "new scenario mine" "validate mine.toml" "run mine.toml -n 2 -o mine" \
    "new estimator mine" "check mine.py" "run wang2013 -n 2 -e mine.py -o out"; do
    echo "ggbench $command"
    # shellcheck disable=SC2086  # the words of a command
    "$ggbench" $command >"$work/output" 2>&1 ||
        { cat "$work/output" >&2; fail "\`ggbench $command\` failed"; }
done
[[ -s out/metrics.csv ]] || fail "\`ggbench run\` wrote no out/metrics.csv"

echo "the session of docs/session.md"
"$work/venv/bin/python" -m pip install --quiet --disable-pip-version-check \
    --constraint "$repo/requirements.lock" "$(echo "$work"/dist/*.whl)[page,terrain]"
PYTHONPATH=$repo/tests "$work/venv/bin/python" - "$repo/docs/session.md" <<'EOF'
import sys
from pathlib import Path

from doc_blocks import Session, blocks

session = Session(Path.cwd(), {})
for block in blocks(Path(sys.argv[1])):
    if not block.reason:
        session.take(block)
size = Path("results/mine/report/my_scenario.html").stat().st_size
print(f"a page of {size / 1e6:.1f} MB to share")
EOF

tar -tzf "$work"/dist/*.tar.gz | cut -d/ -f2- | sort >"$work/packed"
git -C "$repo" ls-files 2>"$work/git.log" | sort >"$work/tracked" || cat "$work/git.log" >&2
comm -13 "$work/packed" "$work/tracked" | grep -v '^\.' >"$work/lost" || true
[[ ! -s $work/lost ]] || { cat "$work/lost" >&2; fail "these files are not in the sdist"; }

own=$("$python" -c 'import sys; print("%d.%d" % sys.version_info[:2])')
for version in 3.11 3.12 3.13 3.14; do
    other=$(command -v "python$version" || true)
    [[ $version != "$own" && -n $other ]] && "$other" -c "" 2>"$work/output" || continue
    echo "the same with Python $version"
    "$other" -m venv "$work/venv-$version"
    "$work/venv-$version/bin/python" -m pip install --quiet --disable-pip-version-check \
        --constraint "$repo/requirements.lock" "$work"/dist/*.whl
    "$work/venv-$version/bin/ggbench" run wang2013 -n 1 -c 0.01E-1Hz -e ekf -e factor-graph \
        -o "out-$version" >"$work/output" 2>&1 ||
        { cat "$work/output" >&2; fail "\`ggbench run\` failed with Python $version"; }
done
echo "wheel check passed"
