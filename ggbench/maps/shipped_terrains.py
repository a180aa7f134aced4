"""Terrains that the package carries, as sources of maps: their field by Parker's series."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import text_of
from ..gravity.gradient_map import MapError
from ..gravity.terrain import Terrain, TerrainError
from .shipped_regions import data_bytes, read_arrays

Array = NDArray[np.float64]


@dataclass(frozen=True)
class TerrainSource:
    """A terrain among the package's data.

    Attributes
    ----------
    file : its data file.
    highest_height_m : up to which its edges leave the field good [m].
    provenance : where the data come from, in words.
    clearance_m : least height of a map above the highest ground [m]: below, Parker's series grows
        too long. It grows with the relief.
    """

    file: str
    highest_height_m: float
    provenance: str
    clearance_m: float = 50.0


TERRAINS = {
    "jacksboro": TerrainSource(
        file="jacksboro_dem_3arcsec.npz",
        highest_height_m=3000.0,
        provenance="SRTM terrain (NASA) of 3 arc seconds around Jacksboro, Tennessee, its masses "
        "by Parker's series",
    ),
    "parallel_valleys": TerrainSource(
        file="parallel_valleys_6arcsec.npz",
        highest_height_m=3000.0,
        provenance="a terrain that is made up, of nine parallel valleys and a hill, its masses by "
        "Parker's series",
    ),
    "rocky_mountains": TerrainSource(
        file="rocky_mountains_dem_234m.npz",
        highest_height_m=6000.0,
        provenance="terrain of cells of 234 m (Terrain Tiles, U.S. Geological Survey) of Rocky "
        "Mountain National Park, Colorado, its masses by Parker's series",
        clearance_m=150.0,
    ),
}
"""Terrains by the name that a recipe uses."""


def terrain_disturbing_field(
    name: str,
    latitude: ArrayLike,
    longitude: ArrayLike,
    height: ArrayLike,
    density: float = 2670.0,
    relief_smoothing_deg: float = 0.0,
) -> tuple[Array, Array]:
    """Return the field of a terrain's masses, as a region's by :func:`.disturbing_field`.

    Parameters
    ----------
    name : a key of :data:`TERRAINS`.
    latitude, longitude, height : as there.
    density : of the ground [kg/m³].
    relief_smoothing_deg : as there, of the terrain: a map of lower resolution.

    Raises MapError if the terrain's file is damaged or the positions are outside of what it gives.
    """
    # Not at the top: a map that is made already needs neither.
    from scipy.ndimage import gaussian_filter

    from ..gravity.parker import TerrainOptions, terrain_field

    terrain = _terrain(name)
    if relief_smoothing_deg > 0.0:
        steps = (terrain.latitude_step_deg, terrain.longitude_step_deg)
        sigma = [relief_smoothing_deg / step for step in steps]
        smooth = gaussian_filter(terrain.height_m.astype(float), sigma, mode="nearest")
        terrain = replace(terrain, height_m=smooth)
    try:
        tensor, vector = terrain_field(
            terrain, latitude, longitude, height, TerrainOptions(density=density)
        )
    except TerrainError as error:
        raise MapError(str(error)) from None
    return tensor.astype(float), vector.astype(float)


def terrain_extent_deg(name: str) -> tuple[tuple[float, float], tuple[float, float]]:
    """Latitudes and longitudes, each from and to [deg], between which a terrain gives a field."""
    terrain = _terrain(name)
    latitudes, longitudes = terrain.latitudes_deg, terrain.longitudes_deg
    return (float(latitudes[0]), float(latitudes[-1])), (
        float(longitudes[0]),
        float(longitudes[-1]),
    )


def terrain_heights_m(name: str) -> tuple[float, float]:
    """Lowest and highest height [m] at which a terrain gives a field."""
    source = TERRAINS[name]
    return math.ceil(highest_ground_m(name) + source.clearance_m), source.highest_height_m


def highest_ground_m(name: str) -> float:
    """Highest ground of a terrain [m]."""
    return float(_terrain(name).height_m.max())


@lru_cache(maxsize=4)
def _terrain(name: str) -> Terrain:
    file = TERRAINS[name].file
    fields = ("south_deg", "west_deg", "latitude_step_deg", "longitude_step_deg", "height_m")
    try:
        arrays: dict[str, Any] = read_arrays(data_bytes(file), fields)
        south, west, latitude_step, longitude_step = (float(arrays[key]) for key in fields[:4])
        heights = arrays["height_m"].astype(float)
        return Terrain(
            south, west, latitude_step, longitude_step, heights, TERRAINS[name].provenance
        )
    except MapError:
        raise
    except Exception as error:
        raise MapError(
            f"Data file {file} of ggbench.scenarios is damaged ({text_of(error)}); it must "
            f"hold the arrays {', '.join(fields)}: install the package again."
        ) from error
