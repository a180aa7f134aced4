"""Compiled oracle (a filter or smoother linearised at the truth) for blocks of runs."""

from __future__ import annotations

import numpy as np

from ..numerics.frozen import read_only
from ..numerics.kernels import compiled
from ..simulation.bound import Bound


def oracle_states(
    bound: Bound, residuals: np.ndarray, error_state: np.ndarray, transition: np.ndarray, lag: int
) -> np.ndarray:
    """Return the states (R, K, n) that the oracle estimates.

    The oracle has the gains of the bound. It processes the same measurements as the estimators, up
    to ``lag`` ticks after each epoch. With a lag of 0 it is a filter.

    Parameters
    ----------
    bound : bounds and gains of the flight.
    residuals : (R, K, m) measurements minus the measurement function h at the true states.
    error_state : (R, K, n) true states.
    transition : (R, K, n, n) transition matrices of each run.
    lag : lag [ticks].
    """
    states = np.empty(error_state.shape)
    _oracle(
        residuals=read_only(residuals),
        error_state=read_only(error_state),
        transition=read_only(transition),
        jacobians=read_only(bound.jacobians),
        gain=read_only(bound.gain),
        smoother_gain=read_only(bound.smoother_gain),
        last=bound.last_epochs(lag),
        states=states,
    )
    return states


@compiled
def _oracle(
    residuals: np.ndarray,
    error_state: np.ndarray,
    transition: np.ndarray,
    jacobians: np.ndarray,
    gain: np.ndarray,
    smoother_gain: np.ndarray,
    last: np.ndarray,
    states: np.ndarray,
) -> None:
    """Fill the oracle's states (R, K, n), which use the measurements up to epochs ``last`` (K,)."""
    runs, epochs, n = states.shape
    filtered, predicted = np.empty((epochs, n)), np.empty((epochs, n))
    innovation, change = np.empty(residuals.shape[2]), np.empty(n)
    for r in range(runs):
        x = np.zeros(n)
        for k in range(epochs):
            predicted[k] = 0.0
            _add_product(transition[r, k], x, predicted[k])
            for j in range(n):
                change[j] = error_state[r, k, j] - predicted[k, j]
            innovation[:] = residuals[r, k]
            _add_product(jacobians[k], change, innovation)
            x = filtered[k]
            x[:] = predicted[k]
            _add_product(gain[k], innovation, x)
        for k in range(epochs - 1, -1, -1):
            x, first = states[r, k], last[k] - 1
            x[:] = filtered[last[k]]
            if last[k] > k and last[k] == last[k + 1]:  # the following epoch is smoothed already
                x[:], first = states[r, k + 1], k
            for i in range(first, k - 1, -1):
                for j in range(n):
                    change[j] = x[j] - predicted[i + 1, j]
                x[:] = filtered[i]
                _add_product(smoother_gain[i], change, x)


@compiled
def _add_product(matrix: np.ndarray, vector: np.ndarray, out: np.ndarray) -> None:
    """Add the product of a matrix (m, n) and a vector (n,) to ``out`` (m,)."""
    for i in range(matrix.shape[0]):
        total = 0.0
        for j in range(matrix.shape[1]):
            total += matrix[i, j] * vector[j]
        out[i] += total
