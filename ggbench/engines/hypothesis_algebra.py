"""Compiled propagation and update of filters with added states, omitting zeros of Φ and H."""

from __future__ import annotations

import numpy as np

from ..numerics import lane_algebra
from ..numerics.kernels import compiled
from ..numerics.records import record
from ..numerics.vectors import load, splat, store


@record
class Added:
    """The added states of a group of filters at one epoch, one filter per lane.

    Attributes
    ----------
    base : number n of the states of the block.
    order, processes : number of states of each error process; number of error processes.
    coupled : number of added states that act on the states of the block: 0, 3 or 4.
    move, drive : (1, 5, lanes) transition and added variance of the processes, see ``moves`` and
        ``drives`` of :class:`.hypothesis_bank.Bank`.
    variances : (1, processes, lanes) stationary variances of the error processes.
    coupling : (n, 4, lanes) submatrix of Φ: effect of the added states on the block's states.
    """

    base: int
    order: int
    processes: int
    coupled: int
    move: np.ndarray
    drive: np.ndarray
    variances: np.ndarray
    coupling: np.ndarray


@compiled
def predict(
    phi: np.ndarray,
    q: np.ndarray,
    moving: int,
    added: Added,
    x: np.ndarray,
    p: np.ndarray,
    turned: np.ndarray,
) -> None:
    """Replace x by Φ x and P by Φ P Φᵀ + Q, for N states including the added states.

    Parameters
    ----------
    phi, q : (n, n, lanes) Φ and Q of the block's states; only the first ``moving`` rows are used.
    moving : number of states that Φ changes.
    added : the added states.
    x, p : (1, N, lanes), (N, N, lanes) mean and covariance of all states.
    turned : (N, n, lanes) scratch.
    """
    n, size, width = added.base, p.shape[0], p.shape[2]
    moving = max(moving, 3)
    first, coupled = n + added.order * added.processes, added.coupled
    top = phi.reshape(-1)[: moving * n * width].reshape((moving, n, width))
    rows = turned.reshape(-1)[: size * moving * width].reshape((size, moving, width))
    lane_algebra.products_of_rows(p, size, top, rows)  # (Φ P)ᵀ
    for i in range(moving):
        for f in range(coupled):
            value = load(added.coupling, i, f)
            for j in range(size):
                store(rows, j, i, load(rows, j, i) + load(p, j, first + f) * value)
    for i in range(moving):
        for j in range(i + 1):
            total = splat(0.0)
            for c in range(n):
                total += load(rows, c, i) * load(phi, j, c)
            for f in range(coupled):
                total += load(rows, first + f, i) * load(added.coupling, j, f)
            total = total + load(q, i, j)
            store(p, i, j, total)
            store(p, j, i, total)
        for j in range(moving, n):
            value = load(rows, j, i)
            store(p, i, j, value)
            store(p, j, i, value)
    # The added rows of P, moved: those of the other columns in place, then the added columns.
    for j in range(moving):
        for i in range(n, size):
            store(p, i, j, load(rows, i, j))
    _move_rows(added, p)
    for i in range(n, size):
        for j in range(n):
            store(p, j, i, load(p, i, j))
    _move_columns(added, p)
    _move_means(phi, moving, added, x, turned)


@compiled
def _move_rows(added: Added, p: np.ndarray) -> None:
    """Multiply the added rows of P by their part of Φ."""
    n, move, size = added.base, added.move, p.shape[0]
    if added.order == 2:
        m_00, m_01 = load(move, 0, 0), load(move, 0, 1)
        m_10, m_11 = load(move, 0, 2), load(move, 0, 3)
        for u in range(added.processes):
            i = n + 2 * u
            for j in range(size):
                one, two = load(p, i, j), load(p, i + 1, j)
                store(p, i, j, m_00 * one + m_01 * two)
                store(p, i + 1, j, m_10 * one + m_11 * two)
    elif added.order == 1:
        m_00 = load(move, 0, 0)
        for i in range(n, n + added.processes):
            for j in range(size):
                store(p, i, j, m_00 * load(p, i, j))
    first = n + added.order * added.processes
    kept = load(move, 0, 4)
    for i in range(first, first + min(added.coupled, 3)):
        for j in range(size):
            store(p, i, j, kept * load(p, i, j))


@compiled
def _move_columns(added: Added, p: np.ndarray) -> None:
    """Multiply the added columns of the added rows of P by their part of Φ, and add Q."""
    n, move, drive, size = added.base, added.move, added.drive, p.shape[0]
    if added.order == 2:
        m_00, m_01 = load(move, 0, 0), load(move, 0, 1)
        m_10, m_11 = load(move, 0, 2), load(move, 0, 3)
        for i in range(n, size):
            for u in range(added.processes):
                j = n + 2 * u
                one, two = load(p, i, j), load(p, i, j + 1)
                store(p, i, j, one * m_00 + two * m_01)
                store(p, i, j + 1, one * m_10 + two * m_11)
        for u in range(added.processes):
            i, variance = n + 2 * u, load(added.variances, 0, u)
            store(p, i, i, load(p, i, i) + load(drive, 0, 0) * variance)
            store(p, i + 1, i, load(p, i + 1, i) + load(drive, 0, 2) * variance)
            store(p, i, i + 1, load(p, i + 1, i))
            store(p, i + 1, i + 1, load(p, i + 1, i + 1) + load(drive, 0, 3) * variance)
    elif added.order == 1:
        m_00 = load(move, 0, 0)
        for i in range(n, size):
            for j in range(n, n + added.processes):
                store(p, i, j, load(p, i, j) * m_00)
        for u in range(added.processes):
            i, variance = n + u, load(added.variances, 0, u)
            store(p, i, i, load(p, i, i) + load(drive, 0, 0) * variance)
    first = n + added.order * added.processes
    kept = load(move, 0, 4)
    for j in range(first, first + min(added.coupled, 3)):
        for i in range(n, size):
            store(p, i, j, load(p, i, j) * kept)
        store(p, j, j, load(p, j, j) + load(drive, 0, 4))
    for i in range(n, size):
        for j in range(n, i):
            store(p, j, i, load(p, i, j))


@compiled
def _move_means(
    phi: np.ndarray, moving: int, added: Added, x: np.ndarray, scratch: np.ndarray
) -> None:
    """Replace x by Φ x; the first row of ``scratch`` is overwritten."""
    n, move = added.base, added.move
    first = n + added.order * added.processes
    for i in range(moving):
        total = splat(0.0)
        for j in range(n):
            total += load(phi, i, j) * load(x, 0, j)
        for f in range(added.coupled):
            total += load(added.coupling, i, f) * load(x, 0, first + f)
        store(scratch, 0, i, total)
    for i in range(moving):
        store(x, 0, i, load(scratch, 0, i))
    if added.order == 2:
        for u in range(added.processes):
            i = n + 2 * u
            one, two = load(x, 0, i), load(x, 0, i + 1)
            store(x, 0, i, load(move, 0, 0) * one + load(move, 0, 1) * two)
            store(x, 0, i + 1, load(move, 0, 2) * one + load(move, 0, 3) * two)
    elif added.order == 1:
        for i in range(n, n + added.processes):
            store(x, 0, i, load(move, 0, 0) * load(x, 0, i))
    for i in range(first, first + min(added.coupled, 3)):
        store(x, 0, i, load(move, 0, 4) * load(x, 0, i))


@compiled
def multiply_rows(
    rows: np.ndarray, used: np.ndarray, used_counts: np.ndarray, p: np.ndarray, out: np.ndarray
) -> None:
    """Fill ``out`` (m, N) with H P, from the non-zero columns of H.

    Parameters
    ----------
    rows : H (m or more, N, lanes).
    used, used_counts : the states on which each row of H depends, and their number, see
        :class:`.hypothesis_bank.Families`.
    p, out : (N, N, lanes) covariance P; (m, N, lanes) output.
    """
    size = p.shape[0]
    for c in range(out.shape[0]):
        for j_0 in range(0, size, 3):
            j = min(j_0, size - 3)
            t_0 = t_1 = t_2 = splat(0.0)
            for i in range(used_counts[c]):
                column = used[c, i]
                value = load(rows, c, column)
                t_0 += value * load(p, column, j)
                t_1 += value * load(p, column, j + 1)
                t_2 += value * load(p, column, j + 2)
            store(out, c, j, t_0)
            store(out, c, j + 1, t_1)
            store(out, c, j + 2, t_2)


@compiled
def project(
    rows: np.ndarray,
    used: np.ndarray,
    used_counts: np.ndarray,
    m: int,
    p: np.ndarray,
    hp: np.ndarray,
    s: np.ndarray,
) -> None:
    """Fill H P (m, N) and the lower half of H P Hᵀ + I (m, m), from the non-zero columns of H."""
    multiply_rows(rows, used, used_counts, p, hp)
    for c in range(m):
        for d in range(c + 1):
            total = splat(1.0) if c == d else splat(0.0)
            for i in range(used_counts[d]):
                total += load(hp, c, used[d, i]) * load(rows, d, used[d, i])
            store(s, c, d, total)


@compiled
def joseph(
    gain: np.ndarray,
    hp: np.ndarray,
    rows: np.ndarray,
    used: np.ndarray,
    used_counts: np.ndarray,
    p: np.ndarray,
    scratch: np.ndarray,
    change: np.ndarray,
) -> None:
    """Update P (N, N, lanes) in Joseph's form, from the non-zero columns of H.

    The result is that of :func:`.lane_algebra.joseph`.

    Parameters
    ----------
    gain, hp : (m, N, lanes) Kᵀ and H P.
    rows : H (m or more, N, lanes).
    used, used_counts : the states on which each row of H depends, and their number, see
        :class:`.hypothesis_bank.Families`.
    p : (N, N, lanes), replaced.
    scratch, change : (N, N, lanes), (m, N, lanes), overwritten.
    """
    lane_algebra.add_products(gain, hp, -1.0, p, scratch)
    multiply_rows(rows, used, used_counts, scratch, change)
    for c in range(gain.shape[0]):
        for j in range(p.shape[0]):
            store(change, c, j, load(gain, c, j) - load(change, c, j))
    lane_algebra.add_products(gain, change, 1.0, scratch, p)
