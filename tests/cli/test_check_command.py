"""``ggbench check``: what it prints and how it ends, whatever the file of a user's own does."""

from __future__ import annotations

import textwrap

import pytest
from click.testing import CliRunner
from command import invoke

from ggbench.cli.main import main
from ggbench.contract.catalogue import CHECKS

START = """
import os
import sys
from dataclasses import dataclass

import numpy as np

from ggbench.problem import Estimate, Estimator


@dataclass(frozen=True)
class Mine(Estimator):
    name = "mine"
    causality = "none"

    def estimate(self, problem, rng):
"""
PRIOR = """
        x, p, means, covs = problem.prior_mean, problem.prior_cov, [], []
        for k in range(problem.epochs):
            phi = problem.transition[k]
            x, p = phi @ x, phi @ p @ phi.T + problem.process_cov[k]
            means.append(x)
            covs.append(0.5 * (p + p.T))
        return Estimate(np.array(means), np.array(covs), "none")
"""


def checked(tmp_path, text, *options):
    (tmp_path / "mine.py").write_text(text)
    done = invoke(["check", "mine.py", *options], tmp_path, columns=100)
    assert "Traceback" not in done.stdout + done.stderr
    return done.returncode, done.stdout, done.stderr


def mine(*lines):
    return START + textwrap.indent("\n".join(lines), 8 * " ") + PRIOR


def failed(output):
    words = [line.split(": ") for line in output.splitlines() if not line.startswith(" ")]
    return [name for word, name, *_ in (w for w in words if len(w) > 1) if word == "FAILED"]


def test_an_estimator_that_keeps_the_contract(tmp_path):
    code, output, _ = checked(tmp_path, mine("print('nonsense', file=sys.stderr)"))
    assert code == 0, output
    assert output.count("passed: ") == len(CHECKS)
    assert output.endswith(f"{len(CHECKS)} of {len(CHECKS)} checks passed, 0 failed.\n")
    assert "nonsense" not in output


@pytest.mark.long
@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("import no_such_thing\n", "No module named 'no_such_thing' (mine.py, line 1"),
        ("x = 1\ny = 2 +\n", "invalid syntax (mine.py, line 2)"),
        ("x = 1\n", "defines 0 estimators; it must define exactly one class"),
        (mine() + START.replace("Mine", "Other") + PRIOR, "defines 2 estimators"),
        (mine().replace("(frozen=True)", ""), "mine.py cannot be imported: TypeError"),
        ("import os\nos._exit(7)\n", "it ended its process, with exit code 7"),
        ("import os\nos.kill(os.getpid(), 11)\n", "its process was ended by SIGSEGV"),
        ("while True:\n    print('x')\n", "it did not return within 5 s"),
    ],
)
def test_what_cannot_be_examined_is_said(tmp_path, text, said):
    code, output, error = checked(tmp_path, text, "--time-limit", "5")
    assert (code, output) == (2, "")
    assert error.startswith("ggbench: mine.py ") and said in error


@pytest.mark.long
def test_a_name_that_is_none_is_said(tmp_path):
    done = invoke(["check", "ekff"], tmp_path)
    assert done.returncode == 2
    assert "there is no estimator 'ekff' (did you mean 'ekf'?)" in done.stderr


@pytest.mark.long
@pytest.mark.parametrize(
    ("lines", "names", "said"),
    [
        (
            ["if problem.epochs == 1:", "    raise ValueError('too short')"],
            ["short"],
            "ValueError: too short (mine.py, line 18: raise ValueError('too short'))",
        ),
        (
            ["if not problem.present.all():", "    os._exit(0)"],
            ["gaps"],
            "it ended its process, with exit code 0",
        ),
        (
            ["while problem.noise_cov.ndim == 3:", "    print('x' * 10000)"],
            ["noise"],
            "it did not return within 5 s",
        ),
        (
            ["if not problem.present.all():", "    sys.exit('enough')"],
            ["gaps"],
            "SystemExit: enough",
        ),
        (
            ["if problem.epochs == 1:", "    os.kill(os.getpid(), 9)"],
            ["short"],
            "its process was ended by SIGKILL",
        ),
        (["if problem.map:", "    input()"], ["estimate"], "on a flight over a map: EOFError"),
    ],
)
def test_a_check_that_it_breaks_off_fails_and_the_others_go_on(tmp_path, lines, names, said):
    code, output, _ = checked(tmp_path, mine(*lines), "--time-limit", "5")
    assert code == 1
    assert failed(output) == names
    assert said in " ".join(output.split())
    if names == ["estimate"]:
        assert f"failed; {len(CHECKS) - 1} not run, because there is no estimate." in output
    else:
        assert output.count("passed: ") == len(CHECKS) - 1


@pytest.mark.long
def test_one_that_takes_nothing_is_no_success(tmp_path):
    text = mine().replace(
        "    def est", "    def skip(self, problem):\n        return 'no'\n\n    def est"
    )
    code, output, error = checked(tmp_path, text)
    assert code == 2
    assert output.count("skipped: ") == len(CHECKS)
    assert "refuses all test problems" in error


@pytest.mark.long
@pytest.mark.parametrize(
    ("text", "said"),
    [("exec:./no_such_program", "no_such_program"), ("estimates.mat", "cannot read estimates.mat")],
)
def test_a_program_or_a_file_of_estimates_that_does_not_exist_is_named(text, said):
    result = CliRunner().invoke(main, ["check", text])
    assert result.exit_code == 2
    assert said in result.output and "cannot be imported: it ended" not in result.output
