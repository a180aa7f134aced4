"""Strapdown mechanization in the local-level East-North-Up frame, and its exact inverse.

State: geodetic latitude L, longitude λ [rad], ellipsoidal height h [m], velocity v^n (ENU) [m/s]
and C_nb, which maps the body frame (right-forward-up) to n::

    L' = v_N/(R_M+h)     λ' = v_E/((R_N+h) cos L)     h' = v_U
    v' = C_nb f − (2ω_ie + ω_en) × v + g        g = (0, 0, −γ(L, h)) + disturbance
    C_nb' = C_nb [ω_ib×] − [(ω_ie + ω_en)×] C_nb

Each step takes the increments of an IMU over the step, ∫ω_ib dt and ∫f dt in body axes, and is of
second order (all rates at the midpoint). :func:`error_free_increments` is its exact inverse: truth
comes back to rounding, because position follows from velocity by the rule that truth uses too.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from .earth import ROTATION_RATE, normal_gravity, radii_of_curvature


@njit(cache=True)
def rotation_matrix(rotation_vector: np.ndarray, out: np.ndarray) -> None:
    """Fill ``out`` (3, 3) with exp([rotation_vector×]) (Rodrigues)."""
    x, y, z = rotation_vector[0], rotation_vector[1], rotation_vector[2]
    angle2 = x * x + y * y + z * z
    if angle2 < 1e-8:  # the series: the quotients below would lose digits
        a = 1.0 - angle2 / 6.0 * (1.0 - angle2 / 20.0)
        b = 0.5 - angle2 / 24.0 * (1.0 - angle2 / 30.0)
    else:
        angle = math.sqrt(angle2)
        a = math.sin(angle) / angle
        b = (1.0 - math.cos(angle)) / angle2
    out[0, 0] = 1.0 - b * (y * y + z * z)
    out[0, 1] = b * x * y - a * z
    out[0, 2] = b * x * z + a * y
    out[1, 0] = b * x * y + a * z
    out[1, 1] = 1.0 - b * (x * x + z * z)
    out[1, 2] = b * y * z - a * x
    out[2, 0] = b * x * z - a * y
    out[2, 1] = b * y * z + a * x
    out[2, 2] = 1.0 - b * (x * x + y * y)


@njit(cache=True)
def rotation_vector(matrix: np.ndarray, out: np.ndarray) -> None:
    """Fill ``out`` (3,) with the rotation vector of a rotation by less than π/2."""
    out[0] = 0.5 * (matrix[2, 1] - matrix[1, 2])
    out[1] = 0.5 * (matrix[0, 2] - matrix[2, 0])
    out[2] = 0.5 * (matrix[1, 0] - matrix[0, 1])
    sine = math.sqrt(out[0] ** 2 + out[1] ** 2 + out[2] ** 2)
    if sine > 1e-5:
        cosine = 0.5 * (matrix[0, 0] + matrix[1, 1] + matrix[2, 2] - 1.0)
        out *= math.atan2(sine, cosine) / sine
    else:
        out *= 1.0 + sine * sine / 6.0


@njit(cache=True)
def product(a: np.ndarray, b: np.ndarray, out: np.ndarray) -> None:
    """Fill ``out`` with the product of two 3 by 3 matrices."""
    for i in range(3):
        for j in range(3):
            out[i, j] = a[i, 0] * b[0, j] + a[i, 1] * b[1, j] + a[i, 2] * b[2, j]


@njit(cache=True)
def attitude_matrix(heading: float, pitch: float, roll: float) -> np.ndarray:
    """Return C_nb of heading (clockwise from north), pitch (nose up), roll (right down) [rad]."""
    sin_h, cos_h = math.sin(heading), math.cos(heading)
    sin_p, cos_p = math.sin(pitch), math.cos(pitch)
    sin_r, cos_r = math.sin(roll), math.cos(roll)
    return np.array(
        [
            [cos_h * cos_r + sin_h * sin_p * sin_r, sin_h * cos_p,
             cos_h * sin_r - sin_h * sin_p * cos_r],
            [-sin_h * cos_r + cos_h * sin_p * sin_r, cos_h * cos_p,
             -sin_h * sin_r - cos_h * sin_p * cos_r],
            [-cos_p * sin_r, sin_p, cos_p * cos_r],
        ]
    )  # fmt: skip


@njit(cache=True)
def frame_rates(
    latitude: float, height: float, velocity: np.ndarray, omega_ie: np.ndarray, omega_en: np.ndarray
) -> None:
    """Fill the earth rate ω_ie^n and the transport rate ω_en^n [rad/s]."""
    meridian, prime_vertical = radii_of_curvature(latitude)
    omega_ie[0] = 0.0
    omega_ie[1] = ROTATION_RATE * math.cos(latitude)
    omega_ie[2] = ROTATION_RATE * math.sin(latitude)
    omega_en[0] = -velocity[1] / (meridian + height)
    omega_en[1] = velocity[0] / (prime_vertical + height)
    omega_en[2] = omega_en[1] * math.tan(latitude)


@njit(cache=True)
def position_rate(position: np.ndarray, velocity: np.ndarray, out: np.ndarray) -> None:
    """Fill (L', λ', h') of a position [rad, rad, m] and an ENU velocity [m/s]."""
    meridian, prime_vertical = radii_of_curvature(position[0])
    out[0] = velocity[1] / (meridian + position[2])
    out[1] = velocity[0] / ((prime_vertical + position[2]) * math.cos(position[0]))
    out[2] = velocity[2]


@njit(cache=True)
def velocity_rate(
    position: np.ndarray, velocity: np.ndarray, specific_force: np.ndarray, out: np.ndarray
) -> None:
    """Fill v' [m/s²] for a specific force in n axes: f^n − (2ω_ie + ω_en) × v + (0, 0, −γ)."""
    omega_ie = np.empty(3)
    omega_en = np.empty(3)
    frame_rates(position[0], position[2], velocity, omega_ie, omega_en)
    x = 2.0 * omega_ie[0] + omega_en[0]
    y = 2.0 * omega_ie[1] + omega_en[1]
    z = 2.0 * omega_ie[2] + omega_en[2]
    gamma, _, _ = normal_gravity(position[0], position[2])
    out[0] = specific_force[0] - (y * velocity[2] - z * velocity[1])
    out[1] = specific_force[1] - (z * velocity[0] - x * velocity[2])
    out[2] = specific_force[2] - (x * velocity[1] - y * velocity[0]) - gamma


@njit(cache=True)
def attitude_rate(
    position: np.ndarray,
    velocity: np.ndarray,
    c_nb: np.ndarray,
    angular_rate: np.ndarray,
    out: np.ndarray,
) -> None:
    """Fill ω_nb^n [rad/s]: the rate at which b turns against n, C_nb ω_ib − ω_ie − ω_en."""
    omega_ie = np.empty(3)
    omega_en = np.empty(3)
    frame_rates(position[0], position[2], velocity, omega_ie, omega_en)
    for i in range(3):
        body = (
            c_nb[i, 0] * angular_rate[0] + c_nb[i, 1] * angular_rate[1]
            + c_nb[i, 2] * angular_rate[2]
        )  # fmt: skip
        out[i] = body - omega_ie[i] - omega_en[i]


@njit(cache=True)
def advance_position(
    position: np.ndarray,
    velocity: np.ndarray,
    next_velocity: np.ndarray,
    dt: float,
    out: np.ndarray,
) -> None:
    """Fill the position after a step with the mean of the two velocities (midpoint rule)."""
    mean = np.empty(3)
    rate = np.empty(3)
    middle = np.empty(3)
    for i in range(3):
        mean[i] = 0.5 * (velocity[i] + next_velocity[i])
    position_rate(position, mean, rate)
    for i in range(3):
        middle[i] = position[i] + 0.5 * dt * rate[i]
    position_rate(middle, mean, rate)
    for i in range(3):
        out[i] = position[i] + dt * rate[i]


@njit(cache=True)
def step(
    position: np.ndarray,
    velocity: np.ndarray,
    c_nb: np.ndarray,
    delta_angle: np.ndarray,
    delta_velocity: np.ndarray,
    disturbance: np.ndarray,
    dt: float,
    next_position: np.ndarray,
    next_velocity: np.ndarray,
    next_c_nb: np.ndarray,
) -> None:
    """Advance the navigation state by one IMU interval.

    Parameters
    ----------
    position, velocity, c_nb : (3,) [rad, rad, m], (3,) ENU [m/s], (3, 3).
    delta_angle, delta_velocity : (3,) increments in body axes [rad], [m/s].
    disturbance : (3,) gravity beyond the normal one, ENU [m/s²] (zero in an INS without a map).
    dt : interval [s].
    next_position, next_velocity, next_c_nb : outputs.
    """
    turn = np.empty((3, 3))
    mid_c_nb = np.empty((3, 3))
    scratch = np.empty((3, 3))
    vector = np.empty(3)
    force = np.empty(3)
    rate = np.empty(3)
    omega_ie = np.empty(3)
    omega_en = np.empty(3)
    mid_position = np.empty(3)
    mid_velocity = np.empty(3)

    # Body attitude halfway, from half the increment and half the turn of n at the old rates.
    frame_rates(position[0], position[2], velocity, omega_ie, omega_en)
    for i in range(3):
        vector[i] = 0.5 * delta_angle[i]
    rotation_matrix(vector, turn)
    product(c_nb, turn, scratch)
    for i in range(3):
        vector[i] = -0.5 * dt * (omega_ie[i] + omega_en[i])
    rotation_matrix(vector, turn)
    product(turn, scratch, mid_c_nb)
    for i in range(3):
        force[i] = (
            mid_c_nb[i, 0] * delta_velocity[0] + mid_c_nb[i, 1] * delta_velocity[1]
            + mid_c_nb[i, 2] * delta_velocity[2]
        ) / dt + disturbance[i]  # fmt: skip

    # Midpoint of position and velocity, then the velocity with the midpoint's rates.
    position_rate(position, velocity, rate)
    for i in range(3):
        mid_position[i] = position[i] + 0.5 * dt * rate[i]
    velocity_rate(position, velocity, force, rate)
    for i in range(3):
        mid_velocity[i] = velocity[i] + 0.5 * dt * rate[i]
    velocity_rate(mid_position, mid_velocity, force, rate)
    for i in range(3):
        next_velocity[i] = velocity[i] + dt * rate[i]
    advance_position(position, velocity, next_velocity, dt, next_position)

    frame_rates(mid_position[0], mid_position[2], mid_velocity, omega_ie, omega_en)
    rotation_matrix(delta_angle, turn)
    product(c_nb, turn, scratch)
    for i in range(3):
        vector[i] = -dt * (omega_ie[i] + omega_en[i])
    rotation_matrix(vector, turn)
    product(turn, scratch, next_c_nb)


def altimeter_gains(time_constant: float) -> tuple[float, float]:
    """Return k₁ [1/s], k₂ [1/s²] that give the vertical channel two poles at −1/T.

    Its own dynamics are δh'' = (2g/R) δh, so k₁ = 2/T and k₂ = 1/T² + 2g/R.
    """
    return 2.0 / time_constant, 1.0 / time_constant**2 + 2.0 * 9.80665 / 6378137.0


def navigate(
    position: np.ndarray,
    velocity: np.ndarray,
    c_nb: np.ndarray,
    delta_angles: np.ndarray,
    delta_velocities: np.ndarray,
    dt: float,
    heights: np.ndarray | None = None,
    gains: tuple[float, float] = (0.0, 0.0),
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Run the mechanization open loop in normal gravity over N increments.

    With an altimeter each step ends with a correction of the vertical channel by the difference
    from its height, h −= k₁ dt (h − h_a), v_U −= k₂ dt (h − h_a), which keeps it stable (Titterton
    and Weston 2004, sec. 12.3).

    Parameters
    ----------
    position, velocity, c_nb : initial state, as in :func:`step`.
    delta_angles, delta_velocities : (N, 3) [rad], [m/s].
    dt : IMU interval [s].
    heights : (N,) of the altimeter at the end of each interval [m]; none without one.
    gains : k₁ [1/s], k₂ [1/s²], from :func:`altimeter_gains`.

    Returns
    -------
    positions (N + 1, 3) [rad, rad, m], velocities (N + 1, 3) [m/s], C_nb (N + 1, 3, 3).
    """
    heights = np.empty(0) if heights is None else heights
    positions, velocities, attitudes = _navigate(
        position, velocity, c_nb, delta_angles, delta_velocities, dt, heights, gains
    )
    return positions, velocities, attitudes


@njit(cache=True)
def _navigate(
    position: np.ndarray,
    velocity: np.ndarray,
    c_nb: np.ndarray,
    delta_angles: np.ndarray,
    delta_velocities: np.ndarray,
    dt: float,
    heights: np.ndarray,
    gains: tuple[float, float],
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Run :func:`navigate`."""
    count = delta_angles.shape[0]
    positions = np.empty((count + 1, 3))
    velocities = np.empty((count + 1, 3))
    attitudes = np.empty((count + 1, 3, 3))
    positions[0], velocities[0], attitudes[0] = position, velocity, c_nb
    disturbance = np.zeros(3)
    for n in range(count):
        step(
            positions[n], velocities[n], attitudes[n], delta_angles[n], delta_velocities[n],
            disturbance, dt, positions[n + 1], velocities[n + 1], attitudes[n + 1],
        )  # fmt: skip
        if heights.shape[0] > 0:
            difference = positions[n + 1, 2] - heights[n]
            positions[n + 1, 2] -= gains[0] * dt * difference
            velocities[n + 1, 2] -= gains[1] * dt * difference
    return positions, velocities, attitudes


@njit(cache=True)
def error_free_increments(
    positions: np.ndarray,
    velocities: np.ndarray,
    attitudes: np.ndarray,
    disturbances: np.ndarray,
    dt: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the IMU increments with which :func:`navigate` follows the truth.

    A fixed-point iteration on the step itself: increments change what they should by almost
    exactly themselves, so six corrections reach rounding in any manoeuvre. Each step starts where
    the increments before it have led, not from the truth: a rounding error that repeats itself
    would otherwise grow with the vertical channel, e^(t √(2g/R)), to kilometres in four hours.

    Parameters
    ----------
    positions, velocities, attitudes : (N + 1, ...) truth, as :func:`navigate` returns it.
    disturbances : (N, 3) gravity disturbance felt during each interval, ENU [m/s²].
    dt : interval [s].

    Returns
    -------
    delta_angles (N, 3) [rad], delta_velocities (N, 3) [m/s].
    """
    count = positions.shape[0] - 1
    delta_angles = np.zeros((count, 3))
    delta_velocities = np.zeros((count, 3))
    position, velocity, c_nb = positions[0].copy(), velocities[0].copy(), attitudes[0].copy()
    next_position = np.empty(3)
    next_velocity = np.empty(3)
    next_c_nb = np.empty((3, 3))
    difference = np.empty((3, 3))
    vector = np.empty(3)
    for n in range(count):
        for iteration in range(7):
            step(
                position, velocity, c_nb, delta_angles[n], delta_velocities[n],
                disturbances[n], dt, next_position, next_velocity, next_c_nb,
            )  # fmt: skip
            if iteration == 6:
                break
            product(next_c_nb.T, attitudes[n + 1], difference)
            rotation_vector(difference, vector)
            for i in range(3):
                delta_angles[n, i] += vector[i]
                for j in range(3):
                    delta_velocities[n, i] += next_c_nb[j, i] * (
                        velocities[n + 1, j] - next_velocity[j]
                    )
        position, next_position = next_position, position
        velocity, next_velocity = next_velocity, velocity
        c_nb, next_c_nb = next_c_nb, c_nb
    return delta_angles, delta_velocities
