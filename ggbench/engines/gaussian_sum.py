"""Compiled Gaussian-sum filter, with eight Gaussians of one run in parallel.

A test compares the filter with the same equations in NumPy.
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
"""Standard deviation of each Gaussian over the spacing: the sum has ripples below 1 %."""
NEGLIGIBLE = 1e-6
"""Weight against the largest one below which a hypothesis is dropped."""
SAME = 1.0
"""Squared Mahalanobis distance of the means below which two hypotheses are one."""
HALVINGS = 6


@record
class Hypotheses:
    """J Gaussians of a mixture.

    Attributes
    ----------
    weights : (J,) logarithms of the weights, up to a common constant.
    means : (J, n) mean states.
    covs : (J, n, n) covariances, or (1, n, n) if all are equal.
    """

    weights: np.ndarray
    means: np.ndarray
    covs: np.ndarray


@compiled
def _filter(
    batch: Batch,
    prior: Hypotheses,
    space: Hypotheses,
    rules: Rules,
    mean: np.ndarray,
    cov: np.ndarray,
    counts: np.ndarray,
    sizes: np.ndarray,
) -> None:
    """Fill mean (R, K, n), cov (R, K, n, n), ``counts`` (R,) and ``sizes`` (R,).

    If no hypothesis has a finite likelihood at an epoch, the mean is NaN from this epoch on.

    Parameters
    ----------
    prior : J hypotheses with a common covariance (1, n, n).
    space : scratch from :func:`space_for`.
    counts, sizes : number of evaluations of h; mean number of Gaussians.
    """
    runs, epochs = batch.measurements.shape[:2]
    for run in range(runs):
        start(prior, space)
        advance(
            batch=batch,
            run=run,
            first=0,
            stop=epochs,
            rules=rules,
            now=space,
            mean=mean[run],
            cov=cov[run],
            evidence=np.empty(0),
            counts=counts[run : run + 1],
            sizes=sizes[run : run + 1],
        )
        sizes[run] /= epochs


@compiled
def start(prior: Hypotheses, now: Hypotheses) -> None:
    """Copy the J Gaussians of ``prior`` to ``now``.

    The Gaussians of ``prior`` have one common covariance (1, n, n). It is copied to each of the J
    covariances of ``now``.
    """
    n = prior.means.shape[1]
    for j in range(len(prior.weights)):
        now.weights[j] = prior.weights[j]
        for a in range(n):
            now.means[j, a] = prior.means[j, a]
            for b in range(n):
                now.covs[j, a, b] = prior.covs[0, a, b]


@compiled
def advance(
    batch: Batch,
    run: int,
    first: int,
    stop: int,
    rules: Rules,
    now: Hypotheses,
    mean: np.ndarray,
    cov: np.ndarray,
    evidence: np.ndarray,
    counts: np.ndarray,
    sizes: np.ndarray,
) -> int:
    """Filter the epochs ``first`` to ``stop`` − 1 of a run.

    Parameters
    ----------
    now : the Gaussians; on return the remaining Gaussians are the first entries.
    mean, cov, evidence : (K, n), (K, n, n), (K,) output; ``evidence`` is empty if it is not needed.
    counts : (1,) number of evaluations of h; those of this call are added.
    sizes : (1,) sum over the epochs of the number of Gaussians.

    Returns
    -------
    Number of remaining Gaussians.
    """
    n, count = now.means.shape[1], len(now.weights)
    expected = lanes.moving_states(batch.transition, batch.process_cov)
    phi, q = lanes.lanes(n, n), lanes.lanes(n, n)
    x, p, scratch = lanes.lanes(1, n), lanes.lanes(n, n), lanes.lanes(n, n)
    reading = readings_of(batch, rules.loss != NONE)
    m = reading.rows.shape[0]
    search = search_of(batch, rules, reading)
    everyone = np.zeros(count, dtype=np.int64)
    group = lanes.group_members(run, run + 1)
    before = 0.0
    if evidence.shape[0] > 0 and count > 0:
        before = _log_sum(now.weights[:count])
    for k in range(first, stop):
        moving = lanes.gather(
            transition=batch.transition,
            process_cov=batch.process_cov,
            group=group,
            k=k,
            expected=expected,
            phi=phi,
            q=q,
        )
        for place in lanes.group_starts(count):
            used = lanes.count_from(place, count)
            _pack(now, place, used, x, p)
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
                now.weights[place + r] -= search.cost[r]
                for c in range(m):
                    now.weights[place + r] += math.log(search.s[c, c, r])
            _unpack(x, p, place, used, now)
        if evidence.shape[0] > 0:
            evidence[k] = _log_sum(now.weights[:count]) - before
        count = _dropped(now, count)
        if count == 0:
            mean[k:stop] = np.nan
            cov[k:stop] = np.nan
            for rest in range(k, min(stop, evidence.shape[0])):
                evidence[rest] = -math.inf
            break
        count = _merged(now, count)
        if evidence.shape[0] > 0:
            before = _log_sum(now.weights[:count])
        sizes[0] += count
        _moments(now, everyone[:count], 0, 0.0, mean[k], cov[k])
    counts[0] += search.counts[:, 1].sum()
    return count


@compiled
def _log_sum(weights: np.ndarray) -> float:
    """Return the logarithm of the sum of weights, given their logarithms (J,).

    Logarithms that are not finite are ignored. Without a finite logarithm the result is −∞.
    """
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
    """Copy ``used`` hypotheses from ``first`` on to lanes; unused lanes repeat the last one."""
    n = source.means.shape[1]
    for r in lanes.each():
        j = first + min(r, used - 1)
        for a in range(n):
            x[0, a, r] = source.means[j, a]
            for b in range(n):
                p[a, b, r] = source.covs[j, a, b]


@compiled
def _unpack(x: np.ndarray, p: np.ndarray, first: int, used: int, out: Hypotheses) -> None:
    """Copy the used lanes to the hypotheses from ``first`` on."""
    n = out.means.shape[1]
    for r in range(used):
        for a in range(n):
            out.means[first + r, a] = x[0, a, r]
            for b in range(n):
                out.covs[first + r, a, b] = p[a, b, r]


@compiled
def _copy(source: Hypotheses, j: int, out: Hypotheses, place: int) -> None:
    """Copy hypothesis ``j`` of ``source`` to index ``place`` of ``out``."""
    n = source.means.shape[1]
    out.weights[place] = source.weights[j]
    for a in range(n):
        out.means[place, a] = source.means[j, a]
        for b in range(n):
            out.covs[place, a, b] = source.covs[j, a, b]


@compiled
def _dropped(now: Hypotheses, count: int) -> int:
    """Drop hypotheses of negligible weight relative to the largest; return the new number."""
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
    """Merge hypotheses with close means (Salmond 1990); return the new number.

    In order of decreasing weight, each hypothesis is merged with the lighter hypotheses within a
    Mahalanobis distance of 1. A merge preserves the mean and covariance of the sum.
    """
    if count == 1:
        return count
    weights, means, covs = now.weights, now.means, now.covs
    n = means.shape[1]
    order = np.argsort(-weights[:count], kind="mergesort")
    leader = np.full(count, -1)
    root, off, ordered = np.empty((n, n)), np.empty(n), np.empty(count)
    for place in range(count):
        ordered[place] = means[order[place], 0]
    for place in range(count):
        first = order[place]
        if leader[first] >= 0:
            continue
        leader[first] = first
        factorised = False
        for behind in range(place + 1, count):  # d² ≥ off² / P_ii: most pairs need no more
            apart = ordered[behind] - ordered[place]
            if apart * apart > SAME * covs[first, 0, 0] or leader[order[behind]] >= 0:
                continue
            other = order[behind]
            near = True
            for i in range(n):
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
    """Fill the lower triangle of the Cholesky factor L of a matrix A, L Lᵀ = A.

    L contains NaN if A is not positive definite.
    """
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
    """Fill mean (n,) and covariance (n, n) of the hypotheses that are merged into ``first``.

    ``leader`` (J,) is the index of the hypothesis into which each one is merged. Return the sum of
    the merged weights, divided by exp(``log_unit``).
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


def prior_cells(block: ProblemBlock, spacing_m: float, most: int) -> Hypotheses:
    """Return the prior as Gaussians with one covariance (1, n, n); see :func:`.split_prior`."""
    weights, means, covs = split_prior(block, spacing_m, most, WIDTH)
    scale = np.sqrt(np.diag(block.prior_cov))
    return Hypotheses(weights, means * scale, covs[:1] * np.outer(scale, scale))


def gaussian_sum(
    block: ProblemBlock, spacing_m: float, most: int, iterations: int, loss: str, threshold: float
) -> EstimateBlock:
    """Run the Gaussian-sum filter.

    Parameters
    ----------
    block : block of R runs.
    spacing_m, most : spacing [m] and largest number of Gaussians of the prior, see
        :func:`.split_prior`.
    iterations : largest number of linearisations of h in each update of a Gaussian.
    loss, threshold : robust loss on each whitened component of a measurement, see
        :mod:`.robust_weights`.
    """
    rules = Rules(iterations, HALVINGS, number_of(loss, threshold), threshold, False)
    runs, epochs, n = block.runs, block.epochs, block.dimension
    mean, cov = np.empty((runs, epochs, n)), np.empty((runs, epochs, n, n))
    counts, sizes = np.zeros(runs, dtype=np.int64), np.zeros(runs)
    prior = prior_cells(block, spacing_m, most)
    _filter(
        batch=batch_of(block),
        prior=prior,
        space=space_for(prior),
        rules=rules,
        mean=mean,
        cov=cov,
        counts=counts,
        sizes=sizes,
    )
    started = np.full(runs, len(prior.weights))
    info = {"hypotheses": started, "mean_hypotheses": sizes, "map_evaluations": counts}
    return EstimateBlock(mean, cov, "filter", info=info)


def space_for(prior: Hypotheses) -> Hypotheses:
    """Return empty arrays for the J Gaussians of a prior, each with its own covariance."""
    most, n = prior.means.shape
    return Hypotheses(np.empty(most), np.empty((most, n)), np.empty((most, n, n)))


class CarriedSum:
    """Gaussian-sum filter of one run that processes the epochs in several calls.

    Attributes
    ----------
    mean, cov : (1, K, n), (1, K, n, n) estimates of the epochs processed so far.
    evidence : (1, K) evidence of each epoch, see :func:`.extended_with_evidence`.
    evaluations : (1,) number of evaluations of h.

    Parameters
    ----------
    block : block of one run.
    prior : Gaussians of the prior, from :func:`prior_cells`.
    space : scratch from :func:`space_for`, used only during the first call of :meth:`advance`;
        several filters can share it.
    iterations, loss, threshold : see :func:`gaussian_sum`.
    """

    def __init__(
        self,
        block: ProblemBlock,
        prior: Hypotheses,
        space: Hypotheses,
        iterations: int,
        loss: str,
        threshold: float,
    ) -> None:
        shape = 1, block.epochs, block.dimension
        self.mean, self.cov = np.empty(shape), np.empty((*shape, block.dimension))
        self.evidence, self.evaluations = np.empty(shape[:2]), np.zeros(1, dtype=np.int64)
        self._batch, self._prior, self._now, self._stop = batch_of(block), prior, space, 0
        self._rules = Rules(iterations, HALVINGS, number_of(loss, threshold), threshold, False)

    def advance(self, stop: int) -> None:
        """Filter the remaining epochs before ``stop``."""
        if self._stop == 0:
            start(self._prior, self._now)
        left = advance(
            batch=self._batch,
            run=0,
            first=self._stop,
            stop=stop,
            rules=self._rules,
            now=self._now,
            mean=self.mean[0],
            cov=self.cov[0],
            evidence=self.evidence[0],
            counts=self.evaluations,
            sizes=np.zeros(1),
        )
        now = self._now
        self._now = Hypotheses(*(part[:left].copy() for part in (now.weights, now.means, now.covs)))
        self._stop = stop
