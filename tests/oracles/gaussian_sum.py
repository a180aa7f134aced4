"""The Gaussian sum in NumPy."""

from __future__ import annotations

import numpy as np

from ggbench.engines.banks import Bank, mixture, updated_covs
from ggbench.engines.gaussian_sum import HALVINGS, NEGLIGIBLE, SAME, WIDTH
from ggbench.engines.robust_weights import losses, weights
from ggbench.estimators.gaussian_sum import GaussianSum
from ggbench.estimators.robust import Loss
from ggbench.numerics.kernels import compiled
from ggbench.problem import Estimate, Problem

CONVERGED = 1e-6
"""Decrease of a cost below which an update has converged: a thousandth of a deviation."""


def estimate(filter: GaussianSum, problem: Problem) -> Estimate:
    """Carry the mixture from epoch to epoch; return its mean and covariance."""
    bank = _Hypotheses(problem, filter.spacing_m, filter.most, filter.loss, filter.limit)
    mean = np.empty((problem.epochs, problem.dimension))
    cov = np.empty((problem.epochs, problem.dimension, problem.dimension))
    started = len(bank.weights)
    counts = []
    for k in range(problem.epochs):
        bank.predict(k)
        bank.update(k, filter.iterations)
        share = np.exp(bank.weights)
        mean[k], cov[k] = mixture(share / share.sum(), bank.means, bank.covs)
        counts.append(len(bank.weights))
    info = {"hypotheses": started, "mean_hypotheses": float(np.mean(counts))}
    scale = bank.scale
    mean, cov = mean * scale, cov * np.outer(scale, scale)
    return Estimate(mean, cov, filter.causality, info=info)


class _Hypotheses(Bank):
    """A bank of iterated filters, of which those are kept that weigh something."""

    def __init__(
        self, problem: Problem, spacing_m: float, most: int, loss: Loss, threshold: float
    ) -> None:
        super().__init__(problem, spacing_m, most, WIDTH)
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
            # At first the innovation may be large because the prior is wide: see robust_weights.
            spread = 0.0 if iteration else np.einsum("jma,jab,jmb->jm", rows, cov, rows)
            weight = weights(white / np.sqrt(1.0 + spread), self.loss, self.threshold)
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
            for halving in range(HALVINGS):
                new_dual = dual[waiting] + 0.5**halving * (full - dual)[waiting]
                new_x = predicted[waiting] + np.einsum("jab,jb->ja", cov[waiting], new_dual)
                new_white, new_cost = self._residuals(k, new_x, new_dual, cov[waiting])
                falls = new_cost < cost[waiting]
                moved, waiting = waiting[falls], waiting[~falls]
                x[moved], dual[moved] = new_x[falls], new_dual[falls]
                white[moved], cost[moved] = new_white[falls], new_cost[falls]
                if not len(waiting):
                    break
            active = active[(before - cost)[active] > CONVERGED]
            if not len(active):
                break
        self.means = x
        self.covs = updated_covs(cov, weighted, projected, s)
        if not np.isfinite(cost).any():
            raise FloatingPointError(f"no hypothesis has a finite likelihood at epoch {k}")
        self.weights = self.weights - cost - 0.5 * np.linalg.slogdet(s).logabsdet
        self.weights -= np.nanmax(self.weights)
        kept = self.weights > np.log(NEGLIGIBLE)
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
        return white, 0.5 * prior + losses(white, self.loss, self.threshold).sum(axis=1)

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
                if off[i] * off[i] > SAME * variances[first, i]:
                    near = False
                    break
            if not near:
                continue
            distance = 0.0
            for i in range(n):
                for j in range(n):
                    distance += off[i] * information[first, i, j] * off[j]
            if distance < SAME:
                leader[other] = first
    return leader
