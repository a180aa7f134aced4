"""Survey lines joined to one flight by artificial turns, in order of time.

An artificial turn consists of a straight piece, a turn, a connecting leg, a turn to the same side,
and a straight piece. The length of this path is a mean speed times the time between the two lines.
The mean is that of two speeds: at the end of the first line and at the start of the second. There
are no measurements in turns.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from ..gravity.ellipsoid import metres_per_radian
from .manoeuvres import Array, TrajectoryError
from .survey_lines import SurveyLine

_ENDS = 5
"""Number of samples for the mean velocity at the end of a line."""
_FINE = 4001
"""Number of points of a path."""
_RADIUS_M, _TIGHTEST_M = 1000.0, 200.0
"""Usual and smallest radius of turns [m]."""
_HALVINGS = 50
_TIMING = 1e-3
_AXES = ("latitude_deg", "longitude_deg", "height_m")


def all_lines(lines: Sequence[SurveyLine]) -> SurveyLine:
    """Join survey lines, in order of time, to one line with artificial turns between them.

    Measurements in the turns are NaN.

    Raises TrajectoryError if lines overlap in time, if their sampling intervals differ, or if the
    time between two lines does not allow a turn.
    """
    ordered = sorted(lines, key=lambda line: float(line.places["time_s"][0]))
    parts = ordered[:1]
    for before, after in pairwise(ordered):
        parts += [_turn(before, after), after]

    def joined(tables: Sequence[Mapping[str, Array]]) -> dict[str, Array]:
        return {key: np.concatenate([table[key] for table in tables]) for key in tables[0]}

    first, last = ordered[0], ordered[-1]
    return SurveyLine(
        f"{first.name} to {last.name}",
        first.kind,
        first.row,
        joined([part.places for part in parts]),
        joined([part.readings for part in parts]),
    )


def _turn(before: SurveyLine, after: SurveyLine) -> SurveyLine:
    """Return the artificial turn between two lines as a line without measurements."""
    name, step = f"the turn from line {before.name} to line {after.name}", before.interval
    ended = float(before.places["time_s"][-1])
    time = float(after.places["time_s"][0]) - ended
    count = round(time / step)
    if count < 2 or max(abs(count * step - time), abs(after.interval - step)) > _TIMING:
        raise TrajectoryError(
            f"{name} lasts {time:g} s and must last a whole number of sampling intervals of "
            f"{step:g} s, at least 2; both lines must have the same interval"
        )
    origin = np.array([before.places[key][-1] for key in _AXES])
    north, east = metres_per_radian(np.array([math.radians(origin[0]), 0.0, origin[2]]))
    scale = np.array([math.radians(north), math.radians(east), 1.0])
    tail, head = (
        (np.stack([line.places[key][rows] for key in _AXES], axis=-1) - origin) * scale
        for line, rows in ((before, slice(-_ENDS, None)), (after, slice(_ENDS)))
    )
    leaving, coming = ((ends[-1] - ends[0]) / ((_ENDS - 1) * step) for ends in (tail, head))
    speeds = math.hypot(*leaving[:2]), math.hypot(*coming[:2])
    length = 0.5 * (speeds[0] + speeds[1]) * time
    headings = [math.atan2(velocity[1], velocity[0]) for velocity in (leaving, coming)]
    curve = _curve_of(
        length, _Curve(tail[-1, :2], head[0, :2], headings[0], headings[1], 0.0, _RADIUS_M)
    )
    if curve is None:
        raise TrajectoryError(
            f"{name} cannot be flown: the vehicle moves {length:.0f} m in {time:g} s, but turns of "
            f"at least {_TIGHTEST_M:g} m radius need a longer path. Check the times of both lines, "
            "or omit one of them"
        )
    # The speed changes evenly from that of the one end to that of the other, so does the height.
    share = np.arange(1, count) / count
    flown = (speeds[0] * share + 0.5 * (speeds[1] - speeds[0]) * share**2) * time
    points = np.column_stack([curve.points(flown * curve.length / length), share * head[0, 2]])
    places = dict(zip(_AXES, (origin + points / scale).T, strict=True))
    places["time_s"] = ended + step * np.arange(1, count)
    nothing = {key: np.full(count - 1, np.nan) for key in before.readings}
    return SurveyLine(name, before.kind, before.row, places, nothing)


@dataclass(frozen=True)
class _Curve:
    """Path between two points (2,) [m] with given headings at both [rad, from the first axis].

    The path is a straight piece, a turn, a connecting leg, a turn to the same side, and a straight
    piece.
    """

    start: Array
    end: Array
    leaving: float
    coming: float
    straight: float
    radius: float

    @cached_property
    def _turns(self) -> tuple[float, float, float, float]:
        """Side, first angle, length of the connecting leg, and last angle of the shorter path."""
        ways = []
        for side in (1.0, -1.0):
            centres = [
                point
                + sign * self.straight * _unit(heading)
                + self.radius * _unit(heading + 0.5 * side * math.pi)
                for point, heading, sign in (
                    (self.start, self.leaving, 1.0),
                    (self.end, self.coming, -1.0),
                )
            ]
            across = centres[1] - centres[0]
            over = math.atan2(across[1], across[0])
            first = side * (over - self.leaving) % math.tau
            last = side * (self.coming - over) % math.tau
            ways.append((side, first, math.hypot(*across), last))
        return min(ways, key=lambda way: self.radius * (way[1] + way[3]) + way[2])

    @property
    def length(self) -> float:
        """Length of the path [m]."""
        _, first, between, last = self._turns
        return 2.0 * self.straight + self.radius * (first + last) + between

    def points(self, at: Array) -> Array:
        """Return the points (N, 2) of the path at distances (N,) from the start [m]."""
        side, first, between, last = self._turns
        fine = np.linspace(0.0, self.length, _FINE)
        start = self.straight + self.radius * first + between
        turned = np.clip(fine - self.straight, 0.0, self.radius * first)
        turned += np.clip(fine - start, 0.0, self.radius * last)
        heading = self.leaving + side * turned / self.radius
        middle = 0.5 * (heading[1:] + heading[:-1])
        steps = fine[1] * np.stack([np.cos(middle), np.sin(middle)], axis=-1)
        path = self.start + np.vstack([np.zeros(2), np.cumsum(steps, axis=0)])
        # What the sum has rounded is spread over the way.
        path += np.linspace(0.0, 1.0, _FINE)[:, np.newaxis] * (self.end - path[-1])
        return np.stack([np.interp(at, fine, path[:, axis]) for axis in range(2)], axis=-1)


def _curve_of(length: float, curve: _Curve) -> _Curve | None:
    """Return a path with a given length [m]; None if it is impossible.

    The straight pieces are lengthened, or the turns are tightened.
    """
    while curve.length > length:
        curve = replace(curve, radius=0.8 * curve.radius)
        if curve.radius < _TIGHTEST_M:
            return None
    low, high = 0.0, length
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (
            (middle, high) if replace(curve, straight=middle).length < length else (low, middle)
        )
    return replace(curve, straight=low)


def _unit(heading: float) -> Array:
    return np.array([math.cos(heading), math.sin(heading)])
