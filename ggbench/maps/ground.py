"""Highest ground of a terrain, the lower limit of a map of level layers.

Parker's series is valid only above the highest ground, so over valleys the lowest layer is as high
as over the summit. Draped layers (:mod:`.drape`) follow the ground instead.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from ..gravity.ellipsoid import EOTVOS, SEMI_MAJOR_AXIS
from ..gravity.meridians import Area, turns
from .netcdf import Nodes

if TYPE_CHECKING:
    from ..gravity.terrain import Terrain

_CLEARANCE_M = 50.0  # least height above the highest ground, by default
_CONVERGING = 1.2  # times what the series takes, about
_QUICK_NODES = 8_000_000  # of the Fourier grid, by default: some seconds
_ROUND_M = 10.0
_WORTH_SAYING_EOTVOS = 1.0
"""Effect of unknown ground beyond the terrain above which a remark is made [E]."""
_DRAPE_M = 200.0  # default height above the ground of the flights in the note on the map's area


@dataclass(frozen=True)
class Ground:
    """Highest ground of a terrain. Heights are above the ellipsoid [m].

    Attributes
    ----------
    terrain, geoid_height_m : see :class:`ggbench.maps.parts.TerrainPart`.
    area : requested bounds of the map.
    clearance_m : planned height of the flight above the ground; None: unknown.
    """

    terrain: Terrain
    geoid_height_m: float
    area: Area = field(default_factory=Area)
    clearance_m: float | None = None

    @property
    def highest_m(self) -> float:
        """Height of the highest ground."""
        return float(np.max(self.terrain.height_m)) + self.geoid_height_m

    @property
    def place_deg(self) -> tuple[float, float]:
        """Latitude and longitude of the highest ground [deg]."""
        row, column = np.unravel_index(
            int(np.argmax(self.terrain.height_m)), self.terrain.height_m.shape
        )
        return float(self.terrain.latitudes_deg[row]), float(self.terrain.longitudes_deg[column])

    def lowest_m(self) -> float:
        """Return the default height of the lowest layer of a map.

        The spacing of the terrain, the convergence of Parker's series and the size of the Fourier
        grid set the clearance above the summit. The layer is at most as high as the planned flight
        over the summit, but not below :meth:`floor_m`.
        """
        from ..gravity.parker import converging_clearance, least_clearance

        cell = math.radians(self.terrain.latitude_step_deg) * SEMI_MAJOR_AXIS
        series = _CONVERGING * converging_clearance(self.terrain)
        quick = least_clearance(self.terrain, _QUICK_NODES)
        clearance = max(_CLEARANCE_M, cell, series, quick)
        lowest = _ROUND_M * math.ceil((self.highest_m + clearance) / _ROUND_M)
        if self.clearance_m is None:
            return lowest
        return max(self.floor_m(), min(lowest, self.highest_m + self.clearance_m))

    def floor_m(self) -> float:
        """Return the lowest possible height of a map."""
        from ..gravity.parker import least_clearance

        return math.ceil(self.highest_m + least_clearance(self.terrain))

    def __str__(self) -> str:
        latitude, longitude = self.place_deg
        placed = self.area.about(longitude)
        outside = not placed.holds(np.array(latitude), np.array(longitude))
        note = ", outside of the map's bounds" if outside else ""
        return (
            f"the highest ground of the terrain ({self.highest_m:.0f} m at {latitude:.4f}° N, "
            f"{longitude:.4f}° E{note})"
        )

    def beyond(self, nodes: Nodes, density: float) -> list[str]:
        """Return a list with a remark on the effect of unknown ground beyond the terrain.

        The list is empty if the effect is small. The estimate uses a half-plane of thickness t and
        density ρ beyond the distance D: its gradient is 2 G ρ t / D, with the gravitational
        constant G. The thickness t is the standard deviation of the terrain's heights. D is the
        distance of the map from the nearest edge of the terrain. ``density`` is ρ [kg/m³].
        """
        from ..gravity.parker import GRAVITATIONAL_CONSTANT  # compiled, as the series below

        terrain = self.terrain
        west, east = (float(v) for v in terrain.longitudes_deg[[0, -1]])
        middle = math.radians(0.5 * float(nodes.latitude_deg[0] + nodes.latitude_deg[-1]))
        turn = float(turns(nodes.longitude_deg.mean(), 0.5 * (west + east)))
        per_degree = math.radians(SEMI_MAJOR_AXIS)
        away = {
            "southern": nodes.latitude_deg[0] - terrain.latitudes_deg[0],
            "northern": terrain.latitudes_deg[-1] - nodes.latitude_deg[-1],
            "western": (nodes.longitude_deg[0] + turn - west) * math.cos(middle),
            "eastern": (east - nodes.longitude_deg[-1] - turn) * math.cos(middle),
        }
        side = min(away, key=lambda name: away[name])
        # The terrain's outermost cells reach half a cell beyond their nodes.
        distance = per_degree * (float(away[side]) + 0.5 * terrain.latitude_step_deg)
        step = float(np.std(terrain.height_m))
        sheet = 2.0 * GRAVITATIONAL_CONSTANT * density * step / EOTVOS
        if sheet < _WORTH_SAYING_EOTVOS * distance:
            return []
        worth, needed_km = (
            float(f"{value:.2g}")
            for value in (sheet / distance, sheet / _WORTH_SAYING_EOTVOS / 1e3)
        )
        return [
            f"the map lies within {distance / 1e3:.2g} km of the {side} edge of the terrain. "
            f"Unknown heights beyond this edge ({step:.0f} m, 1 σ) cause errors of {worth:g} E "
            f"near it. For errors of at most {_WORTH_SAYING_EOTVOS:g} E, provide "
            f"{needed_km:g} km of terrain around the map"
        ]

    def remark(self, nodes: Nodes) -> str:
        """Return a remark on the share of the area where the map covers terrain-following flights.

        The map covers a flight where the flight is not below the lowest layer.
        """
        lowest = float(nodes.height_m[0])
        lat, lon = nodes.latitude_deg, nodes.longitude_deg
        around = self.terrain.crop(lat[0], lat[-1], lon[0], lon[-1]).height_m
        flown = _DRAPE_M if self.clearance_m is None else self.clearance_m
        share = float(np.mean(around + self.geoid_height_m + flown >= lowest))
        cure = ""
        if share < 1.0:
            cure = (
                f"; set lowest_m = {math.ceil(lowest):g} for terrain-following flights, fly "
                f"level flights at {math.ceil(lowest):g} m or more, or build a map whose layers "
                "follow the ground with --drape"
            )
        return (
            f"the lowest layer, {lowest:g} m, lies {lowest - self.highest_m:.0f} m above {self}; "
            f"a flight {flown:g} m above the ground is inside the map over {share:.0%} of its "
            f"area{cure}"
        )
