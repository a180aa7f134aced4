"""Searches for the most probable trajectories of the runs of a block.

:mod:`.line_search` processes the searches of all runs together.
"""

from __future__ import annotations

import numpy as np

from ..block import EstimateBlock, ProblemBlock
from ..numerics.records import fields_of
from .line_search import CONVERGED, MapSearches, answer, ends, search, undisturbed
from .linear_problems import BatchProblem
from .robust_weights import number_of
from .whitened_measurements import batch_of

_ENOUGH = 1e-5
"""Decrease of the cost below which one search from the prior ends, as GTSAM's optimizers do."""


def chosen(searches: MapSearches, which: np.ndarray) -> MapSearches:
    """Return a subset of the searches, given by a mask or by indices (J,)."""
    return MapSearches(*(array[which] for array in fields_of(searches)))


class TrajectorySearch:
    """Searches for the most probable trajectories of a block.

    Parameters
    ----------
    block : block of R runs.
    loss, threshold : robust loss on each whitened component of a measurement, see
        :mod:`.robust_weights`.

    Attributes
    ----------
    scale : (n,) standard deviations of the prior.
    evaluations : (R,) number of evaluations of h so far.
    """

    def __init__(self, block: ProblemBlock, loss: str = "none", threshold: float = np.inf) -> None:
        self.block, self.loss, self.threshold = block, loss, threshold
        self.runs = np.arange(block.runs)
        self.scale = np.sqrt(np.diag(block.prior_cov))
        self.evaluations = np.zeros(block.runs, dtype=int)
        self._arrays = BatchProblem(batch_of(block), number_of(loss, threshold), threshold)

    def from_prior(self, runs: np.ndarray, starts: np.ndarray) -> MapSearches:
        """Return searches that start at the noise-free trajectories of ``starts``.

        Parameters
        ----------
        runs : (J,) run of each search.
        starts : (J, n) λ; the state before the first epoch is prior_mean + P_0 λ.
        """
        begun = self.unstarted(runs, starts)
        undisturbed(self._arrays.batch, begun)
        return begun

    def unstarted(self, runs: np.ndarray, starts: np.ndarray) -> MapSearches:
        """Return searches whose trajectories are not filled.

        Parameters
        ----------
        runs : (J,) run of each search.
        starts : (J, n) λ; the state before the first epoch is prior_mean + P_0 λ.
        """
        jobs, epochs, n = len(runs), self.block.epochs, self.block.dimension
        return MapSearches(
            runs=np.array(runs, dtype=np.int64),
            states=np.zeros((jobs, epochs, n)),
            start=np.array(starts),
            motion=np.zeros(jobs),
            about=np.zeros((jobs, epochs, n)),
            cost=np.full(jobs, np.inf),
            iterations=np.zeros(jobs, dtype=np.int64),
            evaluations=np.zeros(jobs, dtype=np.int64),
            converged=np.zeros(jobs, dtype=np.bool_),
        )

    def search(self, searches: MapSearches, most: int, enough: float = CONVERGED) -> None:
        """Minimise the costs of trajectories by Gauss–Newton searches.

        Each step is halved until the cost decreases. A search makes at most ``most`` steps. It ends
        earlier if the actual or predicted decrease of the cost in a step is smaller than
        ``enough``.
        """
        search(self._arrays, most, enough, searches)
        np.add.at(self.evaluations, searches.runs, searches.evaluations)

    def answers(self, minima: MapSearches) -> tuple[np.ndarray, np.ndarray]:
        """Return smoothed mean (J, K, n) and covariance (J, K, n, n) of each search."""
        jobs, epochs, n = minima.states.shape
        mean, cov = np.empty((jobs, epochs, n)), np.empty((jobs, epochs, n, n))
        answer(self._arrays, minima, mean, cov)
        return mean, cov

    def ends(self, minima: MapSearches) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return mean (J, n) and covariance (J, n, n) at the last epoch, and log widths (J,).

        See :func:`.line_search.ends`.
        """
        jobs, _, n = minima.states.shape
        mean, cov, log_width = np.empty((jobs, 1, n)), np.empty((jobs, 1, n, n)), np.empty(jobs)
        ends(self._arrays, minima, mean, cov, log_width)
        return mean[:, 0], cov[:, 0], log_width


def from_the_prior(block: ProblemBlock, most: int, loss: str, threshold: float) -> EstimateBlock:
    """Find the most probable trajectory of every run by a search from the prior mean.

    The mean is NaN if no step decreases the cost although the linear problem predicts a decrease.

    Parameters
    ----------
    block : block of R runs.
    most : largest number of Gauss–Newton steps.
    loss, threshold : robust loss on each whitened component of a measurement, see
        :mod:`.robust_weights`.
    """
    smoother = TrajectorySearch(block, loss, threshold)
    searches = smoother.from_prior(smoother.runs, np.zeros((block.runs, block.dimension)))
    begun = searches.states.copy()
    smoother.search(searches, most, _ENOUGH)
    mean, cov = smoother.answers(searches)
    stuck = ~searches.converged & (searches.states == begun).all(axis=(1, 2))
    mean[stuck] = np.nan
    info = {
        "iterations": searches.iterations,
        "error": searches.cost,
        "map_evaluations": smoother.evaluations,
    }
    return EstimateBlock(mean, cov, "batch", info=info)
