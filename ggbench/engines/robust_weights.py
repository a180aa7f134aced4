"""Robust losses of eight runs at once, compiled: the weights of whitened equations.

What :mod:`ggbench.estimators.robust` does with one reading, which remains the reference.
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
    """Return the number of a loss; with an infinite threshold it never acts."""
    return LOSSES[loss] if threshold < np.inf else NONE


@compiled
def loss_of(residual: float, loss: int, threshold: float) -> float:
    """Return ρ(r) of a residual in standard deviations; ½ r² without a loss."""
    size = abs(residual)
    if loss == HUBER and size > threshold:
        return threshold * (size - 0.5 * threshold)
    if loss == CAUCHY:
        ratio = residual / threshold
        return 0.5 * threshold * threshold * math.log1p(ratio * ratio)
    return 0.5 * residual * residual


@compiled
def weight_of(residual: float, loss: int, threshold: float) -> float:
    """Return ρ'(r) / r of a residual, 1 for small ones."""
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
    """Fill the weights (m,) with which a linear update of a run minimises the robust cost.

    Begun with the innovation in standard deviations of its own covariance; in no round, as they
    begin.

    Parameters
    ----------
    spread : (m, m, lanes) of which the lower half is H P Hᵀ + 1.
    innovation : (1, m, lanes).
    r : the run's lane.
    rounds : how many, at most.
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
    """Put the noise with the weights of a loss in the place of R in S = H P Hᵀ + R.

    Parameters
    ----------
    s : (m, m, lanes), the lower half.
    innovation : (1, m, lanes).
    noise_cov, noise_inverse : (m, m) R and the inverse of its lower root.
    count : of the runs.
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
        reweigh(scratch[:m], white, m, r, loss, threshold, ROUNDS, weight)
        for i in range(m):
            for j in range(i + 1):
                total = s[i, j, r]
                for c in range(j + 1):
                    total += root[i, c] * (1.0 / weight[c] - 1.0) * root[j, c]
                s[i, j, r] = total
