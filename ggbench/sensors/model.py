"""Measurement model of all estimators, h and H, along INS tracks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from ..gravity.coloured_noise import Whitening
from ..gravity.field import DisturbanceMap, Field
from ..numerics.frozen import frozen, read_only
from ..numerics.records import fields_of
from .aiding import MOVED, AidingSensor, Motion
from .gradiometer.instrument import INSTRUMENTS, STRAPDOWN, Gradiometer, readings_along
from .gradiometer.lowpass import Prefilter
from .gradiometer.mounting import Mount
from .model_arrays import ModelArrays, immutable, linear_reach
from .model_kernels import linearise, linearised, predict
from .states import PlacedStates, Seen, add_columns, turned

NO_MAP = Field.normal().disturbance_map
"""A map without gravity disturbance."""
NO_GRADIOMETER = Gradiometer(1.0, None, (), "local-level")
"""An instrument without channels."""


class DelayedInsSolution(NamedTuple):
    """INS solution at the measurement times of the gradiometer.

    Attributes
    ----------
    delays : (K,) τ_k, delays of the measurements behind their epochs [s].
    positions, attitudes : (..., K, 3), (..., K, 3, 3) at these times, as in
        :class:`.aiding.Motion`.
    rows : (..., K, 6, 15) B_k: from x(t_k) to the position error [m] and attitude error [rad] at
        these times.
    """

    delays: np.ndarray
    positions: np.ndarray
    attitudes: np.ndarray
    rows: np.ndarray


class AidingChannels(NamedTuple):
    """Equation of the channels of the aiding sensors; its symbols are those of ModelArrays.

    Attributes
    ----------
    offset : (..., K, e) in units of the channels.
    linear : (..., K, e, n) C_k.
    weights : (..., K, e, 3) W_k [unit of the channel per m/s²].
    gravity : the map of the gravity disturbance.
    """

    offset: np.ndarray
    linear: np.ndarray
    weights: np.ndarray
    gravity: DisturbanceMap

    def without(self, absent: np.ndarray) -> AidingChannels:
        """Return the equation with zeros for missing measurements, ``absent`` (..., K, e)."""
        for array in (self.offset, self.linear, self.weights):
            array[absent] = 0.0
        return self


def aiding_channels(
    sensors: Sequence[AidingSensor],
    states: Sequence[PlacedStates],
    dimension: int,
    gravity: DisturbanceMap,
    read_at: Sequence[np.ndarray],
    motion: Motion,
    turning: np.ndarray,
) -> AidingChannels:
    """Return the equation of aiding sensors along INS tracks, as if no measurement were missing.

    Parameters
    ----------
    sensors : in the order of their channels.
    states : after those of the INS.
    dimension : number of states.
    gravity : the map of the gravimeters.
    read_at : epochs of the measurements of each sensor.
    motion : INS solution at the epochs (..., K, .).
    turning : (..., K, 3) angular rates about the body's axes at the epochs [rad/s].
    """
    epochs, total = motion.positions.shape[:-1], sum(len(sensor.channels) for sensor in sensors)
    offset, linear = np.zeros((*epochs, total)), np.zeros((*epochs, total, dimension))
    weights, first = np.zeros((*epochs, total, 3)), 0
    for sensor, at in zip(sensors, read_at, strict=True):
        some, now = slice(first, first + len(sensor.channels)), motion.at(at)
        first = some.stop
        ahead, columns = sensor.about(now)
        offset[..., at, some] = ahead
        linear[..., at, some, :MOVED] = columns
        weights[..., at, some, :] = sensor.weights
        gain = np.ones(ahead.shape[:-1])
        seen = Seen(now, turning[..., at, :], gain, ahead.copy)
        add_columns(linear, at, some, states, sensor, seen)
    return AidingChannels(offset, linear, weights, gravity)


def model_arrays(
    field: Field,
    gradiometer: Gradiometer | None,
    times: np.ndarray,
    ins: Motion,
    taken: DelayedInsSolution,
    treatment: Prefilter,
    missing: np.ndarray,
    at: np.ndarray,
    others: AidingChannels,
    states: Sequence[PlacedStates],
    whitening: Whitening | None,
) -> ModelArrays:
    """Return the equation of measurement along an INS track, or along those of a block of runs.

    Parameters
    ----------
    field, gradiometer : assumed map and instrument (or None).
    times : (K,) measurement epochs [s].
    ins : INS solution at the epochs (..., K, .); (...) is () or (R,).
    taken : INS solution at the delayed measurement times.
    treatment : the prefilter of the G outputs of the instrument.
    missing : (..., G) mask of missing measurements.
    at : (G,) epochs of the gradiometer's measurements.
    others : the channels of the other sensors.
    states : after those of the INS.
    whitening : of the G measurements, for coloured noise without low-pass and delay; else None.
    """
    if gradiometer is None:
        gradiometer = NO_GRADIOMETER
    instrument, channels = INSTRUMENTS.index(gradiometer.instrument), gradiometer.channels
    epochs, then = ins.positions.shape[:-1], times - taken.delays
    attitudes, delayed_attitudes = ins.attitudes, taken.attitudes
    if instrument != STRAPDOWN:  # no other reading depends on them
        attitudes = delayed_attitudes = np.broadcast_to(np.eye(3), (*epochs, 3, 3))

    def readings(positions: np.ndarray, times: np.ndarray, c_nb: np.ndarray) -> np.ndarray:
        some = positions[..., at, :], times[at], c_nb[..., at, :, :]
        return np.asarray(readings_along(instrument, *some, field) @ channels.T)

    def at_reference() -> np.ndarray:
        return readings(taken.positions, then, delayed_attitudes)

    gain, offset = np.zeros(epochs), np.zeros((*epochs, len(channels)))
    gain[..., at] = np.where(missing, 0.0, treatment.gain)
    if gradiometer.lowpass is not None:  # else h is what is read at the delayed place, no more
        predicted = gradiometer.lowpass.apply(readings(ins.positions, times, attitudes))
        predicted = np.where(missing[..., np.newaxis], 0.0, treatment.apply(predicted))
        offset[..., at, :] = predicted - gain[..., at][..., np.newaxis] * at_reference()
    g, m, n = len(channels), len(channels) + others.offset.shape[-1], others.linear.shape[-1]
    linear, weights = np.zeros((*epochs, m, n)), np.zeros((*epochs, m, 3))
    linear[..., g:, :], weights[..., g:, :] = others.linear, others.weights
    if g > 0:
        motion = Motion(taken.positions, ins.velocities, delayed_attitudes).at(at)
        still = np.zeros((*epochs, 3))[..., at, :]
        seen = Seen(motion, still, gain[..., at], at_reference)
        add_columns(linear, at, slice(0, g), states, gradiometer, seen)
        if whitening is not None:
            linear[..., at, :g, :] = whitening.of_constant @ linear[..., at, :g, :]
    first_linear, columns = linear_reach(linear, weights)
    mount = Mount(instrument, taken.positions, then, delayed_attitudes, taken.rows)
    mount = turned(mount, states)
    combined, lags = _combined(channels, whitening, at, len(times))
    arrays = ModelArrays(
        dimension=n,
        instrument=mount.instrument,
        channels=channels,
        combined=combined,
        lags=lags,
        origin=field.origin,
        step=field.step,
        coefficients=field.tensor_coefficients,
        base=field.base_coefficients,
        times=then,
        references=taken.positions,
        attitudes=mount.attitudes,
        rows=mount.rows,
        offset=np.concatenate([offset, others.offset], axis=-1),
        gain=gain,
        linear=linear,
        first_linear=first_linear,
        columns=columns,
        weights=weights,
        places=ins.positions,
        gravity=others.gravity if weights.any() else NO_MAP,
    )
    found: ModelArrays = _unchangeable(arrays, read_only)
    return found


def _unchangeable(arrays: Any, kept: Callable[[np.ndarray], np.ndarray]) -> Any:
    """Return a record whose arrays cannot be written, as ``kept`` makes them; maps are not copied.

    Kernels of arrays that can be written would be compiled again.
    """
    changed: dict[str, Any] = {}
    for name, value in zip(arrays.__dataclass_fields__, fields_of(arrays), strict=True):
        if name in ("origin", "step", "coefficients", "base"):
            changed[name] = read_only(value)
        elif isinstance(value, np.ndarray):
            changed[name] = immutable(value) if value.dtype.kind == "i" else kept(value)
        elif isinstance(value, DisturbanceMap):
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
        used = np.flatnonzero(whitening.lags[:, tap] > 0)
        lags[at[used], tap] = at[used] - at[used - whitening.lags[used, tap]]
    return combined, lags


class SensorModel:
    """The measurement model of all estimators: h(k, x) and its Jacobian H(k, x).

    :class:`.ModelArrays` has the equation. A filtered gradiometer's offset is ẑ_k − gain_k S
    T(p̂_k), where ẑ is the measurement predicted along the INS track, after the filter and
    prefilter of the instrument, p̂_k the INS position (and attitude) at t_k − τ_k, and the gain
    that of the chain. Without a filter the offset is zero, and τ_k is the latency of the readings,
    if they have one. Whitened coloured noise combines the last few measurements, each at its own
    INS position less the present position error. This neglects the change of the error, velocity
    error times lag, over up to 15 s in the shipped flights. It raises the bounds of ``vinton2008``
    by 0.7 to 1.1 %. Outside the map the field of the border continues. For a missing measurement h
    and H are zero.

    ``evaluations`` counts evaluations of h and of Jacobians. Compiled engines use the arrays and
    have their own counters.

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
        """Number of evaluations of h and of its Jacobian so far."""
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
        """Return h (N, m) at epochs ``at`` (N,), one state for each epoch, x (N, n)."""
        return self._along(at, x)[0]

    def jacobian_along(self, at: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Return H (N, m, n) at epochs ``at`` (N,), one state for each epoch, x (N, n)."""
        return self._along(at, x)[1]

    def _along(self, at: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return h and H at epochs for a state of each, and count these."""
        epochs = np.ascontiguousarray(at, dtype=np.int64)
        self._states(int(epochs.min(initial=0)), x)
        states = self._states(int(epochs.max(initial=0)), x)
        if states.ndim != 2 or epochs.shape != states.shape[:1]:
            raise ValueError(
                f"states must have the shape (N, n) for epochs {epochs.shape}, not {states.shape}"
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
