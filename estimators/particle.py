"""Particle filter: the textbook's, with what keeps its particles apart.

A cloud of N guesses of the whole state is carried along by Φ and noise, weighed by how likely each
makes the readings, and resampled where too few weigh anything: heavy ones are copied, light ones
die (Gordon, Salmond & Smith 1993). It needs no linearisation and holds several hypotheses at once.

Why it fails here. An INS is a good clockwork: between two readings its errors are driven by a noise
of millimetres, and its biases by none at all, while one reading of a gradiometer tells a position
to some tens of metres. After the first reading a few dozen of ten thousand particles weigh
anything; resampling makes copies of them, and copies that the dynamics hardly part stay copies.
From then on the filter searches among the few guesses that it happened to have in the beginning,
and is sure of the best of them, whichever it is: depletion. More particles help as slowly as a
fifteen-dimensional grid does.

What cures it. ``tempering`` takes a sharp reading in by stages, so that a cloud can move to where
the weight is before it is depleted; ``kernel``, ``roughening`` and ``regularisation`` part copies
by noise that the flight has not, each an approximation that widens the cloud or mixes its modes.
They help, and not enough: see ``rao-blackwellised``, which draws three states instead of fifteen.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..block import DrawingEstimator, EstimateBlock, ProblemBlock
from ..engines.particles import Filtered, Moves, filtered
from ..engines.resampling import Resampling
from ..problem import Causality, Estimate, Problem

_MOST = 1_000_000
"""Particles that fit in memory."""


@dataclass(frozen=True)
class CloudFilter(DrawingEstimator):
    """What particle filters share: runs of a block one after the other, each with its generator."""

    @property
    def causality(self) -> Causality:
        """Measurements up to each epoch."""
        return "filter"

    @property
    @abstractmethod
    def moves(self) -> Moves:
        """How the cloud is kept alive."""

    @abstractmethod
    def drawn(self, problem: Problem) -> int:
        """Return how many of the states, from the first on, are drawn."""

    def skip(self, problem: Problem) -> str | None:
        """Refuse parameters that mean nothing."""
        moves = self.moves
        if not 2 <= moves.particles <= _MOST:
            return f"particles must be 2 to {_MOST}, and is {moves.particles}"
        if moves.start < 1 or moves.start * moves.particles > _MOST:
            most = _MOST // moves.particles
            return f"start must be 1 to {most} with so many particles, and is {moves.start}"
        if not 0.0 <= moves.threshold <= 1.0:
            return f"threshold is a share, 0 to 1, and is {moves.threshold:g}"
        if not 0.0 <= moves.tempering < 1.0:
            return f"tempering is a share, 0 to 1, and is {moves.tempering:g}"
        if not 0.0 <= moves.kernel <= 1.0:
            return f"kernel is a bandwidth, 0 to 1, and is {moves.kernel:g}"
        for name in ("jitter", "straight", "roughening", "regularisation"):
            value = getattr(moves, name)
            if not 0.0 <= value < np.inf:
                return f"{name} must not be negative, and is {value:g}"
        if moves.tempering and not (moves.kernel or moves.roughening or moves.regularisation):
            return "tempering needs a kernel, roughening or regularisation: else copies stay copies"
        return None

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        """Filter one run of any model."""
        found = self._filtered(problem, rng)
        return Estimate(found.mean, found.cov, self.causality, info=found.info, nis=found.nis)

    def estimate_block(
        self, block: ProblemBlock, rngs: Sequence[np.random.Generator] = ()
    ) -> EstimateBlock:
        """Filter the runs of a block, one after the other."""
        runs = zip(range(block.runs), rngs, strict=True)
        found = [self._filtered(block.problem(run), rng) for run, rng in runs]
        info = {name: np.array([one.info[name] for one in found]) for name in found[0].info}
        return EstimateBlock(
            np.stack([one.mean for one in found]), np.stack([one.cov for one in found]),
            self.causality, nis=np.stack([one.nis for one in found]), info=info,
        )  # fmt: skip

    def _filtered(self, problem: Problem, rng: np.random.Generator) -> Filtered:
        return filtered(problem, self.drawn(problem), self.moves, rng)


@dataclass(frozen=True)
class ParticleFilter(CloudFilter):
    """Bootstrap particle filter (Gordon, Salmond & Smith 1993) over all states.

    Parameters
    ----------
    particles : their number N. A run costs about 0.4 µs per particle and epoch.
    resampling : ``systematic``, ``stratified`` or ``residual``.
    threshold : effective sample size over N below which the cloud is resampled.
    tempering : a reading that would leave less than this share of N effective is taken in by
        stages; 0 takes each reading at once. It needs one of the following three.
    kernel : bandwidth, 0 to 1, of the kernel of Liu & West (2001) after resampling.
    roughening : Gordon's K, of noise after resampling in proportion to the cloud's extent.
    regularisation : bandwidth of a kernel on the position after resampling, over the optimal one
        of Musso, Oudjane & Le Gland (2001).
    """

    particles: int = 10_000
    resampling: Resampling = "systematic"
    threshold: float = 0.5
    tempering: float = 0.0
    kernel: float = 0.0
    roughening: float = 0.0
    regularisation: float = 0.0

    name = "particle"

    @property
    def moves(self) -> Moves:
        """As the parameters say."""
        return Moves(
            self.particles, self.resampling, self.threshold, self.tempering, self.kernel,
            roughening=self.roughening, regularisation=self.regularisation,
        )  # fmt: skip

    def drawn(self, problem: Problem) -> int:
        """All states."""
        return problem.dimension
