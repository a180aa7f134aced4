"""Unscented Kalman filter of filterpy, with no method overridden."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..numerics.positive import MatrixSquareRoot
from ..problem import Estimate, Problem
from .ukf import SigmaPoints


@dataclass(frozen=True)
class FilterpyUnscented(SigmaPoints):
    """``filterpy.kalman.UnscentedKalmanFilter`` on any measurement model.

    In filterpy the method of the matrix square root is a parameter of the sigma points. The default
    method is the Cholesky factorisation. It fails if the negative weight of the central point in
    Wang et al. 2013 makes P indefinite. This class then uses a root of the nearest positive
    definite matrix, and counts these repairs.
    """

    name = "filterpy-ukf"
    causality = "filter"

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        """Filter one run: propagate sigma points through Φ and h, epoch by epoch."""
        # Not at the top: it loads as slowly as all the rest, and to be listed needs none of it.
        from filterpy.kalman import (
            JulierSigmaPoints,
            MerweScaledSigmaPoints,
            UnscentedKalmanFilter,
        )

        n, m = problem.dimension, problem.measurements.shape[1]
        root, kappa = MatrixSquareRoot(), self.kappa_of(n)
        if self.points == "merwe":
            points = MerweScaledSigmaPoints(n, self.alpha, self.beta, kappa, sqrt_method=root)
        else:
            points = JulierSigmaPoints(n, kappa=kappa, sqrt_method=root)
        ukf = UnscentedKalmanFilter(
            dim_x=n,
            dim_z=m,
            dt=1.0,
            fx=lambda x, dt, epoch: problem.transition[epoch] @ x,
            hx=lambda x, epoch: problem.model.predict(epoch, x),
            points=points,
        )
        ukf.x, ukf.P = problem.prior_mean.copy(), problem.prior_cov.copy()
        mean, cov = np.empty((problem.epochs, n)), np.empty((problem.epochs, n, n))
        for k in range(problem.epochs):
            ukf.Q = problem.process_cov[k]
            ukf.predict(epoch=k)
            ukf.update(problem.measurements[k], R=problem.noise_of(k), epoch=k)
            ukf.P = root.repaired(ukf.P)
            mean[k], cov[k] = ukf.x, ukf.P
        return Estimate(mean, cov, self.causality, info={"covariance_repairs": root.repairs})
