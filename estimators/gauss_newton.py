"""Batch maximum a posteriori by Gauss–Newton as an iterated Kalman smoother, from many starts.

Each step linearises h about the whole trajectory and solves the linear problem with a Kalman
filter and smoother (Bell 1994), and goes only as far towards its solution as the cost falls: the
line-search iterated extended Kalman smoother of Särkkä & Svensson 2020. The process noise may be
singular: a trajectory is carried with its Lagrange multipliers, x_0 = prior_mean + P_0 λ and
x_k = Φ_k x_{k−1} + Q_k r_k, in which the cost of the motion is ½ λᵀ P_0 λ + ½ Σ r_kᵀ Q_k r_k.

A field of gravity gradients looks alike in many places, and Gauss–Newton finds the nearest. So the
cost is looked at from many starts across the prior of the position, and the best are refined.
Those follow the drift of the INS, however far it leads; one more search starts from the smoothed
track of an extended Kalman filter, which has corrected it on the way.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri

from ..numerics.kernels import compiled
from ..problem import Causality, Estimate, Estimator, Problem
from . import robust
from .robust import Loss
from .ukf import MatrixSquareRoot

_HALVINGS = 15
_CONVERGED = 1e-6
"""Decrease of the cost below which a search has ended: a thousandth of a standard deviation."""
_MOST_STARTS = 1_000_000
"""Starts that fit in memory."""
_SCREENED = 50
"""Number of epochs at which the cost of a start is looked at."""


@dataclass(frozen=True)
class GaussNewton(Estimator):
    """Most probable trajectory, by Gauss–Newton from several starts.

    Parameters
    ----------
    starts : number of initial positions (states in metres) spread over the prior; 1 starts from
        the prior's mean alone. A filter's track is one more start.
    refine : how many of them, those of the lowest costs, are refined.
    max_iterations : limit of Gauss–Newton steps from each start.
    loss : ``huber`` or ``cauchy`` on each component of a reading, by iteratively reweighted least
        squares; see :mod:`ggbench.estimators.robust`.
    threshold : residual [standard deviations of the noise] from which the loss acts; if not
        given, 1.345 for ``huber`` and 2.385 for ``cauchy``.
    """

    starts: int = 1024
    refine: int = 5
    max_iterations: int = 30
    loss: Loss = "none"
    threshold: float | None = None

    name = "gauss-newton"

    @property
    def causality(self) -> Causality:
        """All measurements."""
        return "batch"

    def skip(self, problem: Problem) -> str | None:
        """Refuse limits that leave nothing to do."""
        if not 1 <= self.starts <= _MOST_STARTS:
            return f"starts must be 1 to {_MOST_STARTS}, and is {self.starts}"
        for name in ("refine", "max_iterations"):
            if getattr(self, name) < 1:
                return f"{name} must be at least 1, and is {getattr(self, name)}"
        return robust.refusal(self.loss, self.threshold)

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        """Refine the best starts and return the trajectory of the lowest cost."""
        threshold = robust.threshold_of(self.loss, self.threshold)
        smoother = _Smoother(problem, self.loss, threshold)
        starts = [*smoother.best_starts(self.starts, self.refine), smoother.from_filter()]
        found = [smoother.search(start, self.max_iterations) for start in starts]
        finite = [item for item in found if np.isfinite(item.cost)]
        if not finite:
            raise FloatingPointError("the cost of every start is not a finite number")
        best = min(finite, key=lambda item: item.cost)
        mean, cov = smoother.answer(best)
        info = {
            "cost": best.cost,
            "iterations": sum(item.iterations for item in found),
            "converged": best.converged,
            "refined": len(found),
        }
        return Estimate(mean, cov, self.causality, info=info)


@dataclass(frozen=True)
class _Trajectory:
    """States (K, n), multipliers λ (n,) and r (K, n), in units of the prior's deviations."""

    states: np.ndarray
    start: np.ndarray
    motion: np.ndarray

    def towards(self, other: _Trajectory, share: float) -> _Trajectory:
        """Return the trajectory a share of the way to another one."""
        pairs = zip(vars(self).values(), vars(other).values(), strict=True)
        return _Trajectory(*(a + share * (b - a) for a, b in pairs))


@dataclass(frozen=True)
class _Minimum:
    """The end of a search, and the filter that was linearised there."""

    trajectory: _Trajectory
    cost: float
    iterations: int
    converged: bool
    rows: np.ndarray
    filtered_cov: np.ndarray


class _Smoother:
    """A problem in units of the prior's deviations, its cost and its linearised solution."""

    def __init__(self, problem: Problem, loss: Loss, threshold: float) -> None:
        self.problem = problem
        self.loss, self.threshold = loss, threshold
        self.scale = scale = np.sqrt(np.diag(problem.prior_cov))
        self.transition = problem.transition * scale / scale[:, None]
        self.process_cov = problem.process_cov / np.outer(scale, scale)
        self.prior_mean = problem.prior_mean / scale
        self.prior_cov = problem.prior_cov / np.outer(scale, scale)
        channels = problem.measurements.shape[1]
        noise = np.broadcast_to(problem.noise_cov, (problem.epochs, channels, channels))
        self.noise_root = np.linalg.cholesky(noise)

    def from_prior(self, start: np.ndarray) -> _Trajectory:
        """Return the undisturbed motion from prior_mean + P_0 λ."""
        states = np.empty((self.problem.epochs, self.problem.dimension))
        x = self.prior_mean + self.prior_cov @ start
        for k, phi in enumerate(self.transition):
            x = phi @ x
            states[k] = x
        return _Trajectory(states, start, np.zeros_like(states))

    def from_filter(self) -> _Trajectory:
        """Return the smoothed track of an extended Kalman filter."""
        problem = self.problem
        n, m = problem.dimension, problem.measurements.shape[1]
        rows, target = np.empty((problem.epochs, m, n)), np.empty((problem.epochs, m))
        x, p = self.prior_mean, self.prior_cov
        for k, (phi, q) in enumerate(zip(self.transition, self.process_cov, strict=True)):
            x, p = phi @ x, phi @ p @ phi.T + q
            state = x * self.scale
            innovation = problem.measurements[k] - problem.model.predict(k, state)
            white = np.linalg.solve(self.noise_root[k], innovation)
            h = np.linalg.solve(self.noise_root[k], problem.model.jacobian(k, state) * self.scale)
            rows[k], target[k] = h, white + h @ x
            gain = np.linalg.solve(h @ p @ h.T + np.eye(m), h @ p).T
            keep = np.eye(n) - gain @ h
            x, p = x + gain @ white, keep @ p @ keep.T + gain @ gain.T
        *solution, _ = _smooth(
            self.transition, self.process_cov, self.prior_mean, self.prior_cov, rows, target
        )
        return _Trajectory(*solution)

    def best_starts(self, count: int, keep: int) -> list[_Trajectory]:
        """Return the undisturbed motions of lowest costs from positions across the prior.

        They are a Halton sequence in the normal distribution whose density is that of the prior to
        the power d / (d + 2): with it d-dimensional points leave the smallest mean square distance
        to the nearest one (Zador 1982).
        """
        centre = np.zeros(self.problem.dimension)
        axes = [
            i
            for block in self.problem.layout
            if block.unit == "m"
            for i in range(*block.slice.indices(self.problem.dimension))
        ]
        if count == 1 or not axes:
            return [self.from_prior(centre)]
        from scipy.stats import qmc  # not at the top: it loads slowly

        uniform = qmc.Halton(len(axes), scramble=False).random(count)[1:]  # the first is zero
        normal = np.sqrt(1.0 + 2.0 / len(axes)) * ndtri(uniform)
        starts = np.zeros((count, len(centre)))
        root = np.linalg.cholesky(self.prior_cov[np.ix_(axes, axes)])
        starts[1:, axes] = np.linalg.solve(root.T, normal.T).T
        order = np.argsort(self._screen(starts), kind="stable")
        return [self.from_prior(starts[i]) for i in order[:keep]]

    def _screen(self, starts: np.ndarray) -> np.ndarray:
        """Return the cost of each start (S, n), from a part of the epochs."""
        problem = self.problem
        shown = np.linspace(0, problem.epochs - 1, min(problem.epochs, _SCREENED)).astype(int)
        moved = starts @ self.prior_cov
        costs = 0.5 * np.einsum("si,si->s", starts, moved)
        states = (self.prior_mean + moved).T
        for k, phi in enumerate(self.transition):
            states = phi @ states
            if k in shown:
                residuals = problem.measurements[k] - problem.model.predict(
                    k, states.T * self.scale
                )
                white = np.linalg.solve(self.noise_root[k], residuals.T)
                left = robust.losses(white, self.loss, self.threshold).sum(axis=0)
                costs += problem.epochs / len(shown) * left
        return costs

    def _residuals(self, states: np.ndarray) -> np.ndarray:
        """Return the whitened residuals (K, m) of a trajectory."""
        problem = self.problem
        predicted = [problem.model.predict(k, x) for k, x in enumerate(states * self.scale)]
        residuals = problem.measurements - predicted
        return np.linalg.solve(self.noise_root, residuals[..., np.newaxis])[..., 0]

    def _cost(self, trajectory: _Trajectory, residuals: np.ndarray) -> float:
        start, motion = trajectory.start, trajectory.motion
        moving = np.einsum("ki,kij,kj->", motion, self.process_cov, motion)
        left = robust.losses(residuals, self.loss, self.threshold).sum()
        return float(0.5 * (start @ self.prior_cov @ start + moving) + left)

    def search(self, trajectory: _Trajectory, max_iterations: int) -> _Minimum:
        """Follow Gauss–Newton steps, each halved until the cost falls, to a minimum."""
        problem = self.problem
        residuals = self._residuals(trajectory.states)
        cost = self._cost(trajectory, residuals)
        converged = False
        iterations = 0
        rows: np.ndarray = np.empty(0)
        filtered_cov: np.ndarray = np.empty(0)
        while np.isfinite(cost) and not converged and iterations < max_iterations:
            iterations += 1
            states = trajectory.states * self.scale
            rows = np.stack([problem.model.jacobian(k, x) for k, x in enumerate(states)])
            rows = np.linalg.solve(self.noise_root, rows * self.scale)
            target = residuals + np.einsum("kmi,ki->km", rows, trajectory.states)
            weight = np.sqrt(robust.weights(residuals, self.loss, self.threshold))
            rows *= weight[:, :, None]
            *solution, filtered_cov = _smooth(
                self.transition, self.process_cov, self.prior_mean, self.prior_cov,
                rows, weight * target,
            )  # fmt: skip
            full = _Trajectory(*solution)
            before = cost
            for halving in range(_HALVINGS):
                moved = trajectory.towards(full, 0.5**halving)
                new_residuals = self._residuals(moved.states)
                new = self._cost(moved, new_residuals)
                if new < cost:
                    trajectory, residuals, cost = moved, new_residuals, new
                    break
            converged = before - cost < _CONVERGED
        return _Minimum(trajectory, cost, iterations, converged, rows, filtered_cov)

    def answer(self, minimum: _Minimum) -> tuple[np.ndarray, np.ndarray]:
        """Return the mean (K, n) and the smoothed covariance (K, n, n) at a minimum."""
        cov = _smoothed_cov(self.transition, self.process_cov, minimum.filtered_cov, minimum.rows)
        return minimum.trajectory.states * self.scale, cov * np.outer(self.scale, self.scale)


@compiled
def _smooth(
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


def _smoothed_cov(
    transition: np.ndarray, process_cov: np.ndarray, filtered: np.ndarray, rows: np.ndarray
) -> np.ndarray:
    """Return the covariance (K, n, n) of filtered states given all later measurements, too.

    The two-filter smoother (Fraser & Potter 1969) in square-root form: WᵀW, the information of
    what comes later, is carried backwards through a Q that may be singular,
    (Q + (WᵀW)⁻¹)⁻¹ = Wᵀ (I + W Q Wᵀ)⁻¹ W, and joined with P = UᵀU of the filter,
    (P⁻¹ + WᵀW)⁻¹ = Uᵀ (I + U WᵀW Uᵀ)⁻¹ U. Sharp readings and wide priors do it no harm.
    """
    epochs, n, _ = filtered.shape
    eye = np.eye(n)
    later = np.zeros((epochs, n, n))
    for k in range(epochs - 1, 0, -1):
        found = np.asarray(np.linalg.qr(np.vstack([later[k], rows[k]]), mode="r"))
        root = np.linalg.cholesky(eye + found @ process_cov[k] @ found.T)
        later[k - 1] = np.linalg.solve(root, found) @ transition[k]
    square_root = MatrixSquareRoot()
    upper = np.stack([square_root(cov) for cov in filtered])
    both = np.concatenate(
        [np.broadcast_to(eye, later.shape), later @ upper.transpose(0, 2, 1)], axis=1
    )
    joined = np.asarray(np.linalg.qr(both, mode="r"))
    half = np.linalg.solve(joined.transpose(0, 2, 1), upper)
    return half.transpose(0, 2, 1) @ half
