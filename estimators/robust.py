"""Robust losses on the residuals of a measurement update, by iteratively reweighted noise.

A loss ρ takes the place of half the square of each residual r, in standard deviations of the
measurement noise: Huber's grows linearly beyond its threshold, Cauchy's with the logarithm. Least
squares with the weights w(r) = ρ'(r) / r, found again from its own residuals until they no longer
change, minimises the sum of ρ (Huber & Ronchetti 2009, ch. 7).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from ..block import BlockEstimator
from ..engines.iterated_smoother import OfResiduals
from ..parameters import NonNegative
from ..problem import Estimator

Loss = Literal["none", "huber", "cauchy"]

THRESHOLDS = {"none": np.inf, "huber": 1.345, "cauchy": 2.385}
"""Thresholds that cost 5 % of variance where the noise is Gaussian after all (Zhang 1997)."""
_ROUNDS = 50
_SETTLED = 1e-8


@dataclass(frozen=True)
class RobustLoss(Estimator):
    """Parameters of a robust loss on each component of a whitened residual.

    Parameters
    ----------
    loss : ``huber`` or ``cauchy`` weigh down the components of a measurement that fit neither the
        prediction nor each other.
    threshold : residual [standard deviations of the noise] from which the loss acts; if not
        given, 1.345 for ``huber`` and 2.385 for ``cauchy``.
    """

    loss: Loss = field(default="none", kw_only=True)
    threshold: Annotated[float, Field(gt=0.0)] | None = field(default=None, kw_only=True)

    @property
    def limit(self) -> float:
        """The threshold, or the default of the loss [standard deviations]."""
        return THRESHOLDS[self.loss] if self.threshold is None else self.threshold

    def conflict(self) -> str | None:
        """Refuse a threshold of no loss."""
        if self.loss == "none" and self.threshold is not None:
            return "threshold needs a loss: huber or cauchy"
        return None


@dataclass(frozen=True)
class GatedUpdate(RobustLoss, BlockEstimator):
    """Parameters of a gate on innovations and of an underweighted gain.

    Both are remedies against measurements that a linear update would take too much from, see
    :mod:`ggbench.engines.innovation_gating`.

    Parameters
    ----------
    gate : probability with which a measurement of the assumed noise passes; one whose innovation
        is beyond that quantile of χ² is rejected. 0 is no gate.
    underweighting : β of S = (1 + β) H P Hᵀ + R, for the gain alone; 0 is the optimal gain.
    """

    gate: Annotated[float, Field(ge=0.0, lt=1.0)] = field(default=0.0, kw_only=True)
    underweighting: NonNegative = field(default=0.0, kw_only=True)

    causality = "filter"

    @property
    def exact_if_linear_gaussian(self) -> bool:
        """Not with a gate, which rejects some good measurements, nor with another gain."""
        return not self.gate and not self.underweighting

    def conflict(self) -> str | None:
        """Refuse two remedies at once."""
        if (self.gate or self.underweighting) and self.loss != "none":
            name = "gate" if self.gate else "underweighting"
            return f"{name} and a loss are two answers to the same measurements: choose one"
        return super().conflict()


def losses(residuals: np.ndarray, loss: Loss, threshold: float) -> np.ndarray:
    """Return the loss ρ(r) of each residual in standard deviations; ½ r² without a loss."""
    half = 0.5 * residuals**2
    if loss == "none" or threshold == np.inf:
        return half
    if loss == "huber":
        size = np.abs(residuals)
        return np.where(size > threshold, threshold * (size - 0.5 * threshold), half)
    return 0.5 * threshold**2 * np.log1p((residuals / threshold) ** 2)


def weights(residuals: np.ndarray, loss: Loss, threshold: float) -> np.ndarray:
    """Return the weight ρ'(r) / r of each residual, 1 for small ones."""
    if loss == "none" or threshold == np.inf:
        return np.ones_like(residuals)
    if loss == "huber":
        return threshold / np.maximum(np.abs(residuals), threshold)
    return 1.0 / (1.0 + (residuals / threshold) ** 2)


def of_residuals(loss: Loss, threshold: float) -> tuple[OfResiduals, OfResiduals]:
    """Return :func:`losses` and :func:`weights` as functions of the residuals alone."""
    return (
        lambda residuals: losses(residuals, loss, threshold),
        lambda residuals: weights(residuals, loss, threshold),
    )


def reweighted_noise(
    innovation: np.ndarray, spread: np.ndarray, noise_cov: np.ndarray, loss: Loss, threshold: float
) -> np.ndarray:
    """Return the noise covariance (m, m) with which a linear update minimises the robust cost.

    The loss is on what is left of the innovation after the update, in standard deviations of the
    noise alone, one component at a time: an innovation that the prior can explain is no outlier,
    however large. The first weights are found from the innovation in standard deviations of its
    own covariance, so that the iteration starts on the right side of the outliers.

    Parameters
    ----------
    innovation : (m,) measurement minus prediction.
    spread : (m, m) covariance of the prediction, H P Hᵀ.
    noise_cov : (m, m) R, positive definite.
    """
    if loss == "none" or threshold == np.inf:
        return noise_cov
    root = np.linalg.cholesky(noise_cov)
    white = np.linalg.solve(root, innovation)
    spread = np.linalg.solve(root, np.linalg.solve(root, spread).T)
    # A set of sigma points with negative weights can have a negative spread.
    deviations = np.sqrt(1.0 + np.maximum(np.diag(spread), 0.0))
    weight = weights(white / deviations, loss, threshold)
    for _ in range(_ROUNDS):
        # What the update leaves: y − H K y = R (H P Hᵀ + R)⁻¹ y.
        left = np.linalg.solve(spread + np.diag(1.0 / weight), white) / weight
        last, weight = weight, np.maximum(weights(left, loss, threshold), 1e-12)
        if np.abs(weight - last).max() < _SETTLED:
            break
    return np.asarray((root / weight) @ root.T)
