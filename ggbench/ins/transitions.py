"""Φ, Q and delayed rows along INS tracks, for several runs at once.

The error model x' = F x + w of :mod:`.ins.error_model` is taken over the IMU intervals between two
measurements by its adjoint, backwards from unit vectors at the end (:mod:`.ins.adjoint`); arrays
have the runs last, see :mod:`ggbench.numerics.lanes`.
"""

from __future__ import annotations

import math

import numpy as np

from ..gravity.ellipsoid import metres_per_radian_of
from ..numerics.kernels import compiled
from ..numerics.lane_algebra import add_products, copy
from ..numerics.lanes import lanes
from ..numerics.rotations import sine_cosine
from ..numerics.vectors import load, store
from .adjoint import MOST_FACTORS, Noise, back, forward, series_terms
from .known_gravity import KnownGravity
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
def _as_rows(columns: np.ndarray, metres: np.ndarray, r: int, out: np.ndarray) -> None:
    """Fill ``out`` (len(columns), .) with the columns of run ``r``, of a state in metres."""
    for i in range(columns.shape[0]):
        _as_row(columns, i, metres, r, out[i])


@compiled
def _as_row(columns: np.ndarray, i: int, metres: np.ndarray, r: int, out: np.ndarray) -> None:
    """Fill ``out`` with column ``i`` of run ``r``, of a state in metres."""
    out[0] = columns[i, 1, r] / metres[0, 1, r]
    out[1] = columns[i, 0, r] / metres[0, 0, r]
    for j in range(2, columns.shape[1]):
        out[j] = columns[i, j, r]


@compiled
def compose(
    entries: np.ndarray,
    dt: float,
    noise: Noise,
    start: np.ndarray,
    end: np.ndarray,
    transition: np.ndarray,
    process_cov: np.ndarray,
) -> None:
    """Fill Φ and Q over successive IMU intervals, for the state in metres.

    Parameters
    ----------
    entries : (count, ENTRIES, LANES) of F in the intervals. dt : one of them [s].
    noise : that drives the state.
    start, end : (1, 2, LANES) metres per radian of latitude and longitude at the ends.
    transition, process_cov : (R, n, n) of the group's R runs, output; states from 15 on, or behind
        those of the gravity disturbance, are not touched.
    """
    # A bias that does not wander does not change: its rows are those of the identity.
    moving = STATES if noise.wandering else NAVIGATION_STATES
    states = STATES + noise.disturbance.shape[0]
    which = np.concatenate((np.arange(moving), np.arange(STATES, states)))
    count = which.shape[0]
    columns, terms = lanes(count, states), series_terms()
    factors = lanes(MOST_FACTORS, count)
    covariance, previous = lanes(count, count), lanes(count, count)
    over_interval = Noise(
        noise.roots * math.sqrt(dt), noise.altimeter * math.sqrt(dt), noise.damped,
        noise.wandering, noise.disturbance * math.sqrt(dt),
    )  # fmt: skip
    _unit_columns(end, which, columns)
    for n in range(entries.shape[0] - 1, -1, -1):
        used = factors[: back(entries, n, dt, over_interval, columns, terms, factors)]
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


@compiled
def transitions_lanes(
    track: np.ndarray,
    increments: np.ndarray,
    epochs: np.ndarray,
    dt: float,
    constant: np.ndarray,
    gravity: KnownGravity,
    noise: Noise,
    transition: np.ndarray,
    process_cov: np.ndarray,
) -> None:
    """Fill Φ and Q between measurement epochs along the tracks of a group of runs.

    Parameters
    ----------
    track : (N + 1, TRACK, LANES) from :func:`ggbench.ins.strapdown.navigate_lanes`.
    increments : (N, 6, LANES) of the IMU.
    epochs : (K,) increasing indices of IMU samples. dt : IMU interval [s].
    constant : (ENTRIES,) what is added to F. gravity : what is added to normal gravity.
    noise : that drives the state.
    transition, process_cov : (R, K, n, n) of R runs, output, as :func:`compose` fills them.
    """
    longest = epochs[0]
    for k in range(1, epochs.shape[0]):
        longest = max(longest, epochs[k] - epochs[k - 1])
    entries, start, end = lanes(longest, ENTRIES), lanes(1, 2), lanes(1, 2)
    first = 0
    _metres(track, 0, start)
    for k in range(epochs.shape[0]):
        last = epochs[k]
        entries_between(track, increments, first, last, dt, constant, gravity, entries)
        _metres(track, last, end)
        compose(entries[: last - first], dt, noise, start, end, transition[:, k], process_cov[:, k])
        copy(end, start)
        first = last


@compiled
def delayed(
    entries: np.ndarray,
    part: float,
    dt: float,
    then: np.ndarray,
    now: np.ndarray,
    rows: np.ndarray,
) -> None:
    """Fill B (R, 6, n) of one epoch: position [m] and attitude error at t − τ are B x(t).

    Parameters
    ----------
    entries : (count, ENTRIES, LANES) of F in the IMU intervals from t − τ to t.
    part : of the first interval that lies after t − τ [s]. dt : the others [s].
    then, now : (1, 2, LANES) metres per radian at t − τ and at t.
    rows : output, of the group's R runs.
    """
    columns, terms = lanes(6, STATES), series_terms()
    _unit_columns(then, np.array([0, 1, 2, 6, 7, 8]), columns)
    for n in range(entries.shape[0]):
        forward(entries, n, part if n == 0 else dt, columns, terms)
    for run in range(rows.shape[0]):
        _as_rows(columns, now, run, rows[run])


@compiled
def delayed_rows_lanes(
    track: np.ndarray,
    increments: np.ndarray,
    epochs: np.ndarray,
    delays: np.ndarray,
    dt: float,
    constant: np.ndarray,
    gravity: KnownGravity,
    rows: np.ndarray,
) -> None:
    """Fill B (R, K, 6, 15) of :func:`.error_model.delayed_rows` along the tracks of R runs.

    Parameters
    ----------
    track, increments, epochs, dt, constant, gravity : as in :func:`transitions_lanes`.
    delays : (K,) [s]. rows : output.
    """
    then, now = lanes(1, 2), lanes(1, 2)
    for k in range(epochs.shape[0]):
        last = epochs[k]
        first, part, nearest = intervals_of(delays[k], last, dt)
        entries = lanes(last - first, ENTRIES)
        entries_between(track, increments, first, last, dt, constant, gravity, entries)
        _metres(track, nearest, then)
        _metres(track, last, now)
        delayed(entries, part, dt, then, now, rows[:, k])


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
