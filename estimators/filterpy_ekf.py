"""Extended Kalman filter of filterpy, with no method overridden."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..problem import Estimate, Estimator, Problem


@dataclass(frozen=True)
class FilterpyExtended(Estimator):
    """``filterpy.kalman.ExtendedKalmanFilter`` on any measurement model."""

    name = "filterpy-ekf"
    family = "kalman"
    causality = "filter"

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        """Filter one run: predict with Φ and Q, update with h and H at the prediction."""
        # Not at the top: it loads as slowly as all the rest, and to be listed needs none of it.
        from filterpy.kalman import ExtendedKalmanFilter

        n, m = problem.dimension, problem.measurements.shape[1]
        ekf = ExtendedKalmanFilter(dim_x=n, dim_z=m)
        ekf.x = problem.prior_mean.copy()  # filterpy's default (n, 1) would broadcast with a 1-D z
        ekf.P = problem.prior_cov.copy()
        mean, cov = np.empty((problem.epochs, n)), np.empty((problem.epochs, n, n))
        for k in range(problem.epochs):
            ekf.F, ekf.Q = problem.transition[k], problem.process_cov[k]
            ekf.predict()
            ekf.update(
                problem.measurements[k],
                HJacobian=lambda x, k: problem.model.jacobian(k, x),
                Hx=lambda x, k: problem.model.predict(k, x),
                R=problem.noise_of(k),
                args=(k,),
                hx_args=(k,),
            )
            mean[k], cov[k] = ekf.x, 0.5 * (ekf.P + ekf.P.T)
        return Estimate(mean, cov, self.causality)
