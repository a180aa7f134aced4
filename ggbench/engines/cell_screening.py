"""First epoch of Gaussian sums that differ only in the noise level.

The predictions and linearisations at the first epoch do not depend on the noise level. They are
computed once for all Gaussian sums. Most Gaussians have negligible weight after the first
measurement. Screening drops these Gaussians, so they need no update. A Gaussian sum with a robust
loss is screened separately.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..block import ProblemBlock
from ..numerics import lane_algebra, lanes
from ..numerics.kernels import compiled
from ..numerics.vectors import load, splat, store
from .gaussian_sum import HALVINGS, NEGLIGIBLE, Hypotheses
from .iterated_update import Rules, minimise, search_of
from .robust_weights import number_of
from .whitened_measurements import Batch, batch_of, linearise, readings_of

_MARGIN = 1e-3
"""Margin for rounding of the log weight ratio below which Gaussians are dropped."""


class Screened(NamedTuple):
    """Result of screening the Gaussians of a wide prior at the first epoch.

    Attributes
    ----------
    prior : the remaining Gaussians, with their weights before the first epoch.
    evidence : evidence of the measurements of the first epoch, see :func:`.extended_with_evidence`.
    """

    prior: Hypotheses
    evidence: float


def screened(block: ProblemBlock, prior: Hypotheses, precisions: np.ndarray) -> list[Screened]:
    """Return the result of screening at the first epoch for each of S noise levels.

    Parameters
    ----------
    block : block of one run.
    prior : Gaussians of the prior, from :func:`.prior_cells`.
    precisions : (S, equations) factors on the whitened measurement equations for each noise level.
        A factor is the noise standard deviation that the block assumes, divided by that of the
        noise level.
    """
    weights = np.empty((len(precisions), len(prior.weights)))
    _screen(batch_of(block), prior, precisions, weights)
    return [_kept(prior, own) for own in weights]


def screened_with_loss(
    block: ProblemBlock, prior: Hypotheses, iterations: int, loss: str, threshold: float
) -> tuple[Screened, int]:
    """Return the result of screening with a robust loss, and the number of evaluations of h.

    Parameters
    ----------
    block : block of one run.
    prior : Gaussians of the prior, from :func:`.prior_cells`.
    iterations, loss, threshold : see :func:`.gaussian_sum`. ``iterations`` is at least 2.
    """
    rules = Rules(iterations, HALVINGS, number_of(loss, threshold), threshold, False)
    weights = np.empty(len(prior.weights))
    evaluations = _screen_with_loss(batch_of(block), prior, rules, weights)
    return _kept(prior, weights), evaluations


def _kept(prior: Hypotheses, weights: np.ndarray) -> Screened:
    """Return the result of screening from the log weights (J,) after the first epoch."""
    weights = np.where(np.isfinite(weights), weights, -np.inf)
    kept = weights > weights.max() + math.log(NEGLIGIBLE) - _MARGIN
    if not np.isfinite(weights.max()):
        kept[:] = True
    part = Hypotheses(prior.weights[kept], prior.means[kept], prior.covs)
    evidence = np.logaddexp.reduce(weights) - np.logaddexp.reduce(prior.weights)
    return Screened(part, float(evidence))


@compiled
def _predict(
    batch: Batch, prior: Hypotheses, group: np.ndarray, phi: np.ndarray, p: np.ndarray
) -> int:
    """Fill Φ and the predicted covariance; return the number of states that Φ changes.

    ``phi`` and the common covariance ``p`` are (n, n, lanes) at the first epoch. Every lane of
    ``group`` (lanes,) contains the same run.
    """
    n = prior.means.shape[1]
    q, x, scratch = lanes.lanes(n, n), lanes.lanes(1, n), lanes.lanes(n, n)
    moving = lanes.gather(
        transition=batch.transition,
        process_cov=batch.process_cov,
        group=group,
        k=0,
        expected=lanes.moving_states(batch.transition, batch.process_cov),
        phi=phi,
        q=q,
    )
    lanes.broadcast(prior.covs[0], p)
    lane_algebra.predict(phi, q, moving, x, p, scratch)
    return moving


@compiled
def _move_means(
    prior: Hypotheses,
    first: int,
    count: int,
    phi: np.ndarray,
    moving: int,
    x: np.ndarray,
    scratch: np.ndarray,
) -> None:
    """Fill the predicted means (1, n, lanes) of the ``count`` Gaussians from ``first`` on."""
    for r in lanes.each():
        for i in range(prior.means.shape[1]):
            x[0, i, r] = prior.means[first + min(r, count - 1), i]
    lane_algebra.move(phi, max(moving, 3), x, scratch)


@compiled
def _screen(batch: Batch, prior: Hypotheses, precisions: np.ndarray, weights: np.ndarray) -> None:
    """Fill the logarithms of the weights (S, J) after the first epoch."""
    most, n = prior.means.shape
    phi, p = lanes.lanes(n, n), lanes.lanes(n, n)
    x, scratch = lanes.lanes(1, n), lanes.lanes(n, n)
    reading = readings_of(batch)
    m = reading.rows.shape[0]
    hp, s, root = lanes.lanes(m, n), lanes.lanes(m, m), lanes.lanes(m, m)
    innovation, white, squared = lanes.lanes(1, m), lanes.lanes(1, m), lanes.lanes(1, 1)
    group = lanes.group_members(0, 1)
    moving = _predict(batch, prior, group, phi, p)
    for first in lanes.group_starts(most):
        count = lanes.count_from(first, most)
        _move_means(prior, first, count, phi, moving, x, scratch)
        linearise(batch, group, count, 0, x, reading)
        lane_algebra.project(reading.rows, p, m, hp, s)
        for noise in range(len(precisions)):
            scale = precisions[noise]
            for c in range(m):
                store(innovation, 0, c, scale[c] * load(reading.innovation, 0, c))
                for d in range(c):
                    store(root, c, d, (scale[c] * scale[d]) * load(s, c, d))
                explained = load(s, c, c) - splat(1.0)
                store(root, c, c, (scale[c] * scale[c]) * explained + splat(1.0))
            lane_algebra.factorise(root, m, root)
            lane_algebra.whiten(root, m, innovation, white)
            store(squared, 0, 0, (scale[0] * scale[0]) * load(reading.squared, 0, 0))
            lane_algebra.add_squares(white, m, squared)
            for r in range(count):
                inverse = 1.0
                for c in range(m):
                    inverse *= root[c, c, r]
                weights[noise, first + r] = (
                    prior.weights[first + r] - 0.5 * squared[0, 0, r] + math.log(inverse)
                )


@compiled
def _screen_with_loss(batch: Batch, prior: Hypotheses, rules: Rules, weights: np.ndarray) -> int:
    """Fill the logarithms of the weights (J,); return the number of evaluations of h."""
    most, n = prior.means.shape
    phi, p = lanes.lanes(n, n), lanes.lanes(n, n)
    x, scratch = lanes.lanes(1, n), lanes.lanes(n, n)
    reading = readings_of(batch, True)
    search = search_of(batch, rules, reading)
    group = lanes.group_members(0, 1)
    moving = _predict(batch, prior, group, phi, p)
    for first in lanes.group_starts(most):
        count = lanes.count_from(first, most)
        _move_means(prior, first, count, phi, moving, x, scratch)
        linearise(batch, group, count, 0, x, reading)
        minimise(search, group, count, 0, x, p)
        for r in range(count):
            weights[first + r] = prior.weights[first + r] - search.cost[r]
            for c in range(search.s.shape[0]):
                weights[first + r] += math.log(search.s[c, c, r])
    return search.counts[:, 1].sum()
