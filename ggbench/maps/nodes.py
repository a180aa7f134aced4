"""Choice of the nodes of a map: a user's request, or defaults derived from the inputs."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from numpy.typing import NDArray

from ..gravity.ellipsoid import SEMI_MAJOR_AXIS
from ..gravity.gradient_map import MapError
from ..gravity.meridians import Area, eastern, turns
from .netcdf import FEWEST_NODES, Nodes

Array = NDArray[np.floating]

EVERYWHERE = np.array([-90.0, 90.0, -360.0, 360.0])
"""Bounds of a global source: south, north, west, east [deg]."""
_MOST_NODES = 400_000_000  # 14 GB of float32
MOST_LAYER_NODES = 10_000_000
"""Largest number of nodes of a layer; three layers are in memory at the same time."""
_BYTES_PER_NODE = 3 * 9 * 8
_MOST_CELLS = 1_000_000  # along an axis
_FEWEST_STEPS = FEWEST_NODES - 1
HIGHEST_M = 1e6
_LAYERS = 9
_SPACING_PER_HEIGHT = 0.25
_NEAR_GROUND = (1.0, 100.0), (0.5, 50.0)
"""Horizontal and vertical node spacings over a terrain: fraction of the height above ground, and
largest spacing [m]. A quarter of the height is always allowed. The interpolation error is 0.02 E
RMS where the gradient is 100 E, and 0.005 E at points 100 m higher."""
_LEAST_REACH_M = 1000.0  # upwards, by default
_WIDEST_HEIGHT_SPACING = 1000.0
_ROUNDING_DEG = 1e-6  # what a bound may lie outside for being typed with few digits


@dataclasses.dataclass(frozen=True)
class GridRequest:
    """Bounds and spacings requested by a user; None: derived from the inputs."""

    south_deg: float | None = None
    north_deg: float | None = None
    west_deg: float | None = None
    east_deg: float | None = None
    lowest_m: float | None = None
    highest_m: float | None = None
    spacing_deg: float | None = None
    height_spacing_m: float | None = None

    @property
    def area(self) -> Area:
        """Requested bounds in latitude and longitude."""
        return Area(self.south_deg, self.north_deg, self.west_deg, self.east_deg)


@dataclasses.dataclass
class SourceExtent:
    """Valid area and heights of a source of the field.

    Attributes
    ----------
    bounds : limits south, north, west, east [deg].
    good : the same limits without the edges, where the field is less accurate.
    floor_m : lowest valid height [m].
    lowest_m : default height of the lowest layer [m].
    sources_m : height of the masses [m]; the distance from the masses limits the node spacing.
    ground : description of the highest ground of a terrain; "" for other sources.
    """

    bounds: Array
    good: Array
    floor_m: float
    lowest_m: float
    sources_m: float
    ground: str = ""


def nodes_for(
    extents: list[SourceExtent], request: GridRequest, drape: tuple[float, float] | None = None
) -> tuple[Nodes, list[str]]:
    """Return nodes within the limits of all sources, and remarks on the choice of nodes.

    ``drape`` contains the heights of the lowest and highest layer of a draped map above its base
    surface [m]. The base surface of the result is not set.

    Raises MapError if the request lies outside the sources or has too many nodes.
    """
    remarks: list[str] = []
    inner = np.array([1.0, -1.0, 1.0, -1.0])  # times a bound: the larger is further inside
    turned = _in_one_turn(extents)
    allowed = inner * np.max([inner * (extent.bounds + turn) for extent, turn in turned], axis=0)
    good = inner * np.max([inner * (extent.good + turn) for extent, turn in turned], axis=0)
    names = ("south", "north", "west", "east")
    for name, value in vars(request).items():
        if value is not None and not math.isfinite(value):
            option = name.removesuffix("_deg").removesuffix("_m").replace("_", "-")
            raise MapError(f"--{option} {value} must be a finite number.")
    _require_degrees(request)
    requested = _counted_alike(request.area, allowed)
    bounds = np.array([g if a is None else a for a, g in zip(requested, good, strict=True)])
    if None in requested and np.array_equal(good, EVERYWHERE):
        raise MapError(
            "coefficients cover the whole Earth: give --south, --north, --west and --east [deg]."
        )
    for name, value, allow, sign in zip(names, bounds, allowed, inner, strict=True):
        if not sign * value >= sign * allow - _ROUNDING_DEG:  # NaN fails too
            raise MapError(
                f"--{name} {value:.9g} lies outside the area of the inputs: {allowed[0]:.9g}° to "
                f"{allowed[1]:.9g}° N, {allowed[2]:.9g}° to {allowed[3]:.9g}° E."
            )
    bounds = inner * np.maximum(inner * bounds, inner * allowed)
    for low, high in ((0, 1), (2, 3)):
        if not bounds[low] < bounds[high]:
            raise MapError(
                f"--{names[low]} {bounds[low]:g} must be less than --{names[high]} "
                f"{bounds[high]:g}, within the area of the inputs"
                + (" (across the date line: --west 179 --east -179)." if high == 3 else ".")
            )
    if drape is not None:
        heights, spacing_deg = _clearances_and_spacing(drape, request, remarks)
    else:
        heights, spacing_deg = _heights_and_spacing(extents, request, remarks)
    if request.spacing_deg is None:
        sides = (bounds[1] - bounds[0], bounds[3] - bounds[2])
        spacing_deg = min(spacing_deg, _round_down(3600.0 * min(sides) / _FEWEST_STEPS) / 3600.0)
    latitude = _axis(bounds[0], bounds[1], spacing_deg, allowed[1])
    longitude = _axis(bounds[2], bounds[3], spacing_deg, allowed[3])
    counts = (latitude.size, longitude.size, heights.size)
    if min(counts) < FEWEST_NODES or math.prod(counts) > _MOST_NODES:
        raise MapError(
            f"bounds and spacings give {counts[0]} x {counts[1]} x {counts[2]} nodes in "
            f"latitude, longitude and height: at least {FEWEST_NODES} along each axis and at "
            f"most {_MOST_NODES} in total are allowed; change --spacing-arcmin or "
            "--height-spacing."
        )
    layer = counts[0] * counts[1]
    if layer > MOST_LAYER_NODES:
        raise MapError(
            f"a layer of {counts[0]} x {counts[1]} nodes in latitude and longitude needs "
            f"{layer * _BYTES_PER_NODE / 1e9:.3g} GB of memory; at most "
            f"{MOST_LAYER_NODES:.3g} nodes "
            f"({MOST_LAYER_NODES * _BYTES_PER_NODE / 1e9:.3g} GB) are allowed: increase "
            "--spacing-arcmin, or build the map in parts."
        )
    return Nodes(latitude, longitude, heights), remarks


def _require_degrees(request: GridRequest) -> None:
    """Raise MapError if a bound is outside the limits of latitude or longitude."""
    for name, most in (("south", 90.0), ("north", 90.0), ("west", 360.0), ("east", 360.0)):
        value = getattr(request, f"{name}_deg")
        if value is not None and abs(value) > most:
            what = "longitude" if most > 90.0 else "latitude"
            raise MapError(
                f"--{name} {value:g} is not a {what}: {-most:g} to {most:g} degrees are allowed"
                + ("; are these metres in a projection?" if abs(value) > 1e3 else ".")
            )


def _in_one_turn(extents: list[SourceExtent]) -> list[tuple[SourceExtent, Array]]:
    """Return extents, each with shifts (4,) [deg] that put all longitudes into one turn.

    The turn is that of the first regional extent. A global extent has no shift.
    """
    middles = [float(extent.bounds[2:].mean()) for extent in extents]
    whole = [np.array_equal(extent.bounds, EVERYWHERE) for extent in extents]
    first = next((m for m, w in zip(middles, whole, strict=True) if not w), 0.0)
    added = [0.0 if w else turns(m, first) for m, w in zip(middles, whole, strict=True)]
    return [(e, np.array([0.0, 0.0, a, a])) for e, a in zip(extents, added, strict=True)]


def _counted_alike(area: Area, allowed: Array) -> list[float | None]:
    """Return requested bounds with longitudes in the turn of the allowed bounds."""
    west, east = area.west, area.east
    if np.ptp(allowed[2:]) <= 360.0:
        middle = 0.5 * (allowed[2] + allowed[3])
        west, east = (s if s is None else s + float(turns(s, middle)) for s in (west, east))
    elif west is not None and east is not None:
        if east - west > 360.0 + _ROUNDING_DEG:
            raise MapError(
                f"--west {west:g} to --east {east:g} span {east - west:g} degrees; at most 360 "
                "are allowed."
            )
        east = eastern(west, east)
    return [area.south, area.north, west, east]


def _heights_and_spacing(
    extents: list[SourceExtent], request: GridRequest, remarks: list[str]
) -> tuple[Array, float]:
    floor = max(extent.floor_m for extent in extents)
    sources = max(extent.sources_m for extent in extents)
    lowest = request.lowest_m
    if lowest is None:
        lowest = max(extent.lowest_m for extent in extents)
    nearest = max(extents, key=lambda extent: extent.sources_m)
    distance = lowest - sources
    if not lowest >= floor:
        raise MapError(f"--lowest {lowest:g} {_too_low(extents, lowest, floor)}")
    across, upwards = widest_spacings(distance, bool(nearest.ground))
    spacing_m = request.height_spacing_m
    if spacing_m is None:
        spacing_m = _round_down(min(upwards, _WIDEST_HEIGHT_SPACING))
        if request.highest_m is not None and lowest < request.highest_m:
            spacing_m = min(spacing_m, _round_down((request.highest_m - lowest) / _FEWEST_STEPS))
    if not 0.0 < spacing_m < math.inf:
        remedy = (
            "raise --lowest" if request.height_spacing_m is None else "correct --height-spacing"
        )
        raise MapError(f"the height spacing is {spacing_m:g} m and must be positive: {remedy}.")
    highest = request.highest_m
    if highest is None:
        layers = _LAYERS - 1
        if nearest.ground:
            layers = max(layers, math.ceil(_LEAST_REACH_M / spacing_m))
        highest = lowest + layers * spacing_m
    if not lowest < highest <= HIGHEST_M:
        raise MapError(
            f"--highest {highest:g} must lie above --lowest {lowest:g} and at most at "
            f"{HIGHEST_M:g} m."
        )
    heights = _axis(lowest, highest, spacing_m, math.inf)
    return heights, _horizontal(request, across, distance, remarks)


def _clearances_and_spacing(
    drape: tuple[float, float], request: GridRequest, remarks: list[str]
) -> tuple[Array, float]:
    """Return heights of draped layers above the base surface [m], and the node spacing [deg]."""
    lowest, highest = drape
    for option, value in (("lowest", request.lowest_m), ("highest", request.highest_m)):
        if value is not None:
            raise MapError(
                f"--{option} {value:g} is a height above the ellipsoid; with --drape give "
                "heights above the ground, --clearance-from and --clearance-to."
            )
    if not 0.0 < lowest < highest <= HIGHEST_M:  # NaN fails too
        raise MapError(
            f"--clearance-from {lowest:g} must be above 0 and below --clearance-to {highest:g}, "
            f"which may be at most {HIGHEST_M:g} m."
        )
    across, upwards = widest_spacings(lowest, ground=True)
    spacing_m = request.height_spacing_m
    if spacing_m is None:
        # Whole steps up to the highest layer, at least three for a spline.
        cells = max(FEWEST_NODES - 1, math.ceil((highest - lowest) / upwards - 1e-6))
        spacing_m = (highest - lowest) / cells
    if not 0.0 < spacing_m < math.inf:
        raise MapError(f"--height-spacing {spacing_m:g} must be positive.")
    heights = _axis(lowest, highest, spacing_m, math.inf)
    return heights, _horizontal(request, across, lowest, remarks)


def _horizontal(request: GridRequest, across: float, distance: float, remarks: list[str]) -> float:
    """Return the requested horizontal node spacing [deg], or ``across`` [m] rounded down.

    ``distance`` is the distance of the lowest layer from the sources [m].
    """
    widest = math.degrees(across / SEMI_MAJOR_AXIS)
    spacing_deg = request.spacing_deg
    if spacing_deg is None:
        spacing_deg = _round_down(3600.0 * widest) / 3600.0
    elif spacing_deg > 1.001 * widest:
        remarks.append(
            f"the spacing of {3600 * spacing_deg:g}″ exceeds {3600 * widest:.3g}″, "
            f"{_share(across, distance)} of the distance of {distance:.0f} m to the sources: "
            "interpolation between the nodes is inaccurate"
        )
    if not 0.0 < spacing_deg < math.inf:
        raise MapError(f"the spacing of {3600 * spacing_deg:g}″ must be positive.")
    return spacing_deg


def widest_spacings(distance: float, ground: bool) -> tuple[float, float]:
    """Return the largest horizontal and vertical distances between nodes [m].

    ``distance`` is the distance of the lowest layer from the masses [m]. ``ground`` states whether
    the masses are those of a terrain, for which wider spacings are allowed.
    """
    quarter = _SPACING_PER_HEIGHT * distance
    if not ground:
        return quarter, quarter
    return tuple(  # type: ignore[return-value]
        max(quarter, min(share * distance, most)) for share, most in _NEAR_GROUND
    )


def _share(spacing: float, distance: float) -> str:
    """Return the ratio of a spacing to a distance in words."""
    share = spacing / distance
    return "a quarter" if abs(share - _SPACING_PER_HEIGHT) < 1e-6 else f"{share:.2g}"


def _too_low(extents: list[SourceExtent], lowest: float, floor: float) -> str:
    """Return the end of a message on a lowest height that is too low."""
    allowed = f"at least {floor:g} m is allowed"
    deciding = max(extents, key=lambda extent: extent.floor_m)
    if not deciding.ground:
        return f"lies below the sources: {allowed}."
    above = lowest - deciding.sources_m
    where = f"{abs(above):.3g} m {'below' if above < 0.0 else 'above'} {deciding.ground}"
    if above >= 0.0:
        where = f"only {where}"
    return (
        f"lies {where}: {allowed}. Heights are above the ellipsoid, not above the ground; "
        "--drape builds a map whose layers follow the ground."
    )


def _axis(low: float, high: float, step: float, limit: float) -> Array:
    """Return nodes from ``low`` to ``high`` at a distance of ``step``.

    If the steps do not end at ``high``, the last node lies beyond it by less than a step. This node
    is omitted if it would lie beyond ``limit``.
    """
    cells = math.ceil(min((high - low) / step, 1e9) - 1e-6)
    if cells > _MOST_CELLS:
        raise MapError(
            f"a spacing of {step:g} from {low:g} to {high:g} gives more than {_MOST_CELLS} nodes "
            "along one axis: increase it."
        )
    if low + cells * step > limit + 1e-9:
        cells -= 1
    return low + step * np.arange(cells + 1)


def _round_down(value: float) -> float:
    """Round a value down to two significant digits."""
    if not value > 0.0:
        return value
    unit = 10.0 ** (math.floor(math.log10(value)) - 1)
    return math.floor(value / unit + 1e-9) * unit
