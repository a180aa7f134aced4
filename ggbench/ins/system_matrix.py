"""F of the INS error model, by its entries that are not always zero, for several runs at once.

All arrays have the runs last, :data:`~.kernels.LANES` of them, and are flat where it makes
a loop over the runs vector instructions: element j of run r is at ``j * LANES + r``. Such loops run
to the length of an axis, not to LANES: for a fixed small number of iterations the compiler does not
check that arrays do not overlap, and then gives up.
"""

from __future__ import annotations

import numpy as np

from ..gravity.ellipsoid import normal_gravity_of, radii_derivatives_of
from ..numerics.kernels import LANES, compiled, inlined
from .strapdown import frame_rates_of, place_of

STATES = 15
NAVIGATION_STATES = 9
# F by its entries that are not always zero; 48 of them, in this order.
# 0 to 5: (L; L, h, v_N), (λ; L, h, v_E)
DAMPING = 6  # (h; h)
VELOCITY = 7  # (v_i; L, h, v_E, v_N, v_U) of each i
FORCE = 22  # f^n, of [f^n ×]
ATTITUDE = 25  # (φ_i; L, h, v_E or v_N) of each i
TURN = 34  # ω_in, of −[ω_in ×]
BODY = 37  # C_nb
DECAY = 46  # 1/T of the gyro and of the accelerometer biases, negative
ENTRIES = 48


def _places() -> list[tuple[int, int, int, float]]:
    """Return (row, column, entry, sign) of all of F but its constant (h; v_U) = 1."""
    places = [(0, 0, 0, 1.0), (0, 2, 1, 1.0), (0, 4, 2, 1.0)]
    places += [(1, 0, 3, 1.0), (1, 2, 4, 1.0), (1, 3, 5, 1.0), (2, 2, DAMPING, 1.0)]
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        for at, column in enumerate((0, 2, 3, 4, 5)):
            places.append((3 + i, column, VELOCITY + 5 * i + at, 1.0))
        for at, column in enumerate((0, 2, 4 if i == 0 else 3)):
            places.append((6 + i, column, ATTITUDE + 3 * i + at, 1.0))
        places += [(3 + i, 6 + k, FORCE + j, 1.0), (3 + i, 6 + j, FORCE + k, -1.0)]
        places += [(6 + i, 6 + k, TURN + j, -1.0), (6 + i, 6 + j, TURN + k, 1.0)]
        for axis in range(3):
            places.append((6 + i, 9 + axis, BODY + 3 * i + axis, -1.0))
            places.append((3 + i, 12 + axis, BODY + 3 * i + axis, 1.0))
        places += [(9 + i, 9 + i, DECAY, 1.0), (12 + i, 12 + i, DECAY + 1, 1.0)]
    return places


_ROWS, _COLUMNS, _WHICH, _SIGNS = (np.array(column) for column in zip(*_places(), strict=True))


def dense(entries: np.ndarray) -> np.ndarray:
    """Return F (N, 15, 15) of its entries (N, 48)."""
    matrices = np.zeros((len(entries), STATES, STATES))
    matrices[:, _ROWS, _COLUMNS] = _SIGNS * entries[:, _WHICH]
    matrices[:, 2, 5] = 1.0
    return matrices


def sparse(matrices: np.ndarray) -> np.ndarray:
    """Return the entries (N, 48) of F (N, 15, 15)."""
    entries = np.empty((len(matrices), ENTRIES))
    entries[:, _WHICH] = _SIGNS * matrices[:, _ROWS, _COLUMNS]
    return entries


@inlined
def _fill(
    latitude: float,
    height: float,
    v: tuple[float, float, float],
    f: tuple[float, float, float],
    out: np.ndarray,
    r: int,
) -> None:
    """Fill the entries of F of run ``r`` but C_nb, damping and decay.

    Parameters
    ----------
    latitude, height, v, f : navigation state [rad, m], ENU [m/s], and specific force ENU [m/s²].
    out : (ENTRIES * LANES,) output.
    """
    place = place_of(latitude, height)
    sine, cosine, r_m, r_n = place
    tangent, secant = sine / cosine, 1.0 / cosine
    d_m, d_n = radii_derivatives_of(sine, cosine)
    ie_n, ie_u, en_e, en_n, en_u = frame_rates_of(place, v[0], v[1])
    _, gamma_latitude, gamma_height = normal_gravity_of(sine, cosine, height)
    # Derivatives of ω_ie and ω_en with respect to L, h and v_E, v_N.
    en_e_h, en_n_h = v[1] / (r_m * r_m), -v[0] / (r_n * r_n)
    en_u_h = en_n_h * tangent
    en_e_l, en_n_l = en_e_h * d_m, en_n_h * d_n
    en_u_l = v[0] * secant * secant / r_n + en_u_h * d_n
    en_n_e, en_u_e, en_e_n = 1.0 / r_n, tangent / r_n, -1.0 / r_m
    # Position.
    out[r] = -v[1] * d_m / (r_m * r_m)
    out[LANES + r] = -v[1] / (r_m * r_m)
    out[2 * LANES + r] = 1.0 / r_m
    out[3 * LANES + r] = v[0] * secant / r_n * (tangent - d_n / r_n)
    out[4 * LANES + r] = -v[0] * secant / (r_n * r_n)
    out[5 * LANES + r] = secant / r_n
    # Velocity: −(∂(2ω_ie + ω_en) × v) − (2ω_ie + ω_en) × ∂v + ∂g.
    x_l, y_l, z_l = en_e_l, en_n_l - 2.0 * ie_u, en_u_l + 2.0 * ie_n
    x, y, z = en_e, en_n + 2.0 * ie_n, en_u + 2.0 * ie_u
    out[(VELOCITY + 0) * LANES + r] = z_l * v[1] - y_l * v[2]
    out[(VELOCITY + 1) * LANES + r] = en_u_h * v[1] - en_n_h * v[2]
    out[(VELOCITY + 2) * LANES + r] = en_u_e * v[1] - en_n_e * v[2]
    out[(VELOCITY + 3) * LANES + r] = z
    out[(VELOCITY + 4) * LANES + r] = -y
    out[(VELOCITY + 5) * LANES + r] = x_l * v[2] - z_l * v[0]
    out[(VELOCITY + 6) * LANES + r] = en_e_h * v[2] - en_u_h * v[0]
    out[(VELOCITY + 7) * LANES + r] = -en_u_e * v[0] - z
    out[(VELOCITY + 8) * LANES + r] = en_e_n * v[2]
    out[(VELOCITY + 9) * LANES + r] = x
    out[(VELOCITY + 10) * LANES + r] = y_l * v[0] - x_l * v[1] - gamma_latitude
    out[(VELOCITY + 11) * LANES + r] = en_n_h * v[0] - en_e_h * v[1] - gamma_height
    out[(VELOCITY + 12) * LANES + r] = en_n_e * v[0] + y
    out[(VELOCITY + 13) * LANES + r] = -en_e_n * v[1] - x
    out[(VELOCITY + 14) * LANES + r] = 0.0
    out[(FORCE + 0) * LANES + r], out[(FORCE + 1) * LANES + r] = f[0], f[1]
    out[(FORCE + 2) * LANES + r] = f[2]
    # Attitude: ∂ω_in − ω_in × φ.
    out[(ATTITUDE + 0) * LANES + r] = en_e_l
    out[(ATTITUDE + 1) * LANES + r] = en_e_h
    out[(ATTITUDE + 2) * LANES + r] = en_e_n
    out[(ATTITUDE + 3) * LANES + r] = en_n_l - ie_u
    out[(ATTITUDE + 4) * LANES + r] = en_n_h
    out[(ATTITUDE + 5) * LANES + r] = en_n_e
    out[(ATTITUDE + 6) * LANES + r] = en_u_l + ie_n
    out[(ATTITUDE + 7) * LANES + r] = en_u_h
    out[(ATTITUDE + 8) * LANES + r] = en_u_e
    out[(TURN + 0) * LANES + r] = en_e
    out[(TURN + 1) * LANES + r] = ie_n + en_n
    out[(TURN + 2) * LANES + r] = ie_u + en_u


@compiled
def entries_between(
    before: np.ndarray,
    after: np.ndarray,
    delta_velocities: np.ndarray,
    dt: float,
    constant: np.ndarray,
    out: np.ndarray,
) -> None:
    """Fill the entries of F at the middle of an IMU interval.

    Parameters
    ----------
    before, after : (TRACK * LANES,) navigation states at its ends.
    delta_velocities : (3 * LANES,) increments [m/s]. dt : the interval [s].
    constant : (ENTRIES,) what is added to F, of which only damping and decay may differ from zero.
    out : (ENTRIES * LANES,) output.
    """
    lanes = out.shape[0] // ENTRIES
    for r in range(lanes):
        c = (
            0.5 * (before[6 * LANES + r] + after[6 * LANES + r]),
            0.5 * (before[7 * LANES + r] + after[7 * LANES + r]),
            0.5 * (before[8 * LANES + r] + after[8 * LANES + r]),
            0.5 * (before[9 * LANES + r] + after[9 * LANES + r]),
            0.5 * (before[10 * LANES + r] + after[10 * LANES + r]),
            0.5 * (before[11 * LANES + r] + after[11 * LANES + r]),
            0.5 * (before[12 * LANES + r] + after[12 * LANES + r]),
            0.5 * (before[13 * LANES + r] + after[13 * LANES + r]),
            0.5 * (before[14 * LANES + r] + after[14 * LANES + r]),
        )
        a_0 = delta_velocities[r] / dt
        a_1 = delta_velocities[LANES + r] / dt
        a_2 = delta_velocities[2 * LANES + r] / dt
        _fill(
            0.5 * (before[r] + after[r]),
            0.5 * (before[2 * LANES + r] + after[2 * LANES + r]),
            (
                0.5 * (before[3 * LANES + r] + after[3 * LANES + r]),
                0.5 * (before[4 * LANES + r] + after[4 * LANES + r]),
                0.5 * (before[5 * LANES + r] + after[5 * LANES + r]),
            ),
            (
                c[0] * a_0 + c[1] * a_1 + c[2] * a_2,
                c[3] * a_0 + c[4] * a_1 + c[5] * a_2,
                c[6] * a_0 + c[7] * a_1 + c[8] * a_2,
            ),
            out,
            r,
        )
        out[(BODY + 0) * LANES + r], out[(BODY + 1) * LANES + r] = c[0], c[1]
        out[(BODY + 2) * LANES + r], out[(BODY + 3) * LANES + r] = c[2], c[3]
        out[(BODY + 4) * LANES + r], out[(BODY + 5) * LANES + r] = c[4], c[5]
        out[(BODY + 6) * LANES + r], out[(BODY + 7) * LANES + r] = c[6], c[7]
        out[(BODY + 8) * LANES + r] = c[8]
        out[DAMPING * LANES + r] = constant[DAMPING]
        out[(VELOCITY + 11) * LANES + r] += constant[VELOCITY + 11]
        out[DECAY * LANES + r] = constant[DECAY]
        out[(DECAY + 1) * LANES + r] = constant[DECAY + 1]
