"""bayesfilter (NumPy): extended and unscented Kalman filters.

Install the extra ``bayesfilter``: ``pip install 'ggbench[bayesfilter]'``. A filter of bayesfilter
has one motion model, so this module makes a new filter at each epoch.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ..problem import Causality, Estimate, Estimator, Family, Problem

try:
    from bayesfilter.distributions import Gaussian
    from bayesfilter.filtering import BayesianFilter
    from bayesfilter.model import StateTransitionModel
    from bayesfilter.observation import Observation
except ImportError as error:
    raise ImportError(
        f"{__name__} needs bayesfilter ({error}): pip install 'ggbench[bayesfilter]'"
    ) from error

LIBRARIES = ("bayesfilter",)
"""Distributions on whose versions the estimators' results depend."""


@dataclass(frozen=True)
class BayesfilterEkf(Estimator):
    """Extended Kalman filter of bayesfilter, with states scaled by their prior σ."""

    linearised: ClassVar[bool] = True

    name = "bayesfilter-ekf"
    family: ClassVar[Family] = "kalman"

    @property
    def causality(self) -> Causality:
        """Causality ``filter``: an estimate uses the measurements up to its epoch."""
        return "filter"

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        """Predict and update at every epoch; no random numbers are used."""
        unit = np.sqrt(np.diag(problem.prior_cov))
        squared = np.outer(unit, unit)
        state = Gaussian(problem.prior_mean / unit, problem.prior_cov / squared)
        means, covs = np.empty((problem.epochs, len(unit))), np.empty(problem.transition.shape)
        for k in range(problem.epochs):
            phi = problem.transition[k] / unit[:, np.newaxis] * unit
            motion = StateTransitionModel(
                lambda x, dt, phi=phi: phi @ x,
                problem.process_cov[k] / squared,
                lambda x, dt, phi=phi: phi,
            )
            reading = Observation(
                problem.measurements[k],
                problem.noise_of(k),
                lambda x, k=k: problem.model.predict(k, x * unit),
                lambda x, k=k: problem.model.jacobian(k, x * unit) * unit,
            )
            kalman = BayesianFilter(motion, state)
            state = kalman.predict(state, 1.0, use_jacobian=self.linearised)
            state = kalman.update(reading, state, use_jacobian=self.linearised)
            cov = state.covariance()
            means[k], covs[k] = state.mean() * unit, 0.5 * (cov + cov.T) * squared
        return Estimate(means, covs, self.causality)


@dataclass(frozen=True)
class BayesfilterUkf(BayesfilterEkf):
    """Unscented Kalman filter of bayesfilter, with the sigma points of that package."""

    linearised: ClassVar[bool] = False

    name = "bayesfilter-ukf"
    family: ClassVar[Family] = "sigma-point"
