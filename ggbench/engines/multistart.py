"""The most probable trajectory from many starts: where searches of whole flights are begun.

The searches of all runs of a block go on at once (:mod:`.line_search`).
"""

from __future__ import annotations

import numpy as np
from scipy.special import ndtri

from ..block import EstimateBlock, ProblemBlock
from ..numerics import lanes
from ..numerics.records import fields_of
from ..problem import Problem
from .line_search import Searches, answer, filtered_tracks, screen, search, undisturbed
from .linear_problems import Problems
from .position_grid import states_in_metres
from .robust_weights import number_of
from .whitened_measurements import batch_of
from .window_search import ITERATIONS, Search, best_apart, section

_SCREENED = 50
"""Number of epochs at which the cost of a start is looked at."""
_MOST_POINTS = 50_000
"""Points of the grid on which the first window is searched."""
NO_RIVAL = 50.0
"""Log odds against a place by which it needs no search of the whole flight."""


def across_prior(problem: Problem, count: int) -> np.ndarray:
    """Return λ (S, n) of positions across the prior, the prior's mean first; there may be but that.

    In units of the prior's deviations. They are a Halton sequence in the normal distribution whose
    density is that of the prior to the power d / (d + 2): with it d-dimensional points leave the
    smallest mean square distance to the nearest one (Zador 1982).
    """
    axes = states_in_metres(problem)
    if count == 1 or not axes:
        return np.zeros((1, problem.dimension))
    from scipy.stats import qmc  # not at the top: it loads slowly

    scale = np.sqrt(np.diag(problem.prior_cov))[axes]
    uniform = qmc.Halton(len(axes), scramble=False).random(count)[1:]  # the first is zero
    normal = np.sqrt(1.0 + 2.0 / len(axes)) * ndtri(uniform)
    starts = np.zeros((count, problem.dimension))
    root = np.linalg.cholesky(problem.prior_cov[np.ix_(axes, axes)] / np.outer(scale, scale))
    starts[1:, axes] = np.linalg.solve(root.T, normal.T).T
    return starts


def shown_epochs(epochs: int) -> np.ndarray:
    """Return the epochs at which the cost of a start is looked at."""
    return np.linspace(0, epochs - 1, min(epochs, _SCREENED)).astype(int)


def window_search(problem: Problem, count: int, spacing_m: float, loss: str) -> Search | None:
    """Return the search of the window of the first readings, all taken; None if nothing is found.

    That is where there is no reading, or no position, or one point of the grid.
    """
    read = np.flatnonzero(problem.present.any(axis=1))[:count]
    if not len(read) or not states_in_metres(problem):
        return None
    window = section(problem, 0, read[-1] + 1, problem.prior_mean, problem.prior_cov)
    search = Search(window, spacing_m, _MOST_POINTS, "msd" if loss == "none" else "mad")
    if len(search.points) < 2:
        return None
    search.take(window.epochs)
    return search


def multistart(
    block: ProblemBlock,
    count: int,
    keep: int,
    window: int,
    spacing_m: float,
    most: int,
    loss: str,
    threshold: float,
) -> EstimateBlock:
    """Find the most probable trajectory of every run; its mean is NaN where no start has a cost.

    Parameters
    ----------
    block : the runs.
    count, keep : of the positions across the prior, and of those refined.
    window, spacing_m : of :func:`window_search`; 0 epochs for none.
    most : limit of the steps from each start.
    loss, threshold : on each whitened component of a reading, see :mod:`.robust_weights`.
    """
    smoother = _Smoother(block, loss, threshold)
    # Kind by kind, so that those that go through the lanes together need about as many steps.
    parts = [smoother.best_starts(count, keep), smoother.from_filter()]
    if window:
        parts.append(smoother.from_windows(window, spacing_m, keep))
    searches = Searches(*map(np.concatenate, zip(*map(fields_of, parts), strict=True)))
    smoother.search(searches, most)
    best = np.empty(block.runs, dtype=int)
    for run in range(block.runs):
        own = np.flatnonzero(searches.runs == run)
        costs = searches.cost[own]
        best[run] = own[np.argmin(np.where(np.isfinite(costs), costs, np.inf))]
    minima = _chosen(searches, best)
    mean, cov = smoother.answers(minima)
    mean[~np.isfinite(minima.cost)] = np.nan
    info = {
        "cost": minima.cost,
        "iterations": np.bincount(searches.runs, searches.iterations).astype(int),
        "converged": minima.converged,
        "refined": np.bincount(searches.runs),
        "map_evaluations": smoother.evaluations,
    }
    return EstimateBlock(mean, cov, "batch", info=info)


def _chosen(searches: Searches, which: np.ndarray) -> Searches:
    """Return some of the searches."""
    return Searches(*(array[which] for array in fields_of(searches)))


class _Smoother:
    """Searches of the problems of a block, and where they are begun.

    Attributes
    ----------
    evaluations : (R,) how often h was evaluated so far.
    """

    def __init__(self, block: ProblemBlock, loss: str, threshold: float) -> None:
        self.block, self.loss, self.threshold = block, loss, threshold
        self.runs = np.arange(block.runs)
        self.scale = np.sqrt(np.diag(block.prior_cov))
        self.evaluations = np.zeros(block.runs, dtype=int)
        self._arrays = Problems(batch_of(block), number_of(loss, threshold), threshold)

    def best_starts(self, count: int, keep: int) -> Searches:
        """Return undisturbed motions of lowest costs from positions across the prior."""
        block, first = self.block, self.block.problem(0)
        starts = across_prior(first, count) / self.scale
        if len(starts) == 1:
            return self._from_prior(self.runs, np.tile(starts, (block.runs, 1)))
        costs = self._screened(starts, states_in_metres(first))
        best = np.argsort(costs, axis=1, kind="stable")[:, :keep].T
        return self._from_prior(np.tile(self.runs, len(best)), starts[best.ravel()])

    def _screened(self, starts: np.ndarray, axes: list[int]) -> np.ndarray:
        """Return costs (R, S) of starts (S, n) of states ``axes``, from a part of the epochs."""
        block, count = self.block, len(starts)
        shown = shown_epochs(block.epochs)
        there = np.isin(np.arange(block.epochs), shown)
        places = lanes.lanes(len(axes), len(lanes.starts(count)))
        places.reshape(len(axes), -1)[:, :count] = starts[:, axes].T
        costs = np.zeros((block.runs, count))
        along = np.ascontiguousarray(block.prior_cov[:, axes])
        screen(self._arrays, along, there, places, costs)
        self.evaluations += count * len(shown)
        prior = 0.5 * np.einsum("si,ij,sj->s", starts, block.prior_cov, starts)
        return np.asarray(prior + block.epochs / len(shown) * costs)

    def from_filter(self) -> Searches:
        """Return the smoothed track of an extended Kalman filter of each run."""
        found = self._begun(self.runs, np.zeros((self.block.runs, self.block.dimension)))
        filtered_tracks(self._arrays.batch, found)
        self.evaluations += self.block.epochs
        return found

    def from_windows(self, count: int, spacing_m: float, keep: int) -> Searches:
        """Return the motions that fit the first readings of their runs, the most probable first."""
        windows: dict[int, dict[int, Search]] = {}  # of so many epochs, of each run that has one
        for run in range(self.block.runs):
            found = window_search(self.block.problem(run), count, spacing_m, self.loss)
            if found is not None:
                windows.setdefault(found.problem.epochs, {})[run] = found
        runs, starts = [], [np.zeros((0, self.block.dimension))]
        for stop, searches in windows.items():
            smoother = _Smoother(self.block.until(stop), self.loss, self.threshold)
            places = smoother.places(searches, keep)
            self.evaluations += smoother.evaluations
            for run, found in searches.items():
                own = _chosen(places, (places.runs == run) & np.isfinite(places.cost))
                best = best_apart(found.problem, own.states[:, -1], own.cost, found.spacing)[:keep]
                rivals = [i for i in best if own.cost[i] < own.cost[best[0]] + NO_RIVAL]
                runs += [run] * len(rivals)
                starts.append(own.start[rivals])
                self.evaluations[run] += found.evaluations
        return self._from_prior(np.array(runs, dtype=int), np.vstack(starts))

    def places(self, windows: dict[int, Search], keep: int) -> Searches:
        """Return the ends of searches from the best places of windows, by their runs."""
        begun = [
            np.array(found.starts(keep)).reshape(-1, len(self.scale)) for found in windows.values()
        ]
        runs = np.repeat(list(windows), [len(starts) for starts in begun])
        found = self._from_prior(runs, np.concatenate(begun) / self.scale)
        self.search(found, ITERATIONS)
        return found

    def search(self, searches: Searches, most: int) -> None:
        """Follow Gauss–Newton steps, each halved until the cost falls, to the minima."""
        search(self._arrays, most, searches)
        np.add.at(self.evaluations, searches.runs, searches.evaluations)

    def answers(self, minima: Searches) -> tuple[np.ndarray, np.ndarray]:
        """Return mean (J, K, n) and covariance (J, K, n, n) given all readings."""
        jobs, epochs, n = minima.states.shape
        mean, cov = np.empty((jobs, epochs, n)), np.empty((jobs, epochs, n, n))
        answer(self._arrays, minima, mean, cov)
        return mean, cov

    def _from_prior(self, runs: np.ndarray, starts: np.ndarray) -> Searches:
        """Return the undisturbed motions of runs (J,) from prior_mean + P_0 λ of starts (J, n)."""
        found = self._begun(runs, starts)
        undisturbed(self._arrays.batch, found)
        return found

    def _begun(self, runs: np.ndarray, starts: np.ndarray) -> Searches:
        """Return searches that have yet no states."""
        jobs, epochs, n = len(runs), self.block.epochs, self.block.dimension
        numbers = np.zeros((2, jobs), dtype=np.int64)
        return Searches(
            np.array(runs, dtype=np.int64), np.zeros((jobs, epochs, n)), np.array(starts),
            np.zeros(jobs), np.zeros((jobs, epochs, n)), np.full(jobs, np.inf), numbers[0],
            numbers[1], np.zeros(jobs, dtype=np.bool_),
        )  # fmt: skip
