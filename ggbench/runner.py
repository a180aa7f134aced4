"""One run: simulate it, give it to every estimator, judge the estimates.

This is what a worker process does; nothing here writes anything.
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import json
import math
import os
import resource
import time
import traceback
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from . import convergence, keys, metrics
from .errors import GGBenchError
from .field import Field
from .gradiometer import COMPONENTS
from .problem import Estimate, Estimator, MeasurementModel, Problem
from .registry import Choice, choose
from .schema import CaseSpec
from .simulation import Flight, Truth, prepare, random_streams, simulate
from .store import Result

DETAILED_RUN = 0
"""The run whose errors and claimed deviations are kept component by component, for the figures."""
_LONGEST_TEXT = 4000
_LONGEST_INFO = 100_000
MOST_KEPT = 400
"""Most epochs of a run whose errors are kept as a time series."""


class OtherSourceError(GGBenchError):
    """What would run here is not what the campaign was planned with."""


@dataclass(frozen=True, slots=True)
class Task:
    """One run of one case with the estimators that still miss it.

    Attributes
    ----------
    case : the case. assumption : the study it belongs to, "" for the cases themselves.
    run, seed : the run's number and the campaign's seed.
    estimators : (label, key) of each estimator to run.
    """

    case: CaseSpec
    assumption: str
    run: int
    seed: int
    estimators: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class Started:
    """Says that the run of an estimator begins."""

    label: str


class _CountingModel:
    """A measurement model that counts the points at which the map is evaluated."""

    def __init__(self, model: MeasurementModel) -> None:
        self._model = model
        self.evaluations = 0

    def predict(self, k: int, x: np.ndarray) -> np.ndarray:
        self.evaluations += math.prod(np.shape(x)[:-1])
        return self._model.predict(k, x)

    def jacobian(self, k: int, x: np.ndarray) -> np.ndarray:
        self.evaluations += 1
        return self._model.jacobian(k, x)


@lru_cache(maxsize=1024)
def _flight(case_json: str) -> Flight:
    return prepare(CaseSpec.model_validate_json(case_json))


def flight_of(case: CaseSpec) -> Flight:
    """Return the flight of a case, made once in each process."""
    return _flight(case.model_dump_json())


def forget_flights() -> None:
    """Let go of the flights of this process: a library of scenarios has many, and large ones."""
    _flight.cache_clear()


@lru_cache(maxsize=1024)
def chosen(label: str) -> Choice:
    """Return the estimator of a label, chosen once in each process."""
    return choose(label)


@lru_cache(maxsize=4096)
def _key(case_json: str, label: str, seed: int) -> str:
    return keys.run_key(CaseSpec.model_validate_json(case_json), chosen(label).content, seed)


def _estimator_rng(seed: int, run: int, choice: Choice) -> np.random.Generator:
    """Return the estimator's own generator: reproducible, and no key to the simulation's."""
    content = choice.content
    name = f"{content['class']}|{json.dumps(content['parameters'], sort_keys=True)}|{seed}|{run}"
    digest = hashlib.sha256(name.encode()).digest()
    return np.random.default_rng(int.from_bytes(digest[:16], "little"))


_warm: set[str] = set()
"""Labels of the estimators that this process has run: their first run compiles and imports."""


def run_task(task: Task) -> Iterator[Started | Result]:
    """Simulate one run and judge every estimator on it; a failure is a record.

    Yields
    ------
    For each estimator ``Started``, then its result.

    Raises
    ------
    OtherSourceError
        If the package, a library, an estimator's source or a map file is not what the task's keys
        were made with.
    """
    case_json = task.case.model_dump_json()
    for label, key in task.estimators:
        if _key(case_json, label, task.seed) != key:
            raise OtherSourceError(
                f"the source or version of ggbench, of a library, of {label} or of a map file "
                f"is not what the campaign was started with; here: {keys.environment()}"
            )
    reason, trace = "", ""
    try:
        flight = _flight(case_json)
        problem, truth = simulate(flight, task.seed, task.run)
    except Exception as error:
        reason, trace = f"simulation: {said(error)}", _trace()
    for label, key in task.estimators:
        yield Started(label)
        if reason:
            yield failure(task, label, key, reason, trace)
            continue
        choice = chosen(label)
        cold = label not in _warm
        _warm.add(label)
        record, series, detail = _judge(task, flight, problem, truth, choice)
        # Times of a process's first run hold compilation and imports: summaries leave them out.
        yield Result(key, record | {"cold": cold}, series, detail)


def failure(
    task: Task,
    label: str,
    key: str,
    reason: str,
    trace: str = "",
    retry_above: float | None = None,
) -> Result:
    """Return the result of a run that has none, with the reason."""
    record = _blank(task, chosen(label)) | {"reason": reason}
    if trace:
        record["traceback"] = trace
    return Result(key, record, retry_above=retry_above)


@contextlib.contextmanager
def _own_surroundings() -> Iterator[None]:
    """Undo what an estimator changes for all that run in its process after it.

    NumPy's treatment of floating-point errors, warning filters and the working directory; not what
    it may do to modules.
    """
    folder = Path.cwd()
    try:
        with np.errstate(), warnings.catch_warnings():
            yield
    finally:
        os.chdir(folder)


def said(error: BaseException) -> str:
    """Return an exception as a record can hold it and a terminal show it: printable, not long."""
    try:
        text = str(error)
    except Exception:
        text = "(its text cannot be made)"
    return _printable(f"{type(error).__name__}: {text}")


def _trace() -> str:
    """Return the traceback of the exception being handled, its end if it is long."""
    try:
        return _printable(traceback.format_exc()[-_LONGEST_TEXT:])
    except Exception:  # as long as the exception's own text is part of it
        return ""


def _printable(text: str) -> str:
    shown = (c if c.isprintable() or c == "\n" else ascii(c)[1:-1] for c in text[:_LONGEST_TEXT])
    return "".join(shown)


def _remarks(estimate: Estimate) -> dict[str, Any]:
    """Return an estimate's remarks as JSON can hold them.

    Raises
    ------
    ValueError
        If they are too long to be stored with every run.
    """
    text = json.dumps(dict(estimate.info), default=float)
    if len(text) > _LONGEST_INFO:
        raise ValueError(f"the estimate's info has {len(text)} characters, over {_LONGEST_INFO}")
    found: dict[str, Any] = json.loads(text)
    return found


def _blank(task: Task, choice: Choice) -> dict[str, Any]:
    """Return what a record says of its run before it is known how it went."""
    return {
        "name": choice.estimator.name,
        "parameters": choice.parameters,
        "causality": choice.estimator.causality,
        "run": task.run,
        "seed": task.seed,
        "status": "failed",
    }


def _judge(
    task: Task, flight: Flight, problem: Problem, truth: Truth, choice: Choice
) -> tuple[dict[str, Any], np.ndarray | None, np.ndarray | None]:
    record = _blank(task, choice)
    model = _CountingModel(problem.model)
    given = Problem(**{**vars(problem), "model": model})
    rng = _estimator_rng(task.seed, task.run, choice)
    try:
        # A new instance each time: what one run leaves in it cannot reach the next.
        estimator = dataclasses.replace(choice.estimator)
        with _own_surroundings():
            start = time.perf_counter()
            estimate = estimator.estimate(given, rng)
            record["seconds"] = time.perf_counter() - start
        estimate = _complete(problem, choice.estimator, estimate)
        record["info"] = _remarks(estimate)
        evaluation = metrics.evaluate(problem, estimate, truth)
    except (Exception, SystemExit) as error:
        record |= {"reason": said(error), "traceback": _trace()}
        return record, None, None
    case = task.case
    # An estimate without aiding is set beside the filtering bound: what aiding could give.
    bound_name = "batch" if estimate.causality == "batch" else "filter"
    if estimate.lag is not None:
        bound_name = f"fixed-lag-{lag_epochs(case, estimate.lag)}"
    ins_error = float(np.linalg.norm(truth.error_state[-1, :3]))
    final_error = float(evaluation.position_error[-1])
    record |= {
        "status": "ok",
        "bound": bound_name,
        "map_evaluations": model.evaluations,
        "peak_memory_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0,
        "final_position_error_m": final_error,
        "final_ins_error_m": ins_error,
        "diverged": metrics.has_diverged(final_error, flight.final_bound, ins_error),
        "windows": metrics.window_figures(evaluation, truth.times, case.windows),
    }
    if case.windows.lock_m is not None:
        record |= convergence.judge(
            evaluation.position_error, evaluation.sigmas[:, :3], truth.times, case.windows.lock_m
        )
    series = np.column_stack(
        [evaluation.position_error, evaluation.velocity_error, evaluation.nees, evaluation.nis]
    )[kept_epochs(len(truth.times))]
    detail = None
    if task.run == DETAILED_RUN:
        detail = np.column_stack([evaluation.components, evaluation.sigmas])
    return record, series, detail


def kept_epochs(epochs: int) -> np.ndarray:
    """Return which of the epochs are kept as a time series: all, or an even choice of many."""
    kept = np.linspace(0, epochs - 1, min(epochs, MOST_KEPT))
    return np.round(kept).astype(int)


def _complete(problem: Problem, estimator: Estimator, estimate: Estimate) -> Estimate:
    """Return the estimate with plain arrays; raise unless it is whole and what was declared.

    Raises
    ------
    TypeError, ValueError
        If it is no Estimate, is of another causality than its estimator declares, has a wrong
        shape, or numbers that are complex, not finite or no covariance.
    """
    if not isinstance(estimate, Estimate):
        raise TypeError(f"estimate() returned {type(estimate).__name__}, not an Estimate")
    lag = vars(estimator)["lag"] if estimator.causality == "fixed-lag" else None
    if (estimate.causality, estimate.lag) != (estimator.causality, lag):
        raise ValueError(
            f"the estimate is '{estimate.causality}' with lag {estimate.lag}, but its estimator "
            f"declares '{estimator.causality}' with lag {lag}"
        )
    epochs, n = problem.epochs, problem.dimension
    mean = _real_array("mean", estimate.mean, (epochs, n))
    cov = None
    if estimate.cov is not None:
        cov = _real_array("cov", estimate.cov, (epochs, n, n))
        judged = cov[:, : metrics.JUDGED, : metrics.JUDGED]
        sigma = np.sqrt(np.maximum(np.diagonal(judged, axis1=1, axis2=2), 0.0))
        positive = (sigma > 0.0).all(axis=1)
        scale = np.where(sigma > 0.0, sigma, 1.0)
        correlation = judged / (scale[:, :, None] * scale[:, None, :])
        positive &= np.linalg.eigvalsh(correlation)[:, 0] > 0.0
        if not positive.all():
            raise ValueError(
                f"the estimate's cov is not positive definite at epoch {positive.argmin()}"
            )
    return Estimate(mean, cov, estimate.causality, estimate.lag, estimate.info)


def _real_array(name: str, array: Any, shape: tuple[int, ...]) -> np.ndarray:
    """Return an array of floats of this shape, all finite."""
    if np.shape(array) != shape:
        raise ValueError(f"the estimate's {name} has shape {np.shape(array)}, not {shape}")
    if np.iscomplexobj(array):
        raise ValueError(f"the estimate's {name} is complex")
    numbers = np.asarray(array, dtype=float)
    finite = np.isfinite(numbers).reshape(len(numbers), -1).all(axis=1)
    if not finite.all():
        raise ValueError(f"the estimate's {name} is not finite from epoch {finite.argmin()} on")
    return numbers


def lag_epochs(case: CaseSpec, lag: float) -> int:
    """Return how many epochs after each one a fixed lag [s] sees."""
    return math.floor(lag / case.gradiometer.period_s + 1e-9)


def shared_arrays(flight: Flight, seed: int, lags: Sequence[int]) -> dict[str, np.ndarray]:
    """Return what all runs of a case share: bounds, and the signals that figures show.

    Parameters
    ----------
    flight : the case. seed : the campaign's. lags : fixed lags in use [epochs].
    """
    arrays = {
        "times": flight.times,
        "kept": kept_epochs(len(flight.times)),
        "track": flight.trajectory.positions[flight.epochs],
    }
    bounds = {name: metrics.bound_for(flight.bound, name, None) for name in ("filter", "batch")}
    for lag in lags:
        bounds[f"fixed-lag-{lag}"] = metrics.bound_for(flight.bound, "fixed-lag", lag)
    for name, cov in bounds.items():
        arrays[f"bound-{name}"] = np.stack(metrics.squared_bounds(cov), axis=-1)
    # Γ_UU with the noise that the detailed run has in zz, before and behind the filter.
    rng = random_streams(seed, DETAILED_RUN).gradiometer
    vertical = COMPONENTS.index("zz")
    enu = flight.field.tensor(*arrays["track"].T)
    noise = flight.true.gradiometer.noise_eotvos * rng.standard_normal(flight.noise_free.shape)
    arrays["vertical"] = enu[:, vertical]
    arrays["noisy"] = arrays["vertical"] + noise[:, vertical]
    if flight.true.gradiometer.lowpass is not None:
        arrays["filtered"] = flight.true.gradiometer.lowpass.apply(arrays["noisy"])
        arrays["filtered_true"] = flight.true.gradiometer.lowpass.apply(arrays["vertical"])
    if flight.field.has_map:
        arrays |= _map_signals(flight.field, float(np.mean(arrays["track"][:, 2])))
    return arrays


@lru_cache(maxsize=8)
def _map_signals(field: Field, height: float) -> dict[str, np.ndarray]:
    """Return the disturbing vertical gradient over the whole map, at a height [m]."""
    latitude = np.linspace(field.origin[0], field.upper[0], 101)
    longitude = np.linspace(field.origin[1], field.upper[1], 161)
    full = field.tensor(latitude[:, None], longitude[None, :], height)
    normal = Field.normal().tensor(latitude[:, None], longitude[None, :], height)
    vertical = COMPONENTS.index("zz")
    return {
        "map_latitude": latitude,
        "map_longitude": longitude,
        "map_vertical": full[..., vertical] - normal[..., vertical],
    }
