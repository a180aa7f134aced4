"""The measurement model of all estimators, h and H: what is on board along an INS track."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..gravity.coloured_noise import Whitening
from ..gravity.field import DisturbanceMap, Field
from ..numerics.frozen import frozen, read_only
from ..numerics.records import fields_of
from . import aiding_kernels
from .aiding_kernels import Aiding
from .gradiometer.instrument import INSTRUMENTS, STRAPDOWN, Gradiometer, readings_along
from .gradiometer.lowpass import Prefilter
from .gradiometer.mounting import as_strapdown
from .model_arrays import ModelArrays
from .model_kernels import linearise, linearised, predict

NO_GRADIOMETER = Gradiometer(1.0, None, (), "local-level")
"""An instrument without channels."""


def model_arrays(
    field: Field,
    gradiometer: Gradiometer | None,
    times: np.ndarray,
    positions: np.ndarray,
    attitudes: np.ndarray,
    delayed_positions: np.ndarray,
    delayed_attitudes: np.ndarray,
    delays: np.ndarray,
    rows: np.ndarray,
    treatment: Prefilter,
    missing: np.ndarray | None = None,
    at: np.ndarray | None = None,
    others: tuple[Aiding, np.ndarray] | None = None,
    dimension: int | None = None,
    bias: int | None = None,
    whitening: Whitening | None = None,
    mounting: int = -1,
) -> ModelArrays:
    """Return the measurement model along an INS track, or along the tracks of a block of runs.

    Parameters
    ----------
    field, gradiometer : the map and the instrument, if there is one, as the estimators know them.
    times : (K,) measurement epochs [s].
    positions : (..., K, 3) INS positions at the epochs [rad, rad, m]; (...) is () or (R,).
    attitudes : (..., K, 3, 3) INS attitudes C_nb at the epochs.
    delayed_positions, delayed_attitudes : the same at t_k − τ_k.
    delays : (K,) τ_k [s].
    rows : (..., K, 6, 15) B_k: from x(t_k) to the position error [m] and the attitude error [rad]
        at t_k − τ_k.
    treatment : the prefilter of the G outputs of the instrument.
    missing : (..., G) which of its readings dropped out; none if not given.
    at : (G,) at which epochs the gradiometer is read; at all of them if not given.
    others : the channels of the other sensors, and their offset (..., K, e); none if not given.
    dimension : number of states; if not given, those of ``rows`` and the gradiometer's biases.
    bias : the first state that is one of them, −1 for none; if not given, that behind ``rows``.
    whitening : of the G readings, if their noise is coloured; they have no low-pass then, and come
        without delay.
    mounting : the first of three states that are the instrument's mounting angles; −1 for none.
    """
    if others is None:
        others = without_aiding(field, positions)
    aiding, offsets = others
    if gradiometer is None:
        gradiometer, at = NO_GRADIOMETER, np.zeros(0, dtype=int)
    if at is None:
        at = np.arange(len(times))
    instrument = INSTRUMENTS.index(gradiometer.instrument)
    channels = gradiometer.channels
    if instrument != STRAPDOWN:  # no other reading depends on them
        attitudes = delayed_attitudes = np.broadcast_to(np.eye(3), (*positions.shape, 3))

    def readings(places: np.ndarray, at: np.ndarray, c_nb: np.ndarray) -> np.ndarray:
        return np.asarray(readings_along(instrument, places, at, c_nb, field) @ channels.T)

    gain = np.broadcast_to(treatment.gain, (*positions.shape[:-2], len(at)))
    if missing is not None:
        gain = np.where(missing, 0.0, gain)
    offset = np.zeros((*gain.shape, len(channels)))
    if gradiometer.lowpass is not None:  # else h is what is read at the delayed place, no more
        predicted = readings(positions[..., at, :], times[at], attitudes[..., at, :, :])
        predicted = treatment.apply(gradiometer.lowpass.apply(predicted))
        if missing is not None:
            predicted = np.where(missing[..., np.newaxis], 0.0, predicted)
        at_reference = readings(
            delayed_positions[..., at, :], (times - delays)[at], delayed_attitudes[..., at, :, :]
        )
        offset = predicted - gain[..., np.newaxis] * at_reference
    if len(at) < len(times):
        read_offset, read_gain = offset, gain
        offset, gain = (
            np.zeros((*positions.shape[:-1], len(channels))),
            np.zeros(positions.shape[:-1]),
        )
        offset[..., at, :], gain[..., at] = read_offset, read_gain
    if bias is None:
        bias = rows.shape[-1] if gradiometer.biased else -1
    if dimension is None:
        dimension = rows.shape[-1] + (len(channels) if gradiometer.biased else 0)
    if mounting >= 0:
        delayed_attitudes, rows = as_strapdown(
            instrument, delayed_positions, times - delays, delayed_attitudes, rows, mounting
        )
        instrument = STRAPDOWN
    return ModelArrays(
        dimension,
        instrument,
        read_only(channels),
        *_combined(channels, whitening, at, len(times)),
        bias,
        field.origin,
        field.step,
        field.tensor_coefficients,
        read_only(times - delays),
        read_only(delayed_positions),
        read_only(delayed_attitudes),
        read_only(rows),
        read_only(np.concatenate([offset, offsets], axis=-1)),
        read_only(gain),
        replace(
            aiding,
            rows=read_only(aiding.rows),
            bias=_immutable(aiding.bias),
            arm=_immutable(aiding.arm),
            by_arm=read_only(aiding.by_arm),
            gravity=read_only(aiding.gravity),
            places=read_only(aiding.places),
            present=read_only(aiding.present),
        ),
    )


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
        return read_only(channels[np.newaxis, np.newaxis]), _immutable(np.zeros((1, 1), dtype=int))
    taps = whitening.weights.shape[1]
    lags = np.full((epochs, taps), -1)
    lags[:, 0] = 0
    combined = np.zeros((epochs, taps, *channels.shape))
    combined[at] = whitening.weights @ channels
    for tap in range(1, taps):
        used = np.flatnonzero(whitening.weights[:, tap].any(axis=(1, 2)))
        lags[at[used], tap] = at[used] - at[used - tap]
    return read_only(combined), _immutable(lags)


def without_aiding(field: Field, positions: np.ndarray) -> tuple[Aiding, np.ndarray]:
    """Return the channels of no sensor at INS positions (..., K, 3), and their offsets."""
    epochs, nowhere = positions.shape[:-1], np.zeros(0, dtype=np.int64)
    return Aiding(
        np.zeros((*epochs, 0, aiding_kernels.MOVED)), nowhere, nowhere, np.zeros((*epochs, 0, 3)),
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
        aiding = arrays.aiding
        # All of them: kernels of arrays that can be written would be compiled again.
        self.arrays = replace(
            arrays,
            origin=read_only(arrays.origin),
            step=read_only(arrays.step),
            coefficients=read_only(arrays.coefficients),
            channels=frozen(arrays.channels),
            combined=frozen(arrays.combined),
            lags=_immutable(arrays.lags),
            times=frozen(arrays.times),
            aiding=replace(
                aiding,
                gravity=frozen(aiding.gravity),
                bias=_immutable(aiding.bias),
                arm=_immutable(aiding.arm),
                map=DisturbanceMap(*map(read_only, fields_of(aiding.map))),
            ),
        ).mapped(frozen)
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
