"""Tables and figures of sweeps: sections of the grid, and values that reach a target."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pandas as pd

from ..results.folder import Results
from ..spec.axes import AxisSpec
from ..spec.scenario import Scenario
from ..spec.sweep import largest_within
from . import columns
from .tables import MOST_COLUMNS
from .views import comparable, deciding_cases, few_cases

_FIXED_COLUMNS = 3
"""Columns of the table of targets besides estimators: error, case, bound."""
MOST_PARTS = 3
"""Largest number of parts of a grid in a figure."""
SUCCESS = 0.95
"""Required success rate of the cases in :func:`recovered`."""

LISTED = "at"
"""Word before a list of values that reach a target, if no largest value exists."""


class Part(NamedTuple):
    """Cases along the first axis of a sweep: title, names of the cases, abscissae (n,)."""

    title: str
    cases: list[str]
    places: np.ndarray


def is_of_the_prior(scenario: Scenario) -> bool:
    """Return whether a sweep varies only the initial position uncertainty."""
    sweep = scenario.sweep
    if sweep is None or len(sweep.axes) != 1:
        return False
    widths = {case.initial_error.position_m for case in scenario.cases}
    return len(widths) == len(sweep.axes[0].values)


def parts(scenario: Scenario, cases: pd.DataFrame) -> list[Part]:
    """Return at most three sections of a sweep's grid along its first axis.

    There is one section for each case that the sweep varies. All other axes are fixed at their
    middle values. The abscissae are the values of the first axis. If the sweep varies only the
    initial position uncertainty σ, the abscissae are σ/ℓ. ℓ is the correlation length of the field.
    """
    sweep = scenario.sweep
    assert sweep is not None
    middle = tuple(len(axis.values) // 2 for axis in sweep.axes[1:])
    fixed = [axis.at(at) for axis, at in zip(sweep.axes[1:], middle, strict=True)]
    widths = cases.set_index("case")["width"]
    all_parts = []
    for base, title in sweep.bases.items():
        along = sorted(
            (point.indices[0], name)
            for name, point in sweep.points.items()
            if point.base == base and point.indices[1:] == middle and name in widths.index
        )
        names = [name for _, name in along]
        if not names:
            continue
        places = np.array([sweep.axes[0].values[index] for index, _ in along])
        if is_of_the_prior(scenario):
            places = widths[names].to_numpy(dtype=float)
        all_parts.append(Part(", ".join(filter(None, [title, *fixed])), names, places))
    chosen = few_cases(pd.DataFrame({"part": range(len(all_parts))}), MOST_PARTS)
    return [all_parts[number] for number in chosen["part"]]


def shown_cases(results: Results) -> pd.DataFrame:
    """Return the cases that a page shows, selected by :func:`.views.deciding_cases`.

    In a sweep only the cases of its figure (:func:`parts`) can be selected.
    """
    cases, metrics = results.cases(), results.metrics()
    cases = cases[cases["case"].isin(metrics["case"])]
    if results.scenario.sweep is not None:
        names = [name for part in parts(results.scenario, cases) for name in part.cases]
        cases = cases.set_index("case").loc[names].reset_index()
    return deciding_cases(metrics, cases)


def label_of(scenario: Scenario) -> str:
    """Return the label of the abscissa for the figure of a sweep."""
    assert scenario.sweep is not None
    if is_of_the_prior(scenario):
        return "initial uncertainty over correlation length, σ/ℓ"
    return scenario.sweep.axes[0].title


def reached(
    scenario: Scenario, metrics: pd.DataFrame, cases: pd.DataFrame, own: Sequence[str] = ()
) -> pd.DataFrame:
    """Return a table of the values of a sweep's first axis with an RMS error at most each target.

    A target is an RMS position error. A value reaches it if its RMS error is not larger. There is a
    row for each target and section (:func:`parts`). There are columns for the bound, the EKF and
    the user's own estimators. A cell such as ``3.2 E`` is the largest value of the axis that
    reaches the target, interpolated between cases. Its 95 % interval is in parentheses. The table
    is empty without a sweep.

    If errors decrease along the axis, and some but not all values reach the target, the cell
    instead lists the values that reach it. Either of two situations counts as a decrease:

    - An error is significantly smaller than the error at the value before it.
    - A value reaches the target after a value that does not.
    """
    if scenario.sweep is None:
        return pd.DataFrame()
    axis = scenario.sweep.axes[0]
    settled = metrics[metrics["window"] == "settled"].set_index(["estimator", "case"])
    labels = ["ekf", *own][: MOST_COLUMNS - _FIXED_COLUMNS]
    rows = []
    for target in sorted(scenario.sweep.targets_m):
        for part in parts(scenario, cases):
            if len(part.cases) < len(axis.values) or "ekf" not in settled.index.levels[0]:
                continue
            errors = [_errors(settled, label, part.cases) for label in labels]
            bound = errors[0][0]
            reach = [_reach(axis, target, bound, bound, bound)]
            reach += [_reach(axis, target, *errors_of[1:]) for errors_of in errors]
            rows.append([f"{target:g}", part.title, *reach])
    heads = ["EKF", *(f"`{label}`" for label in labels[1:])]
    return pd.DataFrame(rows, columns=["RMS error [m]", "case", "bound", *heads])


def _errors(settled: pd.DataFrame, label: str, names: Sequence[str]) -> np.ndarray:
    """Return (4, n) of an estimator in n cases: bound, RMS error, lower and upper end [m]."""
    rows = settled.reindex([(label, name) for name in names])
    return rows[["bound_m", "rms_m", "rms_lo", "rms_hi"]].to_numpy(dtype=float).T


def _reach(
    axis: AxisSpec, target: float, errors: np.ndarray, low: np.ndarray, high: np.ndarray
) -> str:
    """Return the largest value of an axis at which errors (n,) reach a target, as text.

    If the errors decrease significantly along the axis, the text lists all values that reach the
    target. ``low`` and ``high`` (n,) are the ends of the confidence intervals of the errors.
    """
    within = errors <= target
    falls = bool((high[1:] < low[:-1]).any())
    if not within.any() or (not falls and not within[int(within.argmin()) :].any()) or within.all():
        reached, *ends = (largest_within(axis, of, target) for of in (errors, high, low))
        text = _limit(reached, axis.unit)
        if ends[0] < ends[1] and np.isfinite(ends).all() and math.isfinite(reached):
            text += f" ({columns.ratio(ends[0])}–{columns.ratio(ends[1])})"
        return text
    values = ", ".join(f"{value:g}" for value in np.asarray(axis.values)[within])
    return f"{LISTED} {values} {axis.unit}".rstrip()


def _limit(value: float, unit: str) -> str:
    if math.isinf(value):
        return "any" if value > 0.0 else "none"
    return columns.NONE if math.isnan(value) else f"{columns.ratio(value)} {unit}"


def recovered(metrics: pd.DataFrame, cases: pd.DataFrame) -> list[tuple[str, float]]:
    """Return the largest σ/ℓ at which each causal estimator has a success rate of at least 95%.

    σ/ℓ is the initial position uncertainty in correlation lengths of the field. The success rate
    must be at least 95% in all cases with equal or smaller σ/ℓ. An estimator is judged only in
    cases of which it has all runs. The estimator with the largest σ/ℓ comes first. If an estimator
    does not even reach 95% at the least σ/ℓ, its value is 0.
    """
    rows = comparable(metrics)
    rows = rows[rows["causality"] == "filter"]
    rows = rows.merge(cases[["case", "width"]], on="case").sort_values("width")
    ranked = []
    for label, own in rows.groupby("estimator", sort=False):
        failed = own.loc[own["success"] < SUCCESS, "width"]
        below = own if failed.empty else own[own["width"] < failed.iloc[0]]
        widest = float(below["width"].max()) if len(below) else 0.0
        ranked.append((str(label), widest, float(own["seconds_per_run"].median())))
    ranked.sort(key=lambda item: (-item[1], item[2]))
    return [(label, widest) for label, widest, _ in ranked]
