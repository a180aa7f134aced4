"""The measurement model of all estimators, h and H: what is on board along an INS track."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from ..gravity.coloured_noise import Whitening
from ..gravity.field import DisturbanceMap, Field
from ..numerics.frozen import frozen, read_only
from ..numerics.records import fields_of
from .aiding import Motion
from .aiding_kernels import MOVED, Aiding
from .gradiometer.instrument import INSTRUMENTS, STRAPDOWN, Gradiometer, readings_along
from .gradiometer.lowpass import Prefilter
from .gradiometer.mounting import as_strapdown
from .model_arrays import ModelArrays
from .model_kernels import linearise, linearised, predict

NO_GRADIOMETER = Gradiometer(1.0, None, (), "local-level")
"""An instrument without channels."""


class Taken(NamedTuple):
    """Where an INS believes to have been when the readings of its epochs were taken.

    Attributes
    ----------
    delays : (K,) τ_k, by which they are older than their epochs [s].
    positions, attitudes : (..., K, 3), (..., K, 3, 3) as :class:`.aiding.Motion` has them, then.
    rows : (..., K, 6, 15) B_k: from x(t_k) to the position error [m] and the attitude error [rad]
        then.
    """

    delays: np.ndarray
    positions: np.ndarray
    attitudes: np.ndarray
    rows: np.ndarray


def model_arrays(
    field: Field,
    gradiometer: Gradiometer | None,
    times: np.ndarray,
    ins: Motion,
    taken: Taken,
    treatment: Prefilter,
    missing: np.ndarray,
    at: np.ndarray,
    others: tuple[Aiding, np.ndarray],
    dimension: int,
    bias: int,
    whitening: Whitening | None,
    mounting: int,
) -> ModelArrays:
    """Return the measurement model along an INS track, or along the tracks of a block of runs.

    Parameters
    ----------
    field, gradiometer : the map and the instrument, if there is one, as the estimators know them.
    times : (K,) measurement epochs [s].
    ins : what the INS indicates at the epochs (..., K, .); (...) is () or (R,).
    taken : what it indicates when readings are taken.
    treatment : the prefilter of the G outputs of the instrument.
    missing : (..., G) which of its readings dropped out.
    at : (G,) at which epochs the gradiometer is read.
    others : the channels of the other sensors, and their offset (..., K, e).
    dimension : number of states.
    bias : the first state that is a bias of the gradiometer; −1 for none.
    whitening : of the G readings, if their noise is coloured; they have no low-pass then, and come
        without delay.
    mounting : the first of three states that are the instrument's mounting angles; −1 for none.
    """
    if gradiometer is None:
        gradiometer = NO_GRADIOMETER
    aiding, offsets = others
    instrument, channels = INSTRUMENTS.index(gradiometer.instrument), gradiometer.channels
    epochs, then, rows = ins.positions.shape[:-1], times - taken.delays, taken.rows
    attitudes, delayed_attitudes = ins.attitudes, taken.attitudes
    if instrument != STRAPDOWN:  # no other reading depends on them
        attitudes = delayed_attitudes = np.broadcast_to(np.eye(3), (*epochs, 3, 3))

    def readings(positions: np.ndarray, times: np.ndarray, c_nb: np.ndarray) -> np.ndarray:
        some = positions[..., at, :], times[at], c_nb[..., at, :, :]
        return np.asarray(readings_along(instrument, *some, field) @ channels.T)

    gain, offset = np.zeros(epochs), np.zeros((*epochs, len(channels)))
    gain[..., at] = np.where(missing, 0.0, treatment.gain)
    if gradiometer.lowpass is not None:  # else h is what is read at the delayed place, no more
        predicted = gradiometer.lowpass.apply(readings(ins.positions, times, attitudes))
        predicted = np.where(missing[..., np.newaxis], 0.0, treatment.apply(predicted))
        at_reference = readings(taken.positions, then, delayed_attitudes)
        offset[..., at, :] = predicted - gain[..., at][..., np.newaxis] * at_reference
    if mounting >= 0:
        delayed_attitudes, rows = as_strapdown(
            instrument, taken.positions, then, delayed_attitudes, rows, mounting
        )
        instrument = STRAPDOWN
    arrays = ModelArrays(
        dimension,
        instrument,
        channels,
        *_combined(channels, whitening, at, len(times)),
        bias,
        field.origin,
        field.step,
        field.tensor_coefficients,
        then,
        taken.positions,
        delayed_attitudes,
        rows,
        np.concatenate([offset, offsets], axis=-1),
        gain,
        aiding,
    )
    found: ModelArrays = _unchangeable(arrays, read_only)
    return found


def _unchangeable(arrays: Any, kept: Callable[[np.ndarray], np.ndarray]) -> Any:
    """Return a record whose arrays cannot be written, as ``kept`` makes them; maps are not copied.

    Kernels of arrays that can be written would be compiled again.
    """
    changed: dict[str, Any] = {}
    for name, value in zip(arrays.__dataclass_fields__, fields_of(arrays), strict=True):
        if name in ("origin", "step", "coefficients"):
            changed[name] = read_only(value)
        elif isinstance(value, np.ndarray):
            changed[name] = _immutable(value) if value.dtype.kind == "i" else kept(value)
        elif isinstance(value, Aiding | DisturbanceMap):
            changed[name] = _unchangeable(value, kept)
    return replace(arrays, **changed)


def _combined(
    channels: np.ndarray, whitening: Whitening | None, at: np.ndarray, epochs: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return which readings h combines, and how: ``combined`` and ``lags`` of the arrays.

    Parameters
    ----------
    channels : (g, 6) of the instrument.
    whitening : of the G readings, None for white noise.
    at : (G,) at which of the epochs they are.
    epochs : number of epochs.
    """
    if whitening is None:
        return channels[np.newaxis, np.newaxis], np.zeros((1, 1), dtype=int)
    taps = whitening.weights.shape[1]
    lags = np.full((epochs, taps), -1)
    lags[:, 0] = 0
    combined = np.zeros((epochs, taps, *channels.shape))
    combined[at] = whitening.weights @ channels
    for tap in range(1, taps):
        used = np.flatnonzero(whitening.weights[:, tap].any(axis=(1, 2)))
        lags[at[used], tap] = at[used] - at[used - tap]
    return combined, lags


def without_aiding(field: Field, positions: np.ndarray) -> tuple[Aiding, np.ndarray]:
    """Return the channels of no sensor at INS positions (..., K, 3), and their offsets."""
    epochs, nowhere = positions.shape[:-1], np.zeros(0, dtype=np.int64)
    return Aiding(
        np.zeros((*epochs, 0, MOVED)), nowhere, nowhere, np.zeros((*epochs, 0, 3)),
        np.zeros((0, 3)), -1, positions, np.zeros((*epochs, 0)), field.disturbance_map,
    ), np.zeros((*epochs, 0))  # fmt: skip


def _immutable(indices: np.ndarray) -> np.ndarray:
    """Return a read-only copy of integers."""
    return np.frombuffer(indices.tobytes(), indices.dtype).reshape(indices.shape)


class SensorModel:
    """The measurement model of all estimators: h(k, x) and its Jacobian H(k, x).

    The gradiometer's channels come first: h(k, x) = ẑ_k + g_k [L(p̂_k − B_k x) − L(p̂_k) + b], where
    ẑ is the reading predicted along the INS track and passed through the same filter and prefilter
    as the instrument's output, p̂_k the INS position (and attitude) at t_k − τ_k, B_k x the error
    there, b the biases among the states, if there are any, and g_k the chain's gain. Without a
    filter this is L(p̂_k − B_k x) + b, where τ_k is the latency of the readings, if they have one.
    Coloured noise is whitened: h combines L at the last few readings, each at the INS position then
    less the position error of now, which hardly changes in a few seconds.
    Outside the map the field at its border is continued. The
    other channels are those of :class:`.Aiding`. Where a reading is missing, h and H are zero.

    ``evaluations`` counts the points at which h was taken, and the Jacobians: what an estimator
    asked of the map. A compiled engine takes the arrays instead and counts for itself.

    Parameters
    ----------
    arrays : of one run, from :func:`model_arrays`.
    """

    def __init__(self, arrays: ModelArrays) -> None:
        self.arrays: ModelArrays = _unchangeable(arrays, frozen)
        self._block = self.arrays.as_block()
        self._evaluations = 0

    @property
    def evaluations(self) -> int:
        """Number of states at which h was taken so far, and of Jacobians."""
        return self._evaluations

    def predict(self, k: int, x: np.ndarray) -> np.ndarray:
        """Return h (..., m) at epoch ``k`` for states x (..., n); any leading axes."""
        states = self._states(k, x)
        points = states.reshape(-1, states.shape[-1])
        self._evaluations += len(points)
        out = predict(self._block, k, points)
        return out.reshape(*states.shape[:-1], out.shape[-1])

    def jacobian(self, k: int, x: np.ndarray) -> np.ndarray:
        """Return H = ∂h/∂x (..., m, n) at epoch ``k`` for states x (..., n); any leading axes."""
        states = self._states(k, x)
        points = states.reshape(-1, states.shape[-1])
        self._evaluations += len(points)
        predicted = np.empty((len(points), self.arrays.offset.shape[-1]))
        out = np.empty((*predicted.shape, points.shape[-1]))
        linearise(self._block, k, points, predicted, out)
        return out.reshape(*states.shape[:-1], *out.shape[1:])

    def predict_along(self, at: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Return h (N, m) at epochs ``at`` (N,) for a state of each, x (N, n)."""
        return self._along(at, x)[0]

    def jacobian_along(self, at: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Return H (N, m, n) at epochs ``at`` (N,) for a state of each, x (N, n)."""
        return self._along(at, x)[1]

    def _along(self, at: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return h and H at epochs for a state of each, and count these."""
        epochs = np.ascontiguousarray(at, dtype=np.int64)
        self._states(int(epochs.min(initial=0)), x)
        states = self._states(int(epochs.max(initial=0)), x)
        if states.ndim != 2 or epochs.shape != states.shape[:1]:
            raise ValueError(
                f"there must be a state of each epoch: of epochs {epochs.shape} (N, n) are wanted,"
                f" and the states are {states.shape}"
            )
        self._evaluations += len(states)
        h, slopes = linearised(self._block, epochs, states)
        return h, slopes

    def _states(self, k: int, x: np.ndarray) -> np.ndarray:
        """Return states ready for the kernels, which check nothing."""
        states = np.ascontiguousarray(x, dtype=float)
        epochs, n = len(self.arrays.rows), self.arrays.dimension
        if not 0 <= k < epochs:
            raise IndexError(f"there is no epoch {k}; the problem has epochs 0 to {epochs - 1}")
        if states.ndim == 0 or states.shape[-1] != n:
            raise ValueError(f"states must be (..., {n}), not {states.shape}")
        return states
