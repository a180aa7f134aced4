"""All results folders of a library at once: run, reported, and joined to a league."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pandas as pd
import pytest
from campaigns import plan, ran, small
from command import invoke
from pages import Page, tables_of
from problems import SMALL
from rich.console import Console

from ggbench.cli.library import Outcome, run_all
from ggbench.spec import scenario


@pytest.fixture(scope="module")
def library(tmp_path_factory) -> Path:
    """Results folders: one finished, one stopped, one damaged, one of the same scenario again."""
    path = tmp_path_factory.mktemp("library")
    ran(path, "results/small", labels=("ins", "ekf", "factor-graph[mode=batch]")).store.close()
    (path / "other").mkdir()
    (path / "other" / "stopped.toml").write_text(SMALL)
    loaded = scenario.load(str(path / "other" / "stopped.toml"))
    ran(path, "results/stopped", labels=("ekf",), runs=2, scenario=loaded).store.close()
    store, _ = plan(path, "results/stopped", ("ekf",), runs=9, scenario=loaded).open()
    store.close()
    shutil.copytree(path / "results" / "small", path / "results" / "again")
    (path / "study.toml").write_text(SMALL.replace("[campaign]", "[campaign]\nleague = false"))
    study = scenario.load(str(path / "study.toml"))
    ran(path, "results/study", labels=("ekf",), runs=2, scenario=study).store.close()
    (path / "results" / "damaged").mkdir()
    (path / "results" / "damaged" / "manifest.json").write_text("{")
    (path / "results" / "notes.txt").write_text("no results")
    return path


@pytest.mark.long
def test_the_reports_of_a_library(library):
    """Every folder has its report, the front page tells of what is finished and what is not."""
    done = invoke(["report", "--all", "results", "-o", "text"], library)
    assert done.returncode == 1  # one is damaged
    assert "results/damaged/manifest.json is damaged" in done.stdout
    assert "results/again is left out: results/small is of the same scenario" in done.stdout
    assert "stopped is left out: it is not finished, of 9 runs 2 are done" in done.stdout
    assert "study is left out: its scenario asks for it" in done.stdout
    text = (library / "text" / "README.md").read_text()
    assert text.startswith("# Which estimator should I use when, and what does it cost?\n")
    assert "](small.md)" in text and "](stopped.md)" not in text and "](study.md)" not in text
    for name in ("small.md", "stopped.md", "study.md", "README/league.png", "definitions.md"):
        assert (library / "text" / name).stat().st_size > 2000
    for report in (library / "text").glob("*.md"):
        links = re.findall(r"\]\(([^)#]+)\)", report.read_text())
        assert [link for link in links if not (report.parent / link).exists()] == []
    # The league is of the reports, which need not have been made on one day.
    shutil.rmtree(library / "text" / "small")
    assert invoke(["report", "--all", "results", "-o", "text"], library).returncode == 1
    assert (library / "text" / "README.md").read_text() == text


@pytest.mark.long
def test_the_pages_of_a_library(library):
    """Beside each report its page, with the same tables, and the league's."""
    done = invoke(["report", "--all", "results", "-o", "pages", "--html"], library)
    assert done.returncode == 1 and "results/damaged/manifest.json is damaged" in done.stdout
    written = {path.stem: path for path in (library / "pages").glob("*.html")}
    assert written.keys() == {"small", "stopped", "study", "league"}
    for name, path in written.items():
        assert f"Wrote pages/{name}.html" in done.stdout
        text = path.with_name("README.md") if name == "league" else path.with_suffix(".md")
        assert Page(path).tables == tables_of(text.read_text(encoding="utf-8"))


@pytest.mark.long
def test_a_league_keeps_what_was_reported_on_another_day(library):
    """The report of a folder that is gone is still in it; without its digest it is not."""
    (library / "days").mkdir()
    shutil.copytree(library / "results" / "small", library / "days" / "small")
    assert invoke(["report", "--all", "days", "-o", "kept"], library).returncode == 0
    shutil.copytree(library / "results" / "stopped", library / "days" / "stopped")
    shutil.rmtree(library / "days" / "small")
    assert invoke(["report", "--all", "days", "-o", "kept"], library).returncode == 0
    assert "](small.md)" in (library / "kept" / "README.md").read_text()
    (library / "kept" / "small" / "data" / "pairs.csv").unlink()
    done = invoke(["report", "--all", "days", "-o", "kept"], library)
    assert done.returncode == 2 and "Traceback" not in done.stderr
    assert "no scenario is finished that could be reported; cannot read" in done.stderr


@pytest.mark.long
def test_reports_are_the_same_when_they_are_made_again(library):
    """Byte for byte, figures too: what a change of a report shows is a change of its results."""
    for folder in ("one", "other_one"):
        assert invoke(["report", "--all", "results", "-o", folder], library).returncode == 1
    names = [path.relative_to(library / "one") for path in (library / "one").rglob("*.*")]
    wanted = ("README.md", "README/league.png", "small.md", "small/data/settled.csv")
    assert {Path(name) for name in wanted} <= set(names)
    for name in names:
        assert (library / "one" / name).read_bytes() == (library / "other_one" / name).read_bytes()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["report", "--all", "nowhere"], "cannot read nowhere: No such file"),
        (["report", "--all", "other"], "other holds no results folders"),
        (["report"], "name a results FOLDER, or --all"),
        (["run"], "name a SCENARIO, or --all"),
        (["run", "--all", "wang2013"], "--all runs all cases of all scenarios"),
        (["run", "--all", "-c", "base"], "--all runs all cases of all scenarios"),
        (["run", "--all", "--run", "1"], "--all runs all cases of all scenarios"),
        (["run", "--all", "-e", "ekff"], "did you mean 'ekf'"),
    ],
)
def test_what_cannot_be_asked_of_a_library(library, arguments, words):
    """Exit code 2 and a sentence, before anything is run or written."""
    done = invoke(arguments, library)
    assert (done.returncode, "Traceback" in done.stderr) == (2, False)
    assert words in done.stderr
    assert not (library / "reports").exists()


def test_the_whole_library_runs(library, monkeypatch):
    """Every shipped scenario into its own folder, resumed; one that fails stops no other."""
    text = SMALL.replace("[campaign]", "[campaign]\nruns = 2") if "[campaign]" in SMALL else SMALL
    good, bad = small(library, text), small(library, SMALL.replace('"ekf"]', '"ekff"]'))
    scenarios = {"a": bad, "b": good, "c": good}
    monkeypatch.setattr(scenario, "shipped", lambda: list(scenarios))
    monkeypatch.setattr(scenario, "load", lambda name: scenarios[name])
    run = ["run", "--all", "-n", "1", "-j", "0", "-o", "lib"]
    done = invoke(run, library)
    assert done.returncode == 1, done.stderr
    assert "a failed: there is no estimator 'ekff'" in done.stdout
    assert "1 scenario failed: a." in done.stdout
    for name in ("b", "c"):
        assert len(pd.read_parquet(library / "lib" / name / "runs.parquet")) == 2 * 2
    assert not (library / "lib" / "a").exists()
    again = invoke([*run, "-e", "ins"], library)
    assert again.returncode == 0 and "runs to do" in again.stdout  # the first one's
    assert again.stdout.count("runs to do") == 1


def test_an_interrupt_ends_the_library():
    """After Ctrl-C no further scenario begins; what else a scenario may raise is an outcome."""
    begun = []

    def run_one(name: str) -> Outcome:
        begun.append(name)
        if name == "broken":
            raise ZeroDivisionError("its own")
        return Outcome(name, interrupted=name == "stopped")

    outcomes = run_all(["broken", "stopped", "never"], run_one, Console(quiet=True))
    assert begun == ["broken", "stopped"]
    assert outcomes[0].error == "ZeroDivisionError: its own" and outcomes[1].interrupted
