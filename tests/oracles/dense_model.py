"""The error model of one INS track as dense matrices, through the kernels for several.

F is written in the textbook variables; Φ, Q and the rows of delayed readings are those of the state
in metres.
"""

from __future__ import annotations

import numpy as np

from ggbench.gravity.ellipsoid import metres_per_radian
from ggbench.ins.adjoint import SCALED, forward, scaled_entries, series_terms
from ggbench.ins.delayed_rows import MOVED, intervals_of
from ggbench.ins.error_model import GYRO_BIAS, added_by
from ggbench.ins.imu import Imu
from ggbench.ins.known_gravity import NORMAL_GRAVITY, KnownGravity
from ggbench.ins.noise import noise_roots
from ggbench.ins.system_matrix import (
    ATTITUDE,
    BODY,
    DAMPING,
    DECAY,
    ENTRIES,
    FORCE,
    LONGITUDE,
    STATES,
    TURN,
    VELOCITY,
    entries_between,
)
from ggbench.ins.transitions import as_row, compose, unit_columns
from ggbench.numerics.kernels import compiled
from ggbench.numerics.lanes import in_lanes, lanes, out_of_lanes, unfilled


def _places() -> list[tuple[int, int, int, float]]:
    """Return (row, column, entry, sign) of all of F but its constant (h; v_U) = 1."""
    places = [(0, 0, 0, 1.0), (0, 2, 1, 1.0), (0, 4, 2, 1.0)]
    places += [(1, 0, 3, 1.0), (1, 2, 4, 1.0), (1, 3, 5, 1.0), (2, 2, DAMPING, 1.0)]
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        for at, column in enumerate((0, 2, 3, 4, 5)):
            places.append((3 + i, column, VELOCITY + 5 * i + at, 1.0))
        places.append((3 + i, 1, LONGITUDE + i, 1.0))
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
    """Return F (N, 15, 15) of its entries (N, 62), without those of the gravity disturbance."""
    matrices = np.zeros((len(entries), STATES, STATES))
    matrices[:, _ROWS, _COLUMNS] = _SIGNS * entries[:, _WHICH]
    matrices[:, 2, 5] = 1.0
    return matrices


def sparse(matrices: np.ndarray) -> np.ndarray:
    """Return the entries (N, 62) of F (N, 15, 15)."""
    entries = np.zeros((len(matrices), ENTRIES))
    entries[:, _WHICH] = _SIGNS * matrices[:, _ROWS, _COLUMNS]
    return entries


def completed(
    matrices: np.ndarray, imu: Imu, altimeter: tuple[tuple[float, float], float] | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Return F (N, 15, 15) with what sensors add to it, and their G q Gᵀ (15, 15)."""
    entries, noise = added_by(imu, altimeter)
    added = dense(entries[np.newaxis])
    added[:, 2, 5] = 0.0
    return matrices + added, noise


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
        track=in_lanes(states[np.newaxis]),
        increments=in_lanes(increments[np.newaxis]),
        first=0,
        last=count,
        dt=dt,
        constant=np.zeros(ENTRIES),
        gravity=gravity,
        out=entries,
    )
    return dense(out_of_lanes(entries, 1)[0])


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
    noise : (15, 15) G q Gᵀ, as :func:`ggbench.ins.error_model.noise_psd` has it.

    Returns
    -------
    transition, process_cov : (K, 15, 15) each, from epoch k − 1 to epoch k.
    """
    entries = in_lanes(sparse(matrices)[np.newaxis])
    decaying = bool(matrices[:, GYRO_BIAS.start :, GYRO_BIAS.start :].any())
    roots = noise_roots(noise, decaying).over(dt)
    transition, process_cov = np.empty((2, 1, len(epochs), STATES, STATES))
    start = 0
    for k, end in enumerate(epochs):
        compose(
            entries=entries[start:end],
            dt=dt,
            noise=roots,
            start=_metres(positions[start]),
            end=_metres(positions[end]),
            transition=transition[:, k],
            process_cov=process_cov[:, k],
        )
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
        _delayed(
            entries[first:epoch],
            part,
            dt,
            _metres(positions[nearest]),
            _metres(positions[epoch]),
            rows[:, k],
        )
    return rows[0]


def _metres(position: np.ndarray) -> np.ndarray:
    """Return metres per radian of latitude and longitude (1, 2, LANES) of one run."""
    return in_lanes(np.reshape(metres_per_radian(position), (1, 1, 2)))


@compiled
def _delayed(
    entries: np.ndarray,
    part: float,
    dt: float,
    then: np.ndarray,
    now: np.ndarray,
    rows: np.ndarray,
) -> None:
    """Fill B (R, 6, n) of one epoch: position [m] and attitude error at t − τ are B x(t).

    Interval by interval, as :func:`.delayed_rows_lanes` must have it, too.

    Parameters
    ----------
    entries : (count, ENTRIES, LANES) of F in the IMU intervals from t − τ to t.
    part : of the first interval that lies after t − τ [s].
    dt : the others [s].
    then, now : (1, 2, LANES) metres per radian at t − τ and at t.
    rows : output, of the group's R runs.
    """
    columns, terms, f = lanes(6, STATES), series_terms(), lanes(1, SCALED)
    unit_columns(then, np.array(MOVED), columns)
    for n in range(entries.shape[0]):
        scaled_entries(entries, n, -(part if n == 0 else dt), f)
        forward(f, columns, terms)
    for run in range(rows.shape[0]):
        for i in range(6):
            as_row(columns, i, now, run, rows[run, i])
