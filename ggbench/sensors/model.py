"""Measurement model h and H of all estimators, along INS tracks."""

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
"""Empty map, for models without gravimeters."""
NO_GRADIOMETER = Gradiometer(1.0, None, (), "local-level")
"""Gradiometer without channels, for models without a gradiometer."""


class DelayedInsSolution(NamedTuple):
    """INS solution at the measurement times of the gradiometer.

    Attributes
    ----------
    delays : (K,) τ_k, time from each measurement to its epoch [s].
    positions, attitudes : (..., K, 3), (..., K, 3, 3) INS solution at the measurement times, as in
        :class:`.aiding.Motion`.
    rows : (..., K, 6, 15) B_k, which maps the INS errors at the epoch to the errors of position [m]
        and attitude [rad] at the measurement time.
    """

    delays: np.ndarray
    positions: np.ndarray
    attitudes: np.ndarray
    rows: np.ndarray


class AidingChannels(NamedTuple):
    """Measurement equation of the aiding channels, in the symbols of :class:`.ModelArrays`.

    Attributes
    ----------
    offset : (..., K, e) constant term of each of e channels [unit of the channel].
    linear : (..., K, e, n) C_k [unit of the channel per unit of the state].
    weights : (..., K, e, 3) W_k [unit of the channel per m/s²].
    gravity : map of the gravity disturbance.
    """

    offset: np.ndarray
    linear: np.ndarray
    weights: np.ndarray
    gravity: DisturbanceMap

    def without(self, absent: np.ndarray) -> AidingChannels:
        """Set the terms of missing measurements to zero in place, and return the equation.

        ``absent`` (..., K, e) is the mask of missing measurements.
        """
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
    """Return the measurement equation of aiding sensors along INS tracks.

    Missing measurements are not considered, see :meth:`AidingChannels.without`.

    Parameters
    ----------
    sensors : aiding sensors, in the order of their channels.
    states : states of the sensors, which follow those of the INS.
    dimension : number n of states.
    gravity : map of the gravity disturbance for the gravimeters.
    read_at : for each sensor, the indices (G,) of the epochs of its measurements.
    motion : INS solution at the K epochs.
    turning : (..., K, 3) angular rates about the body axes at the epochs [rad/s].
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
    """Return the measurement equation along one INS track, or along the R tracks of a block.

    Parameters
    ----------
    field, gradiometer : assumed field and gradiometer; the gradiometer may be None.
    times : (K,) measurement epochs [s].
    ins : INS solution at the epochs. The leading axes (...) of all arrays are () for one track, and
        (R,) for a block.
    taken : INS solution at the measurement times of the gradiometer.
    treatment : prefilter of the G outputs of the gradiometer.
    missing : (..., G) mask of missing gradiometer measurements.
    at : (G,) indices of the epochs with gradiometer measurements.
    others : measurement equation of the aiding sensors.
    states : states of the sensors, which follow those of the INS.
    whitening : whitening of the G measurements for coloured noise, or None for white noise. It is
        allowed only without low-pass filter and latency.
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
    """Return a copy of a record with read-only arrays; arrays of maps are not copied.

    ``kept`` converts each floating-point array to a read-only array. For writable arrays numba
    would compile the kernels again.
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
    """Return ``combined`` and ``lags`` of :class:`.ModelArrays`.

    Parameters
    ----------
    channels : (g, 6) rows that map a tensor to the channels of the gradiometer.
    whitening : whitening of the G measurements; None for white noise.
    at : (G,) epochs of the measurements.
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
    """Measurement model of all estimators: h(k, x) and its Jacobian H(k, x).

    :class:`.ModelArrays` states the equation and defines its symbols.

    For a gradiometer with a low-pass filter the offset is ẑ_k − gain_k S T(p̂_k). Here ẑ_k is the
    measurement predicted along the INS track, after low-pass and prefilter; p̂_k is the INS
    position (and attitude) at t_k − τ_k; gain_k is the gain of low-pass and prefilter. Without a
    low-pass the offset is zero, and τ_k is the latency of the measurements.

    Whitening of coloured noise combines a few successive measurements. Each is evaluated at its INS
    position minus the position error at epoch k. This neglects the change of the position error
    during the lag. The change is the velocity error times the lag, which is 15 or 20 s in the
    shipped flights. In the scenario ``vinton2008`` this approximation raises the error bounds by
    0.7 to 1.1 %.

    Outside the map the field at the border is used. For a missing measurement h and H are zero.

    ``evaluations`` is the number of evaluations of h and of Jacobians. Compiled engines use the
    arrays directly and count evaluations themselves.

    Parameters
    ----------
    arrays : arrays of one run, from :func:`model_arrays`.
    """

    def __init__(self, arrays: ModelArrays) -> None:
        self.arrays: ModelArrays = _unchangeable(arrays, frozen)
        self._block = self.arrays.as_block()
        self._evaluations = 0

    @property
    def evaluations(self) -> int:
        """Number of evaluations of h plus number of evaluations of its Jacobian, so far."""
        return self._evaluations

    def predict(self, k: int, x: np.ndarray) -> np.ndarray:
        """Return h (..., m) at epoch ``k`` for states x (..., n)."""
        states = self._states(k, x)
        points = states.reshape(-1, states.shape[-1])
        self._evaluations += len(points)
        out = predict(self._block, k, points)
        return out.reshape(*states.shape[:-1], out.shape[-1])

    def jacobian(self, k: int, x: np.ndarray) -> np.ndarray:
        """Return H = ∂h/∂x (..., m, n) at epoch ``k`` for states x (..., n)."""
        states = self._states(k, x)
        points = states.reshape(-1, states.shape[-1])
        self._evaluations += len(points)
        predicted = np.empty((len(points), self.arrays.offset.shape[-1]))
        out = np.empty((*predicted.shape, points.shape[-1]))
        linearise(self._block, k, points, predicted, out)
        return out.reshape(*states.shape[:-1], *out.shape[1:])

    def predict_along(self, at: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Return h (N, m) at epochs ``at`` (N,), with one state x (N, n) for each epoch."""
        return self._along(at, x)[0]

    def jacobian_along(self, at: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Return H (N, m, n) at epochs ``at`` (N,), with one state x (N, n) for each epoch."""
        return self._along(at, x)[1]

    def _along(self, at: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return h and H with one state for each epoch, and count the evaluations."""
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
        """Return states as a contiguous array for the kernels.

        Raises IndexError for a wrong epoch ``k``, and ValueError for a wrong shape.
        """
        states = np.ascontiguousarray(x, dtype=float)
        epochs, n = len(self.arrays.rows), self.arrays.dimension
        if not 0 <= k < epochs:
            raise IndexError(f"there is no epoch {k}; the problem has epochs 0 to {epochs - 1}")
        if states.ndim == 0 or states.shape[-1] != n:
            raise ValueError(f"states must be (..., {n}), not {states.shape}")
        return states
