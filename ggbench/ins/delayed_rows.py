"""Propagation of an INS error back from an epoch to the time of a delayed measurement."""

from __future__ import annotations

import math

import numpy as np

from ..numerics.kernels import compiled, copied
from ..numerics.lanes import gather_rows, group_members, lanes
from ..numerics.vectors import load, store
from .adjoint import SCALED, forward, scaled_entries, series_terms
from .known_gravity import KnownGravity
from .system_matrix import NAVIGATION_STATES, STATES, entries_between
from .transitions import entries_of, metres_at, unit_columns

MOVED = (0, 1, 2, 6, 7, 8)
"""Indices of the position and attitude errors in the state vector."""


@compiled
def delayed_rows_lanes(
    track: np.ndarray,
    increments: np.ndarray,
    epochs: np.ndarray,
    delays: np.ndarray,
    dt: float,
    constant: np.ndarray,
    gravity: KnownGravity,
    transition: np.ndarray,
    rows: np.ndarray,
) -> None:
    """Fill B_k, which maps x(t_k) to errors of position [m] and attitude [rad] at t_k − τ_k.

    Here x is the vector of the INS errors, t_k is the time of epoch k, and τ_k is the delay. B_k
    consists of rows of Φ(t_k, t_k − τ_k)⁻¹, with the transition matrix Φ. The effect of process
    noise within the delay is neglected; it is of the order of millimetres.

    Parameters
    ----------
    track, increments, epochs, dt, constant, gravity : as in :func:`.transitions.transitions_lanes`.
    delays : (K,) delays τ_k [s].
    transition : (R, K, n, n) Φ from the previous epoch to each epoch.
    rows : (R, K, 6, 15) output, B_k.
    """
    group = group_members(0, transition.shape[0])
    columns, terms, f = lanes(len(MOVED), STATES), series_terms(), lanes(1, SCALED)
    late, phi = lanes(len(MOVED), STATES), lanes(STATES, transition.shape[3])
    entries, metres, which = entries_of(epochs), lanes(1, 2), np.array(MOVED)
    for k in range(epochs.shape[0]):
        first, part, nearest = intervals_of(delays[k], epochs[k], dt)
        later = k  # the epoch that follows the moment
        while later > 0 and epochs[later - 1] > first:
            later -= 1
        begun, end = epochs[later - 1] if later > 0 else 0, epochs[later]
        metres_at(track, nearest, metres)
        unit_columns(metres, which, columns)
        # To the nearer one of the epochs about the moment, and from there by Φ between epochs.
        earlier = 2 * first < begun + end
        low, high = (begun, first + 1) if earlier else (first, end)
        entries_between(
            track=track,
            increments=increments,
            first=low,
            last=high,
            dt=dt,
            constant=constant,
            gravity=gravity,
            out=entries,
        )
        for n in range(high - low):
            if earlier:
                scaled_entries(entries, high - low - 1 - n, dt if n > 0 else dt - part, f)
            else:
                scaled_entries(entries, n, -dt if n > 0 else -part, f)
            forward(f, columns, terms)
        metres_at(track, begun if earlier else end, metres)
        for i in range(len(MOVED)):
            store(late, i, 0, load(columns, i, 1) / load(metres, 0, 1))
            store(late, i, 1, load(columns, i, 0) / load(metres, 0, 0))
            for j in range(2, STATES):
                store(late, i, j, load(columns, i, j))
        if not earlier:
            later += 1
        for i in range(later, k + 1):
            gather_rows(transition, group, i, STATES, phi)
            multiply_by_inverse(late, phi)
        for run in range(rows.shape[0]):
            for i in range(len(MOVED)):
                for j in range(STATES):
                    rows[run, k, i, j] = late[i, j, run]


@copied
def multiply_by_inverse(rows: np.ndarray, phi: np.ndarray) -> None:
    """Replace the rows Y (6, 15, LANES) by Y Φ⁻¹.

    The first 15 columns of ``phi`` (15, n, LANES) contain Φ, and are overwritten. The navigation
    part of Φ is factorised into triangular matrices. Pivoting is not needed, because this part is
    nearly unit upper triangular. A bias depends only on itself. The effect of a gravity disturbance
    state within the delay is neglected.
    """
    nav = NAVIGATION_STATES
    for k in range(nav):
        inverse = 1.0 / load(phi, k, k)
        for i in range(k + 1, nav):
            factor = load(phi, i, k) * inverse
            store(phi, i, k, factor)
            for j in range(k + 1, nav):
                store(phi, i, j, load(phi, i, j) - factor * load(phi, k, j))
        store(phi, k, k, inverse)
    for row in range(rows.shape[0]):
        for j in range(nav):
            total = load(rows, row, j)
            for k in range(j):
                total -= load(rows, row, k) * load(phi, k, j)
            store(rows, row, j, total * load(phi, j, j))
        for j in range(nav - 2, -1, -1):
            total = load(rows, row, j)
            for k in range(j + 1, nav):
                total -= load(rows, row, k) * load(phi, k, j)
            store(rows, row, j, total)
        for j in range(nav, STATES):
            total = load(rows, row, j)
            for k in range(nav):
                total -= load(rows, row, k) * load(phi, k, j)
            store(rows, row, j, total / load(phi, j, j))


@compiled
def intervals_of(delay: float, epoch: int, dt: float) -> tuple[int, float, int]:
    """Return the IMU intervals within a delay before an epoch.

    Parameters
    ----------
    delay, dt : delay and IMU interval [s].
    epoch : IMU sample of the epoch.

    Returns
    -------
    Index of the first interval; the part of this interval that lies within the delay [s]; index of
    the IMU sample nearest to the start of the delay.
    """
    steps = delay / dt
    whole = math.ceil(steps - 1e-9)
    return (
        max(epoch - whole, 0),
        dt * (steps - (whole - 1)),
        max(epoch - round(steps), 0),
    )
