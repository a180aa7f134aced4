"""Rejuvenation of particle clouds: settings and compiled kernels."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..numerics.positive import ranked_root
from .linear_states import POSITION
from .resampling import Resampling, moments

_USUAL = 4000.0
"""Particles of which ``jitter`` and ``straight`` are given."""


class Moves(NamedTuple):
    """Options for the rejuvenation of a particle cloud; zero switches an option off.

    Attributes
    ----------
    particles : number N of particles.
    resampling : resampling method.
    threshold : effective sample size (ESS), as a fraction of N, below which the cloud is resampled.
    tempering : smallest ESS, as a fraction of N, that an update may leave; otherwise the update is
        split into stages. If ``kernel``, ``roughening`` and ``regularisation`` are zero, only the
        update of a Gaussian cloud is split; the result is exact (:mod:`.annealing`). Otherwise any
        update may be split into powers of the likelihood (Oudjane & Musso 2000), with resampling
        between stages.
    kernel : bandwidth b of the kernel after resampling, x ← m + √(1 − b²) (x − m) + b T^{1/2} e,
        which preserves the mean m and the covariance T of the cloud (Liu & West 2001); e is
        standard normal.
    jitter : noise density of the position [m²/s] that is added to Q, for N = 4000; it is scaled by
        (4000 / N)^{1/2}.
    straight : largest residual variance of h after a linear regression on the sampled states, in
        units of the noise variance, for which h counts as linear. The value applies to N = 4000;
        it is scaled by 4000 / N. If h is linear, a cloud of Gaussian shape is replaced by a Kalman
        filter until h is nonlinear again.
    start : factor on N in the first update that uses particles. This update needs more particles,
        to find narrow modes within the whole prior.
    roughening : K of Gordon et al. (1993). After resampling, noise with standard deviation K E_j
        N^{−1/d} is added to state j of d sampled states, where E_j is the extent of the cloud in
        state j.
    regularisation : bandwidth of a Gaussian kernel on the position after resampling, relative to
        the optimal bandwidth (4/5)^{1/7} N^{−1/7} of Musso, Oudjane & Le Gland (2001).
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

    @property
    def blurs(self) -> bool:
        """Whether noise is added after resampling, which separates copies of a particle."""
        return bool(self.kernel or self.roughening or self.regularisation)

    @property
    def noise_density(self) -> float:
        """Return the option ``jitter``, scaled to the number N of particles [m²/s]."""
        return float(self.jitter * (_USUAL / self.particles) ** 0.5)

    @property
    def most_bending(self) -> float:
        """Return the limit of the residual variance of a linear h, for N particles."""
        return self.straight * _USUAL / self.particles


def roughen(x: np.ndarray, drawn: int, moves: Moves, rng: np.random.Generator) -> None:
    """Add noise to the first ``drawn`` states of particles (N, n), see :class:`Moves`."""
    count = len(x)
    extent = np.ptp(x[:, :drawn], axis=0) * moves.roughening
    noise = rng.standard_normal((count, drawn))
    x[:, :drawn] += noise * extent * count ** (-1.0 / drawn)


def regularise(x: np.ndarray, moves: Moves, rng: np.random.Generator) -> None:
    """Add regularisation noise to the positions of particles (N, n), see :class:`Moves`."""
    count = len(x)
    _, cov = moments(np.full(count, 1.0 / count), x[:, :POSITION])
    root, _ = ranked_root(cov)
    width = (4.0 / (POSITION + 2.0)) ** (1.0 / (POSITION + 4.0))
    width *= moves.regularisation * count ** (-1.0 / (POSITION + 4.0))
    noise = rng.standard_normal((count, root.shape[1]))
    x[:, :POSITION] += width * noise @ root.T
