"""No aiding: the inertial navigation system alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..problem import Causality, Estimate, Estimator, Problem


@dataclass(frozen=True)
class InertialOnly(Estimator):
    """Propagate the prior without a single measurement (the open-loop INS)."""

    name = "ins"

    @property
    def causality(self) -> Causality:
        """No measurement is used."""
        return "none"

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        """Return x_k = Φ_k x_{k−1} and P_k = Φ_k P_{k−1} Φ_kᵀ + Q_k."""
        mean = np.empty((problem.epochs, problem.dimension))
        cov = np.empty((problem.epochs, problem.dimension, problem.dimension))
        x, p = problem.prior_mean, problem.prior_cov
        for k, (phi, q) in enumerate(zip(problem.transition, problem.process_cov, strict=True)):
            x = phi @ x
            p = phi @ p @ phi.T + q
            mean[k], cov[k] = x, p
        return Estimate(mean, cov, self.causality)
