"""Extended Kalman filter with iterated, robust, adaptive updates on many runs at once, compiled.

The equations are those of :class:`ggbench.estimators.ekf.ExtendedKalmanFilter` with filterpy, which
remains the reference: a test holds both together.
"""

from __future__ import annotations

import numpy as np

from ..block import EstimateBlock, ProblemBlock
from ..numerics import lane_algebra, lanes
from ..numerics.kernels import compiled
from .adaptive_noise import adaptive_noise_of, begin, believe, learn
from .iterated_update import Rules, minimise, search_of, update
from .robust_weights import NONE, number_of
from .whitened_measurements import Batch, batch_of, linearise, readings_of, scatter_squares

_HALVINGS = 12


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
    noise = adaptive_noise_of(m, memory)
    search = search_of(n, m)
    unexplained = lanes.lanes(1, 1)
    hp, s, white = search.hp, search.s, search.white
    for first in lanes.starts(runs):
        count, group = lanes.count_from(first, runs), lanes.members(first, runs)
        lanes.spread(batch.prior_mean, x)
        lanes.spread(batch.prior_cov, p)
        spent = np.zeros((len(group), 2), dtype=np.int64)
        begin(noise)
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
            minimise(batch, group, count, k, rules, x, p, reading, search, spent)
            update(rules, x, p, search, scratch)
            lanes.scatter(x, p, first, count, k, mean, cov)
            if memory > 0:
                reading.precision[:] = 1.0
                linearise(batch, group, count, k, x, reading)
                learn(noise, batch.present, group, count, k, p, search, reading)
                spent[:, 1] += 1
        for r in range(count):
            counts[first + r, 0], counts[first + r, 1] = spent[r, 0], spent[r, 1]


def iterated(
    block: ProblemBlock, iterations: int, loss: str, threshold: float, memory: int
) -> EstimateBlock:
    """Run the filter.

    Parameters
    ----------
    block : the runs.
    iterations : most linearisations of h per epoch.
    loss, threshold : on each whitened component of a reading, see :mod:`.robust_weights`.
    memory : readings from which the noise is estimated, see :mod:`.adaptive_noise`; 0 for none.
    """
    runs, epochs, n = block.runs, block.epochs, block.dimension
    mean, cov = np.empty((runs, epochs, n)), np.empty((runs, epochs, n, n))
    nis, counts = np.empty((runs, epochs)), np.zeros((runs, 2), dtype=np.int64)
    rules = Rules(iterations, _HALVINGS, number_of(loss, threshold), threshold, True)
    _iterated(batch_of(block), rules, memory, mean, cov, nis, counts)
    info = {"linearisations": counts[:, 0], "map_evaluations": counts[:, 1]}
    return EstimateBlock(mean, cov, "filter", nis=nis, info=info)
