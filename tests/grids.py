"""Grids of a user's own, as netCDF files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import xarray


def write_grid(
    path: Path | str,
    name: str,
    units: str,
    values: np.ndarray,
    south: float,
    west: float,
    step: float,
) -> None:
    """Write values (n_lat, n_lon) on latitudes and longitudes [deg]."""
    latitude, longitude = (
        first + step * np.arange(count)
        for first, count in zip((south, west), values.shape, strict=True)
    )
    xarray.Dataset(
        {name: (("lat", "lon"), values, {"units": units})},
        {"lat": latitude, "lon": longitude},
    ).to_netcdf(path)
