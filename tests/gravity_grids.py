"""Grids of gravity and of a geoid: 20 by 24 nodes, from 45° N and 7° E on."""

from __future__ import annotations

import netCDF4
import numpy as np
import rasterio
from grids import write_grid
from rasterio.transform import from_origin

VALUES = np.add.outer(np.arange(20.0), 0.1 * np.arange(24.0))


def write_raster(path, values, unit=""):
    """A GeoTIFF of 20 by 24 nodes, from 45° N and 7° E on."""
    with rasterio.open(
        path,
        "w",
        driver="GTiff",
        count=1,
        dtype=values.dtype,
        crs="EPSG:4326",
        height=20,
        width=24,
        transform=from_origin(6.95, 46.95, 0.1, 0.1),
    ) as dataset:
        dataset.write(values[::-1], 1)
        if unit:
            dataset.units = [unit]
    return path


def write_icgem(path, functional, unit):
    """A file of ICGEM's calculation service, of a constant 5."""
    head = ["latitude_parallels 16", "longitude_parallels 16", f"unit {unit}"]
    head += [f"functional {functional}"] if functional else []
    rows = [f"{100 + 0.1 * j:.1f} {20 - 0.1 * i:.1f} 5.0" for i in range(16) for j in range(16)]
    path.write_text("\n".join([*head, "end_of_head ==", *rows]))
    return path


def described(folder, text, values=VALUES):
    """The same grid as GMT's netCDF, its unit in the description alone, and as a raster."""
    write_grid(folder / "a.nc", "z", "", values, south=45.0, west=7.0, step=0.1)
    with netCDF4.Dataset(folder / "a.nc", "a") as file:
        file["z"].long_name = text
    raster = write_raster(folder / "a.tif", values)
    with rasterio.open(raster, "r+") as dataset:
        dataset.set_band_description(1, text)
    return folder / "a.nc", raster


FUNCTIONALS = {
    "geoid": "geoid",
    "height_anomaly": "geoid",
    "height_anomaly_ell": "geoid",
    "gravity_anomaly": "anomaly",
    "gravity_anomaly_cl": "anomaly",
    "gravity_anomaly_sa": "anomaly",
    "gravity_disturbance": "disturbance",
    "gravity_disturbance_sa": "disturbance",
}
"""Functionals of ICGEM, and the kinds of grids that they are."""


def write_gap(path, mark):
    """A file of ICGEM with a 0 among its values, and a mark of gaps."""
    head = ["latitude_parallels 16", "longitude_parallels 16", "unit mgal", f"gapvalue {mark}"]
    rows = [
        f"{100 + 0.1 * j:.1f} {20 - 0.1 * i:.1f} {0.0 if i == j == 3 else 5.0}"
        for i in range(16)
        for j in range(16)
    ]
    path.write_text("\n".join([*head, "longitude latitude gravity", "end_of_head ==", *rows]))


def write_gaps(path):
    """A netCDF file with five rows of gaps in the south; return its values."""
    values = np.arange(1600.0).reshape(40, 40) / 100.0
    values[:5] = np.nan
    write_grid(path, "g", "m", values, south=30.0, west=5.0, step=0.1)
    return values


def write_marked(path, mark, unit):
    """A netCDF file of gravity with an undeclared mark of a gap."""
    values = VALUES.copy()
    values[3, 4] = mark
    write_grid(path, "g", unit, values, south=45.0, west=7.0, step=0.1)


def write_isg(path):
    """A geoid in ISG 1.0: a header of words, then rows from north to south."""
    head = [
        "begin_of_head",
        "model name : made",
        "model type : gravimetric",
        "units : meters",
        "reference : WGS84",
        "lat min = 44.95",
        "lat max = 46.95",
        "lon min = 6.95",
        "lon max = 9.35",
        "delta lat = 0.10",
        "delta lon = 0.10",
        "nrows = 20",
        "ncols = 24",
        "nodata = -9999.0000",
        "ISG format = 1.0",
        "end_of_head",
    ]
    rows = [" ".join(f"{value:.4f}" for value in row) for row in VALUES[::-1]]
    path.write_text("\n".join([*head, *rows, ""]))
