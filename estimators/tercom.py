"""Terrain contour matching (TERCOM): the place whose map fits a window of readings best.

The oldest way to aid an INS by a map (Golden 1980; Hollowell 1990): a window of readings is
compared with what the map says along the INS's track, displaced to each point of a grid, and the
best displacement is a fix. What is measured here are gradients, all channels at once, and
everything else that is on board; so the words are those of :mod:`ggbench.engines.windows`, where
the criteria are written down.

A fix is honest about what it knows: from the best points of the grid the most probable states of
the whole window are found, and the covariance is that of a position whose velocity, height,
attitude and biases are not known either. It is believed only if its residuals are those of noise
and if no other place is nearly as probable. Where it is not, the window grows, and begins anew
when it has grown long.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..engines.fixes import Attempts, Carried, Fusion
from ..engines.iterated_smoother import IteratedSmoother
from ..engines.windows import Criterion, Place, Search, refined, section
from ..problem import Causality, Estimate, Estimator, Problem
from ..reduced import horizontal
from . import robust
from .ekf import ExtendedKalmanFilter
from .robust import Loss

_ITERATIONS = 5
"""Linearisations in each update of the filter that follows a fix."""
_MOST = 1_000_000
"""Points of a grid that fit in memory."""


@dataclass(frozen=True)
class Tercom(Estimator):
    """Terrain contour matching by windows of readings.

    Parameters
    ----------
    criterion : by which places are compared, see :class:`ggbench.engines.windows.Search`.
    window : number of epochs with readings after which a fix is first tried.
    longest : number to which the window grows, ``window`` by ``window``, while its fix is refused;
        then its readings are given up, and the next one begins behind them.
    fusion : what becomes of fixes, see :mod:`ggbench.engines.fixes`.
    spacing_m : step of the grid [m], a quarter of the field's correlation length.
    most : largest number of its points; where there would be more, the step is made longer.
    refine : how many of the best places are refined.
    misfit : largest χ² per reading with which a fix is accepted; 1 is expected.
    odds : least log odds of the best place against the second best with which it is accepted.
    loss : ``huber`` or ``cauchy`` on each component of a reading in the refinement, and in the
        filter of ``fusion=restart``; see :mod:`ggbench.estimators.robust`.
    threshold : residual [standard deviations of the noise] from which the loss acts; if not
        given, 1.345 for ``huber`` and 2.385 for ``cauchy``.
    """

    criterion: Criterion = "msd"
    window: int = 20
    longest: int = 60
    fusion: Fusion = "restart"
    spacing_m: float = 250.0
    most: int = 50_000
    refine: int = 8
    misfit: float = 3.0
    odds: float = 10.0
    loss: Loss = "none"
    threshold: float | None = None

    name = "tercom"

    @property
    def causality(self) -> Causality:
        """Measurements up to each epoch."""
        return "filter"

    @property
    def exact(self) -> bool:
        """Not exact: between its fixes it takes no reading."""
        return False

    def skip(self, problem: Problem) -> str | None:
        """Refuse settings without a meaning, and problems without a horizontal position."""
        if not 0.0 < self.spacing_m < np.inf:
            return f"spacing_m must be positive and finite, and is {self.spacing_m:g}"
        if not 1 <= self.most <= _MOST:
            return f"most must be 1 to {_MOST}, and is {self.most}"
        for name in ("window", "refine"):
            if getattr(self, name) < 1:
                return f"{name} must be at least 1, and is {getattr(self, name)}"
        if self.criterion in ("ncc", "nccdm") and self.window < 3:
            return f"criterion={self.criterion} needs a window of at least 3, not {self.window}"
        if self.longest < self.window:
            return f"longest must be at least the window, {self.window}, and is {self.longest}"
        if not self.misfit > 0.0:
            return f"misfit must be positive, and is {self.misfit:g}"
        if not self.odds >= 0.0:
            return f"odds must not be negative, and is {self.odds:g}"
        if not horizontal(problem, velocity=False):
            return "the problem has no two states in metres, a position to be found"
        return robust.refusal(self.loss, self.threshold)

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        """Try windows one after the other; carry along what has been found."""
        flight = _Flight(self, problem)
        read = np.flatnonzero(problem.present.any(axis=1))
        last = -1  # the last epoch whose readings are spent
        found = False
        while len(left := read[read > last]) >= self.window and not found:
            last, accepted = flight.window(left[: self.longest], last)
            found = accepted and self.fusion == "restart"
        if found and last + 1 < problem.epochs:
            rest = section(problem, last + 1, problem.epochs, *flight.estimate.at(last))
            ekf = ExtendedKalmanFilter(_ITERATIONS, self.loss, self.threshold)
            behind = ekf.estimate(rest, rng)
            assert behind.cov is not None  # a Kalman filter has one
            flight.estimate.put(last + 1, behind.mean, behind.cov)
        mean, cov = flight.estimate.whole()
        fixes = flight.attempts.listed()
        info = {"fixes_tried": len(fixes), "fixes_accepted": int(fixes.accepted.sum())}
        return Estimate(mean, cov, self.causality, info=info, fixes=fixes)


class _Flight:
    """One flight's estimate and fixes in the making."""

    def __init__(self, settings: Tercom, problem: Problem) -> None:
        self.settings, self.problem = settings, problem
        self.estimate, self.attempts = Carried(problem), Attempts()
        self._unaided = Carried(problem)
        self._position = list(horizontal(problem, velocity=False))
        threshold = robust.threshold_of(settings.loss, settings.threshold)
        self._losses = robust.of_residuals(settings.loss, threshold)

    def window(self, read: np.ndarray, last: int) -> tuple[int, bool]:
        """Try a fix from readings after epoch ``last``, from more of them while it is refused.

        Returns
        -------
        The last epoch whose readings are spent, and whether a fix was accepted there.
        """
        settings, problem = self.settings, self.problem
        before = (self._unaided if settings.fusion == "none" else self.estimate).at(last)
        longest = section(problem, last + 1, read[-1] + 1, *before)
        search = Search(longest, settings.spacing_m, settings.most, settings.criterion)
        end, accepted = last, False
        for size in range(settings.window, len(read) + 1, settings.window):
            end = int(read[size - 1])
            search.take(end - last)
            window = section(problem, last + 1, end + 1, *before)
            smoother = IteratedSmoother(window, *self._losses)
            places = refined(smoother, search.starts(settings.refine), search.spacing)
            if not places:
                continue
            accepted, statistic = self._judged(places, int(window.present.sum()))
            place, at = places[0], self._position
            self.attempts.add(end, place.mean[at], place.cov[np.ix_(at, at)], accepted, statistic)
            if accepted:
                self.estimate.put(end, place.mean, place.cov)
                break
        return end, accepted

    def _judged(self, places: list[Place], readings: int) -> tuple[bool, float]:
        """Return whether the best of several places is accepted, and its log odds."""
        best = places[0].cost
        if 2.0 * best > self.settings.misfit * readings:
            return False, -np.inf
        odds = places[1].cost - best if len(places) > 1 else np.inf
        return bool(odds > self.settings.odds), float(odds)
