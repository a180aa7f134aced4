"""Memory layout of the matrices of eight runs (lanes), and copies from and to blocks.

Compiled code processes LANES = 8 runs in parallel, one run per lane. A matrix of eight runs is a
contiguous array (rows, columns, LANES), in which the last axis is the run. A vector of n numbers is
an array (1, n, LANES). In a block of R runs and K epochs, (R, K, ...), the first axis is the run.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from .kernels import LANES, aligned, compiled, inlined
from .vectors import load_from, splat, store_from, transposed, with_sign


@compiled
def unfilled(rows: int, columns: int) -> np.ndarray:
    """Return an unfilled array (rows, columns, LANES), aligned to cache lines."""
    return aligned(rows * columns * LANES).reshape((rows, columns, LANES))


def allocate(*shapes: tuple[int, int]) -> list[np.ndarray]:
    """Return unfilled arrays (rows, columns, LANES) of several shapes in one block of memory.

    NumPy maps large blocks in large pages, which makes the first access fast.
    """
    ends = np.cumsum([0, *(rows * columns * LANES for rows, columns in shapes)])
    memory = np.empty(ends[-1] + LANES)
    start = -(memory.ctypes.data // 8) % LANES
    return [
        memory[start + first : start + last].reshape(*shape, LANES)
        for first, last, shape in zip(ends[:-1], ends[1:], shapes, strict=True)
    ]


@compiled
def lanes(rows: int, columns: int) -> np.ndarray:
    """Return an array (rows, columns, LANES) of zeros, aligned to cache lines."""
    array = unfilled(rows, columns)
    array[:] = 0.0
    return array


@compiled
def series(count: int, rows: int, columns: int) -> np.ndarray:
    """Return an unfilled array (count, rows, columns, LANES): a matrix for each epoch."""
    return unfilled(count * rows, columns).reshape((count, rows, columns, LANES))


@compiled
def group_starts(runs: int) -> np.ndarray:
    """Return the index (groups,) of the first run of each group of up to LANES runs."""
    first = np.empty((runs + LANES - 1) // LANES, dtype=np.int64)
    for i in range(first.shape[0]):
        first[i] = i * LANES
    return first


@compiled
def count_from(first: int, runs: int) -> int:
    """Return the number of runs in the group that begins with run ``first``."""
    return min(LANES, runs - first)


@inlined
def each() -> range:
    """Return the indices of all lanes, including unused ones."""
    return range(LANES)


def lane_of(run: int) -> tuple[int, int]:
    """Return the index of the group that contains a run, and the lane of the run."""
    return divmod(run, LANES)


@compiled
def integers() -> np.ndarray:
    """Return an array (LANES,) of integer zeros."""
    return np.zeros(LANES, dtype=np.int64)


@compiled
def flags() -> np.ndarray:
    """Return an array (LANES,) of False."""
    return np.zeros(LANES, dtype=np.bool_)


@compiled
def numbers(value: float) -> np.ndarray:
    """Return an array (LANES,) of the same value in every lane."""
    return np.full(LANES, value)


@compiled
def group_members(first: int, runs: int) -> np.ndarray:
    """Return the runs (LANES,) of the group that begins with ``first``.

    In a group of fewer than LANES runs the last run repeats.
    """
    out = np.empty(LANES, dtype=np.int64)
    for r in range(LANES):
        out[r] = min(first + r, runs - 1)
    return out


def groups(runs: int) -> Iterator[slice]:
    """Yield the slice of runs in each group, for a block of ``runs`` runs."""
    for first in range(0, runs, LANES):
        yield slice(first, min(first + LANES, runs))


def in_lanes(runs: np.ndarray) -> np.ndarray:
    """Rearrange the matrices (R, rows, columns) of a group to (rows, columns, LANES).

    Unused lanes repeat the last run, see :func:`group_members`.
    """
    out = unfilled(*runs.shape[1:])
    out[:, :, : len(runs)] = np.moveaxis(runs, 0, -1)
    out[:, :, len(runs) :] = runs[-1, :, :, np.newaxis]
    return out


def out_of_lanes(values: np.ndarray, runs: int) -> np.ndarray:
    """Rearrange (rows, columns, LANES) to the matrices (R, rows, columns) of R runs."""
    return np.ascontiguousarray(np.moveaxis(values[:, :, :runs], -1, 0))


@compiled
def _departure(
    transition: np.ndarray, process_cov: np.ndarray, group: np.ndarray, k: int, first: int
) -> float:
    """Return a measure of the change of the states from ``first`` on; zero if Φ and Q keep them.

    The measure is the sum of absolute values of Φ − I and of Q in the rows of these states. The sum
    is over all runs of a group at epoch ``k``.
    """
    epochs, n = transition.shape[1], transition.shape[2]
    size = n * n
    identity = np.zeros(size)
    for i in range(n):
        identity[i * (n + 1)] = 1.0
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
    """Return the number of states up to and including the last one that Φ or Q changes.

    ``transition`` is Φ (R, K, n, n), and ``process_cov`` is Q (R, K, n, n). Only the first epoch of
    the first run is examined.
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
    """Fill Φ and Q of epoch ``k`` for a group of runs.

    Parameters
    ----------
    transition, process_cov : (R, K, n, n) Φ and Q of a block.
    group : (LANES,) runs, see :func:`group_members`.
    expected : number of states that change, from :func:`moving_states`.
    phi, q : (n, n, LANES) output; only the rows of states that change are filled.

    Returns
    -------
    Number of states that change: ``expected``, or n if more states change in any run.
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
    """Fill the first ``count`` rows of ``out`` with values (R, K, rows, columns) at epoch ``k``.

    ``group`` (LANES,) contains the run of each lane, see :func:`group_members`. ``out`` has the
    shape (count or more, columns, LANES).
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
    """Fill ``out`` (1, m, LANES) with values (R, K, m) at epoch ``k``.

    ``group`` (LANES,) contains the run of each lane, see :func:`group_members`.
    """
    for r in range(LANES):
        row = values[group[r], k]
        for j in range(row.shape[0]):
            out[0, j, r] = row[j]


@compiled
def broadcast(values: np.ndarray, out: np.ndarray) -> None:
    """Copy a matrix (rows, columns) to all lanes of ``out`` (rows, columns, LANES)."""
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
    """Write x (1, n, LANES) and P (n, n, LANES) of ``count`` runs to epoch ``k`` of a block.

    ``mean`` (R, K, n) receives x, and ``cov`` (R, K, n, n) receives P. ``first`` is the run of
    lane 0.
    """
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
