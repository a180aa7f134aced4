"""Terrains from the sea floor to the land, as netCDF files and rasters."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import rasterio
import xarray
from rasterio.transform import from_origin

LATITUDES, LONGITUDES = 45.0 + 0.1 * np.arange(12), 7.0 + 0.1 * np.arange(16)
HEIGHTS = np.add.outer(100.0 * np.arange(12), 10.0 * np.arange(16)) - 500.0
"""From the sea floor to the land."""


def write_netcdf(path: Path, heights: np.ndarray, name: str = "z", **attributes: str) -> Path:
    data = {name: (("lat", "lon"), heights, attributes)}
    xarray.Dataset(data, {"lat": LATITUDES, "lon": LONGITUDES}).to_netcdf(path)
    return path


def write_raster(
    path: Path,
    heights: np.ndarray,
    unit: str = "",
    crs: str = "EPSG:4326",
    step: float = 0.1,
    **tags: str,
) -> Path:
    corner = (6.95, 46.15) if step < 1.0 else (5e5, 5e6)
    with rasterio.open(
        path,
        "w",
        driver="GTiff",
        count=1,
        dtype="float32",
        crs=crs,
        height=12,
        width=16,
        transform=from_origin(*corner, step, step),
    ) as dataset:
        dataset.write(heights[::-1].astype(np.float32), 1)
        dataset.update_tags(1, **tags)
        if unit:
            dataset.units = [unit]
    return path
