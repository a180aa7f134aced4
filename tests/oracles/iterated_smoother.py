"""Gauss–Newton as an iterated Kalman smoother: the most probable trajectory from one start.

Each step linearises h about the whole trajectory and solves the linear problem with a Kalman
filter and smoother (Bell 1994), and goes only as far towards its solution as the cost falls: the
line-search iterated extended Kalman smoother of Särkkä & Svensson 2020. The process noise may be
singular: a trajectory is carried with its Lagrange multipliers, x_0 = prior_mean + P_0 λ and
x_k = Φ_k x_{k−1} + Q_k r_k, in which the cost of the motion is ½ λᵀ P_0 λ + ½ Σ r_kᵀ Q_k r_k.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ggbench.engines.line_search import CONVERGED, HALVINGS
from ggbench.engines.robust_weights import losses, weights
from ggbench.engines.window_search import Place
from ggbench.numerics.kernels import compiled
from ggbench.problem import Problem, jacobian_along, predict_along


@dataclass(frozen=True)
class Trajectory:
    """States (K, n), multipliers λ (n,) and r (K, n), in units of the prior's deviations."""

    states: np.ndarray
    start: np.ndarray
    motion: np.ndarray

    def towards(self, other: Trajectory, share: float) -> Trajectory:
        """Return the trajectory a share of the way to another one."""
        pairs = zip(vars(self).values(), vars(other).values(), strict=True)
        return Trajectory(*(a + share * (b - a) for a, b in pairs))


@dataclass(frozen=True)
class Minimum:
    """The end of a search, and the filter that was linearised there."""

    trajectory: Trajectory
    cost: float
    iterations: int
    converged: bool
    rows: np.ndarray
    filtered_cov: np.ndarray


class IteratedSmoother:
    """A problem in units of the prior's deviations, its cost and its linearised solution.

    Parameters
    ----------
    problem : to be solved.
    loss, threshold : on each whitened component of a reading, see :mod:`.robust_weights`.

    Attributes
    ----------
    scale : (n,) the units of all states below.
    """

    def __init__(self, problem: Problem, loss: str = "none", threshold: float = np.inf) -> None:
        self.problem = problem
        self._epochs = np.arange(problem.epochs)
        self.loss, self.threshold = loss, threshold
        self.scale = scale = np.sqrt(np.diag(problem.prior_cov))
        self.transition = problem.transition * scale / scale[:, None]
        self.process_cov = problem.process_cov / np.outer(scale, scale)
        self.prior_mean = problem.prior_mean / scale
        self.prior_cov = problem.prior_cov / np.outer(scale, scale)
        channels = problem.measurements.shape[1]
        noise = np.broadcast_to(problem.noise_cov, (problem.epochs, channels, channels))
        self.noise_root = np.linalg.cholesky(noise)

    def from_prior(self, start: np.ndarray) -> Trajectory:
        """Return the undisturbed motion from prior_mean + P_0 λ."""
        states = np.empty((self.problem.epochs, self.problem.dimension))
        x = self.prior_mean + self.prior_cov @ start
        for k, phi in enumerate(self.transition):
            x = phi @ x
            states[k] = x
        return Trajectory(states, start, np.zeros_like(states))

    def residuals(self, states: np.ndarray) -> np.ndarray:
        """Return the whitened residuals (K, m) of a trajectory's states (K, n)."""
        problem = self.problem
        predicted = predict_along(problem.model, self._epochs, states * self.scale)
        residuals = problem.measurements - predicted
        return np.linalg.solve(self.noise_root, residuals[..., np.newaxis])[..., 0]

    def cost(self, trajectory: Trajectory, residuals: np.ndarray) -> float:
        """Return the cost of a trajectory with its whitened residuals (K, m): −log density."""
        start, motion = trajectory.start, trajectory.motion
        moving = np.einsum("ki,kij,kj->", motion, self.process_cov, motion)
        left = losses(residuals, self.loss, self.threshold).sum()
        return float(0.5 * (start @ self.prior_cov @ start + moving) + left)

    def _promise(
        self, trajectory: Trajectory, other: Trajectory, rows: np.ndarray, target: np.ndarray
    ) -> float:
        """Return by how much the linear problem has the cost fall from a trajectory to another."""
        costs = []
        for one in (trajectory, other):
            left = target - np.einsum("kmi,ki->km", rows, one.states)
            motion = np.einsum("ki,kij,kj->", one.motion, self.process_cov, one.motion)
            motion += one.start @ self.prior_cov @ one.start
            costs.append(0.5 * (motion + (left**2).sum()))
        return float(costs[0] - costs[1])

    def search(self, trajectory: Trajectory, max_iterations: int) -> Minimum:
        """Follow Gauss–Newton steps, each halved until the cost falls, to a minimum."""
        problem = self.problem
        residuals = self.residuals(trajectory.states)
        cost = self.cost(trajectory, residuals)
        converged = False
        iterations = 0
        rows: np.ndarray = np.empty(0)
        filtered_cov: np.ndarray = np.empty(0)
        while np.isfinite(cost) and not converged and iterations < max_iterations:
            iterations += 1
            states = trajectory.states * self.scale
            rows = jacobian_along(problem.model, self._epochs, states)
            rows = np.linalg.solve(self.noise_root, rows * self.scale)
            target = residuals + np.einsum("kmi,ki->km", rows, trajectory.states)
            weight = np.sqrt(weights(residuals, self.loss, self.threshold))
            rows *= weight[:, :, None]
            *solution, filtered_cov = smooth(
                self.transition,
                self.process_cov,
                self.prior_mean,
                self.prior_cov,
                rows,
                weight * target,
            )
            full = Trajectory(*solution)
            before, promise = cost, self._promise(trajectory, full, rows, weight * target)
            if promise < CONVERGED:  # the last step is not judged
                trajectory, cost, converged = full, cost - max(promise, 0.0), True
                break
            moves = False
            for halving in range(HALVINGS):
                moved = trajectory.towards(full, 0.5**halving)
                new_residuals = self.residuals(moved.states)
                new = self.cost(moved, new_residuals)
                if new < cost:
                    trajectory, residuals, cost, moves = moved, new_residuals, new, True
                    break
            if before - cost < CONVERGED:
                converged = moves or promise < CONVERGED
                break
        return Minimum(trajectory, cost, iterations, converged, rows, filtered_cov)


def place_of(smoother: IteratedSmoother, minimum: Minimum) -> Place | None:
    """Return the end of a search as the matchers have it, None where it has no cost."""
    if not np.isfinite(minimum.cost):
        return None
    scale = smoother.scale
    mean = minimum.trajectory.states[-1] * scale
    cov = minimum.filtered_cov[-1] * np.outer(scale, scale)
    log_share = _log_width(smoother, minimum) - minimum.cost
    return Place(mean, 0.5 * (cov + cov.T), minimum.cost, log_share)


def _log_width(smoother: IteratedSmoother, minimum: Minimum) -> float:
    """Return ½ ln of the determinant of a trajectory's covariance over that of the prior.

    That is −½ Σ ln det of the covariances of the innovations, in units of the noise.
    """
    before = np.concatenate([smoother.prior_cov[np.newaxis], minimum.filtered_cov[:-1]])
    phi, rows = smoother.transition, minimum.rows
    before = phi @ before @ phi.transpose(0, 2, 1) + smoother.process_cov
    s = rows @ before @ rows.transpose(0, 2, 1) + np.eye(rows.shape[1])
    return -0.5 * float(np.linalg.slogdet(s)[1].sum())


@compiled
def smooth(
    transition: np.ndarray,
    process_cov: np.ndarray,
    prior_mean: np.ndarray,
    prior_cov: np.ndarray,
    rows: np.ndarray,
    target: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Solve the linear problem target[k] = rows[k] x_k + v_k with white v_k of unit variance.

    A Kalman filter that takes one component of a reading after the other, in Joseph's form; then
    the multipliers backwards (Bryson & Frazier; Bierman 1973): r ← h y / s + (I − K h)ᵀ r over the
    components, r ← Φᵀ r between epochs, and x = x_filtered + P r with the r of what comes later.

    Returns
    -------
    Smoothed states (K, n), multipliers λ (n,) and r (K, n), filtered covariance (K, n, n).
    """
    epochs, m, n = rows.shape
    mean = np.empty((epochs, n))
    cov = np.empty((epochs, n, n))
    gains = np.empty((epochs, m, n))
    news = np.empty((epochs, m))
    x, p = prior_mean.copy(), prior_cov.copy()
    ph = np.empty(n)
    for k in range(epochs):
        phi = transition[k]
        x = phi @ x
        p = phi @ p @ phi.T + process_cov[k]
        for c in range(m):
            h, gain = rows[k, c], gains[k, c]
            s, y = 1.0, target[k, c]
            for i in range(n):
                ph[i] = 0.0
                for j in range(n):
                    ph[i] += p[i, j] * h[j]
                s += ph[i] * h[i]
                y -= h[i] * x[i]
            news[k, c] = y / s
            for i in range(n):
                gain[i] = ph[i] / s
                x[i] += gain[i] * y
                for j in range(n):
                    p[i, j] -= gain[i] * ph[j]
            for i in range(n):
                left = 0.0
                for j in range(n):
                    left += p[i, j] * h[j]
                for j in range(n):
                    p[i, j] += (gain[i] - left) * gain[j]
            for i in range(n):
                for j in range(i):
                    p[i, j] = p[j, i] = 0.5 * (p[i, j] + p[j, i])
        mean[k], cov[k] = x, p
    motion = np.empty((epochs, n))
    back = np.zeros(n)
    for k in range(epochs - 1, -1, -1):
        for i in range(n):
            for j in range(n):
                mean[k, i] += cov[k, i, j] * back[j]
        for c in range(m - 1, -1, -1):
            pull = news[k, c]
            for i in range(n):
                pull -= gains[k, c, i] * back[i]
            for i in range(n):
                back[i] += rows[k, c, i] * pull
        for i in range(n):
            motion[k, i] = back[i]
        back = transition[k].T @ motion[k]
    return mean, back, motion, cov
