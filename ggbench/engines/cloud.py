"""Particle cloud: some states are sampled, the others are in Kalman filters.

Row i of the cloud is (p_i, l_i): the d sampled states, and the mean of the other states. Three
operations draw samples of p: sampling of the prior, prediction, and the kernel after resampling.
Each of them draws from a Gaussian of all states with covariance J. J_pp, J_lp, J_pl and J_ll are
the blocks of J that belong to p and l. Then l is conditioned on the sample: p = G e,
l = J_lp G⁺ᵀ e, P_l = J_ll − J_lp J_pp⁺ J_pl. Here e is standard normal, ⁺ denotes the
pseudo-inverse, and G has full column rank with G Gᵀ = J_pp. In the prediction
J = Φ_l P_l Φ_lᵀ + Q. Φ_l contains the columns of Φ that belong to l. The cross-block J_lp is not
zero, because process noise moves p and l together.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..numerics.kernels import compiled
from ..numerics.positive import ranked_root
from ..problem import Problem
from .annealing import annealed, whitening
from .linear_states import POSITION
from .moves import Moves, regularise, roughen
from .resampling import effective_size, moments, normalise, repaired, resample, unique
from .straightness import bending, is_gaussian

_LEAST_STEP, _BISECTIONS, _MOST_STAGES = 1e-16, 40, 60
"""Smallest power of the likelihood in a stage; number of bisections of its logarithm; largest
number of stages of an update."""
_FEWEST = 4.0
"""Effective sample size over √N below which a measurement lies in the tail of the cloud."""
_PER_STATE = 10.0
"""Least effective sample size per sampled state for a regression on the cloud."""
_PROBES = 100
"""Number of samples of a Gaussian for the test of h for linearity."""
_CHUNK = 8192
"""Particles whose measurements are predicted at once: more of them exceed the cache."""


@compiled
def _log_likelihoods(
    residuals: np.ndarray, inverse: np.ndarray, log: np.ndarray, out: np.ndarray
) -> None:
    """Fill ``out`` (N,) with log_i − ½ |W r_i|², for residuals r_i (N, m).

    W (m, m) is ``inverse``, the inverse of the lower Cholesky factor of the innovation covariance.
    """
    m = residuals.shape[1]
    for i in range(residuals.shape[0]):
        total = 0.0
        for c in range(m):
            white = 0.0
            for d in range(c + 1):
                white += inverse[c, d] * residuals[i, d]
            total += white * white
        out[i] = log[i] - 0.5 * total


class _Reading(NamedTuple):
    """Measurement of epoch ``k`` with m available channels.

    Attributes
    ----------
    there : mask of the available channels.
    slope : (m, n − d) Jacobian ∂h/∂l of the linear states.
    noise : (m, m) noise covariance.
    """

    k: int
    there: np.ndarray
    slope: np.ndarray
    noise: np.ndarray

    def spread(self, rest: np.ndarray) -> np.ndarray:
        """Return the covariance (m, m) of h(x) caused by the covariance ``rest`` of l."""
        return np.asarray(self.slope @ rest @ self.slope.T)


class Cloud:
    """N weighted particles (N, n), log weights (N,), and one P_l (n − d, n − d) for all particles.

    The first d of the n states are sampled. P_l is the covariance of the other states. ``evidence``
    is ln p(z) of all measurements so far, and ``total`` is the logarithm of the sum of the weights.
    While h is linear over the posterior, the cloud is replaced by ``gaussian``: mean (n,) and
    covariance (n, n).
    """

    weights: np.ndarray
    log: np.ndarray
    trial: np.ndarray
    total: float
    gaussian: tuple[np.ndarray, np.ndarray] | None

    def __init__(
        self, problem: Problem, drawn: int, moves: Moves, rng: np.random.Generator
    ) -> None:
        self.problem, self.drawn, self.moves, self.rng = problem, drawn, moves, rng
        self.count = moves.particles
        self.to_draw = self.count * moves.start
        self.gaussian = problem.prior_mean, problem.prior_cov
        self.x, self.rest = problem.prior_mean[np.newaxis], np.empty((0, 0))
        self._level()
        self.poor, self.on_trial = False, 0.0
        self.sizes: list[float] = []
        self.resamplings = self.stages = self.evaluations = 0
        self.fewest, self.evidence = self.count, 0.0

    def predict(self, k: int) -> None:
        """Propagate the cloud from epoch k − 1 to epoch k."""
        problem, d = self.problem, self.drawn
        phi, noise = problem.transition[k], problem.process_cov[k]
        if self.gaussian:
            mean, cov = self.gaussian
            self.gaussian = phi @ mean, phi @ cov @ phi.T + noise
            return
        joint = phi[:, d:] @ self.rest @ phi[:, d:].T + noise
        moved = range(min(d, POSITION))
        joint[moved, moved] += self.moves.noise_density * (problem.times[k] - problem.times[k - 1])
        steps = self._steps(joint)
        self.x = self.x @ phi.T
        self.x += self.rng.standard_normal((len(self.x), len(steps))) @ steps

    def update(self, k: int) -> float:
        """Update the cloud with the measurement of epoch k, and return the NIS.

        The NIS is NaN if the update uses particles.
        """
        reading = self._reading(k)
        exact = self.moves.tempering > 0.0 and not self.moves.blurs
        residuals = np.empty((0, len(reading.noise)))
        if not self.gaussian:
            residuals = self._residuals(reading)
            if exact and self._depletes(residuals, reading):
                self.gaussian = self._moments()
        if self.gaussian and self.moves.most_bending:
            self._draw(_PROBES)
            residuals = self._residuals(reading)
            if self._bending(residuals, reading) < self.moves.most_bending:
                return self._update_gaussian(residuals, reading)
        if self.gaussian and exact:
            residuals, share = self._anneal(reading), 1.0
        else:
            residuals, share = self._weigh_by_stages(residuals, reading)
        straight = self._has_become_gaussian(residuals, reading)
        self._correct(residuals, reading, share)
        if straight:
            self.gaussian = self._moments()
        return math.nan

    def moments(self) -> tuple[np.ndarray, np.ndarray, bool]:
        """Return mean (n,) and covariance (n, n) of the states, and a repair flag.

        The flag is true if :func:`.resampling.repaired` has changed the covariance.
        """
        mean, cov = self.gaussian or self._moments()
        return mean, *repaired(cov, self.problem.prior_cov)

    def renew_if_poor(self) -> None:
        """Resample the cloud if the last update has left a small effective sample size.

        The limit is the fraction ``moves.threshold`` of N. A cloud with more than N particles is
        also resampled.
        """
        if self.poor and not self.gaussian:
            self._renew()
        self.poor = False

    def _reading(self, k: int) -> _Reading:
        there = self.problem.present[k]
        noise = self.problem.noise_of(k)[np.ix_(there, there)]
        slope = np.zeros((len(noise), self.problem.dimension - self.drawn))
        if self.drawn < self.problem.dimension:
            point = self.gaussian[0] if self.gaussian else self.x[0]
            slope = self.problem.model.jacobian(k, point)[there, self.drawn :]
            self.evaluations += 1
        return _Reading(k, there, slope, noise)

    def _moments(self) -> tuple[np.ndarray, np.ndarray]:
        mean, cov = moments(self.weights, self.x)
        cov[self.drawn :, self.drawn :] += self.rest
        return mean, cov

    def _update_gaussian(self, residuals: np.ndarray, reading: _Reading) -> float:
        """Update the Gaussian by statistical linearisation of h; return the NIS.

        The linear regression of h uses points with the mean and covariance of the Gaussian
        (Särkkä & Svensson 2023, ch. 9).
        """
        assert self.gaussian
        (mean, cov), n = self.gaussian, self.x.shape[1]
        innovation, joint = moments(self.weights, np.hstack([self.x, residuals]))
        innovation = innovation[n:]
        spread = joint[n:, n:] + reading.spread(self.rest) + reading.noise
        across = -joint[:n, n:]
        across[self.drawn :] += self.rest @ reading.slope.T
        gain = np.linalg.solve(spread, across.T).T
        self.gaussian = mean + gain @ innovation, cov - gain @ spread @ gain.T
        squared = float(innovation @ np.linalg.solve(spread, innovation))
        self.evidence -= 0.5 * (squared + np.linalg.slogdet(2.0 * np.pi * spread)[1])
        return squared

    def _anneal(self, reading: _Reading) -> np.ndarray:
        """Sample the posterior of the Gaussian in tempered stages; return residuals (N, m)."""
        assert self.gaussian
        mean, cov = self.gaussian
        steps = self._steps(cov)
        space = whitening(reading.noise, reading.spread(self.rest))

        def read(normals: np.ndarray) -> np.ndarray:
            self.x = mean + normals @ steps
            return self._residuals(reading) @ space.rows.T

        found = annealed(
            normals=self._balanced(self.to_draw, len(steps)),
            read=read,
            space=space,
            count=self.count,
            least=self.moves.tempering * self.count,
            resampling=self.moves.resampling,
            rng=self.rng,
        )
        self.x, self.gaussian, self.to_draw = mean + found.normals @ steps, None, self.count
        self._level()
        self.sizes.append(found.size)
        self.stages += found.stages
        self.resamplings += found.stages + 1
        self.fewest = min(self.fewest, found.fewest)
        self.evidence += found.evidence
        return np.asarray(np.linalg.solve(space.rows, found.whitened.T).T)

    def _depletes(self, residuals: np.ndarray, reading: _Reading) -> bool:
        """Return whether a measurement lies in the tail of the cloud; keep the weights.

        In the tail the effective sample size is below 4 √N. A Gaussian with the moments of the
        cloud also covers the tail, where particles are missing. The limit is a fraction 4 / √N of
        the particles, so the filter stays exact for N → ∞.
        """
        before = self.weights.copy()
        size = self._weigh(residuals, reading.spread(self.rest) + reading.noise)
        self.weights = before
        return bool(size < _FEWEST * math.sqrt(self.count))

    def _weigh_by_stages(
        self, residuals: np.ndarray, reading: _Reading
    ) -> tuple[np.ndarray, float]:
        """Weight the cloud with a measurement, in stages if noise separates copies.

        Return the residuals (N, m), and the power of the likelihood with which the linear states
        are still to be updated.
        """
        if self.gaussian:
            self._draw(self.to_draw)
            self.gaussian, self.to_draw = None, self.count
            residuals = self._residuals(reading)
        least = self.moves.tempering * self.count if self.moves.blurs else 0.0
        left, stages = 1.0, 0
        while True:
            spread, noise = reading.spread(self.rest), reading.noise
            size, step = self._weigh(residuals, spread + noise / left), left
            if left == 1.0:
                self.sizes.append(size)
            if size < least and stages < _MOST_STAGES:
                step = self._step(residuals, spread, noise, left)
                self._weigh(residuals, spread + noise / step)
            self.log, self.trial = self.trial, self.log
            self._count_evidence(spread + noise / step, noise, step)
            if step == left:
                break
            self._correct(residuals, reading, step)
            left, stages = left - step, stages + 1
            self.stages += 1
            self._renew()
            residuals = self._residuals(reading)
        poor = effective_size(self.weights) < self.moves.threshold * self.count
        self.poor = poor or len(self.x) > self.count
        return residuals, left

    def _residuals(self, reading: _Reading) -> np.ndarray:
        """Return the residuals z − h(x) (N, m) of all particles."""
        self.evaluations += len(self.x)
        k, there = reading.k, reading.there
        residuals, read = np.empty((len(self.x), len(there))), self.problem.measurements[k]
        for first in range(0, len(self.x), _CHUNK):
            some = slice(first, first + _CHUNK)
            np.subtract(read, self.problem.model.predict(k, self.x[some]), out=residuals[some])
        return residuals if there.all() else np.ascontiguousarray(residuals[:, there])

    def _weigh(self, residuals: np.ndarray, innovation: np.ndarray) -> float:
        """Fill trial log weights and normalised weights; return the effective sample size.

        ``innovation`` (m, m) is the covariance of the residuals.
        """
        _log_likelihoods(residuals, _inverse_root(innovation), self.log, self.trial)
        self.on_trial = normalise(self.trial, self.weights)
        return float(effective_size(self.weights))

    def _count_evidence(self, innovation: np.ndarray, noise: np.ndarray, step: float) -> None:
        """Add the contribution of a stage to the evidence ln p(z).

        A stage uses the power s = ``step`` of the noise density N(r; 0, R). This power equals
        N(r; 0, R / s) times a factor that does not depend on r.
        """
        m = len(noise)
        of_power = (1.0 - step) * np.linalg.slogdet(2.0 * np.pi * noise)[1] - m * math.log(step)
        density = -np.linalg.slogdet(2.0 * np.pi * innovation)[1]
        self.evidence += float(self.on_trial - self.total + 0.5 * (density + of_power))
        self.total = self.on_trial

    def _step(
        self, residuals: np.ndarray, spread: np.ndarray, noise: np.ndarray, most: float
    ) -> float:
        """Return the largest power of the likelihood with enough effective particles.

        The power is at most ``most``.
        """
        least = self.moves.tempering * self.count
        low, high = math.log(_LEAST_STEP), math.log(most)
        for _ in range(_BISECTIONS):
            middle = 0.5 * (low + high)
            if self._weigh(residuals, spread + noise / math.exp(middle)) >= least:
                low = middle
            else:
                high = middle
        return math.exp(low)

    def _correct(self, residuals: np.ndarray, reading: _Reading, share: float) -> None:
        """Update the linear states with the power ``share`` of the likelihood.

        All particles have the same gain. P_l is updated in Joseph's form.
        """
        if not reading.slope.any():
            return
        slope, noise = reading.slope, reading.noise / share
        gain = np.linalg.solve(reading.spread(self.rest) + noise, slope @ self.rest).T
        self.x[:, self.drawn :] += residuals @ gain.T
        keep = np.eye(len(self.rest)) - gain @ slope
        self.rest = keep @ self.rest @ keep.T + gain @ noise @ gain.T

    def _bending(self, residuals: np.ndarray, reading: _Reading) -> float:
        """Return the nonlinear part of h over the cloud, see :func:`.straightness.bending`."""
        d = self.drawn
        # Of what the drawn states alone make of h.
        alone = residuals + self.x[:, d:] @ reading.slope.T
        return bending(self.weights, self.x[:, :d], alone @ _inverse_root(reading.noise).T)

    def _has_become_gaussian(self, residuals: np.ndarray, reading: _Reading) -> bool:
        """Return whether h is linear over the cloud and the cloud is Gaussian."""
        most = self.moves.most_bending
        return (
            most > 0.0
            and bool(effective_size(self.weights) >= _PER_STATE * self.drawn)
            and self._bending(residuals, reading) < most
            and is_gaussian(self.weights, self.x[:, : self.drawn])
        )

    def _renew(self) -> None:
        """Resample the cloud to equal weights, and add the noise of :class:`.Moves`."""
        moves = self.moves
        self.resamplings += 1
        ancestors = resample(moves.resampling, self.weights, self.rng, self.count)
        self.fewest = min(self.fewest, unique(ancestors))
        self.x = self.x[ancestors]
        if moves.roughening:
            roughen(self.x, self.drawn, moves, self.rng)
        if moves.regularisation:
            regularise(self.x, moves, self.rng)
        if moves.kernel:
            self._blur()
        self._level()

    def _level(self) -> None:
        """Give all particles the same weight."""
        count = len(self.x)
        self.log, self.trial = np.zeros(count), np.empty(count)
        self.weights = np.full(count, 1.0 / count)
        self.total = math.log(count)

    def _draw(self, count: int) -> None:
        """Sample the cloud from the Gaussian, with exactly equal mean and covariance.

        The method is second-order exact sampling (Pham 2001).
        """
        assert self.gaussian
        mean, cov = self.gaussian
        steps = self._steps(cov)
        self.x = mean + self._balanced(count, len(steps)) @ steps
        self._level()

    def _blur(self) -> None:
        """Move all particles by the kernel of Liu and West (2001), and update P_l."""
        b = self.moves.kernel
        mean, cov = moments(np.full(self.count, 1.0 / self.count), self.x)
        cov *= b * b
        cov[self.drawn :, self.drawn :] += self.rest
        steps = self._steps(cov)
        self.x = mean + math.sqrt(1.0 - b * b) * (self.x - mean)
        self.x += self.rng.standard_normal((self.count, len(steps))) @ steps

    def _steps(self, joint: np.ndarray) -> np.ndarray:
        """Return the matrix (r, n) that maps r standard normal numbers to a step; set P_l.

        ``joint`` (n, n) is the covariance of all states. P_l becomes the covariance of the linear
        states, conditioned on the sampled states.
        """
        d = self.drawn
        root, inverse = ranked_root(joint[:d, :d])
        known = inverse.T @ joint[:d, d:]
        rest = joint[d:, d:] - known.T @ known
        self.rest = 0.5 * (rest + rest.T)
        return np.hstack([root.T, known])

    def _balanced(self, count: int, rank: int) -> np.ndarray:
        """Return normal numbers (N, r) with exact sample mean 0 and sample covariance I.

        With N ≤ r the numbers are not adjusted.
        """
        noise = self.rng.standard_normal((count, rank))
        if count <= rank or rank == 0:
            return noise
        noise -= noise.mean(axis=0)
        root = np.linalg.cholesky(noise.T @ noise / count)
        return np.asarray(np.linalg.solve(root, noise.T).T)


def _inverse_root(cov: np.ndarray) -> np.ndarray:
    """Return the inverse of the lower Cholesky factor of a covariance (m, m)."""
    return np.asarray(np.linalg.inv(np.linalg.cholesky(cov)))
