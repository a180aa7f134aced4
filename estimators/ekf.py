"""Extended Kalman filter (filterpy): h linearised at the predicted state, Joseph-form update."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter as FilterpyEKF

from ..problem import Causality, Estimate, Estimator, Problem


@dataclass(frozen=True)
class ExtendedKalmanFilter(Estimator):
    """First-order extended Kalman filter (Bar-Shalom, Li & Kirubarajan 2001, ch. 10)."""

    name = "ekf"

    @property
    def causality(self) -> Causality:
        """Measurements up to each epoch."""
        return "filter"

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        """Predict with Φ and Q, update with H at the predicted state, epoch by epoch."""
        n, m = problem.dimension, problem.measurements.shape[1]
        ekf = FilterpyEKF(dim_x=n, dim_z=m)
        ekf.x = problem.prior_mean.copy()  # filterpy's default (n, 1) would broadcast with a 1-D z
        ekf.P = problem.prior_cov.copy()
        ekf.R = problem.noise_cov
        mean = np.empty((problem.epochs, n))
        cov = np.empty((problem.epochs, n, n))
        for k in range(problem.epochs):
            ekf.F, ekf.Q = problem.transition[k], problem.process_cov[k]
            ekf.predict()
            ekf.update(
                problem.measurements[k],
                HJacobian=lambda x, epoch: problem.model.jacobian(epoch, x),
                Hx=lambda x, epoch: problem.model.predict(epoch, x),
                args=(k,),
                hx_args=(k,),
            )
            ekf.P = 0.5 * (ekf.P + ekf.P.T)
            mean[k], cov[k] = ekf.x, ekf.P
        return Estimate(mean, cov, self.causality)
