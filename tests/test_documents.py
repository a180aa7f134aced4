"""What the README, the notes and the committed report say agrees with the code."""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
import yaml
from doc_blocks import blocks, documents
from matplotlib.image import imread

from ggbench.campaign import registry
from ggbench.simulation.error_free_flight import prepare
from ggbench.simulation.runs import simulate
from ggbench.spec import scenario

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")


def test_first_commands_are_make_targets():
    """The README's first block is the two commands that a fresh clone understands."""
    block = re.search(r"```\n(.*?)```", README, re.DOTALL)
    commands = [line.split("#")[0].strip() for line in block.group(1).splitlines()]
    assert commands == ["make paper", "make test"]
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    for command in commands:
        assert re.search(rf"^{command.removeprefix('make ')}:", makefile, re.MULTILINE)


@pytest.mark.parametrize(
    "document",
    ["README.md", "CONTRIBUTING.md"]
    + [str(path.relative_to(ROOT)) for path in documents(ROOT) if path.parent != ROOT]
    + [f"reports/{path.name}" for path in sorted((ROOT / "reports").glob("*.md"))],
)
def test_links_lead_somewhere(document):
    """Every relative link and figure exists."""
    path = ROOT / document
    targets = re.findall(r"\]\(([^)#]+)", path.read_text(encoding="utf-8"))
    # Pages that are generated are those of the site, whose build finds what leads nowhere.
    missing = [t for t in targets if "://" not in t and not t.startswith("generated/")]
    missing = [t for t in missing if not (path.parent / t).exists()]
    assert not missing


def test_example_estimator_works(tmp_path):
    """The README's one-file estimator runs as printed, and as well as the EKF."""
    code = re.search(r"```python\n((?:(?!```).)*IteratedEKF.*?)```", README, re.DOTALL).group(1)
    file = tmp_path / "iterated_ekf.py"
    file.write_text(code, encoding="utf-8")
    flight = prepare(scenario.load("wang2013").case("0.01E-0.2Hz"))
    problem, _ = simulate(flight, seed=3, run=0)
    estimates = [
        registry.choose(text).estimator.estimate(problem, np.random.default_rng(0))
        for text in (f"{file}[iterations=5]", "ekf")
    ]
    sigma = np.sqrt(np.diagonal(estimates[1].cov, axis1=1, axis2=2))
    assert np.abs((estimates[0].mean - estimates[1].mean) / sigma).max() < 0.05


@pytest.mark.long
def test_first_steps_lead_to_a_figure(tmp_path):
    """The script runs as it is, and has the lines that docs/start.md explains."""
    script = (ROOT / "docs" / "examples" / "first_steps.py").read_text(encoding="utf-8")
    page = (ROOT / "docs" / "start.md").read_text(encoding="utf-8")
    shown = "".join(re.findall(r"```python\n(.*?)```", page, re.DOTALL))
    code = [line for line in script.splitlines() if line and not line.startswith("#")]
    assert code == [line for line in shown.splitlines() if line]
    assert len(code) <= 15
    assert "runs=5" in script
    done = subprocess.run(
        [sys.executable, "-c", script.replace("runs=5", "runs=2")],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.startswith("Problem(200 epochs of 6 channels from 1.0 to 200.0 s, 15 states")
    assert done.stderr == ""
    assert imread(tmp_path / "error_over_time.png").shape[0] > 400


def test_errata_cite_existing_tests():
    """Every erratum of the paper names a test that exists."""
    tests = (ROOT / "tests" / "accuracy" / "test_errata.py").read_text(encoding="utf-8")
    page = (ROOT / "docs" / "wang2013.md").read_text(encoding="utf-8")
    cited = re.findall(r"`(test_eq\w+)`", page)
    assert len(cited) >= 10
    assert not [name for name in cited if f"def {name}(" not in tests]


def test_the_documented_session_is_short_and_whole():
    """Twelve commands at most lead a new user from the installation to a page to share."""
    page = ROOT / "docs" / "session.md"
    shown = [block for block in blocks(page) if block.language == "sh"]
    commands = [line for block in shown for line in block.text.splitlines() if line.strip()]
    assert len(commands) <= 12 and commands[0].startswith("pip install ")
    assert all(line.startswith("ggbench ") for line in commands[1:])
    steps = [line.split()[1] for line in commands[1:]]
    wanted = ["run", "map", "new", "validate", "check", "run", "report"]
    assert [step for step in wanted if step in steps] == wanted
    assert [block.reason for block in shown if block.reason][1:] == []  # all but the installation


def test_the_page_on_scores_counts_the_cases_of_the_suite():
    page = (ROOT / "docs" / "howto" / "score.md").read_text(encoding="utf-8")
    suite = tomllib.loads((ROOT / "scenarios" / "suite.toml").read_text(encoding="utf-8"))
    count, runs = len(suite["case"]), suite["campaign"]["runs"]["value"]
    assert f"the suite: {count} cases of {runs} runs" in page


def test_the_citation_is_that_of_this_version():
    """What an archive makes a DOI of: all required keys of CFF 1.2.0, and what the package says."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert {"cff-version", "message", "title", "authors", "abstract"} <= citation.keys()
    assert (citation["cff-version"], citation["type"]) == ("1.2.0", "software")
    assert (citation["version"], citation["license"]) == (project["version"], project["license"])
    assert [author["name"] for author in citation["authors"]] == [
        author["name"] for author in project["authors"]
    ]
    for work in citation["references"]:
        assert {"type", "title", "authors", "journal", "year"} <= work.keys()
        assert all("family-names" in author for author in work["authors"])
