"""Figures of the cases of a results folder."""

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


def error_over_time(
    results: Results, labels_of: Mapping[str, Sequence[str]], most: int | None = None
) -> Drawing:
    """Draw the RMS errors over all runs against time, and the bounds: a column for each case.

    ``labels_of`` names the estimators of each case; ``most`` limits the epochs.
    """
    flights = [flight(results, case, labels, most) for case, labels in labels_of.items()]
    return errors.error_over_time(flights, results.families)


def flight(results: Results, case: str, labels: Iterable[str], most: int | None) -> errors.Flight:
    """Return RMS errors and bounds of a case over the runs that are stored.

    Evenly spread epochs, if there are more than ``most``. An estimator without a finished run has
    no errors.
    """
    arrays = results.arrays(case)
    count = len(arrays["kept"])
    epochs = np.unique(np.linspace(0, count - 1, min(most or count, count)).astype(int))
    epochs_drawn = arrays["kept"][epochs]
    series = {label: results.series(case, label) for label in labels}
    rms = {
        label: np.sqrt(np.mean(errors_of_runs[:, epochs, :2] ** 2, axis=0))
        for label, errors_of_runs in series.items()
        if len(errors_of_runs)
    }
    bounds = {
        name: np.sqrt(arrays[key][epochs_drawn]) for key, name in drawn_bounds(arrays).items()
    }
    return errors.Flight(
        results.scenario.case(case).title, arrays["times"][epochs_drawn], rms, bounds
    )


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
            f"{results.folder} has no errors of {label} in run {DETAILED_RUN} of case {case}, "
            "the run that is stored in detail: it failed or was not run"
        )
    ins = results.detail(case, "ins", DETAILED_RUN)
    first, unit = _COLUMNS[quantity]
    times = results.arrays(case)["times"]
    return errors.component_errors(
        times=times,
        aided=aided,
        ins=ins,
        first=first,
        unit=unit,
        label=label,
        families=results.families,
    )


def field_map(results: Results, case: str) -> Drawing:
    """Draw the map that a case flies over, at flight height, with the track.

    Raise ResultsError if it has none.
    """
    arrays = results.arrays(case)
    if "map_vertical" not in arrays:
        raise ResultsError(f"case {case} uses the normal field: it has no map to draw")
    return field.field_map(arrays)


def track_gradient(results: Results, case: str) -> Drawing:
    """Draw the vertical gradient along the track of a case: true, noisy and filtered.

    Raise ResultsError if there is no gradiometer on board.
    """
    arrays = results.arrays(case)
    if "gradient_times" not in arrays:
        raise ResultsError(f"case {case} has no gradiometer: it has no measurements to draw")
    return field.gradient_along_track(arrays, results.scenario.case(case).title)
