"""Truth and estimators: what looking around finds while one runs, and who is told of looking."""

from __future__ import annotations

import numpy as np
import pytest
from campaigns import ran

from ggbench.campaign.registry import choose
from ggbench.campaign.truth_isolation import HiddenArray, suspicious_names

SPY = """
import gc, sys
from dataclasses import dataclass
import numpy as np
from ggbench.block import BlockEstimator, EstimateBlock
from ggbench.problem import Estimate, Estimator

TRUE = {"Truth", "Flight", "Trajectory"}


def found(shape):
    "How many objects of this process are the truth or hold it."
    seen = gc.get_objects()
    frame = sys._getframe()
    while frame is not None:
        seen += frame.f_locals.values()
        frame = frame.f_back
    arrays = [s for s in seen if isinstance(s, np.ndarray) and s.shape[-2:] == shape]
    return sum(type(s).__name__ in TRUE for s in seen) + len(arrays)
"""
ONE_RUN = """
@dataclass(frozen=True)
class Spy(Estimator):
    name = "spy"
    causality = "filter"

    def estimate(self, problem, rng):
        count = found((problem.epochs, problem.dimension))
        mean = np.zeros((problem.epochs, problem.dimension))
        cov = np.tile(problem.prior_cov, (problem.epochs, 1, 1))
        return Estimate(mean, cov, "filter", info={"found": count})
"""
MANY_RUNS = """
@dataclass(frozen=True)
class BlockSpy(BlockEstimator):
    name = "spy"
    causality = "filter"

    def estimate_block(self, block, rngs):
        count = np.full(block.runs, found((block.epochs, block.dimension)))
        mean = np.zeros((block.runs, block.epochs, block.dimension))
        cov = np.broadcast_to(block.prior_cov, (*mean.shape, block.dimension))
        info = {"found": count, "map_evaluations": 0 * count}
        return EstimateBlock(mean, cov, "filter", info=info)
"""


@pytest.mark.parametrize("spy", [pytest.param(ONE_RUN, marks=pytest.mark.long), MANY_RUNS])
def test_truth_is_no_object_of_the_process_while_an_estimator_runs(spy, tmp_path):
    """Neither frames nor the list of all objects lead to truth, flight or trajectory.

    Neither in the first run of a process nor later, when an earlier run has been judged.
    """
    (tmp_path / "spy.py").write_text(f"{SPY}\n\n{spy}")
    label = f"{tmp_path}/spy.py"
    results = ran(tmp_path, labels=("ekf", label), runs=3, jobs=1)
    records = [record for record in results.records() if record["name"] == "spy"]
    assert [record["status"] for record in records] == ["ok"] * 6
    assert [record["info"]["found"] for record in records] == [0] * 6


def test_what_is_put_away_leaves_nothing_behind():
    """The array comes back bit by bit, as often as it is asked for; where it was, it is not."""
    array = np.random.default_rng(1).normal(size=(2, 3, 5))
    expected = array.copy()
    put_away = HiddenArray(array)
    assert np.isnan(array).all()
    for _ in range(2):
        with put_away.looked_at() as kept:
            assert np.array_equal(kept, expected)


@pytest.mark.parametrize(
    ("source", "names"),
    [
        ("import gc", ["gc"]),
        ("import os, inspect as i", ["inspect"]),
        ("def f():\n    from gc import get_objects", ["gc"]),
        ("import sys\nsys._getframe(1).f_back.f_locals", ["_getframe", "f_back", "f_locals"]),
        ("from sys import _getframe as g", ["_getframe"]),
        ("import sys\ngetattr(sys, '_current_frames')()", ["_current_frames"]),
        ("try:\n    1/0\nexcept Exception as e:\n    e.__traceback__.tb_frame", ["tb_frame"]),
        ("from ggbench.simulation.runs import simulate", ["ggbench.simulation"]),
        ("from ggbench import simulation", ["ggbench.simulation"]),
        ("import ggbench.campaign.runner", ["ggbench.campaign.runner"]),
        ("import numpy\nfrom ggbench.problem import Estimate\nfrom .gc import x", []),
        ("import gcsfs, inspector\n'''gc, inspect and _getframe are not used'''", []),
    ],
)
def test_a_source_that_looks_around_is_recognised(source, names):
    assert suspicious_names(source.encode()) == names


def test_estimators_of_the_benchmark_do_not_look_around():
    for name in ("ins", "ekf", "ukf", "factor-graph", "gauss-newton", "gaussian-sum"):
        assert "seeks" not in choose(name).content


@pytest.mark.long
def test_results_name_an_estimator_that_looks_around(tmp_path, monkeypatch):
    """Whichever estimators are asked for later."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "spy.py").write_text(f"{SPY}\n\n{ONE_RUN}")
    results = ran(tmp_path, labels=("ins", "spy.py"), runs=1)
    results.store.close()
    results = ran(tmp_path, labels=("ekf",), runs=1)
    assert results.seeking["spy.py"].startswith("_getframe, f_back, f_locals, gc")
