"""Runs: simulate them, give them to every estimator, judge the estimates.

This is what a worker process does; nothing here writes anything. Estimators that take many runs at
once get them in blocks that fit into the processor's cache, the others run by run.
"""

from __future__ import annotations

import contextlib
import copy
import dataclasses
import gc
import hashlib
import json
import os
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from ..block import DrawingEstimator, EstimateBlock, ProblemBlock, takes_blocks
from ..errors import GGBenchError
from ..judging import fixes, run_errors
from ..problem import CountingModel, Estimate, Estimator, MeasurementModel, Problem
from ..results.store import Result
from ..simulation.error_free_flight import Flight, prepare
from ..simulation.runs import simulate, simulate_block
from ..spec.case import CaseSpec
from . import result_keys
from .records import Estimated, blank, judged, remarks
from .registry import Choice, choose
from .texts import said, traced
from .truth_kept import PutAway

BLOCK_RUNS = 32
"""Runs that an estimator takes at once: their arrays stay in the processor's cache."""
BLOCK_BYTES = 2**29
"""Of matrices that a block may have where the flight is so long that its runs would have more."""
LEAST_RUNS = 8
"""Runs that a block has in any case: those that go through the kernels together."""


class OtherSourceError(GGBenchError):
    """What would run here is not what the campaign was planned with."""


Pairs = tuple[tuple[str, str], ...]
"""(label, key) of estimators on a case."""


@dataclass(frozen=True, slots=True)
class Task:
    """Runs of one case with the estimators that still miss them, all of them each.

    Attributes
    ----------
    case : the case. assumption : the study it belongs to, "" for the cases themselves.
    runs, seed : the runs' numbers and the campaign's seed.
    estimators : (label, key) of each estimator to run.
    """

    case: CaseSpec
    assumption: str
    runs: Sequence[int]
    seed: int
    estimators: Pairs


@dataclass(frozen=True)
class Started:
    """Says that an estimator begins with runs."""

    label: str
    runs: Sequence[int]


@lru_cache(maxsize=1024)
def flight_of(case: CaseSpec) -> Flight:
    """Return the flight of a case, made once in each process."""
    return prepare(case)


_flown: set[CaseSpec] = set()


def fly_unseen(case: CaseSpec) -> None:
    """Make the flight of a case, and keep it out of sight of those who list a process's objects.

    For a worker: what is there by then, modules above all, is never collected as garbage.
    """
    if case not in _flown:
        _flown.add(case)
        with contextlib.suppress(Exception):  # which run_task meets again, and records
            flight_of(case)
        gc.collect()
        gc.freeze()


def forget_flights() -> None:
    """Let go of the flights of this process: a library of scenarios has many, and large ones."""
    flight_of.cache_clear()


@lru_cache(maxsize=1024)
def chosen(label: str) -> Choice:
    """Return the estimator of a label, chosen once in each process."""
    return choose(label)


@lru_cache(maxsize=4096)
def _key(case: CaseSpec, label: str, seed: int) -> str:
    return result_keys.run_key(case, chosen(label).content, seed)


def _estimator_rng(seed: int, run: int, choice: Choice) -> np.random.Generator:
    """Return the estimator's own generator: reproducible, and no key to the simulation's."""
    content = choice.content
    name = f"{content['class']}|{json.dumps(content['parameters'], sort_keys=True)}|{seed}|{run}"
    digest = hashlib.sha256(name.encode()).digest()
    return np.random.default_rng(int.from_bytes(digest[:16], "little"))


_warm: set[str] = set()
"""Labels of the estimators that this process has run: their first run compiles and imports."""


def run_task(task: Task) -> Iterator[Started | list[Result]]:
    """Simulate runs and judge every estimator on them; a failure is a record.

    Yields
    ------
    For each estimator ``Started``, then the results of these runs; or, if they cannot be run
    together, ``Started`` again for each of them.

    Raises
    ------
    OtherSourceError
        If the package, a library, an estimator's source or a map file is not what the task's keys
        were made with.
    """
    for label, key in task.estimators:
        if _key(task.case, label, task.seed) != key:
            raise OtherSourceError(
                f"the source or version of ggbench, of a library, of {label} or of a map file "
                f"is not what the campaign was started with; here: {result_keys.environment()}"
            )
    at_once = tuple(pair for pair in task.estimators if takes_blocks(chosen(pair[0]).estimator))
    one_by_one = tuple(pair for pair in task.estimators if pair not in at_once)
    size = runs_at_once(task.case) if at_once else 1
    for start in range(0, len(task.runs) if at_once else 0, size):
        yield from _run_block(task, at_once, task.runs[start : start + size])
    for run in task.runs if one_by_one else ():
        yield from _run_one(task, one_by_one, run)


def runs_at_once(case: CaseSpec) -> int:
    """Return how many runs of a case a block has; Φ, Q and P of all their epochs are its memory."""
    size = BLOCK_RUNS
    with contextlib.suppress(Exception):  # a flight that fails says so in every run's record
        flight = flight_of(case)
        matrices = 3 * len(flight.times) * flight.model.dimension**2 * np.dtype(float).itemsize
        while size > LEAST_RUNS and size * matrices > BLOCK_BYTES:
            size //= 2
    return size


def _run_one(task: Task, pairs: Pairs, run: int) -> Iterator[Started | list[Result]]:
    # Of no frame of these, while an estimator runs, truth or flight are a part.
    reason, trace = "", ""
    try:
        problem, truth = _simulated(task, run)
    except Exception as error:
        reason, trace = f"simulation: {said(error)}", traced()
    for label, key in pairs:
        yield Started(label, (run,))
        choice = chosen(label)
        if reason:
            yield [failure(task, run, label, key, reason, trace)]
            continue
        begun = blank(choice, run, task.seed) | {"cold": _is_cold(label)}
        try:
            estimated = _estimate(problem, choice, _estimator_rng(task.seed, run, choice))
            results = _judged([begun], key, task.case, truth, estimated, lambda _: problem)
        except (Exception, SystemExit) as error:
            results = [Result(key, begun | {"reason": said(error), "traceback": traced()})]
        yield results


def _simulated(task: Task, run: int) -> tuple[Problem, PutAway]:
    """Simulate a run; its truth is put away before any estimator sees the problem."""
    problem, truth = simulate(flight_of(task.case), task.seed, run)
    return problem, PutAway(truth.error_state[np.newaxis])


def _run_block(task: Task, pairs: Pairs, runs: Sequence[int]) -> Iterator[Started | list[Result]]:
    """Run several runs at once; should that fail, one by one, so that it costs no other run."""
    try:
        block, truth = _simulated_block(task, runs)
    except Exception as error:
        reason, trace = f"simulation: {said(error)}", traced()
        for run in runs if len(runs) > 1 else ():
            yield from _run_block(task, pairs, (run,))
        for label, key in pairs if len(runs) == 1 else ():
            yield Started(label, runs)
            yield [failure(task, runs[0], label, key, reason, trace)]
        return
    for label, key in pairs:
        yield Started(label, runs)
        choice = chosen(label)
        cold = {"cold": _is_cold(label)}
        blanks = [blank(choice, run, task.seed) | cold for run in runs]
        try:
            rngs = []
            if isinstance(choice.estimator, DrawingEstimator):
                rngs = [_estimator_rng(task.seed, run, choice) for run in runs]
            estimated = _estimate_block(block, choice, rngs)
            results = _judged(blanks, key, task.case, truth, estimated, block.problem)
        except (Exception, SystemExit) as error:
            if len(runs) > 1:
                for run in runs:
                    yield from _run_block(task, ((label, key),), (run,))
                continue
            results = [Result(key, blanks[0] | {"reason": said(error), "traceback": traced()})]
        yield results


def _simulated_block(task: Task, runs: Sequence[int]) -> tuple[ProblemBlock, PutAway]:
    """Simulate runs; their truth is put away before any estimator sees the problems."""
    block, truth = simulate_block(flight_of(task.case), task.seed, runs)
    return block, PutAway(truth.error_state)


def _judged(
    blanks: Sequence[dict[str, Any]],
    key: str,
    case: CaseSpec,
    truth: PutAway,
    estimated: Estimated,
    problem: Callable[[int], Problem],
) -> list[Result]:
    """Judge estimates (:func:`.records.judged`) beside the truth that was put away."""
    with truth.looked_at() as states:
        return judged(blanks, key, flight_of(case), states, estimated, problem)


def _is_cold(label: str) -> bool:
    """Return whether this is an estimator's first run in this process.

    Its time holds compilation and imports: summaries leave it out.
    """
    cold = label not in _warm
    _warm.add(label)
    return cold


def failure(
    task: Task,
    run: int,
    label: str,
    key: str,
    reason: str,
    trace: str = "",
    retry_above: float | None = None,
) -> Result:
    """Return the result of a run that has none, with the reason."""
    record = blank(chosen(label), run, task.seed) | {"reason": reason}
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


def _estimate(problem: Problem, choice: Choice, rng: np.random.Generator) -> Estimated:
    """Let an estimator estimate one run, and see that it returns what it declares.

    Raises
    ------
    TypeError, ValueError
        If it is no Estimate, is of another causality than its estimator declares, has a wrong
        shape, numbers that are complex, fixes that are none, or remarks that cannot be stored.
    """
    # New instances each time: what one estimator or run leaves in them cannot reach the next.
    given = dataclasses.replace(problem, model=copy.copy(problem.model))
    estimator = dataclasses.replace(choice.estimator)
    before = _evaluations(given.model)
    with _own_surroundings():
        start = time.perf_counter()
        estimate = estimator.estimate(given, rng)
        seconds = time.perf_counter() - start
    counted = _evaluations(given.model) - before
    _require_declared(choice.estimator, estimate, Estimate, "estimate")
    epochs, n = problem.epochs, problem.dimension
    mean = run_errors.real_array("mean", estimate.mean, (epochs, n))
    cov = estimate.cov
    if cov is not None:
        cov = run_errors.real_array("cov", cov, (epochs, n, n))[None]
    nis = estimate.nis
    if nis is not None:
        nis = run_errors.real_array("nis", nis, (epochs,))[None]
    info = remarks(estimate.info)
    # Of one that asks other models than the problem's, what it says itself.
    evaluations = info.get("map_evaluations", counted)
    return Estimated(
        mean[None], cov, nis, estimate.causality, estimate.lag, [info],
        [evaluations if isinstance(evaluations, int) else counted], seconds,
        None if estimate.fixes is None else fixes.checked(estimate.fixes, epochs),
    )  # fmt: skip


def _evaluations(model: MeasurementModel) -> int:
    """Return at how many points a model was evaluated so far, 0 if it does not count them."""
    return model.evaluations if isinstance(model, CountingModel) else 0


def _estimate_block(
    block: ProblemBlock, choice: Choice, rngs: Sequence[np.random.Generator]
) -> Estimated:
    """Let an estimator estimate several runs at once, with a generator for each if it draws.

    Raises
    ------
    TypeError, ValueError
        As :func:`_estimate`, and if its info is not one number of each run.
    """
    estimator = dataclasses.replace(choice.estimator)
    assert takes_blocks(estimator)  # run_task has asked
    with _own_surroundings():
        start = time.perf_counter()
        if isinstance(estimator, DrawingEstimator):
            estimate = estimator.estimate_block(block, rngs)
        else:
            estimate = estimator.estimate_block(block)
        seconds = time.perf_counter() - start
    _require_declared(choice.estimator, estimate, EstimateBlock, "estimate_block")
    runs, epochs, n = block.runs, block.epochs, block.dimension
    mean = run_errors.real_array("mean", estimate.mean, (runs, epochs, n))
    cov, nis = estimate.cov, estimate.nis
    if cov is not None:
        cov = run_errors.real_array("cov", cov, (runs, epochs, n, n))
    if nis is not None:
        nis = run_errors.real_array("nis", nis, (runs, epochs))
    for name, values in estimate.info.items():
        run_errors.require_plain(f"info {name}", values)
    columns = {str(name): np.asarray(values) for name, values in estimate.info.items()}
    for name, values in columns.items():
        if values.shape != (runs,) or values.dtype.kind not in "biuf":
            raise ValueError(f"the estimate's info must have a number of each run as its {name}")
    if "map_evaluations" not in columns:
        raise ValueError("the estimate's info has no map_evaluations")
    evaluations = columns.pop("map_evaluations").astype(int).tolist()
    lists = [values.tolist() for values in columns.values()]
    info = [dict(zip(columns, values, strict=True)) for values in zip(*lists, strict=True)]
    return Estimated(
        mean, cov, nis, estimate.causality, estimate.lag,
        info or [{}] * runs, evaluations, seconds / runs,
    )  # fmt: skip


def _require_declared(
    estimator: Estimator,
    estimate: Any,
    kind: type[Estimate] | type[EstimateBlock],
    method: str,
) -> None:
    """Raise TypeError or ValueError unless an estimate is what its estimator declares."""
    if not isinstance(estimate, kind):
        raise TypeError(f"{method}() returned {type(estimate).__name__}, not an {kind.__name__}")
    lag = vars(estimator)["lag"] if estimator.causality == "fixed-lag" else None
    if (estimate.causality, estimate.lag) != (estimator.causality, lag):
        raise ValueError(
            f"the estimate is '{estimate.causality}' with lag {estimate.lag}, but its estimator "
            f"declares '{estimator.causality}' with lag {lag}"
        )
