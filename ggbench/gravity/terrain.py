"""Terrain: heights on a grid regular in geodetic latitude and longitude.

:mod:`ggbench.gravity.terrain_files` reads digital elevation models.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..errors import GGBenchError
from .meridians import turns

FEWEST_NODES = 4  # per axis, what a cubic spline needs
LOWEST_M, HIGHEST_M = -12000.0, 9000.0  # the Earth has nothing beyond
_ON_NODE = 1e-6  # of a step: a bound that rounding puts next to a node


class TerrainError(GGBenchError):
    """A terrain cannot be read, or its field cannot be computed."""


def require_latitudes(name: str, south: float, north: float) -> None:
    """Raise TerrainError if a grid reaches beyond a pole; ``south`` and ``north`` are in deg.

    ``name`` is the subject of the message.
    """
    if -90.0 <= south < north <= 90.0 + 1e-9:
        return
    hint = ""
    if max(abs(south), abs(north)) > 1000.0:
        hint = "; are these metres in a projection that the file does not state?"
    raise TerrainError(
        f"{name} has latitudes from {south:.6g} to {north:.6g}; allowed are -90 to 90 "
        f"degrees{hint or '.'}"
    )


@dataclass(frozen=True, eq=False)
class Terrain:
    """Heights on a grid regular in geodetic latitude and longitude.

    Attributes
    ----------
    south_deg, west_deg : latitude and longitude of the first node, the centre of a cell [deg].
    latitude_step_deg, longitude_step_deg : distances between nodes, positive [deg].
    height_m : heights above the zero level, shape (n_lat, n_lon), south to north and west to east,
        negative for the sea floor [m].
    name : source of the heights, in words.

    Raises TerrainError for fewer than 4 nodes per axis, a node beyond a pole, more than 360° of
    longitude, or heights that are not finite or outside -12000 to 9000 m.
    """

    south_deg: float
    west_deg: float
    latitude_step_deg: float
    longitude_step_deg: float
    height_m: NDArray[np.floating]
    name: str

    def __post_init__(self) -> None:
        shape = np.shape(self.height_m)
        if len(shape) != 2 or min(shape) < FEWEST_NODES:
            raise TerrainError(
                f"{self.name} has heights of shape {shape}; needed is latitude by longitude, at "
                f"least {FEWEST_NODES} of each."
            )
        for name in ("latitude_step_deg", "longitude_step_deg"):
            step = getattr(self, name)
            if not 0.0 < step < np.inf:
                raise TerrainError(f"{self.name} has {name} = {step}, which must be positive.")
        south, north = self.south_deg, self.south_deg + self.latitude_step_deg * (shape[0] - 1)
        require_latitudes(self.name, south, north)
        width = self.longitude_step_deg * (shape[1] - 1)
        if not (abs(self.west_deg) <= 360.0 and width <= 360.0 + 1e-9):
            raise TerrainError(
                f"{self.name} begins at longitude {self.west_deg:.6g} and is {width:.6g} degrees "
                "wide; allowed are -360 to 360, and at most 360 degrees."
            )
        lowest, highest = float(self.height_m.min()), float(self.height_m.max())
        if not (lowest >= LOWEST_M and highest <= HIGHEST_M):  # NaN fails too
            raise TerrainError(
                f"{self.name} has heights from {lowest:g} to {highest:g} m; allowed are "
                f"{LOWEST_M:g} to {HIGHEST_M:g}. Declare a void value with --void VALUE of "
                "'ggbench map build' or with gdal_edit -a_nodata."
            )

    @property
    def latitudes_deg(self) -> NDArray[np.float64]:
        """Latitudes of the rows, ascending, shape (n_lat,) [deg]."""
        steps = np.arange(self.height_m.shape[0], dtype=float)
        return self.south_deg + self.latitude_step_deg * steps

    @property
    def longitudes_deg(self) -> NDArray[np.float64]:
        """Longitudes of the columns, ascending, shape (n_lon,) [deg]."""
        steps = np.arange(self.height_m.shape[1], dtype=float)
        return self.west_deg + self.longitude_step_deg * steps

    def crop(self, south_deg: float, north_deg: float, west_deg: float, east_deg: float) -> Terrain:
        """Return the smallest part of the terrain that covers the bounds [deg].

        Bounds outside the terrain are moved to its edges.

        Raises TerrainError if the bounds are in the wrong order, or fewer than 4 rows or columns
        of the terrain lie between them.
        """
        if not (south_deg < north_deg and west_deg < east_deg):  # NaN fails too
            raise TerrainError(
                f"Latitudes {south_deg} to {north_deg} and longitudes {west_deg} to {east_deg} "
                "must each be in ascending order."
            )
        # The same meridians, counted as the terrain counts.
        turn = float(turns(0.5 * (west_deg + east_deg), self.longitudes_deg.mean()))
        bounds = (
            (south_deg, north_deg, self.south_deg, self.latitude_step_deg),
            (west_deg + turn, east_deg + turn, self.west_deg, self.longitude_step_deg),
        )
        slices = []
        for (low, high, first, step), count in zip(bounds, self.height_m.shape, strict=True):
            begin = max(int(np.floor((low - first) / step + _ON_NODE)), 0)
            end = min(int(np.ceil((high - first) / step - _ON_NODE)) + 1, count)
            slices.append(slice(begin, max(begin, end)))
        rows, columns = slices
        return Terrain(
            self.south_deg + self.latitude_step_deg * rows.start,
            self.west_deg + self.longitude_step_deg * columns.start,
            self.latitude_step_deg,
            self.longitude_step_deg,
            self.height_m[rows, columns],
            f"{self.name}, cropped",
        )
