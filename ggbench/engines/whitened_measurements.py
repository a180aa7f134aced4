"""Whitened linear measurement equations of eight runs, compiled."""

from __future__ import annotations

import math

import numpy as np

from ..block import ProblemBlock
from ..numerics.frozen import read_only
from ..numerics.kernels import compiled, copied, inlined
from ..numerics.lanes import count_from, gather_row, gather_rows, lanes, members, starts
from ..numerics.records import record
from ..numerics.vectors import load, splat, store, with_sign
from ..sensors.aiding_kernels import INS_STATES, MOVED, column_of, linearise_aiding
from ..sensors.model_arrays import (
    EpochContext,
    ModelArrays,
    PointScratch,
    epoch_context,
    load_epoch,
    point_scratch,
)
from ..sensors.model_kernels import linearise_reading, moving_errors, read

_TINY = 1e-300
"""What keeps 0 / 0 from being NaN where a reading is missing."""


@record
class Batch:
    """A block of runs as the arrays that kernels take.

    Attributes
    ----------
    model : arrays of h and H.
    measurements : (R, K, m).
    present : (R, K, m) which channels deliver.
    noise_cov : (1 or K, m, m) R.
    noise_inverse : (1 or K, m, m) inverse of the lower triangular root of R.
    transition, process_cov : (R, K, n, n) Φ and Q.
    prior_mean : (1, n).
    prior_cov : (n, n).
    """

    model: ModelArrays
    measurements: np.ndarray
    present: np.ndarray
    noise_cov: np.ndarray
    noise_inverse: np.ndarray
    transition: np.ndarray
    process_cov: np.ndarray
    prior_mean: np.ndarray
    prior_cov: np.ndarray


def batch_of(block: ProblemBlock) -> Batch:
    """Return the arrays of a block."""
    noise_cov = block.noise_cov.reshape(-1, *block.noise_cov.shape[-2:])
    return Batch(
        block.model, block.measurements, block.present, noise_cov,
        np.linalg.inv(np.linalg.cholesky(noise_cov)), block.transition, block.process_cov,
        block.prior_mean[np.newaxis], block.prior_cov,
    )  # fmt: skip


@record
class Readings:
    """The readings of eight runs at an epoch, linearised; arrays that :func:`linearise` fills.

    Attributes
    ----------
    slope : (g, 6, lanes) A, of the gradiometer's h by the errors B_k x [E/m; E/rad]; ``moving``
        columns are used.
    aiding_slope : (e, 9, lanes) of the other channels, by the first states.
    b : (moving, 15 or more, lanes) B_k, as many rows as there are errors that h depends on.
    errors : (6, 1, lanes) B_k x.
    context : INS solution and gains; the gain is that of biases, too: zero where none came.
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
    context: EpochContext
    z: np.ndarray
    predicted: np.ndarray
    rows: np.ndarray
    innovation: np.ndarray
    precision: np.ndarray
    squared: np.ndarray
    white: np.ndarray
    residual: np.ndarray
    points: PointScratch
    whole: bool


@compiled
def readings_of(batch: Batch, whole: bool = False) -> Readings:
    """Return unfilled arrays for the readings of eight runs.

    With ``whole`` each channel keeps an equation of its own; else equivalent ones are merged.
    """
    model, m, n = batch.model, batch.measurements.shape[2], batch.prior_cov.shape[0]
    moving, g = moving_errors(model), model.channels.shape[0]
    equations = max(_gradient_equations(model, whole) + m - g, 3)
    precision = lanes(1, equations)
    precision[:] = 1.0
    return Readings(
        lanes(g, 6), lanes(m - g, MOVED), lanes(moving, model.rows.shape[3]), lanes(6, 1),
        epoch_context(model), lanes(1, m), lanes(1, m), lanes(equations, n), lanes(1, equations),
        precision, lanes(1, 1), lanes(g, moving), lanes(1, m), point_scratch(1), whole,
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
    batch: Batch, group: np.ndarray, count: int, k: int, x: np.ndarray, out: Readings
) -> None:
    """Fill the readings of a group at epoch ``k``, linearised at x.

    Parameters
    ----------
    batch : of all runs.
    group : (lanes,) runs, of which ``count`` differ.
    k : epoch.
    x : (1, n, lanes).
    out : output.
    """
    model = batch.model
    b, context, predicted = out.b, out.context, out.predicted
    rows, residual, white, innovation = out.rows, out.residual, out.white, out.innovation
    g, moving, columns = out.slope.shape[0], b.shape[0], b.shape[1]
    root = batch.noise_inverse[min(k, batch.noise_inverse.shape[0] - 1)]
    take_readings(batch, group, k, out)
    _displace(x, out)
    if g > 0 and context.gain.any():
        linearise_reading(model, k, context, out.errors, count, out.points, predicted, out.slope)
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
                value = load(context.gain, 0, 0) * splat(root[i, c])
                store(rows, i, model.bias + c, value)
    if out.aiding_slope.shape[0] > 0:
        _linearise_others(model, root, group, count, k, x, equations, out)
    if out.whole:
        scale_equations(out)


@inlined
def take_readings(batch: Batch, group: np.ndarray, k: int, out: Readings) -> None:
    """Fill the readings of a group at epoch ``k`` and what they depend on, but for the states."""
    gather_rows(batch.model.rows, group, k, out.b.shape[0], out.b)
    gather_row(batch.measurements, group, k, out.z)
    load_epoch(batch.model, group, k, out.context)


@compiled
def whiten_residuals(
    batch: Batch, group: np.ndarray, count: int, k: int, x: np.ndarray, out: Readings
) -> None:
    """Fill ``out.residual``, z − h whitened by the given noise, at x: what needs no derivative.

    Of readings that :func:`take_readings` has filled; parameters as those of :func:`linearise`.
    """
    residual = out.residual
    root = batch.noise_inverse[min(k, batch.noise_inverse.shape[0] - 1)]
    _fill_residuals(batch, group, count, k, x, out)
    for i in range(residual.shape[1] - 1, -1, -1):
        total = splat(0.0)
        for c in range(i + 1):
            total += splat(root[i, c]) * load(residual, 0, c)
        store(residual, 0, i, total)


@compiled
def _fill_residuals(
    batch: Batch, group: np.ndarray, count: int, k: int, x: np.ndarray, out: Readings
) -> None:
    """Fill ``out.residual``, z − h at x; parameters as those of :func:`whiten_residuals`."""
    model, predicted = batch.model, out.predicted
    g, m, width = out.slope.shape[0], out.residual.shape[1], out.residual.shape[2]
    _displace(x, out)
    if g > 0 and out.context.gain.any():
        by_channel = predicted.reshape((m, 1, width))[:g]
        read(model, k, out.context, out.errors, 1, count, out.points, by_channel)
    else:
        predicted[:] = 0.0
    if m > g:
        linearise_aiding(
            model.aiding, group, count, k, out.context.offset, x, predicted, out.aiding_slope
        )
    _subtract(model, x, m, out)


@compiled
def _residuals_along(batch: Batch, states: np.ndarray, residuals: np.ndarray) -> None:
    """Fill the residuals (R, K, m) of states (R, K, n)."""
    x, reading = lanes(1, states.shape[2]), readings_of(batch)
    for first in starts(states.shape[0]):
        count, group = count_from(first, states.shape[0]), members(first, states.shape[0])
        for k in range(states.shape[1]):
            gather_row(states, group, k, x)
            take_readings(batch, group, k, reading)
            _fill_residuals(batch, group, count, k, x, reading)
            for r in range(count):
                residuals[first + r, k] = reading.residual[0, :, r]


def residuals_along(block: ProblemBlock, states: np.ndarray) -> np.ndarray:
    """Return z − h(x) (R, K, m) of a block of runs at states (R, K, n), zero where none came."""
    residuals = np.empty(block.measurements.shape)
    _residuals_along(batch_of(block), read_only(np.ascontiguousarray(states)), residuals)
    return residuals


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
            total -= load(out.context.gain, 0, 0) * load(x, 0, model.bias + i)
        store(out.residual, 0, i, total)


@compiled
def scale_equations(out: Readings) -> None:
    """Multiply the equations of a whole reading with their precision."""
    for c in range(out.rows.shape[0]):
        factor = load(out.precision, 0, c)
        store(out.innovation, 0, c, factor * load(out.innovation, 0, c))
        for j in range(out.rows.shape[1]):
            store(out.rows, c, j, factor * load(out.rows, c, j))


@copied
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
    channels, first = slope.shape[0], out.slope.shape[0]
    linearise_aiding(aiding, group, count, k, out.context.offset, x, out.predicted, slope)
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
                    for j in range(INS_STATES, rows.shape[1]):
                        value = column_of(aiding, group[r], k, d, j)
                        rows[place, j, r] += root[first + i, first + d] * value


@copied
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


@copied
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
        there = reading.context.there[0, 0, r] != 0.0
        nis[first + r, k] = reading.squared[0, 0, r] if there else np.nan
