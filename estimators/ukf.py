"""Unscented Kalman filter (filterpy): the paper's sigma points, the scaled set, cubature points.

filterpy 2.0 redraws the sigma points from the predicted mean and covariance before the update, so
the process noise is in them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import Any, Literal

import numpy as np

from ..block import BlockEstimator, EstimateBlock, ProblemBlock
from ..engines import filters
from ..engines.cautious_update import gate_limits
from ..numerics.positive import nearest_root
from ..problem import Causality, Estimate, Problem
from . import cautious, robust, told_noise
from .robust import Loss


class MatrixSquareRoot:
    """Upper-triangular square root of a covariance that may have lost positive definiteness.

    The paper's centre weight is negative, so nothing guarantees that P stays positive definite. It
    is symmetrised and factorised by Cholesky; where that fails, the root is that of its nearest
    positive part, and the repair is counted.
    """

    def __init__(self) -> None:
        self.repairs = 0

    def __call__(self, matrix: np.ndarray) -> np.ndarray:
        """Return U (n, n), upper triangular, with Uᵀ U = P or its nearest positive part."""
        try:
            return np.linalg.cholesky(0.5 * (matrix + matrix.T)).T
        except np.linalg.LinAlgError:
            self.repairs += 1
        return nearest_root(matrix)

    def repaired(self, matrix: np.ndarray) -> np.ndarray:
        """Return the symmetric, positive definite covariance that the square root stands for."""
        before = self.repairs
        root = self(matrix)
        return 0.5 * (matrix + matrix.T) if self.repairs == before else root.T @ root


@cache
def _vectorized_ukf() -> Any:
    """Return filterpy's filter as a class with all sigma points through f and h in one call each.

    filterpy calls them point by point; its equations are unchanged. A robust loss replaces R, an
    underweighted gain has another S, and what is beyond a gate's limit is left out.
    """
    # Not at the top: it loads as slowly as all the rest, and to be listed needs none of it.
    from filterpy.kalman import UnscentedKalmanFilter, unscented_transform

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
                self.S = spread + robust.reweighted_noise(
                    z - predicted, spread, self.R, self.loss, self.threshold
                )
            if self.underweighting:
                _, spread = unscented_transform(self.sigmas_h, self.Wm, self.Wc)
                self.S = self.S + self.underweighting * spread
            self.y = z - predicted
            if self.limit < np.inf and cautious.normalised_square(self.y, self.S) > self.limit:
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

    return VectorizedUKF


@dataclass(frozen=True)
class UnscentedKalmanFilter(BlockEstimator):
    """Unscented Kalman filter (Julier & Uhlmann 2004; eqs. 13–16 of Wang et al. 2013, corrected).

    Parameters
    ----------
    points : ``julier`` for the paper's set, λ = κ; ``merwe`` for the scaled set (van der Merwe);
        ``cubature`` for the 2n points of Arasaratnam & Haykin 2009, which are the paper's set with
        κ = 0: its centre then weighs nothing, and no weight is negative.
    kappa : κ; if not given, the paper's 3 − n for ``julier`` and 0 for ``merwe``.
    alpha, beta : spread and prior-knowledge parameters of the scaled set.
    loss : ``huber`` or ``cauchy`` weigh down the components of a reading that fit neither the
        prediction nor each other; see :mod:`ggbench.estimators.robust`.
    threshold : residual [standard deviations of the noise] from which the loss acts; if not
        given, 1.345 for ``huber`` and 2.385 for ``cauchy``.
    noise_scale : factor on the standard deviations of the readings of gravity and its gradients,
        as the estimator is told them; see :mod:`ggbench.estimators.told_noise`.
    gate : probability between 0 and 1 with which a good reading passes; one whose innovation is
        beyond that quantile of χ² is left out. 0 is no gate. See
        :mod:`ggbench.engines.cautious_update`.
    underweighting : β of S = (1 + β) P_hh + R with the covariance P_hh of h, for the gain
        alone; 0 is the optimal gain.
    engine : ``filterpy``, the reference, or ``numba``: the same, compiled, on many runs at once.
    """

    points: Literal["julier", "merwe", "cubature"] = "julier"
    kappa: float | None = None
    alpha: float = 0.5
    beta: float = 2.0
    loss: Loss = "none"
    threshold: float | None = None
    noise_scale: float = 1.0
    gate: float = 0.0
    underweighting: float = 0.0
    engine: Literal["filterpy", "numba"] = "filterpy"

    name = "ukf"

    @property
    def causality(self) -> Causality:
        """Measurements up to each epoch."""
        return "filter"

    @property
    def exact(self) -> bool:
        """Not with a gate, which leaves good readings out, nor with another gain."""
        return not self.gate and not self.underweighting

    @property
    def takes_blocks(self) -> bool:
        """Only the engine ``numba``."""
        return self.engine == "numba"

    def skip(self, problem: Problem) -> str | None:
        """Refuse sigma points that do not exist: their spread must be positive and finite."""
        n = problem.dimension
        if self.points == "cubature" and self.kappa is not None:
            return "cubature points have no kappa"
        kappa = self._kappa(n)
        if not 0.0 < n + kappa < np.inf:
            return f"n + kappa must be positive and finite, and is {n} + {kappa:g}"
        if self.points == "merwe" and not 0.0 < self.alpha < np.inf:
            return f"alpha must be positive and finite, and is {self.alpha:g}"
        if reason := told_noise.refusal(self.noise_scale):
            return reason
        if reason := robust.refusal(self.loss, self.threshold):
            return reason
        if reason := cautious.refusal(self.gate, self.underweighting, self.loss):
            return reason
        return super().skip(problem) if self.takes_blocks else None

    def _kappa(self, n: int) -> float:
        """Return κ, or the default of the chosen set for n states."""
        if self.kappa is not None:
            return self.kappa
        return 3.0 - n if self.points == "julier" else 0.0

    def estimate_block(self, block: ProblemBlock) -> EstimateBlock:
        """Filter all runs of a block."""
        block = told_noise.told(block, self.noise_scale)
        n = block.dimension
        kappa = self._kappa(n)
        if self.points == "merwe":
            scale = self.alpha**2 * (n + kappa)
            more = 1.0 - self.alpha**2 + self.beta
        else:
            scale, more = n + kappa, 0.0
        centre = 1.0 - n / scale
        mean, cov, nis, counts, rejected = filters.unscented(
            block, math.sqrt(scale), centre + more, 0.5 / scale,
            self.loss, robust.threshold_of(self.loss, self.threshold),
            self.gate, self.underweighting,
        )  # fmt: skip
        info = {"covariance_repairs": counts[:, 0], "map_evaluations": counts[:, 1]}
        if self.gate:
            info["rejected"] = rejected
        return EstimateBlock(mean, cov, self.causality, nis=nis, info=info)

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        """Sigma points through Φ and h, epoch by epoch."""
        if self.takes_blocks:
            return super().estimate(problem, rng)
        from filterpy.kalman import JulierSigmaPoints, MerweScaledSigmaPoints

        problem = told_noise.told(problem, self.noise_scale)
        n, m = problem.dimension, problem.measurements.shape[1]
        root = MatrixSquareRoot()
        kappa = self._kappa(n)
        if self.points in ("julier", "cubature"):
            points = JulierSigmaPoints(n, kappa=kappa, sqrt_method=root)
        else:
            points = MerweScaledSigmaPoints(n, self.alpha, self.beta, kappa, sqrt_method=root)
        ukf = _vectorized_ukf()(
            dim_x=n,
            dim_z=m,
            dt=1.0,
            fx=lambda points, dt, epoch: points @ problem.transition[epoch].T,
            hx=lambda points, epoch: problem.model.predict(epoch, points),
            points=points,
        )
        ukf.x, ukf.P = problem.prior_mean.copy(), problem.prior_cov.copy()
        ukf.underweighting = self.underweighting
        limits = gate_limits(self.gate, problem.present)
        ukf.loss, ukf.threshold = self.loss, robust.threshold_of(self.loss, self.threshold)
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
        if self.gate:
            info["rejected"] = ukf.rejected
        estimate = Estimate(mean, cov, self.causality, info=info)
        return told_noise.with_own_nis(estimate, problem, self.noise_scale)
