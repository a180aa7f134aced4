"""kalbee (NumPy): extended and cubature Kalman filters.

Install the extra ``kalbee``: ``pip install 'ggbench[kalbee]'``. Before each step the filter
receives Q, R and, for the extended filter, the Jacobians of the epoch.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from ..problem import Causality, Estimate, Estimator, Family, Problem

try:
    from kalbee.modules.filters.ckf_filter import CubatureKalmanFilter
    from kalbee.modules.filters.ekf_filter import ExtendedKalmanFilter
except ImportError as error:
    raise ImportError(
        f"{__name__} needs kalbee ({error}): pip install 'ggbench[kalbee]'"
    ) from error

LIBRARIES = ("kalbee",)
"""Distributions on whose versions the estimators' results depend."""


@dataclass(frozen=True)
class KalbeeEstimator(Estimator):
    """Base of kalbee's filters, with states scaled by their prior σ."""

    @property
    def causality(self) -> Causality:
        """Causality ``filter``: an estimate uses the measurements up to its epoch."""
        return "filter"

    @abstractmethod
    def filter(self, **arguments: Any) -> Any:
        """Return a kalbee filter made with ``arguments``, which all kalbee filters accept."""

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        """Predict and update at every epoch; no random numbers are used."""
        unit = np.sqrt(np.diag(problem.prior_cov))
        squared, k = np.outer(unit, unit), 0

        def transition(x: np.ndarray, dt: float) -> np.ndarray:
            return np.asarray((problem.transition[k] / unit[:, np.newaxis] * unit) @ x)

        def measurement(x: np.ndarray) -> np.ndarray:
            return problem.model.predict(k, x[:, 0] * unit)[:, np.newaxis]

        kalman = self.filter(
            state=(problem.prior_mean / unit)[:, np.newaxis],
            covariance=problem.prior_cov / squared,
            transition_covariance=problem.process_cov[0] / squared,
            measurement_covariance=problem.noise_of(0),
            transition_function=transition,
            measurement_function=measurement,
        )
        means, covs = np.empty((problem.epochs, len(unit))), np.empty(problem.transition.shape)
        for k in range(problem.epochs):  # the functions above read it
            kalman.transition_covariance = problem.process_cov[k] / squared
            kalman.measurement_covariance = problem.noise_of(k)
            self.step(kalman, problem, k, unit)
            means[k], covs[k] = kalman.state[:, 0] * unit, kalman.covariance * squared
        return Estimate(means, covs, self.causality)

    def step(self, kalman: Any, problem: Problem, k: int, unit: np.ndarray) -> None:
        """Predict to epoch ``k`` and update; ``unit`` (n,) has the scales of the states."""
        kalman.predict(1.0)
        kalman.update(problem.measurements[k][:, np.newaxis])


@dataclass(frozen=True)
class KalbeeEkf(KalbeeEstimator):
    """Extended Kalman filter of kalbee."""

    name = "kalbee-ekf"
    family: ClassVar[Family] = "kalman"

    def filter(self, **arguments: Any) -> Any:
        """Return the kalbee filter."""
        return ExtendedKalmanFilter(**arguments)

    def step(self, kalman: Any, problem: Problem, k: int, unit: np.ndarray) -> None:
        """Predict to epoch ``k`` and update with Φ_k and H_k; ``unit`` (n,) scales the states."""
        kalman.predict(1.0, F=problem.transition[k] / unit[:, np.newaxis] * unit)
        rows = problem.model.jacobian(k, kalman.state[:, 0] * unit) * unit
        kalman.update(problem.measurements[k][:, np.newaxis], H=rows)


@dataclass(frozen=True)
class KalbeeCkf(KalbeeEstimator):
    """Cubature Kalman filter of kalbee."""

    name = "kalbee-ckf"
    family: ClassVar[Family] = "sigma-point"

    def filter(self, **arguments: Any) -> Any:
        """Return the kalbee filter."""
        return CubatureKalmanFilter(**arguments)
