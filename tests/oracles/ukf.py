"""filterpy's unscented filter with all sigma points at once, a loss, a gate, another gain.

filterpy calls f and h point by point; its equations are unchanged. A robust loss replaces R, an
underweighted gain has another S, and what is beyond a gate's limit is left out.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from filterpy.kalman import (
    JulierSigmaPoints,
    MerweScaledSigmaPoints,
    UnscentedKalmanFilter,
    unscented_transform,
)

from ggbench.engines.innovation_gating import gate_limits
from ggbench.engines.robust_weights import reweighted_noise
from ggbench.estimators.robust import Loss
from ggbench.estimators.ukf import UnscentedKalmanFilter as Compiled
from ggbench.numerics.positive import MatrixSquareRoot
from ggbench.problem import Estimate, Problem

from .gating import normalised_square


class VectorizedUKF(UnscentedKalmanFilter):
    x: np.ndarray
    P: np.ndarray
    loss: Loss = "none"
    threshold: float = np.inf
    underweighting: float = 0.0
    limit: float = np.inf
    rejected: int = 0

    def compute_process_sigmas(self, dt: float, fx: Any = None, **fx_args: Any) -> None:
        points = self.points_fn.sigma_points(self.x, self.P)
        self.sigmas_f = (fx or self.fx)(points, dt, **fx_args)

    def update(self, z: np.ndarray, **hx_args: Any) -> None:
        self.sigmas_h = self.hx(self.sigmas_f, **hx_args)
        predicted, self.S = unscented_transform(self.sigmas_h, self.Wm, self.Wc, self.R)
        if self.loss != "none":
            _, spread = unscented_transform(self.sigmas_h, self.Wm, self.Wc)
            self.S = spread + reweighted_noise(
                z - predicted, spread, self.R, self.loss, self.threshold
            )
        if self.underweighting:
            _, spread = unscented_transform(self.sigmas_h, self.Wm, self.Wc)
            self.S = self.S + self.underweighting * spread
        self.y = z - predicted
        if self.limit < np.inf and normalised_square(self.y, self.S) > self.limit:
            self.rejected += 1
            return
        deviations = self.Wc[:, None] * (self.sigmas_f - self.x)
        cross_cov = deviations.T @ (self.sigmas_h - predicted)
        self.K = np.linalg.solve(self.S, cross_cov.T).T
        self.x = self.x + self.K @ self.y
        self.P = self.P - self.K @ self.S @ self.K.T
        if self.underweighting:
            # P − K P_xzᵀ − P_xz Kᵀ + K P_zz Kᵀ with P_xz = K S and P_zz = S − β P_hh.
            self.P = self.P - self.underweighting * self.K @ spread @ self.K.T


def estimate(filter: Compiled, problem: Problem) -> Estimate:
    """Sigma points through Φ and h, epoch by epoch."""
    n, m = problem.dimension, problem.measurements.shape[1]
    root = MatrixSquareRoot()
    kappa = filter.kappa_of(n)
    if filter.points in ("julier", "cubature"):
        points = JulierSigmaPoints(n, kappa=kappa, sqrt_method=root)
    else:
        points = MerweScaledSigmaPoints(n, filter.alpha, filter.beta, kappa, sqrt_method=root)
    ukf = VectorizedUKF(
        dim_x=n,
        dim_z=m,
        dt=1.0,
        fx=lambda points, dt, epoch: points @ problem.transition[epoch].T,
        hx=lambda points, epoch: problem.model.predict(epoch, points),
        points=points,
    )
    ukf.x, ukf.P = problem.prior_mean.copy(), problem.prior_cov.copy()
    ukf.underweighting = filter.underweighting
    limits = gate_limits(filter.gate, problem.present)
    ukf.loss, ukf.threshold = filter.loss, filter.limit
    mean = np.empty((problem.epochs, n))
    cov = np.empty((problem.epochs, n, n))
    for k in range(problem.epochs):
        ukf.Q, ukf.R = problem.process_cov[k], problem.noise_of(k)
        ukf.limit = limits[k]
        ukf.predict(epoch=k)
        ukf.update(problem.measurements[k], epoch=k)
        ukf.P = root.repaired(ukf.P)
        mean[k], cov[k] = ukf.x, ukf.P
    info = {"covariance_repairs": root.repairs}
    if filter.gate:
        info["rejected"] = ukf.rejected
    return Estimate(mean, cov, filter.causality, info=info)
