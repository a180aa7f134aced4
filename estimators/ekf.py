"""Extended Kalman filter, compiled: plain, iterated, robust, with adaptive measurement noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import Field

from ..block import CompiledModel, EstimateBlock, ProblemBlock
from ..engines.extended_filter import UpdateOptions, extended
from ..parameters import AtLeastOne
from ..problem import Estimate, Problem
from .robust import GatedUpdate


@dataclass(frozen=True)
class ExtendedKalmanFilter(GatedUpdate):
    """Extended Kalman filter (Bar-Shalom, Li & Kirubarajan 2001, ch. 10).

    Parameters
    ----------
    iterations : largest number of linearisations of h per epoch; 1 is the plain filter. With 2 or
        more the update is a Gauss–Newton search for the most probable state (Bell & Cathey 1993),
        with steps halved until the cost decreases.
    noise_memory : number of measurements over which the noise variance of each component is
        estimated from the residuals; 0 keeps the assumed noise. The method is that of Mohamed &
        Schwarz (1999) with the fading memory of Sage & Husa (1969).
    """

    iterations: AtLeastOne = 1
    noise_memory: Annotated[int, Field(ge=0)] = 0

    name = "ekf"
    family = "kalman"

    def conflict(self) -> str | None:
        """Return a reason to refuse the parameters, or None if there is none.

        ``noise_memory`` must not be 1. Gates and underweighting need the plain update:
        ``iterations=1``, ``noise_memory=0`` and no loss.
        """
        if self.noise_memory == 1:
            return "noise_memory must be 0 or at least 2, not 1"
        if self.gate or self.underweighting:
            name = "gate" if self.gate else "underweighting"
            if self.iterations > 1:
                return f"{name} needs iterations = 1, not {self.iterations}"
            if self.noise_memory:
                return f"{name} cannot be combined with noise_memory"
        return super().conflict()

    def skip(self, problem: Problem) -> str | None:
        """Return a reason to skip the problem, or None if there is none.

        Models without compiled kernels are accepted only by the plain filter.
        """
        if self == ExtendedKalmanFilter(noise_scale=self.noise_scale):
            return None
        return super().skip(problem)

    def estimate_block(
        self, block: ProblemBlock, rngs: Sequence[np.random.Generator] = ()
    ) -> EstimateBlock:
        """Filter all runs of a block."""
        return extended(
            block,
            UpdateOptions(
                iterations=self.iterations,
                loss=self.loss,
                threshold=self.limit,
                noise_memory=self.noise_memory,
                gate=self.gate,
                underweighting=self.underweighting,
            ),
        )

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        """Filter one run; the plain filter accepts any measurement model.

        Raises TypeError if the filter is not the plain filter and the model has no kernels.
        """
        if isinstance(problem.model, CompiledModel):
            return super().estimate(problem, rng)
        if reason := self.skip(problem):
            raise TypeError(reason)
        return plain(problem)


def plain(problem: Problem) -> Estimate:
    """Return the estimate of the plain filter, computed in NumPy for any measurement model."""
    x, p = problem.prior_mean, problem.prior_cov
    identity = np.eye(problem.dimension)
    mean = np.empty((problem.epochs, problem.dimension))
    cov = np.empty((problem.epochs, *p.shape))
    for k in range(problem.epochs):
        phi, r = problem.transition[k], problem.noise_of(k)
        x, p = phi @ x, phi @ p @ phi.T + problem.process_cov[k]
        h = problem.model.jacobian(k, x)
        gain = np.linalg.solve(h @ p @ h.T + r, h @ p).T
        x = x + gain @ (problem.measurements[k] - problem.model.predict(k, x))
        kept = identity - gain @ h
        p = kept @ p @ kept.T + gain @ r @ gain.T  # Joseph's form
        p = 0.5 * (p + p.T)
        mean[k], cov[k] = x, p
    return Estimate(mean, cov, "filter", info={"linearisations": problem.epochs})
