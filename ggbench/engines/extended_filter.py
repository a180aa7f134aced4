"""Compiled extended Kalman filter for many runs: plain, iterated, robust, adaptive, gated.

Tests compare the plain filter with filterpy, and the other filters with the same equations in
filterpy and NumPy.

The adaptive filter estimates the noise variance of each component of a whitened measurement. The
estimate follows from the residuals of updates (Mohamed & Schwarz 1999) and has the fading memory of
Sage & Husa (1969).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..block import EstimateBlock, ProblemBlock
from ..numerics import lane_algebra, lanes
from ..numerics.kernels import compiled
from ..numerics.records import record
from .innovation_gating import GateOptions, gate_options, reject, underweight
from .iterated_update import Rules, Search, minimise, search_of, update
from .robust_weights import NONE, number_of
from .whitened_measurements import (
    Batch,
    LinearisedMeasurement,
    batch_of,
    linearise,
    readings_of,
    scale_equations,
    scatter_squares,
)

HALVINGS = 12


@record
class AdaptiveNoise:
    """Noise estimates of eight runs, one run per lane.

    Attributes
    ----------
    memory : number of measurements over which the variances are estimated; 0 keeps the assumed
        noise.
    variances : (1, m, lanes) variance of each component, relative to the assumed noise.
    taken : (1, m, lanes) number of processed measurements of each component, plus one for the
        assumed noise; at most ``memory``.
    """

    memory: int
    variances: np.ndarray
    taken: np.ndarray


@compiled
def apply_noise_estimate(noise: AdaptiveNoise, reading: LinearisedMeasurement) -> None:
    """Whiten a measurement (1, m, lanes) with the estimated noise.

    The measurement equations are multiplied by factors, which stay in ``reading.precision``.
    Therefore :func:`.linearise` also applies these factors, until they are reset.
    """
    for c in range(reading.precision.shape[1]):
        for r in range(reading.precision.shape[2]):
            reading.precision[0, c, r] = 1.0 / math.sqrt(noise.variances[0, c, r])
    scale_equations(reading)


@compiled
def update_noise_estimate(
    noise: AdaptiveNoise, search: Search, group: np.ndarray, count: int, k: int, p: np.ndarray
) -> None:
    """Update the noise estimate with the residuals after an update.

    The expected squares of these residuals are the diagonal of R − H P⁺ Hᵀ.

    Parameters
    ----------
    search : the update; its measurement is linearised at the updated state and whitened by the
        assumed noise.
    group : (lanes,) index of the run in each lane; unused lanes repeat a run.
    count : number of different runs in the group.
    k : epoch.
    p : (n, n, lanes) covariance P⁺ after the update.
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


class UpdateOptions(NamedTuple):
    """Options of measurement updates; the default values give the plain filter.

    A plain update has one linearisation, no loss and no noise estimate.

    Attributes
    ----------
    iterations : largest number of linearisations of h per epoch.
    loss, threshold : robust loss on each whitened component of a measurement, see
        :mod:`.robust_weights`.
    noise_memory : number of measurements over which the noise is estimated; 0 keeps the assumed
        noise.
    gate : probability that the gate accepts a measurement without outlier, see
        :mod:`.innovation_gating`; 0: no gate.
        The gate applies to plain updates only.
    underweighting : factor β of the underweighting, see :mod:`.innovation_gating`; 0 for none.
        The underweighting applies to plain updates only.
    """

    iterations: int = 1
    loss: str = "none"
    threshold: float = np.inf
    noise_memory: int = 0
    gate: float = 0.0
    underweighting: float = 0.0


@compiled
def scatter_evidence(
    squared: np.ndarray, lower: np.ndarray, first: int, count: int, k: int, evidence: np.ndarray
) -> None:
    """Write ln p(z_k | z_0 … z_{k−1}) of a group of runs, without the noise term −½ ln |2π R|.

    Parameters
    ----------
    squared : (1, 1, lanes) twice the minimum cost of the update.
    lower : (m, m, lanes) Cholesky factor of H P Hᵀ + I with inverted diagonal.
    first : index of the run in the first lane.
    count : number of runs in the group.
    k : epoch.
    evidence : (R, K) output.
    """
    for r in range(count):
        total = -0.5 * squared[0, 0, r]
        for c in range(lower.shape[0]):
            total += math.log(lower[c, c, r])
        evidence[first + r, k] = total


@record
class Starts:
    """State of each run before its first epoch.

    Attributes
    ----------
    means : (R, 1, n) mean states.
    covs : (R, 1, n, n) covariances.
    """

    means: np.ndarray
    covs: np.ndarray


def prior_of(block: ProblemBlock) -> Starts:
    """Return the prior of a block as the start of each run."""
    means = np.tile(block.prior_mean, (block.runs, 1, 1))
    return Starts(means, np.tile(block.prior_cov, (block.runs, 1, 1, 1)))


@compiled
def _extended(
    batch: Batch,
    starts: Starts,
    rules: Rules | None,
    memory: int,
    whole: bool,
    gating: GateOptions,
    mean: np.ndarray,
    cov: np.ndarray,
    nis: np.ndarray,
    evidence: np.ndarray,
    counts: np.ndarray,
) -> None:
    """Fill mean (R, K, n), cov (R, K, n, n), NIS (R, K), evidence (R, K).

    Parameters
    ----------
    rules : options of the iterated update; None for the plain update. Branches on None are resolved
        by the compiler, so the plain filter contains no code of the iterated update.
    memory : see :class:`AdaptiveNoise`.
    whole : see :func:`.readings_of`.
    gating : gate and underweighting of plain updates.
    evidence : (R, K) output; with shape (0, 0) it is not computed.
    counts : (R, 3) output: numbers of linearisations, evaluations of h and rejected measurements.
    """
    runs, epochs, n = batch.transition.shape[:3]
    expected = lanes.moving_states(batch.transition, batch.process_cov)
    phi, q = lanes.lanes(n, n), lanes.lanes(n, n)
    x, p, scratch = lanes.lanes(1, n), lanes.lanes(n, n), lanes.lanes(n, n)
    reading = readings_of(batch, whole)
    m = reading.rows.shape[0]
    hp, half, gain = lanes.lanes(m, n), lanes.lanes(m, n), lanes.lanes(m, n)
    s, white, unexplained = lanes.lanes(m, m), lanes.lanes(1, m), lanes.lanes(1, 1)
    weighed, spread = lanes.lanes(m, m), lanes.lanes(m, m)
    if rules is not None:
        search = search_of(batch, rules, reading)
        noise = AdaptiveNoise(memory, lanes.lanes(1, m), lanes.lanes(1, m))
    for first in lanes.group_starts(runs):
        count, group = lanes.count_from(first, runs), lanes.group_members(first, runs)
        lanes.gather_row(starts.means, group, 0, x)
        lanes.gather_rows(starts.covs, group, 0, n, p)
        if rules is not None:
            search.counts[:] = 0
            noise.variances[:] = 1.0
            noise.taken[:] = 1.0
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
            lane_algebra.predict(phi, q, moving, x, p, scratch)
            linearise(batch, group, count, k, x, reading)
            # The square of the innovation is that of every filter: linearised at the prediction,
            # with the given noise.
            lane_algebra.copy(reading.squared, unexplained)
            lane_algebra.project(reading.rows, p, m, hp, s)
            if gating.underweighting > 0.0:
                lane_algebra.copy(s, weighed)
                underweight(weighed, np.eye(m), gating.underweighting, spread)
            lane_algebra.factorise(s, m, s)
            lane_algebra.whiten(s, m, reading.innovation, white)
            lane_algebra.add_squares(white, m, reading.squared)
            scatter_squares(reading, first, count, k, nis)
            if rules is None:
                if gating.underweighting > 0.0:
                    lane_algebra.factorise(weighed, m, s)
                    lane_algebra.whiten(s, m, reading.innovation, white)
                lane_algebra.solve_lower(s, m, hp, half)
                if gating.limits.shape[0] > 0:
                    lane_algebra.add_squares(white, m, unexplained)
                    reject(
                        squared=unexplained,
                        limits=gating.limits,
                        first=first,
                        count=count,
                        k=k,
                        half_gain=half,
                        rejected=counts[:, 2],
                    )
                lane_algebra.correct(half, white, m, x)
                lane_algebra.solve_upper(s, m, half, gain)
                lane_algebra.joseph(
                    gain=gain, hp=hp, rows=reading.rows, m=m, p=p, scratch=scratch, change=half
                )
                if evidence.shape[0] > 0:
                    scatter_evidence(reading.squared, s, first, count, k, evidence)
                counts[first : first + count, :2] += 1
            else:
                lane_algebra.copy(unexplained, reading.squared)
                if memory > 0:
                    apply_noise_estimate(noise, reading)
                minimise(search, group, count, k, x, p)
                update(search, x, p, scratch)
                if evidence.shape[0] > 0:
                    if rules.iterations == 1:
                        lane_algebra.add_squares(search.white, m, reading.squared)
                    else:
                        for r in range(count):
                            reading.squared[0, 0, r] = 2.0 * search.cost[r]
                    scatter_evidence(reading.squared, search.s, first, count, k, evidence)
                if memory > 0:
                    reading.precision[:] = 1.0
                    linearise(batch, group, count, k, x, reading)
                    update_noise_estimate(noise, search, group, count, k, p)
                    search.counts[:, 1] += 1
            lanes.scatter(x=x, p=p, first=first, count=count, k=k, mean=mean, cov=cov)
        if rules is not None:
            counts[first : first + count, :2] = search.counts[:count]


def extended(block: ProblemBlock, options: UpdateOptions) -> EstimateBlock:
    """Run the extended Kalman filter.

    The NIS uses the assumed noise and includes measurements that a gate rejects.

    Parameters
    ----------
    block : block of R runs.
    options : options of the measurement updates.
    """
    return _run(block, options, prior_of(block), np.empty((0, 0)))


def extended_with_evidence(
    block: ProblemBlock, options: UpdateOptions, starts: Starts | None = None
) -> tuple[EstimateBlock, np.ndarray]:
    """Run the extended Kalman filter; return the estimates and the evidence of each epoch (R, K).

    The evidence is ln p(z_k | z_0 … z_{k−1}) without the noise term −½ ln |2π R|. For an iterated
    update it is Laplace's approximation.

    Parameters
    ----------
    starts : initial states; by default the prior of the block.
    """
    evidence = np.empty((block.runs, block.epochs))
    starts = prior_of(block) if starts is None else starts
    return _run(block, options, starts, evidence), evidence


def _run(
    block: ProblemBlock, options: UpdateOptions, starts: Starts, evidence: np.ndarray
) -> EstimateBlock:
    """Run the filter; fill the evidence unless it is empty."""
    runs, epochs, n = block.runs, block.epochs, block.dimension
    mean, cov = np.empty((runs, epochs, n)), np.empty((runs, epochs, n, n))
    nis, counts = np.empty((runs, epochs)), np.zeros((runs, 3), dtype=np.int64)
    loss, memory = number_of(options.loss, options.threshold), options.noise_memory
    whole, rules = loss != NONE or memory > 0, None
    if options.iterations > 1 or whole:
        rules = Rules(options.iterations, HALVINGS, loss, options.threshold, True)
    gating = gate_options(block, options.gate, options.underweighting)
    _extended(
        batch=batch_of(block),
        starts=starts,
        rules=rules,
        memory=memory,
        whole=whole,
        gating=gating,
        mean=mean,
        cov=cov,
        nis=nis,
        evidence=evidence,
        counts=counts,
    )
    info = {"linearisations": counts[:, 0], "map_evaluations": counts[:, 1]}
    if options.gate:
        info["rejected"] = counts[:, 2]
    return EstimateBlock(mean, cov, "filter", nis=nis, info=info)
