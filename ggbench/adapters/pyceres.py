"""pyceres (Ceres Solver): the most probable trajectory by dense nonlinear least squares.

Install the extra ``pyceres``: ``pip install 'ggbench[pyceres]'``. The process noise covariance is
singular, and Ceres has no equality constraints. Therefore the unknowns are standard normal vectors
u and w_k:

    x_0 = prior_mean + L u,  L Lᵀ = prior_cov
    x_k = Φ_k x_{k−1} + G_k w_k,  G_k G_kᵀ = Q_k

G_k has as many columns as the rank of Q_k. The residuals are these unknowns and the whitened
residuals of the measurements.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from ..parameters import AtLeastOne
from ..problem import Causality, Estimate, Estimator, Family, Problem, jacobian_along, predict_along

try:
    import pyceres
except ImportError as error:
    raise ImportError(
        f"{__name__} needs pyceres ({error}): pip install 'ggbench[pyceres]'"
    ) from error

LIBRARIES = ("pyceres",)
"""Distributions on whose versions the estimators' results depend."""
_ENOUGH = 1e-10
"""Relative decrease of the cost, and size of the gradient, below which the iteration ends."""
_UNDAMPED = 1e16
"""Initial radius of the trust region; its reciprocal is the damping."""


class _Trajectory:
    """The states as linear functions of the unknowns, and the whitened measurements."""

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        roots = [problem.noise_root(k) for k in range(problem.epochs)]
        n, size = problem.dimension, problem.dimension + sum(root.shape[1] for root in roots)
        self.mean = np.empty((problem.epochs, n))
        self.rows = np.zeros((problem.epochs, n, size))
        mean, rows, first = problem.prior_mean, np.zeros((n, size)), n
        rows[:, :n] = np.linalg.cholesky(problem.prior_cov)
        for k, root in enumerate(roots):
            mean, rows = problem.transition[k] @ mean, problem.transition[k] @ rows
            rows[:, first : first + root.shape[1]] += root
            first += root.shape[1]
            self.mean[k], self.rows[k] = mean, rows
        m = problem.measurements.shape[1]
        noise = np.broadcast_to(problem.noise_cov, (problem.epochs, m, m))
        self._noise_root = np.linalg.cholesky(noise)
        self._epochs = np.arange(problem.epochs)
        self.size, self.count = size, size + problem.measurements.size

    def states(self, unknowns: np.ndarray) -> np.ndarray:
        """Return the states (K, n)."""
        return np.asarray(self.mean + self.rows @ unknowns)

    def residuals(self, unknowns: np.ndarray) -> np.ndarray:
        """Return the residuals: the unknowns, and the whitened residuals of the measurements."""
        predicted = predict_along(self.problem.model, self._epochs, self.states(unknowns))
        innovation = (self.problem.measurements - predicted)[..., np.newaxis]
        return np.concatenate([unknowns, np.linalg.solve(self._noise_root, innovation).ravel()])

    def jacobian(self, unknowns: np.ndarray) -> np.ndarray:
        """Return the Jacobian of the residuals with respect to the unknowns."""
        h = jacobian_along(self.problem.model, self._epochs, self.states(unknowns))
        along = np.linalg.solve(self._noise_root, h @ self.rows)
        return np.concatenate([np.eye(self.size), -along.reshape(-1, self.size)])


class _Cost(pyceres.CostFunction):
    """Cost function of Ceres with all residuals."""

    def __init__(self, trajectory: _Trajectory) -> None:
        super().__init__()
        self._trajectory = trajectory
        self.set_num_residuals(trajectory.count)
        self.set_parameter_block_sizes([trajectory.size])

    def Evaluate(self, parameters: Any, residuals: Any, jacobians: Any) -> bool:
        """Fill the residuals and, if requested, the Jacobian."""
        unknowns = np.asarray(parameters[0])
        residuals[:] = self._trajectory.residuals(unknowns)
        if jacobians is not None:
            jacobians[0][:] = self._trajectory.jacobian(unknowns).ravel()
        return True


@dataclass(frozen=True)
class PyceresBatch(Estimator):
    """Batch smoother by Levenberg–Marquardt steps of Ceres.

    Parameters
    ----------
    max_iterations : largest number of steps.
    """

    max_iterations: AtLeastOne = 50

    name = "pyceres-batch"
    family: ClassVar[Family] = "smoother"

    @property
    def causality(self) -> Causality:
        """Causality ``batch``: every estimate uses all measurements."""
        return "batch"

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        """Compute the most probable trajectory with Ceres; no random numbers are used."""
        trajectory = _Trajectory(problem)
        unknowns = np.zeros(trajectory.size)
        graph = pyceres.Problem()
        graph.add_residual_block(_Cost(trajectory), pyceres.TrivialLoss(), [unknowns])
        options, summary = pyceres.SolverOptions(), pyceres.SolverSummary()
        options.linear_solver_type = pyceres.LinearSolverType.DENSE_NORMAL_CHOLESKY
        options.max_num_iterations = self.max_iterations
        options.function_tolerance = options.gradient_tolerance = _ENOUGH
        # The first step is one of Gauss and Newton: a damped one leaves a share of the error where
        # the cost is flat, and a linear problem is then solved to 1e-5 posterior deviations only.
        options.initial_trust_region_radius = _UNDAMPED
        options.num_threads = 1
        options.minimizer_progress_to_stdout = False
        pyceres.solve(options, graph, summary)
        jacobian = trajectory.jacobian(unknowns)
        spread = np.linalg.inv(jacobian.T @ jacobian)
        cov = trajectory.rows @ spread @ trajectory.rows.transpose(0, 2, 1)
        info = {"error": float(summary.final_cost), "iterations": summary.num_successful_steps}
        cov = 0.5 * (cov + cov.transpose(0, 2, 1))
        return Estimate(trajectory.states(unknowns), cov, self.causality, info=info)
