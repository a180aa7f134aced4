"""Records and time series of runs, and arrays that all runs of a case share."""

from __future__ import annotations

import json
import math
import platform
import re
import resource
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from pydantic_core import from_json

from ..engines.innovations import innovations_squared
from ..gravity.field import Field
from ..ins.system_matrix import STATES
from ..judging import convergence, fix_metrics, references, run_errors
from ..judging.bounds import squared_bounds
from ..judging.judgement import OUTSIDE
from ..judging.references import CaseBound
from ..problem import Causality, Fixes, Problem
from ..results.columns import BLANK, WINDOW_COLUMNS
from ..results.database import Result
from ..results.store import DETAILED_RUN, SERIES_RUNS, kept_epochs
from ..sensors.gradiometer.instrument import COMPONENTS, Gradiometer
from ..simulation.bound import Bound
from ..simulation.error_free_flight import Flight
from ..simulation.flight_bounds import bounds, unfiltered_bound
from ..simulation.random_streams import RandomStreams
from ..spec.case import CaseSpec
from .registry import Choice

_LONGEST_INFO = 100_000
_LARGEST_COUNT = 2**63 - 1
_STATUS, _PEAK = Path("/proc/self/status"), re.compile(r"VmHWM:\s*(\d+) kB")
BORDER = 0.1
"""Width of the border outside a map that counts as inside, in node spacings."""


@dataclass(frozen=True)
class TimedEstimates:
    """Estimates of R runs by one estimator, with computing times.

    Attributes
    ----------
    mean : (R, K, n) estimated states.
    cov : (R, K, n, n) covariances, or None.
    nis : (R, K) normalised innovation squared; None: to be computed from mean and covariance.
    causality, lag : as in :class:`ggbench.problem.Estimate`.
    info : counters and remarks of each run.
    evaluations : number of map evaluations of each run.
    seconds : computing time per run [s]; for a block, the mean over its runs.
    fixes : position fixes of a matcher that processes a single run, validated by
        :func:`.judging.fix_metrics.checked`; None if there are none.
    """

    mean: np.ndarray
    cov: np.ndarray | None
    nis: np.ndarray | None
    causality: Causality
    lag: float | None
    info: Sequence[dict[str, Any]]
    evaluations: Sequence[int]
    seconds: float
    fixes: Fixes | None = None

    def of_runs(self, some: slice) -> TimedEstimates:
        """Return the estimates of a slice of the runs."""
        columns = {
            name: getattr(self, name) for name in ("mean", "cov", "nis", "info", "evaluations")
        }
        cut = {name: values[some] for name, values in columns.items() if values is not None}
        return replace(self, **cut)


def peak_memory_mb() -> float:
    """Return the peak memory [MiB] of this process.

    On Linux the value is from proc(5), because getrusage(2) includes the memory of the parent.
    """
    if platform.system() == "Linux" and (own := _PEAK.search(_STATUS.read_text())):
        return int(own[1]) / 2.0**10
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    # In bytes on macOS, in KiB on the BSDs (getrusage(2) of each).
    return peak / (2.0**20 if platform.system() == "Darwin" else 2.0**10)


def new_record(choice: Choice, run: int, seed: int) -> dict[str, Any]:
    """Return an incomplete record of a run, without results."""
    return BLANK | {
        "name": choice.estimator.name,
        "parameters": choice.spec.listed,
        "causality": choice.estimator.causality,
        "run": run,
        "seed": seed,
        "status": "failed",
    }


def evaluate_runs(
    blanks: Sequence[dict[str, Any]],
    key: str,
    flight: Flight,
    error_state: np.ndarray,
    estimated: TimedEstimates,
    bound: CaseBound,
    oracle: Callable[[str], np.ndarray],
    problem_of: Callable[[int], Problem],
) -> list[Result]:
    """Evaluate the estimates of R runs; a run with an invalid estimate is a failed run.

    Parameters
    ----------
    blanks : incomplete record of each run (:func:`new_record`).
    key : key of the results.
    flight : flight of the runs.
    error_state : (R, K, n) true error states.
    estimated : estimates of the runs.
    bound : bound of the flight.
    oracle : function that returns the mean squared errors (R, W, 2) of the oracle, given the name
        of a bound. The axes are runs, W windows, and position [m²] and velocity [m²/s²].
    problem_of : function that returns the problem of a run, given its row 0 to R − 1.
    """
    case, times, filters = flight.case, flight.times, estimated.causality == "filter"
    evaluation, flaws = run_errors.evaluate_block(error_state, estimated.mean, estimated.cov)
    if filters and estimated.nis is not None:
        evaluation.nis[:] = estimated.nis
    elif filters and estimated.cov is not None:
        for r in (r for r, flaw in enumerate(flaws) if not flaw):
            mean, cov = estimated.mean[r], estimated.cov[r]
            evaluation.nis[r] = innovations_squared(problem_of(r), mean, cov)
    means = run_errors.window_means(evaluation, times, case.windows)
    final = evaluation.position_error[:, -1].tolist()
    ins = np.sqrt((error_state[:, -1, :3] ** 2).sum(axis=1)).tolist()
    required = bound.required_m
    converged, false = convergence.judge(
        evaluation.position_error, evaluation.sigmas[:, -1, :3], times, required
    )
    name = _bound_of(case, estimated.causality, estimated.lag)
    compared = references.metrics(name, bound, oracle(name))
    windows = np.concatenate([means, compared], axis=2).reshape(len(blanks), -1).tolist()
    peak = peak_memory_mb()
    stored = kept_epochs(len(times))
    curves = (evaluation.position_error, evaluation.velocity_error, evaluation.nees, evaluation.nis)
    outside = np.zeros(len(blanks), dtype=bool)
    if estimated.causality != "none":  # else no map was asked
        outside = outside_map(flight, evaluation.components)
    results = []
    for r, blank in enumerate(blanks):
        record = blank | {"seconds": estimated.seconds}
        if flaw := flaws[r] or _flaw_of_count(estimated.evaluations[r]):
            results.append(Result(key, record | {"reason": f"ValueError: {flaw}"}))
            continue
        record |= {
            "status": "ok",
            "bound": name,
            "required_m": required,
            "peak_memory_mb": peak,
            "info": estimated.info[r],
            "map_evaluations": estimated.evaluations[r],
            "final_position_error_m": final[r],
            "final_ins_error_m": ins[r],
            "diverged": run_errors.has_diverged(final[r], bound.final_m, ins[r]),
            "converged_s": float(converged[r]),
            "false_fix": bool(false[r]),
            **dict(zip(WINDOW_COLUMNS, windows[r], strict=True)),
        }
        fixes: list[dict[str, Any]] = []
        if estimated.fixes is not None:
            fixes = fix_metrics.judge(estimated.fixes, error_state[r], times)
            record["fixes"] = len(fixes)
        if outside[r]:
            record["remark"] = OUTSIDE
        series = detail = None
        if record["run"] < SERIES_RUNS:
            series = _narrowed(np.stack([values[r, stored] for values in curves], axis=-1))
        if record["run"] == DETAILED_RUN:
            detail = _narrowed(_detail(flight, error_state[r], estimated, evaluation, r))
        results.append(Result(key, record, series, detail, fixes))
    return results


def _flaw_of_count(evaluations: int) -> str:
    """Return the fault of an estimator's own count of map evaluations, or ""."""
    if 0 <= evaluations <= _LARGEST_COUNT:
        return ""
    return "the estimate's info has map_evaluations below zero, or beyond 64 bits"


def _detail(
    flight: Flight,
    error_state: np.ndarray,
    estimated: TimedEstimates,
    evaluation: run_errors.Evaluation,
    r: int,
) -> np.ndarray:
    """Return the errors (K, 18) of run ``r``.

    The columns are position and velocity errors, their σ, errors of the gravity disturbance, and
    their σ.
    """
    gravity = np.full((len(error_state), 6), np.nan)
    if flight.model.disturbance is not None:
        states = slice(STATES, STATES + 3)
        gravity[:, :3] = error_state[:, states] - estimated.mean[r, :, states]
        if estimated.cov is not None:
            variances = np.diagonal(estimated.cov[r], axis1=1, axis2=2)[:, states]
            gravity[:, 3:] = np.sqrt(np.maximum(variances, 0.0))
    return np.hstack([evaluation.components[r], evaluation.sigmas[r], gravity])


def outside_map(flight: Flight, errors: np.ndarray) -> np.ndarray:
    """Return a mask (R,): true if any estimated position leaves the map that estimators use.

    ``errors`` (R, K, 6) are ENU errors of position [m] and velocity [m/s].
    """
    believed = flight.trajectory.positions[flight.epochs] + errors[:, :, [1, 0, 2]] / flight.metres
    return np.asarray(~flight.model_field.covers(believed, BORDER).all(axis=1))


def _narrowed(array: np.ndarray) -> np.ndarray:
    """Return an array as float32; values beyond the range of float32 are clipped."""
    largest = np.finfo("<f4").max
    return np.clip(array, -largest, largest).astype("<f4")


def _bound_of(case: CaseSpec, causality: Causality, lag: float | None) -> str:
    """Return the name of the bound that an estimate is compared with.

    An estimate without aiding is compared with the filtering bound, which aiding could reach.
    """
    if lag is not None:
        return f"fixed-lag-{lag_epochs(case, lag)}"
    return "batch" if causality == "batch" else "filter"


def remarks(info: Any) -> dict[str, Any]:
    """Convert an estimate's ``info`` to JSON values for a record.

    Lone surrogates (from file names that are not UTF-8) become ``?``. Raise ValueError if ``info``
    is too long, is nested too deeply, or contains numbers with thousands of digits.
    """
    text = json.dumps(dict(info), default=float, ensure_ascii=False)
    text = text.encode(errors="replace").decode()
    if len(text) > _LONGEST_INFO:
        raise ValueError(f"the estimate's info has {len(text)} characters, over {_LONGEST_INFO}")
    try:
        decoded: dict[str, Any] = from_json(text)  # as it will be read
    except ValueError as error:
        raise ValueError(f"the estimate's info cannot be stored: {error}") from None
    return decoded


def lag_epochs(case: CaseSpec, lag: float) -> int:
    """Return a fixed lag as a number of epochs, rounded down; ``lag`` is in seconds."""
    return math.floor(lag / case.tick_s + 1e-9)


def shared_arrays(flight: Flight, seed: int, lags: Sequence[int]) -> dict[str, np.ndarray]:
    """Return the arrays that all runs of a case share: bounds, availability, signals for figures.

    Arrays over epochs are (K,) or have K rows. ``lags`` are the fixed lags in use [epochs].
    ``seed`` is the seed of the noise in the gradient signals.
    """
    arrays = {
        "times": flight.times,
        "kept": kept_epochs(len(flight.times)),
        "track": flight.trajectory.positions[flight.epochs],
        "present": _some_expected(flight),
        "channels": flight.expected.sum(axis=1),
    }
    bound = CaseBound(flight, bounds([flight])[0])
    for name in ("filter", "batch", *(f"fixed-lag-{lag}" for lag in lags)):
        arrays[f"bound-{name}"] = bound.squares(name)
    true = flight.true.gradiometer
    if true is not None and true.lowpass is not None:
        unfiltered = squared_bounds(unfiltered_bound(flight).filtering)
        arrays["bound-unfiltered"] = np.stack(unfiltered, axis=-1)
    if flight.unknown_gravity.any():
        arrays["response"] = flight.gravity_response
    if flight.model.disturbance is not None:
        arrays["gravity"] = np.hstack([flight.unknown_gravity, _known_gravity(bound.bound)])
    if true is not None:
        arrays |= _gradient_signals(flight, true, seed)
    if flight.field.has_map:
        arrays |= _map_signals(
            flight.field, float(np.mean(flight.field.coordinates(arrays["track"])[:, 2]))
        )
    return arrays


def _some_expected(flight: Flight) -> np.ndarray:
    """Return the expected share of runs (K,) with any measurement at each epoch.

    The channels of a sensor drop out together; different sensors drop out independently.
    """
    true, none = flight.true, np.ones(len(flight.times))
    first = 0
    for count in (true.gradients, *(len(sensor.channels) for sensor in true.aiding)):
        if count:
            none *= 1.0 - flight.expected[:, first]
        first += count
    return np.asarray(1.0 - none)


def _known_gravity(bound: Bound) -> np.ndarray:
    """Return σ and correlations (K, 5) of the gravity disturbance in the bound.

    The first three columns are σ in ENU [m/s²]. The other two are the correlations of the east
    component with the tilt about north, and of the north component with the tilt about east.
    """
    tilts, states = (7, 6), (STATES, STATES + 1)
    sigma = np.sqrt(np.diagonal(bound.filtering, axis1=1, axis2=2))
    correlations = [
        bound.filtering[:, state, tilt] / (sigma[:, state] * sigma[:, tilt])
        for state, tilt in zip(states, tilts, strict=True)
    ]
    return np.column_stack([sigma[:, STATES : STATES + 3], *correlations])


def _gradient_signals(flight: Flight, true: Gradiometer, seed: int) -> dict[str, np.ndarray]:
    """Return Γ_UU at the measurement times: true, noisy and, with a low-pass filter, filtered.

    The noise is that of the detailed run. If the whole tensor was measured, the measured Γ_UU
    replaces the simulated noisy one.
    """
    streams = RandomStreams(seed, DETAILED_RUN, flight.case.draw.name)
    vertical = COMPONENTS.index("zz")
    # Coloured noise is of the channels that there are: another one shows white noise of its RMS.
    instrument = replace(true, components=COMPONENTS, colour=None)
    at, measured = flight.epochs[flight.gradient_epochs], flight.measured
    if measured is not None:  # a map need not reach as far as turns without measurements
        at, measured = at[~flight.absent], measured[~flight.absent]
    enu, count = flight.field.tensor(*flight.trajectory.positions[at].T), len(at)
    arrays = {"gradient_times": flight.trajectory.times[at], "vertical": enu[:, vertical]}
    noise = instrument.noise(count, streams["gradiometer/"])[:, vertical]
    behind = instrument.noise_behind(count, streams["gradiometer/behind_filter"])[:, vertical]
    arrays["noisy"] = arrays["vertical"] + noise
    if measured is not None and true.whole:
        arrays["noisy"] = true.tensors(measured)[:, vertical]
        return arrays
    if instrument.lowpass is None:
        arrays["noisy"] += behind
    else:
        arrays["filtered"] = instrument.lowpass.apply(arrays["noisy"]) + behind
        arrays["filtered_true"] = instrument.lowpass.apply(arrays["vertical"])
    return arrays


@lru_cache(maxsize=8)
def _map_signals(field: Field, height: float) -> dict[str, np.ndarray]:
    """Return the disturbing vertical gradient over the whole map, at a height of its nodes [m]."""
    latitude = np.linspace(field.origin[0], field.upper[0], 101)
    longitude = np.linspace(field.origin[1], field.upper[1], 161)
    return {
        "map_latitude": latitude,
        "map_longitude": longitude,
        "map_vertical": field.vertical_disturbance(
            *field.over_nodes(latitude[:, None], longitude[None, :], height)
        ),
    }
