"""Strapdown mechanization in the local-level East-North-Up frame, and its exact inverse.

The state consists of geodetic latitude L, longitude λ [rad], ellipsoidal height h [m], velocity v
(ENU) [m/s] and C_nb, which maps the body frame b (right-forward-up) to the local-level frame n::

    L' = v_N/(R_M+h)     λ' = v_E/((R_N+h) cos L)     h' = v_U
    v' = C_nb f − (2ω_ie + ω_en) × v + g        g = (0, g_N(L, h), g_U(L, h)) + disturbance
    C_nb' = C_nb [ω_ib×] − [(ω_ie + ω_en)×] C_nb

A step uses the increments of an IMU, ∫ω_ib dt and ∫f dt in body axes, and is of second order (all
rates at the midpoint). :func:`error_free_increments` is the exact inverse of the step. Without
sensor errors the mechanization reproduces the truth to rounding, because the truth uses the same
rule for the position.
"""

from __future__ import annotations

import numpy as np

from ..gravity.ellipsoid import normal_gravity_vector_of
from ..gravity.field import DisturbanceMap
from ..gravity.spline import vector_at
from ..numerics.kernels import compiled, copied, inlined
from ..numerics.lane_algebra import copy
from ..numerics.lanes import in_lanes, lanes, out_of_lanes, unfilled
from ..numerics.rotations import (
    Matrix,
    multiply,
    product,
    rotation_vector,
    small_turn,
)
from ..numerics.vectors import load, store
from .known_gravity import NORMAL_GRAVITY, KnownGravity, extrapolate, integrate
from .local_level import Place, Vector, frame_rates_of, place_of, position_rate_of

TRACK = 15
"""Numbers of a navigation state: position, velocity and C_nb, row by row."""


@inlined
def velocity_rate_of(place: Place, height: float, v: Vector, f: Vector) -> Vector:
    """Return the rate of the velocity, v' = f − (2ω_ie + ω_en) × v + (0, g_N, g_U) [m/s²].

    The velocity ``v`` [m/s] and the specific force ``f`` [m/s²] are in axes ENU. ω_ie is the Earth
    rate, and ω_en is the transport rate. g_N and g_U are components of normal gravity. ``place`` is
    the result of :func:`.place_of`, and ``height`` is in metres.
    """
    ie_n, ie_u, x, en_n, en_u = frame_rates_of(place, v[0], v[1])
    y, z = 2.0 * ie_n + en_n, 2.0 * ie_u + en_u
    north, up = normal_gravity_vector_of(place[0], place[1], height)
    return (
        f[0] - (y * v[2] - z * v[1]),
        f[1] - (z * v[0] - x * v[2]) + north,
        f[2] - (x * v[1] - y * v[0]) + up,
    )


@inlined
def advance_position_of(position: Vector, v: Vector, next_v: Vector, dt: float) -> Vector:
    """Return the position after a step, moved with the mean of two velocities.

    ``v`` and ``next_v`` are the velocities before and after the step of ``dt`` seconds (midpoint
    rule).
    """
    v_e, v_n, v_u = 0.5 * (v[0] + next_v[0]), 0.5 * (v[1] + next_v[1]), 0.5 * (v[2] + next_v[2])
    north, _ = position_rate_of(place_of(position[0], position[2]), v_e, v_n)
    middle = place_of(position[0] + 0.5 * dt * north, position[2] + 0.5 * dt * v_u)
    north, east = position_rate_of(middle, v_e, v_n)
    return position[0] + dt * north, position[1] + dt * east, position[2] + dt * v_u


@inlined
def frame_turn(place: Place, v: Vector, time: float) -> Matrix:
    """Return the inverse rotation of the local-level frame in inertial space, exp(−[ω_in×] t).

    ω_in = ω_ie + ω_en is the rate of the frame, and t is ``time`` [s].
    """
    ie_n, ie_u, en_e, en_n, en_u = frame_rates_of(place, v[0], v[1])
    return small_turn(-time * en_e, -time * (ie_n + en_n), -time * (ie_u + en_u))


@inlined
def step(
    position: Vector,
    v: Vector,
    c_nb: Matrix,
    angle: Vector,
    dv: Vector,
    disturbance: Vector,
    dt: float,
) -> tuple[Vector, Vector, Matrix]:
    """Return the navigation state (position, velocity, C_nb) after an IMU interval.

    Arguments are numbers, or vectors of eight runs.

    Parameters
    ----------
    position, v, c_nb : position [rad, rad, m], velocity ENU [m/s] and attitude matrix.
    angle, dv : increments of angle [rad] (below π) and of velocity [m/s], in body axes.
    disturbance : gravity disturbance, ENU [m/s²]; zero in an INS without gravity compensation.
    dt : IMU interval [s].
    """
    # Body attitude halfway, from half the increment and half the turn of n at the old rates.
    latitude, _, height = position
    place = place_of(latitude, height)
    half = small_turn(0.5 * angle[0], 0.5 * angle[1], 0.5 * angle[2])
    turned = multiply(c_nb, half)
    middle = multiply(frame_turn(place, v, 0.5 * dt), turned)
    f = (
        (middle[0] * dv[0] + middle[1] * dv[1] + middle[2] * dv[2]) / dt + disturbance[0],
        (middle[3] * dv[0] + middle[4] * dv[1] + middle[5] * dv[2]) / dt + disturbance[1],
        (middle[6] * dv[0] + middle[7] * dv[1] + middle[8] * dv[2]) / dt + disturbance[2],
    )
    # Midpoint of position and velocity, then the velocity with the midpoint's rates.
    north, _ = position_rate_of(place, v[0], v[1])
    mid_height = height + 0.5 * dt * v[2]
    mid_place = place_of(latitude + 0.5 * dt * north, mid_height)
    rate = velocity_rate_of(place, height, v, f)
    mid_v = v[0] + 0.5 * dt * rate[0], v[1] + 0.5 * dt * rate[1], v[2] + 0.5 * dt * rate[2]
    rate = velocity_rate_of(mid_place, mid_height, mid_v, f)
    next_v = v[0] + dt * rate[0], v[1] + dt * rate[1], v[2] + dt * rate[2]
    next_c_nb = multiply(frame_turn(mid_place, mid_v, dt), multiply(turned, half))
    return advance_position_of(position, v, next_v, dt), next_v, next_c_nb


def steady_force(positions: np.ndarray, velocities: np.ndarray) -> np.ndarray:
    """Return the specific force (..., 3), ENU [m/s²], at constant velocity in normal gravity.

    In the symbols of :func:`velocity_rate_of` it is (2ω_ie + ω_en) × v − (0, g_N, g_U). Positions
    (..., 3) are in [rad, rad, m], and velocities (..., 3) are ENU [m/s].
    """
    places, speeds = (np.ascontiguousarray(a, float) for a in (positions, velocities))
    return _steady_forces(places.reshape(-1, 3), speeds.reshape(-1, 3)).reshape(places.shape)


@compiled
def _steady_forces(positions: np.ndarray, velocities: np.ndarray) -> np.ndarray:
    out = np.empty(positions.shape)
    for k in range(positions.shape[0]):
        place = place_of(positions[k, 0], positions[k, 2])
        rate = velocity_rate_of(place, positions[k, 2], _numbers(velocities[k]), (0.0, 0.0, 0.0))
        for i in range(3):
            out[k, i] = -rate[i]
    return out


@compiled
def advance_position(
    position: np.ndarray,
    velocity: np.ndarray,
    next_velocity: np.ndarray,
    dt: float,
    out: np.ndarray,
) -> None:
    """Fill the position after a step, see :func:`advance_position_of`.

    Parameters
    ----------
    position : (3,) before the step [rad, rad, m].
    velocity, next_velocity : (3,) before and after the step, ENU [m/s].
    dt : step [s].
    out : (3,) output, position after the step [rad, rad, m].
    """
    out[0], out[1], out[2] = advance_position_of(
        _numbers(position), _numbers(velocity), _numbers(next_velocity), dt
    )


@inlined
def _numbers(vector: np.ndarray) -> Vector:
    """Return the numbers of a vector (3,)."""
    return vector[0], vector[1], vector[2]


def altimeter_gains(time_constant: float) -> tuple[float, float]:
    """Return the gains k₁ [1/s], k₂ [1/s²] that put two poles of the vertical channel at −1/T.

    T is ``time_constant`` [s]. Without damping the height error obeys δh'' = (2g/R) δh, so k₁ = 2/T
    and k₂ = 1/T² + 2g/R. g is gravity, and R is the radius of the Earth.
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
    gravity: KnownGravity = NORMAL_GRAVITY,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Run the mechanization open loop over N increments.

    An altimeter with the measured height h_a damps the vertical channel: it adds −k₁ (h − h_a) to
    h' and −k₂ (h − h_a) to v_U' (Titterton and Weston 2004, sec. 12.3), integrated by the
    trapezoidal rule. A correction only at the end of a step would add a lag that the error model
    does not include.

    Parameters
    ----------
    position, velocity, c_nb : initial state, as in :func:`step`.
    delta_angles, delta_velocities : (N, 3) increments [rad], [m/s] in body axes.
    dt : IMU interval [s].
    heights : (N,) height of the altimeter, averaged over each interval [m]; None without an
        altimeter.
    gains : k₁ [1/s], k₂ [1/s²], from :func:`altimeter_gains`.
    gravity : gravity disturbance that is added to normal gravity.

    Returns
    -------
    positions (N + 1, 3) [rad, rad, m], velocities (N + 1, 3) [m/s], C_nb (N + 1, 3, 3).
    """
    initial = np.concatenate([position, velocity, np.ravel(c_nb)])
    altimeter = np.reshape([] if heights is None else heights, (1, -1, 1))
    track = unfilled(len(delta_angles) + 1, TRACK)
    navigate_lanes(
        initial=in_lanes(initial.reshape(1, 1, TRACK)),
        increments=in_lanes(np.hstack([delta_angles, delta_velocities])[np.newaxis]),
        dt=dt,
        heights=in_lanes(altimeter),
        gains=gains,
        gravity=gravity,
        track=track,
    )
    one = out_of_lanes(track, 1)[0]
    return one[:, :3].copy(), one[:, 3:6].copy(), one[:, 6:].reshape(-1, 3, 3)


@compiled
def navigate_lanes(
    initial: np.ndarray,
    increments: np.ndarray,
    dt: float,
    heights: np.ndarray,
    gains: tuple[float, float],
    gravity: KnownGravity,
    track: np.ndarray,
) -> None:
    """Run the mechanization of :func:`navigate` for a group of eight runs.

    Parameters
    ----------
    initial : (1, TRACK, LANES) initial position, velocity and C_nb (row by row).
    increments : (N, 6, LANES) increments of angle [rad] and velocity [m/s].
    dt : IMU interval [s].
    heights : (N, 1, LANES) heights of the altimeters [m]; (0, 1, LANES) without altimeters.
    gains : k₁ [1/s], k₂ [1/s²] of the altimeter.
    gravity : gravity disturbance that is added to normal gravity. If gradients are integrated, the
        arrays ``held`` and ``total`` of its ``readings`` are filled.
    track : (N + 1, TRACK, LANES) output: position, velocity and C_nb (row by row).
    """
    copy(initial, track)
    disturbance, moved = lanes(1, 3), lanes(3, 3)
    reads = gravity.readings.latest.shape[0] > 0
    for n in range(increments.shape[0]):
        if gravity.map.coefficients.size > 0:
            _look_up(track, n, dt, gravity.map, disturbance)
        elif reads:
            extrapolate(gravity.readings, track, n, dt, moved, disturbance)
        _step_lanes(track, increments, disturbance, n, dt)
        if heights.shape[0] > 0:
            _damp(track, heights, n, dt, gains)
        if reads:
            integrate(gravity.readings, track, n, dt, moved)


@copied
def _damp(
    track: np.ndarray, heights: np.ndarray, n: int, dt: float, gains: tuple[float, float]
) -> None:
    """Correct height and vertical velocity of row ``n + 1`` of a track with the altimeter.

    The altimeter measures the mean height h_a over the step. The mean difference d uses the
    corrected height at the end: d = (h_n + h_{n+1}) / 2 − h_a with
    h_{n+1} = h − (k₁ dt + k₂ dt² / 2) d. The velocity changes by −k₂ dt d.
    """
    change = (gains[0] + 0.5 * gains[1] * dt) * dt
    end = load(track, n + 1, 2)
    difference = (0.5 * (load(track, n, 2) + end) - load(heights, n, 0)) / (1.0 + 0.5 * change)
    store(track, n + 1, 2, end - change * difference)
    store(track, n + 1, 5, load(track, n + 1, 5) - gains[1] * dt * difference)


@copied
def _look_up(
    track: np.ndarray, n: int, dt: float, gravity: DisturbanceMap, disturbance: np.ndarray
) -> None:
    """Fill ``disturbance`` (1, 3, LANES) from a map, half a step after row ``n`` of a track."""
    place, value, derivative = np.empty(3), np.empty(3), np.empty((3, 3))
    for r in range(track.shape[2]):
        latitude, height = track[n, 0, r], track[n, 2, r]
        north, east = position_rate_of(place_of(latitude, height), track[n, 3, r], track[n, 4, r])
        place[0] = latitude + 0.5 * dt * north
        place[1] = track[n, 1, r] + 0.5 * dt * east
        place[2] = height + 0.5 * dt * track[n, 5, r]
        vector_at(
            place, gravity.origin, gravity.step, gravity.coefficients, gravity.base,
            value, derivative,
        )  # fmt: skip
        for i in range(3):
            disturbance[0, i, r] = value[i]


@inlined
def three(rows: np.ndarray, n: int, i: int) -> Vector:
    """Return columns i, i + 1, i + 2 of row ``n`` of an array (rows, columns, LANES)."""
    return load(rows, n, i), load(rows, n, i + 1), load(rows, n, i + 2)


@inlined
def keep(rows: np.ndarray, n: int, i: int, numbers: Vector) -> None:
    """Put ``numbers`` into columns i to i + 2 of row ``n`` of an array (rows, columns, LANES)."""
    store(rows, n, i, numbers[0])
    store(rows, n, i + 1, numbers[1])
    store(rows, n, i + 2, numbers[2])


@compiled
def _step_lanes(
    track: np.ndarray, increments: np.ndarray, disturbance: np.ndarray, n: int, dt: float
) -> None:
    """Run :func:`step` from row ``n`` of a track (., TRACK, LANES) to the next one.

    The step uses row ``n`` of the increments (., 6, LANES) and the disturbance (1, 3, LANES).
    """
    position, velocity, c_nb = step(
        position=three(track, n, 0),
        v=three(track, n, 3),
        c_nb=(*three(track, n, 6), *three(track, n, 9), *three(track, n, 12)),
        angle=three(increments, n, 0),
        dv=three(increments, n, 3),
        disturbance=three(disturbance, 0, 0),
        dt=dt,
    )
    keep(track, n + 1, 0, position)
    keep(track, n + 1, 3, velocity)
    keep(track, n + 1, 6, c_nb[:3])
    keep(track, n + 1, 9, c_nb[3:6])
    keep(track, n + 1, 12, c_nb[6:])


@compiled
def error_free_increments(
    positions: np.ndarray,
    velocities: np.ndarray,
    attitudes: np.ndarray,
    disturbances: np.ndarray,
    dt: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the IMU increments for which :func:`navigate` follows the truth.

    A fixed-point iteration on each step finds the increments. A change of the increments changes
    the result of the step by almost the same amount, so six corrections reach rounding accuracy in
    any manoeuvre. Each step starts from the result of the previous step, not from the truth.
    Otherwise systematic rounding errors would grow in the vertical channel by e^(t √(2g/R)), to
    kilometres in four hours.

    Parameters
    ----------
    positions, velocities, attitudes : (N + 1, 3), (N + 1, 3), (N + 1, 3, 3) truth, as returned by
        :func:`navigate`.
    disturbances : (N, 3) gravity disturbance of each interval, ENU [m/s²].
    dt : IMU interval [s].

    Returns
    -------
    delta_angles (N, 3) [rad], delta_velocities (N, 3) [m/s].
    """
    count = positions.shape[0] - 1
    delta_angles = np.zeros((count, 3))
    delta_velocities = np.zeros((count, 3))
    c_nb, difference, vector = np.empty((3, 3)), np.empty((3, 3)), np.empty(3)
    # The state is kept where navigation keeps it, and advances by its instructions: the same
    # formula compiled once more, for numbers, might round otherwise.
    pair, felt, disturbance = lanes(2, TRACK), lanes(1, 6), lanes(1, 3)
    keep(pair, 0, 0, _numbers(positions[0]))
    keep(pair, 0, 3, _numbers(velocities[0]))
    for i in range(3):
        keep(pair, 0, 6 + 3 * i, _numbers(attitudes[0, i]))
    for n in range(count):
        keep(disturbance, 0, 0, _numbers(disturbances[n]))
        felt[:] = 0.0
        _step_lanes(pair, felt, disturbance, 0, dt)
        for _ in range(6):
            for i in range(3):
                for j in range(3):
                    c_nb[i, j] = pair[1, 6 + 3 * i + j, 0]
            product(c_nb.T, attitudes[n + 1], difference)
            rotation_vector(difference, vector)
            for i in range(3):
                delta_angles[n, i] += vector[i]
                for j in range(3):
                    missing = velocities[n + 1, j] - pair[1, 3 + j, 0]
                    delta_velocities[n, i] += c_nb[j, i] * missing
            keep(felt, 0, 0, _numbers(delta_angles[n]))
            keep(felt, 0, 3, _numbers(delta_velocities[n]))
            _step_lanes(pair, felt, disturbance, 0, dt)
        for i in range(TRACK):
            store(pair, 0, i, load(pair, 1, i))
    return delta_angles, delta_velocities
