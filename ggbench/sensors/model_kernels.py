"""h and H of the gradiometer along INS tracks, compiled: of many points, of one, of eight runs.

Every estimator's measurement model is these kernels, whatever its engine.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..gravity.ellipsoid import ROTATION_RATE, metres_per_radian_of
from ..gravity.field import gradients
from ..numerics.kernels import compiled, inlined
from ..numerics.rotations import product, rotation_matrix
from .gradiometer.instrument import (
    PLATFORM,
    STRAPDOWN,
    linearised_reading_at,
    platform_readings,
    rotate_tensor,
)


class ModelArrays(NamedTuple):
    """The measurement model as arrays: all that the kernels of h and H are given.

    h(k, x) = offset_k + gain_k · (S reading(reference_k − B_k x) + b). For many runs at once (a
    block) the arrays that differ from run to run have the run as leading axis.

    Attributes
    ----------
    instrument : index of :data:`.instrument.INSTRUMENTS`.
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
        return self._replace(**{name: getattr(self, name)[run] for name in OF_A_RUN})

    def as_block(self) -> ModelArrays:
        """Return the arrays of one run as a block of one."""
        return self._replace(**{name: getattr(self, name)[np.newaxis] for name in OF_A_RUN})


OF_A_RUN = ("references", "attitudes", "rows", "offset", "gain")
"""The arrays that differ from run to run."""


@compiled
def run_arrays(model: ModelArrays, run: int) -> ModelArrays:
    """Return the arrays of one run of a block: :meth:`ModelArrays.of_run`, compiled."""
    return ModelArrays(
        model.instrument, model.channels, model.bias, model.origin, model.step,
        model.coefficients, model.times, model.references[run], model.attitudes[run],
        model.rows[run], model.offset[run], model.gain[run],
    )  # fmt: skip


SMALL = 0.1
"""Angle [rad] up to which the series of :func:`turned` are exact to rounding."""


@inlined
def turned(sine: float, cosine: float, d: float) -> tuple[float, float]:
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
        sines[p], cosines[p] = turned(sine, cosine, growth[p])
    for p in range(growth.shape[0]):
        if abs(growth[p]) > SMALL:
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
def predict(model: ModelArrays, k: int, states: np.ndarray) -> np.ndarray:
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
    if abs(growth) < SMALL:
        sine, cosine = turned(sine, cosine, growth)
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


@compiled
def jacobian(model: ModelArrays, k: int, state: np.ndarray) -> np.ndarray:
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
