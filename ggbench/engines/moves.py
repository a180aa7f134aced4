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
    """How a cloud is kept alive; zero switches each of them off.

    Attributes
    ----------
    particles : N.
    resampling : the method.
    threshold : ESS over N below which the cloud is renewed.
    tempering : ESS over N that a stage of a reading leaves at least; a reading that would leave
        less is taken in by stages. Without a kernel those of a Gaussian's draws alone are, and
        exactly (:mod:`.annealing`). With one they are of any cloud, each raising the likelihood to
        a power (Oudjane & Musso 2000), with a renewal in between.
    kernel : bandwidth b of the kernel after resampling, x ← m + √(1 − b²) (x − m) + b T^{1/2} e,
        which keeps mean m and covariance T (Liu & West 2001).
    jitter : noise density of the position [m²/s] added to Q of a cloud of 4000; in proportion to
        N^{−1/2}.
    straight : variance, over that of the noise, which is left of the h of a cloud of 4000 after a
        regression on the drawn states and below which h counts as a straight line over the cloud;
        in proportion to N^{−1}. What goes on, if it is shaped like one, is then a Gaussian, which a
        Kalman filter carries, until h bends over it again.
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

    @property
    def blurs(self) -> bool:
        """Whether a kernel parts copies."""
        return bool(self.kernel or self.roughening or self.regularisation)

    @property
    def noise_density(self) -> float:
        """The jitter of so many particles [m²/s]."""
        return float(self.jitter * (_USUAL / self.particles) ** 0.5)

    @property
    def most_bending(self) -> float:
        """The variance below which h is straight over so many particles."""
        return self.straight * _USUAL / self.particles


def roughen(x: np.ndarray, drawn: int, moves: Moves, rng: np.random.Generator) -> None:
    """Blur the drawn states of particles (N, n) in proportion to their extent, as Gordon et al."""
    count = len(x)
    extent = np.ptp(x[:, :drawn], axis=0) * moves.roughening
    noise = rng.standard_normal((count, drawn))
    x[:, :drawn] += noise * extent * count ** (-1.0 / drawn)


def regularise(x: np.ndarray, moves: Moves, rng: np.random.Generator) -> None:
    """Blur the position of particles (N, n) by the kernel of Musso, Oudjane and Le Gland."""
    count = len(x)
    _, cov = moments(np.full(count, 1.0 / count), x[:, :POSITION])
    root, _ = ranked_root(cov)
    width = (4.0 / (POSITION + 2.0)) ** (1.0 / (POSITION + 4.0))
    width *= moves.regularisation * count ** (-1.0 / (POSITION + 4.0))
    noise = rng.standard_normal((count, root.shape[1]))
    x[:, :POSITION] += width * noise @ root.T
