"""Table of the cases: bounds, required error, INS and flight."""

from __future__ import annotations

import math

import numpy as np
import pandas as pd
import pytest

from ggbench.judging.cases import CASES, cases
from ggbench.judging.verdicts import Verdict
from ggbench.spec import scenario

SPEC = scenario.load("wang2013").case("0.01E-1Hz")
TIMES = np.arange(1.0, 401.0)
RADIUS_M = 6_371_000.0


def arrays() -> dict[str, np.ndarray]:
    """Arrays of a case: bounds of position and velocity, and a track of 100 m/s to the north."""
    north = 100.0 * TIMES / RADIUS_M
    squares = np.stack([TIMES, 1e6 * TIMES], axis=1)
    return {
        "times": TIMES,
        "track": np.stack([0.6 + north, np.full(400, 1.8), 1000.0 + TIMES], axis=1),
        "bound-filter": squares,
        "bound-batch": 0.25 * squares,
    }


def metrics(name: str = SPEC.name) -> pd.DataFrame:
    """Metrics of the INS, a filter and a smoother of a case."""
    rows = [("ins", "none", math.nan, 50.0), ("ekf", "filter", 7.0, 8.0), ("b", "batch", 3.0, 4.0)]
    table = pd.DataFrame(rows, columns=["estimator", "causality", "bound_m", "rms_m"])
    table = table.assign(case=name, window="settled", success=[0.2, 1.0, 1.0], runs=40, draws=20)
    return pd.concat([table, table.assign(window="whole", rms_m=1e6, runs=99, draws=99)])


def row(table: pd.DataFrame | None = None, spec=SPEC) -> pd.Series:
    own = metrics() if table is None else table
    judged = {kind: {SPEC.name: Verdict("ekf")} for kind in ("causal", "smoother")}
    found = cases([spec], {spec.name: arrays()}, own, judged)
    assert tuple(found.columns) == tuple(CASES)
    return found.iloc[0]


def test_bounds_are_those_of_the_position_in_their_windows():
    """Without metrics the filter's bound comes from the arrays, as the smoother's does."""
    settled = SPEC.windows.settled_from_s <= TIMES
    expected = math.sqrt(TIMES[settled].mean())
    assert 0 < settled.sum() < 400
    assert row()["bound_m"] == 7.0
    assert row(metrics()[:0])["bound_m"] == pytest.approx(expected)
    assert row()["smoothing_bound_m"] == pytest.approx(0.5 * expected)
    assert math.isnan(row()["unfiltered_bound_m"])


def test_the_required_error_is_three_bounds_of_the_last_window_or_the_stated_one():
    last = TIMES[-1] - SPEC.windows.last_s < TIMES
    assert row()["required_m"] == pytest.approx(3.0 * math.sqrt(TIMES[last].mean()))
    windows = SPEC.windows.model_copy(update={"required_m": 12.0})
    assert row(spec=SPEC.model_copy(update={"windows": windows}))["required_m"] == 12.0


def test_errors_of_the_ins_and_counts_are_those_of_the_settled_window_of_the_case():
    table = pd.concat([metrics("another").assign(rms_m=9.0, runs=77, draws=77), metrics()])
    found = row(table)
    assert (found["ins_m"], found["ins_success"]) == (50.0, 0.2)
    assert (found["runs"], found["draws"], found["best"]) == (40, 20, "ekf")
    none = row(metrics()[:0])
    assert (none["runs"], none["draws"]) == (0, 0) and math.isnan(none["ins_m"])


def test_the_speed_is_that_of_the_scenario_or_the_mean_along_the_track():
    moving = SPEC.trajectory.model_copy(update={"speed_mps": None})
    assert row()["speed_mps"] == SPEC.trajectory.speed_mps
    found = row(spec=SPEC.model_copy(update={"trajectory": moving}))
    assert found["speed_mps"] == pytest.approx(100.0, rel=0.01)  # of the ellipsoid's radius
    assert found["height_m"] == 1200.5
    assert (found["epochs"], found["duration_s"]) == (400, 400.0)
