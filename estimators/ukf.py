"""Unscented Kalman filter, compiled: the paper's sigma points, the scaled set, cubature points.

The sigma points are drawn again from the predicted mean and covariance before the update, so that
the process noise is in them, as filterpy 2.0 does.
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
    points : ``julier`` for the paper's set, λ = κ; ``merwe`` for the scaled set (van der Merwe);
        ``cubature`` for the 2n points of Arasaratnam & Haykin 2009, the paper's set with κ = 0. Its
        centre has no weight, and no weight is negative.
    kappa : κ [3 − n of the paper for ``julier``, 0 for ``merwe``].
    alpha, beta : spread and prior-knowledge parameters of the scaled set.
    """

    family = "sigma-point"

    points: Literal["julier", "merwe", "cubature"] = "julier"
    kappa: float | None = None
    alpha: Positive = 0.5
    beta: float = 2.0

    def conflict(self) -> str | None:
        """Refuse a κ of cubature points."""
        if self.points == "cubature" and self.kappa is not None:
            return "cubature points have no kappa"
        return super().conflict()

    def skip(self, problem: Problem) -> str | None:
        """Refuse sigma points that do not exist: their spread must be positive and finite."""
        n, kappa = problem.dimension, self.kappa_of(problem.dimension)
        if not 0.0 < n + kappa < np.inf:
            return f"n + kappa must be positive and finite, and is {n} + {kappa:g}"
        return super().skip(problem)

    def kappa_of(self, n: int) -> float:
        """Return κ, or the default of the chosen set for n states."""
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
