"""The Gaussian-sum filter on many runs, compiled: the hypotheses of a run are its lanes.

A test holds it to the same equations in NumPy.
"""

from __future__ import annotations

import math

import numpy as np

from ..block import EstimateBlock, ProblemBlock
from ..numerics import lane_algebra, lanes
from ..numerics.kernels import compiled
from ..numerics.records import record
from .banks import split_prior
from .iterated_update import Rules, minimise, search_of, update
from .robust_weights import NONE, number_of
from .whitened_measurements import Batch, batch_of, linearise, readings_of

WIDTH = 0.6
"""Standard deviation of a Gaussian over the grid's spacing: their sum ripples by less than 1 %."""
NEGLIGIBLE = 1e-6
"""Weight against the largest one below which a hypothesis is dropped."""
SAME = 1.0
"""Squared Mahalanobis distance of the means below which two hypotheses are one."""
HALVINGS = 6


@record
class Hypotheses:
    """Gaussians of a mixture.

    Attributes
    ----------
    weights : (J,) logarithms, up to a common constant.
    means : (J, n).
    covs : (J, n, n).
    """

    weights: np.ndarray
    means: np.ndarray
    covs: np.ndarray


@compiled
def _filter(
    batch: Batch,
    prior: Hypotheses,
    rules: Rules,
    mean: np.ndarray,
    cov: np.ndarray,
    evidence: np.ndarray,
    counts: np.ndarray,
    sizes: np.ndarray,
) -> None:
    """Fill mean (R, K, n), cov (R, K, n, n), evidence (R, K), counts of h and mean sizes (R,).

    The mean is NaN from the epoch on at which no hypothesis has a finite likelihood.

    Parameters
    ----------
    prior : J hypotheses of one covariance (1, n, n).
    evidence : (0, 0) if it is not wanted, and then takes no time.
    """
    runs, epochs = batch.measurements.shape[:2]
    most, n = prior.means.shape
    expected = lanes.moving_states(batch.transition, batch.process_cov)
    phi, q = lanes.lanes(n, n), lanes.lanes(n, n)
    x, p, scratch = lanes.lanes(1, n), lanes.lanes(n, n), lanes.lanes(n, n)
    reading = readings_of(batch, rules.loss != NONE)
    m = reading.rows.shape[0]
    search = search_of(batch, rules, reading)
    now = Hypotheses(np.empty(most), np.empty((most, n)), np.empty((most, n, n)))
    everyone = np.zeros(most, dtype=np.int64)
    for run in range(runs):
        group = lanes.group_members(run, run + 1)
        search.counts[:] = 0
        count = most
        for j in range(most):
            now.weights[j] = prior.weights[j]
            for a in range(n):
                now.means[j, a] = prior.means[j, a]
                for b in range(n):
                    now.covs[j, a, b] = prior.covs[0, a, b]
        total, before = 0, 0.0
        if evidence.shape[0] > 0:
            before = _log_sum(now.weights[:count])
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
            for first in lanes.group_starts(count):
                used = lanes.count_from(first, count)
                _pack(now, first, used, x, p)
                lane_algebra.predict(phi, q, moving, x, p, scratch)
                linearise(batch, group, used, k, x, reading)
                minimise(search, group, used, k, x, p)
                update(search, x, p, scratch)
                if rules.iterations == 1:
                    lane_algebra.add_squares(search.white, m, reading.squared)
                    for r in range(used):
                        search.cost[r] = 0.5 * reading.squared[0, 0, r]
                for r in range(used):
                    # The diagonal of a factor is inverted.
                    now.weights[first + r] -= search.cost[r]
                    for c in range(m):
                        now.weights[first + r] += math.log(search.s[c, c, r])
                _unpack(x, p, first, used, now)
            if evidence.shape[0] > 0:
                evidence[run, k] = _log_sum(now.weights[:count]) - before
            count = _dropped(now, count)
            if count == 0:
                mean[run, k:] = np.nan
                cov[run, k:] = np.nan
                evidence[run : run + 1, k:] = -math.inf
                break
            count = _merged(now, count)
            if evidence.shape[0] > 0:
                before = _log_sum(now.weights[:count])
            total += count
            _moments(now, everyone[:count], 0, 0.0, mean[run, k], cov[run, k])
        counts[run], sizes[run] = search.counts[:, 1].sum(), total / epochs


@compiled
def _log_sum(weights: np.ndarray) -> float:
    """Return the logarithm of the sum of the weights whose logarithms (J,) are finite; or −∞."""
    largest = -math.inf
    for weight in weights:
        if math.isfinite(weight) and weight > largest:
            largest = weight
    total = 0.0
    for weight in weights:
        if math.isfinite(weight):
            total += math.exp(weight - largest)
    return largest + math.log(total) if total > 0.0 else -math.inf


@compiled
def _pack(source: Hypotheses, first: int, used: int, x: np.ndarray, p: np.ndarray) -> None:
    """Fill lanes with hypotheses from ``first`` on; the last one repeats."""
    n = source.means.shape[1]
    for r in lanes.each():
        j = first + min(r, used - 1)
        for a in range(n):
            x[0, a, r] = source.means[j, a]
            for b in range(n):
                p[a, b, r] = source.covs[j, a, b]


@compiled
def _unpack(x: np.ndarray, p: np.ndarray, first: int, used: int, out: Hypotheses) -> None:
    """Write the used lanes back."""
    n = out.means.shape[1]
    for r in range(used):
        for a in range(n):
            out.means[first + r, a] = x[0, a, r]
            for b in range(n):
                out.covs[first + r, a, b] = p[a, b, r]


@compiled
def _copy(source: Hypotheses, j: int, out: Hypotheses, place: int) -> None:
    """Copy a hypothesis."""
    n = source.means.shape[1]
    out.weights[place] = source.weights[j]
    for a in range(n):
        out.means[place, a] = source.means[j, a]
        for b in range(n):
            out.covs[place, a, b] = source.covs[j, a, b]


@compiled
def _dropped(now: Hypotheses, count: int) -> int:
    """Keep the hypotheses that weigh something against the heaviest; return how many."""
    weights, largest = now.weights, -math.inf
    for j in range(count):
        if math.isfinite(weights[j]) and weights[j] > largest:
            largest = weights[j]
    kept = 0
    for j in range(count):
        if weights[j] - largest > math.log(NEGLIGIBLE):
            weights[j] -= largest
            if kept < j:
                _copy(now, j, now, kept)
            kept += 1
    return kept


@compiled
def _merged(now: Hypotheses, count: int) -> int:
    """Merge hypotheses whose means are the same (Salmond 1990); return how many are left.

    From the heaviest on, each takes in the lighter ones within its deviations, so that mean and
    covariance of their sum are kept.
    """
    if count == 1:
        return count
    weights, means, covs = now.weights, now.means, now.covs
    n = means.shape[1]
    order = np.argsort(-weights[:count], kind="mergesort")
    leader = np.full(count, -1)
    root, off = np.empty((n, n)), np.empty(n)
    for first in order:
        if leader[first] >= 0:
            continue
        leader[first] = first
        factorised = False
        for other in order:
            if leader[other] >= 0:
                continue
            near = True
            for i in range(n):  # d² ≥ off² / P_ii: most pairs need no more than this
                off[i] = means[other, i] - means[first, i]
                if off[i] * off[i] > SAME * covs[first, i, i]:
                    near = False
                    break
            if not near:
                continue
            if not factorised:
                _root(covs[first], root)
                factorised = True
            distance = 0.0
            for i in range(n):
                for j in range(i):
                    off[i] -= root[i, j] * off[j]
                off[i] /= root[i, i]
                distance += off[i] * off[i]
            if distance < SAME:
                leader[other] = first
    if (leader == np.arange(count)).all():
        return count
    heads = order[leader[order] == order]
    new = len(heads)
    merged = Hypotheses(np.empty(new), np.empty((new, n)), np.empty((new, n, n)))
    for place in range(new):
        first = heads[place]
        total = _moments(
            now, leader, first, weights[first], merged.means[place], merged.covs[place]
        )
        merged.weights[place] = weights[first] + math.log(total)
    for place in range(new):
        _copy(merged, place, now, place)
    return new


@compiled
def _root(matrix: np.ndarray, root: np.ndarray) -> None:
    """Fill the lower triangle of L, L Lᵀ = a matrix; NaN where it is not positive definite."""
    for i in range(matrix.shape[0]):
        for j in range(i + 1):
            total = matrix[i, j]
            for k in range(j):
                total -= root[i, k] * root[j, k]
            root[i, j] = math.sqrt(total) if i == j else total / root[j, j]


@compiled
def _moments(
    now: Hypotheses,
    leader: np.ndarray,
    first: int,
    log_unit: float,
    mean: np.ndarray,
    cov: np.ndarray,
) -> float:
    """Fill mean (n,) and covariance (n, n) of the hypotheses whose leader (J,) is ``first``.

    Return what they weigh together, in a unit of which the logarithm is given.
    """
    weights, means, covs = now.weights, now.means, now.covs
    n = means.shape[1]
    total = 0.0
    mean[:] = 0.0
    cov[:] = 0.0
    for j in range(len(leader)):
        if leader[j] == first:
            share = math.exp(weights[j] - log_unit)
            total += share
            for a in range(n):
                mean[a] += share * means[j, a]
    for a in range(n):
        mean[a] /= total
    for j in range(len(leader)):
        if leader[j] == first:
            share = math.exp(weights[j] - log_unit) / total
            for a in range(n):
                for b in range(n):
                    apart = (means[j, a] - mean[a]) * (means[j, b] - mean[b])
                    cov[a, b] += share * (covs[j, a, b] + apart)
    return total


def gaussian_sum(
    block: ProblemBlock, spacing_m: float, most: int, iterations: int, loss: str, threshold: float
) -> EstimateBlock:
    """Run the filter.

    Parameters
    ----------
    block : the runs.
    spacing_m, most : of the prior's Gaussians, see :func:`.split_prior`.
    iterations : linearisations of h in each update of a hypothesis.
    loss, threshold : on each whitened component of a reading, see :mod:`.robust_weights`.
    """
    rules = Rules(iterations, HALVINGS, number_of(loss, threshold), threshold, False)
    return _run(block, spacing_m, most, rules, np.empty((0, 0)))


def gaussian_sum_with_evidence(
    block: ProblemBlock, spacing_m: float, most: int, iterations: int, loss: str, threshold: float
) -> tuple[EstimateBlock, np.ndarray]:
    """Run the filter; return the estimates and the evidence of each epoch's readings (R, K).

    See :func:`.extended_with_evidence`.
    """
    rules = Rules(iterations, HALVINGS, number_of(loss, threshold), threshold, False)
    evidence = np.empty((block.runs, block.epochs))
    return _run(block, spacing_m, most, rules, evidence), evidence


def _run(
    block: ProblemBlock, spacing_m: float, most: int, rules: Rules, evidence: np.ndarray
) -> EstimateBlock:
    """Run the filter; fill the evidence unless it is empty."""
    runs, epochs, n = block.runs, block.epochs, block.dimension
    mean, cov = np.empty((runs, epochs, n)), np.empty((runs, epochs, n, n))
    weights, means, covs = split_prior(block.problem(0), spacing_m, most, WIDTH)
    scale = np.sqrt(np.diag(block.prior_cov))
    counts, sizes = np.zeros(runs, dtype=np.int64), np.zeros(runs)
    prior = Hypotheses(weights, means * scale, covs[:1] * np.outer(scale, scale))
    _filter(
        batch=batch_of(block),
        prior=prior,
        rules=rules,
        mean=mean,
        cov=cov,
        evidence=evidence,
        counts=counts,
        sizes=sizes,
    )
    started = np.full(runs, len(weights))
    info = {"hypotheses": started, "mean_hypotheses": sizes, "map_evaluations": counts}
    return EstimateBlock(mean, cov, "filter", info=info)
