"""Flights through waypoints: a turn towards each waypoint, then a straight leg."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..gravity.ellipsoid import metres_along
from .manoeuvres import Array, State, TrajectoryError, Turn, end_of, require_level, speed_of

_STEP = 0.1
"""Sampling interval for the duration of a turn, before the interval of the flight is known [s]."""
_MOST_STEPS, _SMALL = 50, 1e-9
"""Largest number of iterations for the turn angle, and its tolerance [rad]."""
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(8)


@dataclass(frozen=True)
class Waypoint:
    """Shorter turn towards a waypoint, then a straight level leg at constant speed.

    The leg ends at most a tenth of a second of flight before or after the waypoint.

    Attributes
    ----------
    latitude, longitude : position of the waypoint [rad].
    bank, rate, radius : bank angle [rad], turn rate [rad/s] or radius [m] of the turn; two of the
        three are None, see :class:`.Turn`.
    """

    latitude: float
    longitude: float
    bank: float | None = None
    rate: float | None = None
    radius: float | None = None

    def length(self, start: State) -> float:
        """Return the duration of the turn and the straight leg [s]."""
        turned, end = self._turned(start, _STEP)
        return _STEP * len(turned) + self._ahead(end)[1] / speed_of(start)

    def rates(self, start: State, count: int, dt: float) -> Array:
        """Return rates (count, 3) of heading, speed and climb angle.

        Only the heading rate differs from zero, and only in the turn.
        """
        rates = np.zeros((count, 3))
        turned = self._turned(start, dt)[0][:count]
        rates[: len(turned)] = turned
        return rates

    def _turned(self, start: State, dt: float) -> tuple[Array, State]:
        """Return the rates of the turn towards the waypoint, and the state at its end.

        The turn moves the aircraft, so its angle is found by iteration.
        """
        require_level(start)
        speed_of(start)
        end, rates, angle = start, np.zeros((0, 3)), 0.0
        for _ in range(_MOST_STEPS):
            heading, distance = self._ahead(end)
            missing = math.remainder(heading - end.heading, math.tau)
            if abs(missing) < _SMALL or distance < speed_of(start) * dt:
                return rates, end
            angle += missing
            if abs(angle) > math.tau:
                break
            turn = Turn(by=angle, bank=self.bank, rate=self.rate, radius=self.radius)
            rates = turn.rates(start, max(round(turn.length(start) / dt), 1), dt)
            end = end_of(start, rates, dt)
        raise TrajectoryError(
            f"the waypoint is {self._ahead(start)[1]:.0f} m away, too close for the turn towards "
            "it; fly slower, bank more, or remove it"
        )

    def _ahead(self, state: State) -> tuple[float, float]:
        return leg(state.position, self.latitude, self.longitude)


def leg(position: Array, latitude: float, longitude: float) -> tuple[float, float]:
    """Return heading [rad] and length [m] of the rhumb line to a waypoint.

    The line is level and begins at ``position`` (3,): latitude, longitude [rad] and height [m]. The
    heading α satisfies tan α = Δλ / ∫ (M + h) / ((N + h) cos φ) dφ. The length is ∫ (M + h) dφ /
    cos α (Williams 1998, Geometry of Navigation). φ is the latitude, λ the longitude, h the height.
    M and N are the radii of curvature in the meridian and in the prime vertical.
    """
    north = latitude - position[0]
    east = math.remainder(longitude - position[1], math.tau)
    between = np.full((len(_NODES), 3), position[2])
    between[:, 0] = position[0] + 0.5 * north * (1.0 + _NODES)
    per_east, per_north = metres_along(between).T
    stretch = float(0.5 * _WEIGHTS @ (per_north / per_east))
    length = float(0.5 * _WEIGHTS @ per_north)
    heading = math.atan2(east, north * stretch)
    return heading, length / stretch * math.hypot(east, north * stretch)
