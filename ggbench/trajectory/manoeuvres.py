"""Manoeuvres: parts of a flight with changes of heading, speed and climb angle.

A manoeuvre is a series of rates of heading, speed and climb angle at the middles of the sampling
intervals. The flight is the integral of the rates of all manoeuvres. Rates rise and fall as raised
cosines, so acceleration and turn rate are continuous.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ..errors import GGBenchError
from ..ins.strapdown import advance_position
from ..numerics.kernels import compiled

Array = NDArray[np.float64]

BANK_GRAVITY = 9.81
"""The g of a coordinated turn, tan(bank) = speed · turn rate / g [m/s²]."""
LONGEST_FLIGHT = 1e6
"""Longest flight of manoeuvres [s]."""
_RAMP = 5.0  # rolling in or out of a turn, or of an acceleration [s]
_SHORTEST_PULL_UP = 4.0  # [s]


class TrajectoryError(GGBenchError, ValueError):
    """A flight is impossible, or a file for a flight is invalid.

    The class derives from ValueError, so that validation of a scenario states the position of the
    error in the scenario file.
    """


@dataclass(frozen=True)
class State:
    """Initial state of a manoeuvre.

    Attributes
    ----------
    position : (3,) latitude, longitude [rad], height [m].
    heading, speed, climb : heading [rad], speed along the path [m/s], climb angle [rad].
    """

    position: Array
    heading: float
    speed: float
    climb: float


class Manoeuvre(Protocol):
    """Part of a flight, defined by rates of heading, speed and climb angle."""

    def length(self, start: State) -> float:
        """Return the duration of the manoeuvre from an initial state [s].

        Raises TrajectoryError if the manoeuvre is impossible.
        """
        ...

    def rates(self, start: State, count: int, dt: float) -> Array:
        """Return rates (count, 3) of heading [rad/s], speed [m/s²] and climb angle [rad/s].

        The manoeuvre has ``count`` sampling intervals of length ``dt`` [s]. A row contains the
        rates at the middle of an interval.
        """
        ...


@dataclass(frozen=True)
class Segment:
    """Part of a flight with given mean rates of heading, speed and climb angle.

    The rates rise from zero and fall to zero. Rise and fall take at most five seconds each.

    Attributes
    ----------
    duration : duration [s].
    turn_rate : mean rate of the heading, clockwise positive [rad/s].
    acceleration : mean rate of the speed [m/s²].
    climb_rate : mean rate of the climb angle [rad/s].
    """

    duration: float
    turn_rate: float = 0.0
    acceleration: float = 0.0
    climb_rate: float = 0.0

    def length(self, start: State) -> float:
        """Return the duration of the manoeuvre [s]."""
        return self.duration

    def rates(self, start: State, count: int, dt: float) -> Array:
        """Return rates (count, 3) of heading, speed and climb angle.

        The integral of each rate is its mean, an attribute of the segment, times the duration.
        """
        shape = _shape(count, dt, self.duration)
        if abs(count * dt - self.duration) > 1e-9 * self.duration:
            shape *= self.duration / (count * dt)
        return np.outer(shape, [self.turn_rate, self.acceleration, self.climb_rate])


@dataclass(frozen=True)
class Cruise:
    """Straight flight over a distance along the path [m], at constant speed and climb angle."""

    distance: float

    def length(self, start: State) -> float:
        """Return the duration [s], distance over speed."""
        return self.distance / speed_of(start)

    def rates(self, start: State, count: int, dt: float) -> Array:
        """Return zero rates (count, 3)."""
        return np.zeros((count, 3))


@dataclass(frozen=True)
class Turn:
    """Turn by an angle or to a heading; rolling in and rolling out take five seconds each.

    Attributes
    ----------
    by : angle of the turn, clockwise positive [rad]; None if ``to`` is given.
    to : final heading [rad]; None if ``by`` is given.
    direction : direction of a turn ``to`` a heading: 1 right, -1 left, 0 the shorter way.
    bank, rate, radius : bank angle [rad], turn rate [rad/s] or radius [m]; two of the three are
        None. The turn rate is lower if the angle is too small for the time of rolling in and out.
    """

    by: float | None = None
    to: float | None = None
    direction: int = 0
    bank: float | None = None
    rate: float | None = None
    radius: float | None = None

    def angle(self, start: State) -> float:
        """Return the angle of the turn, clockwise positive [rad].

        Raises TrajectoryError if the flight already has the heading ``to``.
        """
        if self.by is not None:
            return self.by
        assert self.to is not None
        short = math.remainder(self.to - start.heading, math.tau)
        if abs(short) < 1e-9:
            raise TrajectoryError(
                f"already flies at heading {math.degrees(self.to):g}°; give another to_heading_deg,"
                " or by_heading_deg = 360 for a full circle"
            )
        if self.direction * short < 0.0:
            return short + self.direction * math.tau
        return short

    def length(self, start: State) -> float:
        """Return the duration of the turn [s], including rolling in and out."""
        if self.rate is not None:
            rate = self.rate
        elif self.radius is not None:
            rate = speed_of(start) / self.radius
        else:
            assert self.bank is not None
            rate = BANK_GRAVITY * math.tan(self.bank) / speed_of(start)
        return max(abs(self.angle(start)) / rate + _RAMP, 2.0 * _RAMP)

    def rates(self, start: State, count: int, dt: float) -> Array:
        """Return rates (count, 3) of heading, speed and climb angle.

        The integral of the heading rate is the angle of the turn. The other two rates are zero.
        """
        shape = _shape(count, dt, count * dt)
        return np.outer(shape, [self.angle(start) / (count * dt), 0.0, 0.0])


@dataclass(frozen=True)
class SpeedChange:
    """Change to a speed [m/s]; the acceleration [m/s²] rises and falls in five seconds each."""

    to: float
    acceleration: float

    def length(self, start: State) -> float:
        """Return the duration of the change [s], including the rise and fall of the acceleration.

        Raises TrajectoryError if the change is impossible.
        """
        if abs(self.to - start.speed) < 1e-9:
            raise TrajectoryError(
                f"already flies at {self.to:g} m/s; to_speed_mps must be another speed"
            )
        return max(abs(self.to - start.speed) / self.acceleration + _RAMP, 2.0 * _RAMP)

    def rates(self, start: State, count: int, dt: float) -> Array:
        """Return rates (count, 3) of heading, speed and climb angle.

        The integral of the acceleration is the change of speed. The other two rates are zero.
        """
        shape = _shape(count, dt, count * dt)
        return np.outer(shape, [0.0, (self.to - start.speed) / (count * dt), 0.0])


@dataclass(frozen=True)
class Climb:
    """Climb or descent from level flight to level flight at another height.

    A small climb is flatter: it does not reach the given climb angle or vertical speed.

    Attributes
    ----------
    by : difference of height, positive upwards [m]; None if ``to`` is given.
    to : final height [m]; None if ``by`` is given.
    angle : climb angle, positive also for a descent [rad]; None if ``vertical_speed`` is given.
    vertical_speed : vertical speed, positive also for a descent [m/s]; None if ``angle`` is given.
    vertical_acceleration : largest vertical acceleration in the pull-up and the push-over [m/s²].
    """

    by: float | None = None
    to: float | None = None
    angle: float | None = None
    vertical_speed: float | None = None
    vertical_acceleration: float = 2.0

    def length(self, start: State) -> float:
        """Return the duration of pull-up, steady climb and push-over [s]."""
        pull_up, steady = self._times(start)
        return 2.0 * pull_up + steady

    def rates(self, start: State, count: int, dt: float) -> Array:
        """Return rates (count, 3) of heading, speed and climb angle.

        The rates of the climb angle give the change of height. The other two rates are zero.

        Raises TrajectoryError if the climb is impossible.
        """
        height = self._height(start)
        pull_up = max(self._times(start)[0], dt)
        middle = (np.arange(count) + 0.5) * dt
        up = np.where(middle < pull_up, 1.0 - np.cos(math.tau * middle / pull_up), 0.0)
        up /= up.sum() * dt
        unit = up - up[::-1]
        shape = _sums(unit, dt)
        if count * dt < pull_up or not shape.max() > 0.0:
            raise TrajectoryError(
                f"climbs within {self.length(start):g} s, which is too short for an IMU interval "
                f"of {dt:g} s"
            )

        def excess(angle: float) -> float:
            return float(start.speed * np.sin(angle * shape).sum() * dt) - height

        reach = math.copysign(0.5 * math.pi, height)
        if excess(reach) * reach < 0.0:
            raise TrajectoryError(
                f"cannot climb {height:g} m in {count * dt:g} s at {start.speed:g} m/s"
            )
        from scipy.optimize import brentq  # not at the top: it loads slowly, and few flights climb

        angle = brentq(excess, 0.0, reach, xtol=1e-15, rtol=1e-14)
        return np.outer(angle * unit, [0.0, 0.0, 1.0])

    def _height(self, start: State) -> float:
        if self.by is not None:
            return self.by
        assert self.to is not None
        height = self.to - float(start.position[2])
        if abs(height) < 1e-3:
            raise TrajectoryError(
                f"already flies at {self.to:g} m; to_height_m must be another height"
            )
        return height

    def _times(self, start: State) -> tuple[float, float]:
        """Return the durations of the pull-up (equal to the push-over) and the steady climb [s]."""
        require_level(start)
        height, speed = abs(self._height(start)), speed_of(start)
        if self.angle is not None:
            angle = self.angle
        else:
            assert self.vertical_speed is not None
            if self.vertical_speed > 0.9 * speed:
                raise TrajectoryError(
                    f"vertical_speed_mps is {self.vertical_speed:g} and must not exceed 0.9 times "
                    f"the initial speed of the segment, {speed:g} m/s"
                )
            angle = math.asin(self.vertical_speed / speed)

        def pull_up(angle: float) -> float:
            # The peak of the raised cosine is twice the mean rate.
            return max(2.0 * speed * angle / self.vertical_acceleration, _SHORTEST_PULL_UP)

        phase = (np.arange(64) + 0.5) / 64.0
        ramp = phase - np.sin(math.tau * phase) / math.tau

        def gain(angle: float) -> float:
            return 2.0 * speed * pull_up(angle) * float(np.sin(angle * ramp).mean())

        if gain(angle) > height:
            from scipy.optimize import brentq

            return pull_up(brentq(lambda a: gain(a) - height, 0.0, angle)), 0.0
        return pull_up(angle), (height - gain(angle)) / (speed * math.sin(angle))


def plan(
    start: State, manoeuvres: Sequence[Manoeuvre], dt: float, size: int | None = None
) -> tuple[Array, float]:
    """Return the rates of manoeuvres flown one after the other.

    Parameters
    ----------
    start : initial state of the flight.
    manoeuvres : manoeuvres in the order of the flight.
    dt : sampling interval [s].
    size : number of manoeuvres in the scenario file, used in messages only. Manoeuvres beyond this
        number are repetitions.

    Returns
    -------
    Rates (N, 3) of heading, speed and climb angle at the middle of each interval, and the duration
    before rounding to whole intervals [s].

    Raises
    ------
    TrajectoryError
        If a manoeuvre is impossible; the message states which one and why.
    """
    parts: list[Array] = []
    total, samples, state = 0.0, 0, start
    for number, manoeuvre in enumerate(manoeuvres):
        try:
            total += manoeuvre.length(state)
            if total > LONGEST_FLIGHT:
                raise TrajectoryError(
                    f"ends after {total:.3g} s; a flight may last {LONGEST_FLIGHT:g} s at most"
                )
            # Ends are rounded, not lengths: rounding errors of many segments do not add up.
            count = max(round(total / dt) - samples, 1)
            parts.append(manoeuvre.rates(state, count, dt))
        except TrajectoryError as error:
            raise TrajectoryError(f"{_place(number, size)}: {error}") from None
        samples += count
        if number + 1 < len(manoeuvres):
            state = end_of(state, parts[-1], dt)
    return np.concatenate(parts), total


def sample(start: State, rates: Array, dt: float) -> tuple[Array, Array, Array]:
    """Return heading, speed and climb angle (N + 1,) at the samples.

    The flight has N sampling intervals of length ``dt`` [s], and a sample at each end of an
    interval. ``rates`` (N, 3) are the rates at the middles of the intervals. They are integrated
    from the values in ``start``.
    """
    heading, speed, climb = (
        first + _sums(rates[:, i], dt)
        for i, first in enumerate((start.heading, start.speed, start.climb))
    )
    return heading, speed, climb


def enu(heading: Array, speed: Array, climb: Array) -> Array:
    """Return velocities (N, 3), ENU [m/s], from headings, speeds and climb angles (N,).

    Units are rad, m/s and rad.
    """
    return np.stack(
        [
            speed * np.cos(climb) * np.sin(heading),
            speed * np.cos(climb) * np.cos(heading),
            speed * np.sin(climb),
        ],
        axis=-1,
    )


@compiled
def follow(position: Array, velocities: Array, dt: float) -> Array:
    """Integrate velocities (N, 3), ENU [m/s], to positions (N, 3) [rad, rad, m].

    The integration rule is that of the mechanization. ``position`` (3,) is the first position.
    """
    positions = np.empty((velocities.shape[0], 3))
    for i in range(3):
        positions[0, i] = position[i]
    for n in range(1, velocities.shape[0]):
        advance_position(positions[n - 1], velocities[n - 1], velocities[n], dt, positions[n])
    return positions


def end_of(start: State, rates: Array, dt: float) -> State:
    """Return the state at the end of a manoeuvre with rates (N, 3)."""
    heading, speed, climb = sample(start, rates, dt)
    positions = follow(start.position, enu(heading, speed, climb), dt)
    return State(positions[-1], float(heading[-1]), float(speed[-1]), float(climb[-1]))


def _place(number: int, size: int | None) -> str:
    if size is None or number < size:
        return f"trajectory.segment[{number}]"
    return f"trajectory.segment[{number % size}] (repetition {number // size + 1})"


def _sums(rate: Array, dt: float) -> Array:
    return np.concatenate([[0.0], np.cumsum(rate) * dt])


def _shape(count: int, dt: float, duration: float) -> Array:
    """Return weights (count,) of mean 1 that rise from zero and fall to zero as raised cosines."""
    middle = (np.arange(count) + 0.5) * dt
    ramp = min(_RAMP, 0.5 * duration)
    edge = np.minimum(middle, count * dt - middle)
    shape = np.where(edge < ramp, 0.5 * (1.0 - np.cos(math.pi * edge / ramp)), 1.0)
    return np.asarray(shape / shape.mean())


def speed_of(start: State) -> float:
    """Return the speed of a state [m/s].

    Raises TrajectoryError if the speed is zero.
    """
    if start.speed < 1e-3:
        raise TrajectoryError(f"needs a speed above 0, but begins at {start.speed:g} m/s")
    return start.speed


def require_level(start: State) -> None:
    """Raise TrajectoryError if the climb angle of a state is not zero."""
    if abs(start.climb) > 1e-6:
        raise TrajectoryError(
            "must begin in level flight, but its initial climb angle is "
            f"{math.degrees(start.climb):g}°"
        )
