"""Transition matrix Φ and process noise Q along INS tracks, for eight runs at once.

The error model x' = F x + w of :mod:`ggbench.ins.error_model` is integrated over the IMU intervals
between two measurements. The adjoint equation (:mod:`ggbench.ins.adjoint`) is integrated backwards
from unit vectors at the later measurement. The last axis of arrays is the run (lane), see
:mod:`ggbench.numerics.lanes`.
"""

from __future__ import annotations

import numpy as np

from ..gravity.ellipsoid import metres_per_radian_of
from ..numerics.kernels import compiled, copied
from ..numerics.lane_algebra import add_products, copy
from ..numerics.lanes import lanes, unfilled
from ..numerics.rotations import sine_cosine
from ..numerics.vectors import load, store
from .adjoint import (
    MOST_FACTORS,
    SCALED,
    is_slow,
    propagate,
    propagate_short_series,
    scaled_entries,
    series_terms,
)
from .known_gravity import KnownGravity
from .noise import Noise
from .system_matrix import ENTRIES, NAVIGATION_STATES, STATES, entries_between


@compiled
def metres_at(track: np.ndarray, n: int, out: np.ndarray) -> None:
    """Fill ``out`` (1, 2, LANES) with metres per radian of latitude and longitude at sample n."""
    sine, cosine = sine_cosine(load(track, n, 0))
    north, east = metres_per_radian_of(sine, cosine, load(track, n, 2))
    store(out, 0, 0, north)
    store(out, 0, 1, east)


@compiled
def unit_columns(metres: np.ndarray, which: np.ndarray, out: np.ndarray) -> None:
    """Fill ``out`` (len(which), n, LANES) with selected rows of the identity matrix.

    ``which`` contains the indices of the rows. Rows are position errors ENU [m]. Columns are errors
    of latitude and longitude [rad]; ``metres`` (1, 2, LANES) from :func:`metres_at` converts them.
    """
    out[:] = 0.0
    for i, j in enumerate(which):
        if j < 2:
            store(out, i, 1 - j, load(metres, 0, 1 - j))
        else:
            store(out, i, j, 1.0)


@compiled
def as_row(columns: np.ndarray, i: int, metres: np.ndarray, r: int, out: np.ndarray) -> None:
    """Fill a row of Φ of run ``r`` from column ``i``, with position errors ENU in metres.

    Parameters
    ----------
    columns : (rows, n, LANES) propagated columns of :func:`unit_columns`, with position errors in
        radians.
    metres : (1, 2, LANES) metres per radian from :func:`metres_at`.
    out : (n,) output.
    """
    out[0] = columns[i, 1, r] / metres[0, 1, r]
    out[1] = columns[i, 0, r] / metres[0, 0, r]
    for j in range(2, columns.shape[1]):
        out[j] = columns[i, j, r]


@copied
def compose(
    entries: np.ndarray,
    dt: float,
    noise: Noise,
    start: np.ndarray,
    end: np.ndarray,
    transition: np.ndarray,
    process_cov: np.ndarray,
) -> None:
    """Fill Φ and Q over successive IMU intervals, with position errors in metres.

    Parameters
    ----------
    entries : (count, ENTRIES, LANES) non-zero entries of F in each interval.
    dt : IMU interval [s].
    noise : process noise accumulated over one IMU interval.
    start, end : (1, 2, LANES) metres per radian of latitude and longitude at the start and at the
        end.
    transition, process_cov : (R, n, n) output, Φ and Q of the R runs of the group. Rows and columns
        of states beyond INS and gravity disturbance are not changed.
    """
    # A bias that does not wander does not change: its rows are those of the identity.
    moving = STATES if noise.wandering else NAVIGATION_STATES
    states = STATES + noise.disturbance.shape[0]
    count = moving + states - STATES
    which = np.empty(count, dtype=np.int64)
    for i in range(count):
        which[i] = i if i < moving else i + STATES - moving
    columns, terms, f = unfilled(count, states), series_terms(), unfilled(1, SCALED)
    factors = unfilled(MOST_FACTORS, count)
    covariance, previous = lanes(count, count), unfilled(count, count)
    slow = is_slow(entries, dt, noise)
    unit_columns(end, which, columns)
    for n in range(entries.shape[0] - 1, -1, -1):
        scaled_entries(entries, n, dt, f)
        if slow:
            used = factors[: propagate_short_series(f, noise, columns, factors)]
        else:
            used = factors[: propagate(f, noise, columns, terms, factors)]
        covariance, previous = previous, covariance
        add_products(used, used, 1.0, previous, covariance)
    for run in range(transition.shape[0]):
        for i in range(moving, STATES):
            transition[run, i, :states] = 0.0
            transition[run, i, i] = 1.0
        process_cov[run, :states, :states] = 0.0
        for i in range(count):
            as_row(columns, i, start, run, transition[run, which[i]])
            for j in range(count):
                process_cov[run, which[i], which[j]] = covariance[i, j, run]


@compiled
def entries_of(epochs: np.ndarray) -> np.ndarray:
    """Return an array (N, ENTRIES, LANES) for the system matrix F between successive epochs.

    ``epochs`` (K,) are indices of IMU samples. N is the largest number of IMU intervals before the
    first epoch, or between two successive epochs.
    """
    longest = epochs[0]
    for k in range(1, epochs.shape[0]):
        longest = max(longest, epochs[k] - epochs[k - 1])
    return lanes(longest, ENTRIES)


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
    track : (N + 1, TRACK, LANES) indicated track from :func:`ggbench.ins.strapdown.navigate_lanes`.
    increments : (N, 6, LANES) increments of the IMU.
    epochs : (K,) increasing indices of IMU samples.
    dt : IMU interval [s].
    constant : (ENTRIES,) constants added to F, see :func:`.entries_between`.
    gravity : gravity disturbance that the mechanization adds to normal gravity.
    noise : process noise accumulated over one IMU interval.
    transition, process_cov : (R, K, n, n) output, Φ and Q of R runs, see :func:`compose`.
    """
    entries, start, end = entries_of(epochs), lanes(1, 2), lanes(1, 2)
    first = 0
    metres_at(track, 0, start)
    for k in range(epochs.shape[0]):
        last = epochs[k]
        entries_between(
            track=track,
            increments=increments,
            first=first,
            last=last,
            dt=dt,
            constant=constant,
            gravity=gravity,
            out=entries,
        )
        metres_at(track, last, end)
        compose(
            entries=entries[: last - first],
            dt=dt,
            noise=noise,
            start=start,
            end=end,
            transition=transition[:, k],
            process_cov=process_cov[:, k],
        )
        copy(end, start)
        first = last
