"""Terrain contour matching (TERCOM): the best-fitting position for a window of measurements.

TERCOM is the oldest method of map aiding (Golden 1980; Hollowell 1990). The INS track of a
window of measurements is displaced to each point of a grid. The measurements are compared with the
map along each displaced track. The best displacement is a position fix. All channels of all sensors
are compared together.
:mod:`ggbench.engines.window_search` defines the criteria.

From the best grid points the method computes the most probable states of the whole window. The
covariance of a fix includes the uncertainty of velocity, height, attitude and biases. A fix is
accepted if its residuals agree with the noise and if no other position is nearly as probable.
Otherwise more measurements are added to the window. A window of the largest size without an
accepted fix is discarded.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field

from ..block import EstimateBlock, ProblemBlock, by_block
from ..engines.extended_filter import UpdateOptions, extended
from ..engines.fix_fusion import FixFusion, Fusion
from ..engines.window_search import (
    MOST,
    Criterion,
    Place,
    Search,
    WindowSearch,
    refined,
    unmatchable,
)
from ..parameters import AtLeastOne, Positive
from ..problem import Estimate, Problem
from ..reduced import horizontal
from .robust import RobustLoss

_ITERATIONS = 5
"""Linearisations in each update of the filter that follows a fix."""


@dataclass(frozen=True)
class Tercom(RobustLoss):
    """Terrain contour matching by windows of measurements.

    Parameters
    ----------
    criterion : cost of a position, see :class:`ggbench.engines.window_search.Search`.
    window : number of epochs with measurements before the first attempt at a fix.
    longest : largest window. A window grows in steps of ``window`` while its fix is rejected. A
        rejected window of this size is discarded, and the next window begins after it.
    fusion : use of the fixes, see :mod:`ggbench.engines.fix_fusion`.
    spacing_m : step of the grid [m]; a quarter of the field's correlation length is suitable.
    most : largest number of grid points; the step is increased if necessary.
    refine : number of the best positions that are refined.
    misfit : largest χ² per measurement of an accepted fix; 1 is expected.
    odds : smallest log odds of an accepted fix: best position against second best position.
    """

    criterion: Criterion = "msd"
    window: AtLeastOne = 20
    longest: int = 60
    fusion: Fusion = "kalman"
    spacing_m: Positive = 250.0
    most: Annotated[int, Field(ge=1, le=MOST)] = 50_000
    refine: AtLeastOne = 8
    misfit: Annotated[float, Field(gt=0.0)] = 3.0
    odds: Annotated[float, Field(ge=0.0)] = 10.0

    name = "tercom"
    family = "matching"
    causality = "filter"
    exact_if_linear_gaussian = False  # between its fixes it takes no reading
    _hands_over: ClassVar[bool] = False

    def conflict(self) -> str | None:
        """Return an error text if ``window`` is too short or exceeds ``longest``; else None."""
        if self.criterion in ("ncc", "nccdm") and self.window < 3:
            return f"criterion={self.criterion} needs a window of at least 3, not {self.window}"
        if self.longest < self.window:
            return f"longest must be at least the window, {self.window}, and is {self.longest}"
        return super().conflict()

    def skip(self, problem: Problem) -> str | None:
        """Return a reason to skip the problem, or None if there is none.

        The problem must have a horizontal position, and its model must have compiled kernels.
        """
        return unmatchable(problem)

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        """Match one window after the other, and propagate the estimate between fixes."""
        return by_block(problem, self._match)

    def _match(self, block: ProblemBlock) -> Estimate:
        position = horizontal(block.problem(0), velocity=False)
        flight = FixFusion(block, self.fusion, position, self._hands_over)
        read = np.flatnonzero(block.present[0].any(axis=1))
        last = -1  # the last epoch whose readings are spent
        while len(left := read[read > last]) >= self.window and not flight.found:
            last = self._window(flight, left[: self.longest], last)
        return flight.estimate(self._filtered)

    def _search(self, window: ProblemBlock) -> WindowSearch:
        return WindowSearch(window, self.loss, self.limit)

    def _filtered(self, rest: ProblemBlock) -> EstimateBlock:
        """Return the estimate of an iterated EKF for the epochs after the first accepted fix."""
        updates = UpdateOptions(iterations=_ITERATIONS, loss=self.loss, threshold=self.limit)
        return extended(rest, updates)

    def _window(self, flight: FixFusion, read: np.ndarray, last: int) -> int:
        """Attempt a fix from the measurements after the epoch ``last``.

        The window grows until a fix is accepted or all epochs ``read`` are used.

        Returns
        -------
        The last epoch of the window. The next window begins after it.
        """
        longest = flight.window(last, read[-1]).problem(0)
        search = Search(longest, self.spacing_m, self.most, self.criterion)
        end = last
        for size in range(self.window, len(read) + 1, self.window):
            end = int(read[size - 1])
            search.take(end - last)
            window = self._search(flight.window(last, end))
            places = refined(window, search.starts(self.refine), search.spacing)
            flight.evaluations += int(window.evaluations[0])
            if not places:
                continue
            accepted, statistic = self._judged(places, int(window.block.present.sum()))
            flight.add(end, places[0].mean, places[0].cov, accepted, statistic)
            if accepted:
                break
        flight.evaluations += search.evaluations
        return end

    def _judged(self, places: list[Place], readings: int) -> tuple[bool, float]:
        """Return whether the best position is accepted, and its log odds.

        The log odds are −∞ if its χ² is too large, and ∞ without a second position.
        """
        best = places[0].cost
        if 2.0 * best > self.misfit * readings:
            return False, -np.inf
        odds = places[1].cost - best if len(places) > 1 else np.inf
        return bool(odds > self.odds), float(odds)


@dataclass(frozen=True)
class TercomEkf(Tercom):
    """TERCOM until the first accepted fix, then an iterated EKF."""

    name = "tercom-ekf"
    _hands_over: ClassVar[bool] = True
