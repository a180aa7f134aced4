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
REPORT = (ROOT / "reports" / "wang2013.md").read_text(encoding="utf-8")


def test_first_commands_are_make_targets():
    """The README's first block is the two commands that a fresh clone understands."""
    block = re.search(r"```\n(.*?)```", README, re.DOTALL)
    commands = [line.split("#")[0].strip() for line in block.group(1).splitlines()]
    assert commands == ["make paper", "make test"]
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    for command in commands:
        assert re.search(rf"^{command.removeprefix('make ')}:", makefile, re.MULTILINE)


def test_table_is_the_reports():
    """Every row of the README's table stands in the generated report, word for word.

    Without its last cell: `make paper` measures the times again.
    """
    marked = re.search(r"<!-- the table.*?-->\n(.*?)<!-- end", README, re.DOTALL)
    rows = [line for line in marked.group(1).splitlines() if line.startswith("|")]
    assert len(rows) > 8 and rows[0].endswith("| ms/run |")
    untimed, report = (
        "\n".join(line.rsplit("|", 2)[0] for line in lines) for lines in (rows, REPORT.splitlines())
    )
    assert untimed in report


def test_the_answer_is_the_reports():
    """What the README says of priors stands in the generated report, word for word."""
    marked = re.search(r"<!-- the answer.*?-->\n(.*?)<!-- end", README, re.DOTALL)
    (answer,) = (line for line in marked.group(1).splitlines() if line)
    report = (ROOT / "reports" / "nonlinearity.md").read_text(encoding="utf-8")
    assert answer.startswith("**") and f"\n{answer}\n" in report


def test_the_verdict_is_the_reports():
    """What the README says of the paper's numbers is the first sentence of the report."""
    marked = re.search(r"<!-- the verdict.*?-->\n(.*?)<!-- end", README, re.DOTALL)
    assert REPORT.split("\n\n")[1] == marked.group(1).strip()


def test_the_advice_is_the_reports():
    """The README's answer and first table stand in the front page of the reports, word for word."""
    marked = re.search(r"<!-- the advice.*?-->\n(.*?)<!-- end", README, re.DOTALL)
    said = marked.group(1).strip()
    page = (ROOT / "reports" / "README.md").read_text(encoding="utf-8")
    assert said.startswith("- **The model is right.") and said.count("\n|") > 7
    assert page.split("\n\n", 1)[1].startswith(said)


@pytest.mark.parametrize(
    "document",
    ["README.md", "CONTRIBUTING.md", "reports/README.md"]
    + [str(path.relative_to(ROOT)) for path in documents(ROOT) if path.parent != ROOT]
    + [f"reports/{name}.md" for name in scenario.shipped()],
)
def test_links_lead_somewhere(document):
    """Every relative link and figure exists."""
    path = ROOT / document
    targets = re.findall(r"\]\(([^)#]+)\)", path.read_text(encoding="utf-8"))
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
        [sys.executable, "-c", script.replace("runs=5", "runs=2")], cwd=tmp_path,
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert done.stdout.startswith("Problem(200 epochs of 6 channels from 1.0 to 200.0 s, 15 states")
    assert done.stderr == ""
    assert imread(tmp_path / "error_over_time.png").shape[0] > 400


def test_errata_cite_existing_tests():
    """Every erratum of the report names a test that exists."""
    tests = (ROOT / "tests" / "accuracy" / "test_errata.py").read_text(encoding="utf-8")
    cited = re.findall(r"`(test_eq\w+)`", REPORT)
    assert len(cited) >= 10
    assert not [name for name in cited if f"def {name}(" not in tests]


@pytest.mark.parametrize("name", scenario.shipped())
def test_report_is_of_the_shipped_scenario(name):
    """The committed report was made from the scenario as it is, at its declared number of runs."""
    loaded = scenario.load(name)
    report = (ROOT / "reports" / f"{name}.md").read_text(encoding="utf-8")
    assert f"scenario {loaded.content_hash[:16]}" in report
    settings = loaded.campaign
    options = " --assumptions" if loaded.assumptions else ""
    assert f"{name} -n {settings.runs} --seed {settings.seed}{options} -o " in report


def test_every_shipped_scenario_has_its_report():
    """What the package ships has been run, and its report is committed."""
    assert [
        name for name in scenario.shipped() if not (ROOT / "reports" / f"{name}.md").exists()
    ] == []


def test_the_front_page_tells_of_every_shipped_scenario():
    """The league was made from all scenarios as they are, each with a link to its report.

    A study that the league does not count has its link in README.md.
    """
    page = (ROOT / "reports" / "README.md").read_text(encoding="utf-8")
    front = (ROOT / "README.md").read_text(encoding="utf-8")
    for name in scenario.shipped():
        loaded = scenario.load(name)
        if not loaded.campaign.league:
            assert f"(reports/{name}.md)" in front
            continue
        assert f"[{loaded.title}]({name}.md)" in page
        assert loaded.content_hash[:16] in page


def test_the_documented_session_is_short_and_whole():
    """Twelve commands at most lead a new user from the installation to a page to share."""
    page = ROOT / "docs" / "session.md"
    shown = [block for block in blocks(page) if block.language == "sh"]
    commands = [line for block in shown for line in block.text.splitlines() if line.strip()]
    assert len(commands) <= 12 and commands[0].startswith("pip install ")
    assert all(line.startswith("ggbench ") for line in commands[1:])
    steps = [line.split()[1] for line in commands[1:]]
    wanted = ["run", "map", "new", "validate", "check", "run", "report"]
    assert [step for step in wanted if step in steps] == wanted and commands[-1].endswith("--html")
    assert [block.reason for block in shown if block.reason][1:] == []  # all but the installation


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
