"""Most probable trajectories from many starts across the prior.

The searches of all runs of a block are processed together (:mod:`.trajectory_search`).
"""

from __future__ import annotations

import numpy as np
from scipy.special import ndtri

from ..block import EstimateBlock, ProblemBlock
from ..numerics import lanes
from ..numerics.records import fields_of
from ..problem import Problem
from .line_search import MapSearches, filtered_tracks, screen
from .position_grid import states_in_metres
from .trajectory_search import TrajectorySearch, chosen
from .window_search import ITERATIONS, Search, best_apart

_SCREENED = 50
"""Largest number of epochs at which the costs of starts are compared."""
_MOST_POINTS = 50_000
"""Largest number of grid points of the map search of a window."""
NO_RIVAL = 50.0
"""Excess of the cost over the best one above which a position is not searched further."""


def across_prior(problem: Problem, count: int) -> np.ndarray:
    """Return multipliers λ (S, n) of S starts spread across the prior.

    A start is the state prior_mean + P_0 λ, in units of the prior's standard deviations. The first
    is the prior mean. The others are a Halton sequence, mapped to a normal distribution. The
    density of this distribution is proportional to the power d / (d + 2) of the prior density of
    the d position states. This power minimises the mean square distance to the nearest start
    (Zador 1982).
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
    """Return evenly spaced epochs (E,) at which the costs of starts are compared."""
    return np.linspace(0, epochs - 1, min(epochs, _SCREENED)).astype(int)


def window_end(present: np.ndarray, count: int) -> int:
    """Return the epoch that follows the first ``count`` epochs with measurements.

    If fewer epochs have measurements, the result follows the last of them. It is 0 without
    measurements.

    Parameters
    ----------
    present : (K, m) mask of available measurements.
    """
    read = np.flatnonzero(present.any(axis=1))[:count]
    return int(read[-1]) + 1 if len(read) else 0


def window_search(window: Problem, spacing_m: float, loss: str) -> Search | None:
    """Return the map search of a window of measurements, or None if there is nothing to search.

    There is nothing to search if the window has no epochs, if the problem has no position states,
    or if the grid has only one point.
    """
    if not window.epochs or not states_in_metres(window):
        return None
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
    """Find the most probable trajectory of every run; NaN if no start has a finite cost.

    Parameters
    ----------
    block : block of R runs.
    count : number of starts across the prior.
    keep : number of the best starts that are refined.
    window : number of epochs with measurements in :func:`window_search`; 0 for no window search.
    spacing_m : step of the grid of :func:`window_search` [m].
    most : largest number of Gauss–Newton steps from each start.
    loss, threshold : robust loss on each whitened component of a measurement, see
        :mod:`.robust_weights`.
    """
    smoother = _Multistart(block, loss, threshold)
    # Kind by kind, so that those that go through the lanes together need about as many steps.
    parts = [smoother.best_starts(count, keep), smoother.from_filter()]
    if window:
        parts.append(smoother.from_windows(window, spacing_m, keep))
    searches = MapSearches(*map(np.concatenate, zip(*map(fields_of, parts), strict=True)))
    smoother.search(searches, most)
    best = np.empty(block.runs, dtype=int)
    for run in range(block.runs):
        own = np.flatnonzero(searches.runs == run)
        costs = searches.cost[own]
        best[run] = own[np.argmin(np.where(np.isfinite(costs), costs, np.inf))]
    minima = chosen(searches, best)
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


class _Multistart(TrajectorySearch):
    """Trajectory searches of a block, and the construction of their starts."""

    def best_starts(self, count: int, keep: int) -> MapSearches:
        """Return searches from the ``keep`` starts of least cost, of ``count`` across the prior.

        Their trajectories are noise-free.
        """
        block, first = self.block, self.block.problem(0)
        starts = across_prior(first, count) / self.scale
        if len(starts) == 1:
            return self.from_prior(self.runs, np.tile(starts, (block.runs, 1)))
        costs = self._screened(starts, states_in_metres(first))
        best = np.argsort(costs, axis=1, kind="stable")[:, :keep].T
        return self.from_prior(np.tile(self.runs, len(best)), starts[best.ravel()])

    def _screened(self, starts: np.ndarray, axes: list[int]) -> np.ndarray:
        """Return approximate costs (R, S) of starts (S, n), from a part of the epochs.

        ``axes`` are the indices of the states in which the starts differ.
        """
        block, count = self.block, len(starts)
        shown = shown_epochs(block.epochs)
        there = np.isin(np.arange(block.epochs), shown)
        places = lanes.lanes(len(axes), len(lanes.group_starts(count)))
        places.reshape(len(axes), -1)[:, :count] = starts[:, axes].T
        costs = np.zeros((block.runs, count))
        along = np.ascontiguousarray(block.prior_cov[:, axes])
        screen(self._arrays, along, there, places, costs)
        self.evaluations += count * len(shown)
        prior = 0.5 * np.einsum("si,ij,sj->s", starts, block.prior_cov, starts)
        return np.asarray(prior + block.epochs / len(shown) * costs)

    def from_filter(self) -> MapSearches:
        """Return searches that start at the smoothed trajectory of each run's EKF."""
        found = self.unstarted(self.runs, np.zeros((self.block.runs, self.block.dimension)))
        filtered_tracks(self._arrays.batch, found)
        self.evaluations += self.block.epochs
        return found

    def from_windows(self, count: int, spacing_m: float, keep: int) -> MapSearches:
        """Return searches from the best matches of the first measurements of each run.

        A run has up to ``keep`` searches, the most probable first. Their trajectories are
        noise-free.
        """
        window_ends = np.array([window_end(there, count) for there in self.block.present])
        runs, starts = [], [np.zeros((0, self.block.dimension))]
        for stop in dict.fromkeys(window_ends.tolist()):
            smoother = _Multistart(self.block.until(stop), self.loss, self.threshold)
            searches = {
                run: found
                for run in np.flatnonzero(window_ends == stop).tolist()
                if (found := window_search(smoother.block.problem(run), spacing_m, self.loss))
            }
            if not searches:
                continue
            places = smoother.places(searches, keep)
            self.evaluations += smoother.evaluations
            for run, found in searches.items():
                own = chosen(places, (places.runs == run) & np.isfinite(places.cost))
                best = best_apart(found.problem, own.states[:, -1], own.cost, found.spacing)[:keep]
                rivals = [i for i in best if own.cost[i] < own.cost[best[0]] + NO_RIVAL]
                runs += [run] * len(rivals)
                starts.append(own.start[rivals])
                self.evaluations[run] += found.evaluations
        return self.from_prior(np.array(runs, dtype=int), np.vstack(starts))

    def places(self, windows: dict[int, Search], keep: int) -> MapSearches:
        """Run searches from the best positions of each window, and return them.

        ``windows`` are the map searches of windows, by run.
        """
        begun = [
            np.array(found.starts(keep)).reshape(-1, len(self.scale)) for found in windows.values()
        ]
        runs = np.repeat(list(windows), [len(starts) for starts in begun])
        found = self.from_prior(runs, np.concatenate(begun) / self.scale)
        self.search(found, ITERATIONS)
        return found
