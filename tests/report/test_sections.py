"""The sections on locking on and of sweeps: their tables, sentences and what their figures get."""

from __future__ import annotations

import dataclasses
import math
import tomllib
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from problems import SMALL
from summaries import case

from ggbench.judging.convergence import COLUMNS
from ggbench.report import locking_section, sweep_section
from ggbench.report.families import Family
from ggbench.spec import scenario
from ggbench.spec.case import CaseSpec


def with_prior(name: str, sigma: float) -> CaseSpec:
    spec = case(name=name, title=f"{name} prior")
    prior = spec.initial_error.model_copy(update={"position_m": sigma})
    windows = spec.windows.model_copy(update={"lock_m": 100.0})
    return spec.model_copy(update={"initial_error": prior, "windows": windows})


CASES = (with_prior("wide", 2000.0), with_prior("near", 500.0))
LOCKS = {
    ("near", "ekf"): (0.90, 0.82, 0.95, 0.02, 0.01, 0.07, 12.0, 10.0, 15.0),
    ("near", "ukf"): (0.80, 0.71, 0.87, 0.08, 0.04, 0.15, 14.0, 11.0, 19.0),
    ("near", "ins"): (0.00, 0.00, 0.04, 0.00, 0.00, 0.04, math.nan, math.nan, math.nan),
    ("wide", "ekf"): (0.50, 0.40, 0.60, 0.30, 0.22, 0.40, 33.0, 30.0, 37.0),
    ("wide", "ukf"): (0.75, 0.66, 0.82, 0.01, 0.002, 0.05, 44.0, 40.0, 48.0),
    ("wide", "ins"): (0.00, 0.00, 0.04, 0.00, 0.00, 0.04, math.nan, math.nan, math.nan),
}
"""Shares, false locks and times with their intervals, by case and estimator."""
LOCK_TIMES = np.array([2.0, math.nan, 7.0, 20.0])


def convergence(monkeypatch, tmp_path: Path) -> tuple[list[str], list[Any], list[Any], list[Any]]:
    """The parts of the section, and what its figures were given."""
    rows = [
        {"case": name, "label": label, "window": "settled", "runs": 100, "position_mrse_m": 1.0,
         "causality": "none" if label == "ins" else "filter", "seconds_per_run": 1.0,
         "ratio_median": 1.0, "success_share": figures[0], "success_lo": figures[1],
         "success_hi": figures[2]}
        | dict(zip(COLUMNS, figures, strict=True))
        for (name, label), figures in LOCKS.items()
    ]  # fmt: skip
    results = SimpleNamespace(
        scenario=SimpleNamespace(cases=CASES, name="s"),
        labels=["ins", "ekf", "ukf"],
        estimators={label: {"parameters": {}} for label in ("ins", "ekf", "ukf")},
        arrays=lambda name: {"times": np.arange(1.0, 21.0)},
        lock_times=lambda name, label: LOCK_TIMES,
    )
    given: tuple[list[Any], list[Any], list[Any]] = ([], [], [])
    monkeypatch.setattr(locking_section, "save", lambda figure, path: None)
    monkeypatch.setattr(locking_section, "over_cases", lambda *items: given[0].extend(items))
    monkeypatch.setattr(locking_section, "against_time", lambda *items: given[1].extend(items))
    monkeypatch.setattr(locking_section, "against_cost", lambda *items: given[2].extend(items))
    report = locking_section.ConvergenceReport(results, pd.DataFrame(rows), tmp_path)
    return report.sections(), *given


def test_locks_are_told_where_intervals_lie_apart(monkeypatch, tmp_path):
    """Surely means intervals that do not overlap, and false locks surely above 5 %."""
    sections, *_ = convergence(monkeypatch, tmp_path)
    wide, near = sections[1].splitlines()
    assert wide == (
        "- **wide prior** (σ 2 km per axis): `ukf` 75 % [66 %, 82 %] locked, and surely more often "
        "than `ekf` 50 % [40 %, 60 %]; false locks in surely more than 5 % of the runs: `ekf` in "
        "30 %."
    )
    assert near == (
        "- **near prior** (σ 500 m per axis): 80 % to 90 % of the runs locked; the intervals of "
        "all aided estimators overlap."
    )


def test_the_table_of_locks_has_each_figure_in_its_column(monkeypatch, tmp_path):
    """Locked, falsely locked, and when, each with its interval."""
    sections, *_ = convergence(monkeypatch, tmp_path)
    rows = [[c.strip() for c in line.strip("|").split(" | ")] for line in sections[-1].split("\n")]
    assert [row for row in rows if row[0] == "near" and row[2] == "`ukf`"] == [
        ["near", "500 m", "`ukf`", "100", "80 % [71 %, 87 %]", "8 % [4 %, 15 %]",
         "14.0 [11.0, 19.0]"]
    ]  # fmt: skip
    assert [row[-1] for row in rows if "`ins`" in row] == ["–", "–"]


def test_the_figures_of_locks_get_what_they_show(monkeypatch, tmp_path):
    """Cases that differ in their prior alone, from the narrowest on, in kilometres."""
    _, over, against, cost = convergence(monkeypatch, tmp_path)
    (panels,), labels = over
    assert (panels.names, panels.priors, labels) == (
        ["near", "wide"], [0.5, 2.0], ["ins", "ekf", "ukf"],
    )  # fmt: skip
    for first, series in ((0, panels.shares), (3, panels.false_locks), (6, panels.times)):
        for place, key in enumerate(("value", "low", "high")):
            wanted = [LOCKS[name, "ukf"][first + place] for name in panels.names]
            assert getattr(series["ukf"], key).tolist() == wanted
    curves, _ = against
    title, times, shares = curves[0]
    assert (title, times.tolist()) == ("wide prior", list(range(21)))
    assert shares["ekf"][[1, 2, 7, 20]].tolist() == [0.0, 0.01, 0.02, 0.03]
    assert not cost  # of two aided estimators


def test_what_a_lock_costs_is_shown_of_three_and_more(monkeypatch, tmp_path):
    """Time and share of each aided estimator; those that differ in their particles are joined."""
    monkeypatch.setattr(locking_section, "_FEW", 1)
    monkeypatch.setattr(
        locking_section, "families",
        lambda found, name: [Family("kf", ("ukf", "ekf"), (5.0, 300.0))],
    )  # fmt: skip
    sections, _, _, (panels, labels, joined) = convergence(monkeypatch, tmp_path)
    assert labels == ["ins", "ekf", "ukf"]
    assert [panel.title for panel in panels] == ["wide prior", "near prior"]
    assert panels[1].seconds == {"ekf": 1.0, "ukf": 1.0}
    assert panels[1].shares["ukf"] == LOCKS["near", "ukf"][:3]
    assert joined == {"kf": {"ukf": "5", "ekf": "300"}}
    assert "](s/cost.png)" in sections[2]


GRID = (
    SMALL[: SMALL.index("[[case]]")]
    + """
[sweep]
targets_m = [10.0]

[[sweep.axis]]
name = "noise"
label = "noise"
unit = "E"
scale = "log"
values = [0.001, 0.01, 0.1]
key = "gradiometer.noise_eotvos"

[[sweep.axis]]
name = "height"
label = "height"
unit = "m"
values = [5000.0, 9000.0]
key = "trajectory.height_m"
"""
)


@pytest.fixture
def report(tmp_path, monkeypatch) -> sweep_section.SweepReport:
    """The EKF's error grows as the root of the noise, and doubles in the upper row."""
    monkeypatch.setattr(sweep_section, "save", lambda figure, path: None)
    loaded = scenario.parse(tomllib.loads(GRID), "grid", "grid")
    rows = []
    for name, point in loaded.sweep.points.items():
        i, j = point.indices
        error = 10.0 * math.sqrt(10.0 ** (i - 1)) * 2.0**j
        nees = {(0, 0): 8.0, (2, 1): 4.0}.get((i, j), 6.5)
        common = {"case": name, "window": "settled", "runs": 50, "failed": 0, "diverged": 0,
                  "nees_lo": 5.0, "nees_hi": 7.0, "seconds_per_run": 1.0}  # fmt: skip
        for label, causality, factor, bound in (
            ("ekf", "filter", 1.0, 0.8 * error),
            # Of a larger error everywhere but in the worst cell.
            ("ukf", "filter", 0.5 if (i, j) == (2, 1) else 1.2, 0.8 * error),
            ("late", "batch", 0.7, 0.7 * error),
        ):
            own = factor * error
            rows.append(
                common
                | {
                    "label": label, "causality": causality, "position_mrse_m": own,
                    "position_mrse_lo": 0.9 * own, "position_mrse_hi": 1.1 * own,
                    "position_bound_m": bound, "position_efficiency": own / bound,
                    "nees_mean": nees,
                }
            )  # fmt: skip
    return sweep_section.SweepReport(loaded, pd.DataFrame(rows), tmp_path)


def test_a_requirement_has_the_interval_of_its_error(report):
    """Where the error is 10 m: noise 0.01 E; its interval's upper end is 10 m at less noise.

    0.01 / 1.1² = 0.0083 and 0.01 / 0.9² = 0.012; the bound, 0.8 of the error, at 0.01 / 0.8².
    """
    (plane,) = report.planes
    lines = report._requirements(plane).splitlines()
    cells = [[c.strip() for c in line.strip("|").split(" | ")] for line in lines]
    assert cells[0] == ["to reach", "noise [E]", "5000 m", "9000 m"]
    assert cells[2] == ["10 m", "`ekf`", "0.01 [0.0083, 0.012]", "0.0025 [0.0021, 0.0031]"]
    assert ["10 m", "*bound: filter*", "0.016", "0.0039"] in cells
    assert report.answer() == (
        "**Largest noise with which `ekf` reaches 10 m: 0.01 E at 5000 m, 0.0025 E at 9000 m.**"
    )


def test_the_answer_of_a_sweep_has_a_line_for_each_plane(report):
    """Under its title; nothing where nothing is to be reached."""
    (plane,) = report.planes
    report.planes = [dataclasses.replace(plane, title=title) for title in ("level", "inertial")]
    lines = report.answer().splitlines()
    assert [line.partition(":")[0] for line in lines] == ["- **level**", "- **inertial**"]
    assert all("reaches 10 m: 0.01 E at 5000 m" in line for line in lines)
    report.sweep = dataclasses.replace(report.sweep, targets_m=())
    assert report.answer() == ""


def test_the_best_is_so_over_the_whole_plane(report):
    """In the geometric mean: one good cell does not make up for five bad ones."""
    (plane,) = report.planes
    assert report._best(plane) == "ekf"
    plane.rows.loc[(slice(None), "ekf"), "runs"] = 20  # of other samples than the others'
    assert report._best(plane) == "ukf"


def test_cells_off_the_bound_and_off_their_band_are_counted(report):
    """By the intervals of the error, and by the band of the NEES."""
    (plane,) = report.planes
    efficiency = report._efficiency(plane)
    assert (
        "- `ekf`: 1.250 in the median cell; largest 1.25 [1.12, 1.38]" in efficiency
        and "the 95 % interval lies wholly above 1 in 6 of 6 cells, wholly below in 0."
        in efficiency
    )
    late = next(line for line in efficiency.splitlines() if line.startswith("- `late`"))
    assert late.endswith("wholly above 1 in 0 of 6 cells, wholly below in 0.")
    ukf = next(line for line in efficiency.splitlines() if line.startswith("- `ukf`"))
    assert ukf.endswith("wholly above 1 in 5 of 6 cells, wholly below in 1.")
    consistency = report._consistency(plane)
    assert "- `ekf`: outside its band in 2 of 6 cells (1 above, 1 below)" in consistency
    assert "farthest from 6: 4.00 (band 5.00–7.00) at noise 0.1 E, height 9000 m." in consistency
