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

Starts for whole flights are few, and where the prior is wide they lie far apart: of 1024 across a
standard deviation of 10 km the nearest to a place beyond two of them is some 1.3 km away, and the
cost there tells no more than anywhere. So the first window of readings is searched as matchers do
(:mod:`ggbench.engines.windows`), on a grid fine enough for the field, and what fits it is one more
start each. Where the first readings say nothing, those for the whole flight remain.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from ..block import BlockEstimator, EstimateBlock, ProblemBlock
from ..engines.iterated_smoother import IteratedSmoother, Minimum, Trajectory
from ..engines.multistart import NO_RIVAL, across_prior, multistart, shown_epochs, window_search
from ..engines.windows import refined
from ..problem import Causality, Estimate, Problem
from . import robust, told_noise
from .robust import Loss
from .ukf import MatrixSquareRoot

_MOST_STARTS = 1_000_000
"""Starts that fit in memory."""


@dataclass(frozen=True)
class GaussNewton(BlockEstimator):
    """Most probable trajectory, by Gauss–Newton from several starts.

    Parameters
    ----------
    starts : number of initial positions (states in metres) spread over the prior; 1 starts from
        the prior's mean alone. A filter's track is one more start.
    refine : how many of them, those of the lowest costs, are refined.
    window : number of epochs with readings that are searched on a grid; 0 for none. With one start
        nothing is searched.
    spacing_m : step of that grid [m], a quarter of the field's correlation length.
    max_iterations : limit of Gauss–Newton steps from each start.
    loss : ``huber`` or ``cauchy`` on each component of a reading, by iteratively reweighted least
        squares; see :mod:`ggbench.estimators.robust`.
    threshold : residual [standard deviations of the noise] from which the loss acts; if not
        given, 1.345 for ``huber`` and 2.385 for ``cauchy``.
    noise_scale : factor on the standard deviations of the readings of gravity and its gradients,
        as the estimator is told them; see :mod:`ggbench.estimators.told_noise`.
    engine : ``numpy``, the reference, or ``numba``: the same searches, compiled, those of many runs
        at once.
    """

    starts: int = 1024
    refine: int = 5
    window: int = 20
    spacing_m: float = 250.0
    max_iterations: int = 30
    loss: Loss = "none"
    threshold: float | None = None
    noise_scale: float = 1.0
    engine: Literal["numpy", "numba"] = "numpy"

    name = "gauss-newton"

    @property
    def causality(self) -> Causality:
        """All measurements."""
        return "batch"

    @property
    def takes_blocks(self) -> bool:
        """Only the engine ``numba``."""
        return self.engine == "numba"

    def skip(self, problem: Problem) -> str | None:
        """Refuse limits that leave nothing to do."""
        if not 1 <= self.starts <= _MOST_STARTS:
            return f"starts must be 1 to {_MOST_STARTS}, and is {self.starts}"
        for name in ("refine", "max_iterations"):
            if getattr(self, name) < 1:
                return f"{name} must be at least 1, and is {getattr(self, name)}"
        if self.window < 0:
            return f"window must not be negative, and is {self.window}"
        if not 0.0 < self.spacing_m < np.inf:
            return f"spacing_m must be positive and finite, and is {self.spacing_m:g}"
        if reason := told_noise.refusal(self.noise_scale):
            return reason
        if reason := robust.refusal(self.loss, self.threshold):
            return reason
        return super().skip(problem) if self.takes_blocks else None

    def estimate_block(self, block: ProblemBlock) -> EstimateBlock:
        """Refine the best starts of all runs of a block; the mean is NaN where none has a cost."""
        block = told_noise.told(block, self.noise_scale)
        threshold = robust.threshold_of(self.loss, self.threshold)
        window = self.window if self.starts > 1 else 0
        mean, cov, info = multistart(
            block, self.starts, self.refine, window, self.spacing_m, self.max_iterations,
            self.loss, threshold,
        )  # fmt: skip
        return EstimateBlock(mean, cov, self.causality, info=info)

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        """Refine the best starts and return the trajectory of the lowest cost."""
        if self.takes_blocks:
            return super().estimate(problem, rng)
        problem = told_noise.told(problem, self.noise_scale)
        threshold = robust.threshold_of(self.loss, self.threshold)
        smoother = _Smoother(problem, self.loss, threshold)
        starts = [*smoother.best_starts(self.starts, self.refine), smoother.from_filter()]
        if self.starts > 1 and self.window:
            starts += smoother.from_window(self.window, self.spacing_m, self.refine)
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


class _Smoother(IteratedSmoother):
    """The search of a problem's minimum with a loss, and where it is begun."""

    def __init__(self, problem: Problem, loss: Loss, threshold: float) -> None:
        super().__init__(problem, *robust.of_residuals(loss, threshold))
        self.loss = loss

    def best_starts(self, count: int, keep: int) -> list[Trajectory]:
        """Return the undisturbed motions of lowest costs from positions across the prior."""
        starts = across_prior(self.problem, count)
        if len(starts) == 1:
            return [self.from_prior(starts[0])]
        order = np.argsort(self._screen(starts), kind="stable")
        return [self.from_prior(starts[i]) for i in order[:keep]]

    def from_window(self, count: int, spacing_m: float, keep: int) -> list[Trajectory]:
        """Return the motions that fit the first readings, the most probable first.

        Parameters
        ----------
        count : of epochs with readings. spacing_m : step of the grid [m].
        keep : largest number of motions. None is returned if the grid has one point: there the
            prior's mean is start enough.
        """
        search = window_search(self.problem, count, spacing_m, self.loss)
        if search is None:
            return []
        smoother = IteratedSmoother(search.problem, self.losses, self.weights)
        places = refined(smoother, search.starts(keep), search.spacing)[:keep]
        return [
            self.from_prior(place.start)
            for place in places
            if place.cost < places[0].cost + NO_RIVAL
        ]

    def _screen(self, starts: np.ndarray) -> np.ndarray:
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
                left = self.losses(white).sum(axis=0)
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
