"""Execution of runs: simulation, estimation and evaluation.

Worker processes run this module, which writes no files. Estimators that process many runs at once
receive blocks that fit into the processor's cache. Other estimators receive single runs.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
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
from ..problem import CountingModel, Estimate, Estimator, Problem
from ..results.database import Result
from ..simulation.input_versions import Versions, input_versions
from ..spec.case import CaseSpec
from . import result_keys
from .flights import SimulatedRuns, groups_of_runs, simulated
from .records import TimedEstimates, evaluate_runs, new_record, remarks
from .registry import Choice, choose, own_file
from .texts import exception_text, traceback_text

clock = time.perf_counter
"""Clock, imported before an estimator can replace it."""


class OtherSourceError(GGBenchError):
    """A worker has other versions of results, libraries or estimators than the campaign."""


EstimatorKeys = tuple[tuple[str, str], ...]
"""(label, key) of estimators on a case."""


@dataclass(frozen=True, slots=True)
class Task:
    """Runs of one case, and the estimators that must process all of these runs.

    Attributes
    ----------
    case : case of the runs.
    assumption : name of the assumption to which the case belongs; "" for a case of the scenario
        itself.
    runs, seed : indices of the runs, and the seed of the campaign.
    estimators : (label, key) of each estimator to run.
    """

    case: CaseSpec
    assumption: str
    runs: Sequence[int]
    seed: int
    estimators: EstimatorKeys

    @property
    def guests(self) -> frozenset[str]:
        """Paths of users' files among the estimators; their code may change the process."""
        return frozenset(filter(None, (own_file(label) for label, _ in self.estimators)))


@dataclass(frozen=True)
class Started:
    """Message: an estimator starts to process runs."""

    label: str
    runs: Sequence[int]


@lru_cache(maxsize=1024)
def chosen(label: str) -> Choice:
    """Return the estimator of a given label, cached in each process."""
    return choose(label)


@lru_cache(maxsize=4096)
def key_of(case: CaseSpec, label: str, seed: int, versions: Versions) -> str:
    """Return the result key of an estimator on a case, cached in each process.

    ``versions`` are the versions of the input files of the case.
    """
    return result_keys.run_key(case, chosen(label).content, seed)


def estimator_rng(seed: int, run: int, choice: Choice) -> np.random.Generator:
    """Return an estimator's random generator for a run.

    The generator is reproducible, and independent of the random numbers of the simulation.
    """
    content = choice.content
    # The assumed noise does not enter: estimators that differ in it alone draw the same numbers.
    own = {key: value for key, value in content["parameters"].items() if key != "noise_scale"}
    name = f"{content['class']}|{json.dumps(own, sort_keys=True)}|{seed}|{run}"
    digest = hashlib.sha256(name.encode()).digest()
    return np.random.default_rng(int.from_bytes(digest[:16], "little"))


_warm: set[str] = set()
"""Labels of the estimators that this process has run.

The time of a first run includes compilation and imports, so summaries omit it.
"""


def run_task(task: Task) -> Iterator[Started | list[Result]]:
    """Simulate runs, run every estimator on them, and yield messages and results.

    For each estimator and group of runs, :class:`Started` is followed by the results of the group.
    If the runs cannot be processed together, each run is a group. A failed run has a result too.
    Raise OtherSourceError if a version, an estimator's source or a map file has changed since the
    keys of the task were computed.
    """
    versions = input_versions(task.case)
    for label, key in task.estimators:
        if key_of(task.case, label, task.seed, versions) != key:
            raise OtherSourceError(
                f"the version of ggbench or of a library, the source of {label} or a map file "
                f"differs from that of the campaign; this machine has {result_keys.environment()}"
            )
    for runs in groups_of_runs(task.case, task.runs):
        yield from _run_block(task, task.estimators, runs)


def by_block_size(pairs: EstimatorKeys) -> tuple[EstimatorKeys, EstimatorKeys]:
    """Split estimators into block estimators and estimators that process a single run."""
    # Read again, not as this process chose it once: a file may change between campaigns.
    together = tuple(p for p in pairs if isinstance(choose(p[0]).estimator, BlockEstimator))
    return together, tuple(pair for pair in pairs if pair not in together)


def _run_block(
    task: Task, pairs: EstimatorKeys, runs: Sequence[int]
) -> Iterator[Started | list[Result]]:
    """Simulate several runs at once, run the estimators on them, and yield messages and results.

    If the simulation fails, each run is simulated singly, so that an error fails only one run.
    """
    try:
        flown = simulated(task.case, task.seed, runs)
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
            yield from _run_estimator(task, label, key, flown, part)


def _run_estimator(
    task: Task,
    label: str,
    key: str,
    flown: SimulatedRuns,
    part: slice,
) -> Iterator[Started | list[Result]]:
    """Run an estimator on a part of a simulated block; after an error, on each run singly."""
    runs = flown.runs[part]
    yield Started(label, runs)
    choice = chosen(label)
    cold = {"cold": label not in _warm}
    _warm.add(label)
    blanks = [new_record(choice, run, task.seed) | cold for run in runs]
    try:
        rngs = [estimator_rng(task.seed, run, choice) for run in runs]
        estimated = timed_estimates(flown.block, part.start, choice, rngs)
        results = _evaluated(blanks, key, flown, part, estimated)
    except (Exception, SystemExit) as error:
        if len(runs) > 1:
            for run in runs:
                yield from _run_block(task, ((label, key),), (run,))
            return
        record = blanks[0] | {"reason": exception_text(error), "traceback": traceback_text()}
        results = [Result(key, record)]
    yield results


def _evaluated(
    blanks: Sequence[dict[str, Any]],
    key: str,
    flown: SimulatedRuns,
    part: slice,
    estimated: TimedEstimates,
) -> list[Result]:
    """Evaluate the estimates of some runs of a block (:func:`.records.evaluate_runs`)."""
    results = []
    with flown.truth.looked_at() as truth:
        for some, flight, bound in flown.flights(part):
            own = slice(some.start - part.start, some.stop - part.start)
            results += evaluate_runs(
                blanks[own],
                key,
                flight=flight,
                error_state=truth[some],
                estimated=estimated.of_runs(own),
                bound=bound,
                oracle=partial(_oracle_means, flown, some, truth),
                problem_of=partial(_problem, flown, some),
            )
    return results


def _oracle_means(
    flown: SimulatedRuns, some: slice, error_state: np.ndarray, name: str
) -> np.ndarray:
    return flown.oracle_means(name, error_state)[some]


def _problem(flown: SimulatedRuns, some: slice, r: int) -> Problem:
    return flown.block.problem(some.start + r)


def failure(
    task: Task,
    run: int,
    label: str,
    key: str,
    reason: str,
    trace: str = "",
    retry_above: float | None = None,
) -> Result:
    """Return the result of a failed run, with the reason of the failure.

    ``trace`` is a traceback, or "" if there is none. If ``retry_above`` [s] is given, a campaign
    with a time limit above this value repeats the run. If it is None, the run is repeated only on
    request.
    """
    record = new_record(chosen(label), run, task.seed) | {"reason": reason}
    if trace:
        record["traceback"] = trace
    return Result(key, record, retry_above=retry_above)


def timed_estimates(
    block: ProblemBlock,
    run: int,
    choice: Choice,
    rngs: Sequence[np.random.Generator],
) -> TimedEstimates:
    """Run an estimator on a block or a single run, measure the time, validate the estimates.

    An estimator without blocks processes only row ``run`` of the block.

    Raise TypeError or ValueError if the result is no estimate, or has another causality or lag than
    the estimator declares. The same errors are raised for a wrong shape, complex numbers, or an
    ``info`` that cannot be stored.
    """
    # A new instance each time: what one run leaves in it cannot reach the next.
    estimator = dataclasses.replace(choice.estimator)
    leading: tuple[int, ...] = ()
    if isinstance(estimator, BlockEstimator):
        estimated, seconds = _timed(partial(estimation.estimate_block, estimator, block, rngs))
        _require_declared(estimator, estimated, EstimateBlock, "estimate_block")
        leading = (block.runs,)
        info, evaluations = _columns(estimated.info, block.runs)
        fixes = None
    else:
        problem = block.problem(run)
        estimated, seconds = _timed(partial(estimation.estimate, estimator, problem, rngs[0]))
        _require_declared(estimator, estimated, Estimate, "estimate")
        info = [remarks(estimated.info)]
        # An estimator that evaluates other models than the problem's counts for itself.
        counted = problem.model.evaluations if isinstance(problem.model, CountingModel) else 0
        own = info[0].get("map_evaluations", counted)
        evaluations = [own if isinstance(own, int) else counted]
        fixes = estimated.fixes
    count, epochs, n = len(rngs), block.epochs, block.dimension
    mean = run_errors.real_array("mean", estimated.mean, (*leading, epochs, n))
    cov, nis = estimated.cov, estimated.nis
    if cov is not None:
        cov = run_errors.real_array("cov", cov, (*leading, epochs, n, n))
        cov = cov.reshape(count, epochs, n, n)
    if nis is not None:
        nis = run_errors.real_array("nis", nis, (*leading, epochs)).reshape(count, epochs)
    return TimedEstimates(
        mean=mean.reshape(count, epochs, n),
        cov=cov,
        nis=nis,
        causality=estimated.causality,
        lag=estimated.lag,
        info=info,
        evaluations=evaluations,
        seconds=seconds / count,
        fixes=None if fixes is None else fix_metrics.checked(fixes, epochs),
    )


def _duration(seconds: Any) -> float:
    """Return a valid duration [s] unchanged, and NaN for any other value."""
    is_valid = isinstance(seconds, float) and 0.0 <= seconds < math.inf
    return seconds if is_valid else math.nan


def _timed(work: Callable[[], Any]) -> tuple[Any, float]:
    """Return the result of an estimator's call, and its duration [s].

    Changes of NumPy's handling of floating-point errors, of warning filters and of the working
    directory are undone. Changes of modules are not.
    """
    folder = Path.cwd()
    try:
        with np.errstate(), warnings.catch_warnings():
            start = clock()
            result = work()
            return result, _duration(clock() - start)
    finally:
        os.chdir(folder)


def _columns(info: Mapping[str, Any], runs: int) -> tuple[list[dict[str, Any]], list[int]]:
    """Return the remarks and the number of map evaluations of each run of a block.

    Raise ValueError if an entry of ``info`` is not one number or text for each run, or if
    ``map_evaluations`` is missing.
    """
    for name, values in info.items():
        run_errors.require_plain(f"info {name}", values)
    columns = {str(name): np.asarray(values) for name, values in info.items()}
    for name, values in columns.items():
        if values.shape != (runs,) or values.dtype.kind not in "biufU":
            raise ValueError(
                f"the entry {name} of the estimate's info must be a number or a text for each run"
            )
    if "map_evaluations" not in columns:
        raise ValueError("the estimate's info has no map_evaluations")
    evaluations = columns.pop("map_evaluations").astype(int).tolist()
    lists = [values.tolist() for values in columns.values()]
    rows = [dict(zip(columns, values, strict=True)) for values in zip(*lists, strict=True)]
    return rows or [{}] * runs, evaluations


def _require_declared(
    estimator: Estimator,
    estimate: Any,
    kind: type[Estimate] | type[EstimateBlock],
    method: str,
) -> None:
    """Raise TypeError or ValueError unless an estimate has the declared type, causality and lag."""
    if not isinstance(estimate, kind):
        raise TypeError(f"{method}() must return {kind.__name__}, not {type(estimate).__name__}")
    lag = vars(estimator)["lag"] if estimator.causality == "fixed-lag" else None
    if (estimate.causality, estimate.lag) != (estimator.causality, lag):
        raise ValueError(
            f"the estimate is '{estimate.causality}' with lag {estimate.lag}, but the estimator "
            f"declares '{estimator.causality}' with lag {lag}"
        )
