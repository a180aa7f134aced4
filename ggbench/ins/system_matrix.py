"""System matrix F of the INS error model, stored as non-zero entries of eight runs.

The last axis of arrays is the run (lane), see :mod:`ggbench.numerics.lanes`.
"""

from __future__ import annotations

import math

import numpy as np

from ..gravity.ellipsoid import normal_gravity_slopes_of, radii_derivatives_of
from ..gravity.field import DisturbanceMap
from ..gravity.spline import vector_at
from ..numerics.kernels import compiled, copied, inlined
from ..numerics.vectors import load, store
from .known_gravity import KnownGravity
from .local_level import Vector, frame_rates_of, place_of
from .strapdown import keep, three

STATES = 15
NAVIGATION_STATES = 9
# F by its entries that are not always zero; 51 of them, in this order.
# 0 to 5: (L; L, h, v_N), (λ; L, h, v_E)
DAMPING = 6  # (h; h)
VELOCITY = 7  # (v_i; L, h, v_E, v_N, v_U) of each i
SINKING = VELOCITY + 11  # (v_U; h)
FORCE = 22  # f^n, of [f^n ×]
ATTITUDE = 25  # (φ_i; L, h, v_E or v_N) of each i
TURN = 34  # ω_in, of −[ω_in ×]
BODY = 37  # C_nb
DECAY = 46  # 1/T of the gyro and of the accelerometer biases, negative
LONGITUDE = 48  # (v_i; λ) of each i, zero unless a map's gravity is added
# Of the gravity disturbance, of which only models that have it know:
DISTANCE = 51  # −|v|/D
DRIVEN = 52  # root of what drives it, √(|v|/D); |v| of what is left when gradients are integrated
SENSED = 53  # T, by which an error of the velocity enters what is integrated
TRANSPORT = 59  # ω_en, of −[ω_en ×], by which what is left turns against the local level
ENTRIES = 62


@inlined
def entries_dot(f: np.ndarray, n: int, j: int, stride: int, x: float, y: float, z: float) -> float:
    """Return the dot product of three entries of the system matrix F and (x, y, z).

    The entries have the indices j, j + stride and j + 2 stride in row ``n`` of ``f``.
    """
    return load(f, n, j) * x + load(f, n, j + stride) * y + load(f, n, j + 2 * stride) * z


@copied
def _fill(
    latitude: float,
    height: float,
    v: Vector,
    f: Vector,
    out: np.ndarray,
    m: int,
) -> None:
    """Fill the entries of F in element ``m`` of ``out``, except C_nb, damping and decay.

    Parameters
    ----------
    latitude, height, v, f : navigation state [rad, m], ENU [m/s], and specific force ENU [m/s²].
    out : (., ENTRIES, LANES) output.
    """
    place = place_of(latitude, height)
    sine, cosine, r_m, r_n = place
    # Curvatures: a division costs as much as a dozen products.
    c_m, c_n, secant = 1.0 / r_m, 1.0 / r_n, 1.0 / cosine
    tangent = sine * secant
    d_m, d_n = radii_derivatives_of(sine, cosine)
    ie_n, ie_u, en_e, en_n, en_u = frame_rates_of(place, v[0], v[1])
    north_l, north_h, up_l, up_h = normal_gravity_slopes_of(sine, cosine, height)
    # Derivatives of ω_ie and ω_en with respect to L, h and v_E, v_N.
    en_e_h, en_n_h = v[1] * c_m * c_m, -v[0] * c_n * c_n
    en_u_h = en_n_h * tangent
    en_e_l, en_n_l = en_e_h * d_m, en_n_h * d_n
    en_u_l = v[0] * secant * secant * c_n + en_u_h * d_n
    en_n_e, en_u_e, en_e_n = c_n, tangent * c_n, -c_m
    # Position.
    keep(out, m, 0, (-en_e_l, -en_e_h, c_m))
    longitude = v[0] * secant * c_n * (tangent - d_n * c_n), en_n_h * secant, secant * c_n
    keep(out, m, 3, longitude)
    # Velocity: −(∂(2ω_ie + ω_en) × v) − (2ω_ie + ω_en) × ∂v + ∂g.
    x_l, y_l, z_l = en_e_l, en_n_l - 2.0 * ie_u, en_u_l + 2.0 * ie_n
    x, y, z = en_e, en_n + 2.0 * ie_n, en_u + 2.0 * ie_u
    store(out, m, VELOCITY, z_l * v[1] - y_l * v[2])
    store(out, m, VELOCITY + 1, en_u_h * v[1] - en_n_h * v[2])
    store(out, m, VELOCITY + 2, en_u_e * v[1] - en_n_e * v[2])
    store(out, m, VELOCITY + 3, z)
    store(out, m, VELOCITY + 4, -y)
    store(out, m, VELOCITY + 5, x_l * v[2] - z_l * v[0] + north_l)
    store(out, m, VELOCITY + 6, en_e_h * v[2] - en_u_h * v[0] + north_h)
    store(out, m, VELOCITY + 7, -en_u_e * v[0] - z)
    store(out, m, VELOCITY + 8, en_e_n * v[2])
    store(out, m, VELOCITY + 9, x)
    store(out, m, VELOCITY + 10, y_l * v[0] - x_l * v[1] + up_l)
    store(out, m, VELOCITY + 11, en_n_h * v[0] - en_e_h * v[1] + up_h)
    store(out, m, VELOCITY + 12, en_n_e * v[0] + y)
    store(out, m, VELOCITY + 13, -en_e_n * v[1] - x)
    store(out, m, VELOCITY + 14, 0.0)
    keep(out, m, FORCE, f)
    # Attitude: ∂ω_in − ω_in × φ.
    keep(out, m, ATTITUDE, (en_e_l, en_e_h, en_e_n))
    keep(out, m, ATTITUDE + 3, (en_n_l - ie_u, en_n_h, en_n_e))
    keep(out, m, ATTITUDE + 6, (en_u_l + ie_n, en_u_h, en_u_e))
    keep(out, m, TURN, (en_e, ie_n + en_n, ie_u + en_u))


@inlined
def _middle(track: np.ndarray, n: int, i: int) -> float:
    """Return component ``i`` of a navigation state midway between IMU samples n and n + 1.

    The mean is used for all components, although some effects are small. The mean of the height
    changes an entry of F by a fraction below 1e-6 in a steep climb. The mean of the attitude
    changes the entries of the specific force by a fraction of 3e-4 in a turn.
    """
    return 0.5 * (load(track, n, i) + load(track, n + 1, i))


@compiled
def entries_between(
    track: np.ndarray,
    increments: np.ndarray,
    first: int,
    last: int,
    dt: float,
    constant: np.ndarray,
    gravity: KnownGravity,
    out: np.ndarray,
) -> None:
    """Fill the non-zero entries of the system matrix F in the IMU intervals between two samples.

    They are computed at the middle of each interval.

    Parameters
    ----------
    track : (N + 1, TRACK, LANES) navigation states.
    increments : (N, 6, LANES) increments of angle [rad] and velocity [m/s].
    dt : IMU interval [s].
    first, last : indices of the two samples.
    constant : (ENTRIES,) constants added to F: damping by an altimeter and decay of biases.
        The entry ``DISTANCE`` is −1/D [1/m], with the correlation length D of the gravity
        disturbance; F gets −1/D times the speed. Other entries are zero.
    gravity : gravity disturbance that the mechanization adds. If it is integrated from gradients,
        call :func:`.receive_all` first.
    out : (M, ENTRIES, LANES) output; the first ``last - first`` of the M elements are filled.
    """
    rate = 1.0 / dt
    for n in range(first, last):
        m = n - first
        a_0, a_1, a_2 = three(increments, n, 3)
        a_0, a_1, a_2 = rate * a_0, rate * a_1, rate * a_2
        for i in range(9):
            store(out, m, BODY + i, _middle(track, n, 6 + i))
        force = (
            entries_dot(f=out, n=m, j=BODY, stride=1, x=a_0, y=a_1, z=a_2),
            entries_dot(f=out, n=m, j=BODY + 3, stride=1, x=a_0, y=a_1, z=a_2),
            entries_dot(f=out, n=m, j=BODY + 6, stride=1, x=a_0, y=a_1, z=a_2),
        )
        velocity = _middle(track, n, 3), _middle(track, n, 4), _middle(track, n, 5)
        _fill(_middle(track, n, 0), _middle(track, n, 2), velocity, force, out, m)
        store(out, m, DAMPING, constant[DAMPING])
        store(out, m, SINKING, load(out, m, SINKING) + constant[SINKING])
        store(out, m, DECAY, constant[DECAY])
        store(out, m, DECAY + 1, constant[DECAY + 1])
        speed = math.sqrt(
            velocity[0] * velocity[0] + velocity[1] * velocity[1] + velocity[2] * velocity[2]
        )
        store(out, m, DISTANCE, constant[DISTANCE] * speed)
        if gravity.map.coefficients.size > 0:
            _add_gradient(track, n, gravity.map, out, m)
        else:
            for i in range(3):
                store(out, m, LONGITUDE + i, 0.0)
        if gravity.readings.latest.shape[0] > 0:
            store(out, m, DRIVEN, speed)
            known = gravity.readings.latest[n]
            for i in range(6):
                store(out, m, SENSED + i, load(gravity.readings.held, known, i))
            place = place_of(_middle(track, n, 0), _middle(track, n, 2))
            _, _, en_e, en_n, en_u = frame_rates_of(place, velocity[0], velocity[1])
            keep(out, m, TRANSPORT, (en_e, en_n, en_u))
        else:
            store(out, m, DRIVEN, math.sqrt(-constant[DISTANCE] * speed))
            for i in range(SENSED, ENTRIES):
                store(out, m, i, 0.0)


@copied
def _add_gradient(
    track: np.ndarray, n: int, gravity: DisturbanceMap, out: np.ndarray, m: int
) -> None:
    """Add the position derivatives of a map's gravity to F in element ``m`` of ``out``.

    The position is midway between samples n and n + 1 of the track.
    """
    place, value, slope = np.empty(3), np.empty(3), np.empty((3, 3))
    for r in range(track.shape[2]):
        for axis in range(3):
            place[axis] = 0.5 * (track[n, axis, r] + track[n + 1, axis, r])
        vector_at(
            place, gravity.origin, gravity.step, gravity.coefficients, gravity.base,
            value, slope,
        )  # fmt: skip
        for i in range(3):
            out[m, VELOCITY + 5 * i, r] += slope[i, 0]
            out[m, LONGITUDE + i, r] = slope[i, 1]
            out[m, VELOCITY + 5 * i + 1, r] += slope[i, 2]
