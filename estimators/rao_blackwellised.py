"""Rao–Blackwellised particle filter: particles of the position, a Kalman filter of all the rest.

Readings of gravity gradients bend with the position alone. Given a path of positions, velocity,
attitude and biases are a linear problem, which a Kalman filter solves exactly, and for all
particles with one and the same covariance. So particles need only three dimensions instead of
fifteen (Schön, Gustafsson & Nordlund 2005; Gustafsson et al. 2002 for terrain navigation).

That alone does not cure the depletion of the textbook filter (see ``particle``): a particle is a
path, a path determines its velocity and its biases, and a copied path stays a copy. Four things do:

- As long as h is a straight line over all that is possible, to within the noise of a reading, the
  posterior is a Gaussian, and a Kalman filter carries it, linearised statistically over a hundred
  points.
- Where h bends over the Gaussian, particles are drawn from it. The reading that comes then has a
  whole prior to search: many more particles than usual weigh it (``start``). A reading that leaves
  too few of them is taken in by stages (``tempering``), between which Metropolis–Hastings steps
  move the particles. These stages are exact (see :mod:`ggbench.engines.annealing`).
- While there are particles the position has an additional noise, of which the Kalman part knows
  (``jitter``), so that copies separate.
- As soon as h is a straight line over the cloud, and the cloud has the shape of a Gaussian, it
  becomes one, linear states included (``straight``). So does the prediction where a reading lies in
  its tail, and leaves fewer than 4 √N effective particles: a Gaussian has tails, a cloud has none.

Without these it claims, on flights that start 100 m off, to know the position ten times better than
the Cramér–Rao bound allows, and is wrong by hundreds of metres.

The posterior is exact in the limit of many particles N: jitter falls as N^{−1/2}, and the bending
that counts as straight as N^{−1}. Priors of 600 m and 1 km, two and three states, against a grid:
the mean is 0.03 to 0.08 standard deviations off with 4000 particles (rms), and 0.015 to 0.05 with
16,000. What remains is sampling noise. Large biases and a truth in the tail of the prior cost
accuracy: with 20 E per channel and 2.5 σ on one axis it is 0.09, 0.07 and 0.02 off with 1000, 4000
and 16,000. A single run scatters by a factor of three about that. Where modes stay alike for
minutes, each resampling lets their weights drift: the shares of two valleys after 80 readings need
30,000 particles.
"""

from __future__ import annotations

from dataclasses import dataclass

from ..engines.linear_states import POSITION, mixing
from ..engines.resampling import Resampling
from ..parameters import AtLeastOne, NonNegative, Share
from ..problem import Problem
from .particle import CloudFilter, Particles, Tempering


@dataclass(frozen=True)
class RaoBlackwellisedFilter(CloudFilter):
    """Rao–Blackwellised particle filter (Schön, Gustafsson & Nordlund 2005) of the position.

    Parameters
    ----------
    particles : number N of particles. Each costs 0.4 µs per epoch.
    resampling : ``systematic``, ``stratified`` or ``residual``.
    threshold : effective sample size over N below which the cloud is resampled.
    tempering : effective share of N below which an update of Gaussian samples is split into
        stages; 0: no stages.
    jitter : noise density of the position [m²/s] for 4000 particles, in proportion to N^{−1/2}.
        The Kalman filter part includes it.
    straight : nonlinear part of the variance of h over 4000 particles, relative to the noise, below
        which a Gaussian replaces the particles; in proportion to N^{−1}; 0: never.
    start : factor on N for the first measurement over which h is nonlinear.
    """

    particles: Particles = 4000
    resampling: Resampling = "systematic"
    threshold: Share = 0.5
    tempering: Tempering = 0.25
    jitter: NonNegative = 0.25
    straight: NonNegative = 0.02
    start: AtLeastOne = 32

    name = "rao-blackwellised"

    def skip(self, problem: Problem) -> str | None:
        """Refuse measurements that bend with other states than the position."""
        return mixing(problem)

    def drawn(self, problem: Problem) -> int:
        """The position."""
        return POSITION
