"""The batch solution of many runs at once, compiled: the factor graph's problem by smoothers.

Each step linearises h about the whole trajectory and solves the linear problem exactly with a
Kalman filter forwards and multipliers backwards (Bryson & Frazier; Bierman 1973): x = x_f + P_f r
with r ← Hᵀ S⁻¹ y + (I − K H)ᵀ r at a reading and r ← Φᵀ r between two. Neither P nor Q is inverted,
so a singular Q is exact, and the cost of the motion is that of the multipliers, ½ Σ rᵀ Q r.

Steps are those of GTSAM's Levenberg–Marquardt optimizer, which remains the reference: the same
damping, the same rules by which steps are taken and the search ends, so that it ends at the same
minimum where there are several. Damping with λ is a reading of every state in units of the prior's
deviation with the variance 1/λ.

Runs are solved eight at once (:mod:`.lane_smoother`); those that need damping, from the start and
one by one, by the kernel of this module.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from ..block import ProblemBlock
from ..numerics.kernels import compiled
from ..sensors.gradiometer.instrument import STRAPDOWN
from ..sensors.model_kernels import ModelArrays, run_arrays
from . import lane_smoother, padded_steps
from .filters import noise_inverse
from .padded_steps import SIZES, size_of, whitened_reading
from .step_rules import FIRST_DAMPING, LEAST_FELT, decide, is_last_step


@compiled
def _damp(
    x: np.ndarray, p: np.ndarray, current: np.ndarray, spread: np.ndarray, inverse: np.ndarray
) -> np.ndarray:
    """Update x and P (n, n) with a reading of every state: ``current``, of variances ``spread``.

    Fill S⁻¹ (n, n); return S⁻¹ y.
    """
    n = current.shape[0]
    s = p.copy()
    for i in range(n):
        s[i, i] += spread[i]
    inverse[:, :] = np.linalg.inv(s)
    pull = inverse @ (current - x)
    before = p.copy()
    x += before @ pull
    p -= before @ inverse @ before
    for i in range(n):
        for j in range(i):
            p[i, j] = p[j, i] = 0.5 * (p[i, j] + p[j, i])
    return pull


def _make_smoother(width: int, channels: int) -> Callable[..., Any]:
    """Return the kernel of the batch solution for up to so many states and components."""

    @compiled
    def smoother(
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
        chosen: np.ndarray,
    ) -> None:
        epochs, m = measurements.shape[1:]
        n, m = prior_mean.shape[0], min(m, channels)
        moving = 6 if model.instrument == STRAPDOWN else 3
        phi, phi_t = np.zeros((width, width)), np.zeros((width, width))
        p, scratch = np.zeros((width, width)), np.zeros((width, width))
        later = np.zeros((width, width))
        hp, half_t = np.zeros((channels, width)), np.zeros((channels, width))
        spread_t, pulled = np.zeros((channels, width)), np.zeros((channels, width))
        s, root = np.zeros((channels, channels)), np.zeros((channels, channels))
        innovation, white = np.zeros(channels), np.zeros(channels)
        work = np.zeros((3, 9, 9))
        x, back = np.zeros(width), np.zeros(width)
        # The linear problem at the current trajectory and at the one that is tried.
        rows, new_rows = np.zeros((epochs, channels, width)), np.zeros((epochs, channels, width))
        target, new_target = np.zeros((epochs, channels)), np.zeros((epochs, channels))
        states, new_states = np.zeros((epochs, width)), np.zeros((epochs, width))
        # What the filter leaves for the way back.
        filtered, filtered_cov = np.zeros((epochs, width)), np.zeros((epochs, width, width))
        gains, inverses = (
            np.zeros((epochs, channels, width)), np.zeros((epochs, channels, channels)),
        )  # fmt: skip
        pulls = np.zeros((epochs, channels))
        damped_cov, damped_inverse = np.zeros((0, n, n)), np.zeros((0, n, n))
        damped_pulls = np.zeros((0, n))
        for run in chosen:
            own = run_arrays(model, run)
            # The undisturbed motion from the prior's mean.
            cost = left = 0.0
            x[:n] = prior_mean
            for k in range(epochs):
                for i in range(n):
                    total = 0.0
                    for j in range(n):
                        total += transition[run, k, i, j] * x[j]
                    states[k, i] = total
                x[:n] = states[k, :n]
            unexplained = 0.0
            for k in range(epochs):
                left, _ = whitened_reading(
                    own, k, states[k], measurements[run, k], noise_inverse, moving, work,
                    rows[k], innovation,
                )  # fmt: skip
                unexplained += left
                cost += 0.5 * (
                    left + padded_steps.to_target(rows[k], states[k], innovation, target[k])
                )
            evaluated = 1
            damping = FIRST_DAMPING
            steps = 0
            final = False
            while True:
                felt = damping >= LEAST_FELT and not final
                if felt and damped_cov.shape[0] == 0:
                    damped_cov, damped_inverse = (
                        np.zeros((epochs, n, n)), np.zeros((epochs, n, n)),
                    )  # fmt: skip
                    damped_pulls = np.zeros((epochs, n))
                x[:n] = prior_mean
                p[:, :] = 0.0
                p[:n, :n] = prior_cov
                for k in range(epochs):
                    changing = padded_steps.padded(transition[run, k], phi, phi_t)
                    padded_steps.predict(
                        phi, phi_t, changing, process_cov[run, k], x, p, scratch, width
                    )
                    h, gain_t, inverse = rows[k], gains[k], inverses[k]
                    for c in range(m):
                        total = target[k, c]
                        for j in range(n):
                            total -= h[c, j] * x[j]
                        innovation[c] = total
                    padded_steps.project(h, p, hp, s, m, width)
                    padded_steps.invert_root(s, root, inverse, m)
                    padded_steps.whiten(inverse, innovation, white, m)
                    padded_steps.times(inverse, hp, half_t, m, channels, width)
                    for j in range(width):
                        total = x[j]
                        for c in range(channels):
                            total += half_t[c, j] * white[c]
                        x[j] = total
                    for c in range(m):
                        total = 0.0
                        for d in range(c, m):
                            total += inverse[d, c] * white[d]
                        pulls[k, c] = total
                    padded_steps.transpose_times(inverse, half_t, gain_t, m, channels, width)
                    padded_steps.joseph(gain_t, hp, h, p, scratch, spread_t, n, m, channels, width)
                    if felt:
                        damped_cov[k] = p[:n, :n]
                        damped_pulls[k] = _damp(
                            x[:n], p[:n, :n], states[k, :n],
                            np.diag(prior_cov) / damping, damped_inverse[k],
                        )  # fmt: skip
                    filtered[k] = x
                    filtered_cov[k] = p
                # The way back: states and the cost of their motion.
                new_cost = 0.0
                back[:] = 0.0
                for r in range(epochs):
                    k = epochs - 1 - r
                    f, h, gain_t = filtered_cov[k], rows[k], gains[k]
                    for j in range(width):
                        total = filtered[k, j]
                        for i in range(width):
                            total += f[i, j] * back[i]
                        new_states[k, j] = total
                    if felt:
                        back[:n] += damped_pulls[k] - damped_inverse[k] @ (damped_cov[k] @ back[:n])
                    for c in range(m):
                        total = pulls[k, c]
                        for j in range(n):
                            total -= gain_t[c, j] * back[j]
                        innovation[c] = total
                    for c in range(m):
                        for j in range(width):
                            back[j] += h[c, j] * innovation[c]
                    new_cost += 0.5 * padded_steps.quadratic(process_cov[run, k], back)
                    padded_steps.padded(transition[run, k], phi, phi_t)
                    for j in range(width):
                        total = 0.0
                        for i in range(width):
                            total += phi[i, j] * back[i]
                        x[j] = total
                    back[:] = x
                new_cost += 0.5 * padded_steps.quadratic(prior_cov, back)
                linear_cost = new_cost + 0.5 * unexplained
                for k in range(epochs):
                    for c in range(m):
                        total = target[k, c]
                        for j in range(n):
                            total -= rows[k, c, j] * new_states[k, j]
                        linear_cost += 0.5 * total * total
                if final:
                    if is_last_step(cost, linear_cost):
                        states, new_states = new_states, states
                    break
                new_unexplained = 0.0
                for k in range(epochs):
                    left, _ = whitened_reading(
                        own, k, new_states[k], measurements[run, k], noise_inverse, moving, work,
                        new_rows[k], innovation,
                    )  # fmt: skip
                    new_unexplained += left
                    new_cost += 0.5 * (
                        left
                        + padded_steps.to_target(
                            new_rows[k], new_states[k], innovation, new_target[k]
                        )
                    )
                evaluated += 1
                good, final, damping = decide(cost, linear_cost, new_cost, damping)
                if good:
                    steps += 1
                    final |= steps >= most
                    cost, unexplained = new_cost, new_unexplained
                    states, new_states = new_states, states
                    rows, new_rows = new_rows, rows
                    target, new_target = new_target, target
            # The filter has gone along the final trajectory: its covariances, given what is later.
            later[:, :] = 0.0
            for r in range(epochs):
                k = epochs - 1 - r
                f, h, gain_t = filtered_cov[k], rows[k], gains[k]
                padded_steps.square(later, f, scratch, p, n, width)
                for i in range(n):
                    mean[run, k, i] = states[k, i]
                    for j in range(i + 1):
                        value = 0.5 * (f[i, j] - p[i, j] + f[j, i] - p[j, i])
                        cov[run, k, i, j] = cov[run, k, j, i] = value
                # Hᵀ S⁻¹ H + (I − K H)ᵀ Λ (I − K H) = Λ + Hᵀ E + Eᵀ H, E = ½ (Kᵀ Λ K + S⁻¹) H − Kᵀ Λ
                for c in range(m):
                    for j in range(width):
                        total = 0.0
                        for i in range(width):
                            total += gain_t[c, i] * later[i, j]
                        pulled[c, j] = total
                inverse = inverses[k]
                for c in range(m):
                    for d in range(m):
                        total = 0.0
                        for j in range(n):
                            total += pulled[c, j] * gain_t[d, j]
                        for e in range(m):
                            total += inverse[e, c] * inverse[e, d]
                        s[c, d] = 0.5 * total
                padded_steps.times(s, h, spread_t, m, channels, width)
                for c in range(m):
                    for j in range(width):
                        spread_t[c, j] -= pulled[c, j]
                for i in range(n):
                    for j in range(width):
                        total = later[i, j]
                        for c in range(channels):
                            total += h[c, i] * spread_t[c, j] + spread_t[c, i] * h[c, j]
                        later[i, j] = total
                padded_steps.padded(transition[run, k], phi, phi_t)
                padded_steps.square(later, phi, scratch, p, n, width)
                later[:, :] = p
            iterations[run], errors[run] = steps, cost
            evaluations[run] = evaluated * epochs
            if steps == 0 and cost > 0.0:  # it gave up
                mean[run] = math.nan

    return smoother


_SMOOTHERS = {size: _make_smoother(*size) for size in SIZES}


def smoother(
    block: ProblemBlock, most: int
) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]:
    """Solve the batch problem of every run.

    Parameters
    ----------
    block : the runs. most : limit of the steps.

    Returns
    -------
    mean (R, K, n), NaN where no step could be taken; cov (R, K, n, n) given all readings; counters.
    """
    mean, cov, counters, damped = lane_smoother.smoother(block, most)
    if damped.any():
        _SMOOTHERS[size_of(block)](
            block.measurements, noise_inverse(block), block.transition, block.process_cov,
            block.prior_mean, block.prior_cov, block.model, most,
            mean, cov, *counters.values(), np.flatnonzero(damped),
        )  # fmt: skip
    return mean, cov, counters
