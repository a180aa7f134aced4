"""Unscented particle filter, optionally with strong tracking.

A bootstrap filter draws particles from the prediction and weights them by the measurement. If the
measurement is far more precise than the prediction, nearly all particles have negligible weight. In
the unscented particle filter each particle has a covariance and an unscented Kalman filter. This
filter processes the measurement before sampling (van der Merwe, Doucet, de Freitas & Wan 2000).
There are three kinds of weights. ``mixture`` and ``exact`` are correct, ``likelihood`` is not:

``mixture``
    No samples are drawn. A particle is a Gaussian, weighted by the predicted density of the
    measurement. Resampling drops particles of small weight and copies particles of large weight.
    For a linear h every particle is a Kalman filter, and the estimate is exact for any number of
    particles. This is the Gaussian-sum particle filter of Kotecha & Djurić (2003b). It is suitable
    because the posterior consists of a few narrow Gaussians: some hundreds of particles across a
    prior of a kilometre find the position. If h is nonlinear over the width of one
    particle (``width_m``), more particles do not make the filter exact. With priors of 600 m and
    1 km the mean differs from the posterior mean on a grid by 0.04 to 0.15 standard deviations. In
    one problem the difference is 0.26, and the reported σ is 0.42 times the correct σ.
``exact``
    These are the weights of van der Merwe et al.: a state x is drawn from the filter's N(μ, S) and
    weighted by p(z | x) p(x | x') / N(x; μ, S), with the previous state x'. For an INS the density
    p(x | x') does not exist, because the process noise is singular. With additional process noise
    the density exists but is narrow: S is the whole uncertainty, Q only the noise of one step. The
    variation of the ratio p(x | x') / N(x; μ, S) grows with tr(Q⁻¹S), until one particle has all
    the weight.
``likelihood``
    These are weights p(z | x) without that ratio, as in many published codes. The particles stay
    distinct, but each measurement is used twice: in the samples and in the weights. For linear h
    and process noise of full rank, the mean differs from that of the Kalman filter by a third of a
    standard deviation.

``strong_tracking`` (see :mod:`.strong_tracking`) increases the predicted covariance of each
particle until it agrees with the innovations. This makes an overconfident filter consistent. If the
model is correct, the fading factor reacts to random innovations and discards information. This
reduces the accuracy much more than fading can improve it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from ..engines.position_grid import position_axes
from ..engines.resampling import effective_size, moments, normalise, repaired, resample
from ..numerics.positive import nearest_root
from ..parameters import Positive, Share
from ..problem import Estimate, Estimator, Problem
from .strong_tracking import faded, fading_factors, innovation_power

_RESAMPLE = 0.5
"""Effective size, as a share of the particles, below which they are resampled."""
_MOST = 100_000
"""Particles with covariances that fit in memory."""


@dataclass(frozen=True)
class UnscentedParticle(Estimator):
    """Unscented particle filter; with ``strong_tracking`` the strong tracking UPF (STUPF).

    Parameters
    ----------
    particles : number of particles.
    weights : ``mixture``, ``likelihood`` or ``exact``; see :mod:`.unscented_particle`. ``exact``
        needs process noise in every direction of the state.
    width_m : standard deviation of a particle with ``mixture`` weights [m]. It applies in
        directions in which the position prior is wider than ``width_m``. A fraction of the field's
        correlation length is suitable. The particles are distributed such that their mixture is the
        prior. With other weights each particle has the covariance of the prior.
    kappa : κ of the sigma points (Julier & Uhlmann 2004) [default: 3 − n].
    strong_tracking : whether each particle has a fading factor.
    rho : forgetting factor ρ of :mod:`.strong_tracking`.
    beta : β of :mod:`.strong_tracking`; larger values weaken the fading.
    """

    particles: Annotated[int, Field(ge=1, le=_MOST)] = 400
    weights: Literal["mixture", "likelihood", "exact"] = "mixture"
    width_m: Positive = 150.0
    kappa: float | None = None
    strong_tracking: bool = False
    rho: Share = 0.95
    beta: Annotated[float, Field(ge=1.0)] = 1.0

    name = "unscented-particle"
    family = "sampled"
    causality = "filter"

    @property
    def exact_if_linear_gaussian(self) -> bool:
        """Whether the filter is exact for linear problems: ``mixture`` weights without fading."""
        return self.weights == "mixture" and not self.strong_tracking

    def skip(self, problem: Problem) -> str | None:
        """Return a reason to skip the problem, or None if there is none.

        Reasons are invalid parameters, and ``exact`` weights with singular process noise.
        """
        n = problem.dimension
        if self.kappa is not None and not 0.0 < n + self.kappa < np.inf:
            return f"n + kappa must be positive and finite, and is {n} + {self.kappa:g}"
        if self.weights == "exact":
            ranks = [problem.noise_root(k).shape[1] for k in range(problem.epochs)]
            if min(ranks) < n:
                return (
                    "weights=exact needs process noise of full rank: its covariance has rank "
                    f"{min(ranks)} of {n}"
                )
        return None

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        """Filter one run: return mean and covariance of the particles at each epoch."""
        cloud = UnscentedCloud(self, problem, rng)
        n = problem.dimension
        mean, cov = np.empty((problem.epochs, n)), np.empty((problem.epochs, n, n))
        for k in range(problem.epochs):
            cloud.predict(k)
            there = problem.present[k]
            if there.any():
                cloud.update(k, there)
            mean[k], cov[k] = cloud.moments()
            if there.any():
                cloud.resample()
        scale = cloud.scale
        return Estimate(
            mean * scale, cov * np.outer(scale, scale), self.causality, info=cloud.told()
        )


class UnscentedCloud:
    """J stored particles: states (J, n), covariances (J, n, n), log weights (J,).

    States are in units of the prior's standard deviations. With ``mixture`` weights,
    identical Gaussians are stored once, together with the number of their copies (J,). Measurements
    are whitened: their noise has unit variance.
    """

    def __init__(
        self, settings: UnscentedParticle, problem: Problem, rng: np.random.Generator
    ) -> None:
        self.settings, self.problem, self.rng = settings, problem, rng
        n, m = problem.dimension, problem.measurements.shape[1]
        self.scale = scale = np.sqrt(np.diag(problem.prior_cov))
        self.transition = problem.transition * scale / scale[:, np.newaxis]
        self.process_cov = problem.process_cov / np.outer(scale, scale)
        self.kappa = 3.0 - n if settings.kappa is None else settings.kappa
        self.draws = settings.weights != "mixture"
        self.states, self.covs = self._drawn() if self.draws else self._split()
        count = len(self.states)
        self.copies = np.full(count, settings.particles // count)
        self.log_weights = np.zeros(count)
        self.power, self.seen = np.zeros((count, m)), np.zeros(m, dtype=bool)
        self.repairs = self.resamplings = 0
        self.sizes: list[float] = []
        self.factors: list[float] = []

    def _drawn(self) -> tuple[np.ndarray, np.ndarray]:
        """Return states drawn from the prior, each with the covariance of the prior."""
        count, n = self.settings.particles, self.problem.dimension
        cov = self.problem.prior_cov / np.outer(self.scale, self.scale)
        drawn = self.rng.standard_normal((count, n)) @ np.linalg.cholesky(cov).T
        return self.problem.prior_mean / self.scale + drawn, np.tile(cov, (count, 1, 1))

    def _split(self) -> tuple[np.ndarray, np.ndarray]:
        """Return states and covariances of Gaussians whose mixture is the prior.

        Their position has the standard deviation ``width_m`` in directions in which the prior is
        wider. A prior that is narrower in all directions gives a single Gaussian.
        """
        variances, gain, *_ = position_axes(self.problem)
        wide = variances > self.settings.width_m**2
        narrowing, gain = variances[wide] - self.settings.width_m**2, gain[:, wide]
        count = self.settings.particles if wide.any() else 1
        places = np.sqrt(narrowing) * self.rng.standard_normal((count, len(narrowing)))
        cov = self.problem.prior_cov / np.outer(self.scale, self.scale)
        narrow = cov - (gain * narrowing) @ gain.T
        states = self.problem.prior_mean / self.scale + places @ gain.T
        return states, np.tile(narrow, (count, 1, 1))

    def predict(self, k: int) -> None:
        """Propagate all particles from epoch k − 1 to epoch k.

        The dynamics are linear, so no sigma points are needed.
        """
        phi = self.transition[k]
        self.states = self.states @ phi.T
        self.covs = phi @ self.covs @ phi.T + self.process_cov[k]

    def update(self, k: int, there: np.ndarray) -> None:
        """Update all particles with measurement k.

        ``there`` (m,) is a mask of the available channels.
        """
        predicted = self.states
        roots = self.square_roots(self.covs)
        innovation, slope, spread = self.linear_regression(k, roots)
        if self.settings.strong_tracking:
            factors = self._fading(k, there, roots, innovation, slope, spread)
            if (factors > 1.0).any():
                # Of other sigma points: gain and covariance are to be of the same filter.
                self.covs = faded(self.covs, self.process_cov[k], factors)
                roots = self.square_roots(self.covs)
                innovation, slope, spread = self.linear_regression(k, roots)
        m = innovation.shape[1]
        expected = spread + np.eye(m)
        try:
            root = np.linalg.cholesky(expected)
        except np.linalg.LinAlgError:  # a negative weight: what h is linear in stays positive
            self.repairs += 1
            spread = _transposed(slope) @ slope
            expected = spread + np.eye(m)
            root = np.linalg.cholesky(expected)
        white = np.linalg.solve(root, innovation[..., np.newaxis])
        gain = _transposed(np.linalg.solve(expected, _transposed(slope)))
        states = predicted + (roots @ (gain @ innovation[..., np.newaxis]))[..., 0]
        keep = np.eye(slope.shape[1]) - gain @ _transposed(slope)
        noise = expected - _transposed(slope) @ slope
        left = keep @ _transposed(keep) + gain @ noise @ _transposed(gain)
        self.covs = roots @ left @ _transposed(roots)
        self.covs = 0.5 * (self.covs + _transposed(self.covs))
        if self.draws:
            self._draw(k, predicted, states)
        else:
            self.states = states
            self.log_weights = self.log_weights - 0.5 * (white[..., 0] ** 2).sum(axis=1)
            self.log_weights -= np.log(np.diagonal(root, axis1=1, axis2=2)).sum(axis=1)

    def _draw(self, k: int, predicted: np.ndarray, means: np.ndarray) -> None:
        """Draw each state from N(mean, covariance) of its filter, and update the log weights."""
        roots = self.square_roots(self.covs)
        normal = self.rng.standard_normal(means.shape)
        self.states = means + (roots @ normal[..., np.newaxis])[..., 0]
        residuals = self._residuals(k, self.states)
        self.log_weights = self.log_weights - 0.5 * (residuals**2).sum(axis=1)
        if self.settings.weights == "exact":
            root = np.linalg.cholesky(self.process_cov[k])
            away = np.linalg.solve(root, (self.states - predicted).T)
            drawn = 0.5 * (normal**2).sum(axis=1)
            drawn += np.log(np.diagonal(roots, axis1=1, axis2=2)).sum(axis=1)
            self.log_weights += drawn - 0.5 * (away**2).sum(axis=0)

    def _residuals(self, k: int, states: np.ndarray) -> np.ndarray:
        """Return the whitened residuals, measurement minus h (..., m), at states (..., n)."""
        problem = self.problem
        residual = problem.measurements[k] - problem.model.predict(k, states * self.scale)
        flat = residual.reshape(-1, residual.shape[-1])
        white = np.linalg.solve(np.linalg.cholesky(problem.noise_of(k)), flat.T).T
        return np.asarray(white.reshape(residual.shape))

    def linear_regression(
        self, k: int, roots: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the statistical linearisation of whitened h from the sigma points of N(x, L Lᵀ).

        ``roots`` (J, n, n) are the roots L. P_xz is the cross-covariance of the states and h.

        Returns
        -------
        Innovations γ (J, m); L⁻¹ P_xz (J, n, m), equal to Lᵀ Hᵀ for a linear h; and the covariance
        P_zz (J, m, m) of h, without R.
        """
        n = roots.shape[1]
        scale, weight = np.sqrt(n + self.kappa), 0.5 / (n + self.kappa)
        steps = scale * _transposed(roots)
        centre = self.states[:, np.newaxis]
        residuals = self._residuals(k, np.concatenate([centre, centre + steps, centre - steps], 1))
        middle, ahead, behind = residuals[:, 0], residuals[:, 1 : n + 1], residuals[:, n + 1 :]
        outer = weight * (ahead.sum(axis=1) + behind.sum(axis=1))
        innovation = (1.0 - 2.0 * n * weight) * middle + outer
        away = residuals - innovation[:, np.newaxis]
        spread = weight * _transposed(away[:, 1:]) @ away[:, 1:]
        spread += (1.0 - 2.0 * n * weight) * away[:, 0, :, np.newaxis] * away[:, 0, np.newaxis]
        return innovation, (weight * scale) * (behind - ahead), spread

    def _fading(
        self,
        k: int,
        there: np.ndarray,
        roots: np.ndarray,
        innovation: np.ndarray,
        slope: np.ndarray,
        spread: np.ndarray,
    ) -> np.ndarray:
        """Return the fading factors (J,), and update the observed innovation variances."""
        self.power[:, there] = innovation_power(
            self.power[:, there], innovation[:, there], self.seen[there], self.settings.rho
        )
        self.seen |= there
        rows = np.linalg.solve(_transposed(roots), slope)  # Hᵀ = (P^l)⁻¹ P_xz
        of_noise = np.einsum("jac,ab,jbc->jc", rows, self.process_cov[k], rows)
        factors = fading_factors(
            self.power[:, there],
            np.diagonal(spread, axis1=1, axis2=2)[:, there],
            of_noise[:, there],
            self.settings.beta,
        )
        self.factors += np.repeat(factors, self.copies).tolist()
        return factors

    def square_roots(self, covs: np.ndarray) -> np.ndarray:
        """Return the roots L (J, n, n) of the covariances P = L Lᵀ in ``covs`` (J, n, n).

        A covariance that is not positive definite is repaired.
        """
        try:
            return np.linalg.cholesky(covs)
        except np.linalg.LinAlgError:
            roots = np.empty_like(covs)
            for j, cov in enumerate(covs):
                try:
                    roots[j] = np.linalg.cholesky(cov)
                except np.linalg.LinAlgError:
                    self.repairs += 1
                    roots[j] = nearest_root(cov).T
            return roots

    def _shares(self) -> np.ndarray:
        """Return the weights (J,) of the stored Gaussians; all copies count, and the sum is one."""
        shares = np.empty(len(self.log_weights))
        normalise(self.log_weights + np.log(self.copies), shares)
        return shares

    def moments(self) -> tuple[np.ndarray, np.ndarray]:
        """Return mean (n,) and covariance (n, n) of the weighted particles."""
        shares = self._shares()
        mean, cov = moments(shares, self.states)
        if self.draws:
            # Of points: where one has all the weight, they have no covariance left.
            cov, poor = repaired(cov, np.eye(len(cov)))
            self.repairs += poor
            return mean, cov
        cov += np.einsum("j,jab->ab", shares, self.covs)
        return mean, 0.5 * (cov + cov.T)

    def resample(self) -> None:
        """Resample the particles if the effective sample size is too small."""
        weights = np.repeat(self._shares() / self.copies, self.copies)
        self.sizes.append(effective_size(weights))
        if self.sizes[-1] >= _RESAMPLE * len(weights):
            return
        self.resamplings += 1
        which = np.repeat(np.arange(len(self.copies)), self.copies)
        chosen = which[resample("systematic", weights, self.rng)]
        if self.draws:
            self.copies = np.ones_like(self.copies)
        else:
            chosen, self.copies = np.unique(chosen, return_counts=True)
        self.states, self.covs, self.power = (
            array[chosen] for array in (self.states, self.covs, self.power)
        )
        self.log_weights = np.zeros(len(chosen))

    def told(self) -> dict[str, float]:
        """Return counters, effective sample sizes and the median fading factor of a run."""
        info = {
            "ess_min": min(self.sizes, default=float(self.settings.particles)),
            "ess_median": float(np.median(self.sizes or [self.settings.particles])),
            "resamplings": self.resamplings,
            "unique": len(self.states),
            "covariance_repairs": self.repairs,
        }
        if self.settings.strong_tracking:
            info["fading_median"] = float(np.median(self.factors or [1.0]))
        return info


def _transposed(matrices: np.ndarray) -> np.ndarray:
    """Return the transposes of matrices (..., n, m)."""
    return np.swapaxes(matrices, -1, -2)
