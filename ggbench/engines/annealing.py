"""Tempered measurement update of Gaussian samples.

A measurement may be far more precise than the prior. Therefore the update has stages: stage i
weights the samples by the likelihood to the power β_i, with β_i increasing from 0 to 1 (Neal 2001;
Del Moral, Doucet & Jasra 2006). Each β_i is chosen such that a minimum number of samples stays
effective. Then the samples are resampled and moved by Metropolis–Hastings steps, which preserve the
tempered posterior. The result is exact in the limit of many samples, for any number of modes.

Each proposed step is γ times the difference of two random samples of dimension r. The factor is
γ = 2.38 / √(2r) (ter Braak 2006). Such differences have the scale of the width of a mode or of the
distance between modes.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ..numerics.kernels import compiled
from .resampling import Resampling, effective_size, normalise, resample, unique

_LEAST_SHARE, _BISECTIONS, MOST_STAGES = 1e-16, 20, 60
"""Smallest increase of the power in a stage; number of bisections of its logarithm; number of
stages after which the power becomes 1."""
_STEPS = 5
"""Metropolis–Hastings steps after each stage."""


class Whitening(NamedTuple):
    """Whitened coordinates y = W r of the residuals r of a measurement.

    The measurement of sampled states p and linear states l is z = h(p) + C l + noise. The noise has
    the covariance R, and l has the covariance P_l.

    Attributes
    ----------
    rows : W (m, m), which whitens the noise and diagonalises C P_l Cᵀ.
    linear : λ (m,), the diagonal of W C P_l Cᵀ Wᵀ.
    log_noise : ln |2π R|.
    """

    rows: np.ndarray
    linear: np.ndarray
    log_noise: float


def whitening(noise: np.ndarray, spread: np.ndarray) -> Whitening:
    """Return the whitened coordinates of a measurement, see :class:`Whitening`.

    ``noise`` (m, m) is the noise covariance R. ``spread`` (m, m) is C P_l Cᵀ, the covariance of h
    caused by the linear states.
    """
    inverse = np.linalg.inv(np.linalg.cholesky(noise))
    linear, axes = np.linalg.eigh(inverse @ spread @ inverse.T)
    log_noise = float(np.linalg.slogdet(2.0 * np.pi * noise)[1])
    return Whitening(axes.T @ inverse, np.maximum(linear, 0.0), log_noise)


class Annealed(NamedTuple):
    """Samples of the posterior after a measurement, with statistics of the update.

    Attributes
    ----------
    normals : (N, r) samples of dimension r, in coordinates in which the prior is standard normal.
    whitened : (N, m) whitened residuals y of the samples, see :class:`Whitening`.
    evidence : ln p(z) of the measurement z.
    size : effective sample size that an update without stages would leave.
    stages : number of stages between prior and posterior.
    fewest : smallest number of distinct samples that a resampling has left.
    """

    normals: np.ndarray
    whitened: np.ndarray
    evidence: float
    size: float
    stages: int
    fewest: int


@compiled
def _raise(
    whitened: np.ndarray, linear: np.ndarray, before: float, after: float, out: np.ndarray
) -> None:
    """Fill ``out`` (N,) with the change of the log weights from power ``before`` to ``after``.

    With the linear states integrated out, the power β of the likelihood is
    exp(−½ Σ [β y² / (1 + β λ) + ln(1 + β λ)]). The common factor |2π R|^{−β/2} is omitted.
    """
    m, constant = whitened.shape[1], 0.0
    factors = np.empty(m)
    for c in range(m):
        above, below = 1.0 + after * linear[c], 1.0 + before * linear[c]
        factors[c] = after / above - before / below
        constant += math.log(above / below)
    for i in range(whitened.shape[0]):
        total = constant
        for c in range(m):
            total += factors[c] * whitened[i, c] * whitened[i, c]
        out[i] = -0.5 * total


def annealed(
    normals: np.ndarray,
    read: Callable[[np.ndarray], np.ndarray],
    space: Whitening,
    count: int,
    least: float,
    resampling: Resampling,
    rng: np.random.Generator,
) -> Annealed:
    """Return samples of the posterior after a measurement, updated in tempered stages.

    Parameters
    ----------
    normals : (M, r) samples of the standard normal prior of dimension r.
    read : function that returns the whitened residuals y (·, m) of samples (·, r).
    space : whitened coordinates that define y.
    count : number N of samples to return.
    least : minimum effective sample size after a stage.
    resampling : resampling method.
    """
    whitened = read(normals)
    power, stages, evidence, fewest = 0.0, 0, -0.5 * space.log_noise, count
    size = math.nan
    while power < 1.0:
        before = power
        wanted = least if stages < MOST_STAGES else 0.0
        weights, gained, power, at_once = _stage(whitened, space.linear, before, wanted)
        size = at_once if before == 0.0 else size
        evidence += gained
        stages += power < 1.0
        ancestors = resample(resampling, weights, rng, count)
        fewest = min(fewest, unique(ancestors))
        normals, whitened = normals[ancestors], whitened[ancestors]
        for _ in range(_STEPS):
            _step(normals, whitened, read, space.linear, power, rng)
    return Annealed(normals, whitened, evidence, size, stages, fewest)


def _stage(
    whitened: np.ndarray, linear: np.ndarray, before: float, least: float
) -> tuple[np.ndarray, float, float, float]:
    """Choose the next power of the likelihood by bisection.

    Returns
    -------
    Normalised weights (M,) at this power, logarithm of their mean before normalisation, the power,
    and the effective sample size at the power 1.
    """
    logs, weights = np.empty(len(whitened)), np.empty(len(whitened))

    def weigh(after: float) -> tuple[float, float]:
        _raise(whitened, linear, before, after, logs)
        total = normalise(logs, weights)
        return total - math.log(len(logs)), float(effective_size(weights))

    gained, at_once = weigh(1.0)
    if at_once >= least:
        return weights, gained, 1.0, at_once
    low, high = math.log(_LEAST_SHARE), math.log(1.0 - before)
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        if weigh(before + math.exp(middle))[1] >= least:
            low = middle
        else:
            high = middle
    after = before + math.exp(low)
    gained, _ = weigh(after)
    return weights, gained, after, at_once


def _step(
    normals: np.ndarray,
    whitened: np.ndarray,
    read: Callable[[np.ndarray], np.ndarray],
    linear: np.ndarray,
    power: float,
    rng: np.random.Generator,
) -> None:
    """Move each sample (N, r) and its residuals y (N, m) by one Metropolis–Hastings step."""
    count, rank = normals.shape
    others = normals[rng.permutation(count)]
    trial = normals + 2.38 / math.sqrt(2.0 * max(rank, 1)) * (others - np.roll(others, 1, axis=0))
    there = read(trial)
    here_logs, there_logs = np.empty(count), np.empty(count)
    _raise(whitened, linear, 0.0, power, here_logs)
    _raise(there, linear, 0.0, power, there_logs)
    gain = there_logs - here_logs + 0.5 * ((normals**2).sum(axis=1) - (trial**2).sum(axis=1))
    taken = rng.exponential(size=count) > -gain
    normals[taken], whitened[taken] = trial[taken], there[taken]
