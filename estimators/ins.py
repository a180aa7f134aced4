"""Inertial navigation without aiding."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..block import BlockEstimator, EstimateBlock, ProblemBlock
from ..problem import Estimate, Problem


@dataclass(frozen=True)
class InertialOnly(BlockEstimator):
    """Propagate the prior without a single measurement (the open-loop INS)."""

    name = "ins"
    family = "inertial"
    causality = "none"

    def skip(self, problem: Problem) -> str | None:
        """Return None: every problem is accepted, because h is not evaluated."""
        return None

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        """Return the propagated prior: x_k = Φ_k x_{k−1}, P_k = Φ_k P_{k−1} Φ_kᵀ + Q_k."""
        mean, cov = _propagated(
            problem.prior_mean, problem.prior_cov,
            problem.transition[np.newaxis], problem.process_cov[np.newaxis],
        )  # fmt: skip
        return Estimate(mean[0], cov[0], self.causality)

    def estimate_block(
        self, block: ProblemBlock, rngs: Sequence[np.random.Generator] = ()
    ) -> EstimateBlock:
        """Propagate the prior of all runs of a block."""
        mean, cov = _propagated(
            block.prior_mean, block.prior_cov, block.transition, block.process_cov
        )
        asked = np.zeros(block.runs, dtype=int)
        return EstimateBlock(mean, cov, self.causality, info={"map_evaluations": asked})


def _propagated(
    prior_mean: np.ndarray, prior_cov: np.ndarray, transition: np.ndarray, process_cov: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return mean (R, K, n) and cov (R, K, n, n) from Φ and Q (R, K, n, n)."""
    mean, cov = np.empty(transition.shape[:-1]), np.empty(transition.shape)
    x, p = prior_mean[np.newaxis, :, np.newaxis], prior_cov[np.newaxis]
    for k in range(transition.shape[1]):
        phi = transition[:, k]
        x = phi @ x
        p = phi @ p @ phi.transpose(0, 2, 1) + process_cov[:, k]
        mean[:, k], cov[:, k] = x[..., 0], p
    return mean, cov
