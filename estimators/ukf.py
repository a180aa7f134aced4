"""Unscented Kalman filter, compiled, with a choice of three sets of sigma points.

New sigma points are computed from the predicted mean and covariance before the update, so that they
include the process noise. filterpy 2.0 does the same.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ..block import EstimateBlock, ProblemBlock
from ..engines import filters
from ..parameters import Positive
from ..problem import Estimator, Problem
from .robust import GatedUpdate


@dataclass(frozen=True)
class SigmaPoints(Estimator):
    """Parameters of a set of sigma points.

    Parameters
    ----------
    points : ``julier``: set of Wang et al. 2013, with the spread parameter λ = κ. ``merwe``: scaled
        set (van der Merwe).
        ``cubature``: 2n points of Arasaratnam & Haykin 2009. They equal ``julier`` with κ = 0,
        which gives the central point the weight zero. No weight is negative.
    kappa : κ [default: 3 − n for ``julier``, as in Wang et al. 2013; 0 for ``merwe``].
    alpha, beta : α (spread) and β (knowledge of the distribution) of the scaled set.
    """

    family = "sigma-point"

    points: Literal["julier", "merwe", "cubature"] = "julier"
    kappa: float | None = None
    alpha: Positive = 0.5
    beta: float = 2.0

    def conflict(self) -> str | None:
        """Return an error text if κ is given for cubature points; else None."""
        if self.points == "cubature" and self.kappa is not None:
            return "cubature points have no kappa"
        return super().conflict()

    def skip(self, problem: Problem) -> str | None:
        """Return a reason to skip the problem, or None if there is none.

        The spread n + κ of the sigma points must be positive and finite for n states.
        """
        n, kappa = problem.dimension, self.kappa_of(problem.dimension)
        if not 0.0 < n + kappa < np.inf:
            return f"n + kappa must be positive and finite, and is {n} + {kappa:g}"
        return super().skip(problem)

    def kappa_of(self, n: int) -> float:
        """Return κ if it is given, else the default of κ for the chosen set and n states."""
        if self.kappa is not None:
            return self.kappa
        return 3.0 - n if self.points == "julier" else 0.0


@dataclass(frozen=True)
class UnscentedKalmanFilter(SigmaPoints, GatedUpdate):
    """Unscented Kalman filter (Julier & Uhlmann 2004; Wang et al. 2013, eqs. 13–16, corrected)."""

    name = "ukf"

    def estimate_block(
        self, block: ProblemBlock, rngs: Sequence[np.random.Generator] = ()
    ) -> EstimateBlock:
        """Filter all runs of a block."""
        n = block.dimension
        scale, more = n + self.kappa_of(n), 0.0
        if self.points == "merwe":
            scale *= self.alpha**2
            more = 1.0 - self.alpha**2 + self.beta
        centre = 1.0 - n / scale
        weights = filters.SigmaWeights(math.sqrt(scale), centre + more, 0.5 / scale)
        return filters.unscented(
            block, weights, self.loss, self.limit, self.gate, self.underweighting
        )
