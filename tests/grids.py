"""Grids of a user's own, as netCDF files."""

from __future__ import annotations

from pathlib import Path

import netCDF4
import numpy as np
import xarray

LATITUDES = 42.0 + np.arange(20) / 10.0
LONGITUDES = 3.0 + np.arange(30) / 10.0
VALUES = 20.0 * np.sin(np.arange(600.0)).reshape(20, 30)
BAD_AXES = {
    "swapped units of axes": (
        {"units": ("degrees_east", "degrees_north")},
        "contradict the name",
    ),
    "longitudes to the west": (
        {"units": ("degrees_north", "degrees_west")},
        "positive north and east",
    ),
    "latitudes to the south": (
        {"units": ("degrees_south", "degrees_east")},
        "positive north and east",
    ),
    "axes in radians": ({"units": ("radians", "radians")}, "degrees are needed"),
    "axes in kilometres": ({"names": ("y", "x"), "units": ("km", "km")}, "degrees are needed"),
    "colatitudes": ({"axis_names": ("colatitude", "")}, "geodetic latitudes are needed"),
    "geocentric latitudes": (
        {"axis_names": ("geocentric latitude", "")},
        "geodetic latitudes are needed",
    ),
}
"""Axes that are no degrees north and east, as arguments of `grid`, and messages."""


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


def grid(
    folder,
    *,
    names=("lat", "lon"),
    axes=(LATITUDES, LONGITUDES),
    units=("degrees_north", "degrees_east"),
    axis_names=("", ""),
    values=VALUES,
    title="",
    **attributes,
):
    """Return a netCDF file of a variable z on two axes."""
    path = folder / "grid.nc"
    with netCDF4.Dataset(path, "w") as file:
        for name, nodes, unit, long_name in zip(names, axes, units, axis_names, strict=True):
            file.createDimension(name, len(nodes))
            axis = file.createVariable(name, "f8", (name,))
            axis[:] = nodes
            axis.setncatts({k: v for k, v in (("units", unit), ("long_name", long_name)) if v})
        variable = file.createVariable("z", "f8", names)
        variable.setncatts(attributes)
        variable[:] = values
        file.title = title
    return path
