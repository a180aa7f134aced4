"""True trajectories: segments of cruise, turn and climb, sampled at the INS rate.

Velocity and attitude are analytic in time; position follows from velocity by the mechanization's
own rule, so that an error-free INS can return the truth to rounding.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .strapdown import advance_position, attitude_matrix


@dataclass(frozen=True)
class Segment:
    """A part of a flight in which speed, heading and climb angle change at constant rates.

    Attributes
    ----------
    duration : [s].
    turn_rate : rate of the heading, clockwise positive [rad/s].
    acceleration : rate of the speed [m/s²].
    climb_rate : rate of the vertical velocity's angle above the horizon [rad/s].
    """

    duration: float
    turn_rate: float = 0.0
    acceleration: float = 0.0
    climb_rate: float = 0.0


@dataclass(frozen=True)
class Trajectory:
    """Truth at the INS rate.

    Attributes
    ----------
    times : (N + 1,) [s]. dt : interval [s].
    positions : (N + 1, 3) geodetic latitude, longitude [rad], height [m].
    velocities : (N + 1, 3) ENU [m/s]. attitudes : (N + 1, 3, 3) C_nb.
    """

    times: np.ndarray
    dt: float
    positions: np.ndarray
    velocities: np.ndarray
    attitudes: np.ndarray


def fly(
    position: np.ndarray,
    speed: float,
    heading: float,
    pitch: float,
    roll: float,
    segments: Sequence[Segment],
    dt: float,
) -> Trajectory:
    """Fly segments from a starting state.

    Heading turns with the velocity, pitch with the climb angle; a turn banks the aircraft for
    coordination (tan(bank) = speed · turn rate / g), rolled in and out over the first and the last
    five seconds of the segment in which the turn rate, too, rises and falls (raised cosine).

    Parameters
    ----------
    position : (3,) latitude, longitude [rad], height [m].
    speed, heading : [m/s], clockwise from north [rad].
    pitch, roll : attitude in straight and level flight [rad].
    segments : flown one after the other. dt : sampling interval [s].

    Returns
    -------
    Trajectory of round(total duration / dt) + 1 samples.
    """
    rates = np.concatenate([_segment_rates(segment, dt) for segment in segments])
    # Midpoint values of the rates integrate exactly into values at the samples.
    heading_t, speed_t, climb_t = (
        start + np.concatenate([[0.0], np.cumsum(rates[:, i]) * dt])
        for i, start in enumerate((heading, speed, 0.0))
    )
    samples = len(heading_t)
    turn_at_samples = np.interp(
        np.arange(samples), np.arange(samples - 1) + 0.5, rates[:, 0], left=0.0, right=0.0
    )
    bank = roll + np.arctan(speed_t * turn_at_samples / 9.81)
    velocities = np.stack(
        [
            speed_t * np.cos(climb_t) * np.sin(heading_t),
            speed_t * np.cos(climb_t) * np.cos(heading_t),
            speed_t * np.sin(climb_t),
        ],
        axis=-1,
    )
    positions = np.empty((samples, 3))
    attitudes = np.empty((samples, 3, 3))
    positions[0] = position
    for n in range(samples):
        attitudes[n] = attitude_matrix(heading_t[n], pitch + climb_t[n], bank[n])
        if n > 0:
            advance_position(positions[n - 1], velocities[n - 1], velocities[n], dt, positions[n])
    return Trajectory(np.arange(samples) * dt, dt, positions, velocities, attitudes)


def _segment_rates(segment: Segment, dt: float) -> np.ndarray:
    """Return (N, 3) heading, speed and climb rates at the middle of each interval."""
    count = max(round(segment.duration / dt), 1)
    middle = (np.arange(count) + 0.5) * dt
    # Rates start and end at zero smoothly; the mean over the segment is kept.
    ramp = min(5.0, 0.5 * segment.duration)
    edge = np.minimum(middle, count * dt - middle)
    shape = np.where(edge < ramp, 0.5 * (1.0 - np.cos(math.pi * edge / ramp)), 1.0)
    shape /= shape.mean()
    return np.outer(shape, [segment.turn_rate, segment.acceleration, segment.climb_rate])
