"""Runs that failed for a reason outside of them are run again on request, and only those."""

from __future__ import annotations

import pytest
from campaigns import ran
from command import invoke
from problems import SMALL

LICENSED = '''
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ggbench.problem import Estimate, Estimator, Problem


@dataclass(frozen=True)
class Licensed(Estimator):
    """Return the prior, as long as a licence server answers."""

    name = "licensed"
    causality = "filter"

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        if not Path(__file__).with_name("licence").exists():
            raise RuntimeError("no licence")
        shape = problem.epochs, problem.dimension
        cov = np.broadcast_to(problem.prior_cov, (*shape, shape[1])).copy()
        return Estimate(np.zeros(shape), cov, "filter")
'''


@pytest.fixture
def labels(tmp_path):
    (tmp_path / "licensed.py").write_text(LICENSED)
    return ("ins", str(tmp_path / "licensed.py"))


def statuses(results):
    return {(r["estimator"], r["run"]): r["status"] for r in results.records()}


def test_failed_runs_are_run_again_and_finished_ones_are_not(labels, tmp_path):
    """Without the option a failure stays, as it must where a run fails by itself."""
    first = ran(tmp_path, labels=labels)
    kept = {r["run"]: r["seconds"] for r in first.records() if r["estimator"] == "ins"}
    first.store.close()
    (tmp_path / "licence").touch()
    again = ran(tmp_path, labels=labels)
    assert sorted(statuses(again).values()) == ["failed"] * 3 + ["ok"] * 3
    again.store.close()
    healed = ran(tmp_path, labels=labels, retry_failed=True)
    assert set(statuses(healed).values()) == {"ok"} and len(statuses(healed)) == 6
    assert {r["run"]: r["seconds"] for r in healed.records() if r["estimator"] == "ins"} == kept


def test_runs_that_fail_again_stay_failed(labels, tmp_path):
    ran(tmp_path, labels=labels).store.close()
    again = ran(tmp_path, labels=labels, retry_failed=True)
    assert sorted(statuses(again).values()) == ["failed"] * 3 + ["ok"] * 3


def test_the_command_retries(labels, tmp_path):
    (tmp_path / "small.toml").write_text(SMALL)
    run = ["run", "small.toml", "-n", "2", "-j", "0", "-o", "out", "-e", labels[1]]
    assert invoke(run, tmp_path).returncode == 1
    (tmp_path / "licence").touch()
    assert invoke(run, tmp_path).returncode == 1
    done = invoke([*run, "--retry-failed"], tmp_path)
    assert done.returncode == 0, done.stderr
    said = invoke([*run, "--retry-failed", "--fresh"], tmp_path)
    assert said.returncode == 2 and "remove --retry-failed" in " ".join(said.stderr.split())
