"""Files of the repository that other services and package indexes read."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))


def test_one_version_and_one_date():
    """Package, citation and the newest section of the changelog name the same release."""
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    changelog = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    newest = re.search(r"^## (\S+) \((\d{4}-\d\d-\d\d)\)$", changelog, re.MULTILINE)
    version = PROJECT["project"]["version"]
    assert (citation["version"], newest[1]) == (version, version)
    assert str(citation["date-released"]) == newest[2]


def test_continuous_integration_runs_the_repositorys_own_script_on_every_version():
    """The workflow calls .ci/run with each Python that the classifiers promise."""
    text = (ROOT / ".github" / "workflows" / "ci.yml").read_text(encoding="utf-8")
    jobs = yaml.safe_load(text)["jobs"]
    matrix = jobs["all-checks"]["strategy"]["matrix"]
    promised = re.findall(r"Python :: (3\.\d+)", "\n".join(PROJECT["project"]["classifiers"]))
    assert matrix["python"] == promised
    assert any("macos" in other["os"] for other in matrix["include"])
    assert "bash .ci/run" in [step.get("run") for step in jobs["all-checks"]["steps"]]


@pytest.mark.parametrize("group", ["test", "docs", "dev"])
def test_packages_of_developers_are_no_extras(group):
    """A user sees only extras that add a feature; PEP 735 groups hold what developers need."""
    assert group in PROJECT["dependency-groups"]
    assert group not in PROJECT["project"]["optional-dependencies"]


def test_every_package_of_the_groups_is_locked():
    """`make` installs the lock alone: a group that is not in it would be missing in a new clone."""
    lines = (ROOT / "requirements.lock").read_text(encoding="utf-8").lower().splitlines()
    locked = {re.sub(r"[-_.]+", "-", line.split("==")[0]) for line in lines if "==" in line}
    wanted = [
        re.split(r"[<>=!\[; ]", requirement)[0].lower()
        for requirements in (
            PROJECT["project"]["dependencies"],
            *PROJECT["project"]["optional-dependencies"].values(),
            *PROJECT["dependency-groups"].values(),
        )
        for requirement in requirements
    ]
    assert [name for name in wanted if re.sub(r"[-_.]+", "-", name) not in locked] == []
