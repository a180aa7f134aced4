"""Views of sweeps: parts of the grid, what is reached, and up to which σ/ℓ a position is found."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from reporting import cases, figure, scenario

from ggbench.judging.summary import FIGURES
from ggbench.report import sweeps
from ggbench.spec.sweep import Axis, Point, Sweep

NOISE = Axis("noise", "noise", "E", "log", (0.01, 0.1, 1.0))
RATE = Axis("rate", "rate", "Hz", "log", (0.1, 1.0, 10.0))


def grid(*axes: Axis, bases: tuple[str, ...] = ("",), targets: tuple[float, ...] = ()):
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
    rows = [figure(f"c{n}", "ekf", "settled", 10.0**n) | {"bound_m": 10.0**n / 2} for n in range(3)]
    loaded = grid(NOISE, targets=(10.0**0.5, 1e3, 1e-3))
    found = sweeps.reached(loaded, pd.DataFrame(rows, columns=[*FIGURES]), cases(3))
    assert found[["bound", "EKF"]].to_numpy().tolist() == [
        ["none", "none"], ["0.063 E", "0.032 E"], ["any", "any"]
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("success", "widest"),
    [((1.0, 1.0, 1.0), 0.9), ((1.0, 0.94, 1.0), 0.1), ((0.5, 1.0, 1.0), 0.0)],
)
def test_a_position_is_recovered_up_to_the_first_case_that_fails(success, widest):
    """A success at a larger σ/ℓ does not count; estimators with fewer runs are not compared."""
    rows = [
        figure(f"c{n}", "ekf", "settled", 1.0) | {"success": share}
        for n, share in enumerate(success)
    ]
    rows += [figure(f"c{n}", "few", "settled", 1.0, runs=3) for n in range(3)]
    held = cases(3).assign(width=[0.1, 0.5, 0.9])
    found = sweeps.recovered(pd.DataFrame(rows, columns=[*FIGURES]), held)
    assert found == [("ekf", widest)]
