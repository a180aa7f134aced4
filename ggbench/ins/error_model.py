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
from ..numerics.rotations import product, rotation_vector
from .system_matrix import STATES as STATES

POSITION, VELOCITY, ATTITUDE = slice(0, 3), slice(3, 6), slice(6, 9)
GYRO_BIAS, ACCELEROMETER_BIAS = slice(9, 12), slice(12, 15)


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
