"""Gaussian-sum filter: a bank of iterated extended Kalman filters across a wide prior.

If the prior is wide compared with the features of the field, one linearisation of h is not valid
across the prior. A single filter may then converge to a wrong position. Therefore the prior is
split into narrow Gaussians on a grid of positions, with one filter for each Gaussian. The filters
are weighted by the predicted density of the measurements (Sorenson & Alspach 1971; Alspach &
Sorenson 1972; Bar-Shalom, Li & Kirubarajan 2001, sec. 11.6). Filters with negligible weight are
dropped. Filters with nearly equal estimates are merged.
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
    spacing_m : distance between neighbouring Gaussians [m]; a fraction of the field's correlation
        length is suitable. The prior is split only in directions in which its standard deviation
        exceeds this distance.
    most : largest number of Gaussians; the distance is increased if necessary.
    iterations : largest number of linearisations of h in each update of a filter (see ``ekf``).
    """

    spacing_m: Positive = 250.0
    most: Annotated[int, Field(ge=1, le=_MOST)] = 4000
    iterations: AtLeastOne = 3

    name = "gaussian-sum"
    family = "mixture"
    causality = "filter"

    def conflict(self) -> str | None:
        """Return an error text if a loss is combined with a single linearisation; else None."""
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
