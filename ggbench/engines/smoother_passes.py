"""Forward, backward and covariance passes of Kalman smoothers of eight runs.

A forward Kalman filter and a backward pass of multipliers r (Bryson & Frazier; Bierman 1973) solve
a linear problem exactly: the smoothed state is x = x_f + P_f r, with the filtered state x_f and its
covariance P_f. Backwards, r ← Hᵀ S⁻¹ y + (I − K H)ᵀ r at a measurement and r ← Φᵀ r between two
measurements. Neither P nor Q is inverted, so Q may be singular. The cost of the process noise is ½
Σ rᵀ Q r.
"""

from __future__ import annotations

import numpy as np

from ..numerics import lane_algebra, lanes
from ..numerics.kernels import compiled
from ..numerics.vectors import load, splat, store
from .linear_problems import Linearisation, Scratch, Smoother, Updates, scratch_of


@compiled
def _update(
    rows: np.ndarray, target: np.ndarray, updates: Updates, k: int, p: np.ndarray, work: Scratch
) -> None:
    """Update x and P with the linear measurement (m, n) of epoch ``k``.

    The state x is ``work.x``, and P is ``p``. ``work`` is scratch for m equations. The data for the
    backward pass are stored in ``updates``.
    """
    lower, gain = updates.lower[k], updates.gains[k]
    m, n = rows.shape[0], rows.shape[1]
    for c in range(m):
        total = load(target, 0, c)
        for j in range(n):
            total -= load(rows, c, j) * load(work.x, 0, j)
        store(work.innovation, 0, c, total)
    lane_algebra.kalman_gain(
        rows=rows, p=p, m=m, hp=work.hp, lower=lower, half=work.half, gain=gain
    )
    lane_algebra.whiten(lower, m, work.innovation, work.white)
    lane_algebra.correct(work.half, work.white, m, work.x)
    column = work.white.reshape((m, 1, work.white.shape[2]))
    lane_algebra.solve_upper(lower, m, column, updates.pulls[k])
    lane_algebra.joseph(
        gain=gain, hp=work.hp, rows=rows, m=m, p=p, scratch=work.scratch, change=work.change
    )


@compiled
def filter_track(smoother: Smoother) -> None:
    """Filter the linear problems of a group; fill x_f (K, 1, n, lanes) and ``half_cov``."""
    restore_filter_state(smoother, -1)
    for k in range(smoother.path.moving.shape[0]):
        filter_epoch(smoother, k)


@compiled
def filter_epoch(smoother: Smoother, k: int) -> None:
    """Predict to epoch ``k``, update with its measurement, store x_f (1, n) and P_f (n, n)."""
    path, work = smoother.path, smoother.work
    lane_algebra.predict(path.phi[k], path.q[k], path.moving[k], work.x, work.p, work.scratch)
    _update(path.rows[k], path.target[k], path.updates, k, work.p, work)
    lane_algebra.copy(work.x, path.filtered[k])
    half = path.half_cov[k]
    place = 0
    for i in range(work.p.shape[0]):
        for j in range(i + 1):
            store(half, 0, place, load(work.p, i, j))
            place += 1


@compiled
def _back_through(
    rows: np.ndarray, updates: Updates, k: int, work: Scratch, back: np.ndarray
) -> None:
    """Propagate the multipliers r (1, n) back through an update: r ← r + Hᵀ (S⁻¹ y − Kᵀ r)."""
    gain, pulls = updates.gains[k], updates.pulls[k]
    m, n = rows.shape[0], rows.shape[1]
    for c in range(m):
        total = load(pulls, c, 0)
        for j in range(n):
            total -= load(gain, c, j) * load(back, 0, j)
        store(work.innovation, 0, c, total)
    for j in range(n):
        total = load(back, 0, j)
        for c in range(m):
            total += load(rows, c, j) * load(work.innovation, 0, c)
        store(back, 0, j, total)


@compiled
def _smoothed(path: Linearisation, k: int, back: np.ndarray, out: np.ndarray) -> None:
    """Fill ``out`` (1, n) with the smoothed state x_f + P_f r of epoch ``k``.

    ``back`` (1, n) are the multipliers r of all later measurements.
    """
    filtered, half = path.filtered[k], path.half_cov[k]
    n = filtered.shape[1]
    for j in range(n):
        total = load(filtered, 0, j)
        place = j * (j + 1) // 2
        for i in range(j + 1):
            total += load(half, 0, place + i) * load(back, 0, i)
        place += j
        for i in range(j + 1, n):
            place += i
            total += load(half, 0, place) * load(back, 0, i)
        store(out, 0, j, total)


@compiled
def _back_in_time(phi: np.ndarray, moving: int, back: np.ndarray, scratch: np.ndarray) -> None:
    """Propagate the multipliers r (1, n) back to the previous epoch: r ← Φᵀ r."""
    n = back.shape[1]
    for j in range(n):
        total = splat(0.0)
        if j >= moving:
            total = load(back, 0, j)
        for i in range(moving):
            total += load(phi, i, j) * load(back, 0, i)
        store(scratch, 0, j, total)
    lane_algebra.copy(scratch, back)


@compiled
def restore_filter_state(smoother: Smoother, k: int) -> None:
    """Restore the filter's x (1, n) and P (n, n) after the update of epoch ``k``.

    Epoch −1 is the prior.
    """
    batch, path, work = smoother.problems.batch, smoother.path, smoother.work
    if k < 0:
        lanes.broadcast(batch.prior_mean, work.x)
        lanes.broadcast(batch.prior_cov, work.p)
    else:
        lane_algebra.copy(path.filtered[k], work.x)
        _whole(path.half_cov[k], work.p)


@compiled
def smooth_back(smoother: Smoother, newest: int, oldest: int) -> None:
    """Fill the smoothed trial states (1, n) backwards from epoch ``newest`` to ``oldest``.

    At ``newest`` the smoothed state is the filtered state.
    """
    path, work = smoother.path, smoother.work
    back = work.back
    for j in range(back.shape[1]):
        store(back, 0, j, splat(0.0))
    for e in range(newest - oldest + 1):
        k = newest - e
        _smoothed(path, k, back, path.trial[k])
        _back_through(path.rows[k], path.updates, k, work, back)
        _back_in_time(path.phi[k], path.moving[k], back, work.x)


@compiled
def _whole(half: np.ndarray, matrix: np.ndarray) -> None:
    """Fill a symmetric matrix (n, n) from its stored lower half (1, n (n + 1) / 2)."""
    place = 0
    for i in range(matrix.shape[0]):
        for j in range(i + 1):
            value = load(half, 0, place)
            store(matrix, i, j, value)
            store(matrix, j, i, value)
            place += 1


@compiled
def backward_pass(smoother: Smoother) -> None:
    """Fill the trial trajectories x_f + P_f r, the motion costs and the predicted costs."""
    path, work = smoother.path, smoother.work
    prior_cov, costs = smoother.problems.batch.prior_cov, smoother.costs
    epochs, m, n = path.rows.shape[:3]
    back, x = work.back, work.x
    zero, two = splat(0.0), splat(2.0)
    for j in range(n):
        store(back, 0, j, zero)
    motion, promised = splat(0.0), splat(0.0)
    for e in range(epochs):
        k = epochs - 1 - e
        rows, phi, q, moving = path.rows[k], path.phi[k], path.q[k], path.moving[k]
        trial, target = path.trial[k], path.target[k]
        _smoothed(path, k, back, trial)
        for c in range(m):
            left = load(target, 0, c)
            for j in range(n):
                left -= load(rows, c, j) * load(trial, 0, j)
            promised += left * left
        _back_through(rows, path.updates, k, work, back)
        for i in range(moving):
            total = splat(0.0)
            for j in range(i):
                total += load(q, i, j) * load(back, 0, j)
            value = load(back, 0, i)
            motion += value * (two * total + load(q, i, i) * value)
        _back_in_time(phi, moving, back, x)
    for i in range(n):
        value = load(back, 0, i)
        for j in range(n):
            motion += value * splat(prior_cov[i, j]) * load(back, 0, j)
    store(costs.motion, 0, 0, motion)
    store(costs.promised, 0, 0, promised)


@compiled
def covariances(
    path: Linearisation,
    states: np.ndarray,
    newest: int,
    oldest: int,
    final: int,
    first: int,
    count: int,
    mean: np.ndarray,
    cov: np.ndarray,
) -> None:
    """Write smoothed trajectories and covariances, given the measurements of a window.

    A covariance is (P_f⁻¹ + Λ)⁻¹ = L (I + Lᵀ Λ L)⁻¹ Lᵀ with P_f = L Lᵀ and the information matrix Λ
    of the later measurements (Fraser & Potter 1969). No covariances are subtracted, so there is no
    cancellation. The filter must have processed the same linearisation.

    Parameters
    ----------
    path : the linearised problems, with the filter's results.
    states : (K, 1, n, lanes) the smoothed trajectories.
    newest, oldest : last and first epoch of the window.
    final : last epoch to write; the first is ``oldest``.
    first, count : first run and number of runs of the group.
    mean, cov : (R, K, n), (R, K, n, n) output.
    """
    n = path.rows.shape[2]
    root, later, nothing = lanes.lanes(n, n), lanes.lanes(n, n), lanes.lanes(n, n)
    work = scratch_of(n, n)  # process noise has up to n equations
    for step in range(newest - oldest + 1):
        k = newest - step
        if k <= final:
            _whole(path.half_cov[k], work.p)
            lane_algebra.transposed_root(work.p, n, root)
            lane_algebra.project(root, later, n, work.hp, work.s)
            lane_algebra.factorise(work.s, n, work.s)
            lane_algebra.solve_lower(work.s, n, root, work.half)
            lane_algebra.add_products(work.half, work.half, 1.0, nothing, work.p)
            lanes.scatter(x=states[k], p=work.p, first=first, count=count, k=k, mean=mean, cov=cov)
        if k > oldest:
            _inform_before(path, k, later, root, work)


@compiled
def _inform_before(
    path: Linearisation, k: int, later: np.ndarray, root: np.ndarray, work: Scratch
) -> None:
    """Propagate the information Λ (n, n) back over epoch ``k``, to the previous epoch.

    The measurement adds Hᵀ H. Process noise Q = R Rᵀ reduces Λ to (Λ⁻¹ + Q)⁻¹, which has the form
    of a covariance Λ updated with the rows Rᵀ. The transition gives Φᵀ Λ Φ. ``root`` (n, n) is
    overwritten.
    """
    rows, phi, p = path.rows[k], path.phi[k], work.p
    n, moving = p.shape[0], max(path.moving[k], 3)
    lane_algebra.add_products(rows, rows, 1.0, later, p)
    noise, gain, hp, change = root[:moving], work.other[:moving], work.hp[:moving], work.change
    lane_algebra.transposed_root(path.q[k], moving, noise)
    lane_algebra.kalman_gain(
        rows=noise, p=p, m=moving, hp=hp, lower=work.s, half=work.half, gain=gain
    )
    lane_algebra.joseph(
        gain=gain, hp=hp, rows=noise, m=moving, p=p, scratch=work.scratch, change=change
    )
    for i in range(n):
        for j in range(n):
            value = splat(1.0 if i == j else 0.0)
            if i < moving:
                value = load(phi, i, j)
            store(root, j, i, value)
    lane_algebra.products_of_rows(root, n, p, work.scratch)
    lane_algebra.products_of_rows(work.scratch, n, root, p)
    for i in range(n):
        for j in range(i + 1):
            value = load(p, i, j)
            store(later, i, j, value)
            store(later, j, i, value)
