"""Gaussian-sum filter: a bank of iterated extended Kalman filters across a wide prior.

Where the prior is wide against the features of the field, one linearisation cannot hold, and a
filter locks onto whatever part of the field looks alike. So the prior is written as a sum of
narrow Gaussians on a grid of positions, each with a filter of its own, weighted by how well it
predicts (Sorenson & Alspach 1971; Alspach & Sorenson 1972; Bar-Shalom, Li & Kirubarajan 2001,
sec. 11.6). What weighs nothing is dropped, what has become the same is merged.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import Field

from ..block import BlockEstimator, EstimateBlock, ProblemBlock
from ..engines.gaussian_sum import gaussian_sum
from ..parameters import AtLeastOne, Positive
from .robust import RobustLoss

_MOST = 100_000
"""Hypotheses that fit in memory."""


@dataclass(frozen=True)
class GaussianSum(RobustLoss, BlockEstimator):
    """Gaussian-sum filter over the position.

    Parameters
    ----------
    spacing_m : distance of the hypotheses [m], a fraction of the field's correlation length. The
        prior is split only in directions in which it is wider.
    most : largest number of hypotheses; the grid is made coarser to keep it.
    iterations : linearisations of h in each update of a hypothesis (see ``ekf``).
    """

    spacing_m: Positive = 250.0
    most: Annotated[int, Field(ge=1, le=_MOST)] = 4000
    iterations: AtLeastOne = 3

    name = "gaussian-sum"
    family = "mixture"
    causality = "filter"

    def conflict(self) -> str | None:
        """Refuse a loss without a second linearisation, which has the first one's residuals."""
        if self.loss != "none" and self.iterations == 1:
            return "a loss needs at least 2 iterations"
        return super().conflict()

    def estimate_block(
        self, block: ProblemBlock, rngs: Sequence[np.random.Generator] = ()
    ) -> EstimateBlock:
        """Filter all runs of a block."""
        return gaussian_sum(
            block, self.spacing_m, self.most, self.iterations, self.loss, self.limit
        )
