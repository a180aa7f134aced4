"""Flights, bounds and simulated blocks of runs, cached in each process."""

from __future__ import annotations

import contextlib
import gc
import itertools
from collections.abc import Iterator, Sequence
from functools import lru_cache

import numpy as np

from ..block import ProblemBlock
from ..engines.whitened_measurements import residuals_along
from ..judging import run_errors
from ..judging.references import CaseBound, oracle_means
from ..judging.situations import is_right_model
from ..problem import Problem
from ..results.store import DETAILED_RUN
from ..simulation.error_free_flight import Flight, prepare
from ..simulation.flight_bounds import bounds
from ..simulation.input_versions import Versions, input_versions
from ..simulation.runs import simulate, simulate_block, simulate_flights
from ..spec.case import CaseSpec
from .truth_isolation import HiddenArray

BLOCK_RUNS = 32
"""Most runs of a block, so that the arrays fit into the processor's cache."""
BLOCK_BYTES = 2**29
"""Largest size of a block's matrices Φ, Q and P; long flights have blocks of fewer runs."""
LEAST_RUNS = 8
"""Least runs of a block: the number that kernels process together."""


def flight_of(case: CaseSpec) -> Flight:
    """Return the flight of a case, cached.

    If the runs have different flights, this is the flight of run 0.
    """
    of_run = case.of_run(0)
    return _flight(of_run, input_versions(of_run))


@lru_cache(maxsize=64)
def _flight(case: CaseSpec, versions: Versions) -> Flight:
    return prepare(case)


def first_problem(case: CaseSpec, seed: int) -> Problem:
    """Return the problem of run 0 of a case, cached."""
    return _first_problem(case, seed, input_versions(case))


@lru_cache(maxsize=BLOCK_RUNS)
def _first_problem(case: CaseSpec, seed: int, versions: Versions) -> Problem:
    return simulate(flight_of(case), seed, DETAILED_RUN)[0]


_bounds: dict[tuple[CaseSpec, Versions], CaseBound] = {}


def case_bounds(cases: Sequence[CaseSpec]) -> list[CaseBound]:
    """Return the bound of each case; all runs of a case must share one flight.

    The latest bounds are cached.
    """
    keys = [(case, input_versions(case)) for case in cases]
    unknown = [key for key in dict.fromkeys(keys) if key not in _bounds]
    if unknown:
        flights = [flight_of(case) for case, _ in unknown]
        new_bounds = zip(flights, bounds(flights), strict=True)
        _bounds.update(zip(unknown, itertools.starmap(CaseBound, new_bounds), strict=True))
    requested = [_bounds[key] for key in keys]
    for key in [*_bounds][: max(len(_bounds) - BLOCK_RUNS, 0)]:
        del _bounds[key]
    return requested


_flown: set[CaseSpec] = set()


def fly_unseen(case: CaseSpec) -> None:
    """Create and cache the flight of a case, and exclude it from garbage collection.

    An estimator can then not find the objects of the flight through the garbage collector. The
    function is intended for workers: all other objects that exist at the time of the call, mainly
    modules, are excluded as well.
    """
    if case not in _flown:
        _flown.add(case)
        with contextlib.suppress(Exception):  # which run_task meets again, and records
            flight_of(case)
        gc.collect()
        gc.freeze()


def forget_flights() -> None:
    """Drop the flights, problems and bounds that this process has cached, to free memory."""
    _flight.cache_clear()
    _first_problem.cache_clear()
    _bounds.clear()


def runs_at_once(case: CaseSpec) -> int:
    """Return the number of runs per block for a case.

    It is :data:`BLOCK_RUNS`, or less if the matrices Φ, Q and P of a block would exceed
    :data:`BLOCK_BYTES`. It is at least :data:`LEAST_RUNS`.
    """
    size = BLOCK_RUNS
    with contextlib.suppress(Exception):  # a flight that fails says so in every run's record
        flight = flight_of(case)
        matrices = 3 * len(flight.times) * flight.model.dimension**2 * np.dtype(float).itemsize
        while size > LEAST_RUNS and size * matrices > BLOCK_BYTES:
            size //= 2
    return size


def groups_of_runs(case: CaseSpec, runs: Sequence[int]) -> Iterator[Sequence[int]]:
    """Yield groups of run indices; the runs of a group share a map and fit into a block."""
    size = runs_at_once(case)
    shared: dict[int, list[int]] = {}
    for run in runs:
        shared.setdefault(run % case.draw.maps, []).append(run)
    for group in shared.values():
        for start in range(0, len(group), size):
            yield group[start : start + size]


class SimulatedRuns:
    """Runs that were simulated together; the truth is hidden while an estimator runs.

    Attributes
    ----------
    case : case of the runs.
    runs : indices of the R runs.
    block : problems of the runs.
    truth : hidden array (R, K, n) of the true error states.
    """

    def __init__(
        self, case: CaseSpec, runs: Sequence[int], block: ProblemBlock, truth: HiddenArray
    ) -> None:
        self.case, self.runs, self.block, self.truth = case, runs, block, truth
        self._oracle_means: dict[str, np.ndarray] = {}

    def flights(self, part: slice) -> Iterator[tuple[slice, Flight, CaseBound]]:
        """Yield (slice, flight, bound) for each group of runs in ``part`` with the same flight.

        If the runs have different tracks, survey lines or map errors, each run is a group.
        """
        pieces = [slice(r, r + 1) for r in range(part.start, part.stop)]
        for some in pieces if self.case.drawn else [part]:
            case = self.case.of_run(self.runs[some.start])
            (bound,) = case_bounds([case])
            yield some, flight_of(case), bound

    def oracle_means(self, name: str, error_state: np.ndarray) -> np.ndarray:
        """Return the mean squared errors (R, W, 2) of the oracle.

        The oracle is a filter or smoother linearised at the truth (:func:`.oracle_means`). The
        errors are NaN if the assumed model differs from the true one. W is the number of windows.
        The last axis is position [m²] and velocity [m²/s²].

        All estimators that are compared with the same bound share the result, so it is cached. The
        result does not reveal the truth.

        Parameters
        ----------
        name : name of the bound.
        error_state : (R, K, n) true error states.
        """
        if name not in self._oracle_means:
            self._oracle_means[name] = self._computed_oracle_means(name, error_state)
        return self._oracle_means[name]

    def _computed_oracle_means(self, name: str, error_state: np.ndarray) -> np.ndarray:
        if not is_right_model(self.case):
            return np.full((len(self.runs), len(run_errors.WINDOWS), 2), np.nan)
        # Computed again for each bound: kept residuals would lead an estimator to the truth.
        residuals = residuals_along(self.block, error_state)
        means = [
            oracle_means(
                name,
                flight,
                bound,
                residuals=residuals[some],
                error_state=error_state[some],
                transition=self.block.transition[some],
            )
            for some, flight, bound in self.flights(slice(0, len(self.runs)))
        ]
        return np.concatenate(means)


def simulated(case: CaseSpec, seed: int, runs: Sequence[int]) -> SimulatedRuns:
    """Simulate runs, and hide the truth before any estimator receives the problems."""
    if not case.drawn:
        block, truth = simulate_block(flight_of(case), seed, runs)
        return SimulatedRuns(case, runs, block, HiddenArray(truth.error_state))
    cases = [case.of_run(run) for run in runs]
    for of_run in cases:
        fly_unseen(of_run)
    case_bounds(cases)
    block, truth = simulate_flights([flight_of(of_run) for of_run in cases], seed, runs)
    return SimulatedRuns(case, runs, block, HiddenArray(truth.error_state))
