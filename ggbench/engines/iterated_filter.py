"""Extended Kalman filter with iterated, robust, adaptive updates on many runs at once, compiled.

A test holds it to the same equations with filterpy and NumPy.

The measurement noise may be estimated from the residuals of updates, a variance of each component
of a whitened reading (Mohamed & Schwarz 1999, with the forgetting of Sage & Husa 1969).
"""

from __future__ import annotations

import math

import numpy as np

from ..block import EstimateBlock, ProblemBlock
from ..numerics import lane_algebra, lanes
from ..numerics.kernels import compiled
from ..numerics.records import record
from .iterated_update import Rules, Search, minimise, search_of, update
from .robust_weights import NONE, number_of
from .whitened_measurements import (
    Batch,
    Readings,
    batch_of,
    linearise,
    readings_of,
    scale_equations,
    scatter_squares,
)

_HALVINGS = 12


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
def believe(noise: AdaptiveNoise, reading: Readings) -> None:
    """Whiten a whole reading by what is believed, and all that are linearised after it."""
    for c in range(reading.precision.shape[1]):
        for r in range(reading.precision.shape[2]):
            reading.precision[0, c, r] = 1.0 / math.sqrt(noise.variances[0, c, r])
    scale_equations(reading)


@compiled
def learn(
    noise: AdaptiveNoise, search: Search, group: np.ndarray, count: int, k: int, p: np.ndarray
) -> None:
    """Take in the residuals after an update: their expected squares are R − H P⁺ Hᵀ.

    Parameters
    ----------
    search : the update; its reading is linearised after it, by the given noise.
    group, count, k : runs and epoch.
    p : (n, n, lanes) P⁺.
    """
    present, reading = search.batch.present, search.reading
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


@compiled
def _iterated(
    batch: Batch,
    rules: Rules,
    memory: int,
    mean: np.ndarray,
    cov: np.ndarray,
    nis: np.ndarray,
    counts: np.ndarray,
) -> None:
    """Fill mean (R, K, n), cov (R, K, n, n), NIS (R, K); counts (R, 2) of linearisations and h."""
    runs, epochs, n = batch.transition.shape[:3]
    expected = lanes.moving_states(batch.transition, batch.process_cov)
    phi, q = lanes.lanes(n, n), lanes.lanes(n, n)
    x, p, scratch = lanes.lanes(1, n), lanes.lanes(n, n), lanes.lanes(n, n)
    reading = readings_of(batch, rules.loss != NONE or memory > 0)
    m = reading.rows.shape[0]
    noise = AdaptiveNoise(memory, lanes.lanes(1, m), lanes.lanes(1, m))
    search = search_of(batch, rules, reading)
    unexplained = lanes.lanes(1, 1)
    hp, s, white = search.hp, search.s, search.white
    for first in lanes.starts(runs):
        count, group = lanes.count_from(first, runs), lanes.members(first, runs)
        lanes.spread(batch.prior_mean, x)
        lanes.spread(batch.prior_cov, p)
        search.counts[:] = 0
        noise.variances[:] = 1.0
        noise.taken[:] = 1.0
        for k in range(epochs):
            moving = lanes.gather(batch.transition, batch.process_cov, group, k, expected, phi, q)
            lane_algebra.predict(phi, q, moving, x, p, scratch)
            linearise(batch, group, count, k, x, reading)
            # The square of the innovation is that of every filter: linearised at the prediction,
            # with the given noise.
            lane_algebra.copy(reading.squared, unexplained)
            lane_algebra.project(reading.rows, p, m, hp, s)
            lane_algebra.factorise(s, m, s)
            lane_algebra.whiten(s, m, reading.innovation, white)
            lane_algebra.add_squares(white, m, reading.squared)
            scatter_squares(reading, first, count, k, nis)
            lane_algebra.copy(unexplained, reading.squared)
            if memory > 0:
                believe(noise, reading)
            minimise(search, group, count, k, x, p)
            update(search, x, p, scratch)
            lanes.scatter(x, p, first, count, k, mean, cov)
            if memory > 0:
                reading.precision[:] = 1.0
                linearise(batch, group, count, k, x, reading)
                learn(noise, search, group, count, k, p)
                search.counts[:, 1] += 1
        for r in range(count):
            counts[first + r, 0] = search.counts[r, 0]
            counts[first + r, 1] = search.counts[r, 1]


def iterated(
    block: ProblemBlock, iterations: int, loss: str, threshold: float, memory: int
) -> EstimateBlock:
    """Run the filter.

    Parameters
    ----------
    block : the runs.
    iterations : most linearisations of h per epoch.
    loss, threshold : on each whitened component of a reading, see :mod:`.robust_weights`.
    memory : readings from which the noise is estimated, 0 for none.
    """
    runs, epochs, n = block.runs, block.epochs, block.dimension
    mean, cov = np.empty((runs, epochs, n)), np.empty((runs, epochs, n, n))
    nis, counts = np.empty((runs, epochs)), np.zeros((runs, 2), dtype=np.int64)
    rules = Rules(iterations, _HALVINGS, number_of(loss, threshold), threshold, True)
    _iterated(batch_of(block), rules, memory, mean, cov, nis, counts)
    info = {"linearisations": counts[:, 0], "map_evaluations": counts[:, 1]}
    return EstimateBlock(mean, cov, "filter", nis=nis, info=info)
