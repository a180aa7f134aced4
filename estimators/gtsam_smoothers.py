"""Factor graph (GTSAM): batch, incremental (iSAM2) and fixed-lag smoothing of one graph.

The graph has one vector node per measurement epoch, in units of the prior's standard deviations. It
has three kinds of factors: a prior factor on the first node, a linear process factor between
neighbouring nodes, and a measurement factor on each node.

The process noise is singular, because constant biases have no noise. Therefore the residual of a
process factor is expressed in the eigenvectors of Q, and directions without noise are hard
constraints (Dellaert & Kaess 2017, sec. 2.5). Q is never inflated. Hard constraints require QR
instead of Cholesky elimination.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import gtsam
import numpy as np

from ..problem import Estimate, MeasurementModel, Problem
from .factor_graph import (
    SAME_TIME,
    GraphParameters,
    checked_jacobian,
    noticeable_changes,
    require_shape,
)
from .robust import Loss

_Error = partial[np.ndarray]
_RELATIVE_DECREASE, _ABSOLUTE_DECREASE = 1e-10, 1e-5
"""Decrease of the cost at which the batch search ends: far above the rounding errors of h."""
_NO_NOISE = 1e-13
"""Eigenvalue of a correlation matrix below which a direction of Q counts as free of noise."""


@dataclass(frozen=True)
class GtsamSmoother(GraphParameters):
    """Batch optimizer, iSAM2 and fixed-lag smoother of GTSAM on one factor graph, for any model."""

    name = "gtsam"

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        """Estimate one run: build the factor graph and solve it in the chosen mode."""
        solve = {"batch": self._batch, "isam2": self._isam2, "fixed-lag": self._fixed_lag}
        scaled = _ScaledProblem(problem, self.loss, self.limit)
        mean, cov, info = solve[self.mode](scaled)
        scale = scaled.scale
        mean, cov = mean * scale, cov * np.outer(scale, scale)
        return Estimate(mean, cov, self.causality, self.fixed_lag, info)

    def _batch(self, scaled: _ScaledProblem) -> tuple[np.ndarray, np.ndarray, dict[str, Any]]:
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        for k, factors in enumerate(scaled.factors()):
            for factor in factors:
                graph.add(factor)
            values.insert(k, scaled.predict(k, values.atVector(k - 1) if k else None))
        parameters = gtsam.LevenbergMarquardtParams()
        parameters.setLinearSolverType("MULTIFRONTAL_QR")
        parameters.setMaxIterations(self.max_iterations)
        parameters.setRelativeErrorTol(_RELATIVE_DECREASE)
        parameters.setAbsoluteErrorTol(_ABSOLUTE_DECREASE)
        # The graph is close to linear and well scaled: little damping, so that it takes
        # Gauss-Newton steps until one of them fails.
        parameters.setlambdaInitial(1e-12)
        optimizer = gtsam.LevenbergMarquardtOptimizer(graph, values, parameters)
        before = optimizer.error()
        values = optimizer.optimize()
        if not np.isfinite(optimizer.error()):
            raise FloatingPointError("the cost of the graph is not finite")
        if optimizer.iterations() == 0 and before > 0.0:
            raise RuntimeError("Levenberg-Marquardt failed at its first step")
        linear = graph.linearize(values)
        step = linear.optimize()
        promised = linear.error(gtsam.VectorValues.Zero(step)) - linear.error(step)
        if abs(promised) <= _ABSOLUTE_DECREASE:
            # One step more, which promises too little for the search to have asked for it: so
            # rounding that ends a search a step earlier does not matter.
            values = values.retract(step)
        marginals = gtsam.Marginals(linear, values)
        epochs = range(scaled.problem.epochs)
        mean = np.stack([values.atVector(k) for k in epochs])
        cov = np.stack([marginals.marginalCovariance(k) for k in epochs])
        return mean, cov, {"iterations": optimizer.iterations(), "error": optimizer.error()}

    def _isam2(self, scaled: _ScaledProblem) -> tuple[np.ndarray, np.ndarray, dict[str, Any]]:
        isam = gtsam.ISAM2(self._isam2_parameters(scaled))
        mean, cov = scaled.empty()
        relinearized = 0
        for k, factors in enumerate(scaled.factors()):
            result = isam.update(*scaled.news(k, factors, mean))
            relinearized += result.getVariablesRelinearized()
            mean[k] = isam.calculateEstimateVector(k)
            cov[k] = isam.marginalCovariance(k)
        return mean, cov, {"relinearized": relinearized}

    def _fixed_lag(self, scaled: _ScaledProblem) -> tuple[np.ndarray, np.ndarray, dict[str, Any]]:
        parameters = self._isam2_parameters(scaled)
        smoother = gtsam.IncrementalFixedLagSmoother(self.lag + SAME_TIME, parameters)
        times = scaled.problem.times
        oldest = self.oldest_nodes(times)
        mean, cov = scaled.empty()
        newest = np.empty_like(mean)
        kept = 0  # nodes before this one have left the window and are final
        for k, factors in enumerate(scaled.factors()):
            while kept < oldest[k]:
                mean[kept] = smoother.calculateEstimateVector(kept)
                cov[kept] = smoother.marginalCovariance(kept)
                kept += 1
            graph, values = scaled.news(k, factors, newest)
            smoother.update(graph, values, {k: times[k]})
            newest[k] = smoother.calculateEstimateVector(k)
        for k in range(kept, len(times)):
            mean[k] = smoother.calculateEstimateVector(k)
            cov[k] = smoother.marginalCovariance(k)
        return mean, cov, {}

    def _isam2_parameters(self, scaled: _ScaledProblem) -> gtsam.ISAM2Params:
        parameters = gtsam.ISAM2Params()
        parameters.setFactorization("QR")
        parameters.relinearizeSkip = 1
        limits = self.relinearize_threshold * noticeable_changes(scaled.problem) / scaled.scale
        of_nodes = gtsam.ISAM2ThresholdMap()
        of_nodes.insert((chr(0), limits))  # the keys of nodes are numbers: symbols without a letter
        parameters.setRelinearizeThreshold(of_nodes)
        parameters.findUnusedFactorSlots = True
        # No wildfire threshold: every change reaches every node, so that the result is exact.
        parameters.setOptimizationParams(gtsam.ISAM2GaussNewtonParams(0.0))
        return parameters


class _ScaledProblem:
    """Problem in standard deviations of the prior, and its factors."""

    def __init__(self, problem: Problem, loss: Loss, threshold: float) -> None:
        self.problem = problem
        self.loss, self.threshold = loss, threshold
        self.scale = np.sqrt(np.diag(problem.prior_cov))
        self.transition = problem.transition * self.scale / self.scale[:, None]
        self.process_cov = problem.process_cov / np.outer(self.scale, self.scale)

    def empty(self) -> tuple[np.ndarray, np.ndarray]:
        """Return arrays for the mean (K, n) and the covariance (K, n, n)."""
        epochs, n = self.problem.epochs, self.problem.dimension
        return np.empty((epochs, n)), np.empty((epochs, n, n))

    def predict(self, k: int, previous: np.ndarray | None) -> np.ndarray:
        """Return the predicted node k from the node before it (None: from the prior)."""
        if previous is None:
            previous = self.problem.prior_mean / self.scale
        return self.transition[k] @ previous

    def news(
        self, k: int, factors: list[gtsam.NonlinearFactor], mean: np.ndarray
    ) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
        """Return the new factors and the initial value of node k for an incremental solver.

        The initial value is predicted from ``mean[k - 1]``, or from the prior for k = 0.
        """
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        for factor in factors:
            graph.add(factor)
        values.insert(k, self.predict(k, mean[k - 1] if k else None))
        return graph, values

    def factors(self) -> Iterator[list[gtsam.NonlinearFactor]]:
        """Yield the factors that each epoch adds to the graph."""
        for k in range(self.problem.epochs):
            motion = self._process_factor(k) if k else self._prior_factor()
            if self.loss == "none" or self.threshold == np.inf:
                yield [motion, self._gradient_factor(k)]
            else:
                yield [motion, *self._robust_factors(k)]

    def _prior_factor(self) -> gtsam.NonlinearFactor:
        """Return the factor of the prior, propagated from the start to the first epoch."""
        phi = self.transition[0]
        start = self.problem.prior_cov / np.outer(self.scale, self.scale)
        cov = phi @ start @ phi.T + self.process_cov[0]
        noise = gtsam.noiseModel.Gaussian.Covariance(0.5 * (cov + cov.T))
        return gtsam.PriorFactorVector(0, self.predict(0, None), noise)

    def _process_factor(self, k: int) -> gtsam.NonlinearFactor:
        """Return the factor Mᵀ(x_k − Φ x_{k−1}) with the rows of Mᵀ whitened or constrained."""
        rows, sigmas = _noise_directions(self.process_cov[k])
        noise = gtsam.noiseModel.Constrained.MixedSigmas(np.ones(len(sigmas)), sigmas)
        origin = gtsam.Values()  # without it the container ignores the point it is evaluated at
        origin.insert(k - 1, np.zeros(len(sigmas)))
        origin.insert(k, np.zeros(len(sigmas)))
        linear = gtsam.JacobianFactor(
            k - 1, -rows @ self.transition[k], k, rows, np.zeros(len(sigmas)), noise
        )
        return gtsam.LinearContainerFactor(linear, origin)

    def _gradient_factor(self, k: int) -> gtsam.NonlinearFactor:
        """Return the custom factor h(k, x_k) − z_k."""
        noise = gtsam.noiseModel.Gaussian.Covariance(self.problem.noise_of(k))
        return gtsam.CustomFactor(noise, [k], self._error(k))

    def _error(self, k: int) -> _Error:
        # A partial of a module-level function: a callback that owned its factor would leak.
        return partial(
            _gradient_error, self.problem.model, self.problem.measurements[k], self.scale, k
        )

    def _robust_factors(self, k: int) -> list[gtsam.NonlinearFactor]:
        """Return a custom factor with a robust loss for each component of the whitened residual.

        GTSAM's robust noise model of a vector computes one weight from the norm of the residual.
        One bad component would therefore reduce the weight of the whole measurement.
        """
        estimators = gtsam.noiseModel.mEstimator
        if self.loss == "huber":
            robustness: gtsam.noiseModel.mEstimator.Base = estimators.Huber.Create(self.threshold)
        else:
            robustness = estimators.Cauchy.Create(self.threshold)
        noise = gtsam.noiseModel.Robust.Create(robustness, gtsam.noiseModel.Unit.Create(1))
        root = np.linalg.cholesky(self.problem.noise_of(k))
        reading = _Reading(self._error(k), root)
        return [
            gtsam.CustomFactor(noise, [k], partial(_component_error, reading, c))
            for c in range(len(root))
        ]


def _gradient_error(
    model: MeasurementModel,
    measurement: np.ndarray,
    scale: np.ndarray,
    k: int,
    factor: gtsam.CustomFactor,
    values: gtsam.Values,
    jacobians: list[np.ndarray] | None,
) -> np.ndarray:
    """Return h(k, x) − z; fill ``jacobians[0]`` with the Jacobian unless it is None.

    Only this callback passes arrays from Python to GTSAM. A Jacobian that is missing,
    one-dimensional or of the wrong width would crash the process or falsify the result. Therefore
    the function checks all shapes.
    """
    x = values.atVector(k) * scale
    if jacobians is not None:
        jacobians[0] = np.asfortranarray(checked_jacobian(model, k, x, len(measurement)) * scale)
    predicted = np.asarray(model.predict(k, x), dtype=float)
    require_shape("prediction", predicted, measurement.shape)
    return predicted - measurement


class _Reading:
    """Whitened residual of a measurement and its Jacobian at the last state evaluated.

    GTSAM evaluates the components of a measurement one by one, all at the same state.
    """

    def __init__(self, error: _Error, noise_root: np.ndarray) -> None:
        self._error, self._root = error, noise_root
        self._at = b""
        self.residual = self.jacobian = np.empty(0)

    def at(self, factor: gtsam.CustomFactor, values: gtsam.Values) -> None:
        """Evaluate residual and Jacobian at the state of the factor's node, if it has changed."""
        state = values.atVector(factor.keys()[0]).tobytes()
        if state == self._at:
            return
        jacobians = [np.empty(0)]
        residual = self._error(factor, values, jacobians)
        self.residual = np.linalg.solve(self._root, residual)
        self.jacobian = np.linalg.solve(self._root, jacobians[0])
        self._at = state


def _component_error(
    reading: _Reading,
    component: int,
    factor: gtsam.CustomFactor,
    values: gtsam.Values,
    jacobians: list[np.ndarray] | None,
) -> np.ndarray:
    """Return one component of the whitened residual; fill its Jacobian (1, n) unless None."""
    reading.at(factor, values)
    if jacobians is not None:
        jacobians[0] = np.asfortranarray(reading.jacobian[component : component + 1])
    return reading.residual[component : component + 1]


def _noise_directions(cov: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return a matrix M and σ such that M w ~ N(0, diag(σ²)) for w ~ N(0, cov).

    ``cov`` may be singular; σ is zero in directions without noise.
    """
    sigma = np.sqrt(np.diag(cov))
    noisy = sigma > 0.0
    rows = np.eye(len(cov))
    sigmas = np.zeros(len(cov))
    if noisy.any():
        # Eigenvectors of the correlation, so that no unit outweighs another.
        block = np.ix_(noisy, noisy)
        values, vectors = np.linalg.eigh(cov[block] / np.outer(sigma[noisy], sigma[noisy]))
        rows[block] = vectors.T / sigma[noisy]
        sigmas[noisy] = np.where(values > _NO_NOISE, np.sqrt(np.maximum(values, 0.0)), 0.0)
    return rows, sigmas
