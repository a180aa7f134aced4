"""True trajectories from manoeuvres or from a track, sampled at the INS rate.

Velocity and attitude are smooth in time. The position is integrated from the velocity by the rule
of the mechanization, so an error-free INS reproduces the truth to rounding.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..numerics.kernels import compiled
from ..numerics.rotations import attitude_matrix, between
from .manoeuvres import BANK_GRAVITY, Manoeuvre, Segment, State, enu, follow, plan, sample

if TYPE_CHECKING:
    from .track import Track

__all__ = ["Segment", "Trajectory", "along", "fly"]


@dataclass(frozen=True)
class Trajectory:
    """True trajectory at the INS rate.

    Attributes
    ----------
    times : (N + 1,) times [s].
    dt : sampling interval [s].
    positions : (N + 1, 3) geodetic latitude, longitude [rad], height [m].
    velocities : (N + 1, 3) velocities ENU [m/s].
    attitudes : (N + 1, 3, 3) attitude matrices C_nb, from body axes to ENU.
    """

    times: np.ndarray
    dt: float
    positions: np.ndarray
    velocities: np.ndarray
    attitudes: np.ndarray

    @property
    def mean_heights(self) -> np.ndarray:
        """Return the mean height (N,) of each interval [m], as measured by an altimeter."""
        return 0.5 * (self.positions[1:, 2] + self.positions[:-1, 2])

    def at(self, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return positions (K, 3) and attitudes C_nb (K, 3, 3) at times (K,) of the flight [s]."""
        positions = np.stack(
            [np.interp(times, self.times, self.positions[:, axis]) for axis in range(3)], axis=-1
        )
        sample = np.minimum(times / self.dt, len(self.times) - 1)
        first = np.minimum(sample.astype(int), len(self.times) - 2)
        attitudes = between(self.attitudes[first], self.attitudes[first + 1], sample - first)
        return positions, attitudes


def fly(
    position: np.ndarray,
    speed: float,
    heading: float,
    pitch: float,
    roll: float,
    segments: Sequence[Manoeuvre],
    dt: float,
    banks: bool = True,
    size: int | None = None,
) -> Trajectory:
    """Return the true trajectory of manoeuvres from an initial state.

    The heading is the direction of the velocity. If ``banks`` is true, the climb angle is added to
    the pitch, and turns are coordinated: tan(bank) = speed · turn rate / g. In the first and last
    five seconds of a turn, the turn rate rises and falls as a raised cosine. The bank angle follows
    the turn rate.

    Parameters
    ----------
    position : (3,) latitude, longitude [rad], height [m].
    speed, heading : initial speed [m/s], and heading, clockwise from north [rad].
    pitch, roll : attitude in straight and level flight [rad].
    segments : manoeuvres, flown one after the other.
    dt : sampling interval [s].
    banks : whether the vehicle banks in turns and pitches with its climb angle.
    size : number of segments in the scenario file; later segments are repetitions. Used in
        messages.

    Returns
    -------
    The trajectory, with round(total duration / dt) + 1 samples.

    Raises
    ------
    TrajectoryError
        If a segment is impossible; the message states which one and why.
    """
    start = State(np.asarray(position, dtype=float), heading, speed, 0.0)
    rates, _ = plan(start, segments, dt, size)
    heading_t, speed_t, climb_t = sample(start, rates, dt)
    samples = len(heading_t)
    turn_at_samples = np.interp(
        np.arange(samples), np.arange(samples - 1) + 0.5, rates[:, 0], left=0.0, right=0.0
    )
    if banks:
        bank = roll + np.arctan(speed_t * turn_at_samples / BANK_GRAVITY)
        angles = np.stack([heading_t, pitch + climb_t, bank], axis=-1)
    else:
        level = np.ones(samples)
        angles = np.stack([heading_t, pitch * level, roll * level], axis=-1)
    return _trajectory(start.position, enu(heading_t, speed_t, climb_t), angles, dt)


def along(track: Track, dt: float, pitch: float, roll: float, banks: bool = True) -> Trajectory:
    """Return the true trajectory along a smoothed track, with samples ``dt`` [s] apart.

    ``pitch``, ``roll`` and ``banks`` are as in :func:`fly`. They are used only for angles that the
    track does not contain.

    Raises TrajectoryError if the track cannot be flown.
    """
    from .track import resample  # not at the top: it loads slowly, few flights have a track

    position, velocities, angles = resample(track, dt, pitch, roll, banks)
    return _trajectory(position, velocities, angles, dt)


def _trajectory(
    position: np.ndarray, velocities: np.ndarray, angles: np.ndarray, dt: float
) -> Trajectory:
    """Return the trajectory with given velocities, and heading, pitch, roll, both (N + 1, 3)."""
    return Trajectory(
        np.arange(len(velocities)) * dt,
        dt,
        follow(position, velocities, dt),
        velocities,
        attitudes_of(angles),
    )


@compiled
def attitudes_of(angles: np.ndarray) -> np.ndarray:
    """Return attitude matrices C_nb (N, 3, 3) for heading, pitch and roll (N, 3) [rad]."""
    attitudes = np.empty((angles.shape[0], 3, 3))
    for n in range(angles.shape[0]):
        c_nb = attitude_matrix(angles[n, 0], angles[n, 1], angles[n, 2])
        for i in range(3):
            for j in range(3):
                attitudes[n, i, j] = c_nb[i, j]
    return attitudes
