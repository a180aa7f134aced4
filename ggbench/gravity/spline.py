"""Tensor-product cubic B-splines on a grid regular in latitude, longitude and height, compiled.

Coefficients interpolate the values at the nodes; the ends are not-a-knot.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.linalg import solve_banded

from ..numerics.kernels import compiled, copied, inlined


def spline_coefficients(values: np.ndarray, axis: int) -> np.ndarray:
    """Return uniform cubic B-spline coefficients that interpolate ``values`` along ``axis``.

    n nodes (n >= 4) give n + 2 coefficients; the two end conditions are not-a-knot (the third
    derivative is continuous across the second and the last but one node).
    """
    data = np.moveaxis(values, axis, 0)
    n = data.shape[0]
    right = np.zeros((n + 2, *data.shape[1:]))
    right[1:-1] = data
    band = np.zeros((9, n + 2))  # LAPACK's band storage, four diagonals on either side

    def put(row: int, column: int, value: float) -> None:
        band[4 + row - column, column] = value

    for offset, weight in enumerate((1.0, -4.0, 6.0, -4.0, 1.0)):
        put(0, offset, weight)
        put(n + 1, n - 3 + offset, weight)
    for row in range(1, n + 1):
        for column, weight in zip(range(row - 1, row + 2), (1 / 6, 4 / 6, 1 / 6), strict=True):
            put(row, column, weight)
    solved = solve_banded((4, 4), band, right.reshape(n + 2, -1))
    return np.ascontiguousarray(np.moveaxis(solved.reshape(right.shape), 0, axis))


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


@inlined
def _slopes(t: float, slope: np.ndarray) -> None:
    """Fill the derivatives of the four weights."""
    slope[0], slope[1], slope[2], slope[3] = _four_slopes(t)


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


@copied
def _sum_columns_and_slopes(
    flat: np.ndarray,
    size: int,
    start: int,
    row: int,
    column: int,
    weights: np.ndarray,
    out: np.ndarray,
    along_first: np.ndarray,
    along_second: np.ndarray,
) -> None:
    """Do :func:`_sum_columns`, and the same for the derivatives along the first two axes.

    ``weights`` (24,): of each axis the four weights and their four derivatives.
    """
    x_0, x_1, x_2, x_3 = weights[8], weights[9], weights[10], weights[11]
    y_0, y_1, y_2, y_3 = weights[12], weights[13], weights[14], weights[15]
    for a in range(4):
        c_0 = _UNSIGNED(start + a * row)
        c_1, c_2 = c_0 + _UNSIGNED(column), c_0 + _UNSIGNED(2 * column)
        c_3 = c_0 + _UNSIGNED(3 * column)
        weight, slope = weights[a], weights[4 + a]
        for c in range(_UNSIGNED(size)):
            f_0, f_1, f_2, f_3 = flat[c_0 + c], flat[c_1 + c], flat[c_2 + c], flat[c_3 + c]
            across = x_0 * f_0 + x_1 * f_1 + x_2 * f_2 + x_3 * f_3
            slope_across = y_0 * f_0 + y_1 * f_1 + y_2 * f_2 + y_3 * f_3
            if a == 0:
                out[c] = weight * across
                along_first[c] = slope * across
                along_second[c] = weight * slope_across
            else:
                out[c] += weight * across
                along_first[c] += slope * across
                along_second[c] += weight * slope_across


@inlined
def _along(columns: np.ndarray, weight: np.ndarray, m: int, count: int) -> float:
    """Return the sum along a column of component ``m`` of ``count``."""
    return (
        weight[0] * columns[m]
        + weight[1] * columns[count + m]
        + weight[2] * columns[2 * count + m]
        + weight[3] * columns[3 * count + m]
    )


@copied
def _spline(
    position: np.ndarray,
    origin: np.ndarray,
    step: np.ndarray,
    coefficients: np.ndarray,
    work: np.ndarray,
    out: np.ndarray,
    count: int,
) -> bool:
    """Fill ``out`` (4 count,): the values, then the three derivatives of each; see spline_at.

    ``work`` (24 + 12 count,) is scratch: to ask for it costs as much as to fill it.
    """
    weights = work[:24]
    start = 0
    inside = True
    for axis in range(3):
        nodes = coefficients.shape[axis]
        cell, t, within = _locate(position[axis], origin[axis], step[axis], nodes)
        if cell < 0:
            out[:] = math.nan
            return False
        start = start * nodes + cell
        _weights(t, weights[8 * axis :])
        slopes = weights[8 * axis + 4 : 8 * axis + 8]
        _slopes(t, slopes)
        scale = 1.0 / step[axis] if within else 0.0
        inside &= within
        for i in range(4):
            slopes[i] *= scale
    column = coefficients.shape[2] * count
    row = coefficients.shape[1] * column
    size = 4 * count
    sums = work[24 : 24 + size]
    along_first, along_second = work[24 + size : 24 + 2 * size], work[24 + 2 * size :]
    _sum_columns_and_slopes(
        coefficients.reshape(-1), size, start * count, row, column,
        weights, sums, along_first, along_second,
    )  # fmt: skip
    vertical, slopes = weights[16:20], weights[20:24]
    for m in range(count):
        out[m] = _along(sums, vertical, m, count)
        out[count + 3 * m] = _along(along_first, vertical, m, count)
        out[count + 3 * m + 1] = _along(along_second, vertical, m, count)
        out[count + 3 * m + 2] = _along(sums, slopes, m, count)
    return inside


TENSOR_WORK = 24 + 12 * 6
"""Length of the scratch of :func:`spline_tensor_at`."""


@compiled
def spline_tensor_at(
    position: np.ndarray,
    origin: np.ndarray,
    step: np.ndarray,
    coefficients: np.ndarray,
    work: np.ndarray,
    out: np.ndarray,
) -> bool:
    """Fill ``out`` (24,): a tensor and the three derivatives of each component; see spline_at.

    ``work`` (:data:`TENSOR_WORK`,) is scratch.
    """
    return _spline(position, origin, step, coefficients, work, out, 6)  # loops of known length


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
    value : (m,) output. derivative : (m, 3) output, per unit of each axis.

    Returns
    -------
    Whether the position lies inside the grid.
    """
    count = coefficients.shape[3]
    work, out = np.empty(24 + 12 * count), np.empty(4 * count)
    if count == 6:
        inside = spline_tensor_at(position, origin, step, coefficients, work, out)
    else:
        inside = _spline(position, origin, step, coefficients, work, out, count)
    for m in range(count):
        value[m] = out[m]
        for axis in range(3):
            derivative[m, axis] = out[count + 3 * m + axis]
    return inside


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
