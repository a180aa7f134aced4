"""``ggbench show``, ``compare`` and ``run --run``: what a user reads about single runs."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path

import pytest
from campaigns import ran
from command import invoke
from problems import SMALL

from ggbench.cli.run_view import info_text

HALF_BLIND = """
from dataclasses import dataclass
import numpy as np
from ggbench.campaign import registry
from ggbench.problem import Estimate, Estimator


@dataclass(frozen=True)
class Blurred(Estimator):
    blur: float = FACTOR
    name = "blurred"
    causality = "filter"

    def estimate(self, problem, rng):
        whole = registry.choose("ekf").estimator.estimate(problem, rng)
        return Estimate(whole.mean * self.blur, whole.cov, "filter")
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """Two campaigns that differ in an estimator's source; the second one's is worse."""
    path = tmp_path_factory.mktemp("story")
    (path / "small.toml").write_text(SMALL)
    # A process keeps the first source of a file that it runs: the other one needs a worker.
    for name, factor, jobs in (("before", "1.0", "1"), ("after", "0.3", "0")):
        (path / "blurred.py").write_text(HALF_BLIND.replace("FACTOR", factor))
        run = ["run", "small.toml", "-n", "30", "-s", "5", "-j", jobs, "-o", name]
        done = invoke([*run, "-e", "ekf", "-e", "blurred.py"], path)
        assert done.returncode == 0, done.stderr
    return path


@pytest.mark.long
def test_compare_finds_what_became_worse(folder):
    """The worse estimator is named, with before, after and ratio; the exit code is 1."""
    done = invoke(["compare", "before", "after"], folder, columns=160)
    assert (done.returncode, done.stderr) == (1, "")
    lines = [line.split() for line in done.stdout.splitlines() if "blurred.py" in line]
    verdicts = {(words[0], words[2]): words[-1] for words in lines}
    assert verdicts["base", "m"] == "worse"
    assert "Runs are paired" in done.stdout
    unchanged = [line for line in done.stdout.splitlines() if " ekf " in line]
    assert len(unchanged) == 4 and all(line.rstrip().endswith("same") for line in unchanged)


@pytest.mark.long
def test_compare_in_the_other_direction_and_below_the_threshold(folder):
    """Better is no failure, nor is worse within the threshold; equal folders are the same."""
    assert invoke(["compare", "after", "before"], folder).returncode == 0
    assert invoke(["compare", "before", "after", "--threshold", "9"], folder).returncode == 0
    done = invoke(["compare", "before", "before"], folder)
    assert done.returncode == 0
    assert "worse" not in done.stdout.split("Runs are")[0]


@pytest.mark.long
def test_compare_another_parameter(folder):
    """An estimator with another parameter is compared with itself, under both labels."""
    run = ["run", "small.toml", "-n", "10", "-s", "5", "-j", "0", "-c", "base"]
    for name, blur in (("low", "0.9"), ("high", "0.1")):
        assert invoke([*run, "-o", name, "-e", f"blurred.py[blur={blur}]"], folder).returncode == 0
    done = invoke(["compare", "low", "high"], folder)
    assert done.returncode == 1
    text = " ".join(done.stdout.split())
    assert "blurred.py[blur=0.9] → blurred.py[blur=0.1]" in text


@pytest.mark.long
def test_compare_folders_with_nothing_in_common(folder, tmp_path):
    """Folders of other estimators cannot be compared: a sentence, exit code 2."""
    ran(tmp_path, labels=("ins",), runs=2).store.close()
    done = invoke(["compare", str(folder / "before"), str(tmp_path / "out")], folder)
    assert (done.returncode, len(done.stderr.splitlines())) == (2, 1)
    assert "ins" in done.stderr


def test_show_tells_the_run_that_deserves_a_look(folder):
    """Without a number: the largest error, its metrics, error against time, and the commands."""
    done = invoke(["show", "after"], folder)
    assert (done.returncode, done.stderr) == (0, "")
    assert "120 results of up to 30 runs per case: 0 failed" in done.stdout
    assert "ratio of the error to the estimator's median error in its case" in done.stdout
    assert "position error in m against time" in done.stdout
    assert "bound (rms)" in done.stdout and "█" in done.stdout


def test_show_tells_what_an_estimator_said_of_its_run(folder):
    """``Estimate.info``, in words: of what is long its start, nothing of one that is silent."""
    done = invoke(["show", "before", "--run", "7", "--case", "noisy"], folder)
    assert re.search(r"^ekf says: linearisations [0-9]+$", done.stdout, re.MULTILINE)
    assert "blurred.py says" not in done.stdout
    said = info_text({"cost": 1 / 3, "converged": True, "per_epoch": list(range(99))})
    assert said.startswith("cost 0.3333; converged True; per epoch [0, 1, 2,")
    assert said.endswith("...") and len(said) < 120


@pytest.mark.long
def test_the_command_that_show_prints_repeats_the_run(folder, tmp_path):
    """What is printed to repeat a run gives the same metrics and stores nothing."""
    shown = invoke(["show", "before", "--run", "7", "--case", "noisy"], folder)
    assert shown.returncode == 0, shown.stderr
    commands = [line.strip() for line in shown.stdout.splitlines() if "ggbench run" in line]
    assert len(commands) == 2
    held = {path.name for path in folder.iterdir()}
    done = invoke(shlex.split(commands[0])[1:], folder)
    assert (done.returncode, done.stderr) == (0, "")
    metrics = [
        next(line.split()[1:5] for line in text.splitlines() if line.startswith(" ekf"))
        for text in (shown.stdout, done.stdout)
    ]
    assert metrics[0] == metrics[1]
    assert {path.name for path in folder.iterdir()} == held


def test_a_case_of_an_assumption_can_be_repeated(folder):
    """A run of a study is named STUDY/CASE."""
    done = invoke(
        ["run", "wang2013", "--case", "position-2m/0.01E-0.2Hz", "-e", "ekf", "--run", "3"], folder
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert "0.01 E at 0.2 Hz, run 3" in done.stdout


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["show", "before", "--run", "30"], "before holds no run 30; available: runs 0 to 29"),
        (["show", "before", "--case", "x"], "before holds no run of case x"),
    ],
)
def test_what_is_not_there_has_its_sentence(arguments, sentence, folder):
    done = invoke(arguments, folder)
    assert (done.returncode, len(done.stderr.splitlines())) == (2, 1)
    assert sentence in done.stderr


def test_text_of_others_is_not_taken_for_markup(folder):
    """A title or label with brackets is shown as it is, not as colours or errors."""
    manifest = folder / "before" / "manifest.json"
    content = manifest.read_text()
    manifest.write_text(json.dumps(json.loads(content) | {"title": "[bold]a[/b] [link=x]"}))
    try:
        done = invoke(["show", "before"], folder)
    finally:
        manifest.write_text(content)
    assert done.returncode == 0, done.stderr
    assert "[bold]a[/b] [link=x]" in done.stdout
