"""Flights for ``ggbench new`` that follow the ground within a draped map."""

from __future__ import annotations

import json
import math
import tomllib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import GGBenchError

if TYPE_CHECKING:
    from ..maps.netcdf import Nodes

_DURATION_S = 130.0
_SPEED_MPS = 60.0
_SHARE = 0.8
"""Of the map's shorter side, which the flight takes at most."""
_ROOM_M = 20.0
"""To the lowest and the highest layer: three deviations of a barometer's error."""
_HEADINGS = (90.0, 0.0, 45.0, 135.0, 270.0, 180.0, 225.0, 315.0)
_STEP_S = 0.1


class NewFileError(GGBenchError):
    """A new file cannot be created."""


def quoted(path: Path) -> str:
    """Return a path as a string of TOML, which has the syntax of JSON."""
    return json.dumps(path.as_posix(), ensure_ascii=False)


def draped_flight(
    nodes: Nodes,
    attributes: Mapping[str, str],
    own_map: Path,
    terrain: Path,
    clearance: float,
    at_most: Callable[[float, float, str], float],
) -> str:
    """Return the table of a straight flight that follows the ground in the middle of a draped map.

    The heading is the first of eight on which the flight stays inside the map by three standard
    deviations of a barometer.

    Parameters
    ----------
    nodes, attributes : of the map.
    own_map, terrain : files.
    clearance : least height above the terrain [m].
    at_most : returns the speed [m/s], given the largest possible speed, the usual speed, and the
        reason for the limit in words.

    Raises
    ------
    NewFileError
        If no heading is suitable; the message states the required layers.
    TrajectoryError
        If the terrain cannot be read or does not cover the map.
    """
    # Not at the top: --help loads no numbers.
    import numpy as np
    from scipy.interpolate import RegularGridInterpolator

    from ..gravity.ellipsoid import metres_per_radian
    from ..simulation.true_motion import trajectory_of
    from ..spec.trajectory import TrajectorySpec

    assert nodes.base_m is not None
    lat, lon = nodes.latitude_deg, nodes.longitude_deg
    middle = 0.5 * float(lat[0] + lat[-1]), 0.5 * float(lon[0] + lon[-1])
    metres = metres_per_radian(np.array([math.radians(middle[0]), 0.0, 0.0]))
    per_north, per_east = (math.radians(1.0) * length for length in metres)
    side = min(float(np.ptp(lat)) * per_north, float(np.ptp(lon)) * per_east)
    room = f"the flight of {_DURATION_S:g} s takes {_SHARE:g} of the map's shorter side"
    speed = at_most(_SHARE * side / _DURATION_S, _SPEED_MPS, room)
    base = RegularGridInterpolator((lat, lon), nodes.base_m, bounds_error=False, fill_value=None)
    lowest, highest = float(nodes.height_m[0]), float(nodes.height_m[-1])
    needed = []
    for heading in _HEADINGS:
        back = 0.5 * _DURATION_S * speed
        south = back * math.cos(math.radians(heading)) / per_north
        west = back * math.sin(math.radians(heading)) / per_east
        table = (
            f"latitude_deg = {middle[0] - south:.5f}\nlongitude_deg = {middle[1] - west:.5f}\n"
            "# Without height_m the flight starts just high enough above the terrain.\n"
            f"speed_mps = {speed:.3g}\nheading_deg = {heading:.1f}    # clockwise from north\n\n"
            '[[trajectory.segment]]\nkind = "terrain-following"\n'
            f"terrain = {quoted(terrain)}\n"
            f"clearance_m = {clearance:g}    # above the ground, at least\n"
            f"{_zero_level(attributes)}duration_s = {_DURATION_S:g}\n"
        )
        spec = TrajectorySpec.model_validate(tomllib.loads(f"[trajectory]\n{table}")["trajectory"])
        flown = trajectory_of(spec, _STEP_S).positions
        above = flown[:, 2] - base(np.degrees(flown[:, :2]))
        if lowest + _ROOM_M <= above.min() and above.max() <= highest - _ROOM_M:
            return table
        needed.append((float(above.min()), float(above.max())))
    low, high = min(needed, key=lambda each: max(lowest - each[0], each[1] - highest))
    layers = (
        f"--clearance-from {max(math.floor(low - _ROOM_M), 1):g} "
        f"--clearance-to {math.ceil(high + _ROOM_M):g}"
    )
    raise NewFileError(
        f"a flight {clearance:g} m above the ground of {terrain} is {low:.0f} to {high:.0f} m "
        f"above the base of {own_map}, and the map has layers from {lowest:g} to {highest:g} m: "
        f"give another --clearance, or build the map with {layers}"
    )


def _zero_level(attributes: Mapping[str, str]) -> str:
    """Return the line of the geoid's height that a map states of its terrain, if any."""
    height = geoid_height_of(attributes)
    return f"geoid_height_m = {height:g}    # as in the map\n" if height else ""


def geoid_height_of(attributes: Mapping[str, str]) -> float | None:
    """Return the geoid height stated by a map for its terrain [m], or None."""
    try:
        height = float(json.loads(attributes.get("parameters", "{}"))["geoid_height_m"])
    except (ValueError, KeyError, TypeError):
        return None
    return height if math.isfinite(height) else None
