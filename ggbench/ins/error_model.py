"""Linear error model of a strapdown INS: F, and Φ and Q between two measurements.

There are fifteen states: errors of position, velocity and attitude (φ, with C̃_nb = (I − [φ×])
C_nb), gyro biases ε_b and accelerometer biases ∇_b. An error is indicated − true, and a bias is
measured − true. F uses the textbook variables (δL, δλ, δh) and the exact derivative of the radii of
curvature, so it is the exact Jacobian of :mod:`ggbench.ins.strapdown`. Φ and Q refer to the states
of the benchmark, with the position error (δr_E, δr_N, δr_U) in metres::

    δr_E = (R_N + h) cos L δλ,   δr_N = (R_M + h) δL,   δr_U = δh

Φ and Q depend only on the INS solution, so all estimators of a run share them.
"""

from __future__ import annotations

import numpy as np

from ..gravity.ellipsoid import metres_per_radian
from ..numerics.kernels import compiled
from ..numerics.rotations import product, rotation_vector
from .imu import Imu
from .system_matrix import DAMPING, DECAY, ENTRIES, SINKING
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
    """Fill errors of position [m], velocity [m/s] and attitude [rad] of INS states.

    Parameters
    ----------
    states : (R, K, 15) indicated position, velocity and C_nb (row by row) in R runs.
    positions, velocities, attitudes : (K, 3), (K, 3), (K, 3, 3) true values.
    out : (R, K, n) output; the first nine states are filled.
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
    """Return the PSD matrix G q Gᵀ (15, 15) of white accelerometer and gyro noise.

    q contains the PSDs of the sensors, and G maps sensor noise to rates of the states. The PSDs are
    in (m/s²)²/Hz and (rad/s)²/Hz. Accelerometer noise drives the velocity error, and gyro noise
    drives the attitude error, both through C_nb. G q Gᵀ is diagonal because the three axes have
    equal PSDs.
    """
    noise = np.zeros((STATES, STATES))
    noise[VELOCITY, VELOCITY] = accelerometer_psd * np.eye(3)
    noise[ATTITUDE, ATTITUDE] = gyro_psd * np.eye(3)
    return noise


def added_by(
    imu: Imu, altimeter: tuple[tuple[float, float], float] | None
) -> tuple[np.ndarray, np.ndarray]:
    """Return the constants that sensors add to F, and the PSD matrix of the process noise.

    The constants (ENTRIES,) belong to the non-zero entries of the system matrix F. The PSD matrix
    is G q Gᵀ (15, 15). It contains the white noise of the IMU, the noise w of biases, and the noise
    e of an altimeter. Gauss–Markov biases obey b' = −b/T + w. An altimeter damps the vertical
    channel: it adds −k₁ (δh − e) to δh' and −k₂ (δh − e) to δv_U'.

    Parameters
    ----------
    imu : the inertial sensors.
    altimeter : gains k₁ [1/s], k₂ [1/s²], from :func:`ggbench.ins.strapdown.altimeter_gains`, and
        the PSD of e [m²/Hz]; None without an altimeter.
    """
    entries = np.zeros(ENTRIES)
    noise = noise_psd(imu.accelerometer_root_psd**2, imu.gyro_root_psd**2)
    for i, block, sigma, time in (
        (DECAY, GYRO_BIAS, imu.gyro_bias, imu.gyro_bias_time),
        (DECAY + 1, ACCELEROMETER_BIAS, imu.accelerometer_bias, imu.accelerometer_bias_time),
    ):
        entries[i] -= 1.0 / time
        noise[block, block] += 2.0 * sigma**2 / time * np.eye(3)
    if altimeter is not None:
        gains, psd = altimeter
        entries[[DAMPING, SINKING]] -= gains
        noise[np.ix_([2, 5], [2, 5])] += psd * np.outer(gains, gains)
    return entries, noise
