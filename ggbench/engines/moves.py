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
    """Rejuvenation of a particle cloud; zero switches an option off.

    Attributes
    ----------
    particles : N.
    resampling : the method.
    threshold : ESS over N below which the cloud is resampled.
    tempering : least ESS over N after a stage; an update that would leave less is split into
        stages. Without a kernel only updates of Gaussian samples are split, exactly
        (:mod:`.annealing`). With a kernel all updates are split, by powers of the likelihood
        (Oudjane & Musso 2000), with resampling between stages.
    kernel : bandwidth b of the kernel after resampling, x ← m + √(1 − b²) (x − m) + b T^{1/2} e,
        which keeps mean m and covariance T (Liu & West 2001).
    jitter : noise density of the position [m²/s] added to Q of a cloud of 4000; in proportion to
        N^{−1/2}.
    straight : residual variance of h over a cloud of 4000 after a regression on the sampled states,
        relative to the noise, below which h counts as linear; in proportion to N^{−1}. A cloud of
        Gaussian shape is then replaced by a Gaussian in a Kalman filter, until h is nonlinear over
        it.
    start : factor on N until the first measurement has been processed, because that measurement
        searches the whole prior for narrow modes.
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

    @property
    def blurs(self) -> bool:
        """Whether a kernel separates copies."""
        return bool(self.kernel or self.roughening or self.regularisation)

    @property
    def noise_density(self) -> float:
        """Return the jitter for a number of particles [m²/s]."""
        return float(self.jitter * (_USUAL / self.particles) ** 0.5)

    @property
    def most_bending(self) -> float:
        """Return the largest nonlinear variance of h that counts as linear."""
        return self.straight * _USUAL / self.particles


def roughen(x: np.ndarray, drawn: int, moves: Moves, rng: np.random.Generator) -> None:
    """Add noise to sampled states of particles (N, n), in proportion to their extent."""
    count = len(x)
    extent = np.ptp(x[:, :drawn], axis=0) * moves.roughening
    noise = rng.standard_normal((count, drawn))
    x[:, :drawn] += noise * extent * count ** (-1.0 / drawn)


def regularise(x: np.ndarray, moves: Moves, rng: np.random.Generator) -> None:
    """Add noise to positions of particles (N, n), by the kernel of Musso, Oudjane, Le Gland."""
    count = len(x)
    _, cov = moments(np.full(count, 1.0 / count), x[:, :POSITION])
    root, _ = ranked_root(cov)
    width = (4.0 / (POSITION + 2.0)) ** (1.0 / (POSITION + 4.0))
    width *= moves.regularisation * count ** (-1.0 / (POSITION + 4.0))
    noise = rng.standard_normal((count, root.shape[1]))
    x[:, :POSITION] += width * noise @ root.T
