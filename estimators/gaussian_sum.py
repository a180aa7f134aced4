"""Gaussian-sum filter: a bank of iterated extended Kalman filters across a wide prior.

Where the prior is wide against the features of the field, one linearisation cannot hold, and a
filter locks onto whatever part of the field looks alike. So the prior is written as a sum of
narrow Gaussians on a grid of positions, each with a filter of its own, weighted by how well it
predicts (Sorenson & Alspach 1971; Alspach & Sorenson 1972; Bar-Shalom, Li & Kirubarajan 2001,
sec. 11.6). What weighs nothing is dropped, what has become the same is merged.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from ..block import BlockEstimator, EstimateBlock, ProblemBlock
from ..engines.banks import Bank, updated_covs
from ..engines.gaussian_sum import gaussian_sum
from ..engines.iterated_update import Rules
from ..engines.robust_weights import number_of
from ..numerics.kernels import compiled
from ..problem import Causality, Estimate, Problem
from . import robust, told_noise
from .robust import Loss

_WIDTH = 0.6
"""Standard deviation of a Gaussian over the grid's spacing: their sum ripples by less than 1 %."""
_NEGLIGIBLE = 1e-6
"""Weight against the largest one below which a hypothesis is dropped."""
_SAME = 1.0
"""Squared Mahalanobis distance of the means below which two hypotheses are one."""
_MOST = 100_000
"""Hypotheses that fit in memory."""
_HALVINGS = 6
_CONVERGED = 1e-6
"""Decrease of a cost below which an update has converged: a thousandth of a deviation."""


@dataclass(frozen=True)
class GaussianSum(BlockEstimator):
    """Gaussian-sum filter over the position.

    Parameters
    ----------
    spacing_m : distance of the hypotheses [m], some fraction of the field's correlation length.
        Directions of the position in which the prior is narrower are not split.
    most : largest number of hypotheses; where the grid would need more, it is made coarser.
    iterations : linearisations of h in each update of a hypothesis (see ``ekf``).
    loss : ``huber`` or ``cauchy`` on each component of a reading, reweighted at each
        linearisation; see :mod:`ggbench.estimators.robust`.
    threshold : residual [standard deviations of the noise] from which the loss acts; if not
        given, 1.345 for ``huber`` and 2.385 for ``cauchy``.
    noise_scale : factor on the standard deviations of the readings of gravity and its gradients,
        as the estimator is told them; see :mod:`ggbench.estimators.told_noise`.
    engine : ``numpy``, the reference, or ``numba``: the same, compiled, on many runs at once.
    """

    spacing_m: float = 250.0
    most: int = 4000
    iterations: int = 3
    loss: Loss = "none"
    threshold: float | None = None
    noise_scale: float = 1.0
    engine: Literal["numpy", "numba"] = "numpy"

    name = "gaussian-sum"

    @property
    def causality(self) -> Causality:
        """Measurements up to each epoch."""
        return "filter"

    @property
    def takes_blocks(self) -> bool:
        """Only the engine ``numba``."""
        return self.engine == "numba"

    def skip(self, problem: Problem) -> str | None:
        """Refuse grids that do not exist."""
        if not 0.0 < self.spacing_m < np.inf:
            return f"spacing_m must be positive and finite, and is {self.spacing_m:g}"
        if not 1 <= self.most <= _MOST:
            return f"most must be 1 to {_MOST}, and is {self.most}"
        if self.iterations < 1:
            return f"iterations must be at least 1, and is {self.iterations}"
        if self.loss != "none" and self.iterations == 1:
            return "a loss needs at least 2 iterations"
        if reason := told_noise.refusal(self.noise_scale):
            return reason
        if reason := robust.refusal(self.loss, self.threshold):
            return reason
        return super().skip(problem) if self.takes_blocks else None

    def estimate_block(self, block: ProblemBlock) -> EstimateBlock:
        """Filter all runs of a block."""
        block = told_noise.told(block, self.noise_scale)
        threshold = robust.threshold_of(self.loss, self.threshold)
        rules = Rules(self.iterations, _HALVINGS, number_of(self.loss, threshold), threshold, False)
        mean, cov, info = gaussian_sum(
            block, self.spacing_m, self.most, _WIDTH, rules, _NEGLIGIBLE, _SAME
        )
        estimate = EstimateBlock(mean, cov, self.causality, info=info)
        return told_noise.with_own_nis_of_runs(estimate, block, self.noise_scale)

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        """Carry the mixture from epoch to epoch; return its mean and covariance."""
        if self.takes_blocks:
            return super().estimate(problem, rng)
        problem = told_noise.told(problem, self.noise_scale)
        threshold = robust.threshold_of(self.loss, self.threshold)
        bank = _Hypotheses(problem, self.spacing_m, self.most, self.loss, threshold)
        mean = np.empty((problem.epochs, problem.dimension))
        cov = np.empty((problem.epochs, problem.dimension, problem.dimension))
        started = len(bank.weights)
        counts = []
        for k in range(problem.epochs):
            bank.predict(k)
            bank.update(k, self.iterations)
            mean[k], cov[k] = bank.moments()
            counts.append(len(bank.weights))
        info = {"hypotheses": started, "mean_hypotheses": float(np.mean(counts))}
        scale = bank.scale
        mean, cov = mean * scale, cov * np.outer(scale, scale)
        estimate = Estimate(mean, cov, self.causality, info=info)
        return told_noise.with_own_nis(estimate, problem, self.noise_scale)


class _Hypotheses(Bank):
    """A bank of iterated filters, of which those are kept that weigh something."""

    def __init__(
        self, problem: Problem, spacing_m: float, most: int, loss: Loss, threshold: float
    ) -> None:
        super().__init__(problem, spacing_m, most, _WIDTH)
        self.loss, self.threshold = loss, threshold

    def update(self, k: int, iterations: int) -> None:
        """Update all hypotheses with reading k; drop and merge.

        The likelihood of a reading is Laplace's: the density at the most probable state, over the
        part of the prior that the reading leaves. For a linear h it is exact.
        """
        predicted, cov = self.means, self.covs
        x, dual = predicted.copy(), np.zeros_like(predicted)
        white, cost = self._residuals(k, x, dual, cov)
        rows = self._white_rows(k, x)
        active = np.arange(len(x))  # those whose cost still falls
        for iteration in range(iterations):
            if iteration:
                rows[active] = self._white_rows(k, x[active])
            # At first the innovation may be large because the prior is wide: see robust.py.
            spread = 0.0 if iteration else np.einsum("jma,jab,jmb->jm", rows, cov, rows)
            weight = robust.weights(white / np.sqrt(1.0 + spread), self.loss, self.threshold)
            weighted = np.sqrt(weight)[..., None] * rows
            projected = weighted @ cov
            s = projected @ weighted.transpose(0, 2, 1) + np.eye(rows.shape[1])
            innovation = white - np.einsum("jmi,ji->jm", rows, predicted - x)
            innovation *= np.sqrt(weight)
            solved = np.linalg.solve(s, innovation[..., None])
            full = (weighted.transpose(0, 2, 1) @ solved)[..., 0]
            if iterations == 1:  # the extended Kalman filter takes the step as it is
                x = predicted + np.einsum("jab,jb->ja", cov, full)
                cost = 0.5 * np.einsum("jm,jm->j", innovation, solved[..., 0])
                break
            before = cost.copy()
            waiting = active
            for halving in range(_HALVINGS):
                new_dual = dual[waiting] + 0.5**halving * (full - dual)[waiting]
                new_x = predicted[waiting] + np.einsum("jab,jb->ja", cov[waiting], new_dual)
                new_white, new_cost = self._residuals(k, new_x, new_dual, cov[waiting])
                falls = new_cost < cost[waiting]
                moved, waiting = waiting[falls], waiting[~falls]
                x[moved], dual[moved] = new_x[falls], new_dual[falls]
                white[moved], cost[moved] = new_white[falls], new_cost[falls]
                if not len(waiting):
                    break
            active = active[(before - cost)[active] > _CONVERGED]
            if not len(active):
                break
        self.means = x
        self.covs = updated_covs(cov, weighted, projected, s)
        if not np.isfinite(cost).any():
            raise FloatingPointError(f"no hypothesis has a finite likelihood at epoch {k}")
        self.weights = self.weights - cost - 0.5 * np.linalg.slogdet(s).logabsdet
        self.weights -= np.nanmax(self.weights)
        kept = self.weights > np.log(_NEGLIGIBLE)
        self.weights, self.means, self.covs = _merged(
            self.weights[kept], self.means[kept], self.covs[kept]
        )

    def _residuals(
        self, k: int, x: np.ndarray, dual: np.ndarray, cov: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Whitened residuals (J, m) at states and the costs (J,) of prior and reading."""
        residual = self.problem.measurements[k] - self.problem.model.predict(k, x * self.scale)
        white = np.linalg.solve(np.linalg.cholesky(self.problem.noise_of(k)), residual.T).T
        prior = np.einsum("ja,jab,jb->j", dual, cov, dual)
        return white, 0.5 * prior + robust.losses(white, self.loss, self.threshold).sum(axis=1)

    def _white_rows(self, k: int, x: np.ndarray) -> np.ndarray:
        """Jacobians (J, m, n) of the whitened reading."""
        rows = self.problem.model.jacobian(k, x * self.scale)
        return np.linalg.solve(np.linalg.cholesky(self.problem.noise_of(k)), rows * self.scale)


def _merged(
    weights: np.ndarray, means: np.ndarray, covs: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Merge hypotheses whose means are the same, keeping mean and covariance of their sum."""
    if len(weights) == 1:
        return weights, means, covs
    order = np.argsort(-weights, kind="stable")
    variances = np.diagonal(covs, axis1=1, axis2=2).copy()
    leader = _leaders(order, means, variances, np.linalg.inv(covs))
    merged_weights, merged_means, merged_covs = [], [], []
    for first in order[leader[order] == order]:
        group = np.flatnonzero(leader == first)
        share = np.exp(weights[group] - weights[first])
        total = share.sum()
        mean = share @ means[group] / total
        off = means[group] - mean
        spread = np.einsum("j,jab->ab", share, covs[group]) + (off.T * share) @ off
        merged_weights.append(weights[first] + np.log(total))
        merged_means.append(mean)
        merged_covs.append(spread / total)
    return np.array(merged_weights), np.array(merged_means), np.array(merged_covs)


@compiled
def _leaders(
    order: np.ndarray, means: np.ndarray, variances: np.ndarray, information: np.ndarray
) -> np.ndarray:
    """Return for each hypothesis the index (J,) of the one that takes it in, maybe itself.

    From the heaviest on, each takes in the lighter ones within its deviations (Salmond 1990).
    """
    count, n = means.shape
    leader = np.full(count, -1)
    off = np.empty(n)
    for first in order:
        if leader[first] >= 0:
            continue
        leader[first] = first
        for other in order:
            if leader[other] >= 0:
                continue
            near = True
            for i in range(n):  # d² ≥ off² / P_ii: most pairs need no more than this
                off[i] = means[other, i] - means[first, i]
                if off[i] * off[i] > _SAME * variances[first, i]:
                    near = False
                    break
            if not near:
                continue
            distance = 0.0
            for i in range(n):
                for j in range(n):
                    distance += off[i] * information[first, i, j] * off[j]
            if distance < _SAME:
                leader[other] = first
    return leader
