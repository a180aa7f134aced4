"""Φ, Q and delayed rows along INS tracks, for several runs at once.

The error model x' = F x + w of :mod:`.ins.error_model` is taken over the IMU intervals between two
measurements by its adjoint, backwards from unit vectors at the end (:mod:`.ins.adjoint`); arrays
are laid out as :mod:`ggbench.ins.system_matrix` says.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..gravity.ellipsoid import metres_per_radian_of
from ..numerics.kernels import LANES, aligned, compiled
from ..numerics.rotations import sine_cosine
from .adjoint import add_products, add_six, back, forward, wander
from .strapdown import TRACK
from .system_matrix import ENTRIES, NAVIGATION_STATES, STATES, entries_between


class Noise(NamedTuple):
    """What drives the error model: G q Gᵀ by its square roots.

    Attributes
    ----------
    roots : (15,) of the diagonal, without the altimeter's part.
    altimeter : (2,) in δh and δv_U, of what couples them.
    damped : whether there is an altimeter. wandering : whether biases decay or are driven.
    """

    roots: np.ndarray
    altimeter: np.ndarray
    damped: bool
    wandering: bool


def noise_roots(noise: np.ndarray, decaying: bool) -> Noise:
    """Return the square roots of G q Gᵀ (15, 15): diagonal but for what an altimeter couples.

    ``decaying`` says that F makes biases decay.
    """
    altimeter, diagonal = np.zeros(2), np.diag(noise).copy()
    if noise[2, 2] > 0.0:
        altimeter = noise[2, [2, 5]] / math.sqrt(noise[2, 2])
        diagonal[[2, 5]] -= altimeter**2
    roots = np.sqrt(np.maximum(diagonal, 0.0))
    wandering = decaying or bool(roots[NAVIGATION_STATES:].any())
    return Noise(roots, altimeter, bool(altimeter.any()), wandering)


@compiled
def _metres(latitudes: np.ndarray, heights: np.ndarray, out: np.ndarray) -> None:
    """Fill ``out`` (2, LANES) with what δL and δλ are worth [m/rad]."""
    for r in range(latitudes.shape[0]):
        sine, cosine = sine_cosine(latitudes[r])
        out[0, r], out[1, r] = metres_per_radian_of(sine, cosine, heights[r])


@compiled
def _unit_columns(metres: np.ndarray, which: np.ndarray, out: np.ndarray) -> None:
    """Fill ``out`` (len(which), 15 * LANES) with rows of the identity, positions in metres."""
    out[:, :] = 0.0
    for i in range(which.shape[0]):
        j = which[i]
        for r in range(LANES):
            if j == 0:
                out[i, LANES + r] = metres[1, r]
            elif j == 1:
                out[i, r] = metres[0, r]
            else:
                out[i, j * LANES + r] = 1.0


@compiled
def _as_rows(columns: np.ndarray, metres: np.ndarray, r: int, out: np.ndarray) -> None:
    """Fill ``out`` (len(columns), 15) with the columns of run ``r``, of a state in metres."""
    for i in range(columns.shape[0]):
        out[i, 0] = columns[i, LANES + r] / metres[1, r]
        out[i, 1] = columns[i, r] / metres[0, r]
        for j in range(2, STATES):
            out[i, j] = columns[i, j * LANES + r]


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
    entries : (count, ENTRIES * LANES) of F in the intervals. dt : one of them [s].
    noise : that drives the state.
    start, end : (2, LANES) metres per radian of latitude and longitude at the ends.
    transition, process_cov : (R, n, n) of R <= LANES runs, output; states from 15 on are not
        touched.
    """
    # A bias that does not wander does not change: its rows are those of the identity.
    count = STATES if noise.wandering else NAVIGATION_STATES
    columns = aligned(count * STATES * LANES).reshape((count, STATES * LANES))
    white = aligned(count * 21 * LANES).reshape((count, 21 * LANES))
    biases = aligned(count * 18 * LANES).reshape((count, 18 * LANES))
    covariance = aligned(count * count * LANES).reshape((count, count, LANES))
    covariance[:] = 0.0
    roots, altimeter = noise.roots * math.sqrt(dt), noise.altimeter * math.sqrt(dt)
    _unit_columns(end, np.arange(count), columns)
    for n in range(entries.shape[0] - 1, -1, -1):
        if noise.wandering:
            wander(entries[n], dt, roots, columns, biases)
            for rows in range(3):
                add_six(biases, 6 * LANES * rows, covariance)
        back(entries[n], dt, roots, altimeter, columns, white)
        add_products(white, covariance)
        if noise.damped:
            add_six(white, 15 * LANES, covariance)
    for run in range(transition.shape[0]):
        _as_rows(columns, start, run, transition[run])
        for i in range(count, STATES):
            transition[run, i, :STATES] = 0.0
            transition[run, i, i] = 1.0
        process_cov[run, :STATES, :STATES] = 0.0
        for i in range(count):
            for j in range(i + 1):
                process_cov[run, i, j] = process_cov[run, j, i] = covariance[i, j, run]


@compiled
def transitions_lanes(
    track: np.ndarray,
    increments: np.ndarray,
    epochs: np.ndarray,
    dt: float,
    constant: np.ndarray,
    noise: Noise,
    transition: np.ndarray,
    process_cov: np.ndarray,
) -> None:
    """Fill Φ and Q between measurement epochs along the tracks of up to LANES runs.

    Parameters
    ----------
    track : (N + 1, TRACK, LANES) from :func:`ggbench.ins.strapdown.navigate_lanes`.
    increments : (N, 6, LANES) of the IMU.
    epochs : (K,) increasing indices of IMU samples. dt : IMU interval [s].
    constant : (ENTRIES,) what is added to F. noise : that drives the state.
    transition, process_cov : (R, K, n, n) of R runs, output; states from 15 on are not touched.
    """
    states = track.reshape((track.shape[0], TRACK * LANES))
    readings = increments.reshape((increments.shape[0], 6 * LANES))
    longest = epochs[0]
    for k in range(1, epochs.shape[0]):
        longest = max(longest, epochs[k] - epochs[k - 1])
    entries = aligned(longest * ENTRIES * LANES).reshape((longest, ENTRIES * LANES))
    start, end = np.empty((2, LANES)), np.empty((2, LANES))
    first = 0
    _metres(track[0, 0], track[0, 2], start)
    for k in range(epochs.shape[0]):
        last = epochs[k]
        for n in range(first, last):
            entries_between(
                states[n], states[n + 1], readings[n, 3 * LANES :], dt, constant, entries[n - first]
            )
        _metres(track[last, 0], track[last, 2], end)
        compose(entries[: last - first], dt, noise, start, end, transition[:, k], process_cov[:, k])
        start[:, :] = end
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
    entries : (count, ENTRIES * LANES) of F in the IMU intervals from t − τ to t.
    part : of the first interval that lies after t − τ [s]. dt : the others [s].
    then, now : (2, LANES) metres per radian at t − τ and at t.
    rows : output, of R <= LANES runs.
    """
    columns = aligned(6 * STATES * LANES).reshape((6, STATES * LANES))
    _unit_columns(then, np.array([0, 1, 2, 6, 7, 8]), columns)
    for n in range(entries.shape[0]):
        forward(entries[n], part if n == 0 else dt, columns)
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
    rows: np.ndarray,
) -> None:
    """Fill B (R, K, 6, 15) of :func:`.error_model.delayed_rows` along the tracks of R runs.

    Parameters
    ----------
    track, increments, epochs, dt, constant : as in :func:`transitions_lanes`.
    delays : (K,) [s]. rows : output.
    """
    states = track.reshape((track.shape[0], TRACK * LANES))
    readings = increments.reshape((increments.shape[0], 6 * LANES))
    then, now = np.empty((2, LANES)), np.empty((2, LANES))
    for k in range(epochs.shape[0]):
        last = epochs[k]
        first, part, nearest = intervals_of(delays[k], last, dt)
        count = last - first
        entries = aligned(count * ENTRIES * LANES).reshape((count, ENTRIES * LANES))
        for n in range(first, last):
            entries_between(
                states[n], states[n + 1], readings[n, 3 * LANES :], dt, constant, entries[n - first]
            )
        _metres(track[nearest, 0], track[nearest, 2], then)
        _metres(track[last, 0], track[last, 2], now)
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
