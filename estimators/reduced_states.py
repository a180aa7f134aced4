"""Filters of two or four states, as published, for comparison with filters of all states.

Much of the literature on gravity-gradient matching estimates only position and velocity, or only
the position, and assumes that all other states are known. Such a model lacks tilt and accelerometer
biases, which cause velocity errors within minutes (Schuler period 84 minutes). A declared process
noise replaces the omitted states, and the result depends on this noise. With too little noise the
filter is overconfident. With too much noise the filter discards the information of earlier
measurements.

In the estimate the omitted states have their propagated prior, so that the estimate can be compared
with estimates of all states.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, Literal

import numpy as np

from ..parameters import NonNegative
from ..problem import Estimate, Estimator, Problem
from ..reduced import Reduction, drifting, horizontal, reduced, walking
from .ekf import ExtendedKalmanFilter
from .filterpy_ukf import FilterpyUnscented
from .gaussian_particle import GaussianParticle
from .gaussian_sum import GaussianSum
from .particle import ParticleFilter
from .point_mass import PointMass
from .unscented_particle import UnscentedParticle

FILTERS: Mapping[str, Estimator] = MappingProxyType(
    {
        "ekf": ExtendedKalmanFilter(),
        "ukf": FilterpyUnscented(points="cubature"),
        "gaussian-sum": GaussianSum(),
        "point-mass": PointMass(),
        "particle": ParticleFilter(particles=10_000),
        "gaussian-particle": GaussianParticle(particles=3000),
        "unscented-particle": UnscentedParticle(particles=100),
        "strong-tracking": UnscentedParticle(particles=100, strong_tracking=True),
    }
)
"""The filters, with their usual numbers of particles."""


@dataclass(frozen=True)
class ReducedStates(Estimator):
    """Filter of some states; all others are assumed to be known.

    Parameters
    ----------
    filter : ``ekf``, ``ukf`` (with cubature points), ``gaussian-sum``, ``point-mass``,
        ``particle``, ``gaussian-particle``, ``unscented-particle``, or ``strong-tracking``, the
        unscented particle filter with strong tracking.
    states : ``motion``: position and velocity east and north. ``position``: only the position east
        and north.
    noise : density of the white noise that replaces the omitted states: acceleration noise [m²/s³]
        for ``motion``, velocity noise [m²/s] for ``position``; 0 for no noise.
    particles : number of particles [default: 10,000 for ``particle``, 3000 for
        ``gaussian-particle``, 100 for the unscented particle filters].
    beta : β of ``strong-tracking`` [default: 1].
    weights : weights of the unscented particle filters, as in :mod:`.unscented_particle` [default:
        ``mixture``].
    """

    filter: Literal[
        "ekf",
        "ukf",
        "gaussian-sum",
        "point-mass",
        "particle",
        "gaussian-particle",
        "unscented-particle",
        "strong-tracking",
    ] = "ekf"
    states: Literal["motion", "position"] = "motion"
    noise: NonNegative = 1e-3
    particles: int | None = None
    beta: float | None = None
    weights: Literal["mixture", "likelihood", "exact"] | None = None

    name = "reduced"
    family = "kalman"
    causality = "filter"
    exact_if_linear_gaussian = False  # of another problem

    def conflict(self) -> str | None:
        """Return an error text if a parameter does not belong to the filter; else None."""
        if self.particles is not None and "particles" not in vars(FILTERS[self.filter]):
            return f"{self.filter} has no particles"
        if self.beta is not None and self.filter != "strong-tracking":
            return f"{self.filter} has no beta: remove beta, or use filter=strong-tracking"
        if self.weights is not None and "weights" not in vars(FILTERS[self.filter]):
            return f"{self.filter} has no weights"
        try:
            self._filter()
        except ValueError as error:
            return str(error)
        return super().conflict()

    def skip(self, problem: Problem) -> str | None:
        """Return a reason to skip the problem, or None if there is none.

        The problem must have the reduced states and other states. The chosen filter must accept the
        problem of the reduced states.
        """
        blocks = {block.name for block in problem.layout}
        if not horizontal(problem, self.states == "motion") or len(blocks) < 2:
            return "the problem has no position and velocity errors among other states"
        return self._filter().skip(self._reduction(problem).problem)

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        """Filter the problem of the reduced states, and return an estimate of all states."""
        reduction = self._reduction(problem)
        return reduction.embedded(self._filter().estimate(reduction.problem, rng))

    def _reduction(self, problem: Problem) -> Reduction:
        motion = self.states == "motion"
        noise = (drifting if motion else walking)(problem.times, self.noise)
        return reduced(problem, horizontal(problem, motion), noise)

    def _filter(self) -> Estimator:
        given = {"particles": self.particles, "beta": self.beta, "weights": self.weights}
        changes: dict[str, Any] = {k: v for k, v in given.items() if v is not None}
        return replace(FILTERS[self.filter], **changes)
