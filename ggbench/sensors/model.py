"""The measurement model of all estimators, h and H: the instrument along an INS track."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..gravity.field import Field
from ..numerics.frozen import frozen, read_only
from .gradiometer.instrument import INSTRUMENTS, STRAPDOWN, Gradiometer, readings_along
from .gradiometer.lowpass import Prefilter
from .model_kernels import OF_A_RUN, ModelArrays, jacobian, predict


def model_arrays(
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
) -> ModelArrays:
    """Return the measurement model along an INS track, or along the tracks of a block of runs.

    Parameters
    ----------
    field, gradiometer : the map and the instrument, as the estimators know them.
    times : (K,) measurement epochs [s].
    positions : (..., K, 3) INS positions at the epochs [rad, rad, m]; (...) is () or (R,).
    attitudes : (..., K, 3, 3) INS attitudes C_nb at the epochs.
    delayed_positions, delayed_attitudes : the same at t_k − τ_k.
    delays : (K,) τ_k [s].
    rows : (..., K, 6, 15) B_k: from x(t_k) to the position error [m] and the attitude error [rad]
        at t_k − τ_k.
    treatment : the prefilter of the instrument's output.
    missing : (..., K) which readings dropped out; none if not given.
    """
    instrument = INSTRUMENTS.index(gradiometer.instrument)
    channels = gradiometer.channels
    if instrument != STRAPDOWN:  # no other reading depends on them
        attitudes = delayed_attitudes = np.broadcast_to(np.eye(3), (*positions.shape, 3))

    def readings(places: np.ndarray, at: np.ndarray, c_nb: np.ndarray) -> np.ndarray:
        tensors = readings_along(
            instrument,
            np.ascontiguousarray(places.reshape(-1, 3)),
            np.ascontiguousarray(np.broadcast_to(at, places.shape[:-1]).reshape(-1)),
            np.ascontiguousarray(c_nb.reshape(-1, 3, 3)),
            field.origin, field.step, field.tensor_coefficients,
        )  # fmt: skip
        return np.asarray((tensors @ channels.T).reshape(*places.shape[:-1], -1))

    gain = np.broadcast_to(treatment.gain, positions.shape[:-1])
    predicted = readings(positions, times, attitudes)
    if gradiometer.lowpass is not None:
        predicted = treatment.apply(gradiometer.lowpass.apply(predicted))
    if missing is not None:
        gain = np.where(missing, 0.0, gain)
        predicted = np.where(missing[..., np.newaxis], 0.0, predicted)
    at_reference = readings(delayed_positions, times - delays, delayed_attitudes)
    offset = predicted - gain[..., np.newaxis] * at_reference
    return ModelArrays(
        instrument,
        read_only(channels),
        rows.shape[-1] if gradiometer.biased else -1,
        field.origin,
        field.step,
        field.tensor_coefficients,
        *map(read_only, (times - delays, delayed_positions, delayed_attitudes, rows, offset, gain)),
    )


class GradiometerModel:
    """The measurement model of all estimators: h(k, x) and its Jacobian H(k, x).

    h(k, x) = ẑ_k + g_k [L(p̂_k − B_k x) − L(p̂_k) + b], where ẑ is the reading predicted along the
    INS track and passed through the same filter and prefilter as the instrument's output, p̂_k the
    INS position (and attitude) at t_k − τ_k, B_k x the error there, b the biases among the states,
    if there are any, and g_k the chain's gain. Without a filter this is L(p_INS − δr) + b. Outside
    the map the field at its border is continued. Where a reading is missing, h and H are zero.

    ``evaluations`` counts the points at which h was taken, and the Jacobians: what an estimator
    asked of the map. A compiled engine takes the arrays instead and counts for itself.

    Parameters
    ----------
    arrays : of one run, from :func:`model_arrays`.
    """

    def __init__(self, arrays: ModelArrays) -> None:
        own: dict[str, Any] = {
            name: frozen(getattr(arrays, name)) for name in ("channels", "times", *OF_A_RUN)
        }
        self.arrays = arrays._replace(**own)
        self._block = self.arrays.as_block()
        self._evaluations = 0

    @property
    def evaluations(self) -> int:
        """Number of states at which h was taken so far, and of Jacobians."""
        return self._evaluations

    def predict(self, k: int, x: np.ndarray) -> np.ndarray:
        """Return h (..., m) [E] at epoch ``k`` for states x (..., n); any leading axes."""
        states = self._states(k, x)
        points = states.reshape(-1, states.shape[-1])
        self._evaluations += len(points)
        out = predict(self._block, k, points)
        return out.reshape(*states.shape[:-1], out.shape[-1])

    def jacobian(self, k: int, x: np.ndarray) -> np.ndarray:
        """Return H = ∂h/∂x (m, n) [E per unit of the state] at epoch ``k`` and state x (n,)."""
        state = self._states(k, x)
        if state.ndim != 1:
            raise ValueError(f"the Jacobian is taken at one state (n,), not at {state.shape}")
        self._evaluations += 1
        return jacobian(self._block, k, state)

    def _states(self, k: int, x: np.ndarray) -> np.ndarray:
        """Return states ready for the kernels, which check nothing."""
        states = np.ascontiguousarray(x, dtype=float)
        epochs, n = len(self.arrays.rows), self.arrays.dimension
        if not 0 <= k < epochs:
            raise IndexError(f"there is no epoch {k}; the problem has epochs 0 to {epochs - 1}")
        if states.ndim == 0 or states.shape[-1] != n:
            raise ValueError(f"states must be (..., {n}), not {states.shape}")
        return states
