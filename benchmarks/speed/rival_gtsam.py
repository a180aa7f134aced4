"""Batch smoother of gtsam in its usual form.

There is one graph. h and H are in NumPy as a CustomFactor, and the optimiser is
Levenberg–Marquardt. The state is in units of the prior standard deviations. The residual of the
process factor is along the eigenvectors of Q. The biases have no process noise, and are therefore
hard constraints. Without this form, gtsam does not solve the graph, or only with artificial noise.
"""

from __future__ import annotations

from functools import partial

import gtsam
import numpy as np

from .numpy_model import NumpyModel
from .problem_file import Arrays


def reading_error(
    model: NumpyModel,
    measurement: np.ndarray,
    scale: np.ndarray,
    k: int,
    factor: gtsam.CustomFactor,
    values: gtsam.Values,
    jacobians: list[np.ndarray] | None,
) -> np.ndarray:
    """Return the residual h(x) − z, and set its Jacobian in ``jacobians``."""
    x = values.atVector(k) * scale
    if jacobians is not None:
        jacobians[0] = np.asfortranarray(model.jacobian(k, x) * scale)
    return model.predict(k, x) - measurement


def process_factor(k: int, phi: np.ndarray, q: np.ndarray) -> gtsam.NonlinearFactor:
    """Return the linear factor between x_{k−1} and x_k for a singular Q."""
    n = len(phi)
    noisy = np.diag(q) > 0.0
    rows, sigmas = np.eye(n), np.zeros(n)
    sigma = np.sqrt(np.diag(q)[noisy])
    block = np.ix_(noisy, noisy)
    values, vectors = np.linalg.eigh(q[block] / np.outer(sigma, sigma))
    rows[block] = vectors.T / sigma
    sigmas[noisy] = np.sqrt(np.maximum(values, 0.0)) * (values > 1e-13)
    noise = gtsam.noiseModel.Constrained.MixedSigmas(np.ones(n), sigmas)
    linear = gtsam.JacobianFactor(k - 1, -rows @ phi, k, rows, np.zeros(n), noise)
    origin = gtsam.Values()
    origin.insert(k - 1, np.zeros(n))
    origin.insert(k, np.zeros(n))
    return gtsam.LinearContainerFactor(linear, origin)


class Batch:
    """Batch smoother that also computes all marginal covariances."""

    runs_per_call = 1

    def __init__(self, arrays: Arrays) -> None:
        self.arrays = arrays
        self.models = [NumpyModel(arrays, run) for run in range(arrays.runs)]

    def solve(self, run: int) -> np.ndarray:
        """Return the means (1, K, n) of a run."""
        a, model, scale = self.arrays, self.models[run], self.arrays.scale
        noise = gtsam.noiseModel.Gaussian.Covariance(a.noise_cov)
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        x = a.prior_mean / scale
        for k in range(len(a.times)):
            phi = a.transition[run, k] * scale / scale[:, None]
            q = a.process_cov[run, k] / np.outer(scale, scale)
            x = phi @ x
            if k:
                graph.add(process_factor(k, phi, q))
            else:
                cov = phi @ (a.prior_cov / np.outer(scale, scale)) @ phi.T + q
                start = gtsam.noiseModel.Gaussian.Covariance(0.5 * (cov + cov.T))
                graph.add(gtsam.PriorFactorVector(0, x, start))
            error = partial(reading_error, model, a.measurements[run, k], scale, k)
            graph.add(gtsam.CustomFactor(noise, [k], error))
            values.insert(k, x)
        parameters = gtsam.LevenbergMarquardtParams()
        parameters.setLinearSolverType("MULTIFRONTAL_QR")
        parameters.setRelativeErrorTol(1e-10)
        parameters.setlambdaInitial(1e-12)
        values = gtsam.LevenbergMarquardtOptimizer(graph, values, parameters).optimize()
        marginals = gtsam.Marginals(graph.linearize(values), values)
        for k in range(len(a.times)):
            marginals.marginalCovariance(k)
        return np.stack([values.atVector(k) for k in range(len(a.times))])[None] * scale
