"""Results, maps and compiled code are known by the source that made them: all of it, by content."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import ggbench

PACKAGE = Path(ggbench.__file__).parent
SCRIPT = "from ggbench.numerics import source; print(source.source_hash())"


def hash_of(folder: Path) -> str:
    """The hash that a process sees which imports the package from a folder."""
    done = subprocess.run(
        [sys.executable, "-P", "-c", SCRIPT],
        env={"PYTHONPATH": str(folder)}, capture_output=True, text=True, check=True,
    )  # fmt: skip
    return done.stdout.strip()


@pytest.fixture
def copy(tmp_path) -> Path:
    shutil.copytree(
        PACKAGE, tmp_path / "ggbench", ignore=shutil.ignore_patterns("__pycache__", "scenarios")
    )
    return tmp_path / "ggbench"


def modules() -> list[str]:
    """Every module of the package, whatever folder it lies in."""
    return sorted(str(path.relative_to(PACKAGE)) for path in PACKAGE.rglob("*.py"))


def test_every_module_counts(copy):
    """A change of any module, in the top folder or below, is another source."""
    before = hash_of(copy.parent)
    found = {before}
    for name in modules():
        file = copy / name
        text = file.read_text(encoding="utf-8")
        file.write_text(text + "# another source\n", encoding="utf-8")
        found.add(hash_of(copy.parent))
        file.write_text(text, encoding="utf-8")
    assert len(found) == 1 + len(modules())
    assert hash_of(copy.parent) == before


def test_a_new_module_counts_and_a_renamed_one(copy):
    before = hash_of(copy.parent)
    (copy / "room").mkdir()
    (copy / "room" / "new.py").write_text("")
    added = hash_of(copy.parent)
    (copy / "room" / "new.py").rename(copy / "room" / "other.py")
    assert len({before, added, hash_of(copy.parent)}) == 3
