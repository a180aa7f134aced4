"""Fusion of the position fixes of a matcher with the INS.

``fusion`` names one of two methods. Both use each measurement once.

``none``    the prior of each fix is the flight's prior, propagated without fixes. A fix
            uses only the measurements of its own window.
``kalman``  the prior of each fix is the propagated estimate, which includes earlier fixes.

A matcher may hand over to a filter: the first accepted fix ends the search, and the filter
processes the later measurements.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Literal

import numpy as np

from ..block import EstimateBlock, ProblemBlock
from ..problem import Estimate, Fixes, Problem

Fusion = Literal["none", "kalman"]


class PropagatedEstimate:
    """Estimate of a flight, propagated between fixes.

    Attributes
    ----------
    mean, cov : (K, n), (K, n, n) estimates. They are valid up to the last epoch that was
        set with ``put``, or requested with ``at`` since then.
    """

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        epochs, n = problem.epochs, problem.dimension
        self.mean, self.cov = np.empty((epochs, n)), np.empty((epochs, n, n))
        self._filled = 0

    def at(self, k: int) -> tuple[np.ndarray, np.ndarray]:
        """Return mean (n,) and covariance (n, n) at epoch ``k``; epoch −1 is the prior."""
        if k < 0:
            return self.problem.prior_mean, self.problem.prior_cov
        while self._filled <= k:
            filled = self._filled
            mean, cov = self.at(filled - 1)
            phi = self.problem.transition[filled]
            cov = phi @ cov @ phi.T + self.problem.process_cov[filled]
            self.mean[filled], self.cov[filled] = phi @ mean, 0.5 * (cov + cov.T)
            self._filled += 1
        return self.mean[k], self.cov[k]

    def put(self, k: int, mean: np.ndarray, cov: np.ndarray) -> None:
        """Set the estimate at epoch ``k``; later epochs are propagated from it.

        If ``mean`` is (K', n) and ``cov`` is (K', n, n), K' estimates are set: those of epoch ``k``
        and of the following epochs.
        """
        self.at(k)
        stop = k + (1 if mean.ndim == 1 else len(mean))
        self.mean[k:stop], self.cov[k:stop] = mean, cov
        self._filled = stop

    def whole(self) -> tuple[np.ndarray, np.ndarray]:
        """Return mean (K, n) and covariance (K, n, n), propagated to the end of the flight."""
        self.at(self.problem.epochs - 1)
        return self.mean, self.cov


Attempt = tuple[int, np.ndarray, np.ndarray, bool, float]
"""Epoch, position errors (d,), covariance (d, d), acceptance, statistic of a fix, see Fixes."""


def fixes_of(attempts: Sequence[Attempt]) -> Fixes:
    """Return the fixes of a flight; without attempts the arrays are empty and two-dimensional."""
    if not attempts:
        empty = np.zeros(0)
        return Fixes(
            empty.astype(int), np.zeros((0, 2)), np.zeros((0, 2, 2)), empty.astype(bool), empty
        )
    epochs, means, covs, accepted, statistics = zip(*attempts, strict=True)
    return Fixes(
        epoch=np.array(epochs),
        mean=np.array(means),
        cov=np.array(covs),
        accepted=np.array(accepted),
        statistic=np.array(statistics),
    )


class FixFusion:
    """Estimate of a flight whose measurements are matched with the map window by window.

    Parameters
    ----------
    block : block of one run.
    fusion : method of fusion, ``none`` or ``kalman``.
    position : indices of the position states that a fix contains.
    hands_over : whether the first accepted fix ends the search.

    Attributes
    ----------
    problem : the problem of the run.
    found : whether the search has ended.
    evaluations : number of evaluations of h; every search increases it.
    """

    def __init__(
        self,
        block: ProblemBlock,
        fusion: Fusion,
        position: Sequence[int],
        hands_over: bool = False,
    ) -> None:
        self.block, self.fusion, self.found = block, fusion, False
        self.problem, self.evaluations = block.problem(0), 0
        self._hands_over = hands_over
        self._estimate = PropagatedEstimate(self.problem)
        self._unaided = PropagatedEstimate(self.problem)
        self._attempts: list[Attempt] = []
        self._position, self._last = list(position), -1

    def window(self, last: int, end: int) -> ProblemBlock:
        """Return the window of epochs after ``last`` up to and including ``end``."""
        return self.block.part(last + 1, end + 1, *self.before(last))

    def before(self, last: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the prior mean (n,) and covariance (n, n) of a window that follows ``last``.

        The prior is the estimate at epoch ``last``. With ``fusion`` "none" it is the flight's
        prior, propagated without fixes.
        """
        return (self._unaided if self.fusion == "none" else self._estimate).at(last)

    def add(
        self, epoch: int, mean: np.ndarray, cov: np.ndarray, accepted: bool, statistic: float
    ) -> None:
        """Record a fix at an epoch; an accepted fix replaces the estimate at that epoch.

        Parameters
        ----------
        mean, cov : (n,), (n, n) mean and covariance of all states.
        accepted : whether the fix passed the acceptance test.
        statistic : value of the test statistic.
        """
        at = self._position
        self._attempts.append((epoch, mean[at], cov[np.ix_(at, at)], accepted, statistic))
        if accepted:
            self._estimate.put(epoch, mean, cov)
            self.found, self._last = self._hands_over, epoch

    def estimate(self, behind: Callable[[ProblemBlock], EstimateBlock] | None = None) -> Estimate:
        """Return the estimate of the flight.

        The parameter ``behind`` is a filter. It processes the measurements after a hand-over.
        """
        if behind is not None and self.found and self._last + 1 < self.problem.epochs:
            start = self._estimate.at(self._last)
            filtered = behind(self.block.part(self._last + 1, self.problem.epochs, *start))
            self.evaluations += int(filtered.info["map_evaluations"][0])
            self._estimate.put(self._last + 1, filtered.mean[0], filtered.cov[0])
        mean, cov = self._estimate.whole()
        fixes = fixes_of(self._attempts)
        info = {
            "fixes_tried": len(fixes),
            "fixes_accepted": int(fixes.accepted.sum()),
            "map_evaluations": self.evaluations,
        }
        return Estimate(mean, cov, "filter", info=info, fixes=fixes)
