"""Tables of flight segments."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from pydantic import Field, model_validator

from ..trajectory.manoeuvres import Climb, Cruise, Manoeuvre, Segment, SpeedChange, Turn
from ..trajectory.terrain_following import TerrainFollowing
from ..trajectory.waypoints import Waypoint
from . import quantities as q
from .tables import Section

Kind = Literal["rates", "cruise", "climb", "turn", "speed", "waypoint", "terrain-following"]
_STEEPNESS = ("bank_deg", "turn_rate_deg_per_s", "radius_m")
_CHOICES: dict[str, tuple[tuple[str, ...], ...]] = {
    "rates": (("duration_s",),),
    "cruise": (("duration_s", "distance_km"),),
    "climb": (("to_height_m", "by_height_m"), ("climb_angle_deg", "vertical_speed_mps")),
    "turn": (("to_heading_deg", "by_heading_deg"), _STEEPNESS),
    "speed": (("to_speed_mps",), ("acceleration_mps2",)),
    "waypoint": (("latitude_deg",), ("longitude_deg",), _STEEPNESS),
    "terrain-following": (("terrain",), ("clearance_m",), ("duration_s", "distance_km")),
}
"""Groups of keys; a kind of segment needs exactly one key of each of its groups."""
_OPTIONS: dict[str, tuple[str, ...]] = {
    "rates": ("turn_rate_deg_per_s", "acceleration_mps2", "climb_rate_deg_per_s"),
    "cruise": (),
    "climb": ("max_vertical_acceleration_mps2",),
    "turn": ("direction",),
    "speed": (),
    "waypoint": (),
    "terrain-following": (
        "geoid_height_m",
        "lowest_m",
        "max_climb_angle_deg",
        "max_vertical_acceleration_mps2",
    ),
}
"""Further keys that a kind of segment may have."""


class SegmentSpec(Section):
    """``[[trajectory.segment]]``: a segment of the flight; segments are flown in order."""

    kind: Kind = "rates"
    """Manoeuvre; it determines the other keys of the segment."""
    duration_s: q.Duration | None = None
    """`rates`, `cruise`, `terrain-following`: duration. The last two also accept `distance_km`."""
    distance_km: q.Kilometres | None = None
    """`cruise`, `terrain-following`: distance; or give `duration_s`."""
    turn_rate_deg_per_s: q.AngularRate = 0.0
    """`rates`: rate, positive to the right; `turn`, `waypoint`: positive; or give `bank_deg`."""
    acceleration_mps2: q.Acceleration = 0.0
    """`rates`: acceleration along the path; `speed`: magnitude of the acceleration."""
    climb_rate_deg_per_s: q.AngularRate = 0.0
    """`rates`: rate of the climb angle."""
    to_height_m: q.Height | None = None
    """`climb`: height to reach; or give `by_height_m`."""
    by_height_m: q.HeightDifference | None = None
    """`climb`: difference of height, positive upwards; or give `to_height_m`."""
    climb_angle_deg: q.Incline | None = None
    """`climb`: angle; or give `vertical_speed_mps`."""
    vertical_speed_mps: q.VerticalSpeed | None = None
    """`climb`: vertical speed; or give `climb_angle_deg`."""
    max_vertical_acceleration_mps2: q.LargestAcceleration = 2.0
    """`climb`, `terrain-following`: largest vertical acceleration."""
    to_heading_deg: q.Angle | None = None
    """`turn`: heading to reach; or give `by_heading_deg`."""
    by_heading_deg: q.Turns | None = None
    """`turn`: angle, positive to the right; or give `to_heading_deg`."""
    direction: Literal["left", "right", "shorter"] = "shorter"
    """`turn` with `to_heading_deg`: direction of the turn."""
    bank_deg: q.Bank | None = None
    """`turn`, `waypoint`: bank angle; or give `turn_rate_deg_per_s` or `radius_m`."""
    radius_m: q.Radius | None = None
    """`turn`, `waypoint`: radius; or give `turn_rate_deg_per_s` or `bank_deg`."""
    to_speed_mps: q.Speed | None = None
    """`speed`: speed to reach."""
    latitude_deg: q.Latitude | None = None
    """`waypoint`: latitude of the point. The vehicle turns towards it and flies straight to it."""
    longitude_deg: q.Longitude | None = None
    """`waypoint`: longitude of the point."""
    terrain: Annotated[str, Field(min_length=1)] | None = None
    """`terrain-following`: path of an elevation model, or `jacksboro_dem_3arcsec.npz` (shipped)."""
    clearance_m: q.Clearance | None = None
    """`terrain-following`: least height above the terrain."""
    geoid_height_m: q.HeightDifference = 0.0
    """`terrain-following`: height of the zero level of the terrain above the ellipsoid."""
    lowest_m: q.Height | None = None
    """`terrain-following`: lowest height above the ellipsoid. Without it: no limit."""
    max_climb_angle_deg: q.InclineLimit = 10.0
    """`terrain-following`: largest climb angle."""

    @model_validator(mode="after")
    def _check(self) -> SegmentSpec:
        keys = keys_given(self) - {"kind"}
        kind = f'a segment of kind "{self.kind}"'
        groups = _CHOICES[self.kind]
        allowed = {key for group in groups for key in group} | {*_OPTIONS[self.kind]}
        for group in groups:
            chosen = [key for key in group if key in keys]
            if len(chosen) != 1:
                demand = f"'{group[0]}'" if len(group) == 1 else f"exactly one of {_list(group)}"
                raise ValueError(
                    f"{kind} needs {demand}, found {_list(chosen) if chosen else 'none'}"
                )
        if keys - allowed:
            named = '; other kinds have a line kind = "..."' if self.kind == "rates" else ""
            raise ValueError(
                f"{kind} has no key '{min(keys - allowed)}'; its keys: "
                f"{_list(sorted(allowed))}{named}"
            )
        if self.kind == "turn":
            if "direction" in keys and self.to_heading_deg is None:
                raise ValueError(
                    "direction is allowed only with to_heading_deg; the sign of by_heading_deg "
                    "gives the direction, positive to the right"
                )
            if self.by_heading_deg == 0.0:
                raise ValueError(
                    "by_heading_deg must not be 0: it is the change of heading, positive to the "
                    "right"
                )
        turns = self.kind in ("turn", "waypoint") and "turn_rate_deg_per_s" in keys
        if turns and not self.turn_rate_deg_per_s > 0.0:
            sign = "; the sign of by_heading_deg gives the direction" if self.kind == "turn" else ""
            raise ValueError(
                f"turn_rate_deg_per_s is {self.turn_rate_deg_per_s:g} and must be positive in "
                f"{kind}{sign}"
            )
        if self.kind == "speed" and not self.acceleration_mps2 > 0.0:
            raise ValueError(
                f"acceleration_mps2 is {self.acceleration_mps2:g} and must be positive in a "
                'segment of kind "speed"; to_speed_mps decides between speeding up and slowing '
                "down"
            )
        if self.by_height_m == 0.0:
            raise ValueError(
                "by_height_m must not be 0: it is the change of height, positive upwards"
            )
        return self

    def manoeuvre(self) -> Manoeuvre:
        """Return the segment as a manoeuvre in SI units."""
        if self.kind == "rates":
            assert self.duration_s is not None
            return Segment(
                self.duration_s,
                math.radians(self.turn_rate_deg_per_s),
                self.acceleration_mps2,
                math.radians(self.climb_rate_deg_per_s),
            )
        if self.kind == "cruise":
            if self.duration_s is not None:
                return Segment(self.duration_s)
            assert self.distance_km is not None
            return Cruise(1e3 * self.distance_km)
        if self.kind == "climb":
            return Climb(
                self.by_height_m,
                self.to_height_m,
                _radians(self.climb_angle_deg),
                self.vertical_speed_mps,
                self.max_vertical_acceleration_mps2,
            )
        if self.kind == "turn":
            return Turn(
                _radians(self.by_heading_deg),
                _radians(self.to_heading_deg),
                {"left": -1, "right": 1, "shorter": 0}[self.direction],
                _radians(self.bank_deg),
                _radians(self.turn_rate_deg_per_s) or None,
                self.radius_m,
            )
        if self.kind == "speed":
            assert self.to_speed_mps is not None
            return SpeedChange(self.to_speed_mps, self.acceleration_mps2)
        if self.kind == "waypoint":
            assert self.latitude_deg is not None and self.longitude_deg is not None
            return Waypoint(
                math.radians(self.latitude_deg),
                math.radians(self.longitude_deg),
                _radians(self.bank_deg),
                _radians(self.turn_rate_deg_per_s) or None,
                self.radius_m,
            )
        assert self.terrain is not None and self.clearance_m is not None
        return TerrainFollowing(
            terrain=self.terrain,
            clearance=self.clearance_m,
            zero_level=self.geoid_height_m,
            lowest=-math.inf if self.lowest_m is None else self.lowest_m,
            duration=self.duration_s,
            distance=None if self.distance_km is None else 1e3 * self.distance_km,
            climb_angle=math.radians(self.max_climb_angle_deg),
            vertical_acceleration=self.max_vertical_acceleration_mps2,
        )


def keys_given(section: Section) -> set[str]:
    """Return the keys of a table whose values differ from the defaults."""
    fields = type(section).model_fields
    return {key for key, field in fields.items() if getattr(section, key) != field.default}


def _radians(degrees: float | None) -> float | None:
    return None if degrees is None else math.radians(degrees)


def _list(keys: tuple[str, ...] | list[str]) -> str:
    return ", ".join(f"'{key}'" for key in keys)
