"""What the sigma points of eight runs read, compiled: those that are far enough to be evaluated."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..gravity.ellipsoid import ROTATION_RATE, metres_per_radian_of
from ..gravity.field import gradients
from ..numerics.kernels import LANES, aligned, compiled
from ..numerics.lanes import lanes
from ..numerics.rotations import sine_cosine
from ..numerics.vectors import load, load_from, splat, store, store_from
from ..sensors.gradiometer.instrument import PLATFORM, STRAPDOWN, platform_readings
from ..sensors.model_kernels import SMALL, ModelArrays, predict_errors, run_arrays, turned
from ..sensors.model_lanes import TURN
from .whitened_readings import Readings

_NEAR, _STRAIGHT = 0.01, 1e-7
"""Displacements [m], [rad] of the instrument over which h is a straight line."""
_EVEN = 2
"""Pairs of points are evaluated by so many, so that no loop over points leaves a remainder: what a
run's points read then does not depend on how many points other runs have."""


class Points(NamedTuple):
    """Sigma points x ± d_q of eight runs and what they read.

    Attributes
    ----------
    shift : (moving, n, LANES) B_k d_q [m; rad].
    odd, even : (m, n, LANES) half the difference and half the sum of h(x ± d_q) − h(x) [E].
    far : (LANES, n) which points are evaluated, of each run. counts : (LANES,) how many pairs.
    buffer, chosen, own : scratch.
    """

    shift: np.ndarray
    odd: np.ndarray
    even: np.ndarray
    far: np.ndarray
    counts: np.ndarray
    buffer: np.ndarray
    chosen: np.ndarray
    own: np.ndarray


@compiled
def points_of(moving: int, n: int, m: int) -> Points:
    """Return the arrays for points of n states and readings of m components."""
    most = 2 * (n + _EVEN) * LANES
    return Points(
        lanes(moving, n), lanes(m, n), lanes(m, n), np.zeros((LANES, n), dtype=np.int64),
        np.zeros(LANES, dtype=np.int64), aligned((15 + m) * most),
        lanes(3, n + _EVEN), lanes(1, 9),
    )  # fmt: skip


@compiled
def read_points(
    model: ModelArrays,
    group: np.ndarray,
    count: int,
    k: int,
    lower: np.ndarray,
    spread: float,
    reading: Readings,
    out: Points,
) -> None:
    """Fill what the sigma points x ± spread · L_q read, biases left out.

    Parameters
    ----------
    model, group, count, k : of a block, runs (LANES,) of which ``count`` differ, epoch.
    lower : (n, n, LANES) root of P. spread : by how much its columns are stretched.
    reading : h(x), its slope and B_k.
    out : output; ``counts`` of pairs that were evaluated.
    """
    shift, odd, even, counts = out.shift, out.odd, out.even, out.counts
    b, slope, gain = reading.b, reading.slope, model.gain
    moving, n, m = shift.shape[0], shift.shape[1], odd.shape[0]
    columns = b.shape[1]
    factor, zero = splat(spread), splat(0.0)
    for i in range(moving):
        for q in range(n):
            total = zero
            for j in range(q, columns):
                total += load(b, i, j) * load(lower, j, q)
            store(shift, i, q, factor * total)
    for c in range(m):
        for q in range(n):
            total = zero
            for i in range(moving):
                total += load(slope, c, i) * load(shift, i, q)
            store(odd, c, q, total)
            store(even, c, q, zero)
    most = 0
    for r in range(LANES):
        counts[r] = 0
        if r < count and gain[group[r], k] != 0.0:
            counts[r] = _far(out, r)
            most = max(most, counts[r])
    if most == 0:
        return
    if model.instrument == STRAPDOWN:
        for r in range(count):
            if counts[r] > 0:
                _evaluate_run(run_arrays(model, group[r]), k, r, reading, out)
    else:
        _evaluate(model, group, k, most + most % _EVEN, _alike(count, out), reading, out)


@compiled
def _far(out: Points, r: int) -> int:
    """List the points of a run over which h may bend; return how many pairs there are."""
    shift, far = out.shift, out.far
    moving, n = shift.shape[0], shift.shape[1]
    count = 0
    for q in range(n):
        size = turn = 0.0
        for i in range(3):
            size += shift[i, q, r] * shift[i, q, r]
        for i in range(3, moving):
            turn += shift[i, q, r] * shift[i, q, r]
        if not (size < _NEAR * _NEAR and turn < _STRAIGHT * _STRAIGHT):
            far[r, count] = q
            count += 1
    return count


@compiled
def _alike(count: int, points: Points) -> int:
    """Return of how many pairs, the first in the lists, ``count`` runs have the same."""
    fewest = points.counts[0]
    for r in range(1, count):
        fewest = min(fewest, points.counts[r])
    for s in range(fewest):
        for r in range(1, count):
            if points.far[r, s] != points.far[0, s]:
                return s
    return fewest


@compiled
def _evaluate_run(own: ModelArrays, k: int, r: int, reading: Readings, out: Points) -> None:
    """Evaluate the far points of one run."""
    moving, m, count = out.shift.shape[0], out.odd.shape[0], out.counts[r]
    errors = out.buffer[: 12 * count].reshape((6, 2 * count))
    found = out.buffer[12 * count : (12 + 2 * m) * count].reshape((m, 2 * count))
    for i in range(moving):
        centre = reading.errors[0, i, r]
        for s in range(count):
            shift = out.shift[i, out.far[r, s], r]
            errors[i, s], errors[i, count + s] = centre + shift, centre - shift
    predict_errors(own, k, errors, found)
    for c in range(m):
        centre = reading.predicted[0, c, r]
        for s in range(count):
            plus, minus = found[c, s] - centre, found[c, count + s] - centre
            out.odd[c, out.far[r, s], r] = 0.5 * (plus - minus)
            out.even[c, out.far[r, s], r] = 0.5 * (plus + minus)


@compiled
def _evaluate(
    model: ModelArrays,
    group: np.ndarray,
    k: int,
    pairs: int,
    alike: int,
    reading: Readings,
    out: Points,
) -> None:
    """Evaluate the far points of all runs, as :func:`.model_kernels.predict_errors` does.

    Point ``s`` of a run is at s * LANES + r; a run with fewer than ``pairs`` is filled up.
    The first ``alike`` pairs are the same ones in all runs.
    """
    odd, even, far, counts = out.odd, out.even, out.far, out.counts
    shift, chosen, own, buffer = out.shift, out.chosen, out.own, out.buffer
    errors, predicted, gains = reading.errors, reading.predicted, reading.gain
    references, offsets, channels = model.references, model.offset, model.channels
    count, half = 2 * pairs * LANES, pairs * LANES
    positions = buffer[: 3 * count].reshape((3, count))
    tensors = buffer[3 * count : 9 * count].reshape((6, count))
    trigonometry = buffer[9 * count : 13 * count].reshape((4, count))
    growth = buffer[13 * count : 15 * count].reshape((2, count))
    turning = ROTATION_RATE * model.times[k]
    for r in range(LANES):
        reference = references[group[r], k]
        latitude, longitude, angle = reference[0], reference[1], reference[1] + turning
        sine, cosine = sine_cosine(latitude)
        own[0, 0, r], own[0, 1, r], own[0, 2, r] = latitude, longitude, reference[2]
        own[0, 3, r], own[0, 4, r] = sine, cosine
        own[0, 5, r], own[0, 6, r] = sine_cosine(angle - TURN * math.floor(angle / TURN + 0.5))
        own[0, 7, r], own[0, 8, r] = metres_per_radian_of(sine, cosine, reference[2])
    for i in range(3):
        for s in range(pairs):
            if s < alike:
                store(chosen, i, s, load(shift, i, far[0, s]))
                continue
            for r in range(LANES):
                q = far[r, s]
                chosen[i, s, r] = shift[i, q, r] if s < counts[r] else 0.0
    latitude, longitude, height = load(own, 0, 0), load(own, 0, 1), load(own, 0, 2)
    sine, cosine = load(own, 0, 3), load(own, 0, 4)
    sine_a, cosine_a = load(own, 0, 5), load(own, 0, 6)
    per_north, per_east = load(own, 0, 7), load(own, 0, 8)
    for side in range(2):
        sign = 1.0 - 2.0 * side
        for s in range(pairs):
            p = side * half + s * LANES
            # Linear in the error, as the error state is.
            east = load(errors, 0, 0) + sign * load(chosen, 0, s)
            north = load(errors, 0, 1) + sign * load(chosen, 1, s)
            up = load(errors, 0, 2) + sign * load(chosen, 2, s)
            growth_n, growth_e = 0.0 - north / per_north, 0.0 - east / per_east
            store_from(growth, p, growth_n)
            store_from(growth, count + p, growth_e)
            store_from(positions, p, latitude + growth_n)
            store_from(positions, count + p, longitude + growth_e)
            store_from(positions, 2 * count + p, height - up)
            one, two = turned(sine, cosine, growth_n)
            store_from(trigonometry, p, one)
            store_from(trigonometry, count + p, two)
            one, two = turned(sine_a, cosine_a, growth_e)
            store_from(trigonometry, 2 * count + p, one)
            store_from(trigonometry, 3 * count + p, two)
    for p in range(count):
        if abs(growth[0, p]) > SMALL or abs(growth[1, p]) > SMALL:
            north, angle = positions[0, p], positions[1, p] + turning
            trigonometry[0, p], trigonometry[1, p] = math.sin(north), math.cos(north)
            trigonometry[2, p], trigonometry[3, p] = math.sin(angle), math.cos(angle)
    gradients(
        positions, trigonometry[0], trigonometry[1],
        model.origin, model.step, model.coefficients, tensors,
    )  # fmt: skip
    if model.instrument == PLATFORM:
        platform_readings(
            trigonometry[0], trigonometry[1], trigonometry[2], trigonometry[3], tensors
        )
    for c in range(odd.shape[0]):
        channel = channels[c]
        for r in range(LANES):
            own[0, 0, r] = predicted[0, c, r] - offsets[group[r], k, c]
        gain, centre = load(gains, 0, 0), load(own, 0, 0)
        for s in range(pairs):
            plus, minus = splat(0.0), splat(0.0)
            for i in range(6):
                at = i * count + s * LANES
                plus += channel[i] * load_from(tensors, at)
                minus += channel[i] * load_from(tensors, half + at)
            plus, minus = gain * plus - centre, gain * minus - centre
            if s < alike:
                store(odd, c, far[0, s], 0.5 * (plus - minus))
                store(even, c, far[0, s], 0.5 * (plus + minus))
                continue
            store(own, 0, 1, 0.5 * (plus - minus))
            store(own, 0, 2, 0.5 * (plus + minus))
            for r in range(LANES):
                if s < counts[r]:
                    q = far[r, s]
                    odd[c, q, r], even[c, q, r] = own[0, 1, r], own[0, 2, r]
