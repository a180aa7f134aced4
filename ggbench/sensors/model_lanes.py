"""h and H of eight runs at once, in the lanes of vector registers.

The arithmetic is that of :mod:`ggbench.sensors.model_kernels`; the run is the last index of arrays.
"""

from __future__ import annotations

import math

import numpy as np

from ..gravity.ellipsoid import (
    ROTATION_RATE,
    metres_per_radian_of,
    normal_gradient_of,
    normal_gradient_slopes_of,
)
from ..gravity.field import spline_lanes
from ..numerics.kernels import LANES, aligned, compiled, inlined
from ..numerics.rotations import sine_cosine
from .gradiometer.instrument import PLATFORM, STRAPDOWN, inertial_matrix, rotated, sum_of, turn_of
from .model_kernels import ModelArrays, linearise_errors, run_arrays

TURN = 2.0 * math.pi
_D, _SINE, _COSINE, _ANGLE, _NORTH, _EAST, _PLACE, _WORK = 6, 24, 25, 26, 28, 29, 30, 33
"""Where in the work of :func:`linearise_lanes` is what, after the tensors."""


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
