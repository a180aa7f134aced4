"""The linear error model of the strapdown INS: F, and Φ and Q between two measurements.

Fifteen states: position, velocity and attitude error (φ: C̃_nb = (I − [φ×]) C_nb), gyro bias ε_b
and accelerometer bias ∇_b; error = indicated − true, measured = true + bias. F is written in the
textbook variables (δL, δλ, δh) and with the exact derivative of the radii of curvature with
latitude, so it is the Jacobian of :mod:`ggbench.strapdown` and not an approximation of it. Φ and Q
leave this module for the benchmark's state, whose position error is (δr_E, δr_N, δr_U) in metres::

    δr_E = (R_N + h) cos L δλ,   δr_N = (R_M + h) δL,   δr_U = δh

All of it depends on the INS-indicated states only, so every estimator of a run shares it.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from .earth import normal_gravity, radii_latitude_derivatives, radii_of_curvature
from .strapdown import frame_rates

STATES = 15
NAVIGATION_STATES = 9
POSITION, VELOCITY, ATTITUDE = slice(0, 3), slice(3, 6), slice(6, 9)
GYRO_BIAS, ACCELEROMETER_BIAS = slice(9, 12), slice(12, 15)


@njit(cache=True)
def system_matrix(
    position: np.ndarray,
    velocity: np.ndarray,
    c_nb: np.ndarray,
    specific_force: np.ndarray,
    out: np.ndarray,
) -> None:
    """Fill F (15, 15) in the variables (δL, δλ, δh), δv, φ, ε_b, ∇_b.

    Parameters
    ----------
    position, velocity, c_nb : navigation state [rad, rad, m], ENU [m/s], (3, 3).
    specific_force : (3,) f^n, ENU [m/s²].
    out : (15, 15) output.
    """
    latitude, height = position[0], position[2]
    v_e, v_n = velocity[0], velocity[1]
    sine, cosine = math.sin(latitude), math.cos(latitude)
    tangent, secant = sine / cosine, 1.0 / cosine
    meridian, prime_vertical = radii_of_curvature(latitude)
    d_meridian, d_prime_vertical = radii_latitude_derivatives(latitude)
    r_m, r_n = meridian + height, prime_vertical + height
    omega_ie = np.empty(3)
    omega_en = np.empty(3)
    frame_rates(latitude, height, velocity, omega_ie, omega_en)

    out[:, :] = 0.0
    # Position.
    out[0, 0] = -v_n * d_meridian / r_m**2
    out[0, 2] = -v_n / r_m**2
    out[0, 4] = 1.0 / r_m
    out[1, 0] = v_e * secant / r_n * (tangent - d_prime_vertical / r_n)
    out[1, 2] = -v_e * secant / r_n**2
    out[1, 3] = secant / r_n
    out[2, 5] = 1.0

    # Derivatives of ω_ie and ω_en with respect to L, h and v_E, v_N.
    ie_latitude = np.array([0.0, -omega_ie[2], omega_ie[1]])
    en_latitude = np.array(
        [
            v_n * d_meridian / r_m**2,
            -v_e * d_prime_vertical / r_n**2,
            v_e * (secant * secant / r_n - tangent * d_prime_vertical / r_n**2),
        ]
    )
    en_height = np.array([v_n / r_m**2, -v_e / r_n**2, -v_e * tangent / r_n**2])
    en_velocity_e = np.array([0.0, 1.0 / r_n, tangent / r_n])
    en_velocity_n = np.array([-1.0 / r_m, 0.0, 0.0])

    # Velocity: −(∂(2ω_ie + ω_en) × v) − (2ω_ie + ω_en) × ∂v + ∂g.
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        v_j, v_k = velocity[j], velocity[k]
        out[3 + i, 0] = -(
            (2.0 * ie_latitude[j] + en_latitude[j]) * v_k
            - (2.0 * ie_latitude[k] + en_latitude[k]) * v_j
        )
        out[3 + i, 2] = -(en_height[j] * v_k - en_height[k] * v_j)
        out[3 + i, 3] = -(en_velocity_e[j] * v_k - en_velocity_e[k] * v_j)
        out[3 + i, 4] = -(en_velocity_n[j] * v_k - en_velocity_n[k] * v_j)
        out[3 + i, 3 + k] -= 2.0 * omega_ie[j] + omega_en[j]
        out[3 + i, 3 + j] += 2.0 * omega_ie[k] + omega_en[k]
        # [f^n ×] φ and C_nb ∇_b
        out[3 + i, 6 + k] = specific_force[j]
        out[3 + i, 6 + j] = -specific_force[k]
        # Attitude: ∂ω_in − ω_in × φ − C_nb ε_b.
        out[6 + i, 0] = ie_latitude[i] + en_latitude[i]
        out[6 + i, 2] = en_height[i]
        out[6 + i, 3] = en_velocity_e[i]
        out[6 + i, 4] = en_velocity_n[i]
        out[6 + i, 6 + k] = -(omega_ie[j] + omega_en[j])
        out[6 + i, 6 + j] = omega_ie[k] + omega_en[k]
        for axis in range(3):
            out[6 + i, 9 + axis] = -c_nb[i, axis]
            out[3 + i, 12 + axis] = c_nb[i, axis]
    _, gamma_latitude, gamma_height = normal_gravity(latitude, height)
    out[5, 0] -= gamma_latitude
    out[5, 2] -= gamma_height


@njit(cache=True)
def system_matrices(
    positions: np.ndarray,
    velocities: np.ndarray,
    attitudes: np.ndarray,
    delta_velocities: np.ndarray,
    dt: float,
) -> np.ndarray:
    """Return F (N, 15, 15) at the middle of each of N IMU intervals of an INS track."""
    count = delta_velocities.shape[0]
    matrices = np.empty((count, STATES, STATES))
    middle = np.empty((3, 3))
    force = np.empty(3)
    for n in range(count):
        middle[:, :] = 0.5 * (attitudes[n] + attitudes[n + 1])
        for i in range(3):
            force[i] = (
                middle[i, 0] * delta_velocities[n, 0]
                + middle[i, 1] * delta_velocities[n, 1]
                + middle[i, 2] * delta_velocities[n, 2]
            ) / dt
        system_matrix(
            0.5 * (positions[n] + positions[n + 1]),
            0.5 * (velocities[n] + velocities[n + 1]),
            middle,
            force,
            matrices[n],
        )
    return matrices


@njit(cache=True)
def _product(a: np.ndarray, b: np.ndarray, scale: float, out: np.ndarray) -> None:
    """Fill ``out`` with scale · a b (small matrices, plain loops: faster than calling BLAS)."""
    for i in range(a.shape[0]):
        for j in range(b.shape[1]):
            out[i, j] = 0.0
        for k in range(a.shape[1]):
            factor = scale * a[i, k]
            if factor != 0.0:  # half of F is zero
                for j in range(b.shape[1]):
                    out[i, j] += factor * b[k, j]


@njit(cache=True)
def discretize(
    matrix: np.ndarray, noise: np.ndarray, dt: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return Φ = exp(F dt), Ψ = ∫ exp(F s) ds and Q = ∫ Φ(s) G q Gᵀ Φ(s)ᵀ ds of one short step.

    The series of Van Loan's matrix exponential, to the order at which its terms fall below
    rounding for an IMU interval (F's chain bias → attitude → velocity → position ends after three
    products; what comes back is 1e-3 s⁻¹ at most). Ψ carries a constant input u: x += Ψ B u.

    Parameters
    ----------
    matrix : (n, n) F. noise : (n, n) G q Gᵀ, power spectral densities. dt : step [s].
    """
    n = matrix.shape[0]
    transition = np.eye(n)
    integral = np.eye(n) * dt
    term = np.eye(n)
    scratch = np.empty((n, n))
    for order in range(1, 6):
        _product(matrix, term, dt / order, scratch)
        term, scratch = scratch, term
        transition += term
        integral += term * (dt / (order + 1))
    covariance = noise * dt
    moment = covariance.copy()
    for order in range(2, 7):
        _product(matrix, moment, dt / order, scratch)
        for i in range(n):
            for j in range(n):
                moment[i, j] = scratch[i, j] + scratch[j, i]
        covariance += moment
    return transition, integral, covariance


@njit(cache=True)
def metres_per_radian(position: np.ndarray) -> tuple[float, float]:
    """Return (R_M + h) and (R_N + h) cos L [m/rad]: what δL and δλ are worth in metres."""
    meridian, prime_vertical = radii_of_curvature(position[0])
    return meridian + position[2], (prime_vertical + position[2]) * math.cos(position[0])


@njit(cache=True)
def _to_metres(position: np.ndarray) -> np.ndarray:
    """Return the matrix that takes (δL, δλ, δh, ...) to (δr_E, δr_N, δr_U, ...)."""
    north, east = metres_per_radian(position)
    change = np.eye(STATES)
    change[0, 0] = change[1, 1] = 0.0
    change[0, 1] = east
    change[1, 0] = north
    return change


@njit(cache=True)
def _from_metres(position: np.ndarray) -> np.ndarray:
    """Return the inverse of :func:`_to_metres`."""
    north, east = metres_per_radian(position)
    change = np.eye(STATES)
    change[0, 0] = change[1, 1] = 0.0
    change[1, 0] = 1.0 / east
    change[0, 1] = 1.0 / north
    return change


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
    block : :data:`GYRO_BIAS` or :data:`ACCELEROMETER_BIAS`. sigma : [its unit]. time : T [s].
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
    gains : k₁ [1/s], k₂ [1/s²], from :func:`ggbench.strapdown.altimeter_gains`.
    psd : of the altimeter's white noise e [m²/Hz].
    """
    vertical = np.array([2, 5])
    matrices[:, vertical, 2] -= gains
    noise[np.ix_(vertical, vertical)] += psd * np.outer(gains, gains)


@njit(cache=True)
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
    # Constant biases: only the nine navigation states evolve, Φ = [Φ_n, Ψ_n B; 0, I].
    constant = not np.any(matrices[:, NAVIGATION_STATES:, NAVIGATION_STATES:]) and not np.any(
        noise[NAVIGATION_STATES:, NAVIGATION_STATES:]
    )
    nav = NAVIGATION_STATES if constant else STATES
    moving_noise = noise[:nav, :nav].copy()
    count = epochs.shape[0]
    transition = np.zeros((count, STATES, STATES))
    process_cov = np.zeros((count, STATES, STATES))
    bias_input = np.empty((nav, STATES - nav))
    from_bias = np.empty((nav, STATES - nav))
    phi = np.empty((nav, STATES))
    next_phi = np.empty((nav, STATES))
    scratch = np.empty((nav, nav))
    start = 0
    for k in range(count):
        phi[:, :] = 0.0
        for i in range(nav):
            phi[i, i] = 1.0
        q = np.zeros((nav, nav))
        for n in range(start, epochs[k]):
            step_phi, step_psi, step_q = discretize(matrices[n, :nav, :nav], moving_noise, dt)
            bias_input[:, :] = matrices[n, :nav, nav:]
            _product(step_psi, bias_input, 1.0, from_bias)
            _product(step_phi, phi, 1.0, next_phi)
            next_phi[:, nav:] += from_bias
            phi, next_phi = next_phi, phi
            _product(step_phi, q, 1.0, scratch)
            _product(scratch, step_phi.T, 1.0, q)
            q += step_q
        to_metres = _to_metres(positions[epochs[k]])
        full = np.eye(STATES)
        full[:nav] = phi
        transition[k] = to_metres @ full @ _from_metres(positions[start])
        full[:, :] = 0.0
        full[:nav, :nav] = q
        full = to_metres @ full @ to_metres.T
        process_cov[k] = 0.5 * (full + full.T)
        start = epochs[k]
    return transition, process_cov


@njit(cache=True)
def delayed_rows(
    matrices: np.ndarray, positions: np.ndarray, epochs: np.ndarray, delays: np.ndarray, dt: float
) -> np.ndarray:
    """Return B (K, 6, 15): position [m] and attitude error [rad] at t_k − τ_k are B_k x(t_k).

    Rows of Φ(t_k, t_k − τ_k)⁻¹; process noise within the delay (millimetres) is neglected.
    ``delays`` (K,) are in seconds, zero or positive, and do not reach before sample 0.
    """
    count = epochs.shape[0]
    rows = np.empty((count, 6, STATES))
    term = np.empty((6, STATES))
    scratch = np.empty((6, STATES))
    row = np.empty((6, STATES))
    for k in range(count):
        steps = delays[k] / dt
        whole = math.ceil(steps - 1e-9)
        first = max(epochs[k] - whole, 0)
        row[:3] = _to_metres(positions[max(epochs[k] - round(steps), 0)])[:3]
        row[3:] = np.eye(STATES)[6:9]
        # Back from t_k − τ_k: Φ⁻¹ of the steps in the order of time, the first one in part.
        for n in range(first, epochs[k]):
            part = dt * (steps - (whole - 1)) if n == first else dt
            term[:, :] = row
            for order in range(1, 6):
                _product(term, matrices[n], -part / order, scratch)
                term, scratch = scratch, term
                row += term
        rows[k] = row @ _from_metres(positions[epochs[k]])
    return rows
