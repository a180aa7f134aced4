"""Steps of filters and smoothers on the matrices of eight runs at once, compiled.

A matrix of eight runs is a contiguous array (rows, columns, LANES), the run last; a column of
numbers is an array (1, n, LANES). Sizes are those of the arrays: n states, m equations of a
reading, each three at least (equations may be zero). Readings are whitened: the noise of each
equation has unit variance. Symmetric matrices are computed by halves and kept whole. No step mixes
lanes, so a run's result does not depend on its neighbours, bit for bit.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from .kernels import LANES, aligned, compiled, inlined
from .vectors import load, load_from, root, splat, store, store_from, transposed, with_sign


@compiled
def lanes(rows: int, columns: int) -> np.ndarray:
    """Return an array (rows, columns, LANES) of zeros whose vectors lie within lines of cache."""
    array = aligned(rows * columns * LANES)
    array[:] = 0.0
    return array.reshape((rows, columns, LANES))


@compiled
def members(first: int, runs: int) -> np.ndarray:
    """Return the runs (LANES,) of the group that begins with ``first``; the last one may repeat."""
    out = np.empty(LANES, dtype=np.int64)
    for r in range(LANES):
        out[r] = min(first + r, runs - 1)
    return out


@compiled
def _departure(
    transition: np.ndarray, process_cov: np.ndarray, group: np.ndarray, k: int, first: int
) -> float:
    """Return zero if rows of Φ from ``first`` on are the identity's and those of Q are zero.

    Of all runs of a group at epoch ``k``.
    """
    epochs, n = transition.shape[1], transition.shape[2]
    size = n * n
    identity = np.eye(n)
    one, total = splat(1.0), splat(0.0)
    for r in range(LANES):
        start = (group[r] * epochs + k) * size
        for begin in range(first * n, size, LANES):
            at = min(begin, size - LANES)  # the last vector may overlap
            total += with_sign(load_from(transition, start + at) - load_from(identity, at), one)
            total += with_sign(load_from(process_cov, start + at), one)
    sums = np.empty(LANES)
    store_from(sums, 0, total)
    return sums.sum()


@compiled
def moving_states(transition: np.ndarray, process_cov: np.ndarray) -> int:
    """Return how many states there are before those that Φ and Q (R, K, n, n) leave as they are.

    As the first run has it at its first epoch.
    """
    group = np.zeros(LANES, dtype=np.int64)
    count = transition.shape[2]
    while count > 0 and _departure(transition, process_cov, group, 0, count - 1) == 0.0:
        count -= 1
    return count


@compiled
def gather(
    transition: np.ndarray,
    process_cov: np.ndarray,
    group: np.ndarray,
    k: int,
    expected: int,
    phi: np.ndarray,
    q: np.ndarray,
) -> int:
    """Fill Φ and Q of epoch ``k``.

    Parameters
    ----------
    transition, process_cov : (R, K, n, n) of a block.
    group : (LANES,) runs, see :func:`members`.
    expected : how many states move, from :func:`moving_states`.
    phi, q : (n, n, LANES) output, the rows of states that move.

    Returns
    -------
    How many states move: ``expected``, or n where any of the runs departs from that.
    """
    n = phi.shape[0]
    moving = expected
    if _departure(transition, process_cov, group, k, expected) != 0.0:
        moving = n
    gather_rows(transition, group, k, moving, phi)
    gather_rows(process_cov, group, k, moving, q)
    return moving


@compiled
def gather_rows(values: np.ndarray, group: np.ndarray, k: int, count: int, out: np.ndarray) -> None:
    """Fill the first ``count`` rows of values (R, K, rows, columns) at epoch ``k``.

    ``out`` (., columns, LANES) has as many columns. Eight numbers of each run become eight vectors.
    """
    used, size = count * values.shape[3], values.shape[2] * values.shape[3]
    epochs = values.shape[1]
    start_0, start_1 = (group[0] * epochs + k) * size, (group[1] * epochs + k) * size
    start_2, start_3 = (group[2] * epochs + k) * size, (group[3] * epochs + k) * size
    start_4, start_5 = (group[4] * epochs + k) * size, (group[5] * epochs + k) * size
    start_6, start_7 = (group[6] * epochs + k) * size, (group[7] * epochs + k) * size
    whole = used - used % LANES
    for at in range(0, whole, LANES):
        columns = transposed(
            (
                load_from(values, start_0 + at), load_from(values, start_1 + at),
                load_from(values, start_2 + at), load_from(values, start_3 + at),
                load_from(values, start_4 + at), load_from(values, start_5 + at),
                load_from(values, start_6 + at), load_from(values, start_7 + at),
            )
        )  # fmt: skip
        start = at * LANES
        store_from(out, start, columns[0])
        store_from(out, start + LANES, columns[1])
        store_from(out, start + 2 * LANES, columns[2])
        store_from(out, start + 3 * LANES, columns[3])
        store_from(out, start + 4 * LANES, columns[4])
        store_from(out, start + 5 * LANES, columns[5])
        store_from(out, start + 6 * LANES, columns[6])
        store_from(out, start + 7 * LANES, columns[7])
    flat, flat_out = values.reshape(-1), out.reshape(-1)
    for at in range(whole, used):
        for r in range(LANES):
            flat_out[at * LANES + r] = flat[(group[r] * epochs + k) * size + at]


@compiled
def gather_row(values: np.ndarray, group: np.ndarray, k: int, out: np.ndarray) -> None:
    """Fill (1, m, LANES) with values (R, K, m) at epoch ``k``."""
    for r in range(LANES):
        row = values[group[r], k]
        for j in range(row.shape[0]):
            out[0, j, r] = row[j]


@compiled
def spread(values: np.ndarray, out: np.ndarray) -> None:
    """Give a matrix (rows, columns) to all lanes."""
    for i in range(values.shape[0]):
        for j in range(values.shape[1]):
            for r in range(LANES):
                out[i, j, r] = values[i, j]


@compiled
def scatter(
    x: np.ndarray,
    p: np.ndarray,
    first: int,
    count: int,
    k: int,
    mean: np.ndarray,
    cov: np.ndarray,
) -> None:
    """Write x and P of ``count`` runs from ``first`` on to mean (R, K, n) and cov (R, K, n, n)."""
    n, epochs = p.shape[0], mean.shape[1]
    for r in range(count):
        to_mean = mean[first + r, k]
        for i in range(n):
            to_mean[i] = x[0, i, r]
    size = n * n
    whole = size - size % LANES
    for at in range(0, whole, LANES):
        start = at * LANES
        rows = transposed(
            (
                load_from(p, start), load_from(p, start + LANES),
                load_from(p, start + 2 * LANES), load_from(p, start + 3 * LANES),
                load_from(p, start + 4 * LANES), load_from(p, start + 5 * LANES),
                load_from(p, start + 6 * LANES), load_from(p, start + 7 * LANES),
            )
        )  # fmt: skip
        run = (first * epochs + k) * size + at
        store_from(cov, run, rows[0])
        if count > 1:
            store_from(cov, run + 1 * epochs * size, rows[1])
        if count > 2:
            store_from(cov, run + 2 * epochs * size, rows[2])
        if count > 3:
            store_from(cov, run + 3 * epochs * size, rows[3])
        if count > 4:
            store_from(cov, run + 4 * epochs * size, rows[4])
        if count > 5:
            store_from(cov, run + 5 * epochs * size, rows[5])
        if count > 6:
            store_from(cov, run + 6 * epochs * size, rows[6])
        if count > 7:
            store_from(cov, run + 7 * epochs * size, rows[7])
    flat, flat_p = cov.reshape(-1), p.reshape(-1)
    for at in range(whole, size):
        for r in range(count):
            flat[((first + r) * epochs + k) * size + at] = flat_p[at * LANES + r]


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
def products_of_rows(a: np.ndarray, count: int, b: np.ndarray, out: np.ndarray) -> None:
    """Fill A Bᵀ of the first ``count`` rows, three or more, of A (., n) and all of B (., n)."""
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
    """Replace x (1, n) by Φ x and P (n, n) by Φ P Φᵀ + Q; ``moving`` rows of Φ and Q are used.

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
    """Replace x (1, n) by Φ x; row 0 of ``scratch`` is overwritten."""
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
    """Fill the first ``count`` rows of A B of A (., k) and B (k, n)."""
    depth = right.shape[0]
    for i in range(count):
        for j in range(right.shape[1]):
            total = splat(0.0)
            for k in range(depth):
                total += load(left, i, k) * load(right, k, j)
            store(out, i, j, total)


@compiled
def project(rows: np.ndarray, p: np.ndarray, m: int, hp: np.ndarray, s: np.ndarray) -> None:
    """Fill H P (m, n) and the lower half of S = H P Hᵀ + 1 (m, m)."""
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
    """Fill the lower triangle of L, L Lᵀ = a matrix of which the lower half is given.

    The diagonal of ``lower`` is that of 1 / L; NaN or infinite in a lane and from the row on where
    the matrix is not positive definite. ``matrix`` and ``lower`` may be the same array.
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
        store(lower, i, i, one / root(total))


@compiled
def triangular_root(matrix: np.ndarray, lower: np.ndarray, inverse: np.ndarray) -> None:
    """Fill the lower triangle of L (n, n), L Lᵀ = a symmetric matrix, and 1 / L_ii (1, n).

    Where the matrix of a lane is not positive definite ``inverse`` has an element there that is
    not a positive number.
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
        value = one / root(total)
        store(inverse, 0, i, value)
        store(lower, i, i, total * value)


@compiled
def is_positive(inverse: np.ndarray, r: int) -> bool:
    """Return whether a matrix was positive definite, from :func:`triangular_root`."""
    good = True
    for i in range(inverse.shape[1]):
        good &= 0.0 < inverse[0, i, r] < np.inf
    return good


@compiled
def solve_lower(lower: np.ndarray, m: int, right: np.ndarray, out: np.ndarray) -> None:
    """Fill L⁻¹ B of L from :func:`factorise` and the first m rows of B (., n); may be in place."""
    for j in range(right.shape[1]):
        for i in range(m):
            total = load(right, i, j)
            for k in range(i):
                total -= load(lower, i, k) * load(out, k, j)
            store(out, i, j, total * load(lower, i, i))


@compiled
def solve_upper(lower: np.ndarray, m: int, right: np.ndarray, out: np.ndarray) -> None:
    """Fill L⁻ᵀ B of L from :func:`factorise` and the first m rows of B (., n); may be in place."""
    for j in range(right.shape[1]):
        for i in range(m - 1, -1, -1):
            total = load(right, i, j)
            for k in range(i + 1, m):
                total -= load(lower, k, i) * load(out, k, j)
            store(out, i, j, total * load(lower, i, i))


@compiled
def whiten(lower: np.ndarray, m: int, residual: np.ndarray, out: np.ndarray) -> None:
    """Fill L⁻¹ y (1, m) of L from :func:`factorise`."""
    for i in range(m):
        total = load(residual, 0, i)
        for k in range(i):
            total -= load(lower, i, k) * load(out, 0, k)
        store(out, 0, i, total * load(lower, i, i))


@compiled
def add_squares(values: np.ndarray, m: int, out: np.ndarray) -> None:
    """Add to out (1, 1) the sum of the squares of the first m of values (1, .)."""
    total = load(out, 0, 0)
    for i in range(m):
        value = load(values, 0, i)
        total += value * value
    store(out, 0, 0, total)


@compiled
def correct(half: np.ndarray, white: np.ndarray, m: int, x: np.ndarray) -> None:
    """Add to x (1, n) the product of a matrix (m, n), transposed, and a column (1, m)."""
    for j in range(x.shape[1]):
        total = load(x, 0, j)
        for c in range(m):
            total += load(half, c, j) * load(white, 0, c)
        store(x, 0, j, total)


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
    """Replace P by (I − K H) P (I − K H)ᵀ + K Kᵀ of K given as Kᵀ (m, n).

    With M = P − K (H P) that is M − (M Hᵀ − K) Kᵀ: two products of rank m instead of two whole
    ones. ``hp`` (m, n) is H P; ``scratch`` (n, n) and ``change`` (m, n) are overwritten. M is
    symmetric but for rounding.
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
    """Fill P ± Aᵀ B of A and B (m, n), a symmetric matrix (n, n), in another array than P."""
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
