"""Terrains whose heights are a plane, in the formats of elevation models."""

from __future__ import annotations

import numpy as np
import rasterio
import xarray
from rasterio.transform import from_origin

from ggbench.gravity.meridians import Area

SOUTH, WEST, STEP = 45.0, 7.0, 0.01
N_LAT, N_LON = 12, 16
LATITUDES = SOUTH + STEP * np.arange(N_LAT)
LONGITUDES = WEST + STEP * np.arange(N_LON)


def plane(latitude, longitude):
    """Heights [m] by which a cell is known: no two are alike, and any interpolation keeps them."""
    return 1000.0 + 2000.0 * (np.asarray(latitude) - SOUTH) + 700.0 * (longitude - WEST)


HEIGHTS = plane(LATITUDES[:, np.newaxis], LONGITUDES)
# A raster begins in the north-west, with the corner of a cell.
CORNERS = from_origin(WEST - STEP / 2, LATITUDES[-1] + STEP / 2, STEP, STEP)

SOUTH_EAST = Area(45.0, 45.04, WEST + 360.0 + 0.09, WEST + 0.15)
"""A part of the terrain, its sides counted in two ways."""


def write_raster(path, heights=HEIGHTS[::-1], tags=None, scales=None, units=None, **profile):
    profile = {
        "driver": "GTiff",
        "count": 1,
        "dtype": "float64",
        "crs": "EPSG:4326",
        "transform": CORNERS,
        "height": heights.shape[0],
        "width": heights.shape[1],
        **profile,
    }
    with rasterio.open(path, "w", **profile) as dataset:
        for band in range(1, profile["count"] + 1):
            dataset.write(heights.astype(profile["dtype"]), band)
        dataset.update_tags(**(tags or {}))
        if scales:
            dataset.scales = scales
        if units:
            dataset.units = units
    return path


def grid(latitude=LATITUDES, longitude=LONGITUDES, names=("lat", "lon")):
    heights = plane(np.asarray(latitude)[:, np.newaxis], (np.asarray(longitude) + 180) % 360 - 180)
    return xarray.DataArray(heights, dict(zip(names, (latitude, longitude), strict=True)), names)


def write_voids(path, parts, mark=-9999.0):
    """Write the plane with voids in parts of the raster, which begins in the north."""
    heights = HEIGHTS[::-1].copy()
    for part in parts:
        heights[part] = mark
    return write_raster(path, heights, nodata=mark)


def write_projected_voids(path):
    """Write a level terrain in metres of a projection, its corner in the north-west empty."""
    heights = np.full((60, 60), 500.0)
    heights[:20, :20] = -9999.0
    return write_raster(
        path,
        heights,
        crs="EPSG:32632",
        nodata=-9999.0,
        transform=from_origin(500000.0, 5000000.0, 100.0, 100.0),
    )


def write_tile(path, dtype):
    """Write a tile of waves in integers of a type."""
    rows, columns = np.mgrid[:1201, :1201]
    heights = (500.0 + 0.5 * rows + 200.0 * np.sin(columns / 40.0)).astype(int)
    heights.astype(dtype).tofile(path)
