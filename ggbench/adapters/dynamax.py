"""dynamax (JAX): extended and unscented Kalman filters, extended Kalman smoother.

A class of a few lines adds a filter of dynamax to campaigns::

    @dataclass(frozen=True)
    class Mine(DynamaxEstimator):
        name = "dynamax-ekf"

        def posterior(self, parameters, emissions, inputs):
            return extended_kalman_filter(parameters, emissions, inputs=inputs)

Install the extra ``dynamax``: ``pip install 'ggbench[dynamax]'``. Importing this module sets JAX to
double precision. Code compiled by JAX calls the problem's h and H in Python. A campaign therefore
compares the accuracy of the filters, not the speed that they would have with an h written in JAX.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from importlib.metadata import version
from typing import Any, ClassVar

import numpy as np

from ..problem import Causality, Estimate, Estimator, Family, Problem

try:
    import jax
    import jax.numpy as jnp
    from dynamax.nonlinear_gaussian_ssm import (
        ParamsNLGSSM,
        UKFHyperParams,
        extended_kalman_filter,
        extended_kalman_smoother,
        unscented_kalman_filter,
    )

    from .jax_callback import MeasurementCallback
except ImportError as error:
    raise ImportError(
        f"{__name__} needs dynamax ({error}): pip install 'ggbench[dynamax]'"
    ) from error

if version("dynamax").startswith(("0.", "1.0.0", "1.0.1", "1.0.2")):
    raise ImportError(
        f"{__name__} needs dynamax 1.0.3 or newer, not {version('dynamax')}: pip install "
        "'ggbench[dynamax]'. Earlier versions use the transition and the noise of a wrong epoch"
    )

jax.config.update("jax_enable_x64", True)

LIBRARIES = ("dynamax", "jax", "jaxlib")
"""Distributions on whose versions the estimators' results depend."""
_SMALL = 1e-4
"""Units of states and measurements, in standard deviations of prior and noise.

dynamax adds 1e-9 to the diagonal of inverted matrices. In these units the variances are about 1e8,
so that 1e-9 is negligible.
"""


@dataclass(frozen=True)
class DynamaxEstimator(Estimator):
    """Base of estimators that call dynamax's inference for nonlinear Gaussian models.

    A derived class defines ``name`` and :meth:`posterior`; a smoother also sets ``causality =
    "batch"``. JAX compiles :meth:`posterior` once per process and array shape.
    """

    @property
    def causality(self) -> Causality:
        """Causality ``filter``: an estimate uses the measurements up to its epoch."""
        return "filter"

    @abstractmethod
    def posterior(self, parameters: ParamsNLGSSM, emissions: Any, inputs: Any) -> Any:
        """Return dynamax's filtered posterior, or its smoothed one for a ``batch`` estimator.

        Parameters
        ----------
        parameters : dynamax's parameters of the scaled problem, with time-varying Q and R; the
            initial state is the prior at the first epoch.
        emissions : (K, m) scaled measurements.
        inputs : (K,) epoch indices, second argument of the dynamics and emission functions.
        """

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        """Compute the posterior with dynamax; no random numbers are used."""
        compiled = _Compiled.of(self)
        mean, cov = compiled(problem)
        return Estimate(mean, 0.5 * (cov + cov.transpose(0, 2, 1)), self.causality)


@dataclass
class _Compiled:
    """Posterior of an estimator, compiled by JAX; h is that of the current problem."""

    estimator: DynamaxEstimator
    function: Callable[..., Any] = field(init=False)
    measurement: MeasurementCallback = field(default_factory=lambda: MeasurementCallback(_SMALL))

    def __post_init__(self) -> None:
        self.function = jax.jit(self._posterior)

    @staticmethod
    @cache
    def of(estimator: DynamaxEstimator) -> _Compiled:
        """Return the compiled posterior of an estimator; equal estimators share it."""
        return _Compiled(estimator)

    def __call__(self, problem: Problem) -> tuple[np.ndarray, np.ndarray]:
        """Return mean (K, n) and covariance (K, n, n) of the estimator's posterior."""
        state, reading = self.measurement.units(problem)
        noise_cov = np.broadcast_to(problem.noise_cov, (problem.epochs, len(reading), len(reading)))
        first, noise = problem.transition[0], problem.process_cov[0]
        squared = np.outer(state, state)
        with self.measurement.of(problem):
            mean, cov = self.function(
                first @ problem.prior_mean / state,
                (first @ problem.prior_cov @ first.T + noise) / squared,
                problem.transition / state[:, np.newaxis] * state,
                problem.process_cov / squared,
                noise_cov / np.outer(reading, reading),
                problem.measurements / reading,
            )
            return np.asarray(mean) * state, np.asarray(cov) * squared

    def _posterior(
        self,
        mean: Any,
        cov: Any,
        transition: Any,
        process_cov: Any,
        noise_cov: Any,
        measurements: Any,
    ) -> tuple[Any, Any]:
        """Return means and covariances from arrays traced by JAX; h is called in Python."""
        epochs, m = measurements.shape
        parameters = ParamsNLGSSM(
            initial_mean=mean,
            initial_covariance=cov,
            dynamics_function=lambda x, k: transition[k] @ x,
            dynamics_covariance=process_cov,
            emission_function=self.measurement.function(m, len(mean)),
            emission_covariance=noise_cov,
        )
        posterior = self.estimator.posterior(parameters, measurements, jnp.arange(epochs))
        if self.estimator.causality == "batch":
            return posterior.smoothed_means, posterior.smoothed_covariances
        return posterior.filtered_means, posterior.filtered_covariances


@dataclass(frozen=True)
class DynamaxEkf(DynamaxEstimator):
    """Extended Kalman filter of dynamax."""

    name = "dynamax-ekf"
    family: ClassVar[Family] = "kalman"

    def posterior(self, parameters: ParamsNLGSSM, emissions: Any, inputs: Any) -> Any:
        """Return the filtered posterior."""
        return extended_kalman_filter(parameters, emissions, inputs=inputs)


@dataclass(frozen=True)
class DynamaxUkf(DynamaxEstimator):
    """Unscented Kalman filter of dynamax, with the sigma points of the estimator ``ukf``."""

    name = "dynamax-ukf"
    family: ClassVar[Family] = "sigma-point"

    def posterior(self, parameters: ParamsNLGSSM, emissions: Any, inputs: Any) -> Any:
        """Return the filtered posterior."""
        points = UKFHyperParams(alpha=1.0, beta=0.0, kappa=3.0 - len(parameters.initial_mean))
        return unscented_kalman_filter(parameters, emissions, points, inputs=inputs)


@dataclass(frozen=True)
class DynamaxSmoother(DynamaxEstimator):
    """Extended Kalman smoother of dynamax, linearised once along the filtered states."""

    name = "dynamax-smoother"
    family: ClassVar[Family] = "smoother"
    causality = "batch"

    def posterior(self, parameters: ParamsNLGSSM, emissions: Any, inputs: Any) -> Any:
        """Return the smoothed posterior."""
        return extended_kalman_smoother(parameters, emissions, inputs=inputs)
