"""h of a problem as a function that JAX compiles: called back, with H as its derivative."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from typing import Any

import jax
import numpy as np

from ..problem import Problem

jax.config.update("jax_enable_x64", True)

LIBRARIES = ("jax", "jaxlib")
"""Distributions whose version results depend on."""


class MeasurementCallback:
    """The measurement function of the problem at hand, in small units.

    Parameters
    ----------
    unit : units of states and measurements, in deviations of prior and noise.
    """

    def __init__(self, unit: float = 1.0) -> None:
        self._unit = unit
        self._problem: Problem | None = None

    @contextlib.contextmanager
    def of(self, problem: Problem) -> Iterator[None]:
        """Call back the model of a problem while the context lasts."""
        self._problem = problem
        try:
            yield
        finally:
            self._problem = None

    def units(self, problem: Problem) -> tuple[np.ndarray, np.ndarray]:
        """Return the units of the states (n,) and of the measurements (m,)."""
        variances = np.diagonal(problem.noise_cov, axis1=-2, axis2=-1)
        variances = variances.reshape(-1, variances.shape[-1]).min(axis=0)
        return self._unit * np.sqrt(np.diag(problem.prior_cov)), self._unit * np.sqrt(variances)

    def function(self, m: int, n: int) -> Callable[[Any, Any], Any]:
        """Return h of a state (n,) and the number of an epoch, (m,), for JAX."""

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
        state, measurement = self.units(problem)
        return np.asarray(problem.model.predict(epoch, np.asarray(x) * state) / measurement)

    def _jacobian(self, x: Any, k: Any) -> np.ndarray:
        """Return H (..., m, n) in small units at states (..., n), all of one epoch."""
        problem, epoch = self._at(k)
        state, measurement = self.units(problem)
        rows = problem.model.jacobian(epoch, np.asarray(x) * state)
        return np.asarray(rows * state / measurement[:, np.newaxis])

    def _at(self, k: Any) -> tuple[Problem, int]:
        epochs = np.unique(np.asarray(k))
        if self._problem is None or len(epochs) != 1:
            raise ValueError(f"h is asked for one epoch of the problem at hand, not for {epochs}")
        return self._problem, int(epochs[0])
