"""Particle weights, resampling and weighted moments.

Weights are stored as logarithms: one measurement of six channels may change ratios of weights by
factors of e^10000, beyond double precision. Resampling replaces weighted particles by equally
weighted particles and copies particles of large weight. All methods are unbiased: the expected
number of copies of particle i is N W_i, with the normalised weight W_i (Douc, Cappé & Moulines
2005). The methods differ in the variance of the number of copies.
"""

from __future__ import annotations

import math
from typing import Literal

import numpy as np

from ..numerics.kernels import compiled

Resampling = Literal["systematic", "stratified", "residual"]
FLOOR = 1e-14
"""Least eigenvalue of a covariance in units of the prior's variances: what few particles leave."""


@compiled
def normalise(log_weights: np.ndarray, weights: np.ndarray) -> float:
    """Fill normalised weights (N,) from log weights (N,); return ln Σ exp(log weights).

    A log weight of NaN gives the weight zero. If all weights are zero, or a weight is infinite, the
    measurement gives no information: all weights become equal and −∞ is returned.
    """
    count = log_weights.shape[0]
    largest = -math.inf
    for i in range(count):
        if log_weights[i] > largest:  # false for NaN
            largest = log_weights[i]
    if math.isinf(largest):
        for i in range(count):
            weights[i] = 1.0 / count
        return -math.inf
    total = 0.0
    for i in range(count):
        value = math.exp(log_weights[i] - largest)
        weights[i] = 0.0 if math.isnan(value) else value
        total += weights[i]
    for i in range(count):
        weights[i] /= total
    return largest + math.log(total)


@compiled
def effective_size(weights: np.ndarray) -> float:
    """Return the effective sample size 1 / Σ W_i² (from 1 to N) of normalised weights (N,)."""
    total = 0.0
    for i in range(weights.shape[0]):
        total += weights[i] * weights[i]
    return 1.0 / total


@compiled
def strata(weights: np.ndarray, places: np.ndarray, ancestors: np.ndarray) -> None:
    """Fill ``ancestors`` (M,) by systematic or stratified resampling.

    Entry j is the particle at the quantile (j + u_j) / M of the cumulated weights, j = 0 … M − 1.

    Parameters
    ----------
    weights : (N,) normalised weights.
    places : numbers u_j from 0 to 1: one number (1,) for systematic resampling (Carpenter, Clifford
        & Fearnhead 1999), M numbers (M,) for stratified resampling (Kitagawa 1996).
    ancestors : (M,) output: indices of particles in ascending order, int64.
    """
    count, i, reached = ancestors.shape[0], 0, weights[0]
    last = weights.shape[0] - 1
    while last > 0 and weights[last] == 0.0:
        last -= 1  # where rounding ends the sum below the last quantile, that one is not chosen
    for j in range(count):
        quantile = (j + places[min(j, places.shape[0] - 1)]) / count
        while reached <= quantile and i < last:
            i += 1
            reached += weights[i]
        ancestors[j] = i


@compiled
def residues(weights: np.ndarray, places: np.ndarray, ancestors: np.ndarray) -> None:
    """Fill ``ancestors`` (M,) by residual resampling (Liu & Chen 1998).

    Particle i is copied ⌊M W_i⌋ times. The remaining copies are drawn with probabilities
    proportional to M W_i − ⌊M W_i⌋.

    Parameters
    ----------
    weights, ancestors : as in :func:`strata`.
    places : (M,) uniform numbers between 0 and 1.
    """
    size, count = weights.shape[0], ancestors.shape[0]
    copies, left = np.empty(size, dtype=np.int64), np.empty(size)
    whole, total = 0, 0.0
    for i in range(size):
        copies[i] = int(count * weights[i])
        whole += copies[i]
        total += count * weights[i] - copies[i]
        left[i] = total
    for j in range(count - whole):
        chosen = np.searchsorted(left, places[j] * total, side="right")
        copies[min(chosen, size - 1)] += 1
    j = 0
    for i in range(size):
        for _ in range(copies[i]):
            if j < count:
                ancestors[j] = i
                j += 1


def unique(ancestors: np.ndarray) -> int:
    """Return the number of distinct particles among sorted ancestors (N,)."""
    return int(np.count_nonzero(np.diff(ancestors))) + 1


def resample(
    kind: Resampling, weights: np.ndarray, rng: np.random.Generator, count: int | None = None
) -> np.ndarray:
    """Return the indices (M,) of the particles to copy, in ascending order.

    The new particles have equal weights.

    Parameters
    ----------
    kind : resampling method.
    weights : (N,) normalised weights.
    rng : random numbers.
    count : number M of new particles; N by default.
    """
    ancestors = np.empty(len(weights) if count is None else count, dtype=np.int64)
    if kind == "residual":
        residues(weights, rng.random(len(ancestors)), ancestors)
    else:
        strata(weights, rng.random(1 if kind == "systematic" else len(ancestors)), ancestors)
    return ancestors


def moments(weights: np.ndarray, states: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return mean (n,) and covariance (n, n) of states (N, n) with normalised weights (N,)."""
    mean = weights @ states
    away = np.empty_like(states)
    _weighted_deviations(weights, states, mean, away)
    return mean, away.T @ away  # of a matrix with itself: half the work


@compiled
def _weighted_deviations(
    weights: np.ndarray, states: np.ndarray, mean: np.ndarray, away: np.ndarray
) -> None:
    """Fill (N, n) with √W_i (x_i − mean), in one passage through memory."""
    for i in range(states.shape[0]):
        root = math.sqrt(weights[i])
        for j in range(states.shape[1]):
            away[i, j] = root * (states[i, j] - mean[j])


def repaired(cov: np.ndarray, prior_cov: np.ndarray) -> tuple[np.ndarray, bool]:
    """Return a positive definite covariance (n, n), and whether it was changed.

    The covariance of few particles or of identical particles is singular. For the
    repair it is expressed in units of the prior's standard deviations. Its eigenvalues below
    :data:`FLOOR` are then set to :data:`FLOOR`, or to a larger value if rounding errors require it.
    """
    scale = np.sqrt(np.diag(prior_cov))
    values, vectors = np.linalg.eigh(cov / np.outer(scale, scale))
    # Rounding in a product of three matrices must not undo it.
    floor = max(FLOOR, 8.0 * len(values) * np.finfo(float).eps * values[-1])
    if values[0] >= floor:
        return 0.5 * (cov + cov.T), False
    root = scale[:, np.newaxis] * vectors * np.sqrt(np.maximum(values, floor))
    return root @ root.T, True
