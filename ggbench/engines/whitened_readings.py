"""Readings of eight runs as whitened linear equations, compiled."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..block import ProblemBlock
from ..numerics.kernels import compiled, inlined
from ..numerics.lanes import gather_row, gather_rows, lanes
from ..numerics.vectors import load, splat, store, with_sign
from ..sensors.aiding_kernels import MOVED, column_of, linearise_aiding
from ..sensors.model_kernels import (
    Here,
    ModelArrays,
    Points,
    arrive,
    here_of,
    linearise_reading,
    moving_errors,
    points_of,
    read,
)

_TINY = 1e-300
"""What keeps 0 / 0 from being NaN where a reading is missing."""


class Readings(NamedTuple):
    """The readings of eight runs at an epoch, linearised; arrays that :func:`linearise` fills.

    Attributes
    ----------
    slope : (g, 6, lanes) A, of the gradiometer's h by the errors B_k x [E/m; E/rad]; ``moving``
        columns are used.
    aiding_slope : (e, 9, lanes) of the other channels, by the first states.
    b : (moving, 15, lanes) B_k, as many rows as there are errors that h depends on.
    errors : (6, 1, lanes) B_k x.
    here : what the readings depend on; the gain is that of biases, too: zero where none came.
    z : (1, m, lanes) readings.
    predicted : (1, m, lanes) h(x), of the gradiometer without biases.
    rows, innovation : (equations, n, lanes), (1, equations, lanes): H δx = innovation + noise of
        unit variance. If there were less than three, others are zero.
    precision : (1, equations, lanes) by which the equations of a whole reading are multiplied:
        inverse deviations of their noise in units of the given, ones until somebody knows better.
    squared : (1, 1, lanes) the sum of the squares of what no state explains.
    white, residual : (g, moving, lanes), (1, m, lanes) whitened A and z − h, compressed.
    points : scratch.
    whole : whether each channel keeps an equation of its own.
    """

    slope: np.ndarray
    aiding_slope: np.ndarray
    b: np.ndarray
    errors: np.ndarray
    here: Here
    z: np.ndarray
    predicted: np.ndarray
    rows: np.ndarray
    innovation: np.ndarray
    precision: np.ndarray
    squared: np.ndarray
    white: np.ndarray
    residual: np.ndarray
    points: Points
    whole: bool


@compiled
def readings_of(model: ModelArrays, n: int, m: int, whole: bool = False) -> Readings:
    """Return the arrays for readings of m channels and n states.

    Of a ``whole`` reading each channel is an equation; else they are as few as say the same.
    """
    moving, g = moving_errors(model), model.channels.shape[0]
    equations = max(_gradient_equations(model, whole) + m - g, 3)
    precision = lanes(1, equations)
    precision[:] = 1.0
    return Readings(
        lanes(g, 6), lanes(m - g, MOVED), lanes(moving, model.rows.shape[3]), lanes(6, 1),
        here_of(m), lanes(1, m), lanes(1, m), lanes(equations, n), lanes(1, equations), precision,
        lanes(1, 1), lanes(g, moving), lanes(1, m), points_of(1), whole,
    )  # fmt: skip


@compiled
def _gradient_equations(model: ModelArrays, whole: bool) -> int:
    """Return how many equations the gradiometer's channels become.

    What channels without biases say about ``moving`` errors is at most so many.
    """
    g = model.channels.shape[0]
    return g if whole or model.bias >= 0 else min(g, moving_errors(model))


@compiled
def linearise(
    model: ModelArrays,
    measurements: np.ndarray,
    noise_inverse: np.ndarray,
    group: np.ndarray,
    count: int,
    k: int,
    x: np.ndarray,
    out: Readings,
) -> None:
    """Fill the readings of a group at epoch ``k``, linearised at x.

    Parameters
    ----------
    model, measurements : of a block; (R, K, m).
    noise_inverse : (1 or K, m, m) of :func:`noise_inverse`.
    group : (lanes,) runs, of which ``count`` differ. x : (1, n, lanes). out : output.
    """
    b, gain, predicted = out.b, out.here.gain, out.predicted
    rows, residual, white, innovation = out.rows, out.residual, out.white, out.innovation
    g, moving, columns = out.slope.shape[0], b.shape[0], b.shape[1]
    root = noise_inverse[min(k, noise_inverse.shape[0] - 1)]
    take_readings(model, measurements, group, k, out)
    _displace(x, out)
    if g > 0 and gain.any():
        linearise_reading(model, k, out.here, out.errors, count, out.points, predicted, out.slope)
    else:
        predicted[:] = 0.0
        out.slope[:] = 0.0
    _subtract(model, x, g, out)
    _whiten(root, out)
    equations = _gradient_equations(model, out.whole)
    if equations < g:
        _compress(out)
    total = splat(0.0)
    for i in range(equations, g):
        value = load(residual, 0, i)
        total += value * value
    store(out.squared, 0, 0, total)
    for i in range(equations):
        store(innovation, 0, i, load(residual, 0, i))
        for c in range(columns):
            total = splat(0.0)
            for j in range(moving):
                total += load(white, i, j) * load(b, j, c)
            store(rows, i, c, total)
        if model.bias >= 0:
            for c in range(i + 1):
                value = load(gain, 0, 0) * splat(root[i, c])
                store(rows, i, model.bias + c, value)
    if out.aiding_slope.shape[0] > 0:
        _linearise_others(model, root, group, count, k, x, equations, out)
    if out.whole:
        scale_equations(out)


@inlined
def take_readings(
    model: ModelArrays, measurements: np.ndarray, group: np.ndarray, k: int, out: Readings
) -> None:
    """Fill the readings of a group at epoch ``k`` and what they depend on, but for the states."""
    gather_rows(model.rows, group, k, out.b.shape[0], out.b)
    gather_row(measurements, group, k, out.z)
    arrive(model, group, k, out.here)


@compiled
def whiten_residuals(
    model: ModelArrays,
    noise_inverse: np.ndarray,
    group: np.ndarray,
    count: int,
    k: int,
    x: np.ndarray,
    out: Readings,
) -> None:
    """Fill ``out.residual``, z − h whitened by the given noise, at x: what needs no derivative.

    Of readings that :func:`take_readings` has filled; parameters as those of :func:`linearise`.
    """
    predicted, residual = out.predicted, out.residual
    g, m, width = out.slope.shape[0], residual.shape[1], residual.shape[2]
    root = noise_inverse[min(k, noise_inverse.shape[0] - 1)]
    _displace(x, out)
    if g > 0 and out.here.gain.any():
        by_channel = predicted.reshape((m, 1, width))[:g]
        read(model, k, out.here, out.errors, 1, count, out.points, by_channel)
    else:
        predicted[:] = 0.0
    if m > g:
        linearise_aiding(
            model.aiding, group, count, k, out.here.offset, x, predicted, out.aiding_slope
        )
    _subtract(model, x, m, out)
    for i in range(m - 1, -1, -1):
        total = splat(0.0)
        for c in range(i + 1):
            total += splat(root[i, c]) * load(residual, 0, c)
        store(residual, 0, i, total)


@inlined
def _displace(x: np.ndarray, out: Readings) -> None:
    """Fill B_k x."""
    for i in range(out.b.shape[0]):
        total = splat(0.0)
        for j in range(out.b.shape[1]):
            total += load(out.b, i, j) * load(x, 0, j)
        store(out.errors, i, 0, total)


@inlined
def _subtract(model: ModelArrays, x: np.ndarray, count: int, out: Readings) -> None:
    """Fill z − h(x) of the first ``count`` channels, the gradiometer's biases in h."""
    for i in range(count):
        total = load(out.z, 0, i) - load(out.predicted, 0, i)
        if model.bias >= 0 and i < out.slope.shape[0]:
            total -= load(out.here.gain, 0, 0) * load(x, 0, model.bias + i)
        store(out.residual, 0, i, total)


@compiled
def scale_equations(out: Readings) -> None:
    """Multiply the equations of a whole reading with their precision."""
    for c in range(out.rows.shape[0]):
        factor = load(out.precision, 0, c)
        store(out.innovation, 0, c, factor * load(out.innovation, 0, c))
        for j in range(out.rows.shape[1]):
            store(out.rows, c, j, factor * load(out.rows, c, j))


@compiled
def _linearise_others(
    model: ModelArrays,
    root: np.ndarray,
    group: np.ndarray,
    count: int,
    k: int,
    x: np.ndarray,
    equations: int,
    out: Readings,
) -> None:
    """Fill the equations of the aiding sensors, behind those of the gradiometer.

    Their noise is independent of the gradiometer's: ``root``, the inverse root of R, has two
    blocks.
    """
    slope, rows, innovation, aiding = out.aiding_slope, out.rows, out.innovation, model.aiding
    channels, first, columns = slope.shape[0], out.slope.shape[0], out.b.shape[1]
    linearise_aiding(aiding, group, count, k, out.here.offset, x, out.predicted, slope)
    for i in range(channels):
        place = equations + i
        for c in range(rows.shape[1]):
            store(rows, place, c, splat(0.0))
        total = splat(0.0)
        for d in range(i + 1):
            weight = splat(root[first + i, first + d])
            total += weight * (load(out.z, 0, first + d) - load(out.predicted, 0, first + d))
            for c in range(MOVED):
                store(rows, place, c, load(rows, place, c) + weight * load(slope, d, c))
        store(innovation, 0, place, total)
        for d in range(i + 1):
            for r in range(group.shape[0]):
                if aiding.present[group[r], k, d] != 0.0:
                    for j in range(columns, rows.shape[1]):
                        rows[place, j, r] += root[first + i, first + d] * column_of(aiding, d, j)


@compiled
def _whiten(noise_inverse: np.ndarray, out: Readings) -> None:
    """Multiply slope and residual by the inverse root of R."""
    slope, white, residual = out.slope, out.white, out.residual
    m, moving = white.shape[0], white.shape[1]
    for i in range(m - 1, -1, -1):
        total = splat(0.0)
        for c in range(i + 1):
            total += splat(noise_inverse[i, c]) * load(residual, 0, c)
        store(residual, 0, i, total)
        for j in range(moving):
            total = splat(0.0)
            for c in range(i + 1):
                total += splat(noise_inverse[i, c]) * load(slope, c, j)
            store(white, i, j, total)


@compiled
def _compress(out: Readings) -> None:
    """Turn m equations A e = residual + noise of unit variance into as many as e has numbers.

    By an orthogonal transformation (Householder): the first rows, upper triangular, hold all that
    the equations say about e; the residuals of the others say nothing.
    """
    slope, residual = out.white, out.residual
    m, columns = slope.shape[0], slope.shape[1]
    tiny = splat(_TINY)
    for j in range(columns):
        first = load(slope, j, j)
        norm = first * first
        for i in range(j + 1, m):
            value = load(slope, i, j)
            norm += value * value
        # v = column − norm e_j; vᵀv / 2 = norm² − norm · first
        signed = splat(0.0) - with_sign(math.sqrt(norm), first)
        scale = splat(1.0) / (norm - signed * first + tiny)
        store(slope, j, j, first - signed)
        for c in range(j + 1, columns):
            along = splat(0.0)
            for i in range(j, m):
                along += load(slope, i, j) * load(slope, i, c)
            along *= scale
            for i in range(j, m):
                store(slope, i, c, load(slope, i, c) - along * load(slope, i, j))
        along = splat(0.0)
        for i in range(j, m):
            along += load(slope, i, j) * load(residual, 0, i)
        along *= scale
        for i in range(j, m):
            store(residual, 0, i, load(residual, 0, i) - along * load(slope, i, j))
        store(slope, j, j, signed)
        for i in range(j + 1, m):
            store(slope, i, j, splat(0.0))


@compiled
def scatter_squares(reading: Readings, first: int, count: int, k: int, nis: np.ndarray) -> None:
    """Write the squares of the innovations of a group; NaN where there was no reading."""
    for r in range(count):
        there = reading.here.there[0, 0, r] != 0.0
        nis[first + r, k] = reading.squared[0, 0, r] if there else np.nan


def noise_inverse(block: ProblemBlock) -> np.ndarray:
    """Return the inverse (1 or K, m, m) of the lower triangular root of R."""
    return np.linalg.inv(np.linalg.cholesky(noise_covs(block)))


def noise_covs(block: ProblemBlock) -> np.ndarray:
    """Return R of all epochs, or of each: (1 or K, m, m)."""
    return block.noise_cov.reshape(-1, *block.noise_cov.shape[-2:])
