"""Terrain-following flights within a draped map, for ``ggbench new``."""

from __future__ import annotations

import json
import math
import tomllib
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import GGBenchError

if TYPE_CHECKING:
    from ..maps.netcdf import Nodes

_DURATION_S = 130.0
_SPEEDS_MPS = (60.0, 20.0)
"""Usual speed, and a slow one, which follows the ground more closely."""
_LEAST_SHARE = 0.4
"""Least ratio of the lowest layer to the clearance; lower layers need much denser nodes."""
_SHARE = 0.8
"""Largest share of the map's shorter side that a flight covers."""
_ROOM_M = 20.0
"""Margin to the lowest and highest layer: three standard deviations of a barometer's error."""
_HEADINGS = (90.0, 0.0, 45.0, 135.0, 270.0, 180.0, 225.0, 315.0)
_STEP_S = 0.1


class NewFileError(GGBenchError):
    """A file of ``ggbench new`` cannot be created."""


def quoted(path: Path) -> str:
    """Return a path as a quoted TOML string."""
    return json.dumps(path.as_posix(), ensure_ascii=False)


def draped_flight(
    nodes: Nodes,
    attributes: Mapping[str, str],
    own_map: Path,
    terrain: Path,
    clearance: float,
    at_most: Callable[[float, float, str], float],
) -> str:
    """Return a ``[trajectory]`` table: a straight terrain-following flight in a draped map.

    The flight crosses the middle of the map. Eight headings are tried in a fixed order, until the
    flight stays between the lowest and the highest layer. The required margin to these layers is
    three standard deviations of a barometer's error.

    Parameters
    ----------
    nodes, attributes : nodes and attributes of the map.
    own_map, terrain : paths of the map and of the terrain.
    clearance : least height above the terrain [m].
    at_most : function that returns the speed [m/s], given the largest possible speed, the usual
        speed, and the reason for the limit in words.

    Raises
    ------
    NewFileError
        If no heading is suitable; the message states the required layers.
    TrajectoryError
        If the terrain cannot be read or does not cover the map.
    """
    room = f"a flight of {_DURATION_S:g} s may cover at most {_SHARE:g} of the map's shorter side"
    speed = at_most(_fastest(nodes), _SPEEDS_MPS[0], room)
    lowest, highest = float(nodes.height_m[0]), float(nodes.height_m[-1])
    needed = []
    geoid_height = geoid_height_of(attributes)
    for table, low, high in _flights(nodes, terrain, clearance, speed, geoid_height):
        if lowest + _ROOM_M <= low and high <= highest - _ROOM_M:
            return table
        needed.append((low, high))
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


def needed_layers(
    nodes: Nodes, terrain: Path, clearance: float, geoid_height: float
) -> tuple[float, float]:
    """Return the lowest and the highest layer [m] that flights over a draped map need.

    The flights follow the terrain on eight straight headings through the middle of the map, each at
    the usual and at a slow speed. They stay between the two layers. The margin is three standard
    deviations of a barometer's error.

    Parameters
    ----------
    nodes : nodes with a base surface; their layers are ignored.
    terrain : path of the terrain.
    clearance : least height above the terrain [m].
    geoid_height : height of the terrain's zero level above the ellipsoid [m].

    Raises
    ------
    TrajectoryError
        If the terrain cannot be followed.
    """
    fastest = _fastest(nodes)
    heights = [
        height
        for speed in _SPEEDS_MPS
        for _, *ends in _flights(nodes, terrain, clearance, min(speed, fastest), geoid_height)
        for height in ends
    ]
    lowest = max(math.floor(min(heights) - _ROOM_M), math.ceil(_LEAST_SHARE * clearance))
    return float(lowest), float(math.ceil(max(heights) + _ROOM_M))


def _middle(nodes: Nodes) -> tuple[float, float]:
    """Return latitude and longitude of the middle of a map [deg]."""
    lat, lon = nodes.latitude_deg, nodes.longitude_deg
    return 0.5 * float(lat[0] + lat[-1]), 0.5 * float(lon[0] + lon[-1])


def _metres_per_degree(latitude_deg: float) -> tuple[float, float]:
    """Return the lengths [m] of a degree to the north and of a degree to the east."""
    import numpy as np  # not at the top: --help loads no numbers

    from ..gravity.ellipsoid import metres_per_radian

    north, east = metres_per_radian(np.array([math.radians(latitude_deg), 0.0, 0.0]))
    return math.radians(1.0) * north, math.radians(1.0) * east


def _fastest(nodes: Nodes) -> float:
    """Return the speed [m/s] at which a flight covers its largest share of the map."""
    per_north, per_east = _metres_per_degree(_middle(nodes)[0])
    lat, lon = nodes.latitude_deg, nodes.longitude_deg
    side = min(float(lat[-1] - lat[0]) * per_north, float(lon[-1] - lon[0]) * per_east)
    return _SHARE * side / _DURATION_S


def _flights(
    nodes: Nodes, terrain: Path, clearance: float, speed: float, geoid_height: float | None
) -> Iterator[tuple[str, float, float]]:
    """Yield the table of a flight on each heading, with its least and largest height [m].

    The heights are above the base surface of the nodes. ``geoid_height`` [m] is the height of the
    terrain's zero level above the ellipsoid, or None.
    """
    import numpy as np  # not at the top: --help loads no numbers
    from scipy.interpolate import RegularGridInterpolator

    from ..simulation.true_motion import trajectory_of
    from ..spec.trajectory import TrajectorySpec

    assert nodes.base_m is not None
    middle = _middle(nodes)
    per_north, per_east = _metres_per_degree(middle[0])
    axes = nodes.latitude_deg, nodes.longitude_deg
    base = RegularGridInterpolator(axes, nodes.base_m, bounds_error=False, fill_value=None)
    back = 0.5 * _DURATION_S * speed
    zero_level = f"geoid_height_m = {geoid_height:g}    # as in the map\n" if geoid_height else ""
    for heading in _HEADINGS:
        south = back * math.cos(math.radians(heading)) / per_north
        west = back * math.sin(math.radians(heading)) / per_east
        table = (
            f"latitude_deg = {middle[0] - south:.5f}\nlongitude_deg = {middle[1] - west:.5f}\n"
            "# Without height_m the flight starts just high enough above the terrain.\n"
            f"speed_mps = {speed:.3g}\nheading_deg = {heading:.1f}    # clockwise from north\n\n"
            '[[trajectory.segment]]\nkind = "terrain-following"\n'
            f"terrain = {quoted(terrain)}\n"
            f"clearance_m = {clearance:g}    # above the ground, at least\n"
            f"{zero_level}duration_s = {_DURATION_S:g}\n"
        )
        spec = TrajectorySpec.model_validate(tomllib.loads(f"[trajectory]\n{table}")["trajectory"])
        flown = trajectory_of(spec, _STEP_S).positions
        above = flown[:, 2] - base(np.degrees(flown[:, :2]))
        yield table, float(above.min()), float(above.max())


def geoid_height_of(attributes: Mapping[str, str]) -> float | None:
    """Return the geoid height [m] that a map states for its terrain; None if it states none."""
    try:
        height = float(json.loads(attributes.get("parameters", "{}"))["geoid_height_m"])
    except (ValueError, KeyError, TypeError):
        return None
    return height if math.isfinite(height) else None
