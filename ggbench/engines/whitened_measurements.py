"""Whitened linear measurement equations of eight runs, compiled."""

from __future__ import annotations

import math

import numpy as np

from ..block import ProblemBlock
from ..numerics.frozen import read_only
from ..numerics.kernels import compiled, copied, inlined
from ..numerics.lanes import count_from, gather_row, group_members, group_starts, lanes
from ..numerics.records import record
from ..numerics.vectors import load, splat, store, with_sign
from ..sensors.model_arrays import ModelArrays
from ..sensors.model_kernels import (
    Expansion,
    expand,
    expansion_of,
    load_expansion,
    moving_errors,
    predict_runs,
)

_TINY = 1e-300
"""What keeps 0 / 0 from being NaN where a reading is missing."""


@record
class Batch:
    """A block of R runs as arrays for compiled kernels.

    Attributes
    ----------
    model : arrays of h and H.
    measurements : (R, K, m) measurements z.
    present : (R, K, m) mask of available measurements.
    noise_cov : (1 or K, m, m) R.
    noise_inverse : (1 or K, m, m) inverse of the lower Cholesky factor of R.
    transition, process_cov : (R, K, n, n) Φ and Q.
    prior_mean : (1, n) mean state before the first epoch.
    prior_cov : (n, n) covariance before the first epoch.
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
    """Return the arrays of a block for compiled kernels."""
    noise_cov = block.noise_cov.reshape(-1, *block.noise_cov.shape[-2:])
    return Batch(
        model=block.model,
        measurements=block.measurements,
        present=block.present,
        noise_cov=noise_cov,
        noise_inverse=np.linalg.inv(np.linalg.cholesky(noise_cov)),
        transition=block.transition,
        process_cov=block.process_cov,
        prior_mean=block.prior_mean[np.newaxis],
        prior_cov=block.prior_cov,
    )


@record
class LinearisedMeasurement:
    """Linearised measurement of eight runs at an epoch, one run per lane.

    Attributes
    ----------
    expansion : h(x) and its derivative H, in units of the channels.
    there : (1, 1, lanes) the value one for a run with any available channel, else zero.
    z : (1, m, lanes) measurements.
    rows, innovation : (equations, n, lanes), (1, equations, lanes) whitened H and innovation of the
        equations H δx = innovation + noise of unit variance. There are at least three equations;
        unused equations are zero.
    precision : (1, equations, lanes) factors on the equations; ones by default. A factor is the
        assumed noise standard deviation, divided by an estimated or hypothetical one.
        :func:`linearise` applies the factors only if ``whole`` is true.
    squared : (1, 1, lanes) sum of squares of the part of the measurement that does not depend on
        the states.
    white : (g, moving, lanes) whitened derivative A of g gradients with respect to the instrument
        errors. These are position errors, and attitude errors if the gradiometer is strapdown.
        ``moving`` is the number of instrument errors.
    residual : (1, m, lanes) whitened z − h(x).
    whole : whether each channel has its own equation; otherwise equivalent equations are merged.
    """

    expansion: Expansion
    there: np.ndarray
    z: np.ndarray
    rows: np.ndarray
    innovation: np.ndarray
    precision: np.ndarray
    squared: np.ndarray
    white: np.ndarray
    residual: np.ndarray
    whole: bool


@compiled
def readings_of(batch: Batch, whole: bool = False) -> LinearisedMeasurement:
    """Return unfilled arrays for the measurements of eight runs.

    See :class:`LinearisedMeasurement` for ``whole``.
    """
    model, m, n = batch.model, batch.measurements.shape[2], batch.prior_cov.shape[0]
    moving, g = moving_errors(model.instrument), model.channels.shape[0]
    equations = max(gradient_equations(g, moving, model.first_linear, whole) + m - g, 3)
    precision = lanes(1, equations)
    precision[:] = 1.0
    return LinearisedMeasurement(
        expansion=expansion_of(model),
        there=lanes(1, 1),
        z=lanes(1, m),
        rows=lanes(equations, n),
        innovation=lanes(1, equations),
        precision=precision,
        squared=lanes(1, 1),
        white=lanes(g, moving),
        residual=lanes(1, m),
        whole=whole,
    )


@compiled
def gradient_equations(channels: int, moving: int, first_linear: int, whole: bool) -> int:
    """Return the number of measurement equations of the gradiometer.

    If the linear part of h does not affect the g gradient channels, they depend only on the
    instrument errors, see :func:`.moving_errors`. Their equations are then merged into at most
    ``moving`` equations, unless ``whole`` is true.

    Parameters
    ----------
    channels : number g of gradient channels.
    moving : number of instrument errors, from :func:`.moving_errors`.
    first_linear : see :class:`.ModelArrays`.
    whole : see :class:`LinearisedMeasurement`.
    """
    return channels if whole or first_linear < channels else min(channels, moving)


@compiled
def linearise(
    batch: Batch, group: np.ndarray, count: int, k: int, x: np.ndarray, out: LinearisedMeasurement
) -> None:
    """Fill the measurements of a group at epoch ``k``, linearised at x.

    The noise of the gradiometer must be independent of that of other sensors.

    Parameters
    ----------
    batch : arrays of all runs.
    group : (lanes,) index of the run in each lane; unused lanes repeat a run.
    count : number of different runs in the group.
    k : epoch.
    x : (1, n, lanes) linearisation points.
    out : output, see :class:`LinearisedMeasurement`.
    """
    model, m, g = batch.model, out.residual.shape[1], out.white.shape[0]
    root = batch.noise_inverse[min(k, batch.noise_inverse.shape[0] - 1)]
    gather_row(batch.measurements, group, k, out.z)
    _find_present(batch, group, k, out)
    expand(model, group, count, k, x, out.expansion)
    _whiten_residuals(root, out)
    _whiten_slope(root, out)
    moving = moving_errors(model.instrument)
    equations = gradient_equations(g, moving, model.first_linear, out.whole)
    if equations < g:
        _compress(out)
    total = splat(0.0)
    for i in range(equations, g):
        value = load(out.residual, 0, i)
        total += value * value
    store(out.squared, 0, 0, total)
    for i in range(equations):
        store(out.innovation, 0, i, load(out.residual, 0, i))
        _fill_row(model, root, i, i, out)
    for i in range(g, m):
        place = equations + i - g
        store(out.innovation, 0, place, load(out.residual, 0, i))
        _fill_row(model, root, i, place, out)
    if out.whole:
        scale_equations(out)


@inlined
def _find_present(batch: Batch, group: np.ndarray, k: int, out: LinearisedMeasurement) -> None:
    """Fill ``out.there`` with 1 for each run with an available channel, else with 0."""
    for r in range(group.shape[0]):
        present = batch.present[group[r], k]
        out.there[0, 0, r] = 0.0
        for c in range(present.shape[0]):
            if present[c]:
                out.there[0, 0, r] = 1.0


@inlined
def _fill_row(
    model: ModelArrays, root: np.ndarray, c: int, place: int, out: LinearisedMeasurement
) -> None:
    """Fill row ``place`` of H with row ``c`` of the whitened matrix A B_k + D.

    After :func:`_compress` the row is that of the compressed A B_k.
    """
    rows, white, b = out.rows, out.white, out.expansion.b
    linear, columns = out.expansion.linear, model.columns
    width = 0
    if c < white.shape[0]:
        width = b.shape[1]
        for j in range(width):
            total = splat(0.0)
            for i in range(white.shape[1]):
                total += load(white, c, i) * load(b, i, j)
            store(rows, place, j, total)
    for j in range(width, rows.shape[1]):
        store(rows, place, j, splat(0.0))
    for d in range(model.first_linear, c + 1):
        weight = root[c, d]
        if weight != 0.0:
            for s in range(columns.shape[0]):
                j = columns[s]
                value = load(rows, place, j) + splat(weight) * load(linear, d, j)
                store(rows, place, j, value)


@inlined
def take_readings(batch: Batch, group: np.ndarray, k: int, out: LinearisedMeasurement) -> None:
    """Load the measurements of a group (lanes,) at epoch ``k``, and the parameters of h."""
    gather_row(batch.measurements, group, k, out.z)
    load_expansion(batch.model, group, k, out.expansion)


@compiled
def whiten_residuals(
    batch: Batch, group: np.ndarray, count: int, k: int, x: np.ndarray, out: LinearisedMeasurement
) -> None:
    """Fill ``out.residual`` (1, m, lanes) with z − h(x), whitened with the noise covariance.

    H is not evaluated. Call :func:`take_readings` before, which loads z. The other parameters are
    those of :func:`linearise`.
    """
    predict_runs(batch.model, group, count, k, x, out.expansion)
    _whiten_residuals(batch.noise_inverse[min(k, batch.noise_inverse.shape[0] - 1)], out)


@compiled
def _residuals_along(batch: Batch, states: np.ndarray, residuals: np.ndarray) -> None:
    """Fill the residuals (R, K, m) of states (R, K, n)."""
    x, reading = lanes(1, states.shape[2]), readings_of(batch)
    for first in group_starts(states.shape[0]):
        count, group = count_from(first, states.shape[0]), group_members(first, states.shape[0])
        for k in range(states.shape[1]):
            gather_row(states, group, k, x)
            take_readings(batch, group, k, reading)
            predict_runs(batch.model, group, count, k, x, reading.expansion)
            for r in range(count):
                for c in range(residuals.shape[2]):
                    predicted = reading.expansion.predicted[0, c, r]
                    residuals[first + r, k, c] = reading.z[0, c, r] - predicted


def residuals_along(block: ProblemBlock, states: np.ndarray) -> np.ndarray:
    """Return z − h(x) (R, K, m) of a block at states (R, K, n); zero for missing measurements."""
    residuals = np.empty(block.measurements.shape)
    _residuals_along(batch_of(block), read_only(np.ascontiguousarray(states)), residuals)
    return residuals


@compiled
def scale_equations(out: LinearisedMeasurement) -> None:
    """Multiply H (m, n) and the innovation (1, m) by ``precision`` (1, m).

    Merged equations must have equal factors, see ``whole`` of :class:`LinearisedMeasurement`.
    """
    for c in range(out.rows.shape[0]):
        factor = load(out.precision, 0, c)
        store(out.innovation, 0, c, factor * load(out.innovation, 0, c))
        for j in range(out.rows.shape[1]):
            store(out.rows, c, j, factor * load(out.rows, c, j))


@inlined
def _whiten_residuals(root: np.ndarray, out: LinearisedMeasurement) -> None:
    """Fill ``out.residual`` with z − h(x), whitened by ``root``, the inverse factor of R."""
    predicted, residual = out.expansion.predicted, out.residual
    for i in range(residual.shape[1]):
        total = splat(0.0)
        for c in range(i + 1):
            total += splat(root[i, c]) * (load(out.z, 0, c) - load(predicted, 0, c))
        store(residual, 0, i, total)


@copied
def _whiten_slope(root: np.ndarray, out: LinearisedMeasurement) -> None:
    """Fill ``out.white`` with A, whitened by ``root``, the inverse Cholesky factor of R."""
    slope, white = out.expansion.slope, out.white
    for i in range(white.shape[0]):
        for j in range(white.shape[1]):
            total = splat(0.0)
            for c in range(i + 1):
                total += splat(root[i, c]) * load(slope, c, j)
            store(white, i, j, total)


@copied
def _compress(out: LinearisedMeasurement) -> None:
    """Reduce m equations A e = residual + unit noise to one equation for each component of e.

    An orthogonal transformation (Householder) makes A upper triangular. The first rows then contain
    all information on e. The residuals of the other rows do not depend on e.
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
def scatter_squares(
    reading: LinearisedMeasurement, first: int, count: int, k: int, nis: np.ndarray
) -> None:
    """Write the normalised innovation squared of each of ``count`` runs.

    Parameters
    ----------
    reading : linearised measurement of the group.
    first : index of the run in the first lane.
    count : number of runs.
    k : epoch.
    nis : (R, K) output; NaN where no channel is available.
    """
    for r in range(count):
        there = reading.there[0, 0, r] != 0.0
        nis[first + r, k] = reading.squared[0, 0, r] if there else np.nan
