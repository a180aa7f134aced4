"""Tensor-product cubic B-splines on a grid regular in latitude, longitude and height, compiled.

Coefficients interpolate the values at the nodes; the ends are not-a-knot.
"""

from __future__ import annotations

import math

import numpy as np

from ..numerics.kernels import compiled, copied, inlined


def spline_coefficients(values: np.ndarray, axis: int) -> np.ndarray:
    """Return uniform cubic B-spline coefficients that interpolate ``values`` along ``axis``.

    n nodes (n >= 4) give n + 2 coefficients c; the two end conditions are not-a-knot (the third
    derivative is continuous across the second and the last but one node). With
    c[i−1] + 4 c[i] + c[i+1] = 6 d[i], they are c[2] = (8 d[2] − d[1] − d[3]) / 6 and its mirror
    image; what lies between is tridiagonal.
    """
    n = values.shape[axis]
    before, after = math.prod(values.shape[:axis]), math.prod(values.shape[axis + 1 :])
    data = np.ascontiguousarray(values, dtype=float).reshape(before, n, after)
    found = np.empty((*values.shape[:axis], n + 2, *values.shape[axis + 1 :]))
    _fill_coefficients(data, found.reshape(before, n + 2, after))
    return found


@compiled
def _fill_coefficients(data: np.ndarray, found: np.ndarray) -> None:
    """Fill the coefficients (a, n + 2, b) that interpolate data (a, n, b) along the second axis."""
    n = data.shape[1]
    factors = np.zeros(n + 2)
    for i in range(3, n - 1):
        factors[i] = 1.0 / (4.0 - factors[i - 1])
    for a in range(data.shape[0]):
        d, c = data[a], found[a]
        for b in range(d.shape[1]):
            c[2, b] = (8.0 * d[1, b] - d[0, b] - d[2, b]) / 6.0
            c[n - 1, b] = (8.0 * d[n - 2, b] - d[n - 1, b] - d[n - 3, b]) / 6.0
        for i in range(3, n - 1):
            for b in range(d.shape[1]):
                c[i, b] = (6.0 * d[i - 1, b] - c[i - 1, b]) * factors[i]
        for i in range(n - 2, 2, -1):
            for b in range(d.shape[1]):
                c[i, b] -= factors[i] * c[i + 1, b]
        for b in range(d.shape[1]):
            c[1, b] = 6.0 * d[1, b] - 4.0 * c[2, b] - c[3, b]
            c[0, b] = 6.0 * d[0, b] - 4.0 * c[1, b] - c[2, b]
            c[n, b] = 6.0 * d[n - 2, b] - 4.0 * c[n - 1, b] - c[n - 2, b]
            c[n + 1, b] = 6.0 * d[n - 1, b] - 4.0 * c[n, b] - c[n - 1, b]


@inlined
def _locate(position: float, origin: float, step: float, nodes: int) -> tuple[int, float, bool]:
    """Return the cell along an axis, the place 0 <= t <= 1 in it, and whether the grid has it.

    A position outside is moved to the border; the cell of NaN is −1.
    """
    u = (position - origin) / step
    if math.isnan(u):  # it must not become an index, nor a number
        return -1, math.nan, False
    cells = nodes - 3
    clamped = min(max(u, 0.0), float(cells))
    cell = min(int(clamped), cells - 1)
    # Half a millionth of a cell: a border node computed in another order is inside.
    return cell, clamped - cell, abs(u - clamped) <= 5e-7


@inlined
def _four_weights(t: float) -> tuple[float, float, float, float]:
    """Return the four cubic B-spline weights at 0 <= t <= 1 of a cell."""
    u = 1.0 - t
    return (
        u * u * u * (1.0 / 6.0),
        (4.0 + t * t * (3.0 * t - 6.0)) * (1.0 / 6.0),
        (4.0 + u * u * (3.0 * u - 6.0)) * (1.0 / 6.0),
        t * t * t * (1.0 / 6.0),
    )


@inlined
def _four_slopes(t: float) -> tuple[float, float, float, float]:
    """Return the derivatives of the four weights."""
    u = 1.0 - t
    return -0.5 * u * u, t * (1.5 * t - 2.0), u * (2.0 - 1.5 * u), 0.5 * t * t


@inlined
def _weights(t: float, weight: np.ndarray) -> None:
    """Fill the four weights."""
    weight[0], weight[1], weight[2], weight[3] = _four_weights(t)


_UNSIGNED = np.uint64
"""An index that cannot be negative: one that could be would keep a loop from running on vectors."""


@copied
def _sum_columns(
    flat: np.ndarray,
    size: int,
    start: int,
    row: int,
    column: int,
    first: np.ndarray,
    second: np.ndarray,
    out: np.ndarray,
) -> None:
    """Sum the 16 columns of nodes around a cell with the weights ``first`` ⊗ ``second``.

    The four nodes of a column, with all their components, are contiguous, so that ``out`` is one
    sum of ``size`` numbers. ``start`` is where the first column begins in the flat coefficients,
    ``row`` and ``column`` how far it is to the next one along the first and the second axis.
    """
    for a in range(4):
        c_0 = _UNSIGNED(start + a * row)
        c_1, c_2 = c_0 + _UNSIGNED(column), c_0 + _UNSIGNED(2 * column)
        c_3 = c_0 + _UNSIGNED(3 * column)
        w_0, w_1 = first[a] * second[0], first[a] * second[1]
        w_2, w_3 = first[a] * second[2], first[a] * second[3]
        for c in range(_UNSIGNED(size)):
            total = (
                w_0 * flat[c_0 + c] + w_1 * flat[c_1 + c]
                + w_2 * flat[c_2 + c] + w_3 * flat[c_3 + c]
            )  # fmt: skip
            out[c] = total if a == 0 else out[c] + total


@inlined
def _along(columns: np.ndarray, weight: np.ndarray, m: int, count: int) -> float:
    """Return the sum along a column of component ``m`` of ``count``."""
    return (
        weight[0] * columns[m]
        + weight[1] * columns[count + m]
        + weight[2] * columns[2 * count + m]
        + weight[3] * columns[3 * count + m]
    )


_SUMS = 24
"""Where in the scratch of a point the sums along columns begin, after the weights of its axes."""


@inlined
def _put_weights(t: float, scale: float, at: int, work: np.ndarray) -> None:
    """Put the four weights at a place of a cell, and their derivatives, into the scratch."""
    weights, slopes = _four_weights(t), _four_slopes(t)
    for i in range(4):
        work[at + i], work[at + 4 + i] = weights[i], scale * slopes[i]


@copied
def _sum_columns_and_slopes(
    flat: np.ndarray, start: int, row: int, column: int, size: int, work: np.ndarray
) -> None:
    """Do :func:`_sum_columns` with the scratch's weights, and for the slopes of the first two axes.

    The three sums of ``size`` numbers follow each other from :data:`_SUMS` on. One array for all
    that is read and written here: to make views of it would cost as much as the sums.
    """
    x_0, x_1, x_2, x_3 = work[8], work[9], work[10], work[11]
    y_0, y_1, y_2, y_3 = work[12], work[13], work[14], work[15]
    for a in range(4):
        c_0 = _UNSIGNED(start + a * row)
        c_1, c_2 = c_0 + _UNSIGNED(column), c_0 + _UNSIGNED(2 * column)
        c_3 = c_0 + _UNSIGNED(3 * column)
        weight, slope = work[a], work[4 + a]
        for c in range(_UNSIGNED(size)):
            f_0, f_1, f_2, f_3 = flat[c_0 + c], flat[c_1 + c], flat[c_2 + c], flat[c_3 + c]
            across = x_0 * f_0 + x_1 * f_1 + x_2 * f_2 + x_3 * f_3
            slope_across = y_0 * f_0 + y_1 * f_1 + y_2 * f_2 + y_3 * f_3
            s_0 = c + _UNSIGNED(_SUMS)
            s_1, s_2 = s_0 + _UNSIGNED(size), s_0 + _UNSIGNED(2 * size)
            if a == 0:
                work[s_0] = weight * across
                work[s_1] = slope * across
                work[s_2] = weight * slope_across
            else:
                work[s_0] += weight * across
                work[s_1] += slope * across
                work[s_2] += weight * slope_across


@inlined
def _up(work: np.ndarray, weights: int, sums: int, m: int, count: int) -> float:
    """Return the sum along a column of component ``m`` of ``count``, from sums in the scratch."""
    return (
        work[weights] * work[sums + m]
        + work[weights + 1] * work[sums + count + m]
        + work[weights + 2] * work[sums + 2 * count + m]
        + work[weights + 3] * work[sums + 3 * count + m]
    )


@copied
def _evaluate(
    latitude: float,
    longitude: float,
    height: float,
    origin: np.ndarray,
    step: np.ndarray,
    coefficients: np.ndarray,
    flat: np.ndarray,
    work: np.ndarray,
    count: int,
) -> bool:
    """Evaluate the spline of ``count`` components at a point; see :func:`spline_at`.

    ``work`` (24 + 16 count,) is scratch, whose last 4 count numbers are then the values and the
    three derivatives of each. ``flat`` are the coefficients in one row.
    """
    shape, size = coefficients.shape, 4 * count
    result = _SUMS + 3 * size
    i, t_0, in_0 = _locate(latitude, origin[0], step[0], shape[0])
    j, t_1, in_1 = _locate(longitude, origin[1], step[1], shape[1])
    k, t_2, in_2 = _locate(height, origin[2], step[2], shape[2])
    if i < 0 or j < 0 or k < 0:
        for m in range(size):
            work[result + m] = math.nan
        return False
    _put_weights(t_0, 1.0 / step[0] if in_0 else 0.0, 0, work)
    _put_weights(t_1, 1.0 / step[1] if in_1 else 0.0, 8, work)
    _put_weights(t_2, 1.0 / step[2] if in_2 else 0.0, 16, work)
    column = shape[2] * count
    row = shape[1] * column
    _sum_columns_and_slopes(flat, i * row + j * column + k * count, row, column, size, work)
    for m in range(count):
        work[result + m] = _up(work, 16, _SUMS, m, count)
        at = result + count + 3 * m
        work[at] = _up(work, 16, _SUMS + size, m, count)
        work[at + 1] = _up(work, 16, _SUMS + 2 * size, m, count)
        work[at + 2] = _up(work, 20, _SUMS, m, count)
    return in_0 and in_1 and in_2


@compiled
def spline_at(
    position: np.ndarray,
    origin: np.ndarray,
    step: np.ndarray,
    coefficients: np.ndarray,
    value: np.ndarray,
    derivative: np.ndarray,
) -> bool:
    """Evaluate the spline and its derivatives at one (latitude, longitude, height).

    Outside the grid the value at its border is kept and the derivative across it is zero: an
    estimator's trial point must have a number, and this one is continuous.

    Parameters
    ----------
    position, origin, step : (3,) in the units of the grid's three axes.
    coefficients : (n0 + 2, n1 + 2, n2 + 2, m).
    value : (m,) output.
    derivative : (m, 3) output, per unit of each axis.

    Returns
    -------
    Whether the position lies inside the grid.
    """
    count = coefficients.shape[3]
    work, flat = np.empty(_SUMS + 16 * count), coefficients.reshape(-1)
    inside = _evaluate(
        position[0], position[1], position[2], origin, step, coefficients, flat, work, count
    )
    for m in range(count):
        value[m] = work[_SUMS + 12 * count + m]
        for axis in range(3):
            derivative[m, axis] = work[_SUMS + 13 * count + 3 * m + axis]
    return inside


TENSOR_WORK = _SUMS + 16 * 6
"""Length of the scratch of :func:`spline_tensor_slopes`."""


@compiled
def spline_tensor_slopes(
    positions: np.ndarray,
    count: int,
    origin: np.ndarray,
    step: np.ndarray,
    coefficients: np.ndarray,
    work: np.ndarray,
    out: np.ndarray,
) -> None:
    """Fill (24, N): tensors and the three derivatives of each component, at some of N positions.

    Parameters
    ----------
    positions : (3, N), of which the first ``count`` are evaluated.
    origin, step, coefficients : as in :func:`spline_at`, of six components.
    work : (:data:`TENSOR_WORK`,) scratch.
    out : output.
    """
    flat = coefficients.reshape(-1)
    for p in range(count):
        # Sizes that are constants make loops of known length.
        _evaluate(
            positions[0, p], positions[1, p], positions[2, p], origin, step, coefficients, flat,
            work, 6,
        )  # fmt: skip
        for m in range(24):
            out[m, p] = work[_SUMS + 72 + m]


@compiled
def spline_tensors(
    positions: np.ndarray,
    count: int,
    origin: np.ndarray,
    step: np.ndarray,
    coefficients: np.ndarray,
    out: np.ndarray,
) -> None:
    """Fill the tensors (6, N) at the first ``count`` of N positions (3, N), without derivatives.

    NaN where a position is; else as :func:`spline_at` has them.
    """
    flat = coefficients.reshape(-1)
    weights = np.empty((3, 4))
    columns = np.empty(24)
    shape = coefficients.shape
    column = shape[2] * 6
    row = shape[1] * column
    for p in range(count):
        i, t_0, _ = _locate(positions[0, p], origin[0], step[0], shape[0])
        j, t_1, _ = _locate(positions[1, p], origin[1], step[1], shape[1])
        k, t_2, _ = _locate(positions[2, p], origin[2], step[2], shape[2])
        if i < 0 or j < 0 or k < 0:
            out[:, p] = math.nan
            continue
        _weights(t_0, weights[0])
        _weights(t_1, weights[1])
        _weights(t_2, weights[2])
        start = i * row + j * column + k * 6
        _sum_columns(flat, 24, start, row, column, weights[0], weights[1], columns)
        for m in range(6):
            out[m, p] = _along(columns, weights[2], m, 6)
