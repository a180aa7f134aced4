"""Batch maximum a posteriori estimation by iterated Kalman smoothing from many starts.

A Gauss–Newton step is one pass of a Kalman smoother, see :mod:`ggbench.engines.line_search`.

The cost has many local minima, and Gauss–Newton converges to the nearest one. Therefore the cost is
evaluated for many starts across the position prior, and the best starts are refined. The trajectory
of a start contains the uncorrected INS drift. One more search starts from the smoothed track of an
extended Kalman filter, in which the drift is corrected.

With a wide prior the starts are far apart. For 1024 starts and a standard deviation of 10 km, the
start nearest to a position beyond 2 σ is about 1.3 km away. At this distance the cost does not
indicate the minimum. Therefore the first window of measurements is also searched on a grid that
resolves the field (:mod:`ggbench.engines.window_search`). The best grid positions are additional
starts. If the first measurements are not informative, the starts across the prior remain.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import Field

from ..block import BlockEstimator, EstimateBlock, ProblemBlock
from ..engines.multistart import multistart
from ..parameters import AtLeastOne, Positive
from .robust import RobustLoss

_MOST_STARTS = 1_000_000
"""Starts that fit in memory."""


@dataclass(frozen=True)
class GaussNewton(RobustLoss, BlockEstimator):
    """Most probable trajectory, by Gauss–Newton from several starts.

    Parameters
    ----------
    starts : number of initial positions across the prior; 1 uses only the prior mean. A position
        comprises all states with the unit metre. The track of a filter is an additional start.
    refine : number of refined starts. The starts with the lowest costs are refined.
    window : number of epochs with measurements in the grid search; 0: no grid search. With
        ``starts=1`` there is no grid search either.
    spacing_m : step of the grid search [m]; a quarter of the field's correlation length is
        suitable.
    max_iterations : largest number of Gauss–Newton steps from each start.
    """

    starts: Annotated[int, Field(ge=1, le=_MOST_STARTS)] = 1024
    refine: AtLeastOne = 5
    window: Annotated[int, Field(ge=0)] = 20
    spacing_m: Positive = 250.0
    max_iterations: AtLeastOne = 30

    name = "gauss-newton"
    family = "smoother"
    causality = "batch"

    def estimate_block(
        self, block: ProblemBlock, rngs: Sequence[np.random.Generator] = ()
    ) -> EstimateBlock:
        """Estimate all runs of a block; the mean is NaN if no start has a finite cost."""
        window = self.window if self.starts > 1 else 0
        return multistart(
            block,
            count=self.starts,
            keep=self.refine,
            window=window,
            spacing_m=self.spacing_m,
            most=self.max_iterations,
            loss=self.loss,
            threshold=self.limit,
        )
