"""Gauss–Newton from many starts in NumPy."""

from __future__ import annotations

import numpy as np

from ggbench.engines.multistart import (
    NO_RIVAL,
    across_prior,
    shown_epochs,
    window_end,
    window_search,
)
from ggbench.engines.robust_weights import losses
from ggbench.engines.window_search import ITERATIONS, best_apart
from ggbench.estimators.gauss_newton import GaussNewton
from ggbench.numerics.positive import MatrixSquareRoot
from ggbench.problem import Estimate, Problem

from .iterated_smoother import IteratedSmoother, Minimum, Trajectory, smooth
from .windows import section


def estimate(search: GaussNewton, problem: Problem) -> Estimate:
    """Refine the best starts and return the trajectory of the lowest cost."""
    smoother = _Smoother(problem, search.loss, search.limit)
    starts = [*smoother.best_starts(search.starts, search.refine), smoother.from_filter()]
    if search.starts > 1 and search.window:
        starts += smoother.from_window(search.window, search.spacing_m, search.refine)
    found = [smoother.search(start, search.max_iterations) for start in starts]
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
    return Estimate(mean, cov, search.causality, info=info)


class _Smoother(IteratedSmoother):
    """The search of a problem's minimum with a loss, and where it is begun."""

    def best_starts(self, count: int, keep: int) -> list[Trajectory]:
        """Return the undisturbed motions of lowest costs from positions across the prior."""
        starts = across_prior(self.problem, count)
        if len(starts) == 1:
            return [self.from_prior(starts[0])]
        order = np.argsort(self.screened_costs(starts), kind="stable")
        return [self.from_prior(starts[i]) for i in order[:keep]]

    def from_filter(self) -> Trajectory:
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
        *solution, _ = smooth(
            self.transition, self.process_cov, self.prior_mean, self.prior_cov, rows, target
        )
        return Trajectory(*solution)

    def from_window(self, count: int, spacing_m: float, keep: int) -> list[Trajectory]:
        """Return the motions that fit the first readings, the most probable first.

        Parameters
        ----------
        count : of epochs with readings. spacing_m : step of the grid [m].
        keep : largest number of motions. None is returned if the grid has one point: there the
            prior's mean is start enough.
        """
        problem, stop = self.problem, window_end(self.problem.present, count)
        window = section(problem, 0, stop, problem.prior_mean, problem.prior_cov)
        search = window_search(window, spacing_m, self.loss)
        if search is None:
            return []
        smoother = IteratedSmoother(search.problem, self.loss, self.threshold)
        found = [
            smoother.search(smoother.from_prior(start), ITERATIONS) for start in search.starts(keep)
        ]
        found = [minimum for minimum in found if np.isfinite(minimum.cost)]
        if not found:
            raise FloatingPointError("no motion fits the first readings")
        means = np.array([minimum.trajectory.states[-1] for minimum in found]) * smoother.scale
        costs = np.array([minimum.cost for minimum in found])
        best = best_apart(search.problem, means, costs, search.spacing)[:keep]
        return [
            self.from_prior(found[i].trajectory.start)
            for i in best
            if costs[i] < costs[best[0]] + NO_RIVAL
        ]

    def screened_costs(self, starts: np.ndarray) -> np.ndarray:
        """Return the cost of each start (S, n), from a part of the epochs."""
        problem = self.problem
        shown = shown_epochs(problem.epochs)
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
                left = losses(white, self.loss, self.threshold).sum(axis=0)
                costs += problem.epochs / len(shown) * left
        return costs

    def answer(self, minimum: Minimum) -> tuple[np.ndarray, np.ndarray]:
        """Return the mean (K, n) and the smoothed covariance (K, n, n) at a minimum."""
        cov = _smoothed_cov(self.transition, self.process_cov, minimum.filtered_cov, minimum.rows)
        return minimum.trajectory.states * self.scale, cov * np.outer(self.scale, self.scale)


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
