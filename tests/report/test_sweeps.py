"""Views of sweeps: parts of the grid, what is reached, and up to which σ/ℓ a position is found."""

from __future__ import annotations

import math

import numpy as np
import pandas as pd
import pytest
from reporting import cases, metric, scenario

from ggbench.judging.summary import METRICS
from ggbench.report import sweeps
from ggbench.spec.axes import AxisSpec
from ggbench.spec.sweep import Point, Sweep

NOISE = AxisSpec(
    name="noise", label="noise", unit="E", scale="log", values=(0.01, 0.1, 1.0), key="k"
)
RATE = AxisSpec(name="rate", label="rate", unit="Hz", scale="log", values=(0.1, 1.0, 10.0), key="k")


def grid(*axes: AxisSpec, bases: tuple[str, ...] = ("",), targets: tuple[float, ...] = ()):
    shape = [len(axis.values) for axis in axes]
    places = [(base, indices) for base in bases for indices in np.ndindex(*shape)]
    points = {f"c{n}": Point(base, indices) for n, (base, indices) in enumerate(places)}
    return scenario(sweep=Sweep(axes, targets, {base: base for base in bases}, points))


def test_parts_run_along_the_first_axis_at_the_middle_of_the_others():
    loaded = grid(NOISE, RATE, bases=("platform", "level"))
    found = sweeps.parts(loaded, cases(18))
    assert [part.title for part in found] == ["platform, 1 Hz", "level, 1 Hz"]
    assert [part.cases for part in found] == [["c1", "c4", "c7"], ["c10", "c13", "c16"]]
    assert found[0].places.tolist() == list(NOISE.values)


def test_at_most_three_parts_are_shown():
    found = sweeps.parts(grid(NOISE, bases=tuple("abcdef")), cases(18))
    assert len(found) == 3 and (found[0].title, found[-1].title) == ("a", "f")


def test_cases_that_were_not_run_are_left_out():
    (part,) = sweeps.parts(grid(NOISE), cases(2))
    assert part.cases == ["c0", "c1"]


def test_a_target_is_reached_where_a_power_law_reaches_it():
    """Errors of 1, 10 and 100 m at 0.01, 0.1 and 1 E: 3.16 m at 0.0316 E; bounds are a half."""
    rows = [metric(f"c{n}", "ekf", "settled", 10.0**n) | {"bound_m": 10.0**n / 2} for n in range(3)]
    loaded = grid(NOISE, targets=(10.0**0.5, 1e3, 1e-3))
    found = sweeps.reached(loaded, pd.DataFrame(rows, columns=[*METRICS]), cases(3))
    assert found[["bound", "EKF"]].to_numpy().tolist() == [
        ["none", "none"],
        ["0.063 E", "0.032 E (0.029–0.035)"],
        ["any", "any"],
    ]


def test_targets_have_a_column_of_ones_own_estimator():
    """With a tenth of the EKF's errors it reaches 3.16 m at ten times the noise.

    Others have no column; one that failed has no value.
    """
    rows = [
        metric(f"c{n}", label, "settled", factor * 10.0**n)
        for n in range(3)
        for label, factor in (("ekf", 1.0), ("mine", 0.1), ("ukf", 1.0), ("broken", math.nan))
    ]
    loaded = grid(NOISE, targets=(10.0**0.5,))
    table = pd.DataFrame(rows, columns=[*METRICS])
    found = sweeps.reached(loaded, table, cases(3), ["mine", "broken"])
    assert list(found)[3:] == ["EKF", "`mine`", "`broken`"]
    assert found.iloc[0, 3:].tolist()[:2] == ["0.032 E (0.029–0.035)", "0.32 E (0.29–0.35)"]
    assert found.iloc[0, 5] == "–"


HEADING = AxisSpec(
    name="heading",
    label="heading",
    unit="°",
    scale="linear",
    values=(0.0, 45.0, 90.0, 135.0),
    key="k",
)


@pytest.mark.parametrize(
    ("errors", "said"),
    [
        ((10.0, 20.0, 80.0, 160.0), "75 ° (72–78)"),  # 50 m on the way from 20 to 80 m
        ((10.0, 9.5, 80.0, 160.0), "80 ° (78–82)"),  # a fall within the intervals of 10%
        ((10.0, 40.0, 90.0, 30.0), "at 0, 45, 135 °"),  # one heading misses
        ((90.0, 40.0, 30.0, 20.0), "at 45, 90, 135 °"),
        ((40.0, 10.0, 90.0, 90.0), "at 0, 45 °"),  # surely smaller than before
        ((10.0, 40.0, 20.0, 30.0), "any"),
        ((60.0, 90.0, 70.0, 80.0), "none"),
    ],
)
def test_a_value_is_interpolated_only_where_errors_grow(errors, said):
    """Else the values that reach the target are listed: of headings there is no largest one."""
    rows = [metric(f"c{n}", "ekf", "settled", error) for n, error in enumerate(errors)]
    found = sweeps.reached(
        grid(HEADING, targets=(50.0,)), pd.DataFrame(rows, columns=[*METRICS]), cases(4)
    )
    assert found["EKF"].tolist() == [said]


@pytest.mark.parametrize(
    ("success", "widest"),
    [((1.0, 1.0, 1.0), 0.9), ((1.0, 0.94, 1.0), 0.1), ((0.5, 1.0, 1.0), 0.0)],
)
def test_a_position_is_recovered_up_to_the_first_case_that_fails(success, widest):
    """A success at a larger σ/ℓ does not count; estimators with fewer runs are not compared."""
    rows = [
        metric(f"c{n}", "ekf", "settled", 1.0) | {"success": share}
        for n, share in enumerate(success)
    ]
    rows += [metric(f"c{n}", "few", "settled", 1.0, runs=3) for n in range(3)]
    held = cases(3).assign(width=[0.1, 0.5, 0.9])
    found = sweeps.recovered(pd.DataFrame(rows, columns=[*METRICS]), held)
    assert found == [("ekf", widest)]
