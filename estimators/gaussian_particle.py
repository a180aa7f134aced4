"""Gaussian particle filter: a Gaussian posterior with moments from particles.

At each epoch the filter draws new particles from a Gaussian, weights them by the likelihood of the
measurement, and keeps only their mean and covariance (Kotecha & Djurić 2003a). There is no
resampling, so no particle is copied. Therefore sample impoverishment cannot occur: with nearly
noiseless dynamics, copies of particles never separate. The dynamics are linear, so the prediction
of the Gaussian is exact.

The filter has two other weaknesses. First, with a wide prior the posterior is multimodal, and one
Gaussian cannot represent it. Second, if a measurement is ten times more precise than the prediction
along three axes, a few of 3000 particles have all the weight. The covariance of these few particles
is rank-deficient and the filter is overconfident. Such a covariance is repaired, and the repair is
counted, but the lost information is not restored. A proposal that includes the measurement
(``ekf``, ``ukf``) helps if h is nearly linear over the prediction. Otherwise the proposal is a
narrow Gaussian at a wrong position, and the weights of its samples vary more than those of samples
from the prediction.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from pydantic import Field
from scipy.linalg import solve_triangular

from ..engines.resampling import effective_size, moments, normalise, repaired
from ..numerics.positive import MatrixSquareRoot
from ..problem import Estimate, Estimator, Problem

_MOST = 10_000_000
"""Particles that fit in memory."""


@dataclass(frozen=True)
class GaussianParticle(Estimator):
    """Gaussian particle filter.

    Parameters
    ----------
    particles : number of samples at every epoch.
    proposal : density from which samples are drawn. ``prior``: the prediction. ``ekf`` or ``ukf``:
        the prediction, updated by an extended Kalman filter, or by an unscented Kalman filter with
        cubature points.
    """

    particles: Annotated[int, Field(ge=2, le=_MOST)] = 3000
    proposal: Literal["prior", "ekf", "ukf"] = "prior"

    name = "gaussian-particle"
    family = "sampled"
    causality = "filter"
    exact_if_linear_gaussian = False  # moments of particles scatter

    def skip(self, problem: Problem) -> str | None:
        """Return a reason to skip the problem, or None if there is none.

        The number of particles must exceed the number of states.
        """
        if self.particles <= problem.dimension:
            return (
                f"particles must be larger than the number of states, {problem.dimension}, not "
                f"{self.particles}"
            )
        return None

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        """Filter one run: predict, sample, weight and compute moments at each epoch."""
        n = problem.dimension
        scale = np.sqrt(np.diag(problem.prior_cov))
        mean, cov = problem.prior_mean / scale, problem.prior_cov / np.outer(scale, scale)
        means, covs = np.empty((problem.epochs, n)), np.empty((problem.epochs, n, n))
        root = MatrixSquareRoot()
        sizes = []
        repairs = 0
        for k in range(problem.epochs):
            phi = problem.transition[k] * scale / scale[:, np.newaxis]
            mean = phi @ mean
            cov = phi @ cov @ phi.T + problem.process_cov[k] / np.outer(scale, scale)
            if problem.present[k].any():
                step = _Step(problem, k, scale, mean, cov, root)
                mean, cov, size = step.updated(self.proposal, self.particles, rng)
                cov, poor = repaired(cov, np.eye(n))
                sizes.append(size)
                repairs += poor
            means[k], covs[k] = mean, cov
        info = {
            "ess_min": min(sizes, default=float(self.particles)),
            "ess_median": float(np.median(sizes or [self.particles])),
            "covariance_repairs": repairs + root.repairs,
        }
        return Estimate(means * scale, covs * np.outer(scale, scale), self.causality, info=info)


class _Step:
    """One measurement and the predicted Gaussian, in standard deviations of the prior."""

    def __init__(
        self,
        problem: Problem,
        k: int,
        scale: np.ndarray,
        mean: np.ndarray,
        cov: np.ndarray,
        root: MatrixSquareRoot,
    ) -> None:
        self.problem, self.k, self.scale = problem, k, scale
        self.mean, self.cov, self._root = mean, cov, root
        self.lower = root(cov).T
        self.noise_root = np.linalg.cholesky(problem.noise_of(k))

    def residuals(self, states: np.ndarray) -> np.ndarray:
        """Return the whitened residuals, measurement minus h (N, m), at states (N, n)."""
        predicted = self.problem.model.predict(self.k, states * self.scale)
        away = self.problem.measurements[self.k] - predicted
        return np.asarray(solve_triangular(self.noise_root, away.T, lower=True).T)

    def updated(
        self, proposal: str, count: int, rng: np.random.Generator
    ) -> tuple[np.ndarray, np.ndarray, float]:
        """Return mean and covariance of the weighted particles, and the effective sample size.

        W are the normalised weights. The sample covariance is too small by the factor 1 − ΣW², like
        that of N samples by 1 − 1/N. The sample mean has a sampling error, whose covariance is ΣW²
        times the covariance of the samples. Both effects are small at one epoch but accumulate over
        hundreds of epochs. If the effective sample size 1/ΣW² exceeds n + 1, the covariance is
        therefore multiplied by (1 + ΣW²) / (1 − ΣW²).
        """
        mean, lower = self.mean, self.lower
        if proposal != "prior":
            mean, cov = self._filtered(proposal)
            lower = self._root(cov).T
        normal = rng.standard_normal((count, len(mean)))
        states = mean + normal @ lower.T
        log_weights = -0.5 * (self.residuals(states) ** 2).sum(axis=1)
        if proposal != "prior":
            back = solve_triangular(self.lower, (states - self.mean).T, lower=True)
            log_weights += 0.5 * ((normal**2).sum(axis=1) - (back**2).sum(axis=0))
        weights = np.empty(count)
        normalise(log_weights, weights)
        mean, cov = moments(weights, states)
        size = effective_size(weights)
        if size > len(mean) + 1:
            cov *= (1.0 + 1.0 / size) / (1.0 - 1.0 / size)
        return mean, cov, size

    def _filtered(self, proposal: str) -> tuple[np.ndarray, np.ndarray]:
        """Return mean and covariance of the prediction, updated by an EKF or a cubature filter."""
        n = len(self.mean)
        if proposal == "ekf":
            rows = self.problem.model.jacobian(self.k, self.mean * self.scale) * self.scale
            slope = self.lower.T @ solve_triangular(self.noise_root, rows, lower=True).T
            innovation = self.residuals(self.mean[np.newaxis])[0]
            noise = np.eye(len(innovation))
        else:
            steps = np.sqrt(n) * self.lower.T
            points = self.residuals(np.concatenate([self.mean + steps, self.mean - steps]))
            innovation = points.mean(axis=0)
            slope = (points[n:] - points[:n]) / (2.0 * np.sqrt(n))
            away = points - innovation
            noise = np.eye(len(innovation)) + away.T @ away / (2 * n) - slope.T @ slope
        gain = np.linalg.solve(slope.T @ slope + noise, slope.T).T
        keep = np.eye(n) - gain @ slope.T
        root = self.lower
        left = keep @ keep.T + gain @ noise @ gain.T
        return self.mean + root @ gain @ innovation, root @ left @ root.T
