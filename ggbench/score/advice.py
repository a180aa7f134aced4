"""Advice on a case: estimators, accuracy, limiting error sources, required gradiometer."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from ..campaign import campaign, running
from ..judging.planned import bound_of
from ..judging.summary import SMOOTHERS
from ..results.folder import Results
from ..spec.case import CaseSpec
from ..spec.named_sensors import table_of
from ..spec.scenario import Scenario
from . import stored_runs
from .stored_runs import ScoreError

RUNS = 40
_FINEST, _COARSEST = 1e-6, 1e4
"""Limits of the gradiometer noise in the search for a target, in the unit of the key."""
_STEPS = 14
"""Number of bisections of this range on a logarithmic scale, for an accuracy of 0.2%."""
_NOISES = ("noise_eotvos", "noise_density_eotvos_per_sqrt_hz")
SIDES = ("", "truth", "model")
"""Tables of a case that may state a number: the common table, and those of truth and model."""


@dataclass(frozen=True)
class Limit:
    """Cramér–Rao bound of a case in which one error source is halved.

    Attributes
    ----------
    cause : name of the error source.
    bound_m : bound of the RMS position error in the settled window [m].
    gain : relative decrease of the bound.
    """

    cause: str
    bound_m: float
    gain: float


@dataclass(frozen=True)
class Advice:
    """Result of ``ggbench advise``.

    Attributes
    ----------
    bound_m : Cramér–Rao bound of the RMS position error in the settled window [m].
    limits : effect of halving each error source, the largest first.
    noise : largest gradiometer noise that reaches the target; NaN without a target, or if no noise
        reaches it.
    unit : unit of ``noise``; "" without a gradiometer.
    """

    case: CaseSpec
    bound_m: float
    limits: tuple[Limit, ...]
    noise: float
    unit: str
    results: Results


def estimators() -> list[str]:
    """Return the labels of the INS and of all estimators recommended in any case of the suite."""
    recommended = stored_runs.header()["recommended"].values()
    labels = [kinds[kind]["label"] for kind in ("causal", "smoother") for kinds in recommended]
    return ["ins", *dict.fromkeys(label for label in labels if label)]


def advise(
    scenario: Scenario,
    case: CaseSpec,
    folder: Path,
    target_m: float | None = None,
    runs: int = RUNS,
    jobs: int | None = None,
    progress: Callable[[running.CampaignProgress], None] = lambda step: None,
) -> Advice:
    """Run the estimators on a case, and compute the effect of each error source on the bound.

    ``target_m`` is the required RMS position error [m]. Raise GGBenchError if the case cannot be
    flown, or no run gives a result.
    """
    bound = bound_of(case)
    limits = [
        Limit(cause, lowered, 1.0 - lowered / bound)
        for cause, change in halved(case)
        if (lowered := bound_of(change)) > 0.0
    ]
    key = _noise_key(case)
    noise = needed(case, key, target_m) if target_m is not None and key else math.nan
    work = campaign.planned(scenario, folder, estimators(), runs=runs, cases=[case.name])
    results = running.fly(work, jobs, progress=progress)
    if results.metrics().empty:
        raise ScoreError(f"no run of case {case.name} gave a result")
    ranked = tuple(sorted(limits, key=lambda limit: -limit.gain))
    unit = {_NOISES[0]: "E", _NOISES[1]: "E/√Hz"}.get(key.partition(".")[2], "")
    return Advice(case, bound, ranked, noise, unit, results)


def _noise_key(case: CaseSpec) -> str:
    """Return the dotted key of the gradiometer's noise; "" if no key states it as a number."""
    tables = [case.gradiometer, case.truth.gradiometer, case.model.gradiometer]
    present = [t for t in tables if t is not None]
    names = [n for n in _NOISES if any(getattr(table, n, None) is not None for table in present)]
    return f"gradiometer.{names[0]}" if names else ""


def with_value(
    case: CaseSpec, key: str, value: Callable[[float], float], sides: Sequence[str] = SIDES
) -> CaseSpec:
    """Return a case in which the value of a key is changed in each of the given tables.

    Parameters
    ----------
    key : dotted key, such as ``gradiometer.noise_eotvos``.
    value : function from the old number to the new one. Only positive numbers are changed.
    sides : tables to change: ``truth``, ``model``, and "" for the case's common table.
    """
    for side in sides:
        present = _held(getattr(case, side) if side else case, key)
        if isinstance(present, int | float) and present > 0.0:
            case = case.changed(f"{side}.{key}".lstrip("."), value(present))
    return case


def _held(tables: Any, key: str) -> Any:
    """Return the value at a dotted key in the tables of a side, or None."""
    *path, name = key.split(".")
    table = tables
    if path[0] != "sensor" and path[0] in tables.sensor:
        table, path = tables.sensor[path[0]], path[1:]
    for part in path:
        table = table.get(part) if isinstance(table, Mapping) else getattr(table, part, None)
    return getattr(table, name, None)


def _numbers(table: Any, *words: str) -> list[str]:
    """Return the keys of a table that contain one of some words, except keys of times."""
    return [
        name
        for name in type(table).model_fields
        if any(word in name for word in words) and not name.endswith("_s")
    ]


def halved(case: CaseSpec) -> Iterator[tuple[str, CaseSpec]]:
    """Yield each error source, with a case in which it is halved in truth and model.

    The error of the map is removed instead of halved.
    """
    causes: list[tuple[str, list[str]]] = []
    if case.gradiometer is not None:
        key = _noise_key(case)
        biases = [f"gradiometer.{name}" for name in _numbers(case.gradiometer, "bias", "drift")]
        causes += [("noise of the gradiometer", [key] if key else [])]
        causes += [("biases and drift of the gradiometer", biases)]
    for name, spec in case.sensor.items():
        place, words = table_of(name), name.replace("_", " ").replace("gnss", "GNSS receiver")
        for kind in ("noise", "bias"):
            keys = [f"{place}.{item}" for item in _numbers(spec, kind)]
            causes.append((f"{kind} of the {words}", keys))
    if case.altimeter is not None:
        noises = [f"altimeter.{name}" for name in _numbers(case.altimeter, "noise")]
        causes.append(("noise of the altimeter", noises))
    prior = [f"initial_error.{name}" for name in type(case.initial_error).model_fields]
    causes.append(("initial uncertainty", prior))
    imu = [f"imu.{name}" for name in _numbers(case.imu, "bias", "noise")]
    causes.append(("errors of the inertial sensors", imu))
    if case.model.field.standard_error:
        yield "error of the map (removed)", case.changed("model.field.standard_error", False)
    for cause, keys in causes:
        half = case
        for key in keys:
            half = with_value(half, key, lambda number: 0.5 * number)
        if half is not case:
            yield cause, half


def needed(case: CaseSpec, key: str, target_m: float) -> float:
    """Return the largest gradiometer noise with which the bound reaches ``target_m`` [m].

    ``key`` is the dotted key of the noise; truth and model change together. The result has the unit
    of the key. It is NaN if no noise between 1e-6 and 1e4 reaches the target.
    """
    low, high = math.log(_FINEST), math.log(_COARSEST)

    def reached(noise: float) -> bool:
        return bound_of(with_value(case, key, lambda number: noise)) <= target_m

    if not reached(_FINEST):
        return math.nan
    for _ in range(_STEPS):
        middle = 0.5 * (low + high)
        if reached(math.exp(middle)):
            low = middle
        else:
            high = middle
    return math.exp(low)


def usual_seconds() -> Mapping[str, float]:
    """Return the usual computing time of a run [s] by estimator: the median over the suite.

    The times of the advice's own runs include loading and compilation, so they are not used.
    """
    cells = pd.DataFrame(stored_runs.header()["cells"])
    return {
        str(name): float(s) for name, s in cells.groupby("estimator")["seconds"].median().items()
    }


def recommended(advice: Advice) -> tuple[str, bool]:
    """Return the label of a causal estimator, and whether it is recommended.

    The estimator is the fastest recommended estimator, or the best if none is recommended.
    """
    seconds, metrics = usual_seconds(), table(advice)
    causal = ~metrics["causality"].isin(SMOOTHERS)
    named = metrics.loc[causal & metrics["recommended"].astype(bool), "estimator"]
    if len(named):
        return min(named, key=lambda label: seconds.get(label, math.inf)), True
    return advice.results.cases().iloc[0]["best"], False


def after_landing(advice: Advice) -> str:
    """Return the label of the smoother with the least error; "" if there was no smoother."""
    return str(advice.results.cases().iloc[0]["best_smoother"])


def table(advice: Advice) -> pd.DataFrame:
    """Return the metrics of all estimators in the settled window, sorted by RMS error."""
    metrics = advice.results.metrics()
    return metrics[metrics["window"] == "settled"].sort_values("rms_m", kind="stable")
