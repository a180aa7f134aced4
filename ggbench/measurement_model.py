"""The measurement model of all estimators, h and H, compiled: the instrument along an INS track."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from .earth import (
    ROTATION_RATE,
    metres_per_radian_of,
    normal_gradient_of,
    normal_gradient_slopes_of,
)
from .field import Field, gradients, spline_lanes
from .gradiometer import (
    INSTRUMENTS,
    PLATFORM,
    STRAPDOWN,
    Gradiometer,
    inertial_matrix,
    linearised_reading_at,
    platform_readings,
    readings_along,
    rotate_tensor,
    rotated,
    sum_of,
    turn_of,
)
from .kernels import LANES, aligned, compiled, inlined
from .lowpass import Prefilter
from .problem import frozen, read_only
from .rotations import sine_cosine
from .strapdown import product, rotation_matrix


class ModelArrays(NamedTuple):
    """The measurement model as arrays: all that the kernels of h and H are given.

    h(k, x) = offset_k + gain_k · (S reading(reference_k − B_k x) + b). For many runs at once (a
    block) the arrays that differ from run to run have the run as leading axis.

    Attributes
    ----------
    instrument : index of :data:`.gradiometer.INSTRUMENTS`.
    channels : (m, 6) S, from the tensor in the mount to the channels.
    bias : index of the first of the m biases b among the states; −1 for none.
    origin, step, coefficients : the map, see :class:`.field.Field`.
    times : (K,) t_k − τ_k [s].
    references : (K, 3) INS positions then [rad, rad, m].
    attitudes : (K, 3, 3) INS attitudes C_nb then; only a strapdown instrument has any.
    rows : (K, 6, 15) B_k, see :class:`GradiometerModel`.
    offset : (K, m) [E].
    gain : (K,); zero where a reading is missing.
    """

    instrument: int
    channels: np.ndarray
    bias: int
    origin: np.ndarray
    step: np.ndarray
    coefficients: np.ndarray
    times: np.ndarray
    references: np.ndarray
    attitudes: np.ndarray
    rows: np.ndarray
    offset: np.ndarray
    gain: np.ndarray

    @property
    def dimension(self) -> int:
        """Number of states n."""
        return int(self.rows.shape[-1] + (len(self.channels) if self.bias >= 0 else 0))

    def of_run(self, run: int) -> ModelArrays:
        """Return the arrays of one run of a block."""
        return self._replace(**{name: getattr(self, name)[run] for name in _OF_A_RUN})

    def as_block(self) -> ModelArrays:
        """Return the arrays of one run as a block of one."""
        return self._replace(**{name: getattr(self, name)[np.newaxis] for name in _OF_A_RUN})


_OF_A_RUN = ("references", "attitudes", "rows", "offset", "gain")
"""The arrays that differ from run to run."""


@compiled
def run_arrays(model: ModelArrays, run: int) -> ModelArrays:
    """Return the arrays of one run of a block: :meth:`ModelArrays.of_run`, compiled."""
    return ModelArrays(
        model.instrument, model.channels, model.bias, model.origin, model.step,
        model.coefficients, model.times, model.references[run], model.attitudes[run],
        model.rows[run], model.offset[run], model.gain[run],
    )  # fmt: skip


TURN = 2.0 * math.pi
_SMALL = 0.1
"""Angle [rad] up to which the series of :func:`_turned` are exact to rounding."""


@inlined
def _turned(sine: float, cosine: float, d: float) -> tuple[float, float]:
    """Return sin and cos of an angle that has grown by a small d, from its sine and cosine."""
    d2 = d * d
    sin_d = d * (1.0 - d2 / 6.0 * (1.0 - d2 / 20.0 * (1.0 - d2 / 42.0 * (1.0 - d2 / 72.0))))
    cos_d = 1.0 - d2 / 2.0 * (
        1.0 - d2 / 12.0 * (1.0 - d2 / 30.0 * (1.0 - d2 / 56.0 * (1.0 - d2 / 90.0)))
    )
    return sine * cos_d + cosine * sin_d, cosine * cos_d - sine * sin_d


@compiled
def _turn_all(angle: float, growth: np.ndarray, sines: np.ndarray, cosines: np.ndarray) -> None:
    """Fill sines and cosines (N,) of ``angle + growth[p]``."""
    sine, cosine = math.sin(angle), math.cos(angle)
    for p in range(growth.shape[0]):
        sines[p], cosines[p] = _turned(sine, cosine, growth[p])
    for p in range(growth.shape[0]):
        if abs(growth[p]) > _SMALL:
            sines[p], cosines[p] = math.sin(angle + growth[p]), math.cos(angle + growth[p])


@compiled
def predict_errors(model: ModelArrays, k: int, errors: np.ndarray, out: np.ndarray) -> None:
    """Fill h (m, N) [E] of N points, biases left out.

    Parameters
    ----------
    model, k : arrays of one run, epoch.
    errors : (6, N) B_k x of each point: position error ENU [m] and attitude error [rad]; the latter
        only of a strapdown instrument.
    out : (m, N) output.
    """
    count = errors.shape[1]
    reference = model.references[k]
    per_north, per_east = metres_per_radian_of(
        math.sin(reference[0]), math.cos(reference[0]), reference[2]
    )
    positions = np.empty((3, count))
    growth = np.empty((2, count))
    trigonometry = np.empty((4, count))
    tensors = np.empty((6, count))
    # Linear in the error, as the error state is.
    for p in range(count):
        growth[0, p] = -errors[1, p] / per_north
        growth[1, p] = -errors[0, p] / per_east
        positions[0, p] = reference[0] + growth[0, p]
        positions[1, p] = reference[1] + growth[1, p]
        positions[2, p] = reference[2] - errors[2, p]
    _turn_all(reference[0], growth[0], trigonometry[0], trigonometry[1])
    gradients(
        positions, trigonometry[0], trigonometry[1],
        model.origin, model.step, model.coefficients, tensors,
    )  # fmt: skip
    if model.instrument == PLATFORM:
        angle = reference[1] + ROTATION_RATE * model.times[k]
        _turn_all(angle, growth[1], trigonometry[2], trigonometry[3])
        platform_readings(
            trigonometry[0], trigonometry[1], trigonometry[2], trigonometry[3], tensors
        )
    elif model.instrument == STRAPDOWN:
        turn = np.empty((3, 3))
        c_nb = np.empty((3, 3))
        tensor = np.empty(6)
        for p in range(count):
            rotation_matrix(errors[3:, p], turn)
            product(turn, model.attitudes[k], c_nb)
            tensor[:] = tensors[:, p]
            rotate_tensor(c_nb.T, tensor, tensor)
            tensors[:, p] = tensor
    gain = model.gain[k]
    for m in range(out.shape[0]):
        channel, offset, row = model.channels[m], model.offset[k, m], out[m]
        for p in range(count):
            row[p] = offset + gain * (
                channel[0] * tensors[0, p] + channel[1] * tensors[1, p]
                + channel[2] * tensors[2, p] + channel[3] * tensors[3, p]
                + channel[4] * tensors[4, p] + channel[5] * tensors[5, p]
            )  # fmt: skip


@compiled
def _predict(model: ModelArrays, k: int, states: np.ndarray) -> np.ndarray:
    """Return h (N, m) of states (N, n)."""
    count, rows = states.shape[0], model.rows[k]
    errors = np.zeros((6, count))
    for i in range(6 if model.instrument == STRAPDOWN else 3):
        for p in range(count):
            for j in range(rows.shape[1]):
                errors[i, p] += rows[i, j] * states[p, j]
    found = np.empty((model.channels.shape[0], count))
    predict_errors(model, k, errors, found)
    out = np.ascontiguousarray(found.T)
    if model.bias >= 0:
        out += model.gain[k] * states[:, model.bias : model.bias + found.shape[0]]
    return out


@compiled
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


@compiled
def linearise_errors(
    model: ModelArrays, k: int, error: np.ndarray, predicted: np.ndarray, out: np.ndarray
) -> None:
    """Fill h (m,) [E], biases left out, and its derivative by the error (m, 6).

    Parameters
    ----------
    model, k : arrays of one run, epoch.
    error : (6,) B_k x, see :func:`predict_errors`.
    predicted : (m,) output.
    out : (m, 6) output [E/m; E/rad].
    """
    reference = model.references[k]
    sine, cosine = math.sin(reference[0]), math.cos(reference[0])
    per_north, per_east = metres_per_radian_of(sine, cosine, reference[2])
    work = np.empty(54)
    position, reading, slope = work[:3], work[3:9], work[9:45].reshape(6, 6)
    growth = -error[1] / per_north
    position[0] = reference[0] + growth
    position[1] = reference[1] - error[0] / per_east
    position[2] = reference[2] - error[2]
    if abs(growth) < _SMALL:
        sine, cosine = _turned(sine, cosine, growth)
    else:
        sine, cosine = math.sin(position[0]), math.cos(position[0])
    c_nb = work[45:].reshape(3, 3)
    if model.instrument == STRAPDOWN:
        turn = np.empty((3, 3))
        rotation_matrix(error[3:], turn)
        product(turn, model.attitudes[k], c_nb)
    linearised_reading_at(
        model.instrument, position, sine, cosine, model.times[k], c_nb,
        model.origin, model.step, model.coefficients, reading, slope,
    )  # fmt: skip
    # The error's metres are measured at the reference, the slope's at the displaced point.
    north, east = metres_per_radian_of(sine, cosine, position[2])
    scale_east, scale_north = -east / per_east, -north / per_north
    for i in range(6):
        slope[i, 0] *= scale_east
        slope[i, 1] *= scale_north
        slope[i, 2] *= -1.0
    if model.instrument == STRAPDOWN:
        slope[:, 3:] = slope[:, 3:].copy() @ _left_jacobian(error[3:])
    else:
        slope[:, 3:] = 0.0
    gain = model.gain[k]
    for m in range(model.channels.shape[0]):
        channel = model.channels[m]
        value = 0.0
        for i in range(6):
            value += channel[i] * reading[i]
        predicted[m] = model.offset[k, m] + gain * value
        for j in range(6):
            along = 0.0
            for i in range(6):
                along += channel[i] * slope[i, j]
            out[m, j] = gain * along


_T, _D, _SINE, _COSINE, _ANGLE, _NORTH, _EAST, _PLACE, _WORK = 0, 6, 24, 25, 26, 28, 29, 30, 33
"""Where in the work of :func:`linearise_lanes` is what: tensors, their derivatives, sines, ..."""


@compiled
def linearise_lanes(
    model: ModelArrays,
    runs: np.ndarray,
    count: int,
    k: int,
    errors: np.ndarray,
    work: np.ndarray,
    predicted: np.ndarray,
    out: np.ndarray,
) -> None:
    """Fill h [E], biases left out, and its derivative by the error, of several runs of a block.

    Parameters
    ----------
    model, k : arrays of a block, epoch.
    runs : (LANES,) index of each run. count : how many of the lanes there is an answer for.
    errors : (6 * LANES,) B_k x, see :func:`predict_errors`; the run is the last index, as below.
    work : from :func:`linearising_work`.
    predicted : (m * LANES,) output.
    out : (m * 6 * LANES,) output [E/m; E/rad].
    """
    platform = model.instrument == PLATFORM
    if model.instrument == STRAPDOWN:
        _linearise_strapdown(model, runs, count, k, errors, predicted, out)
        return
    for r in range(LANES):
        reference = model.references[runs[r], k]
        for i in range(3):
            work[(_PLACE + i) * LANES + r] = reference[i]
    turned = ROTATION_RATE * model.times[k]
    for r in range(LANES):
        latitude, longitude = work[_PLACE * LANES + r], work[(_PLACE + 1) * LANES + r]
        height = work[(_PLACE + 2) * LANES + r]
        sine, cosine = sine_cosine(latitude)
        per_north, per_east = metres_per_radian_of(sine, cosine, height)
        # Linear in the error, as the error state is.
        latitude -= errors[LANES + r] / per_north
        longitude -= errors[r] / per_east
        sine, cosine = sine_cosine(latitude)
        angle = longitude + turned
        sine_a, cosine_a = sine_cosine(angle - TURN * math.floor(angle / TURN + 0.5))
        work[_SINE * LANES + r], work[_COSINE * LANES + r] = sine, cosine
        work[_ANGLE * LANES + r], work[(_ANGLE + 1) * LANES + r] = sine_a, cosine_a
        work[_NORTH * LANES + r], work[_EAST * LANES + r] = per_north, per_east
        work[_PLACE * LANES + r], work[(_PLACE + 1) * LANES + r] = latitude, longitude
        work[(_PLACE + 2) * LANES + r] = height - errors[2 * LANES + r]
    if model.coefficients.size > 0:
        spline_lanes(
            work[_PLACE * LANES : _WORK * LANES], count, model.origin, model.step,
            model.coefficients, work[_WORK * LANES :], work[: _SINE * LANES],
        )  # fmt: skip
    for r in range(LANES):
        sine, cosine = work[_SINE * LANES + r], work[_COSINE * LANES + r]
        height = work[(_PLACE + 2) * LANES + r]
        ee, nn, nu, uu = normal_gradient_of(sine, cosine, height)
        slopes = normal_gradient_slopes_of(sine, cosine, height)
        north, east = metres_per_radian_of(sine, cosine, height)
        per_north, per_east = 1.0 / north, 1.0 / east
        t = (
            work[r] + ee, work[LANES + r], work[2 * LANES + r],
            work[3 * LANES + r] + nn, work[4 * LANES + r] + nu, work[5 * LANES + r] + uu,
        )  # fmt: skip
        # Of the spline: along latitude, longitude, height; of the tensor: east, north, up.
        d_e = (
            per_east * work[(_D + 1) * LANES + r], per_east * work[(_D + 4) * LANES + r],
            per_east * work[(_D + 7) * LANES + r], per_east * work[(_D + 10) * LANES + r],
            per_east * work[(_D + 13) * LANES + r], per_east * work[(_D + 16) * LANES + r],
        )  # fmt: skip
        d_n = (
            per_north * work[_D * LANES + r] + slopes[0], per_north * work[(_D + 3) * LANES + r],
            per_north * work[(_D + 6) * LANES + r],
            per_north * work[(_D + 9) * LANES + r] + slopes[1],
            per_north * work[(_D + 12) * LANES + r] + slopes[2],
            per_north * work[(_D + 15) * LANES + r] + slopes[3],
        )  # fmt: skip
        d_u = (
            work[(_D + 2) * LANES + r] + slopes[4], work[(_D + 5) * LANES + r],
            work[(_D + 8) * LANES + r], work[(_D + 11) * LANES + r] + slopes[5],
            work[(_D + 14) * LANES + r] + slopes[6], work[(_D + 17) * LANES + r] + slopes[7],
        )  # fmt: skip
        if platform:
            c = inertial_matrix(
                sine, cosine, work[_ANGLE * LANES + r], work[(_ANGLE + 1) * LANES + r]
            )
            # The field's change and the local level's turn (eq. 12).
            d_e = rotated(c, sum_of(d_e, turn_of(t, 0.0, cosine * per_east, sine * per_east)))
            d_n = rotated(c, sum_of(d_n, turn_of(t, -per_north, 0.0, 0.0)))
            d_u = rotated(c, d_u)
            t = rotated(c, t)
        # The error's metres are measured at the reference, the slope's at the displaced point.
        scale_east = -east / work[_EAST * LANES + r]
        scale_north = -north / work[_NORTH * LANES + r]
        work[r], work[LANES + r], work[2 * LANES + r] = t[0], t[1], t[2]
        work[3 * LANES + r], work[4 * LANES + r], work[5 * LANES + r] = t[3], t[4], t[5]
        _store_column(d_e, scale_east, 0, r, work)
        _store_column(d_n, scale_north, 1, r, work)
        _store_column(d_u, -1.0, 2, r, work)
    for m in range(model.channels.shape[0]):
        channel = model.channels[m]
        c_0, c_1, c_2, c_3 = channel[0], channel[1], channel[2], channel[3]
        c_4, c_5 = channel[4], channel[5]
        value = predicted[m * LANES : (m + 1) * LANES]
        slope = out[m * 6 * LANES : (m + 1) * 6 * LANES]
        for r in range(LANES):
            value[r] = (
                c_0 * work[r] + c_1 * work[LANES + r] + c_2 * work[2 * LANES + r]
                + c_3 * work[3 * LANES + r] + c_4 * work[4 * LANES + r]
                + c_5 * work[5 * LANES + r]
            )  # fmt: skip
            for j in range(3):
                slope[j * LANES + r] = (
                    c_0 * work[(_D + j) * LANES + r] + c_1 * work[(_D + 3 + j) * LANES + r]
                    + c_2 * work[(_D + 6 + j) * LANES + r] + c_3 * work[(_D + 9 + j) * LANES + r]
                    + c_4 * work[(_D + 12 + j) * LANES + r] + c_5 * work[(_D + 15 + j) * LANES + r]
                )  # fmt: skip
        for r in range(LANES):
            run = runs[r]
            gain = model.gain[run, k]
            value[r] = model.offset[run, k, m] + gain * value[r]
            for j in range(3):
                slope[j * LANES + r] *= gain


@inlined
def _store_column(d: tuple[float, ...], scale: float, axis: int, r: int, work: np.ndarray) -> None:
    """Put how a tensor changes along an axis into the work of :func:`linearise_lanes`."""
    work[(_D + axis) * LANES + r] = scale * d[0]
    work[(_D + 3 + axis) * LANES + r] = scale * d[1]
    work[(_D + 6 + axis) * LANES + r] = scale * d[2]
    work[(_D + 9 + axis) * LANES + r] = scale * d[3]
    work[(_D + 12 + axis) * LANES + r] = scale * d[4]
    work[(_D + 15 + axis) * LANES + r] = scale * d[5]


@compiled
def linearising_work() -> np.ndarray:
    """Return the work that :func:`linearise_lanes` needs."""
    work = aligned((_WORK + 27) * LANES + 96)
    work[:] = 0.0
    return work


@compiled
def _linearise_strapdown(
    model: ModelArrays,
    runs: np.ndarray,
    count: int,
    k: int,
    errors: np.ndarray,
    predicted: np.ndarray,
    out: np.ndarray,
) -> None:
    """Do :func:`linearise_lanes` run by run: each has an attitude of its own."""
    channels = model.channels.shape[0]
    error, value, slope = np.empty(6), np.empty(channels), np.empty((channels, 6))
    for r in range(count):
        for i in range(6):
            error[i] = errors[i * LANES + r]
        linearise_errors(run_arrays(model, runs[r]), k, error, value, slope)
        for m in range(channels):
            predicted[m * LANES + r] = value[m]
            for j in range(6):
                out[(6 * m + j) * LANES + r] = slope[m, j]


@compiled
def _jacobian(model: ModelArrays, k: int, state: np.ndarray) -> np.ndarray:
    """Return H (m, n) of one state."""
    rows, width = model.rows[k], model.rows.shape[2]
    moving = 6 if model.instrument == STRAPDOWN else 3
    channels = model.channels.shape[0]
    error, predicted = np.zeros(6), np.empty(channels)
    slope = np.empty((channels, 6))
    for i in range(moving):
        for j in range(width):
            error[i] += rows[i, j] * state[j]
    linearise_errors(model, k, error, predicted, slope)
    out = np.zeros((channels, state.shape[0]))
    for m in range(channels):
        row = out[m]
        for j in range(moving):
            for i in range(width):
                row[i] += slope[m, j] * rows[j, i]
        if model.bias >= 0:
            row[model.bias + m] += model.gain[k]
    return out


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

    Parameters
    ----------
    arrays : of one run, from :func:`model_arrays`.
    """

    def __init__(self, arrays: ModelArrays) -> None:
        own: dict[str, Any] = {
            name: frozen(getattr(arrays, name)) for name in ("channels", "times", *_OF_A_RUN)
        }
        self.arrays = arrays._replace(**own)

    def predict(self, k: int, x: np.ndarray) -> np.ndarray:
        """Return h (..., m) [E] at epoch ``k`` for states x (..., n); any leading axes."""
        states = self._states(k, x)
        out = _predict(self.arrays, k, states.reshape(-1, states.shape[-1]))
        return out.reshape(*states.shape[:-1], out.shape[-1])

    def jacobian(self, k: int, x: np.ndarray) -> np.ndarray:
        """Return H = ∂h/∂x (m, n) [E per unit of the state] at epoch ``k`` and state x (n,)."""
        state = self._states(k, x)
        if state.ndim != 1:
            raise ValueError(f"the Jacobian is taken at one state (n,), not at {state.shape}")
        return _jacobian(self.arrays, k, state)

    def _states(self, k: int, x: np.ndarray) -> np.ndarray:
        """Return states ready for the kernels, which check nothing."""
        states = np.ascontiguousarray(x, dtype=float)
        epochs, n = len(self.arrays.rows), self.arrays.dimension
        if not 0 <= k < epochs:
            raise IndexError(f"there is no epoch {k}; the problem has epochs 0 to {epochs - 1}")
        if states.ndim == 0 or states.shape[-1] != n:
            raise ValueError(f"states must be (..., {n}), not {states.shape}")
        return states
