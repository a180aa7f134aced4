"""Rao–Blackwellised particle filter: particles of the position, a Kalman filter of all the rest.

Readings of gravity gradients bend with the position alone. Given a path of positions, velocity,
attitude and biases are a linear problem, which a Kalman filter solves exactly, and for all
particles with one and the same covariance. So particles need only three dimensions instead of
fifteen (Schön, Gustafsson & Nordlund 2005; Gustafsson et al. 2002 for terrain navigation).

That alone does not cure the textbook filter's depletion (see ``particle``): a particle is a path,
a path tells its velocity and its biases, and a copied path stays a copy. Three things do:

- The first reading leaves a few of thousands of particles, perhaps none at the right of several
  places that look alike. So many more of them weigh it (``start``), and readings that still leave
  too few are taken in by stages (``tempering``), each of which leaves a quarter of the cloud and
  blurs it by a ``kernel`` before the next.
- While the cloud still has several modes or bends with the field, the position has a noise that the
  Kalman part is told of (``jitter``), so that copies part.
- As soon as h is a straight line over the whole cloud, to within the noise of a reading, prior,
  reading and so the posterior are Gaussians. Instead of being resampled the cloud then becomes the
  Gaussian of its mean and covariance, linear states included: velocity and biases that were tied
  to paths are a covariance again, and nothing is claimed that the readings have not told. A Kalman
  filter, linearised statistically over a hundred points, carries it; should h bend over it again,
  particles are drawn from it.

Without these it claims, on flights where it started 100 m off, to know the position ten times
better than the Cramér–Rao bound allows, and is wrong by hundreds of metres.
"""

from __future__ import annotations

from dataclasses import dataclass

from ..engines.linear_states import POSITION, mixing
from ..engines.particles import Moves
from ..engines.resampling import Resampling
from ..parameters import AtLeastOne, NonNegative, Share
from ..problem import Problem
from .particle import CloudFilter, Particles, Tempering


@dataclass(frozen=True)
class RaoBlackwellisedFilter(CloudFilter):
    """Rao–Blackwellised particle filter (Schön, Gustafsson & Nordlund 2005) of the position.

    Parameters
    ----------
    particles : their number N. Until it is straight a cloud costs 0.4 µs per particle and epoch.
    resampling : ``systematic``, ``stratified`` or ``residual``.
    threshold : effective sample size over N below which the cloud is renewed.
    tempering : a reading that would leave less than this share of N effective is taken in by
        stages; 0 takes each reading at once.
    kernel : bandwidth, 0 to 1, of the kernel of Liu & West (2001) after resampling.
    jitter : noise of the position [m²/s], told to the Kalman part, while the cloud is not straight.
    straight : variance of h over the cloud, over that of the noise, which no straight line explains
        and below which the cloud counts as straight, and goes on as a Gaussian; 0: never.
    start : how many times N particles weigh the first reading, which has a whole prior to search.
    """

    particles: Particles = 4000
    resampling: Resampling = "systematic"
    threshold: Share = 0.5
    tempering: Tempering = 0.25
    kernel: Share = 0.1
    jitter: NonNegative = 0.25
    straight: NonNegative = 0.25
    start: AtLeastOne = 32

    name = "rao-blackwellised"

    @property
    def moves(self) -> Moves:
        """As the parameters say."""
        return Moves(
            self.particles, self.resampling, self.threshold, self.tempering, self.kernel,
            self.jitter, self.straight, self.start,
        )  # fmt: skip

    def skip(self, problem: Problem) -> str | None:
        """Refuse measurements that bend with other states than the position."""
        return mixing(problem)

    def drawn(self, problem: Problem) -> int:
        """The position."""
        return POSITION
