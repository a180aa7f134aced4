"""The Gaussian-sum filter on many runs, compiled: the hypotheses of a run are its lanes.

The equations are those of :class:`ggbench.estimators.gaussian_sum.GaussianSum` with NumPy, which
remains the reference: a test holds both together.
"""

from __future__ import annotations

import math

import numpy as np

from ..block import ProblemBlock
from ..numerics import lane_algebra, lanes
from ..numerics.kernels import LANES, compiled
from ..sensors.model_kernels import ModelArrays
from .banks import split_prior
from .iterated_update import Rules, minimise, search_of, update
from .robust_weights import NONE
from .whitened_readings import linearise, noise_inverse, readings_of


@compiled
def _filter(
    measurements: np.ndarray,
    noise_inverse: np.ndarray,
    transition: np.ndarray,
    process_cov: np.ndarray,
    model: ModelArrays,
    first_weights: np.ndarray,
    first_means: np.ndarray,
    first_cov: np.ndarray,
    rules: Rules,
    negligible: float,
    same: float,
    mean: np.ndarray,
    cov: np.ndarray,
    counts: np.ndarray,
    sizes: np.ndarray,
) -> None:
    """Fill mean (R, K, n), cov (R, K, n, n), counts of h (R,) and mean numbers of hypotheses (R,).

    The mean is NaN from the epoch on at which no hypothesis has a finite likelihood.
    """
    runs, epochs, m = measurements.shape
    most, n = first_means.shape
    expected = lanes.moving_states(transition, process_cov)
    phi, q = lanes.lanes(n, n), lanes.lanes(n, n)
    x, p, scratch = lanes.lanes(1, n), lanes.lanes(n, n), lanes.lanes(n, n)
    reading = readings_of(model, n, m, rules.loss != NONE)
    m = reading.rows.shape[0]
    search = search_of(n, m)
    weights, means, covs = np.empty(most), np.empty((most, n)), np.empty((most, n, n))
    group, told = np.empty(LANES, dtype=np.int64), np.zeros((LANES, 2), dtype=np.int64)
    for run in range(runs):
        group[:] = run
        told[:] = 0
        count = most
        for j in range(most):
            weights[j] = first_weights[j]
            for a in range(n):
                means[j, a] = first_means[j, a]
                for b in range(n):
                    covs[j, a, b] = first_cov[a, b]
        total = 0
        for k in range(epochs):
            moving = lanes.gather(transition, process_cov, group, k, expected, phi, q)
            for first in range(0, count, LANES):
                used = min(LANES, count - first)
                _pack(means, covs, first, used, x, p)
                lane_algebra.predict(phi, q, moving, x, p, scratch)
                linearise(model, measurements, noise_inverse, group, used, k, x, reading)
                minimise(
                    model, measurements, noise_inverse, group, used, k, rules, x, p, reading,
                    search, told,
                )  # fmt: skip
                update(rules, x, p, search, scratch)
                if rules.iterations == 1:
                    lane_algebra.add_squares(search.white, m, reading.squared)
                    for r in range(used):
                        search.cost[r] = 0.5 * reading.squared[0, 0, r]
                for r in range(used):
                    # The diagonal of a factor is inverted.
                    weights[first + r] -= search.cost[r]
                    for c in range(m):
                        weights[first + r] += math.log(search.s[c, c, r])
                _unpack(x, p, first, used, means, covs)
            count = _dropped(weights, means, covs, count, negligible)
            if count == 0:
                mean[run, k:] = np.nan
                cov[run, k:] = np.nan
                break
            count = _merged(weights, means, covs, count, same)
            total += count
            _moments(weights, means, covs, count, mean[run, k], cov[run, k])
        counts[run], sizes[run] = told[:, 1].sum(), total / epochs


@compiled
def _pack(
    means: np.ndarray, covs: np.ndarray, first: int, used: int, x: np.ndarray, p: np.ndarray
) -> None:
    """Fill lanes with hypotheses from ``first`` on; the last one repeats."""
    n = means.shape[1]
    for r in range(LANES):
        j = first + min(r, used - 1)
        for a in range(n):
            x[0, a, r] = means[j, a]
            for b in range(n):
                p[a, b, r] = covs[j, a, b]


@compiled
def _unpack(
    x: np.ndarray, p: np.ndarray, first: int, used: int, means: np.ndarray, covs: np.ndarray
) -> None:
    """Write the used lanes back."""
    n = means.shape[1]
    for r in range(used):
        for a in range(n):
            means[first + r, a] = x[0, a, r]
            for b in range(n):
                covs[first + r, a, b] = p[a, b, r]


@compiled
def _move(
    weights: np.ndarray, means: np.ndarray, covs: np.ndarray, source: int, place: int
) -> None:
    """Copy a hypothesis to another place."""
    n = means.shape[1]
    weights[place] = weights[source]
    for a in range(n):
        means[place, a] = means[source, a]
        for b in range(n):
            covs[place, a, b] = covs[source, a, b]


@compiled
def _dropped(
    weights: np.ndarray, means: np.ndarray, covs: np.ndarray, count: int, negligible: float
) -> int:
    """Keep the hypotheses that weigh something against the heaviest; return how many."""
    largest = -math.inf
    for j in range(count):
        if math.isfinite(weights[j]) and weights[j] > largest:
            largest = weights[j]
    kept = 0
    for j in range(count):
        if weights[j] - largest > math.log(negligible):
            weights[j] -= largest
            if kept < j:
                _move(weights, means, covs, j, kept)
            kept += 1
    return kept


@compiled
def _merged(
    weights: np.ndarray, means: np.ndarray, covs: np.ndarray, count: int, same: float
) -> int:
    """Merge hypotheses whose means are the same (Salmond 1990); return how many are left.

    From the heaviest on, each takes in the lighter ones within its deviations, so that mean and
    covariance of their sum are kept.
    """
    if count == 1:
        return count
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
                if off[i] * off[i] > same * covs[first, i, i]:
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
            if distance < same:
                leader[other] = first
    if (leader == np.arange(count)).all():
        return count
    heads = order[leader[order] == order]
    new = len(heads)
    new_weights, new_means = np.empty(new), np.zeros((new, n))
    new_covs = np.zeros((new, n, n))
    for place in range(new):
        first, total = heads[place], 0.0
        for j in range(count):
            if leader[j] == first:
                share = math.exp(weights[j] - weights[first])
                total += share
                for a in range(n):
                    new_means[place, a] += share * means[j, a]
        for a in range(n):
            new_means[place, a] /= total
        for j in range(count):
            if leader[j] == first:
                share = math.exp(weights[j] - weights[first]) / total
                for a in range(n):
                    for b in range(n):
                        apart = (means[j, a] - new_means[place, a]) * (
                            means[j, b] - new_means[place, b]
                        )
                        new_covs[place, a, b] += share * (covs[j, a, b] + apart)
        new_weights[place] = weights[first] + math.log(total)
    for place in range(new):
        weights[place] = new_weights[place]
        for a in range(n):
            means[place, a] = new_means[place, a]
            for b in range(n):
                covs[place, a, b] = new_covs[place, a, b]
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
    weights: np.ndarray,
    means: np.ndarray,
    covs: np.ndarray,
    count: int,
    mean: np.ndarray,
    cov: np.ndarray,
) -> None:
    """Fill mean (n,) and covariance (n, n) of the mixture."""
    n = means.shape[1]
    total = 0.0
    mean[:] = 0.0
    cov[:] = 0.0
    for j in range(count):
        share = math.exp(weights[j])
        total += share
        for a in range(n):
            mean[a] += share * means[j, a]
    for a in range(n):
        mean[a] /= total
    for j in range(count):
        share = math.exp(weights[j]) / total
        for a in range(n):
            for b in range(n):
                apart = (means[j, a] - mean[a]) * (means[j, b] - mean[b])
                cov[a, b] += share * (covs[j, a, b] + apart)


def gaussian_sum(
    block: ProblemBlock,
    spacing_m: float,
    most: int,
    width: float,
    rules: Rules,
    negligible: float,
    same: float,
) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]:
    """Run the filter.

    Parameters
    ----------
    block : the runs. spacing_m, most, width : of the prior's Gaussians, see :func:`.split_prior`.
    rules : of each update.
    negligible : weight against the largest one below which a hypothesis is dropped.
    same : squared Mahalanobis distance below which two are one.

    Returns
    -------
    mean (R, K, n), cov (R, K, n, n) of the mixture; counters.
    """
    runs, epochs, n = block.runs, block.epochs, block.dimension
    mean, cov = np.empty((runs, epochs, n)), np.empty((runs, epochs, n, n))
    weights, means, covs = split_prior(block.problem(0), spacing_m, most, width)
    scale = np.sqrt(np.diag(block.prior_cov))
    counts, sizes = np.zeros(runs, dtype=np.int64), np.zeros(runs)
    _filter(
        block.measurements, noise_inverse(block), block.transition, block.process_cov, block.model,
        weights, means * scale, covs[0] * np.outer(scale, scale), rules, negligible, same,
        mean, cov, counts, sizes,
    )  # fmt: skip
    started = np.full(runs, len(weights))
    info = {"hypotheses": started, "mean_hypotheses": sizes, "map_evaluations": counts}
    return mean, cov, info
