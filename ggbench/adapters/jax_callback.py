"""Measurement function h as a JAX function by callback, with the Jacobian H as derivative."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from typing import Any

import jax
import numpy as np

from ..problem import Problem

jax.config.update("jax_enable_x64", True)

LIBRARIES = ("jax", "jaxlib")
"""Distributions on whose versions the results depend."""


def measurement_function(problem: Problem) -> Callable[[Any, Any], Any]:
    """Return a problem's h(x, k) as a JAX function to trace, batch and differentiate.

    ``h = measurement_function(problem)``; ``jax.jacfwd(h)(x, k)`` is H.

    Parameters
    ----------
    problem : problem whose model evaluates h and H.

    Returns
    -------
    A function of a state x (n,) in SI units and an epoch index k. It returns the predicted
    measurements (m,), and its forward derivative is H. ``jax.vmap`` over x, k or both is allowed;
    reverse differentiation (``jax.grad``) is not.
    """
    callback = MeasurementCallback(unit=None, problem=problem)
    return callback.function(problem.measurements.shape[1], problem.dimension)


class MeasurementCallback:
    """Measurement function of the current problem, in scaled units.

    Parameters
    ----------
    unit : factor that defines the scales. It multiplies the prior standard deviations of the states
        and the least noise standard deviations of the measurements. If it is None, nothing is
        scaled.
    problem : current problem. If it is None, ``with callback.of(problem)`` sets it.
    """

    def __init__(self, unit: float | None = 1.0, problem: Problem | None = None) -> None:
        self._unit = unit
        self._problem = problem

    @contextlib.contextmanager
    def of(self, problem: Problem) -> Iterator[None]:
        """Return a context in which ``problem`` is the current problem."""
        self._problem = problem
        try:
            yield
        finally:
            self._problem = None

    def units(self, problem: Problem) -> tuple[np.ndarray, np.ndarray]:
        """Return the scales of the states (n,) and of the measurements (m,)."""
        if self._unit is None:
            return np.ones(problem.dimension), np.ones(problem.measurements.shape[1])
        variances = np.diagonal(problem.noise_cov, axis1=-2, axis2=-1)
        variances = variances.reshape(-1, variances.shape[-1]).min(axis=0)
        return self._unit * np.sqrt(np.diag(problem.prior_cov)), self._unit * np.sqrt(variances)

    def function(self, m: int, n: int) -> Callable[[Any, Any], Any]:
        """Return h for JAX: a function of a state (n,) and an epoch index, with result (m,)."""

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
        """Return h (..., m) in scaled units at scaled states (..., n) and epochs (...)."""
        problem = self._at_hand()
        state, measurement = self.units(problem)
        predicted = _by_epoch(problem.model.predict, np.asarray(x) * state, k)
        return np.asarray(predicted / measurement)

    def _jacobian(self, x: Any, k: Any) -> np.ndarray:
        """Return H (..., m, n) in scaled units at scaled states (..., n) and epochs (...)."""
        problem = self._at_hand()
        state, measurement = self.units(problem)
        rows = _by_epoch(problem.model.jacobian, np.asarray(x) * state, k)
        return np.asarray(rows * state / measurement[:, np.newaxis])

    def _at_hand(self) -> Problem:
        if self._problem is None:
            raise ValueError("h is called outside of the context of a problem")
        return self._problem


def _by_epoch(evaluate: Callable[[int, np.ndarray], Any], x: np.ndarray, k: Any) -> np.ndarray:
    """Return values of a model at states (..., n), with one evaluation for each epoch."""
    epochs = np.broadcast_to(np.asarray(k), x.shape[:-1])
    values = None
    for epoch in np.unique(epochs):
        chosen = epochs == epoch
        evaluated = np.asarray(evaluate(int(epoch), x[chosen]))
        if values is None:
            values = np.empty((*epochs.shape, *evaluated.shape[1:]))
        values[chosen] = evaluated
    assert values is not None
    return values
