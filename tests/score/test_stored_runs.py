"""The shipped runs of the suite: complete, of this suite, small, and what a folder holds."""

from __future__ import annotations

import importlib.resources

import numpy as np
import pytest
from campaigns import ran

from ggbench.campaign.result_keys import RESULTS_VERSION
from ggbench.judging.verdicts import require_equal_runs
from ggbench.score import stored_runs
from ggbench.score.stored_runs import ScoreError
from ggbench.spec import scenario

MOST_BYTES = 2_200_000


def test_the_shipped_runs_are_those_of_the_suite():
    """Every estimator of its roster has the same runs in all cases, of this version."""
    suite, stored = scenario.load("suite"), stored_runs.read()
    header = stored.header
    assert header["scenario_hash"] == suite.content_hash
    assert header["results_version"] == RESULTS_VERSION
    assert (header["seed"], header["runs"]) == (suite.campaign.seed, suite.campaign.runs)
    labels, cases = list(suite.campaign.estimators), [case.name for case in suite.cases]
    assert stored.runs["estimator"].unique().tolist() == labels
    assert stored.runs["case"].unique().tolist() == cases
    require_equal_runs(stored.runs)
    assert len(stored.runs) == len(cases) * len(labels) * header["runs"]
    file = importlib.resources.files("ggbench.scenarios") / stored_runs.FILE
    assert len(file.read_bytes()) <= MOST_BYTES


def test_what_is_written_is_read(tmp_path):
    """Errors, consistency and success of a small campaign, to seven digits."""
    results = ran(tmp_path, labels=("ins", "ekf", "factor-graph[mode=batch]"), runs=3)
    stored_runs.write(results, tmp_path / "runs.npz")
    found = stored_runs.read(tmp_path / "runs.npz")
    keys = ["case", "estimator", "run"]
    before = results.runs().set_index(keys).sort_index()
    after = found.runs.set_index(keys).sort_index()
    assert list(before.index) == list(after.index)
    for name in stored_runs.NUMBERS:
        np.testing.assert_allclose(after[name], before[name], rtol=2e-7)
    for name in ("status", "diverged", "false_fix", "causality", "name", "draw", "bound"):
        assert list(after[name]) == list(before[name])


def test_unequal_runs_are_not_written(tmp_path):
    """Control: a folder with fewer runs of one estimator."""
    ran(tmp_path, labels=("ins",), runs=3)
    results = ran(tmp_path, labels=("ekf",), runs=2)
    with pytest.raises(
        ScoreError, match="contains 10 runs, but 2 estimators in 2 cases of 3 runs need 12"
    ):
        stored_runs.write(results, tmp_path / "runs.npz")


def test_a_damaged_file_is_a_sentence(tmp_path):
    (tmp_path / "runs.npz").write_bytes(b"nothing")
    with pytest.raises(ScoreError, match=r"stored runs .*runs\.npz cannot be unpacked"):
        stored_runs.read(tmp_path / "runs.npz")
