"""A particle filter of which some states may be Kalman filtered: one engine for the whole family.

The first d states of a particle are drawn, the others, l, are a Gaussian for each particle, all of
one covariance P_l, because the dynamics are linear and the readings linear in l (Schön, Gustafsson
& Nordlund 2005: the Rao–Blackwellised or marginalised filter). With all states drawn, d = n, it is
the bootstrap filter of Gordon, Salmond & Smith (1993), with none the Kalman filter.

A row of the cloud is (p_i, l_i). Prediction, the start and kernels all draw from a Gaussian of
joint covariance J over the states and keep what of l the draw does not tell: p = G e, l = J_lp G⁺ᵀ
e, P_l = J_ll − J_lp J_pp⁺ J_pl, where G Gᵀ = J_pp has the rank that J_pp has. In the prediction J =
Φ_l P_l Φ_lᵀ + Q, whose cross-block is not zero: the noise of an interval moves p and l together.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from ..numerics.kernels import compiled
from ..numerics.positive import ranked_root
from ..problem import Problem
from .linear_states import POSITION
from .resampling import Resampling, effective_size, moments, normalise, repaired, resample, unique

_LEAST_STEP, _BISECTIONS, _MOST_STAGES = 1e-16, 40, 60
"""Share of a reading that a stage takes at least; halvings (of its logarithm) by which a stage is
found; stages in which a reading is taken in at most."""
_PER_STATE = 10.0
"""Effective particles per drawn state from which a regression on them says anything."""
_PROBES = 100
"""Points with the exact moments of a Gaussian, by which it is seen whether h is straight there."""
_CHUNK = 8192
"""Particles whose readings are asked for at once: more of them leave the processor's cache."""


class Moves(NamedTuple):
    """How a cloud is kept alive; zero switches each of them off.

    Attributes
    ----------
    particles : N.
    resampling : the method.
    threshold : ESS over N below which the cloud is renewed.
    tempering : ESS over N that a stage of a reading leaves at least; a reading that would leave
        less is taken in by stages, each raising the likelihood to a power (Neal 2001; Oudjane &
        Musso 2000), with a renewal in between.
    kernel : bandwidth b of the kernel after resampling, x ← m + √(1 − b²) (x − m) + b T^{1/2} e,
        which keeps mean m and covariance T (Liu & West 2001).
    jitter : noise density of the position [m²/s] added to Q while the cloud is not straight.
    straight : variance, over that of the noise, which is left of the cloud's h after a regression
        on the drawn states and below which h counts as a straight line over the cloud. What goes
        on is then a Gaussian, which a Kalman filter carries, until h bends over it again.
    start : how many times N particles there are until the first reading has been weighed. It is
        the one reading that searches a whole prior, for modes that may be narrow.
    roughening : K of Gordon et al. (1993): K E_j N^{−1/d} of noise in state j after resampling,
        E_j the extent of the cloud in it.
    regularisation : bandwidth of a Gaussian kernel on the position after resampling, over the
        optimal one of Musso, Oudjane & Le Gland (2001): (4/5)^{1/7} N^{−1/7}.
    """

    particles: int
    resampling: Resampling = "systematic"
    threshold: float = 0.5
    tempering: float = 0.0
    kernel: float = 0.0
    jitter: float = 0.0
    straight: float = 0.0
    start: int = 1
    roughening: float = 0.0
    regularisation: float = 0.0


class Filtered(NamedTuple):
    """The filter's results: mean (K, n), cov (K, n, n), nis (K,), counters and evidence of the run.

    NIS is that of the cloud: innovation against the mean of h, covariance of h over the cloud plus
    R. It is χ² where the cloud is a Gaussian, and NaN where h is not straight over it. The evidence
    is ln p(z) of all readings, by which models of one flight may be compared; what blurs a cloud
    (``Moves``) biases it.
    """

    mean: np.ndarray
    cov: np.ndarray
    nis: np.ndarray
    info: dict[str, Any]


def filtered(problem: Problem, drawn: int, moves: Moves, rng: np.random.Generator) -> Filtered:
    """Run the filter, with the first ``drawn`` of the n states as particles.

    h must be linear in the other states with coefficients that depend on none of them; see
    :func:`.linear_states.mixing`.
    """
    epochs, n = problem.epochs, problem.dimension
    mean, cov, nis = np.empty((epochs, n)), np.empty((epochs, n, n)), np.full(epochs, np.nan)
    cloud = _Cloud(problem, drawn, moves, rng)
    repairs = 0
    for k in range(epochs):
        cloud.predict(k)
        if problem.present[k].any():
            nis[k] = cloud.update(k)
        mean[k], cov[k], was_repaired = cloud.moments()
        repairs += was_repaired
        cloud.renew_if_poor()
    sizes = cloud.sizes or [float(moves.particles)]
    info = {
        "ess_min": float(np.min(sizes)),
        "ess_median": float(np.median(sizes)),
        "resamplings": cloud.resamplings,
        "tempering_stages": cloud.stages,
        "unique_min": cloud.fewest,
        "covariance_repairs": repairs,
        "map_evaluations": cloud.evaluations,
        "log_evidence": cloud.evidence,
    }
    return Filtered(mean, cov, nis, info)


@compiled
def _log_likelihoods(
    residuals: np.ndarray, inverse: np.ndarray, log: np.ndarray, out: np.ndarray
) -> None:
    """Fill log (N,) − ½ |W r_i|² of residuals (N, m); W (m, m) is lower triangular."""
    m = residuals.shape[1]
    for i in range(residuals.shape[0]):
        total = 0.0
        for c in range(m):
            white = 0.0
            for d in range(c + 1):
                white += inverse[c, d] * residuals[i, d]
            total += white * white
        out[i] = log[i] - 0.5 * total


class _Cloud:
    """N weighted particles (N, n), log weights (N,), and P_l (n − d, n − d) of them all.

    Their ``evidence`` is ln p(z) of all readings so far, ``total`` the ln Σ of their weights. Where
    the cloud has become a ``gaussian``, mean (n,) and covariance (n, n), a few points stand for it.
    """

    def __init__(
        self, problem: Problem, drawn: int, moves: Moves, rng: np.random.Generator
    ) -> None:
        self.problem, self.drawn, self.moves, self.rng = problem, drawn, moves, rng
        self.count = moves.particles
        size = self.count * moves.start
        self.x = np.empty((size, problem.dimension))
        self.rest = np.empty((0, 0))
        self.log, self.trial = np.zeros(size), np.empty(size)
        self.weights = np.full(size, 1.0 / size)
        self.straight = self.poor = False
        self.on_trial = 0.0
        self.sizes: list[float] = []
        self.resamplings = self.stages = self.evaluations = 0
        self.fewest = self.count
        self.evidence, self.total = 0.0, math.log(size)
        self.gaussian: tuple[np.ndarray, np.ndarray] | None = None

    def predict(self, k: int) -> None:
        """Carry the cloud to epoch k; to the first one, draw it there, where its prior leads."""
        problem, d = self.problem, self.drawn
        phi, noise = problem.transition[k], problem.process_cov[k]
        if k == 0:
            # Paths from the start would tell the velocity what the position has drawn.
            joint = phi @ problem.prior_cov @ phi.T + noise
            steps = self._steps(joint)
            self.x = phi @ problem.prior_mean + self._balanced(len(self.x), len(steps)) @ steps
            return
        if self.gaussian:
            mean, cov = self.gaussian
            self.gaussian = phi @ mean, phi @ cov @ phi.T + noise
            self._draw(*self.gaussian, _PROBES)
            return
        joint = phi[:, d:] @ self.rest @ phi[:, d:].T + noise
        if self.moves.jitter and not self.straight:
            spread = self.moves.jitter * (problem.times[k] - problem.times[k - 1])
            joint[range(POSITION), range(POSITION)] += spread
        steps = self._steps(joint)
        self.x = self.x @ phi.T
        self.x += self.rng.standard_normal((len(self.x), len(steps))) @ steps

    def update(self, k: int) -> float:
        """Weigh the cloud by the reading of epoch k; return its NIS, NaN where it is none."""
        problem, d = self.problem, self.drawn
        there = problem.present[k]
        noise = problem.noise_of(k)[np.ix_(there, there)]
        slope = np.zeros((len(noise), len(self.rest)))
        if d < problem.dimension:
            slope = problem.model.jacobian(k, self.x[0])[there, d:]
            self.evaluations += 1
        residuals = self._residuals(k, there)
        if self.gaussian:
            self._straighten(residuals, slope, noise)
            if self.straight:
                return self._update_gaussian(residuals, slope, noise)
            self._draw(*self.gaussian, self.count)
            self.gaussian = None
            residuals = self._residuals(k, there)
        squared = self._innovation_squared(residuals, slope, noise) if self.straight else math.nan
        left, stages = 1.0, 0
        while True:
            spread = slope @ self.rest @ slope.T
            size, step = self._weigh(residuals, spread + noise / left), left
            if left == 1.0:
                self.sizes.append(size)
            if size < self.moves.tempering * self.count and stages < _MOST_STAGES:
                step = self._step(residuals, spread, noise, left)
                self._weigh(residuals, spread + noise / step)
            self.log, self.trial = self.trial, self.log
            self._count_evidence(spread + noise / step, noise, step)
            if not self.straight:
                self._straighten(residuals, slope, noise)
            if slope.any():
                self._correct(residuals, slope, spread + noise / step, noise / step)
            if step == left:
                break
            left, stages = left - step, stages + 1
            self.stages += 1
            self._straighten(residuals, slope, noise)
            self._renew()
            residuals = self._residuals(k, there)
        least = self.moves.threshold * self.count
        if effective_size(self.weights) < least or len(self.x) > self.count:
            self._straighten(residuals, slope, noise)
            self.poor = True
        return squared

    def moments(self) -> tuple[np.ndarray, np.ndarray, bool]:
        """Return mean (n,) and covariance (n, n) of the states, and whether it was repaired."""
        mean, cov = self.gaussian or self._moments()
        return mean, *repaired(cov, self.problem.prior_cov)

    def renew_if_poor(self) -> None:
        """Renew the cloud where a reading has left too few of its particles any weight."""
        if self.poor and self.straight:
            self.gaussian = self._moments()
        elif self.poor:
            self._renew()
        self.poor = False

    def _moments(self) -> tuple[np.ndarray, np.ndarray]:
        mean, cov = moments(self.weights, self.x)
        cov[self.drawn :, self.drawn :] += self.rest
        return mean, cov

    def _update_gaussian(
        self, residuals: np.ndarray, slope: np.ndarray, noise: np.ndarray
    ) -> float:
        """Update the Gaussian by a reading, linearised statistically; return its NIS.

        By regression on points that have its moments (Särkkä & Svensson 2023, ch. 9).
        """
        assert self.gaussian
        (mean, cov), n = self.gaussian, self.x.shape[1]
        innovation, joint = moments(self.weights, np.hstack([self.x, residuals]))
        innovation = innovation[n:]
        spread = joint[n:, n:] + slope @ self.rest @ slope.T + noise
        across = -joint[:n, n:]
        across[self.drawn :] += self.rest @ slope.T
        gain = np.linalg.solve(spread, across.T).T
        self.gaussian = mean + gain @ innovation, cov - gain @ spread @ gain.T
        squared = float(innovation @ np.linalg.solve(spread, innovation))
        self.evidence -= 0.5 * (squared + np.linalg.slogdet(2.0 * np.pi * spread)[1])
        return squared

    def _residuals(self, k: int, there: np.ndarray) -> np.ndarray:
        self.evaluations += len(self.x)
        residuals, read = np.empty((len(self.x), len(there))), self.problem.measurements[k]
        for first in range(0, len(self.x), _CHUNK):
            some = slice(first, first + _CHUNK)
            np.subtract(read, self.problem.model.predict(k, self.x[some]), out=residuals[some])
        return residuals if there.all() else np.ascontiguousarray(residuals[:, there])

    def _weigh(self, residuals: np.ndarray, innovation: np.ndarray) -> float:
        """Put log weights after a share of a reading on trial; return the ESS that they leave."""
        _log_likelihoods(residuals, _inverse_root(innovation), self.log, self.trial)
        self.on_trial = normalise(self.trial, self.weights)
        return float(effective_size(self.weights))

    def _count_evidence(self, innovation: np.ndarray, noise: np.ndarray, step: float) -> None:
        """Add what a share of a reading has added to ln p(z).

        The share of a density N(r; 0, R) is its power, which is N(r; 0, R / share) but for a factor
        that depends on R alone.
        """
        m = len(noise)
        of_power = (1.0 - step) * np.linalg.slogdet(2.0 * np.pi * noise)[1] - m * math.log(step)
        density = -np.linalg.slogdet(2.0 * np.pi * innovation)[1]
        self.evidence += float(self.on_trial - self.total + 0.5 * (density + of_power))
        self.total = self.on_trial

    def _step(
        self, residuals: np.ndarray, spread: np.ndarray, noise: np.ndarray, most: float
    ) -> float:
        """Return which share of a reading leaves as many effective particles as it should."""
        least = self.moves.tempering * self.count
        low, high = math.log(_LEAST_STEP), math.log(most)
        for _ in range(_BISECTIONS):
            middle = 0.5 * (low + high)
            if self._weigh(residuals, spread + noise / math.exp(middle)) >= least:
                low = middle
            else:
                high = middle
        return math.exp(low)

    def _correct(
        self, residuals: np.ndarray, slope: np.ndarray, innovation: np.ndarray, noise: np.ndarray
    ) -> None:
        """Update the linear states: one gain for all particles, P_l in Joseph's form."""
        gain = np.linalg.solve(innovation, slope @ self.rest).T
        self.x[:, self.drawn :] += residuals @ gain.T
        keep = np.eye(len(self.rest)) - gain @ slope
        self.rest = keep @ self.rest @ keep.T + gain @ noise @ gain.T

    def _innovation_squared(
        self, residuals: np.ndarray, slope: np.ndarray, noise: np.ndarray
    ) -> float:
        mean, cov = moments(self.weights, residuals)
        return float(mean @ np.linalg.solve(cov + slope @ self.rest @ slope.T + noise, mean))

    def _straighten(self, residuals: np.ndarray, slope: np.ndarray, noise: np.ndarray) -> None:
        """Find whether h is straight over the weighted cloud, to the noise."""
        d = self.drawn
        if not self.moves.straight or effective_size(self.weights) < _PER_STATE * d:
            self.straight = False
            return
        # Of what the drawn states alone make of h.
        bent = (residuals + self.x[:, d:] @ slope.T) @ _inverse_root(noise).T
        _, joint = moments(self.weights, np.hstack([self.x[:, :d], bent]))
        _, inverse = ranked_root(joint[:d, :d])
        explained = inverse.T @ joint[:d, d:]
        left = np.diag(joint)[d:] - (explained**2).sum(axis=0)
        self.straight = bool(left.max() < self.moves.straight)

    def _renew(self) -> None:
        """Replace the cloud by one of equal weights."""
        moves, d = self.moves, self.drawn
        self.resamplings += 1
        if self.straight:
            self._draw(*self._moments(), self.count)
        else:
            ancestors = resample(moves.resampling, self.weights, self.rng, self.count)
            self.fewest = min(self.fewest, unique(ancestors))
            self.x = self.x[ancestors]
            if moves.roughening:
                extent = np.ptp(self.x[:, :d], axis=0) * moves.roughening
                noise = self.rng.standard_normal((self.count, d))
                self.x[:, :d] += noise * extent * self.count ** (-1.0 / d)
            if moves.regularisation:
                self._regularise()
            if moves.kernel:
                self._blur()
        self._level()

    def _level(self) -> None:
        """Give all particles the same weight."""
        count = len(self.x)
        self.log, self.trial = np.zeros(count), np.empty(count)
        self.weights = np.full(count, 1.0 / count)
        self.total = math.log(count)

    def _draw(self, mean: np.ndarray, cov: np.ndarray, count: int) -> None:
        """Draw the cloud from a Gaussian, whose mean and covariance it then has exactly.

        Second-order exact sampling (Pham 2001): the draw adds no error to either.
        """
        steps = self._steps(cov)
        self.x = mean + self._balanced(count, len(steps)) @ steps
        self._level()

    def _blur(self) -> None:
        """Move all particles by the kernel of Liu and West, and P_l with them."""
        b = self.moves.kernel
        mean, cov = moments(np.full(self.count, 1.0 / self.count), self.x)
        cov *= b * b
        cov[self.drawn :, self.drawn :] += self.rest
        steps = self._steps(cov)
        self.x = mean + math.sqrt(1.0 - b * b) * (self.x - mean)
        self.x += self.rng.standard_normal((self.count, len(steps))) @ steps

    def _regularise(self) -> None:
        """Blur the position by the kernel of Musso, Oudjane and Le Gland."""
        _, cov = moments(np.full(self.count, 1.0 / self.count), self.x[:, :POSITION])
        root, _ = ranked_root(cov)
        width = (4.0 / (POSITION + 2.0)) ** (1.0 / (POSITION + 4.0))
        width *= self.moves.regularisation * self.count ** (-1.0 / (POSITION + 4.0))
        noise = self.rng.standard_normal((self.count, root.shape[1]))
        self.x[:, :POSITION] += width * noise @ root.T

    def _steps(self, joint: np.ndarray) -> np.ndarray:
        """Return (r, n) what r normal numbers make of a particle, and keep the rest as P_l."""
        d = self.drawn
        root, inverse = ranked_root(joint[:d, :d])
        told = inverse.T @ joint[:d, d:]
        rest = joint[d:, d:] - told.T @ told
        self.rest = 0.5 * (rest + rest.T)
        return np.hstack([root.T, told])

    def _balanced(self, count: int, rank: int) -> np.ndarray:
        """Return normal numbers (N, r) whose mean is zero and whose covariance is one, exactly."""
        noise = self.rng.standard_normal((count, rank))
        if count <= rank or rank == 0:
            return noise
        noise -= noise.mean(axis=0)
        root = np.linalg.cholesky(noise.T @ noise / count)
        return np.asarray(np.linalg.solve(root, noise.T).T)


def _inverse_root(cov: np.ndarray) -> np.ndarray:
    """Return the inverse of the lower triangular root of a covariance (m, m)."""
    return np.asarray(np.linalg.inv(np.linalg.cholesky(cov)))
