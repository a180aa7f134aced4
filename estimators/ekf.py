"""Extended Kalman filter, compiled: plain, iterated, robust, with adaptive measurement noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import Field

from ..block import CompiledModel, EstimateBlock, ProblemBlock
from ..engines import filters
from ..engines.iterated_filter import iterated
from ..parameters import AtLeastOne
from ..problem import Estimate, Problem
from . import textbook
from .robust import GatedUpdate


@dataclass(frozen=True)
class ExtendedKalmanFilter(GatedUpdate):
    """Extended Kalman filter (Bar-Shalom, Li & Kirubarajan 2001, ch. 10).

    Parameters
    ----------
    iterations : most linearisations of h per epoch. 1 is the plain filter; with more, the update
        is a Gauss–Newton search for the most probable state (Bell & Cathey 1993), whose steps are
        halved until the cost falls.
    noise_memory : number of measurements over which the measurement noise is estimated from the
        residuals, a variance for each component (Mohamed & Schwarz 1999, with the forgetting of
        Sage & Husa 1969); 0 keeps the given noise.
    """

    iterations: AtLeastOne = 1
    noise_memory: Annotated[int, Field(ge=0)] = 0

    name = "ekf"
    family = "kalman"

    def conflict(self) -> str | None:
        """Refuse a memory of one measurement, and gates of other updates than the plain one."""
        if self.noise_memory == 1:
            return "noise_memory must be 0 or at least 2, and is 1"
        if self.gate or self.underweighting:
            name = "gate" if self.gate else "underweighting"
            if self.iterations > 1:
                return f"{name} is of the plain update, and not with iterations = {self.iterations}"
            if self.noise_memory:
                return f"{name} needs the given noise, and not a noise_memory"
        return super().conflict()

    def skip(self, problem: Problem) -> str | None:
        """Refuse models without kernels where only the compiled filter has what is asked for."""
        if self.gate or self.underweighting or self.noise_memory:
            return super().skip(problem)
        return None

    def estimate_block(
        self, block: ProblemBlock, rngs: Sequence[np.random.Generator] = ()
    ) -> EstimateBlock:
        """Filter all runs of a block."""
        if self.iterations == 1 and self.loss == "none" and not self.noise_memory:
            return filters.extended(block, self.gate, self.underweighting)
        return iterated(block, self.iterations, self.loss, self.limit, self.noise_memory)

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        """Filter one run; of a model without kernels by :mod:`.textbook`."""
        if isinstance(problem.model, CompiledModel):
            return super().estimate(problem, rng)
        return textbook.extended(problem, self.iterations, self.loss, self.limit)
