"""Φ, Q and delayed rows along INS tracks, for several runs at once.

The error model x' = F x + w of :mod:`.ins.error_model` is taken over the IMU intervals between two
measurements by its adjoint, backwards from unit vectors at the end (:mod:`.ins.adjoint`); arrays
have the runs last, see :mod:`ggbench.numerics.lanes`.
"""

from __future__ import annotations

import math

import numpy as np

from ..gravity.ellipsoid import metres_per_radian_of
from ..numerics.kernels import compiled, copied
from ..numerics.lane_algebra import add_products, copy
from ..numerics.lanes import gather_rows, lanes, members, unfilled
from ..numerics.records import record
from ..numerics.rotations import sine_cosine
from ..numerics.vectors import load, store
from .adjoint import (
    MOST_FACTORS,
    OVER,
    back,
    back_slowly,
    forward,
    is_slow,
    over,
    series_terms,
)
from .known_gravity import KnownGravity
from .noise import Noise
from .system_matrix import ENTRIES, NAVIGATION_STATES, STATES, entries_between


@compiled
def _metres(track: np.ndarray, n: int, out: np.ndarray) -> None:
    """Fill ``out`` (1, 2, LANES) with what δL and δλ are worth [m/rad] at a sample of a track."""
    sine, cosine = sine_cosine(load(track, n, 0))
    north, east = metres_per_radian_of(sine, cosine, load(track, n, 2))
    store(out, 0, 0, north)
    store(out, 0, 1, east)


@compiled
def _unit_columns(metres: np.ndarray, which: np.ndarray, out: np.ndarray) -> None:
    """Fill ``out`` (len(which), n, LANES) with rows of the identity, positions in metres."""
    out[:] = 0.0
    for i, j in enumerate(which):
        if j < 2:
            store(out, i, 1 - j, load(metres, 0, 1 - j))
        else:
            store(out, i, j, 1.0)


@compiled
def _as_row(columns: np.ndarray, i: int, metres: np.ndarray, r: int, out: np.ndarray) -> None:
    """Fill ``out`` with column ``i`` of run ``r``, of a state in metres."""
    out[0] = columns[i, 1, r] / metres[0, 1, r]
    out[1] = columns[i, 0, r] / metres[0, 0, r]
    for j in range(2, columns.shape[1]):
        out[j] = columns[i, j, r]


@record
class Delays:
    """Where along a flight delayed readings were felt.

    Attributes
    ----------
    first, part, nearest : (K,) of each epoch, from :func:`intervals_of`; no elements where nothing
        is asked for.
    of_interval : (N,) an epoch of which the delay begins in each IMU interval; −1 for none.
    following : (K,) another one that begins where an epoch's does; −1 for none.
    """

    first: np.ndarray
    part: np.ndarray
    nearest: np.ndarray
    of_interval: np.ndarray
    following: np.ndarray


_NONE = np.empty(0, dtype=np.int64)
NO_DELAYS = Delays(_NONE, np.empty(0), _NONE, _NONE, _NONE)


@copied
def delays_along(delays: np.ndarray, epochs: np.ndarray, dt: float) -> Delays:
    """Return where delays (K,) [s] before epochs (K,) of IMU samples begin; or of none, (0,)."""
    count = delays.shape[0]
    first, nearest = np.empty(count, dtype=np.int64), np.empty(count, dtype=np.int64)
    part, following = np.empty(count), np.full(count, -1)
    of_interval = np.full(epochs[-1], -1)
    for k in range(count):
        first[k], part[k], nearest[k] = intervals_of(delays[k], epochs[k], dt)
        if first[k] < epochs[k]:
            following[k] = of_interval[first[k]]
            of_interval[first[k]] = k
    return Delays(first, part, nearest, of_interval, following)


@copied
def compose(
    entries: np.ndarray,
    dt: float,
    noise: Noise,
    start: np.ndarray,
    end: np.ndarray,
    transition: np.ndarray,
    process_cov: np.ndarray,
    track: np.ndarray,
    since: int,
    late: Delays,
    rows: np.ndarray,
) -> None:
    """Fill Φ and Q over successive IMU intervals, for the state in metres.

    Parameters
    ----------
    entries : (count, ENTRIES, LANES) of F in the intervals.
    dt : one of them [s].
    noise : that drives the state.
    start, end : (1, 2, LANES) metres per radian of latitude and longitude at the ends.
    transition, process_cov : (R, n, n) of the group's R runs, output; states from 15 on, or behind
        those of the gravity disturbance, are not touched.
    track : (N + 1, TRACK, LANES).
    since : its sample at which the intervals begin.
    late : delays along it.
    rows : (R, K, 6, 15) output, of the delays that begin in the intervals: from an error at their
        end to that where the delay begins.
    """
    # A bias that does not wander does not change: its rows are those of the identity.
    moving = STATES if noise.wandering else NAVIGATION_STATES
    states = STATES + noise.disturbance.shape[0]
    which = np.concatenate((np.arange(moving), np.arange(STATES, states)))
    count = which.shape[0]
    columns, terms, f = unfilled(count, states), series_terms(), unfilled(1, OVER)
    factors = unfilled(MOST_FACTORS, count)
    covariance, previous = lanes(count, count), unfilled(count, count)
    over_interval = Noise(
        noise.roots * math.sqrt(dt), noise.altimeter * math.sqrt(dt), noise.damped,
        noise.wandering, noise.disturbance * math.sqrt(dt),
    )  # fmt: skip
    slow = is_slow(entries, dt, noise)
    _unit_columns(end, which, columns)
    for n in range(entries.shape[0] - 1, -1, -1):
        k = late.of_interval[since + n] if late.first.shape[0] > 0 else -1
        while k >= 0:
            over(entries, n, -late.part[k], f)
            _take_back(f, track, late.nearest[k], columns, moving, terms, rows[:, k])
            k = late.following[k]
        over(entries, n, dt, f)
        if slow:
            used = factors[: back_slowly(f, over_interval, columns, factors)]
        else:
            used = factors[: back(f, over_interval, columns, terms, factors)]
        covariance, previous = previous, covariance
        add_products(used, used, 1.0, previous, covariance)
    for run in range(transition.shape[0]):
        for i in range(moving, STATES):
            transition[run, i, :states] = 0.0
            transition[run, i, i] = 1.0
        process_cov[run, :states, :states] = 0.0
        for i in range(count):
            _as_row(columns, i, start, run, transition[run, which[i]])
            for j in range(count):
                process_cov[run, which[i], which[j]] = covariance[i, j, run]


@copied
def _take_back(
    f: np.ndarray,
    track: np.ndarray,
    nearest: int,
    columns: np.ndarray,
    moving: int,
    terms: np.ndarray,
    rows: np.ndarray,
) -> None:
    """Fill B (R, 6, 15) from the end of some intervals to a moment within the one before them.

    Position [m] and attitude error then are B times the error at the end, in metres.

    Parameters
    ----------
    f : F over what of that interval lies behind the moment, negative.
    nearest : sample of a track.
    columns : rows of Φ from the interval's end to the end of all, in metres there; the first
        ``moving`` ones are those of the first states, of which the others up to 15 do not change.
    terms : overwritten.
    rows : output.
    """
    late, metres, phi = lanes(6, STATES), lanes(1, 2), lanes(STATES, STATES)
    _metres(track, nearest, metres)
    _unit_columns(metres, np.array([0, 1, 2, 6, 7, 8]), late)
    forward(f, late, terms)
    # The first two rows are those of east and north, the first two columns of latitude, longitude.
    for i in range(STATES):
        store(phi, i, i, 1.0)
        for j in range(STATES if i < moving else 0):
            store(phi, i, j, load(columns, 1 - i if i < 2 else i, j))
    _undo(late, phi)
    for i in range(6):
        for run in range(rows.shape[0]):
            for j in range(NAVIGATION_STATES):
                rows[run, i, 1 - j if j < 2 else j] = late[i, j, run]
            for j in range(NAVIGATION_STATES, STATES):
                rows[run, i, j] = late[i, j, run]


@compiled
def transitions_lanes(
    track: np.ndarray,
    increments: np.ndarray,
    epochs: np.ndarray,
    delays: np.ndarray,
    dt: float,
    constant: np.ndarray,
    gravity: KnownGravity,
    noise: Noise,
    transition: np.ndarray,
    process_cov: np.ndarray,
    rows: np.ndarray,
) -> None:
    """Fill Φ and Q between measurement epochs along the tracks of a group of runs.

    Parameters
    ----------
    track : (N + 1, TRACK, LANES) from :func:`ggbench.ins.strapdown.navigate_lanes`.
    increments : (N, 6, LANES) of the IMU.
    epochs : (K,) increasing indices of IMU samples.
    dt : IMU interval [s].
    delays : (K,) [s] for which rows are asked for; (0,) for none.
    constant : (ENTRIES,) what is added to F.
    gravity : what is added to normal gravity.
    noise : that drives the state.
    transition, process_cov : (R, K, n, n) of R runs, output, as :func:`compose` fills them.
    rows : (R, K, 6, 15) output: position [m] and attitude error [rad] at t_k − τ_k are B_k x(t_k).
        Process noise within the delay (millimetres) is neglected.
    """
    longest = epochs[0]
    for k in range(1, epochs.shape[0]):
        longest = max(longest, epochs[k] - epochs[k - 1])
    entries, start, end = lanes(longest, ENTRIES), lanes(1, 2), lanes(1, 2)
    late = delays_along(delays, epochs, dt)
    first = 0
    _metres(track, 0, start)
    for k in range(epochs.shape[0]):
        last = epochs[k]
        entries_between(track, increments, first, last, dt, constant, gravity, entries)
        _metres(track, last, end)
        compose(
            entries[: last - first], dt, noise, start, end, transition[:, k], process_cov[:, k],
            track, first, late, rows,
        )  # fmt: skip
        copy(end, start)
        first = last
    if late.first.shape[0] > 0:
        _bring_up(epochs, late.first, transition, rows)


@copied
def _bring_up(
    epochs: np.ndarray, first: np.ndarray, transition: np.ndarray, rows: np.ndarray
) -> None:
    """Take B of each epoch (R, K, 6, 15) from the end of the interval its delay begins in to it.

    The intervals between epochs (K,) that lie within a delay, which begins at the sample ``first``
    (K,), are those of ``transition`` (R, K, n, n).
    """
    group = members(0, transition.shape[0])
    late, phi = lanes(6, STATES), lanes(STATES, transition.shape[3])
    for k in range(epochs.shape[0]):
        if first[k] == epochs[k]:
            for run in range(rows.shape[0]):
                rows[run, k] = 0.0
                for i in range(6):
                    rows[run, k, i, i if i < 3 else i + 3] = 1.0
            continue
        within = np.searchsorted(epochs, first[k], side="right")
        if within == k:
            continue
        for i in range(6):
            for j in range(STATES):
                for lane in range(group.shape[0]):
                    late[i, j, lane] = rows[group[lane], k, i, j]
        for i in range(within + 1, k + 1):
            gather_rows(transition, group, i, STATES, phi)
            _undo(late, phi)
        for run in range(rows.shape[0]):
            for i in range(6):
                for j in range(STATES):
                    rows[run, k, i, j] = late[i, j, run]


@compiled
def _undo(rows: np.ndarray, phi: np.ndarray) -> None:
    """Replace rows Y (6, 15) by Y Φ⁻¹ of Φ (15, .), whose first 15 columns are overwritten.

    By triangular factors of the navigation state's part without pivots: it is nearly an upper
    triangle of ones and what adds up in the delay. Biases feel nothing but themselves. What the
    disturbance of gravity adds in a delay, if it is a state, is neglected.
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
    """Return what a delay before an epoch spans.

    The first IMU interval in it, how much of that one [s], and the sample next to its beginning.
    """
    steps = delay / dt
    whole = math.ceil(steps - 1e-9)
    return (
        max(epoch - whole, 0),
        dt * (steps - (whole - 1)),
        max(epoch - round(steps), 0),
    )
