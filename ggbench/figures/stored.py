"""Figures of the cases that a results folder holds, drawn from what is stored alone."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Literal

import numpy as np

from ..results.folder import Results, ResultsError
from ..results.store import DETAILED_RUN
from . import errors, field
from .style import Drawing

Quantity = Literal["position", "velocity"]
_COLUMNS: dict[Quantity, tuple[int, str]] = {"position": (0, "m"), "velocity": (3, "m/s")}
"""First column of an error's components in a detailed run, and its unit."""


_BOUNDS = {"bound-filter": "filter", "bound-batch": "smoother", "bound-fixed-lag": "fixed lag"}
"""Words for the bounds that are drawn, by their stored names without a lag."""


def error_over_time(results: Results, shown: Mapping[str, Sequence[str]]) -> Drawing:
    """Draw the RMS errors over all runs against time, and the bounds: a panel for each case.

    ``shown`` are the estimators by the name of a case.
    """
    return errors.error_over_time(
        [
            (results.scenario.case(name).title, *errors_over_time(results, name, labels))
            for name, labels in shown.items()
        ]
    )


def errors_over_time(
    results: Results, case: str, labels: Iterable[str]
) -> tuple[np.ndarray, dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Return times (K',) [s], and RMS errors and bounds of a case at them, each (K', 2).

    Errors of position [m] and velocity [m/s] over the runs that are stored; an estimator without a
    finished run has none.
    """
    curves = {}
    for label in labels:
        series = results.series(case, label)
        if len(series):
            curves[label] = np.sqrt(np.mean(series[:, :, :2] ** 2, axis=0))
    stored = results.arrays(case)
    kept = stored["kept"]
    bounds = {name: np.sqrt(stored[key][kept]) for key, name in drawn_bounds(stored).items()}
    return stored["times"][kept], curves, bounds


def drawn_bounds(arrays: Iterable[str]) -> dict[str, str]:
    """Return the bounds that are drawn over time: key among the arrays of a case to its name."""
    keys = [key for key in arrays if key.startswith("bound-") and key != "bound-unfiltered"]
    return {key: f"bound, {_BOUNDS[key.rstrip('-0123456789')]}" for key in keys}


def component_errors(results: Results, case: str, label: str, quantity: Quantity) -> Drawing:
    """Draw the ENU errors of the detailed run with their claimed ±3σ, and the pure INS's.

    Raise ResultsError if this run of the estimator failed or has not been run; if the quantity is
    another one.
    """
    if quantity not in _COLUMNS:
        raise ResultsError(f"the quantity is {quantity!r} and must be one of {', '.join(_COLUMNS)}")
    aided = results.detail(case, label, DETAILED_RUN)
    if aided is None:
        raise ResultsError(
            f"{results.folder} holds no errors of {label} in run {DETAILED_RUN} of case {case}, "
            "the one that is kept in detail: it failed or was not run"
        )
    ins = results.detail(case, "ins", DETAILED_RUN)
    first, unit = _COLUMNS[quantity]
    times = results.arrays(case)["times"]
    return errors.component_errors(times, aided, ins, first, unit, label)


def field_map(results: Results, case: str) -> Drawing:
    """Draw the map that a case flies over, at flight height, with the track.

    Raise ResultsError if it has none.
    """
    arrays = results.arrays(case)
    if "map_vertical" not in arrays:
        raise ResultsError(f"case {case} flies over the normal field: it has no map to draw")
    return field.field_map(arrays)


def track_gradient(results: Results, case: str) -> Drawing:
    """Draw the vertical gradient along the track of a case: true, noisy and filtered.

    Raise ResultsError if there is no gradiometer on board.
    """
    arrays = results.arrays(case)
    if "gradient_times" not in arrays:
        raise ResultsError(f"case {case} flies without a gradiometer: it has no readings to draw")
    return field.gradient_along_track(arrays, results.scenario.case(case).title)
