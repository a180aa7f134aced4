"""Margins between a flight and the limits of a map, compared with the INS error."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from ..campaign.records import BORDER
from ..figures.numbers import short, some
from ..gravity.ellipsoid import metres_along
from ..gravity.field import Field
from ..gravity.meridians import turns
from ..simulation.ins_error import InsError
from ..spec.aiding import BarometerSpec, GnssSpec
from ..spec.case import CaseSpec
from ..trajectory.truth import Trajectory

DEVIATIONS = 3.0
"""Required margin of a map around a flight, in standard deviations of the INS error."""
SIDES = ("south", "north", "west", "east")


@dataclass(frozen=True)
class Bounds:
    """Limits of a map.

    Attributes
    ----------
    lower, upper : (3,) latitude, longitude [rad] and height [m]; in a draped map the height above
        the base surface.
    step : (3,) distance between neighbouring nodes [rad, rad, m].
    field : gravity field of the map, with its base surface. If the map is not built yet, this is
        the normal field, and the map counts as level.
    """

    lower: np.ndarray
    upper: np.ndarray
    step: np.ndarray
    field: Field = dataclasses.field(default_factory=Field.normal)

    @property
    def with_border(self) -> Bounds:
        """Limits enlarged by the border that still counts as inside."""
        room = BORDER * self.step
        return dataclasses.replace(self, lower=self.lower - room, upper=self.upper + room)

    @property
    def finite(self) -> bool:
        """Whether there is a map."""
        return bool(np.isfinite([self.lower, self.upper]).all())


@dataclass(frozen=True)
class Margin:
    """Least distances of a flight from the limits of a map.

    Attributes
    ----------
    border : least distance to a side of the map [m].
    side : name of this side.
    below, above : least distances to the lowest and to the highest layer of nodes [m].
    lowest : height of the lowest layer above the base surface [m]; None for a level map.
    """

    border: float
    side: str
    below: float
    above: float
    lowest: float | None = None

    @property
    def least(self) -> float:
        """Least of all distances [m]; negative outside the map."""
        return min(self.border, self.below, self.above)


@dataclass(frozen=True)
class Shortfall:
    """A margin inside a map that is too narrow for the INS error.

    Attributes
    ----------
    side : ``south``, ``north``, ``west``, ``east``, ``below`` or ``above``.
    margin, needed : actual and required margin [m].
    time : time of the largest shortfall [s].
    """

    side: str
    margin: float
    needed: float
    time: float


def distances(
    trajectory: Trajectory, bounds: Bounds, samples: np.ndarray | slice = slice(None)
) -> dict[str, np.ndarray]:
    """Return the distances [m] of a flight from the limits of a map, by name of the limit.

    Each array (K,) contains the distances at the K chosen ``samples``. Keys are ``south``,
    ``north``, ``west``, ``east``, ``below`` (lowest layer) and ``above`` (highest layer). Distances
    are negative outside the map.
    """
    lower, upper, positions = bounds.lower, bounds.upper, trajectory.positions[samples]
    turn = turns(0.5 * (lower[1] + upper[1]), trajectory.positions[0, 1], math.tau)
    metres = metres_along(positions)
    heights = bounds.field.coordinates(positions - np.array([0.0, turn, 0.0]))[:, 2]
    return {
        "south": (positions[:, 0] - lower[0]) * metres[:, 1],
        "north": (upper[0] - positions[:, 0]) * metres[:, 1],
        "west": (positions[:, 1] - lower[1] - turn) * metres[:, 0],
        "east": (upper[1] + turn - positions[:, 1]) * metres[:, 0],
        "below": heights - lower[2],
        "above": upper[2] - heights,
    }


def margin_of(trajectory: Trajectory, bounds: Bounds) -> Margin:
    """Return the least distances of a flight from the limits of a map."""
    least = {
        side: float(distance.min()) for side, distance in distances(trajectory, bounds).items()
    }
    side = min(SIDES, key=lambda each: least[each])
    lowest = float(bounds.lower[2]) if bounds.field.is_draped else None
    return Margin(least[side], side, least["below"], least["above"], lowest)


def shortfalls(
    case: CaseSpec, trajectory: Trajectory, bounds: Bounds, error: InsError
) -> tuple[Shortfall, ...]:
    """Return the shortfalls of the margins inside a map: at most one horizontal and one vertical.

    The required margin is three standard deviations of the INS error. Of the four sides the largest
    shortfall is returned, and likewise of the lowest and highest layers. With GNSS positions
    no margin counts as too narrow. With a barometer no height margin counts as too narrow.
    """
    aided: set[str] = set()
    for sensor in case.side("truth").sensor.values():
        if isinstance(sensor, BarometerSpec):
            aided.add("up")
        if isinstance(sensor, GnssSpec) and sensor.position_noise_m is not None:
            aided.update(("horizontal", "up"))
    deviations = {
        **dict.fromkeys(("west", "east"), error.deviations[:, 0]),
        **dict.fromkeys(("south", "north"), error.deviations[:, 1]),
        **dict.fromkeys(("below", "above"), error.deviations[:, 2]),
    }
    plain = distances(trajectory, bounds, error.samples)
    with_border = distances(trajectory, bounds.with_border, error.samples)
    worst = []
    for axis, sides in (("horizontal", SIDES), ("up", ("below", "above"))):
        missing = {
            # Where the flight itself leaves the map, as in a turn between lines, none is needed.
            side: np.where(
                plain[side] < 0.0, 0.0, DEVIATIONS * deviations[side] - with_border[side]
            )
            for side in sides
        }
        side = max(sides, key=lambda each: float(missing[each].max()))
        at = int(missing[side].argmax())
        if axis not in aided and missing[side][at] > 0.0:
            needed = DEVIATIONS * float(deviations[side][at])
            worst.append(Shortfall(side, float(plain[side][at]), needed, float(error.times[at])))
    return tuple(worst)


def narrow_margins(margins: Iterable[tuple[str, tuple[Shortfall, ...]]]) -> Iterator[str]:
    """Yield a sentence for each of the six limits of a map at which a case has a shortfall.

    The sentence describes the largest shortfall at this limit. ``margins`` has the name of each
    case and the shortfalls of this case.
    """
    of_side: dict[str, list[tuple[str, Shortfall]]] = {}
    for name, short_of in margins:
        for each in short_of:
            of_side.setdefault(each.side, []).append((name, each))
    for side, cases in of_side.items():
        _, worst = max(cases, key=lambda pair: pair[1].needed - pair[1].margin)
        where = {
            "below": "above the lowest height of its map",
            "above": "below the highest height of its map",
        }.get(side, f"from the {side} border of its map")
        names = some([name for name, _ in cases], most=3)
        yield (
            f"in {names}, {worst.time:.0f} s after the start, the flight is "
            f"{length(worst.margin)} {where}; {DEVIATIONS:g} standard deviations of the INS error "
            f"are {length(worst.needed)}. Estimates may leave the map; outside it the values "
            "of its border are used"
        )


def length(metres: float) -> str:
    """Return a length as text with unit, in kilometres from 10 km on."""
    return f"{short(metres / 1e3)} km" if abs(metres) >= 1e4 else f"{metres:.0f} m"
