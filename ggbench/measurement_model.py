"""The measurement model of all estimators, h and H, compiled: the instrument along an INS track."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from .field import Field
from .gradiometer import (
    INSTRUMENTS,
    STRAPDOWN,
    Gradiometer,
    reading_at,
    reading_jacobian_at,
    readings_along,
)
from .ins_error import metres_per_radian
from .lowpass import Prefilter
from .problem import frozen
from .strapdown import product, rotation_matrix


@njit(cache=True)
def _displaced(reference: np.ndarray, east: float, north: float, up: float) -> np.ndarray:
    """Return reference − (east, north, up) [m] as (L, λ, h), linear as the error state is."""
    per_north, per_east = metres_per_radian(reference)
    return np.array(
        [reference[0] - north / per_north, reference[1] - east / per_east, reference[2] - up]
    )


@njit(cache=True)
def _errors(rows: np.ndarray, state: np.ndarray, out: np.ndarray) -> None:
    """Fill the position [m] and attitude [rad] errors (6,) = B x at t − τ."""
    for i in range(6):
        out[i] = 0.0
        for j in range(rows.shape[1]):
            out[i] += rows[i, j] * state[j]


@njit(cache=True)
def _corrected(
    instrument: int,
    state: np.ndarray,
    rows: np.ndarray,
    reference: np.ndarray,
    c_nb: np.ndarray,
    error: np.ndarray,
    true_c_nb: np.ndarray,
) -> np.ndarray:
    """Return the position that a state corrects the reference to; fill its error and C_nb.

    ``error`` (6,) is B x; ``true_c_nb`` (3, 3) changes for a strapdown instrument only.
    """
    _errors(rows, state, error)
    if instrument == STRAPDOWN:
        turn = np.empty((3, 3))
        rotation_matrix(error[3:], turn)
        product(turn, c_nb, true_c_nb)
    return _displaced(reference, error[0], error[1], error[2])


@njit(cache=True)
def _predict(
    instrument: int,
    states: np.ndarray,
    rows: np.ndarray,
    reference: np.ndarray,
    c_nb: np.ndarray,
    time: float,
    offset: np.ndarray,
    gain: float,
    channels: np.ndarray,
    bias: int,
    origin: np.ndarray,
    step: np.ndarray,
    coefficients: np.ndarray,
) -> np.ndarray:
    """Return h (N, m) of N states: offset + gain · (S reading(reference − B x) + b)."""
    out = np.empty((states.shape[0], channels.shape[0]))
    reading = np.empty(6)
    error = np.empty(6)
    true_c_nb = c_nb.copy()
    for n in range(states.shape[0]):
        position = _corrected(instrument, states[n], rows, reference, c_nb, error, true_c_nb)
        reading_at(instrument, position, time, true_c_nb, origin, step, coefficients, reading)
        for m in range(channels.shape[0]):
            value = 0.0
            for i in range(6):
                value += channels[m, i] * reading[i]
            if bias >= 0:
                value += states[n, bias + m]
            out[n, m] = offset[m] + gain * value
    return out


@njit(cache=True)
def _left_jacobian(vector: np.ndarray) -> np.ndarray:
    """Return J (3, 3) with exp([(v + δ)×]) = exp([(J δ)×]) exp([v×]) to first order in δ."""
    x, y, z = vector[0], vector[1], vector[2]
    angle2 = x * x + y * y + z * z
    if angle2 < 1e-8:
        a, b = 0.5 - angle2 / 24.0, 1.0 / 6.0 - angle2 / 120.0
    else:
        angle = math.sqrt(angle2)
        a = (1.0 - math.cos(angle)) / angle2
        b = (angle - math.sin(angle)) / (angle2 * angle)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    square = np.empty((3, 3))
    product(cross, cross, square)
    return np.eye(3) + a * cross + b * square


@njit(cache=True)
def _jacobian(
    instrument: int,
    state: np.ndarray,
    rows: np.ndarray,
    reference: np.ndarray,
    c_nb: np.ndarray,
    time: float,
    gain: float,
    channels: np.ndarray,
    bias: int,
    origin: np.ndarray,
    step: np.ndarray,
    coefficients: np.ndarray,
) -> np.ndarray:
    """Return H (m, n) of one state."""
    error = np.empty(6)
    true_c_nb = c_nb.copy()
    position = _corrected(instrument, state, rows, reference, c_nb, error, true_c_nb)
    slope = np.empty((6, 6))
    reading_jacobian_at(instrument, position, time, true_c_nb, origin, step, coefficients, slope)
    # The state's metres are measured at the reference, the slope's at the displaced point.
    reference_north, reference_east = metres_per_radian(reference)
    north, east = metres_per_radian(position)
    slope[:, 0] *= -east / reference_east
    slope[:, 1] *= -north / reference_north
    slope[:, 2] *= -1.0
    if instrument == STRAPDOWN:
        slope[:, 3:] = slope[:, 3:].copy() @ _left_jacobian(error[3:])
    out = np.zeros((channels.shape[0], state.shape[0]))
    for m in range(channels.shape[0]):
        for j in range(6):
            along = 0.0
            for i in range(6):
                along += channels[m, i] * slope[i, j]
            if along != 0.0:
                for i in range(rows.shape[1]):
                    out[m, i] += gain * along * rows[j, i]
        if bias >= 0:
            out[m, bias + m] += gain
    return out


class GradiometerModel:
    """The measurement model of all estimators: h(k, x) and its Jacobian H(k, x).

    h(k, x) = ẑ_k + g_k [L(p̂_k − B_k x) − L(p̂_k) + b], where ẑ is the reading predicted along the
    INS track and passed through the same filter and prefilter as the instrument's output, p̂_k the
    INS position (and attitude) at t_k − τ_k, B_k x the error there, b the biases among the states,
    if there are any, and g_k the chain's gain. Without a filter this is L(p_INS − δr) + b. Outside
    the map the field at its border is continued. Where a reading is missing, h and H are zero.

    Parameters
    ----------
    field, gradiometer : the map and the instrument, as the estimators know them.
    times : (K,) measurement epochs [s].
    positions : (K, 3) INS positions at the epochs [rad, rad, m].
    attitudes : (K, 3, 3) INS attitudes C_nb at the epochs.
    delayed_positions, delayed_attitudes : the same at t_k − τ_k.
    delays : (K,) τ_k [s].
    rows : (K, 6, 15) B_k: from x(t_k) to the position error [m] and the attitude error [rad] at
        t_k − τ_k.
    treatment : the prefilter of the instrument's output.
    missing : (K,) which readings dropped out; none if not given.
    """

    def __init__(
        self,
        field: Field,
        gradiometer: Gradiometer,
        times: np.ndarray,
        positions: np.ndarray,
        attitudes: np.ndarray,
        delayed_positions: np.ndarray,
        delayed_attitudes: np.ndarray,
        delays: np.ndarray,
        rows: np.ndarray,
        treatment: Prefilter,
        missing: np.ndarray | None = None,
    ) -> None:
        self._map = (field.origin, field.step, field.tensor_coefficients)
        self._instrument = INSTRUMENTS.index(gradiometer.instrument)
        self._channels = frozen(gradiometer.channels)
        self._references = frozen(delayed_positions)
        if self._instrument != STRAPDOWN:  # no other reading depends on them
            attitudes = delayed_attitudes = np.tile(np.eye(3), (len(times), 1, 1))
        self._attitudes = frozen(delayed_attitudes)
        self._times = frozen(times - delays)
        self._rows = frozen(rows)
        self._bias = rows.shape[-1] if gradiometer.biased else -1
        self._dimension = rows.shape[-1] + (len(self._channels) if gradiometer.biased else 0)
        present = np.ones(len(times)) if missing is None else np.where(missing, 0.0, 1.0)
        self._gain = frozen(treatment.gain * present)
        predicted = self._readings(positions, times, attitudes)
        if gradiometer.lowpass is not None:
            predicted = treatment.apply(gradiometer.lowpass.apply(predicted))
        at_reference = self._readings(self._references, self._times, self._attitudes)
        offset = present[:, None] * predicted - self._gain[:, None] * at_reference
        self._offset = frozen(offset)

    def _readings(
        self, positions: np.ndarray, times: np.ndarray, attitudes: np.ndarray
    ) -> np.ndarray:
        tensors = readings_along(
            self._instrument, positions, times, np.ascontiguousarray(attitudes), *self._map
        )
        return np.asarray(tensors @ self._channels.T)

    def predict(self, k: int, x: np.ndarray) -> np.ndarray:
        """Return h (..., m) [E] at epoch ``k`` for states x (..., n); any leading axes."""
        states = self._states(k, x)
        flat = states.reshape(-1, states.shape[-1])
        out = _predict(
            self._instrument, flat, self._rows[k], self._references[k], self._attitudes[k],
            self._times[k], self._offset[k], self._gain[k], self._channels, self._bias, *self._map,
        )  # fmt: skip
        return out.reshape(*states.shape[:-1], out.shape[-1])

    def jacobian(self, k: int, x: np.ndarray) -> np.ndarray:
        """Return H = ∂h/∂x (m, n) [E per unit of the state] at epoch ``k`` and state x (n,)."""
        state = self._states(k, x)
        if state.ndim != 1:
            raise ValueError(f"the Jacobian is taken at one state (n,), not at {state.shape}")
        return _jacobian(
            self._instrument, state, self._rows[k], self._references[k], self._attitudes[k],
            self._times[k], self._gain[k], self._channels, self._bias, *self._map,
        )  # fmt: skip

    def _states(self, k: int, x: np.ndarray) -> np.ndarray:
        """Return states ready for the kernels, which check nothing."""
        states = np.ascontiguousarray(x, dtype=float)
        epochs, n = len(self._rows), self._dimension
        if not 0 <= k < epochs:
            raise IndexError(f"there is no epoch {k}; the problem has epochs 0 to {epochs - 1}")
        if states.ndim == 0 or states.shape[-1] != n:
            raise ValueError(f"states must be (..., {n}), not {states.shape}")
        return states
