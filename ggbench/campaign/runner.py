"""Runs: simulate them, give them to every estimator, judge the estimates.

This is what a worker process does; nothing here writes anything. Estimators that take many runs at
once get them in blocks that fit into the processor's cache, the others in blocks of one run.
"""

from __future__ import annotations

import contextlib
import copy
import dataclasses
import gc
import hashlib
import itertools
import json
import os
import time
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from .. import estimation
from ..block import BlockEstimator, EstimateBlock, ProblemBlock
from ..errors import GGBenchError
from ..judging import fix_metrics, run_errors
from ..judging.references import CaseBound
from ..problem import CountingModel, Estimate, Estimator, Problem
from ..results.store import DETAILED_RUN, Result
from ..simulation.error_free_flight import Flight, prepare
from ..simulation.flight_bounds import bounds
from ..simulation.runs import simulate, simulate_block, simulate_flights
from ..spec.case import CaseSpec
from . import result_keys
from .records import TimedEstimates, evaluate_runs, new_record, remarks
from .registry import Choice, choose
from .texts import exception_text, traceback_text
from .truth_isolation import HiddenArray

BLOCK_RUNS = 32
"""Runs that an estimator takes at once: their arrays stay in the processor's cache."""
BLOCK_BYTES = 2**29
"""Of matrices that a block may have where the flight is so long that its runs would have more."""
LEAST_RUNS = 8
"""Runs that a block has in any case: those that go through the kernels together."""


class OtherSourceError(GGBenchError):
    """The worker's versions of results, libraries or estimators differ from the campaign's."""


Pairs = tuple[tuple[str, str], ...]
"""(label, key) of estimators on a case."""


@dataclass(frozen=True, slots=True)
class Task:
    """Runs of one case with the estimators that still miss them, all of them each.

    Attributes
    ----------
    case : the case.
    assumption : the study it belongs to, "" for the cases themselves.
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


def flight_of(case: CaseSpec) -> Flight:
    """Return the flight of a case, made once in each process; of one with draws, of run 0."""
    return _flight(case.of_run(0))


@lru_cache(maxsize=64)
def _flight(case: CaseSpec) -> Flight:
    return prepare(case)


@lru_cache(maxsize=BLOCK_RUNS)
def first_problem(case: CaseSpec, seed: int) -> Problem:
    """Return the problem of a case's first run, made once for all that ask what it is like."""
    return simulate(flight_of(case), seed, DETAILED_RUN)[0]


_bounds: dict[CaseSpec, CaseBound] = {}


def case_bounds(cases: Sequence[CaseSpec]) -> list[CaseBound]:
    """Return the bounds of cases without draws, together; kept of the latest in each process."""
    unknown = [case for case in dict.fromkeys(cases) if case not in _bounds]
    if unknown:
        flights = [flight_of(case) for case in unknown]
        found = zip(flights, bounds(flights), strict=True)
        _bounds.update(zip(unknown, itertools.starmap(CaseBound, found), strict=True))
    wanted = [_bounds[case] for case in cases]
    for case in [*_bounds][: max(len(_bounds) - BLOCK_RUNS, 0)]:
        del _bounds[case]
    return wanted


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
    _flight.cache_clear()
    first_problem.cache_clear()
    _bounds.clear()


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
    # The assumed noise does not enter: estimators that differ in it alone draw the same numbers.
    own = {key: value for key, value in content["parameters"].items() if key != "noise_scale"}
    name = f"{content['class']}|{json.dumps(own, sort_keys=True)}|{seed}|{run}"
    digest = hashlib.sha256(name.encode()).digest()
    return np.random.default_rng(int.from_bytes(digest[:16], "little"))


_warm: set[str] = set()
"""Labels of the estimators that this process has run.

The time of a first run holds compilation and imports: summaries leave it out.
"""


def run_task(task: Task) -> Iterator[Started | list[Result]]:
    """Simulate runs and judge every estimator on them; a failure is a record.

    Yield for each estimator ``Started``, then the results of these runs; or, if they cannot be run
    together, ``Started`` again for each of them. Raise OtherSourceError if a version, an
    estimator's source or a map file is not what the task's keys were made with.
    """
    for label, key in task.estimators:
        if _key(task.case, label, task.seed) != key:
            raise OtherSourceError(
                f"the version of ggbench or of a library, the source of {label} or a map file "
                f"is not what the campaign was started with; here: {result_keys.environment()}"
            )
    for runs in _blocks(task, runs_at_once(task.case)):
        yield from _run_block(task, task.estimators, runs)


def _blocks(task: Task, size: int) -> Iterator[Sequence[int]]:
    """Yield runs of a task that share their map, so many at most."""
    shared: dict[int, list[int]] = {}
    for run in task.runs:
        shared.setdefault(run % task.case.draw.maps, []).append(run)
    for runs in shared.values():
        for start in range(0, len(runs), size):
            yield runs[start : start + size]


def by_block_size(pairs: Pairs) -> tuple[Pairs, Pairs]:
    """Return those of the estimators that take many runs at once, and those that take one."""
    # Read again, not as this process chose it once: a file may change between campaigns.
    together = tuple(p for p in pairs if isinstance(choose(p[0]).estimator, BlockEstimator))
    return together, tuple(pair for pair in pairs if pair not in together)


def runs_at_once(case: CaseSpec) -> int:
    """Return how many runs of a case a block has; Φ, Q and P of all their epochs are its memory."""
    size = BLOCK_RUNS
    with contextlib.suppress(Exception):  # a flight that fails says so in every run's record
        flight = flight_of(case)
        matrices = 3 * len(flight.times) * flight.model.dimension**2 * np.dtype(float).itemsize
        while size > LEAST_RUNS and size * matrices > BLOCK_BYTES:
            size //= 2
    return size


def _run_block(task: Task, pairs: Pairs, runs: Sequence[int]) -> Iterator[Started | list[Result]]:
    """Simulate several runs at once; should that fail, one by one: it costs no other run."""
    try:
        block, truth = _simulated_block(task, runs)
    except Exception as error:
        reason, trace = f"simulation: {exception_text(error)}", traceback_text()
        for run in runs if len(runs) > 1 else ():
            yield from _run_block(task, pairs, (run,))
        for label, key in pairs if len(runs) == 1 else ():
            yield Started(label, runs)
            yield [failure(task, runs[0], label, key, reason, trace)]
        return
    for label, key in pairs:
        at_once = isinstance(chosen(label).estimator, BlockEstimator)
        size = len(runs) if at_once else 1
        for start in range(0, len(runs), size):
            part = slice(start, start + size)
            yield from _run_estimator(task, label, key, runs[part], block, truth, part)


def _run_estimator(
    task: Task,
    label: str,
    key: str,
    runs: Sequence[int],
    block: ProblemBlock,
    truth: HiddenArray,
    part: slice,
) -> Iterator[Started | list[Result]]:
    """Let an estimator run ``runs``, a part of a simulated block; should that fail, one by one."""
    yield Started(label, runs)
    choice = chosen(label)
    cold = {"cold": label not in _warm}
    _warm.add(label)
    blanks = [new_record(choice, run, task.seed) | cold for run in runs]
    problems = [block.problem(r) for r in range(part.start, part.stop)]
    try:
        rngs = [_estimator_rng(task.seed, run, choice) for run in runs]
        estimated = _estimate(block, problems, choice, rngs)
        results = _evaluated(blanks, key, task.case, truth, part, estimated, problems)
    except (Exception, SystemExit) as error:
        if len(runs) > 1:
            for run in runs:
                yield from _run_block(task, ((label, key),), (run,))
            return
        record = blanks[0] | {"reason": exception_text(error), "traceback": traceback_text()}
        results = [Result(key, record)]
    yield results


def _simulated_block(task: Task, runs: Sequence[int]) -> tuple[ProblemBlock, HiddenArray]:
    """Simulate runs; their truth is put away before any estimator sees the problems."""
    if not task.case.drawn:
        block, truth = simulate_block(flight_of(task.case), task.seed, runs)
        return block, HiddenArray(truth.error_state)
    cases = [task.case.of_run(run) for run in runs]
    for case in cases:
        fly_unseen(case)
    case_bounds(cases)
    block, truth = simulate_flights([flight_of(case) for case in cases], task.seed, runs)
    return block, HiddenArray(truth.error_state)


def _evaluated(
    blanks: Sequence[dict[str, Any]],
    key: str,
    case: CaseSpec,
    truth: HiddenArray,
    part: slice,
    estimated: TimedEstimates,
    problems: Sequence[Problem],
) -> list[Result]:
    """Judge estimates (:func:`.records.evaluate_runs`) of a part of the runs that truth is of."""
    count = len(problems)
    alike = [slice(r, r + 1) for r in range(count)] if case.drawn else [slice(0, count)]
    results = []
    with truth.looked_at() as whole:
        for some in alike:
            of_runs, states = case.of_run(blanks[some.start]["run"]), whole[part][some]
            flight = flight_of(of_runs)
            (bound,) = case_bounds([of_runs])
            results += evaluate_runs(
                blanks[some], key, flight, states, estimated.of_runs(some), bound, problems[some]
            )
    return results


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
    record = new_record(chosen(label), run, task.seed) | {"reason": reason}
    if trace:
        record["traceback"] = trace
    return Result(key, record, retry_above=retry_above)


def _estimate(
    block: ProblemBlock,
    problems: Sequence[Problem],
    choice: Choice,
    rngs: Sequence[np.random.Generator],
) -> TimedEstimates:
    """Let an estimator estimate a block, or one of its problems, and see that it keeps its word.

    Raise TypeError or ValueError if it is no estimate, is of another causality than its estimator
    declares, has a wrong shape, complex numbers, or remarks that cannot be stored.
    """
    # A new instance each time: what one run leaves in it cannot reach the next.
    estimator = dataclasses.replace(choice.estimator)
    leading: tuple[int, ...] = ()
    if isinstance(estimator, BlockEstimator):
        found, seconds = _timed(partial(estimation.estimate_block, estimator, block, rngs))
        _require_declared(estimator, found, EstimateBlock, "estimate_block")
        leading = (block.runs,)
        info, evaluations = _columns(found.info, block.runs)
        fixes = None
    else:
        problem = dataclasses.replace(problems[0], model=copy.copy(problems[0].model))
        found, seconds = _timed(partial(estimation.estimate, estimator, problem, rngs[0]))
        _require_declared(estimator, found, Estimate, "estimate")
        info = [remarks(found.info)]
        # An estimator that evaluates other models than the problem's counts for itself.
        counted = problem.model.evaluations if isinstance(problem.model, CountingModel) else 0
        own = info[0].get("map_evaluations", counted)
        evaluations = [own if isinstance(own, int) else counted]
        fixes = found.fixes
    count, epochs, n = len(problems), block.epochs, block.dimension
    mean = run_errors.real_array("mean", found.mean, (*leading, epochs, n))
    cov, nis = found.cov, found.nis
    if cov is not None:
        cov = run_errors.real_array("cov", cov, (*leading, epochs, n, n))
        cov = cov.reshape(count, epochs, n, n)
    if nis is not None:
        nis = run_errors.real_array("nis", nis, (*leading, epochs)).reshape(count, epochs)
    return TimedEstimates(
        mean.reshape(count, epochs, n), cov, nis, found.causality, found.lag,
        info, evaluations, seconds / count,
        None if fixes is None else fix_metrics.checked(fixes, epochs),
    )  # fmt: skip


def _timed(work: Callable[[], Any]) -> tuple[Any, float]:
    """Return what an estimator returns, and how long it took [s].

    What it changes for all that run in its process after it is undone: NumPy's treatment of
    floating-point errors, warning filters and the working directory; not what it may do to modules.
    """
    folder = Path.cwd()
    try:
        with np.errstate(), warnings.catch_warnings():
            start = time.perf_counter()
            found = work()
            return found, time.perf_counter() - start
    finally:
        os.chdir(folder)


def _columns(info: Mapping[str, Any], runs: int) -> tuple[list[dict[str, Any]], list[int]]:
    """Return the remarks of each run of a block, and its evaluations of the map.

    Raise ValueError if the info is not one number of each run, or has no map_evaluations.
    """
    for name, values in info.items():
        run_errors.require_plain(f"info {name}", values)
    columns = {str(name): np.asarray(values) for name, values in info.items()}
    for name, values in columns.items():
        if values.shape != (runs,) or values.dtype.kind not in "biuf":
            raise ValueError(f"the estimate's info must have a number of each run as its {name}")
    if "map_evaluations" not in columns:
        raise ValueError("the estimate's info has no map_evaluations")
    evaluations = columns.pop("map_evaluations").astype(int).tolist()
    lists = [values.tolist() for values in columns.values()]
    found = [dict(zip(columns, values, strict=True)) for values in zip(*lists, strict=True)]
    return found or [{}] * runs, evaluations


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
