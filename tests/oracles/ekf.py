"""The iterated, robust, adaptive and gated extended Kalman filter, by filterpy's updates."""

from __future__ import annotations

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter as FilterpyEKF

from ggbench.engines.innovation_gating import gate_limits
from ggbench.estimators.ekf import ExtendedKalmanFilter
from ggbench.problem import Estimate, Problem

from .gating import joseph, normalised_square
from .textbook import Update


def estimate(filter: ExtendedKalmanFilter, problem: Problem) -> Estimate:
    """Predict with Φ and Q, update with h linearised where it fits, epoch by epoch."""
    n, m = problem.dimension, problem.measurements.shape[1]
    ekf = FilterpyEKF(dim_x=n, dim_z=m)
    ekf.x = problem.prior_mean.copy()  # filterpy's default (n, 1) would broadcast with a 1-D z
    ekf.P = problem.prior_cov.copy()
    noise = _AdaptiveNoise(m, filter.noise_memory)
    threshold = filter.limit
    limits = gate_limits(filter.gate, problem.present)
    mean = np.empty((problem.epochs, n))
    cov = np.empty((problem.epochs, n, n))
    linearisations = rejected = 0
    for k in range(problem.epochs):
        ekf.F, ekf.Q = problem.transition[k], problem.process_cov[k]
        ekf.predict()
        believed = noise.of(problem.noise_of(k))
        update = Gated(
            problem,
            k,
            predicted=ekf.x,
            cov=ekf.P,
            noise_cov=believed,
            loss=filter.loss,
            threshold=threshold,
        )
        if filter.iterations > 1:
            update.minimise(filter.iterations)
        linearisations += update.linearisations
        if limits[k] < np.inf and update.square(filter.underweighting) > limits[k]:
            rejected += 1
        else:
            ekf.update(
                problem.measurements[k],
                HJacobian=lambda x, u: u.rows,
                Hx=lambda x, u: u.h,
                R=update.underweighted_noise(filter.underweighting),
                args=(update,),
                hx_args=(update,),
            )
            if filter.underweighting:  # filterpy took the noise of the gain for that of readings
                ekf.P = joseph(update.cov, ekf.K, update.rows, update.noise_cov)
        if filter.iterations > 1:
            ekf.x = update.x  # filterpy takes the whole of one step, from the prediction
        ekf.P = 0.5 * (ekf.P + ekf.P.T)
        mean[k], cov[k] = ekf.x, ekf.P
        if filter.noise_memory:
            noise.learn(
                problem.noise_of(k),
                problem.present[k],
                problem.measurements[k] - problem.model.predict(k, ekf.x),
                update.rows @ ekf.P @ update.rows.T,
                update.noise_cov,
            )
    info = {"linearisations": linearisations}
    if filter.gate:
        info["rejected"] = rejected
    return Estimate(mean, cov, filter.causality, info=info)


class Gated(Update):
    """An update that may be gated, or have an underweighted gain."""

    def underweighted_noise(self, underweighting: float) -> np.ndarray:
        """R + β H P Hᵀ, the noise with which a filter has the underweighted gain."""
        if not underweighting:
            return self.noise_cov
        return self.noise_cov + underweighting * self.innovation()[1]

    def square(self, underweighting: float) -> float:
        """yᵀ S⁻¹ y of the innovation, by the S of the gain."""
        innovation, spread = self.innovation()
        return normalised_square(innovation, spread + self.underweighted_noise(underweighting))


class _AdaptiveNoise:
    """Variances of the components of the whitened noise, estimated from what updates leave."""

    def __init__(self, channels: int, memory: int) -> None:
        self._memory = memory
        self._readings, self._variances = np.ones(channels), np.ones(channels)

    def of(self, given: np.ndarray) -> np.ndarray:
        """Return what is believed by now of a noise covariance that is given."""
        if not self._memory:
            return given
        root = np.linalg.cholesky(given)
        return np.asarray((root * self._variances) @ root.T)

    def learn(
        self,
        given: np.ndarray,
        there: np.ndarray,
        residual: np.ndarray,
        spread: np.ndarray,
        weighted_cov: np.ndarray,
    ) -> None:
        """Take in a residual after the update: its expected square is R − H P⁺ Hᵀ.

        Of the channels that are ``there``; R was ``given`` so, and ``weighted_cov`` used.
        """
        root = np.linalg.cholesky(given)
        white = np.linalg.solve(root, residual)
        certain = np.linalg.solve(root, np.linalg.solve(root, spread).T)
        # A component that a robust loss holds for an outlier counts as little as it did there.
        weighted = np.linalg.solve(root, np.linalg.solve(root, weighted_cov).T)
        weight = self._variances / np.diag(weighted)
        self._readings[there] = np.minimum(self._readings + 1.0, self._memory)[there]
        new = weight * white**2 + np.diag(certain)
        self._variances[there] += ((new - self._variances) / self._readings)[there]
