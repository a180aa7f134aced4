"""Advice on a user's own case: estimator, accuracy, what limits it, instrument for a target."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from operator import attrgetter
from pathlib import Path

import pandas as pd

from ..campaign import campaign, running
from ..judging.planned import bound_of
from ..results.folder import Results
from ..spec.case import CaseSpec
from ..spec.scenario import Scenario
from . import stored_runs
from .stored_runs import ScoreError

RUNS = 40
_FINEST, _COARSEST = 1e-6, 1e4
"""Noise of a gradiometer between which one is sought for a target, in its own unit."""
_STEPS = 14
"""Halvings of that range on a logarithmic scale: to 0.2%."""
_NOISES = ("noise_eotvos", "noise_density_eotvos_per_sqrt_hz")
_SENSORS = {"gravimeter": "noise_mgal", "gnss": "position_noise_m", "velocity_log": "noise_mps"}


@dataclass(frozen=True)
class Limit:
    """The bound [m] if one cause of error is halved, and its relative decrease."""

    cause: str
    bound_m: float
    gain: float


@dataclass(frozen=True)
class Advice:
    """What ``ggbench advise`` found.

    Attributes
    ----------
    bound_m : Cramér–Rao bound of the RMS position error in the settled window [m].
    limits : causes of error, the one that gains most first.
    noise : noise of the gradiometer that reaches the target, NaN if none does or none is sought.
    unit : of that noise; "" without a gradiometer.
    """

    case: CaseSpec
    bound_m: float
    limits: tuple[Limit, ...]
    noise: float
    unit: str
    results: Results


def estimators() -> list[str]:
    """Return the INS and the estimators that are recommended in some case of the suite."""
    recommended = stored_runs.header()["recommended"].values()
    found = [kinds[kind]["label"] for kind in ("causal", "smoother") for kinds in recommended]
    return ["ins", *dict.fromkeys(label for label in found if label)]


def advise(
    scenario: Scenario,
    case: CaseSpec,
    folder: Path,
    target_m: float | None = None,
    runs: int = RUNS,
    jobs: int | None = None,
    progress: Callable[[running.CampaignProgress], None] = lambda step: None,
) -> Advice:
    """Fly a few runs of a case of a scenario, and compute what its bound gains.

    ``target_m`` is the RMS position error that is wanted [m]. Raise GGBenchError if the case cannot
    be flown, or runs gave no result.
    """
    bound = bound_of(case)
    limits = [
        Limit(cause, halved, 1.0 - halved / bound)
        for cause, change in _halved(case)
        if (halved := bound_of(change)) > 0.0
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
    """Return the key of the gradiometer's noise, "" if none can be changed by a number."""
    spec = case.gradiometer
    names = [name for name in _NOISES if spec is not None and getattr(spec, name) is not None]
    return f"gradiometer.{names[0]}" if names else ""


def _with_half(case: CaseSpec, keys: list[str]) -> CaseSpec:
    for key in keys:
        case = case.changed(key, 0.5 * attrgetter(key)(case))
    return case


def _halved(case: CaseSpec) -> Iterator[tuple[str, CaseSpec]]:
    """Yield each cause of error with the case in which it is half as large."""
    if key := _noise_key(case):
        yield "noise of the gradiometer", _with_half(case, [key])
    for sensor, name in _SENSORS.items():
        spec = case.sensor.get(sensor)
        if spec is not None and getattr(spec, name) is not None:
            words = sensor.replace("_", " ").replace("gnss", "GNSS receiver")
            half = case.changed(f"{sensor}.{name}", 0.5 * getattr(spec, name))
            yield f"noise of the {words}", half
    if case.model.field.standard_error:
        yield "error of the map (removed)", case.changed("model.field.standard_error", False)
    prior = [f"initial_error.{name}" for name in ("position_m", "velocity_mps", "attitude_arcmin")]
    yield "initial uncertainty", _with_half(case, prior)
    imu = [
        f"imu.{name}"
        for name in (
            "gyro_bias_deg_per_h",
            "gyro_noise_deg_per_sqrt_h",
            "accelerometer_bias_ug",
            "accelerometer_noise_ug_per_sqrt_hz",
        )
        if getattr(case.imu, name) > 0.0
    ]
    yield "errors of the inertial sensors", _with_half(case, imu)


def needed(case: CaseSpec, key: str, target_m: float) -> float:
    """Return the largest noise of the gradiometer with which the bound reaches a target [m].

    ``key`` is the dotted key of the noise. NaN if no noise between 1e-6 and 1e4 reaches it.
    """
    low, high = math.log(_FINEST), math.log(_COARSEST)
    if bound_of(case.changed(key, _FINEST)) > target_m:
        return math.nan
    for _ in range(_STEPS):
        middle = 0.5 * (low + high)
        if bound_of(case.changed(key, math.exp(middle))) <= target_m:
            low = middle
        else:
            high = middle
    return math.exp(low)


def recommended(advice: Advice) -> tuple[str, bool]:
    """Return the causal estimator to use, and whether it is recommended or only the best."""
    row = advice.results.cases().iloc[0]
    return (row["recommended"], True) if row["recommended"] else (row["best"], False)


def table(advice: Advice) -> pd.DataFrame:
    """Return the settled metrics of the estimators that were flown, by RMS error."""
    metrics = advice.results.metrics()
    return metrics[metrics["window"] == "settled"].sort_values("rms_m", kind="stable")
