"""cuthbert (JAX): square-root extended Kalman filter and smoother.

Install the extra ``cuthbert``: ``pip install 'ggbench[cuthbert]'``. Code compiled by JAX calls the
measurement function h in Python (:mod:`.jax_callback`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from typing import Any, ClassVar

import numpy as np

from ..numerics.positive import ranked_root
from ..problem import Causality, Estimate, Estimator, Family, Problem

try:
    import jax
    from cuthbert import filter as run_filter
    from cuthbert import smoother as run_smoother
    from cuthbert.gaussian import moments

    from .jax_callback import MeasurementCallback
except ImportError as error:
    raise ImportError(
        f"{__name__} needs cuthbert ({error}): pip install 'ggbench[cuthbert]'"
    ) from error

LIBRARIES = ("cuthbert", "cuthbertlib", "jax", "jaxlib")
"""Distributions on whose versions the estimators' results depend."""


@dataclass(frozen=True)
class CuthbertEkf(Estimator):
    """Extended Kalman filter of cuthbert, in square-root form."""

    name = "cuthbert-ekf"
    family: ClassVar[Family] = "kalman"

    @property
    def causality(self) -> Causality:
        """Causality ``filter``: an estimate uses the measurements up to its epoch."""
        return "filter"

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        """Compute the posterior with cuthbert; no random numbers are used."""
        mean, cov = _Compiled.of(type(self))(problem)
        return Estimate(mean, cov, self.causality)


@dataclass(frozen=True)
class CuthbertSmoother(CuthbertEkf):
    """Extended Kalman smoother of cuthbert, linearised once along the filtered states."""

    name = "cuthbert-smoother"
    family: ClassVar[Family] = "smoother"

    @property
    def causality(self) -> Causality:
        """Causality ``batch``: every estimate uses all measurements."""
        return "batch"


@dataclass
class _Compiled:
    """Posterior of an estimator, compiled by JAX; h is that of the current problem."""

    smooths: bool
    measurement: MeasurementCallback = field(default_factory=MeasurementCallback)
    function: Callable[..., Any] = field(init=False)

    def __post_init__(self) -> None:
        self.function = jax.jit(self._posterior)

    @staticmethod
    @cache
    def of(kind: type[CuthbertEkf]) -> _Compiled:
        """Return the compiled posterior of a class, cached in the process."""
        return _Compiled(issubclass(kind, CuthbertSmoother))

    def __call__(self, problem: Problem) -> tuple[np.ndarray, np.ndarray]:
        """Return mean (K, n) and covariance (K, n, n), in units of the problem."""
        state, measurement = self.measurement.units(problem)
        roots = np.zeros(problem.transition.shape)
        for k, process_cov in enumerate(problem.process_cov / np.outer(state, state)):
            root, _ = ranked_root(process_cov)
            roots[k, :, : root.shape[1]] = root
        noise = problem.noise_cov / np.outer(measurement, measurement)
        m = len(measurement)
        inputs = (
            np.arange(problem.epochs),
            problem.transition / state[:, np.newaxis] * state,
            roots,
            np.broadcast_to(np.linalg.cholesky(noise), (problem.epochs, m, m)),
            problem.measurements / measurement,
        )
        prior = np.linalg.cholesky(problem.prior_cov / np.outer(state, state))
        with self.measurement.of(problem):
            mean, root = self.function(problem.prior_mean / state, prior, inputs)
            mean, root = np.asarray(mean)[1:] * state, np.asarray(root)[1:] * state[:, np.newaxis]
        return mean, root @ root.transpose(0, 2, 1)

    def _posterior(self, mean: Any, root: Any, inputs: Any) -> tuple[Any, Any]:
        """Return means and covariance roots at K + 1 epochs, of which the first is the prior.

        All arguments and results are arrays traced by JAX.
        """
        h = self.measurement.function(inputs[4].shape[1], len(mean))

        def dynamics(state: Any, arguments: Any) -> Any:
            _, transition, process_root, *_ = arguments
            return (lambda x: (transition @ x, process_root)), state.mean

        def observation(state: Any, arguments: Any) -> Any:
            k, _, _, noise_root, measured = arguments
            return (lambda x: (h(x, k), noise_root)), state.mean, measured

        kalman = moments.build_filter(mean, root, dynamics, observation)
        states = run_filter(kalman, inputs, kalman.init_prepare())
        if self.smooths:
            states = run_smoother(moments.build_smoother(dynamics), states)
        return states.mean, states.chol_cov
