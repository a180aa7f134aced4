"""Measurement noise estimated from the residuals of updates, on eight runs at once, compiled.

A variance of each component of a whitened reading (Mohamed & Schwarz 1999, with the forgetting of
Sage & Husa 1969): what :class:`ggbench.estimators.ekf.ExtendedKalmanFilter` with filterpy does with
one run, which remains the reference.
"""

from __future__ import annotations

import math

import numpy as np

from ..numerics import lane_algebra
from ..numerics.kernels import compiled
from ..numerics.lanes import lanes
from ..numerics.records import record
from .iterated_update import Search
from .whitened_measurements import Readings, scale_equations


@record
class AdaptiveNoise:
    """What is believed of the noise of eight runs.

    Attributes
    ----------
    memory : number of readings that count; 0 believes the given noise.
    variances : (1, m, lanes) of components in units of the given noise.
    taken : (1, m, lanes) readings that have been taken in, and one for what was given.
    """

    memory: int
    variances: np.ndarray
    taken: np.ndarray


@compiled
def adaptive_noise_of(m: int, memory: int) -> AdaptiveNoise:
    """Return the noise of readings of m equations."""
    return AdaptiveNoise(memory, lanes(1, m), lanes(1, m))


@compiled
def begin(noise: AdaptiveNoise) -> None:
    """Believe what is given."""
    noise.variances[:] = 1.0
    noise.taken[:] = 1.0


@compiled
def believe(noise: AdaptiveNoise, reading: Readings) -> None:
    """Whiten a whole reading by what is believed, and all that are linearised after it."""
    for c in range(reading.precision.shape[1]):
        for r in range(reading.precision.shape[2]):
            reading.precision[0, c, r] = 1.0 / math.sqrt(noise.variances[0, c, r])
    scale_equations(reading)


@compiled
def learn(
    noise: AdaptiveNoise,
    present: np.ndarray,
    group: np.ndarray,
    count: int,
    k: int,
    p: np.ndarray,
    search: Search,
    reading: Readings,
) -> None:
    """Take in the residuals after an update: their expected squares are R − H P⁺ Hᵀ.

    Parameters
    ----------
    present : (R, K, m) which channels there were.
    group, count, k : runs and epoch.
    p : (n, n, lanes) P⁺.
    search : the update.
    reading : linearised after it, by the given noise.
    """
    lane_algebra.products_of_rows(search.rows, search.rows.shape[0], p, search.hp)
    for r in range(count):
        there = present[group[r], k]
        for c in range(there.shape[0]):
            if not there[c]:
                continue
            certain = 0.0
            for j in range(p.shape[0]):
                certain += search.hp[c, j, r] * search.rows[c, j, r]
            # A component that a robust loss holds for an outlier counts as little as it did there.
            variance, weight = noise.variances[0, c, r], search.weights[0, c, r]
            residual = reading.innovation[0, c, r]
            new = weight * residual * residual + certain * variance / weight
            taken = min(noise.taken[0, c, r] + 1.0, float(noise.memory))
            noise.taken[0, c, r] = taken
            noise.variances[0, c, r] = variance + (new - variance) / taken
