"""Compiled tensor-product cubic B-splines on a grid of latitude, longitude and height.

The grid is regular along each axis. The spline interpolates the values at the nodes and has
not-a-knot end conditions.

The third coordinate of a draped grid is the height above a base surface B, a spline on the nodes of
the first two axes. The value is F(φ, λ, h) = S(φ, λ, h − B(φ, λ)) with the spline S. Derivatives
are those of F and follow from the chain rule. A base of size zero means level layers.
"""

from __future__ import annotations

import math

import numpy as np

from ..numerics.kernels import compiled, copied, inlined
from ..numerics.vectors import load_from, splat, store_from


def spline_coefficients(values: np.ndarray, axis: int) -> np.ndarray:
    """Return uniform cubic B-spline coefficients that interpolate values along an axis.

    Values d (..., n, ...), n >= 4, give coefficients c (..., n + 2, ...) in the same unit. They
    fulfil c[i−1] + 4 c[i] + c[i+1] = 6 d[i], a tridiagonal system. In these equations the indices
    of c begin at 0 and those of d at 1. The end conditions are not-a-knot: the third derivative is
    continuous across the second and the last but one node. This gives
    c[2] = (8 d[2] − d[1] − d[3]) / 6 and the mirrored equation at the other end.
    """
    n = values.shape[axis]
    before, after = math.prod(values.shape[:axis]), math.prod(values.shape[axis + 1 :])
    data = np.ascontiguousarray(values, dtype=float).reshape(before, n, after)
    coefficients = np.empty((*values.shape[:axis], n + 2, *values.shape[axis + 1 :]))
    _fill_coefficients(data, coefficients.reshape(before, n + 2, after))
    return coefficients


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
    """Return the cell along an axis, the fraction 0 <= t <= 1 in it, and a flag.

    The flag is True if the position is within the grid. A position outside is moved to the border.
    The cell of NaN is −1.
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
    """Return the four cubic B-spline weights at a fraction 0 <= t <= 1 of a cell."""
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


_SUMS = 24
"""Index of the first sum in the scratch array, after 24 weights and derivatives of three axes."""


@inlined
def _put_weights(t: float, scale: float, at: int, work: np.ndarray) -> None:
    """Write the four weights at a fraction t of a cell, and their derivatives, to ``work``.

    The weights begin at the index ``at``. The derivatives follow, multiplied by ``scale``.
    """
    weights, slopes = _four_weights(t), _four_slopes(t)
    for i in range(4):
        work[at + i], work[at + 4 + i] = weights[i], scale * slopes[i]


@inlined
def _sum_columns(flat: np.ndarray, start: int, row: int, column: int, work: np.ndarray) -> None:
    """Sum the 16 columns of nodes around a cell, weighted along the first two axes.

    A column has four nodes along the height with six components each: 24 contiguous numbers. Their
    weighted sums are written to ``work`` from index :data:`_SUMS` on. ``start``, ``row`` and
    ``column`` are results of :func:`_weigh`.
    """
    s_0 = s_1 = s_2 = splat(0.0)
    for a in range(4):
        for b in range(4):
            at, weight = start + a * row + b * column, splat(work[a] * work[8 + b])
            s_0 = s_0 + weight * load_from(flat, at)
            s_1 = s_1 + weight * load_from(flat, at + 8)
            s_2 = s_2 + weight * load_from(flat, at + 16)
    store_from(work, _SUMS, s_0)
    store_from(work, _SUMS + 8, s_1)
    store_from(work, _SUMS + 16, s_2)


@copied
def _sum_columns_and_slopes(
    flat: np.ndarray, start: int, row: int, column: int, work: np.ndarray
) -> None:
    """Sum columns as :func:`_sum_columns`, also for derivatives along the first two axes.

    Three groups of 24 sums are written to ``work`` from index :data:`_SUMS` on: value, derivative
    along the first axis, derivative along the second axis.
    """
    s_0 = s_1 = s_2 = n_0 = n_1 = n_2 = e_0 = e_1 = e_2 = splat(0.0)
    for a in range(4):
        for b in range(4):
            at = start + a * row + b * column
            f_0, f_1, f_2 = load_from(flat, at), load_from(flat, at + 8), load_from(flat, at + 16)
            weight = splat(work[a] * work[8 + b])
            north, east = splat(work[4 + a] * work[8 + b]), splat(work[a] * work[12 + b])
            s_0, s_1, s_2 = s_0 + weight * f_0, s_1 + weight * f_1, s_2 + weight * f_2
            n_0, n_1, n_2 = n_0 + north * f_0, n_1 + north * f_1, n_2 + north * f_2
            e_0, e_1, e_2 = e_0 + east * f_0, e_1 + east * f_1, e_2 + east * f_2
    store_from(work, _SUMS, s_0)
    store_from(work, _SUMS + 8, s_1)
    store_from(work, _SUMS + 16, s_2)
    store_from(work, _SUMS + 24, n_0)
    store_from(work, _SUMS + 32, n_1)
    store_from(work, _SUMS + 40, n_2)
    store_from(work, _SUMS + 48, e_0)
    store_from(work, _SUMS + 56, e_1)
    store_from(work, _SUMS + 64, e_2)


@inlined
def _up(work: np.ndarray, weights: int, sums: int, m: int, count: int) -> float:
    """Return component ``m`` of ``count`` components, summed along the third axis.

    ``weights`` is the index in ``work`` of the four weights, ``sums`` that of the column sums.
    """
    return (
        work[weights] * work[sums + m]
        + work[weights + 1] * work[sums + count + m]
        + work[weights + 2] * work[sums + 2 * count + m]
        + work[weights + 3] * work[sums + 3 * count + m]
    )


@compiled
def vector_at(
    position: np.ndarray,
    origin: np.ndarray,
    step: np.ndarray,
    coefficients: np.ndarray,
    base: np.ndarray,
    value: np.ndarray,
    derivative: np.ndarray,
) -> None:
    """Evaluate a spline of three components and its derivatives at one position.

    Outside the grid the value at the border is used, and the derivative across the border is zero.
    This extrapolation is continuous and gives estimators a value at trial points outside the map.

    Parameters
    ----------
    position, origin, step : (3,) position, first node and spacing of the grid: latitude, longitude
        [rad], height [m].
    coefficients : (n0 + 2, n1 + 2, n2 + 2, 3) B-spline coefficients.
    base : (n0 + 2, n1 + 2) B-spline coefficients of the base surface [m]; of size zero for level
        layers.
    value : (3,) output.
    derivative : (3, 3) output: derivative of each component with respect to latitude, longitude
        [1/rad] and height [1/m].
    """
    work, flat = np.empty(_SUMS + 36), coefficients.reshape(-1)
    start, row, column, base_north, base_east = _weigh(
        latitude=position[0],
        longitude=position[1],
        height=position[2],
        origin=origin,
        step=step,
        coefficients=coefficients,
        base=base,
        work=work,
    )
    if start < 0:
        value[:] = math.nan
        derivative[:] = math.nan
        return
    # A column of four nodes has twelve numbers: two vectors of eight that overlap.
    low = high = north_low = north_high = east_low = east_high = splat(0.0)
    for a in range(4):
        for b in range(4):
            at = start + a * row + b * column
            first, last = load_from(flat, at), load_from(flat, at + 4)
            weight = splat(work[a] * work[8 + b])
            north, east = splat(work[4 + a] * work[8 + b]), splat(work[a] * work[12 + b])
            low, high = low + weight * first, high + weight * last
            north_low, north_high = north_low + north * first, north_high + north * last
            east_low, east_high = east_low + east * first, east_high + east * last
    store_from(work, _SUMS, low)
    store_from(work, _SUMS + 4, high)
    store_from(work, _SUMS + 12, north_low)
    store_from(work, _SUMS + 16, north_high)
    store_from(work, _SUMS + 24, east_low)
    store_from(work, _SUMS + 28, east_high)
    for m in range(3):
        value[m] = _up(work, 16, _SUMS, m, 3)
        derivative[m, 0] = _up(work, 16, _SUMS + 12, m, 3)
        derivative[m, 1] = _up(work, 16, _SUMS + 24, m, 3)
        derivative[m, 2] = _up(work, 20, _SUMS, m, 3)
    if base.size > 0:
        for m in range(3):
            derivative[m, 0] -= base_north * derivative[m, 2]
            derivative[m, 1] -= base_east * derivative[m, 2]


@inlined
def _surface(base: np.ndarray, i: int, j: int, work: np.ndarray, rows: int, columns: int) -> float:
    """Return the weighted sum of the 16 base coefficients around the cell (i, j).

    ``rows`` and ``columns`` are the indices in ``work`` of the weights of the two axes. Terms are
    added in short independent chains for speed.
    """
    total = 0.0
    for a in range(4):
        first = work[columns] * base[i + a, j] + work[columns + 1] * base[i + a, j + 1]
        last = work[columns + 2] * base[i + a, j + 2] + work[columns + 3] * base[i + a, j + 3]
        total += work[rows + a] * (first + last)
    return total


@inlined
def _weigh(
    latitude: float,
    longitude: float,
    height: float,
    origin: np.ndarray,
    step: np.ndarray,
    coefficients: np.ndarray,
    base: np.ndarray,
    work: np.ndarray,
) -> tuple[int, int, int, float, float]:
    """Fill ``work`` with the weights of the three axes, and return indices of the nodes.

    For each axis ``work`` contains four weights and four derivatives.

    Returns
    -------
    Index of the first column of nodes in the flat coefficients, or −1 for NaN; index increments
    to the next column along the first and along the second axis; derivatives of the base surface
    along these two axes [m/rad].
    """
    shape = coefficients.shape
    column = shape[2] * shape[3]
    row = shape[1] * column
    i, t_0, in_0 = _locate(latitude, origin[0], step[0], shape[0])
    j, t_1, in_1 = _locate(longitude, origin[1], step[1], shape[1])
    if i < 0 or j < 0:
        return -1, row, column, 0.0, 0.0
    _put_weights(t_0, 1.0 / step[0] if in_0 else 0.0, 0, work)
    _put_weights(t_1, 1.0 / step[1] if in_1 else 0.0, 8, work)
    north = east = 0.0
    if base.size > 0:
        height -= _surface(base, i, j, work, 0, 8)
        north, east = _surface(base, i, j, work, 4, 8), _surface(base, i, j, work, 0, 12)
    k, t_2, in_2 = _locate(height, origin[2], step[2], shape[2])
    if k < 0:
        return -1, row, column, 0.0, 0.0
    _put_weights(t_2, 1.0 / step[2] if in_2 else 0.0, 16, work)
    return i * row + j * column + k * shape[3], row, column, north, east


TENSOR_WORK = _SUMS + 3 * 24
"""Length of the scratch of :func:`spline_tensor_slopes`."""


@compiled
def spline_tensor_slopes(
    positions: np.ndarray,
    count: int,
    origin: np.ndarray,
    step: np.ndarray,
    coefficients: np.ndarray,
    base: np.ndarray,
    work: np.ndarray,
    out: np.ndarray,
) -> None:
    """Fill ``out`` (24, N) with tensors and their derivatives at some of N positions.

    Rows 0 to 5 are the six tensor components [E]. Rows 6 + 3m, 7 + 3m and 8 + 3m are the
    derivatives of component m with respect to latitude, longitude [E/rad] and height [E/m].

    Parameters
    ----------
    positions : (3, N) [rad, rad, m], of which the first ``count`` are evaluated.
    origin, step, coefficients, base : as in :func:`vector_at`, with six components.
    work : (:data:`TENSOR_WORK`,) scratch.
    out : (24, N) output.
    """
    flat = coefficients.reshape(-1)
    for p in range(count):
        start, row, column, north, east = _weigh(
            latitude=positions[0, p],
            longitude=positions[1, p],
            height=positions[2, p],
            origin=origin,
            step=step,
            coefficients=coefficients,
            base=base,
            work=work,
        )
        if start < 0:
            out[:, p] = math.nan
            continue
        _sum_columns_and_slopes(flat, start, row, column, work)
        for m in range(6):
            out[m, p] = _up(work, 16, _SUMS, m, 6)
            out[6 + 3 * m, p] = _up(work, 16, _SUMS + 24, m, 6)
            out[7 + 3 * m, p] = _up(work, 16, _SUMS + 48, m, 6)
            out[8 + 3 * m, p] = _up(work, 20, _SUMS, m, 6)
        if base.size > 0:
            for m in range(6):
                out[6 + 3 * m, p] -= north * out[8 + 3 * m, p]
                out[7 + 3 * m, p] -= east * out[8 + 3 * m, p]


@compiled
def spline_tensors(
    positions: np.ndarray,
    count: int,
    origin: np.ndarray,
    step: np.ndarray,
    coefficients: np.ndarray,
    base: np.ndarray,
    out: np.ndarray,
) -> None:
    """Fill ``out`` (6, N) with tensors at the first ``count`` of N positions, without derivatives.

    ``positions`` are (3, N) [rad, rad, m]. A NaN position gives NaN. Outside the grid the value at
    the border is used, as in :func:`vector_at`.
    """
    flat, work = coefficients.reshape(-1), np.empty(_SUMS + 24)
    for p in range(count):
        start, row, column, _, _ = _weigh(
            latitude=positions[0, p],
            longitude=positions[1, p],
            height=positions[2, p],
            origin=origin,
            step=step,
            coefficients=coefficients,
            base=base,
            work=work,
        )
        if start < 0:
            out[:, p] = math.nan
            continue
        _sum_columns(flat, start, row, column, work)
        for m in range(6):
            out[m, p] = _up(work, 16, _SUMS, m, 6)


@compiled
def surface_heights(
    positions: np.ndarray, origin: np.ndarray, step: np.ndarray, base: np.ndarray, out: np.ndarray
) -> None:
    """Fill ``out`` (N,) with heights of a base surface [m] at positions (N, 3).

    Outside the grid the height at the border is used.
    """
    work = np.empty(16)
    for p in range(positions.shape[0]):
        i, t_0, _ = _locate(positions[p, 0], origin[0], step[0], base.shape[0])
        j, t_1, _ = _locate(positions[p, 1], origin[1], step[1], base.shape[1])
        if i < 0 or j < 0:
            out[p] = math.nan
            continue
        _put_weights(t_0, 0.0, 0, work)
        _put_weights(t_1, 0.0, 8, work)
        out[p] = _surface(base, i, j, work, 0, 8)
