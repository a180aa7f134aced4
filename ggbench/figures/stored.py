"""Figures of the cases of a results folder."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise
from typing import Any, Literal

import numpy as np

from ..results.folder import Results, ResultsError
from ..results.store import DETAILED_RUN
from . import answer, errors, field
from .style import Drawing

Quantity = Literal["position", "velocity"]
_COLUMNS: dict[Quantity, tuple[int, str]] = {"position": (0, "m"), "velocity": (3, "m/s")}
"""First column and unit of each quantity in the errors of the detailed run."""
MOST_PANELS = 3
"""Largest number of panels in a figure of a sweep."""
_LOG_FROM = 5.0
"""Ratio of the largest to the least swept value above which the axis is logarithmic."""
_BOUNDS = {"bound-filter": "filter", "bound-batch": "smoother", "bound-fixed-lag": "fixed lag"}
"""Words for the bounds that are drawn, by their stored names without a lag."""


def error_over_time(
    results: Results, labels_of: Mapping[str, Sequence[str]], most: int | None = None
) -> Drawing:
    """Draw RMS errors and bounds against time, with a column for each case.

    The RMS is taken over the stored runs. ``labels_of`` has the estimators of each case.
    ``most`` is the largest number of epochs.
    """
    flights = [flight(results, case, labels, most) for case, labels in labels_of.items()]
    return errors.error_over_time(flights, results.families)


def flight(results: Results, case: str, labels: Iterable[str], most: int | None) -> errors.Flight:
    """Return the RMS errors and the bounds of a case as functions of time.

    The RMS is taken over the stored runs. At most ``most`` evenly spread epochs are used. An
    estimator without a finished run is left out.
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
    """Return the bounds to draw over time: the name in the legend, by key of the stored array.

    ``arrays`` contains the keys of all stored arrays of a case.
    """
    keys = [key for key in arrays if key.startswith("bound-") and key != "bound-unfiltered"]
    return {key: f"bound, {_BOUNDS[key.rstrip('-0123456789')]}" for key in keys}


def component_errors(results: Results, case: str, label: str, quantity: Quantity) -> Drawing:
    """Draw ENU errors of an estimator in run 0 with the reported ±3σ, and the errors of the INS.

    Raise ResultsError if this run failed or does not exist, or the quantity is neither ``position``
    nor ``velocity``.
    """
    if quantity not in _COLUMNS:
        raise ResultsError(f"the quantity is {quantity!r} and must be one of {', '.join(_COLUMNS)}")
    aided = results.detail(case, label, DETAILED_RUN)
    if aided is None:
        raise ResultsError(
            f"{results.folder} has no error history of {label} in case {case}, run "
            f"{DETAILED_RUN}: this run failed or does not exist. Only run {DETAILED_RUN} is stored "
            "in detail"
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
    """Draw a case's map at flight height, with the track.

    Raise ResultsError if the case has no map.
    """
    arrays = results.arrays(case)
    if "map_vertical" not in arrays:
        raise ResultsError(f"case {case} uses the normal field: it has no map to draw")
    return field.field_map(arrays)


def track_gradient(results: Results, case: str) -> Drawing:
    """Draw the vertical gradient along the track of a case: true, noisy and filtered.

    Raise ResultsError if the case has no gradiometer.
    """
    arrays = results.arrays(case)
    if "gradient_times" not in arrays:
        raise ResultsError(f"case {case} has no gradiometer: it has no measurements to draw")
    return field.gradient_along_track(arrays, results.scenario.case(case).title)


def swept(results: Results, key: str | None = None) -> Drawing:
    """Draw RMS errors, bounds and the INS error against a swept value.

    Each combination of values of the other swept keys has a panel; at most :data:`MOST_PANELS` are
    drawn.

    Parameters
    ----------
    results : results of a sweep.
    key : dotted key of the abscissa. By default it is the key with the fewest changes between
        successive cases.

    Raises
    ------
    ResultsError
        If ``key`` does not vary, or no number varies.
    """
    metrics = results.metrics()
    rows = metrics[metrics["window"] == "settled"]
    cases = [case for case in results.scenario.cases if case.name in set(rows["case"])]
    tables = [_numbers(case.model_dump(warnings=False)) for case in cases]
    shared = [name for name in tables[0] if all(name in table for table in tables)]
    changes = {name: sum(a[name] != b[name] for a, b in pairwise(tables)) for name in shared}
    varied = sorted((name for name in shared if changes[name]), key=lambda name: changes[name])
    chosen = key or (varied[0] if varied else "")
    if chosen not in varied:
        reason = f"it varies {', '.join(varied)}" if varied else "no numeric key varies"
        raise ResultsError(f"{results.folder} holds no sweep of {key or 'a number'}: {reason}")
    parts: dict[tuple[str, ...], list[tuple[float, str]]] = {}
    for case, table in zip(cases, tables, strict=True):
        rest = tuple(f"{name.split('.')[-1]} {table[name]:g}" for name in varied if name != chosen)
        parts.setdefault(rest, []).append((table[chosen], case.name))
    labels = [label for label in results.labels if label != "ins"]
    panels = []
    for rest, part in [*parts.items()][:MOST_PANELS]:
        places, names = zip(*sorted(part), strict=True)
        panels.append(answer.panel(rows, names, labels, ", ".join(rest), np.array(places)))
    values = np.concatenate([each.places for each in panels])
    log = bool(values.min() > 0.0 and values.max() > _LOG_FROM * values.min())
    return answer.over_axis(panels, chosen, log, results.families)


def _numbers(table: Mapping[str, Any], above: str = "") -> dict[str, float]:
    """Return the numbers of nested tables by their dotted keys."""
    numbers: dict[str, float] = {}
    for key, value in table.items():
        if isinstance(value, Mapping):
            numbers |= _numbers(value, f"{above}{key}.")
        elif isinstance(value, int | float) and not isinstance(value, bool):
            numbers[f"{above}{key}"] = value
    return numbers
