"""Compiled unscented Kalman filter for many runs.

A test compares the filter with that of filterpy.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import objmode

from ..block import EstimateBlock, ProblemBlock
from ..numerics import lane_algebra, lanes
from ..numerics.kernels import compiled, interpreted
from ..numerics.positive import nearest_root
from ..numerics.vectors import load, splat, store
from ..sensors.model_kernels import moving_errors
from .innovation_gating import GateOptions, gate_options, reject, underweight
from .robust_weights import NONE, number_of, reweigh_unwhitened
from .sigma_points import SigmaPoints, read_sigma_points, sigma_points_of
from .whitened_measurements import (
    Batch,
    LinearisedMeasurement,
    batch_of,
    linearise,
    readings_of,
    scatter_squares,
)


class SigmaWeights(NamedTuple):
    """Spread and weights of sigma points.

    Attributes
    ----------
    spread : factor on the columns of the Cholesky factor of P.
    centre_cov : weight of the central point in covariances.
    weight : weight of every other point, in means and covariances.
    """

    spread: float
    centre_cov: float
    weight: float


@compiled
def _moments(
    lower: np.ndarray,
    noise_cov: np.ndarray,
    weights: SigmaWeights,
    points: SigmaPoints,
    offset: np.ndarray,
    s: np.ndarray,
    cross: np.ndarray,
) -> None:
    """Fill the offset of the mean, the lower half of S (m, m) and the cross-covariance.

    The two points of a pair deviate from h(x) by e + o and e − o. The mean of the outer products of
    these deviations is e eᵀ + o oᵀ. The weights of the mean add up to one.
    """
    m, n = points.odd.shape[0], points.odd.shape[1]
    weight = weights.weight
    double, scale = splat(2.0 * weight), splat(2.0 * weight * weights.spread)
    middle = splat(weights.centre_cov + 2.0 * weight * n - 2.0)
    for c in range(m):
        total = splat(0.0)
        for q in range(n):
            total += load(points.even, c, q)
        store(offset, 0, c, double * total)
    for c in range(m):
        for d in range(c + 1):
            total = splat(0.0)
            for q in range(n):
                total += load(points.odd, c, q) * load(points.odd, d, q)
                total += load(points.even, c, q) * load(points.even, d, q)
            product = load(offset, 0, c) * load(offset, 0, d)
            store(s, c, d, splat(noise_cov[c, d]) + (double * total + middle * product))
        for j in range(n):
            total = splat(0.0)
            for q in range(j + 1):
                total += load(points.odd, c, q) * load(lower, j, q)
            store(cross, c, j, scale * total)


@interpreted
def _repaired(p: np.ndarray, r: int, lower: np.ndarray) -> np.ndarray:
    """Fill the Cholesky factor of the repaired P of lane ``r``; return the repaired P (n, n).

    The repair is that of :func:`.nearest_root`. ``p`` is not changed.
    """
    matrix = p[:, :, r].copy()
    # Rarely needed, and LAPACK takes ten seconds to compile.
    with objmode(upper="float64[:, :]", nearest="float64[:, :]"):
        upper = nearest_root(matrix)
        nearest = upper.T @ upper
    n = p.shape[0]
    for i in range(n):
        for j in range(i + 1):
            lower[i, j, r] = upper[j, i]
    return nearest


@compiled
def _unscented(
    batch: Batch,
    weights: SigmaWeights,
    loss: int,
    threshold: float,
    gating: GateOptions,
    mean: np.ndarray,
    cov: np.ndarray,
    nis: np.ndarray,
    counts: np.ndarray,
    rejected: np.ndarray,
) -> None:
    """Run the unscented Kalman filter on all runs, and fill the results.

    ``counts`` (R, 2) are the numbers of repaired covariances and of evaluations of h.
    """
    runs, epochs, m = batch.measurements.shape
    model, n = batch.model, batch.prior_cov.shape[0]
    expected = lanes.moving_states(batch.transition, batch.process_cov)
    phi, q = lanes.lanes(n, n), lanes.lanes(n, n)
    x, p, scratch = lanes.lanes(1, n), lanes.lanes(n, n), lanes.lanes(n, n)
    lower, inverse = lanes.lanes(n, n), lanes.lanes(1, n)
    reading = readings_of(batch)
    equations = reading.rows.shape[0]
    hp, linear = lanes.lanes(equations, n), lanes.lanes(equations, equations)
    s, white = lanes.lanes(m, m), lanes.lanes(1, max(m, equations))
    points = sigma_points_of(moving_errors(model.instrument), n, m, model.channels.shape[0])
    offset, cross, reweighed = lanes.lanes(1, m), lanes.lanes(m, n), lanes.lanes(m + 1, m)
    h_cov, gain, squared = lanes.lanes(m, m), lanes.lanes(m, n), lanes.lanes(1, 1)
    for first in lanes.group_starts(runs):
        count, group = lanes.count_from(first, runs), lanes.group_members(first, runs)
        lanes.broadcast(batch.prior_mean, x)
        lanes.broadcast(batch.prior_cov, p)
        for k in range(epochs):
            moving = lanes.gather(
                transition=batch.transition,
                process_cov=batch.process_cov,
                group=group,
                k=k,
                expected=expected,
                phi=phi,
                q=q,
            )
            # The motion is linear: sigma points through Φ have the mean Φ x and the covariance
            # Φ P Φᵀ exactly.
            lane_algebra.predict(phi, q, moving, x, p, scratch)
            lane_algebra.triangular_root(p, lower, inverse)
            for r in range(count):
                if not lane_algebra.is_positive(inverse, r):
                    counts[first + r, 0] += 1
                    _repaired(p, r, lower)
            linearise(batch, group, count, k, x, reading)
            read_sigma_points(
                model=model,
                group=group,
                count=count,
                k=k,
                x=x,
                lower=lower,
                spread=weights.spread,
                at=reading.expansion,
                out=points,
            )
            for r in range(count):
                counts[first + r, 1] += 1 + 2 * points.counts[r]
            at = min(k, batch.noise_cov.shape[0] - 1)
            r_k = batch.noise_cov[at]
            _moments(
                lower=lower,
                noise_cov=r_k,
                weights=weights,
                points=points,
                offset=offset,
                s=s,
                cross=cross,
            )
            # The square of the innovation is judged as that of every filter is, linearised.
            lane_algebra.project(reading.rows, p, equations, hp, linear)
            lane_algebra.factorise(linear, equations, linear)
            lane_algebra.whiten(linear, equations, reading.innovation, white)
            lane_algebra.add_squares(white, equations, reading.squared)
            scatter_squares(reading, first, count, k, nis)
            _innovations(reading, offset)
            if loss != NONE:
                root = batch.noise_inverse[at]
                reweigh_unwhitened(
                    s=s,
                    innovation=reading.z,
                    noise_cov=r_k,
                    noise_inverse=root,
                    count=count,
                    loss=loss,
                    threshold=threshold,
                    scratch=reweighed,
                )
            if gating.underweighting > 0.0:
                underweight(s, r_k, gating.underweighting, h_cov)
            lane_algebra.factorise(s, m, s)
            lane_algebra.whiten(s, m, reading.z, white)
            lane_algebra.solve_lower(s, m, cross, cross)
            if gating.limits.shape[0] > 0:
                squared[:] = 0.0
                lane_algebra.add_squares(white, m, squared)
                reject(
                    squared=squared,
                    limits=gating.limits,
                    first=first,
                    count=count,
                    k=k,
                    half_gain=cross,
                    rejected=rejected,
                )
            lane_algebra.correct(cross, white, m, x)
            lane_algebra.add_products(cross, cross, -1.0, p, scratch)
            p, scratch = scratch, p
            if gating.underweighting > 0.0:
                # P − K P_xzᵀ − P_xz Kᵀ + K P_zz Kᵀ with P_xz = K S and P_zz = S − β Cov h.
                lane_algebra.solve_upper(s, m, cross, gain)
                lane_algebra.product(h_cov, gain, m, cross)
                lane_algebra.add_products(gain, cross, -gating.underweighting, p, scratch)
                p, scratch = scratch, p
            lane_algebra.triangular_root(p, lower, inverse)
            for r in range(count):
                if not lane_algebra.is_positive(inverse, r):
                    counts[first + r, 0] += 1
                    nearest = _repaired(p, r, lower)
                    for i in range(n):
                        for j in range(n):
                            p[i, j, r] = nearest[i, j]
            lanes.scatter(x=x, p=p, first=first, count=count, k=k, mean=mean, cov=cov)


@compiled
def _innovations(reading: LinearisedMeasurement, offset: np.ndarray) -> None:
    """Replace the measurements z by innovations: z minus the weighted mean of h."""
    for c in range(reading.z.shape[1]):
        expected = load(reading.expansion.predicted, 0, c) + load(offset, 0, c)
        store(reading.z, 0, c, load(reading.z, 0, c) - expected)


def unscented(
    block: ProblemBlock,
    weights: SigmaWeights,
    loss: str,
    threshold: float,
    gate: float,
    underweighting: float,
) -> EstimateBlock:
    """Run the unscented Kalman filter.

    If the deviation d of sigma points x ± d displaces the instrument by less than 1 cm and rotates
    it by less than 1e-7 rad, h is linearised: h(x) ± A B_k d. Here A is the derivative of h with
    respect to B_k x, the errors of the instrument's position and attitude. The linearisation error
    is at most 5e-5 m² times the second derivative of h. At 10 km height this derivative is at most
    1e-6 E/m² (100 E/(10 km)²), and the error is below 1e-10 E. At 100 m the error is below 5e-7 E.

    Parameters
    ----------
    block : block of R runs.
    weights : spread and weights of the sigma points; the weights of a mean add up to 1.
    loss, threshold : robust loss on each whitened component of a measurement, see
        :mod:`.robust_weights`.
    gate : acceptance probability of the gate, see :mod:`.innovation_gating`; 0 for no gate. It
        must be 0 with a loss.
    underweighting : factor β of the underweighting, see :mod:`.innovation_gating`; 0 for none. It
        must be 0 with a loss.
    """
    runs, epochs, n = block.runs, block.epochs, block.dimension
    mean, cov = np.empty((runs, epochs, n)), np.empty((runs, epochs, n, n))
    nis, counts = np.empty((runs, epochs)), np.zeros((runs, 2), dtype=np.int64)
    rejected = np.zeros(runs, dtype=np.int64)
    number, gating = number_of(loss, threshold), gate_options(block, gate, underweighting)
    _unscented(
        batch=batch_of(block),
        weights=weights,
        loss=number,
        threshold=threshold,
        gating=gating,
        mean=mean,
        cov=cov,
        nis=nis,
        counts=counts,
        rejected=rejected,
    )
    info = {"covariance_repairs": counts[:, 0], "map_evaluations": counts[:, 1]}
    if gate:
        info["rejected"] = rejected
    return EstimateBlock(mean, cov, "filter", nis=nis, info=info)
