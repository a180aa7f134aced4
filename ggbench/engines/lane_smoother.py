"""The batch solution of eight runs at once, compiled: see :mod:`ggbench.engines.batch_smoother`.

All runs of a group take their steps together, each by its own decisions; one that has ended stays
where it is. Damping is not felt here: a run that needs it is left to the kernel of single runs.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..block import ProblemBlock
from ..numerics import lane_algebra, lanes
from ..numerics.kernels import LANES, aligned, compiled
from ..numerics.vectors import load, splat, store
from ..sensors.model_kernels import ModelArrays
from .filters import noise_inverse
from .step_rules import FIRST_DAMPING, arrived, decide, is_last_step
from .whitened_readings import Readings, linearise, readings_of


class _Path(NamedTuple):
    """The linear problems of a group about its trajectories, and what the filter leaves of them.

    Attributes
    ----------
    moving : (K,) how many states Φ moves. phi, q : (K, n, n, LANES) their rows of Φ and Q.
    rows, target : (K, m, n, LANES), (K, 1, m, LANES): H x = target + noise of unit variance.
    old_rows, old_target : those of the step before.
    states, trial : (K, 1, n, LANES) the trajectory and the one that is tried.
    filtered, half_cov : (K, 1, n, LANES), (K, 1, n (n + 1) / 2, LANES): x_f and P_f, half of it.
    gains, lower, pulls : (K, m, n, LANES), (K, m, m, LANES), (K, m, 1, LANES): Kᵀ, the root of S
        (see :func:`.lanes.factorise`) and S⁻¹ y.
    """

    moving: np.ndarray
    phi: np.ndarray
    q: np.ndarray
    rows: np.ndarray
    target: np.ndarray
    old_rows: np.ndarray
    old_target: np.ndarray
    states: np.ndarray
    trial: np.ndarray
    filtered: np.ndarray
    half_cov: np.ndarray
    gains: np.ndarray
    lower: np.ndarray
    pulls: np.ndarray


class _Work(NamedTuple):
    """Scratch for one epoch: arrays of lanes named as what they hold for a while."""

    x: np.ndarray
    p: np.ndarray
    scratch: np.ndarray
    other: np.ndarray
    hp: np.ndarray
    half: np.ndarray
    change: np.ndarray
    s: np.ndarray
    innovation: np.ndarray
    white: np.ndarray
    back: np.ndarray


class _Costs(NamedTuple):
    """Sums along the trial trajectories, (1, 1, LANES) each.

    Attributes
    ----------
    unexplained : squares of what no state explains.
    explained : squares of the other residuals; promised : what the linear problem said of them.
    motion : the cost of the motion, twice.
    """

    unexplained: np.ndarray
    explained: np.ndarray
    promised: np.ndarray
    motion: np.ndarray


@compiled
def _series(epochs: int, rows: int, columns: int) -> np.ndarray:
    """Return an array (epochs, rows, columns, LANES), not yet filled."""
    return aligned(epochs * rows * columns * LANES).reshape((epochs, rows, columns, LANES))


@compiled
def _path_of(epochs: int, n: int, m: int) -> _Path:
    """Return the arrays of a group; rows and targets before the first step are zero."""
    path = _Path(
        np.zeros(epochs, dtype=np.int64), _series(epochs, n, n), _series(epochs, n, n),
        _series(epochs, m, n), _series(epochs, 1, m), _series(epochs, m, n),
        _series(epochs, 1, m), _series(epochs, 1, n), _series(epochs, 1, n),
        _series(epochs, 1, n), _series(epochs, 1, n * (n + 1) // 2), _series(epochs, m, n),
        _series(epochs, m, m), _series(epochs, m, 1),
    )  # fmt: skip
    path.rows[:] = 0.0
    path.target[:] = 0.0
    return path


@compiled
def _work_of(n: int, m: int) -> _Work:
    """Return the scratch for n states and m equations."""
    new = lanes.lanes
    return _Work(
        new(1, n), new(n, n), new(n, n), new(n, n), new(m, n), new(m, n), new(m, n), new(m, m),
        new(1, m), new(1, m), new(1, n),
    )  # fmt: skip


@compiled
def _copy(source: np.ndarray, out: np.ndarray) -> None:
    """Copy an array of lanes (rows, columns, LANES)."""
    for i in range(source.shape[0]):
        for j in range(source.shape[1]):
            store(out, i, j, load(source, i, j))


@compiled
def _put_back(path: _Path, k: int, r: int) -> None:
    """Give a run the linear problem of the step before, at an epoch."""
    for c in range(path.rows.shape[1]):
        path.target[k, 0, c, r] = path.old_target[k, 0, c, r]
        for j in range(path.rows.shape[2]):
            path.rows[k, c, j, r] = path.old_rows[k, c, j, r]


@compiled
def _judge(path: _Path, reading: Readings, k: int, costs: _Costs) -> None:
    """Replace the linear problem of an epoch by the one about the trial; add up the costs."""
    rows, target, trial = path.rows[k], path.target[k], path.trial[k]
    m, n = rows.shape[0], rows.shape[1]
    explained = load(costs.explained, 0, 0)
    for c in range(m):
        new = load(reading.innovation, 0, c)
        explained += new * new
        for j in range(n):
            new += load(reading.rows, c, j) * load(trial, 0, j)
        store(path.old_target[k], 0, c, load(target, 0, c))
        store(target, 0, c, new)
    store(costs.explained, 0, 0, explained)
    total = load(costs.unexplained, 0, 0) + load(reading.squared, 0, 0)
    store(costs.unexplained, 0, 0, total)
    _copy(rows, path.old_rows[k])
    _copy(reading.rows, rows)


@compiled
def _update(path: _Path, k: int, work: _Work) -> None:
    """Update x and P with the linear reading of an epoch; keep what the way back needs."""
    rows, lower, gain, target = path.rows[k], path.lower[k], path.gains[k], path.target[k]
    m, n = rows.shape[0], rows.shape[1]
    for c in range(m):
        total = load(target, 0, c)
        for j in range(n):
            total -= load(rows, c, j) * load(work.x, 0, j)
        store(work.innovation, 0, c, total)
    lane_algebra.project(rows, work.p, m, work.hp, work.s)
    lane_algebra.factorise(work.s, m, lower)
    lane_algebra.whiten(lower, m, work.innovation, work.white)
    lane_algebra.solve_lower(lower, m, work.hp, work.half)
    lane_algebra.correct(work.half, work.white, m, work.x)
    lane_algebra.solve_upper(lower, m, work.half, gain)
    lane_algebra.solve_upper(lower, m, work.white.reshape((m, 1, LANES)), path.pulls[k])
    lane_algebra.joseph(gain, work.hp, rows, m, work.p, work.scratch, work.change)
    _copy(work.x, path.filtered[k])
    half = path.half_cov[k]
    place = 0
    for i in range(n):
        for j in range(i + 1):
            store(half, 0, place, load(work.p, i, j))
            place += 1


@compiled
def _back(path: _Path, prior_cov: np.ndarray, work: _Work, costs: _Costs) -> None:
    """Fill the trial trajectories, x_f + P_f r; what their motion and, linearly, readings cost."""
    epochs, m, n = path.rows.shape[0], path.rows.shape[1], path.rows.shape[2]
    back, x = work.back, work.x
    zero, two = splat(0.0), splat(2.0)
    for j in range(n):
        store(back, 0, j, zero)
    motion, promised = splat(0.0), splat(0.0)
    for e in range(epochs):
        k = epochs - 1 - e
        rows, gain, half, pulls = path.rows[k], path.gains[k], path.half_cov[k], path.pulls[k]
        phi, q, moving = path.phi[k], path.q[k], path.moving[k]
        filtered, trial, target = path.filtered[k], path.trial[k], path.target[k]
        for j in range(n):
            total = load(filtered, 0, j)
            place = j * (j + 1) // 2
            for i in range(j + 1):
                total += load(half, 0, place + i) * load(back, 0, i)
            place += j
            for i in range(j + 1, n):
                place += i
                total += load(half, 0, place) * load(back, 0, i)
            store(trial, 0, j, total)
        for c in range(m):
            total, left = load(pulls, c, 0), load(target, 0, c)
            for j in range(n):
                total -= load(gain, c, j) * load(back, 0, j)
                left -= load(rows, c, j) * load(trial, 0, j)
            promised += left * left
            store(work.innovation, 0, c, total)
        for j in range(n):
            total = load(back, 0, j)
            for c in range(m):
                total += load(rows, c, j) * load(work.innovation, 0, c)
            store(back, 0, j, total)
        for i in range(moving):
            total = splat(0.0)
            for j in range(i):
                total += load(q, i, j) * load(back, 0, j)
            value = load(back, 0, i)
            motion += value * (two * total + load(q, i, i) * value)
        for j in range(n):
            total = splat(0.0)
            if j >= moving:
                total = load(back, 0, j)
            for i in range(moving):
                total += load(phi, i, j) * load(back, 0, i)
            store(x, 0, j, total)
        _copy(x, back)
    for i in range(n):
        value = load(back, 0, i)
        for j in range(n):
            motion += value * splat(prior_cov[i, j]) * load(back, 0, j)
    store(costs.motion, 0, 0, motion)
    store(costs.promised, 0, 0, promised)


@compiled
def _covariances(
    path: _Path, first: int, count: int, work: _Work, mean: np.ndarray, cov: np.ndarray
) -> None:
    """Write the trajectories and their covariances P_f − P_f Λ P_f, given all readings."""
    epochs, m, n = path.rows.shape[0], path.rows.shape[1], path.rows.shape[2]
    f, phi_t = lanes.lanes(n, n), lanes.lanes(n, n)
    later, t, p = work.other, work.scratch, work.p
    pulled, e, s = work.hp, work.change, work.s
    later[:] = 0.0
    half_of = splat(0.5)
    for step in range(epochs):
        k = epochs - 1 - step
        rows, gain, lower, phi = path.rows[k], path.gains[k], path.lower[k], path.phi[k]
        half, moving = path.half_cov[k], path.moving[k]
        place = 0
        for i in range(n):
            for j in range(i + 1):
                value = load(half, 0, place)
                store(f, i, j, value)
                store(f, j, i, value)
                place += 1
        lane_algebra.products_of_rows(f, n, later, t)
        lane_algebra.products_of_rows(t, n, f, p)
        for i in range(n):
            for j in range(i + 1):
                value = load(f, i, j) - load(p, i, j)
                store(p, i, j, value)
                store(p, j, i, value)
        lanes.scatter(path.states[k], p, first, count, k, mean, cov)
        # Hᵀ S⁻¹ H + (I − K H)ᵀ Λ (I − K H) = Λ + Hᵀ E + Eᵀ H, E = ½ (Kᵀ Λ K + S⁻¹) H − Kᵀ Λ
        lane_algebra.products_of_rows(gain, m, later, pulled)
        lane_algebra.solve_lower(lower, m, rows, e)
        lane_algebra.solve_upper(lower, m, e, e)
        for c in range(m):
            for d in range(m):
                total = splat(0.0)
                for j in range(n):
                    total += load(pulled, c, j) * load(gain, d, j)
                store(s, c, d, total)
            for j in range(n):
                total = load(e, c, j)
                for d in range(m):
                    total += load(s, c, d) * load(rows, d, j)
                store(e, c, j, half_of * total - load(pulled, c, j))
        for i in range(n):
            for j in range(i + 1):
                total = load(later, i, j)
                for c in range(m):
                    total += load(rows, c, i) * load(e, c, j)
                    total += load(e, c, i) * load(rows, c, j)
                store(later, i, j, total)
                store(later, j, i, total)
        for i in range(n):
            for j in range(n):
                value = splat(1.0 if i == j else 0.0)
                if i < moving:
                    value = load(phi, i, j)
                store(phi_t, j, i, value)
        lane_algebra.products_of_rows(phi_t, n, later, t)
        lane_algebra.products_of_rows(t, n, phi_t, p)
        for i in range(n):
            for j in range(i + 1):
                value = load(p, i, j)
                store(later, i, j, value)
                store(later, j, i, value)


@compiled
def _smooth(
    measurements: np.ndarray,
    noise_inverse: np.ndarray,
    transition: np.ndarray,
    process_cov: np.ndarray,
    prior_mean: np.ndarray,
    prior_cov: np.ndarray,
    model: ModelArrays,
    most: int,
    mean: np.ndarray,
    cov: np.ndarray,
    iterations: np.ndarray,
    errors: np.ndarray,
    evaluations: np.ndarray,
    damped: np.ndarray,
) -> None:
    """Solve the problems of a block, see :func:`smoother`; ``damped`` (R,) is left to others."""
    runs, epochs = measurements.shape[0], measurements.shape[1]
    n = prior_mean.shape[0]
    expected = lanes.moving_states(transition, process_cov)
    reading = readings_of(model, n, measurements.shape[2])
    m = reading.rows.shape[0]
    path, work = _path_of(epochs, n, m), _work_of(n, m)
    costs = _Costs(lanes.lanes(1, 1), lanes.lanes(1, 1), lanes.lanes(1, 1), lanes.lanes(1, 1))
    active = np.zeros(LANES, dtype=np.bool_)
    cost, unexplained, linear = np.zeros(LANES), np.zeros(LANES), np.zeros(LANES)
    damping = np.zeros(LANES)
    for first in range(0, runs, LANES):
        count = min(LANES, runs - first)
        group = lanes.members(first, runs)
        active[:] = False
        active[:count] = True
        damping[:] = FIRST_DAMPING
        lanes.spread(prior_mean.reshape((1, n)), work.x)
        # The undisturbed motion from the prior's mean.
        for k in range(epochs):
            path.moving[k] = lanes.gather(
                transition, process_cov, group, k, expected, path.phi[k], path.q[k]
            )
            lane_algebra.move(path.phi[k], path.moving[k], work.x, work.scratch)
            _copy(work.x, path.trial[k])
        costs.motion[:] = 0.0
        begun, going = False, True
        while going:
            _forward(
                model, measurements, noise_inverse, prior_mean, prior_cov, group, count, active,
                True, path, reading, work, costs,
            )  # fmt: skip
            going = stale = False
            for r in range(count):
                if not active[r]:
                    continue
                run = first + r
                evaluations[run] += epochs
                left = costs.unexplained[0, 0, r]
                new_cost = 0.5 * (costs.motion[0, 0, r] + left + costs.explained[0, 0, r])
                good, final = True, False
                if begun:
                    good, final, damping[r] = decide(cost[r], linear[r], new_cost, damping[r])
                if good:
                    for k in range(epochs):
                        for i in range(n):
                            path.states[k, 0, i, r] = path.trial[k, 0, i, r]
                    cost[r], unexplained[r] = new_cost, left
                    if begun:
                        iterations[run] += 1
                        final |= iterations[run] >= most
                else:
                    stale = True
                    for k in range(epochs):
                        _put_back(path, k, r)
                    damped[run] = not final
                active[r] = good and not final
                going |= active[r]
            begun = True
            if going:
                _back(path, prior_cov, work, costs)
                going = False
                for r in range(count):
                    linear[r] = 0.5 * (
                        costs.motion[0, 0, r] + unexplained[r] + costs.promised[0, 0, r]
                    )
                    active[r] &= not arrived(cost[r], linear[r])
                    going |= active[r]
            if stale and not going:
                _forward(
                    model, measurements, noise_inverse, prior_mean, prior_cov, group, count, active,
                    False, path, reading, work, costs,
                )  # fmt: skip
        # The filter has gone along the final trajectories: one step more, too small to be judged.
        _back(path, prior_cov, work, costs)
        for r in range(count):
            errors[first + r] = cost[r]
            linear_cost = 0.5 * (costs.motion[0, 0, r] + unexplained[r] + costs.promised[0, 0, r])
            if is_last_step(cost[r], linear_cost):
                for k in range(epochs):
                    for i in range(n):
                        path.states[k, 0, i, r] = path.trial[k, 0, i, r]
        _covariances(path, first, count, work, mean, cov)


@compiled
def _forward(
    model: ModelArrays,
    measurements: np.ndarray,
    noise_inverse: np.ndarray,
    prior_mean: np.ndarray,
    prior_cov: np.ndarray,
    group: np.ndarray,
    count: int,
    active: np.ndarray,
    anew: bool,
    path: _Path,
    reading: Readings,
    work: _Work,
    costs: _Costs,
) -> None:
    """Filter all runs; if ``anew``, those that are active linearised about their trials."""
    costs.unexplained[:] = 0.0
    costs.explained[:] = 0.0
    lanes.spread(prior_mean.reshape((1, prior_mean.shape[0])), work.x)
    lanes.spread(prior_cov, work.p)
    for k in range(path.rows.shape[0]):
        if anew:
            linearise(model, measurements, noise_inverse, group, count, k, path.trial[k], reading)
            _judge(path, reading, k, costs)
            for r in range(count):
                if not active[r]:
                    _put_back(path, k, r)
        lane_algebra.predict(path.phi[k], path.q[k], path.moving[k], work.x, work.p, work.scratch)
        _update(path, k, work)


def smoother(
    block: ProblemBlock, most: int
) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray], np.ndarray]:
    """Solve the batch problem of every run that needs no damping.

    Parameters
    ----------
    block : the runs. most : limit of the steps.

    Returns
    -------
    mean (R, K, n); cov (R, K, n, n); counters; which runs (R,) need damping and are not solved.
    """
    runs, epochs, n = block.runs, block.epochs, block.dimension
    mean, cov = np.empty((runs, epochs, n)), np.empty((runs, epochs, n, n))
    iterations, evaluations = np.zeros(runs, dtype=np.int64), np.zeros(runs, dtype=np.int64)
    error, damped = np.zeros(runs), np.zeros(runs, dtype=bool)
    _smooth(
        block.measurements, noise_inverse(block), block.transition, block.process_cov,
        block.prior_mean, block.prior_cov, block.model, most,
        mean, cov, iterations, error, evaluations, damped,
    )  # fmt: skip
    mean[(iterations == 0) & (error > 0.0)] = np.nan  # it gave up
    counters = {"iterations": iterations, "error": error, "map_evaluations": evaluations}
    return mean, cov, counters, damped
