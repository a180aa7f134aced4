"""The linear error model of the strapdown INS: F, and Φ and Q between two measurements.

Fifteen states: position, velocity and attitude error (φ: C̃_nb = (I − [φ×]) C_nb), gyro bias ε_b
and accelerometer bias ∇_b; error = indicated − true, measured = true + bias. F is written in the
textbook variables (δL, δλ, δh) and with the exact derivative of the radii of curvature with
latitude, so it is the Jacobian of :mod:`.ins.strapdown` and not an approximation of it. Φ and Q
leave this module for the benchmark's state, whose position error is (δr_E, δr_N, δr_U) in metres::

    δr_E = (R_N + h) cos L δλ,   δr_N = (R_M + h) δL,   δr_U = δh

All of it depends on the INS-indicated states only, so every estimator of a run shares it.
"""

from __future__ import annotations

import numpy as np

from ..gravity.ellipsoid import metres_per_radian
from ..numerics.kernels import compiled
from ..numerics.lanes import in_lanes, out_of_lanes, unfilled
from ..numerics.rotations import product, rotation_vector
from .known_gravity import NORMAL_GRAVITY, KnownGravity
from .noise import noise_roots
from .system_matrix import ENTRIES, dense, entries_between, sparse
from .system_matrix import STATES as STATES
from .transitions import NO_DELAYS, compose, delayed, intervals_of

POSITION, VELOCITY, ATTITUDE = slice(0, 3), slice(3, 6), slice(6, 9)
GYRO_BIAS, ACCELEROMETER_BIAS = slice(9, 12), slice(12, 15)


def system_matrix(
    position: np.ndarray,
    velocity: np.ndarray,
    c_nb: np.ndarray,
    specific_force: np.ndarray,
    out: np.ndarray,
    gravity: KnownGravity = NORMAL_GRAVITY,
) -> None:
    """Fill F (15, 15) in the variables (δL, δλ, δh), δv, φ, ε_b, ∇_b.

    Parameters
    ----------
    position, velocity, c_nb : navigation state [rad, rad, m], ENU [m/s], (3, 3).
    specific_force : (3,) f^n, ENU [m/s²].
    out : (15, 15) output.
    gravity : what the mechanization adds to normal gravity.
    """
    state = np.concatenate([position, velocity, np.ravel(c_nb)])
    force = (c_nb.T @ specific_force)[np.newaxis]
    out[:, :] = _matrices(np.stack([state, state]), force, 1.0, gravity)[0]


def system_matrices(
    positions: np.ndarray,
    velocities: np.ndarray,
    attitudes: np.ndarray,
    delta_velocities: np.ndarray,
    dt: float,
    gravity: KnownGravity = NORMAL_GRAVITY,
) -> np.ndarray:
    """Return F (N, 15, 15) at the middle of each of N IMU intervals of an INS track."""
    states = np.hstack([positions, velocities, attitudes.reshape(-1, 9)])
    return _matrices(states, delta_velocities, dt, gravity)


def _matrices(
    states: np.ndarray, delta_velocities: np.ndarray, dt: float, gravity: KnownGravity
) -> np.ndarray:
    """Return F (N, 15, 15) between states (N + 1, 15)."""
    count = len(delta_velocities)
    increments = np.hstack([np.zeros((count, 3)), delta_velocities])
    entries = unfilled(count, ENTRIES)
    entries_between(
        in_lanes(states[np.newaxis]), in_lanes(increments[np.newaxis]), 0, count, dt,
        np.zeros(ENTRIES), gravity, entries,
    )  # fmt: skip
    return dense(out_of_lanes(entries, 1)[0])


@compiled
def navigation_errors(
    states: np.ndarray,
    positions: np.ndarray,
    velocities: np.ndarray,
    attitudes: np.ndarray,
    out: np.ndarray,
) -> None:
    """Fill position [m], velocity [m/s] and attitude [rad] errors of INS states against the truth.

    Parameters
    ----------
    states : (R, K, 15) position, velocity and C_nb, row by row, of the INS in R runs.
    positions, velocities, attitudes : (K, 3), (K, 3), (K, 3, 3) of the truth.
    out : (R, K, n) output, of which the first nine elements are filled.
    """
    turn = np.empty((3, 3))
    c_bn = np.empty((3, 3))
    vector = np.empty(3)
    for r in range(states.shape[0]):
        for k in range(states.shape[1]):
            state, error = states[r, k], out[r, k]
            north, east = metres_per_radian(state)
            error[0] = (state[1] - positions[k, 1]) * east
            error[1] = (state[0] - positions[k, 0]) * north
            error[2] = state[2] - positions[k, 2]
            for i in range(3):
                error[3 + i] = state[3 + i] - velocities[k, i]
                for j in range(3):
                    c_bn[j, i] = state[6 + 3 * i + j]
            product(attitudes[k], c_bn, turn)
            rotation_vector(turn, vector)
            for i in range(3):
                error[6 + i] = vector[i]


def noise_psd(accelerometer_psd: float, gyro_psd: float) -> np.ndarray:
    """Return G q Gᵀ (15, 15) of white sensor noise [(m/s²)²/Hz, (rad/s)²/Hz].

    w_a enters δv' and w_g enters φ' through C_nb; equal axes make G q Gᵀ diagonal.
    """
    noise = np.zeros((STATES, STATES))
    noise[VELOCITY, VELOCITY] = accelerometer_psd * np.eye(3)
    noise[ATTITUDE, ATTITUDE] = gyro_psd * np.eye(3)
    return noise


def add_bias_decay(
    matrices: np.ndarray, noise: np.ndarray, block: slice, sigma: float, time: float
) -> None:
    """Make a bias a Gauss–Markov process: b' = −b/T + w of stationary standard deviation σ.

    Parameters
    ----------
    matrices, noise : (N, 15, 15) F and (15, 15) G q Gᵀ, changed in place.
    block : :data:`GYRO_BIAS` or :data:`ACCELEROMETER_BIAS`.
    sigma : [its unit].
    time : T [s].
    """
    matrices[:, block, block] -= np.eye(3) / time
    noise[block, block] += 2.0 * sigma**2 / time * np.eye(3)


def add_altimeter(
    matrices: np.ndarray, noise: np.ndarray, gains: tuple[float, float], psd: float
) -> None:
    """Add the damping of the vertical channel: δh' −= k₁ (δh − e), δv_U' −= k₂ (δh − e).

    Parameters
    ----------
    matrices, noise : (N, 15, 15) F and (15, 15) G q Gᵀ, changed in place.
    gains : k₁ [1/s], k₂ [1/s²], from :func:`ggbench.ins.strapdown.altimeter_gains`.
    psd : of the altimeter's white noise e [m²/Hz].
    """
    vertical = np.array([2, 5])
    matrices[:, vertical, 2] -= gains
    noise[np.ix_(vertical, vertical)] += psd * np.outer(gains, gains)


def transitions(
    matrices: np.ndarray, positions: np.ndarray, epochs: np.ndarray, dt: float, noise: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Compose Φ and Q of the IMU steps between measurement epochs, for the state in metres.

    Parameters
    ----------
    matrices : (N, 15, 15) from :func:`system_matrices`.
    positions : (N + 1, 3) INS track.
    epochs : (K,) increasing indices of IMU samples; the first transition starts at sample 0.
    dt : IMU interval [s].
    noise : (15, 15) G q Gᵀ, from :func:`noise_psd`.

    Returns
    -------
    transition, process_cov : (K, 15, 15) each, from epoch k − 1 to epoch k.
    """
    entries = in_lanes(sparse(matrices)[np.newaxis])
    roots = noise_roots(noise, bool(matrices[:, GYRO_BIAS.start :, GYRO_BIAS.start :].any()))
    transition, process_cov = np.empty((2, 1, len(epochs), STATES, STATES))
    nowhere = np.empty((1, 0, 6, STATES))
    start = 0
    for k, end in enumerate(epochs):
        compose(
            entries[start:end], dt, roots, _metres(positions[start]), _metres(positions[end]),
            transition[:, k], process_cov[:, k], unfilled(0, STATES), 0, NO_DELAYS, nowhere,
        )  # fmt: skip
        start = end
    return transition[0], process_cov[0]


def delayed_rows(
    matrices: np.ndarray, positions: np.ndarray, epochs: np.ndarray, delays: np.ndarray, dt: float
) -> np.ndarray:
    """Return B (K, 6, 15): position [m] and attitude error [rad] at t_k − τ_k are B_k x(t_k).

    Rows of Φ(t_k, t_k − τ_k)⁻¹; process noise within the delay (millimetres) is neglected.
    ``delays`` (K,) are in seconds, zero or positive, and do not reach before sample 0.
    """
    entries = in_lanes(sparse(matrices)[np.newaxis])
    rows = np.empty((1, len(epochs), 6, STATES))
    for k, (epoch, delay) in enumerate(zip(epochs, delays, strict=True)):
        first, part, nearest = intervals_of(delay, epoch, dt)
        delayed(
            entries[first:epoch], part, dt, _metres(positions[nearest]), _metres(positions[epoch]),
            rows[:, k],
        )  # fmt: skip
    return rows[0]


def _metres(position: np.ndarray) -> np.ndarray:
    """Return metres per radian of latitude and longitude (1, 2, LANES) of one run."""
    return in_lanes(np.reshape(metres_per_radian(position), (1, 1, 2)))
