"""Robust losses on the residuals of a measurement update, by iteratively reweighted noise.

A residual r is in standard deviations of the measurement noise. A loss ρ(r) replaces the quadratic
cost ½ r². Huber's loss grows linearly beyond a threshold, Cauchy's loss logarithmically.
Iteratively reweighted least squares with the weights w(r) = ρ'(r) / r minimises the sum of ρ (Huber
& Ronchetti 2009, ch. 7).

The module contains a NumPy version for one measurement and a compiled version for eight runs.
"""

from __future__ import annotations

import math

import numpy as np

from ..numerics.kernels import compiled

NONE, HUBER, CAUCHY = 0, 1, 2
LOSSES = {"none": NONE, "huber": HUBER, "cauchy": CAUCHY}
"""Numbers by which kernels know the losses."""
ROUNDS = 50
"""In which the weights of an update are found at most."""
_SETTLED = 1e-8
_LEAST = 1e-12


def number_of(loss: str, threshold: float) -> int:
    """Return the code of a loss; an infinite threshold gives the code of no loss."""
    return LOSSES[loss] if threshold < np.inf else NONE


@compiled
def loss_of(residual: float, loss: int, threshold: float) -> float:
    """Return the loss ρ(r) of a residual r in standard deviations; ½ r² without a loss."""
    size = abs(residual)
    if loss == HUBER and size > threshold:
        return threshold * (size - 0.5 * threshold)
    if loss == CAUCHY:
        ratio = residual / threshold
        return 0.5 * threshold * threshold * math.log1p(ratio * ratio)
    return 0.5 * residual * residual


@compiled
def weight_of(residual: float, loss: int, threshold: float) -> float:
    """Return the weight ρ'(r) / r of a residual r in standard deviations of the noise.

    The weight is 1 without a loss.
    """
    if loss == HUBER:
        return threshold / max(abs(residual), threshold)
    if loss == CAUCHY:
        ratio = residual / threshold
        return 1.0 / (1.0 + ratio * ratio)
    return 1.0


@compiled
def reweigh(
    spread: np.ndarray,
    innovation: np.ndarray,
    m: int,
    r: int,
    loss: int,
    threshold: float,
    rounds: int,
    weight: np.ndarray,
) -> None:
    """Fill the weights (m,) with which a linear update of one run minimises the robust cost.

    The initial weights follow from the innovation, divided by the standard deviations of the
    innovation. With ``rounds`` 0 they are the result.

    Parameters
    ----------
    spread : (m, m, lanes) lower half of the whitened innovation covariance H P Hᵀ + I.
    innovation : (1, m, lanes) innovations.
    m : number of channels.
    r : lane of the run.
    loss, threshold : code of the loss, and threshold.
    rounds : largest number of iterations.
    weight : (m,) output.
    """
    for c in range(m):
        deviation = math.sqrt(max(spread[c, c, r], 1.0))
        weight[c] = weight_of(innovation[0, c, r] / deviation, loss, threshold)
    lower, left = np.empty((m, m)), np.empty(m)
    for _ in range(rounds):
        # What the update leaves: y − H K y = W⁻¹ (H P Hᵀ + W⁻¹)⁻¹ y.
        for i in range(m):
            for j in range(i + 1):
                total = spread[i, j, r]
                if i == j:
                    total += 1.0 / weight[i] - 1.0
                for k in range(j):
                    total -= lower[i, k] * lower[j, k]
                lower[i, j] = math.sqrt(total) if i == j else total / lower[j, j]
        for i in range(m):
            total = innovation[0, i, r]
            for k in range(i):
                total -= lower[i, k] * left[k]
            left[i] = total / lower[i, i]
        for i in range(m - 1, -1, -1):
            total = left[i]
            for k in range(i + 1, m):
                total -= lower[k, i] * left[k]
            left[i] = total / lower[i, i]
        moved = 0.0
        for c in range(m):
            new = max(weight_of(left[c] / weight[c], loss, threshold), _LEAST)
            moved = max(moved, abs(new - weight[c]))
            weight[c] = new
        if moved < _SETTLED:
            break


@compiled
def reweigh_unwhitened(
    s: np.ndarray,
    innovation: np.ndarray,
    noise_cov: np.ndarray,
    noise_inverse: np.ndarray,
    count: int,
    loss: int,
    threshold: float,
    scratch: np.ndarray,
) -> None:
    """Replace R in S = H P Hᵀ + R by the noise covariance reweighted by a loss.

    Parameters
    ----------
    s : (m, m, lanes) lower half of S, overwritten.
    innovation : (1, m, lanes) innovations.
    noise_cov, noise_inverse : (m, m) R and the inverse of its lower Cholesky factor.
    count : number of runs.
    loss, threshold : code of the loss, and threshold.
    scratch : (m + 1, m, lanes).
    """
    m = s.shape[0]
    root = np.linalg.cholesky(noise_cov)
    white, half, weight = scratch[m:], np.empty((m, m)), np.empty(m)
    for r in range(count):
        for i in range(m):
            total = 0.0
            for c in range(i + 1):
                total += noise_inverse[i, c] * innovation[0, c, r]
            white[0, i, r] = total
            for j in range(m):
                total = 0.0
                for c in range(i + 1):
                    total += noise_inverse[i, c] * s[max(c, j), min(c, j), r]
                half[i, j] = total
        for i in range(m):
            for j in range(i + 1):
                total = 0.0
                for c in range(j + 1):
                    total += half[i, c] * noise_inverse[j, c]
                scratch[i, j, r] = total
        reweigh(
            spread=scratch[:m],
            innovation=white,
            m=m,
            r=r,
            loss=loss,
            threshold=threshold,
            rounds=ROUNDS,
            weight=weight,
        )
        for i in range(m):
            for j in range(i + 1):
                total = s[i, j, r]
                for c in range(j + 1):
                    total += root[i, c] * (1.0 / weight[c] - 1.0) * root[j, c]
                s[i, j, r] = total


def losses(residuals: np.ndarray, loss: str, threshold: float) -> np.ndarray:
    """Return the loss ρ(r) of each residual r; ½ r² without a loss.

    ``residuals`` (...) are in standard deviations of the noise. The result has the same shape.
    """
    half = 0.5 * residuals**2
    if loss == "none" or threshold == np.inf:
        return half
    if loss == "huber":
        size = np.abs(residuals)
        return np.where(size > threshold, threshold * (size - 0.5 * threshold), half)
    return 0.5 * threshold**2 * np.log1p((residuals / threshold) ** 2)


def weights(residuals: np.ndarray, loss: str, threshold: float) -> np.ndarray:
    """Return the weight ρ'(r) / r of each residual r.

    ``residuals`` (...) are in standard deviations of the noise. The result has the same shape.
    """
    if loss == "none" or threshold == np.inf:
        return np.ones_like(residuals)
    if loss == "huber":
        return threshold / np.maximum(np.abs(residuals), threshold)
    return 1.0 / (1.0 + (residuals / threshold) ** 2)


def reweighted_noise(
    innovation: np.ndarray, spread: np.ndarray, noise_cov: np.ndarray, loss: str, threshold: float
) -> np.ndarray:
    """Return the noise covariance (m, m) with which a linear update minimises the robust cost.

    The loss applies to each component of the residual after the update, in standard deviations of
    the noise. Therefore a large innovation is no outlier if an error of the prior explains it. The
    initial weights follow from the innovation, divided by the standard deviations of the
    innovation, so the iteration starts with outliers already down-weighted.

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
    for _ in range(ROUNDS):
        # What the update leaves: y − H K y = R (H P Hᵀ + R)⁻¹ y.
        left = np.linalg.solve(spread + np.diag(1.0 / weight), white) / weight
        last, weight = weight, np.maximum(weights(left, loss, threshold), _LEAST)
        if np.abs(weight - last).max() < _SETTLED:
            break
    return np.asarray((root / weight) @ root.T)
