"""dynamax (JAX): a problem as its parameters, its posterior as an estimate.

A filter of dynamax joins a campaign as a class of a few lines::

    @dataclass(frozen=True)
    class Mine(DynamaxEstimator):
        name = "dynamax-ekf"

        def posterior(self, parameters, emissions, inputs):
            return extended_kalman_filter(parameters, emissions, inputs=inputs)

It needs the extra ``dynamax``: ``pip install 'ggbench[dynamax]'``. To import it turns JAX to double
precision. h is the problem's own, called back from what JAX compiles, and its derivative is H: a
campaign compares what filters find, and not how fast they would be with an h of their own in JAX.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from importlib.metadata import version
from typing import Any

import numpy as np

from ..problem import Causality, Estimate, Estimator, Problem

try:
    import jax
    import jax.numpy as jnp
    from dynamax.nonlinear_gaussian_ssm import ParamsNLGSSM
except ImportError as error:
    raise ImportError(
        f"{__name__} needs dynamax ({error}): pip install 'ggbench[dynamax]'"
    ) from error

if version("dynamax").startswith(("0.", "1.0.0", "1.0.1", "1.0.2")):
    raise ImportError(
        f"{__name__} needs dynamax 1.0.3 or newer, not {version('dynamax')}, which takes the noise "
        "and the transition of a step from the epoch before: pip install 'ggbench[dynamax]'"
    )

jax.config.update("jax_enable_x64", True)

LIBRARIES = ("dynamax", "jax", "jaxlib")
"""Distributions whose version its results depend on."""
_SMALL = 1e-4
"""Units of states and readings, in deviations of prior and noise. dynamax adds 1e-9 to the diagonal
of what it inverts, which is to be negligible next to variances of 1e8."""


@dataclass(frozen=True)
class DynamaxEstimator(Estimator):
    """An estimator that is one of dynamax's inference functions for nonlinear Gaussian models.

    Derive from it, name it, and write :meth:`posterior`; for a smoother with
    ``causality = "batch"``. JAX compiles the function once in a process, for each shape of problem.
    """

    @property
    def causality(self) -> Causality:
        """Measurements up to each epoch."""
        return "filter"

    @abstractmethod
    def posterior(self, parameters: ParamsNLGSSM, emissions: Any, inputs: Any) -> Any:
        """Return dynamax's posterior, filtered or, of a ``batch`` estimator, smoothed.

        Parameters
        ----------
        parameters : of the problem in small units, with time-varying Q and R; the initial state is
            that of the first epoch.
        emissions : (K, m) readings.
        inputs : (K,) numbers of the epochs, which the functions of dynamics and emission take as
            their second argument.
        """

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        """Have dynamax find the posterior; nothing is drawn."""
        found = _Compiled.of(self)
        mean, cov = found(problem)
        return Estimate(mean, 0.5 * (cov + cov.transpose(0, 2, 1)), self.causality)


@dataclass
class _Compiled:
    """An estimator's posterior as JAX compiles it, for the model of the problem that is at hand."""

    estimator: DynamaxEstimator
    function: Callable[..., Any] = field(init=False)
    problem: Problem | None = None

    def __post_init__(self) -> None:
        self.function = jax.jit(self._posterior)

    @staticmethod
    @cache
    def of(estimator: DynamaxEstimator) -> _Compiled:
        """Return what an estimator compiles, one for all that are equal to it."""
        return _Compiled(estimator)

    def __call__(self, problem: Problem) -> tuple[np.ndarray, np.ndarray]:
        """Return mean (K, n) and covariance (K, n, n) of the estimator's posterior."""
        state, reading = _units(problem)
        noise_cov = np.broadcast_to(problem.noise_cov, (problem.epochs, len(reading), len(reading)))
        first, noise = problem.transition[0], problem.process_cov[0]
        squared = np.outer(state, state)
        self.problem = problem
        try:
            mean, cov = self.function(
                first @ problem.prior_mean / state,
                (first @ problem.prior_cov @ first.T + noise) / squared,
                problem.transition / state[:, np.newaxis] * state,
                problem.process_cov / squared,
                noise_cov / np.outer(reading, reading),
                problem.measurements / reading,
            )
            return np.asarray(mean) * state, np.asarray(cov) * squared
        finally:
            self.problem = None

    def _posterior(
        self,
        mean: Any,
        cov: Any,
        transition: Any,
        process_cov: Any,
        noise_cov: Any,
        measurements: Any,
    ) -> tuple[Any, Any]:
        """Return the posterior of arrays that JAX traces; h is called back."""
        epochs, m = measurements.shape
        parameters = ParamsNLGSSM(
            initial_mean=mean,
            initial_covariance=cov,
            dynamics_function=lambda x, k: transition[k] @ x,
            dynamics_covariance=process_cov,
            emission_function=self._emission(m, len(mean)),
            emission_covariance=noise_cov,
        )
        found = self.estimator.posterior(parameters, measurements, jnp.arange(epochs))
        if self.estimator.causality == "batch":
            return found.smoothed_means, found.smoothed_covariances
        return found.filtered_means, found.filtered_covariances

    def _emission(self, m: int, n: int) -> Callable[[Any, Any], Any]:
        """Return h of a state and an epoch's number for JAX, with H as its derivative."""

        @jax.custom_jvp
        def h(x: Any, k: Any) -> Any:
            shape = jax.ShapeDtypeStruct((m,), float)
            return jax.pure_callback(self._predict, shape, x, k, vmap_method="broadcast_all")

        def along(primals: tuple[Any, Any], tangents: tuple[Any, Any]) -> tuple[Any, Any]:
            shape = jax.ShapeDtypeStruct((m, n), float)
            rows = jax.pure_callback(self._jacobian, shape, *primals, vmap_method="broadcast_all")
            return h(*primals), rows @ tangents[0]

        h.defjvp(along)
        return h

    def _predict(self, x: Any, k: Any) -> np.ndarray:
        """Return h (..., m) in small units at states (..., n), all of one epoch."""
        problem, epoch = self._at(k)
        state, reading = _units(problem)
        return np.asarray(problem.model.predict(epoch, np.asarray(x) * state) / reading)

    def _jacobian(self, x: Any, k: Any) -> np.ndarray:
        """Return H (..., m, n) in small units at states (..., n), all of one epoch."""
        problem, epoch = self._at(k)
        state, reading = _units(problem)
        rows = problem.model.jacobian(epoch, np.asarray(x) * state)
        return np.asarray(rows * state / reading[:, np.newaxis])

    def _at(self, k: Any) -> tuple[Problem, int]:
        epochs = np.unique(np.asarray(k))
        if self.problem is None or len(epochs) != 1:
            raise ValueError(f"h is asked for one epoch of the problem at hand, not for {epochs}")
        return self.problem, int(epochs[0])


def _units(problem: Problem) -> tuple[np.ndarray, np.ndarray]:
    """Return the units of the states (n,) and of the readings (m,) in which dynamax works."""
    variances = np.diagonal(problem.noise_cov, axis1=-2, axis2=-1)
    variances = variances.reshape(-1, variances.shape[-1]).min(axis=0)
    return _SMALL * np.sqrt(np.diag(problem.prior_cov)), _SMALL * np.sqrt(variances)
