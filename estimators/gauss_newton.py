"""Batch maximum a posteriori by Gauss–Newton as an iterated Kalman smoother, from many starts.

The steps are those of :mod:`ggbench.engines.line_search`.

A field of gravity gradients looks alike in many places, and Gauss–Newton finds the nearest. So the
cost is looked at from many starts across the prior of the position, and the best are refined.
Those follow the drift of the INS, however far it leads; one more search starts from the smoothed
track of an extended Kalman filter, which has corrected it on the way.

Starts for whole flights are few, and where the prior is wide they lie far apart: of 1024 across a
standard deviation of 10 km the nearest to a place beyond two of them is some 1.3 km away, and the
cost there tells no more than anywhere. So the first window of readings is searched as matchers do
(:mod:`ggbench.engines.window_search`), on a grid fine enough for the field, and what fits it is
one more start each. Where the first readings say nothing, those for the whole flight remain.
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
    starts : number of initial positions (states in metres) spread over the prior; 1 starts from
        the prior's mean alone. The track of a filter is a further start.
    refine : number of starts with the lowest costs that are refined.
    window : number of epochs with measurements of a grid search; 0: no search. With one start
        there is no search.
    spacing_m : step of that grid [m], a quarter of the field's correlation length.
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
        """Refine the best starts of all runs of a block; the mean is NaN where none has a cost."""
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
