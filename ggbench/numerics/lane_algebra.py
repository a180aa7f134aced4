"""Compiled linear algebra of filters and smoothers, for eight runs at once.

Matrices have the layout of :mod:`.lanes`: the run (lane) is the last axis, and docstrings omit this
axis. There are n states and m measurement equations. Both numbers are at least three; unused
equations are zero. Measurements are whitened: the noise of each equation has unit variance. One
half of a symmetric matrix is computed and copied to the other half. No step mixes lanes, so the
result of a run is bitwise independent of the other runs.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from .kernels import compiled, inlined
from .vectors import load, splat, store

_ROUNDING = 1e-14
"""Largest pivot, relative to its variance, that is attributed to rounding errors."""
Tile = tuple[Any, Any, Any, Any, Any, Any, Any, Any, Any]
"""Vectors of three by three elements, row by row."""


@inlined
def _row_products(a: np.ndarray, i: int, b: np.ndarray, j: int) -> Tile:
    """Return the products of rows i, i + 1, i + 2 of A (., n) and rows j, j + 1, j + 2 of B."""
    t_00 = t_01 = t_02 = t_10 = t_11 = t_12 = t_20 = t_21 = t_22 = splat(0.0)
    for k in range(b.shape[1]):
        b_0, b_1, b_2 = load(b, j, k), load(b, j + 1, k), load(b, j + 2, k)
        value = load(a, i, k)
        t_00 += value * b_0
        t_01 += value * b_1
        t_02 += value * b_2
        value = load(a, i + 1, k)
        t_10 += value * b_0
        t_11 += value * b_1
        t_12 += value * b_2
        value = load(a, i + 2, k)
        t_20 += value * b_0
        t_21 += value * b_1
        t_22 += value * b_2
    return t_00, t_01, t_02, t_10, t_11, t_12, t_20, t_21, t_22


@inlined
def _column_products(a: np.ndarray, i: int, b: np.ndarray, j: int) -> Tile:
    """Return the products of columns i, i + 1, i + 2 of A (m, .) and j, j + 1, j + 2 of B."""
    t_00 = t_01 = t_02 = t_10 = t_11 = t_12 = t_20 = t_21 = t_22 = splat(0.0)
    for k in range(b.shape[0]):
        b_0, b_1, b_2 = load(b, k, j), load(b, k, j + 1), load(b, k, j + 2)
        value = load(a, k, i)
        t_00 += value * b_0
        t_01 += value * b_1
        t_02 += value * b_2
        value = load(a, k, i + 1)
        t_10 += value * b_0
        t_11 += value * b_1
        t_12 += value * b_2
        value = load(a, k, i + 2)
        t_20 += value * b_0
        t_21 += value * b_1
        t_22 += value * b_2
    return t_00, t_01, t_02, t_10, t_11, t_12, t_20, t_21, t_22


@compiled
def copy(source: np.ndarray, out: np.ndarray) -> None:
    """Copy the matrix ``source`` (rows, columns) to ``out``."""
    for i in range(source.shape[0]):
        for j in range(source.shape[1]):
            store(out, i, j, load(source, i, j))


@compiled
def products_of_rows(a: np.ndarray, count: int, b: np.ndarray, out: np.ndarray) -> None:
    """Fill the first ``count`` rows of ``out`` with those of A Bᵀ.

    Parameters
    ----------
    a, b : matrices A (count or more, n) and B (rows, n), each with three rows or more.
    count : number of rows to fill, three or more.
    out : (count or more, rows) output.
    """
    rows = b.shape[0]
    for i_0 in range(0, count, 3):
        i = min(i_0, count - 3)  # the last tile may overlap
        for j_0 in range(0, rows, 3):
            j = min(j_0, rows - 3)
            t_00, t_01, t_02, t_10, t_11, t_12, t_20, t_21, t_22 = _row_products(a, i, b, j)
            store(out, i, j, t_00)
            store(out, i, j + 1, t_01)
            store(out, i, j + 2, t_02)
            store(out, i + 1, j, t_10)
            store(out, i + 1, j + 1, t_11)
            store(out, i + 1, j + 2, t_12)
            store(out, i + 2, j, t_20)
            store(out, i + 2, j + 1, t_21)
            store(out, i + 2, j + 2, t_22)


@inlined
def _put(out: np.ndarray, i: int, j: int, value: Any) -> None:
    """Set an element of the lower half of a symmetric matrix, and its mirror image."""
    if j <= i:
        store(out, i, j, value)
        store(out, j, i, value)


@compiled
def predict(
    phi: np.ndarray,
    q: np.ndarray,
    moving: int,
    x: np.ndarray,
    p: np.ndarray,
    scratch: np.ndarray,
) -> None:
    """Replace x (1, n) by Φ x and P (n, n) by Φ P Φᵀ + Q.

    Only the first ``moving`` rows of Φ and Q (n, n) are used; Φ leaves the other states unchanged.
    ``scratch`` (n, n) is overwritten.
    """
    n = p.shape[0]
    moving = max(moving, 3)
    products_of_rows(phi, moving, p, scratch)
    for i_0 in range(0, moving, 3):
        i = min(i_0, moving - 3)
        for j_0 in range(0, i + 3, 3):
            j = min(j_0, moving - 3)
            t_00, t_01, t_02, t_10, t_11, t_12, t_20, t_21, t_22 = _row_products(scratch, i, phi, j)
            _put(p, i, j, t_00 + load(q, i, j))
            _put(p, i, j + 1, t_01 + load(q, i, j + 1))
            _put(p, i, j + 2, t_02 + load(q, i, j + 2))
            _put(p, i + 1, j, t_10 + load(q, i + 1, j))
            _put(p, i + 1, j + 1, t_11 + load(q, i + 1, j + 1))
            _put(p, i + 1, j + 2, t_12 + load(q, i + 1, j + 2))
            _put(p, i + 2, j, t_20 + load(q, i + 2, j))
            _put(p, i + 2, j + 1, t_21 + load(q, i + 2, j + 1))
            _put(p, i + 2, j + 2, t_22 + load(q, i + 2, j + 2))
    for i in range(moving):
        for j in range(moving, n):
            value = load(scratch, i, j)
            store(p, i, j, value)
            store(p, j, i, value)
    move(phi, moving, x, scratch)


@compiled
def move(phi: np.ndarray, moving: int, x: np.ndarray, scratch: np.ndarray) -> None:
    """Replace x (1, n) by Φ x, using the first ``moving`` rows of Φ.

    Row 0 of ``scratch`` is overwritten.
    """
    n = x.shape[1]
    for i in range(moving):
        total = splat(0.0)
        for k in range(n):
            total += load(phi, i, k) * load(x, 0, k)
        store(scratch, 0, i, total)
    for i in range(moving):
        store(x, 0, i, load(scratch, 0, i))


@compiled
def product(left: np.ndarray, right: np.ndarray, count: int, out: np.ndarray) -> None:
    """Fill the first ``count`` rows of ``out`` with those of A B.

    ``left`` is A (count or more, k), and ``right`` is B (k, n).
    """
    depth = right.shape[0]
    for i in range(count):
        for j in range(right.shape[1]):
            total = splat(0.0)
            for k in range(depth):
                total += load(left, i, k) * load(right, k, j)
            store(out, i, j, total)


@compiled
def project(rows: np.ndarray, p: np.ndarray, m: int, hp: np.ndarray, s: np.ndarray) -> None:
    """Fill ``hp`` (m, n) with H P, and the lower half of ``s`` (m, m) with S = H P Hᵀ + I.

    ``rows`` is H (m, n), and ``p`` is P (n, n).
    """
    n = p.shape[0]
    one = splat(1.0)
    products_of_rows(rows, m, p, hp)
    for c in range(m):
        for d in range(c + 1):
            total = splat(0.0)
            for k in range(n):
                total += load(hp, c, k) * load(rows, d, k)
            store(s, c, d, total + one if c == d else total)


@compiled
def factorise(matrix: np.ndarray, m: int, lower: np.ndarray) -> None:
    """Fill ``lower`` (m, m) with the Cholesky factor L of a symmetric matrix A = L Lᵀ.

    ``matrix`` is A (m, m); only its lower half is used. The diagonal of ``lower`` contains
    1 / L_ii. If the matrix of a lane is not positive definite, these values are NaN or infinite
    from some row on. ``matrix`` and ``lower`` may be the same array.
    """
    one = splat(1.0)
    for i in range(m):
        for j in range(i):
            total = load(matrix, i, j)
            for k in range(j):
                total -= load(lower, i, k) * load(lower, j, k)
            store(lower, i, j, total * load(lower, j, j))
        total = load(matrix, i, i)
        for k in range(i):
            value = load(lower, i, k)
            total -= value * value
        store(lower, i, i, one / math.sqrt(total))


@compiled
def triangular_root(matrix: np.ndarray, lower: np.ndarray, inverse: np.ndarray) -> None:
    """Fill ``lower`` (n, n) with the Cholesky factor L of a symmetric matrix A = L Lᵀ.

    ``matrix`` is A (n, n); each element is a vector with a lane for each run. Only the lower
    triangle of ``lower`` is filled. ``inverse`` (1, n) is filled with 1 / L_ii. If A of a lane is
    not positive definite, an element of ``inverse`` in this lane is not a positive number.
    """
    one = splat(1.0)
    for i in range(matrix.shape[0]):
        for j in range(i):
            total = load(matrix, i, j)
            for k in range(j):
                total -= load(lower, i, k) * load(lower, j, k)
            store(lower, i, j, total * load(inverse, 0, j))
        total = load(matrix, i, i)
        for k in range(i):
            value = load(lower, i, k)
            total -= value * value
        value = one / math.sqrt(total)
        store(inverse, 0, i, value)
        store(lower, i, i, total * value)


@compiled
def transposed_root(matrix: np.ndarray, size: int, out: np.ndarray) -> None:
    """Fill ``out`` with the transposed Cholesky factor Lᵀ of a leading block, L Lᵀ = A.

    A is the leading block (size, size) of the symmetric ``matrix`` (n, n), and may be singular: a
    row of Lᵀ is zero if its pivot is zero within rounding. Elements of ``out`` (size, n) in columns
    beyond ``size`` are zero.
    """
    for i in range(size):
        for j in range(out.shape[1]):
            total = splat(0.0)
            if i <= j < size:
                total = load(matrix, i, j)
                for k in range(i):
                    total -= load(out, k, i) * load(out, k, j)
            store(out, i, j, total)
        for r in range(out.shape[2]):
            left = out[i, i, r]
            inverse = 0.0 if left <= _ROUNDING * matrix[i, i, r] else 1.0 / math.sqrt(left)
            for j in range(i, size):
                out[i, j, r] *= inverse


@compiled
def is_positive(inverse: np.ndarray, r: int) -> bool:
    """Return whether the matrix of lane ``r`` is positive definite.

    ``inverse`` (1, n) is the output of :func:`triangular_root`.
    """
    good = True
    for i in range(inverse.shape[1]):
        good &= 0.0 < inverse[0, i, r] < np.inf
    return good


@compiled
def solve_lower(lower: np.ndarray, m: int, right: np.ndarray, out: np.ndarray) -> None:
    """Fill ``out`` (m, n) with L⁻¹ B, for L (m, m) from :func:`factorise`.

    B is the first m rows of ``right``. ``out`` may be the same array as ``right``.
    """
    for j in range(right.shape[1]):
        for i in range(m):
            total = load(right, i, j)
            for k in range(i):
                total -= load(lower, i, k) * load(out, k, j)
            store(out, i, j, total * load(lower, i, i))


@compiled
def solve_upper(lower: np.ndarray, m: int, right: np.ndarray, out: np.ndarray) -> None:
    """Fill ``out`` (m, n) with L⁻ᵀ B, for L (m, m) from :func:`factorise`.

    B is the first m rows of ``right``. ``out`` may be the same array as ``right``.
    """
    for j in range(right.shape[1]):
        for i in range(m - 1, -1, -1):
            total = load(right, i, j)
            for k in range(i + 1, m):
                total -= load(lower, k, i) * load(out, k, j)
            store(out, i, j, total * load(lower, i, i))


@compiled
def whiten(lower: np.ndarray, m: int, residual: np.ndarray, out: np.ndarray) -> None:
    """Fill ``out`` (1, m) with L⁻¹ y.

    ``residual`` is y (1, m), and ``lower`` is L (m, m) from :func:`factorise`.
    """
    for i in range(m):
        total = load(residual, 0, i)
        for k in range(i):
            total -= load(lower, i, k) * load(out, 0, k)
        store(out, 0, i, total * load(lower, i, i))


@compiled
def add_squares(values: np.ndarray, m: int, out: np.ndarray) -> None:
    """Add the squares of the first m elements of ``values`` (1, m or more) to ``out`` (1, 1)."""
    total = load(out, 0, 0)
    for i in range(m):
        value = load(values, 0, i)
        total += value * value
    store(out, 0, 0, total)


@compiled
def correct(half: np.ndarray, white: np.ndarray, m: int, x: np.ndarray) -> None:
    """Add Aᵀ w to the states x (1, n).

    ``half`` is A (m, n), and ``white`` is w (1, m). With A = L⁻¹ H P and the whitened innovation
    w = L⁻¹ y, this is the Kalman update of x.
    """
    for j in range(x.shape[1]):
        total = load(x, 0, j)
        for c in range(m):
            total += load(half, c, j) * load(white, 0, c)
        store(x, 0, j, total)


@compiled
def kalman_gain(
    rows: np.ndarray,
    p: np.ndarray,
    m: int,
    hp: np.ndarray,
    lower: np.ndarray,
    half: np.ndarray,
    gain: np.ndarray,
) -> None:
    """Compute the Kalman gain of whitened measurements, K = P Hᵀ (H P Hᵀ + I)⁻¹.

    Parameters
    ----------
    rows : (m, n) measurement matrix H.
    p : (n, n) covariance P of the states.
    m : number of measurement equations.
    hp : (m, n) output, H P.
    lower : (m, m) output, Cholesky factor L of H P Hᵀ + I, see :func:`factorise`.
    half : (m, n) output, L⁻¹ H P.
    gain : (m, n) output, Kᵀ.
    """
    project(rows, p, m, hp, lower)
    factorise(lower, m, lower)
    solve_lower(lower, m, hp, half)
    solve_upper(lower, m, half, gain)


@compiled
def joseph(
    gain: np.ndarray,
    hp: np.ndarray,
    rows: np.ndarray,
    m: int,
    p: np.ndarray,
    scratch: np.ndarray,
    change: np.ndarray,
) -> None:
    """Replace P (n, n) by Joseph's form (I − K H) P (I − K H)ᵀ + K Kᵀ.

    With M = P − K (H P), symmetric except for rounding, the result is M − (M Hᵀ − K) Kᵀ. This needs
    two products of rank m instead of two products of full rank. ``gain`` (m, n) is Kᵀ, ``hp``
    (m, n) is H P, and ``rows`` (m, n) is H. ``scratch`` (n, n) and ``change`` (m, n) are
    overwritten.
    """
    add_products(gain, hp, -1.0, p, scratch)
    products_of_rows(rows, m, scratch, change)
    for c in range(m):
        for j in range(p.shape[0]):
            store(change, c, j, load(gain, c, j) - load(change, c, j))
    add_products(gain, change, 1.0, scratch, p)


@compiled
def add_products(
    left: np.ndarray, right: np.ndarray, sign: float, p: np.ndarray, out: np.ndarray
) -> None:
    """Fill ``out`` (n, n) with the symmetric matrix P + s Aᵀ B.

    ``left`` is A (m, n), ``right`` is B (m, n), ``sign`` is s, and ``p`` is P (n, n). ``out`` and
    ``p`` must be different arrays.
    """
    n, factor = p.shape[0], splat(sign)
    for i_0 in range(0, n, 3):
        i = min(i_0, n - 3)
        for j_0 in range(0, i + 3, 3):
            j = min(j_0, n - 3)
            t_00, t_01, t_02, t_10, t_11, t_12, t_20, t_21, t_22 = _column_products(
                left, i, right, j
            )
            _put(out, i, j, load(p, i, j) + factor * t_00)
            _put(out, i, j + 1, load(p, i, j + 1) + factor * t_01)
            _put(out, i, j + 2, load(p, i, j + 2) + factor * t_02)
            _put(out, i + 1, j, load(p, i + 1, j) + factor * t_10)
            _put(out, i + 1, j + 1, load(p, i + 1, j + 1) + factor * t_11)
            _put(out, i + 1, j + 2, load(p, i + 1, j + 2) + factor * t_12)
            _put(out, i + 2, j, load(p, i + 2, j) + factor * t_20)
            _put(out, i + 2, j + 1, load(p, i + 2, j + 1) + factor * t_21)
            _put(out, i + 2, j + 2, load(p, i + 2, j + 2) + factor * t_22)
