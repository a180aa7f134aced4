"""Messages of elevation models."""

from __future__ import annotations

import struct

import grids
import numpy as np
import pytest
import rasterio
import rasterio.shutil
import sea_floors
import xarray
from rasterio.transform import Affine, from_origin
from refusals import refused
from terrain_planes import (
    HEIGHTS,
    LATITUDES,
    LONGITUDES,
    N_LAT,
    N_LON,
    SOUTH,
    SOUTH_EAST,
    STEP,
    WEST,
    grid,
    write_projected_voids,
    write_raster,
    write_tile,
    write_voids,
)

from ggbench.gravity.meridians import Area
from ggbench.gravity.terrain import TerrainError
from ggbench.gravity.terrain_files import read_terrain


def content(path, data=b""):
    path.write_bytes(data)


def cut_raster(path):
    write_raster(path, np.zeros((200, 200)))
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])


def huge_raster(path):
    """A sparse raster of 40 gigabytes takes no room on the disk."""
    with rasterio.open(
        path,
        "w",
        driver="GTiff",
        width=100_000,
        height=50_000,
        count=1,
        dtype="float64",
        crs="EPSG:4326",
        transform=from_origin(-180, 90, 0.0036, 0.0036),
        sparse_ok=True,
        compress="deflate",
        tiled=True,
        bigtiff="yes",
    ):
        pass


def ascii_grid(path):
    source = path.with_name("source.tif")
    sea_floors.write_raster(source, sea_floors.HEIGHTS)
    rasterio.shutil.copy(source, path, driver="AAIGrid")


def netcdf(path, **variables):
    xarray.Dataset(variables).to_netcdf(path, engine="scipy")


def axes(path, **attributes):
    """A grid on x and y with attributes of the axes."""
    data = grid(names=("y", "x"))
    for name, each in attributes.items():
        data[name].attrs.update(each)
    netcdf(path, z=data)


def gmt_3(path):
    sides = {"x_range": ("side", [7.0, 8.5]), "y_range": ("side", [45.0, 46.1])}
    values = {"dimension": ("side", [16, 12]), "z": ("xysize", sea_floors.HEIGHTS.ravel())}
    netcdf(path, **sides, **values)


def sea_floor(path, shift=0.0, cell=None, feet=False, dtype="float64", **options):
    """A netCDF file from the sea floor to the land, moved and with another cell."""
    heights = ((sea_floors.HEIGHTS + shift) / (0.3048 if feet else 1.0)).astype(dtype)
    if cell is not None:
        heights[5, 7] = cell
    sea_floors.write_netcdf(path, heights, **options)


def described(path, **options):
    """A grid of netCDF whose variable and axes are described."""
    grids.grid(path.parent, values=100.0 + grids.VALUES, **options).rename(path)


def archive(path, lat=LATITUDES, lon=LONGITUDES, z=HEIGHTS):
    np.savez(path, lat=lat, lon=lon, z=z)


def other_archive(path):
    np.savez(path, heights=HEIGHTS)


def cut_archive(path):
    archive(path)
    path.write_bytes(path.read_bytes()[:-40])


def folder(path):
    path.mkdir()


def none(path):
    """No file at all."""


def file_as_folder(path):
    path.parent.touch()


TURNED = Affine(STEP, 0.1 * STEP, WEST, 0.1 * STEP, -STEP, SOUTH)
METRES = from_origin(4e5, 5e6, 90.0, 90.0)
UNEVEN = LATITUDES + 0.001 * (np.arange(N_LAT) == 5)
GEOSOFT = struct.pack("<5i", 4, 1, 16, 12, 1) + bytes(512 + 4 * 192 - 20)
PROJECTED = {"standard_name": "projection_x_coordinate"}
DEPTHS = {"standard_name": "sea_floor_depth"}
QUARTER = np.s_[:6, :8]
NO_RASTER = r"a\.tif cannot be read as a raster"
NO_NETCDF = r"a\.nc cannot be read as a netCDF file"
NO_DIRECTION = "without a direction: set the attribute positive"
DECLARE = "Declare a void value with --void VALUE"
BELOW_SEA = "heights in 'm below sea level'; metres or feet are"
IN_AREA = (
    r"2 voids among \d+ cells of the area needed, 45° to 45.04° N, 7.09° to 7.15° E, the first "
    r"at latitude, longitude 45.01000, 7.12000; .* choose bounds without voids"
)
BAD = {
    "two bands": ("a.tif", write_raster, {"count": 2}, "has 2 bands; exactly one band, with h"),
    "rotated rows": (
        "a.tif",
        write_raster,
        {"transform": TURNED},
        "is rotated; rows must lie along parallels",
    ),
    "no place": (
        "a.tif",
        write_raster,
        {"transform": Affine.identity(), "crs": None},
        "is not georeferenced",
    ),
    "metres without a projection": (
        "a.tif",
        write_raster,
        {"transform": METRES, "crs": None},
        r"latitudes from 4.9.* to 4.9.*e\+06; allowed are -90 to 90 degrees",
    ),
    "heights in fathoms": (
        "a.tif",
        write_raster,
        {"units": ["fathom"]},
        "heights in 'fathom'; metres or feet are allowed",
    ),
    "heights above Everest": (
        "a.tif",
        write_raster,
        {"heights": HEIGHTS[::-1] * 10.0},
        "heights from 10000 to .* m; allowed are -12000 to 9000",
    ),
    "half a raster": ("a.tif", cut_raster, {}, NO_RASTER),
    "half a tile": (
        "N36W085.hgt",
        content,
        {"data": b"\0" * 1000},
        "N36W085.hgt has 1000 bytes; a square of 16-bit integers is needed",
    ),
    "bytes that are no raster": ("a.tif", content, {"data": b"no raster at all"}, NO_RASTER),
    "bytes that are no netCDF": ("a.nc", content, {"data": b"\x89HDF no netCDF"}, NO_NETCDF),
    "a header of Surfer alone": (
        "a.grd",
        content,
        {"data": b"DSBB"},
        "a.grd cannot be read as a raster",
    ),
    "an empty netCDF": ("a.nc", content, {}, NO_NETCDF),
    "two grids": (
        "a.nc",
        netcdf,
        {"slope": grid(), "roughness": grid()},
        r"has 2 variables on latitude and longitude \(slope, roughness\); it must have one",
    ),
    "no latitudes and longitudes": (
        "a.nc",
        netcdf,
        {"z": (("a", "b"), HEIGHTS)},
        r"has 0 variables on latitude and longitude \(none\)",
    ),
    "axes in metres": (
        "a.nc",
        axes,
        {"x": {"units": "m"}, "y": {"units": "m"}},
        "has y in 'm'; degrees are needed",
    ),
    "an axis of a projection": (
        "a.nc",
        axes,
        {"x": PROJECTED},
        "coordinate x belongs to a projection; degrees are needed",
    ),
    "uneven latitudes": (
        "a.npz",
        archive,
        {"lat": UNEVEN},
        "has latitudes that are not evenly spaced",
    ),
    "latitudes in no order": (
        "a.npz",
        archive,
        {"lat": np.roll(LATITUDES, 3)},
        "has latitudes that are not evenly spaced",
    ),
    "longitudes along the first axis": (
        "a.npz",
        archive,
        {"z": HEIGHTS.T},
        r"heights of shape \(16, 12\), but \(12,\) latitudes and \(16,\) longitudes",
    ),
    "latitudes beyond the pole": (
        "a.npz",
        archive,
        {"lat": LATITUDES + 45.0},
        "latitudes from 90 to 90.11; allowed are -90 to 90 degrees",
    ),
    "arrays of another program": (
        "a.npz",
        other_archive,
        {},
        r"has the arrays heights; it must have one of these sets: \(lat, lon, z\)",
    ),
    "a cut archive": ("a.npz", cut_archive, {}, "a.npz cannot be unpacked"),
    "pickled objects": (
        "a.npz",
        archive,
        {"z": np.array([{}], dtype=object)},
        "a.npz cannot be unpacked",
    ),
    "words for heights": (
        "a.npz",
        archive,
        {"z": np.full((N_LAT, N_LON), "high")},
        "a.npz cannot be read as a NumPy archive",
    ),
    "three latitudes": (
        "a.npz",
        archive,
        {"lat": LATITUDES[:3], "z": HEIGHTS[:3]},
        "has 3 latitudes; at least 4 are needed",
    ),
    "unknown suffix": ("a.docx", content, {}, "a.docx has an unknown suffix; allowed: .tif"),
    "a folder": ("a.tif", folder, {}, "is a folder; a terrain is a file"),
    "no file": ("nowhere.tif", none, {}, "There is no terrain file .*nowhere.tif"),
    "a name without measure": (
        "a" * 1000 + ".tif",
        none,
        {},
        r"The terrain file .* cannot be read",
    ),
    "a name with a zero byte": ("a\0.tif", none, {}, r"The terrain file .* cannot be read"),
    "a file as a folder": (
        "file.tif/a.tif",
        file_as_folder,
        {},
        r"The terrain file .* cannot be read",
    ),
    "too many cells": (
        "globe.tif",
        huge_raster,
        {},
        r"50000 x 100000 cells; at most 1e\+08 are allowed",
    ),
    "a few voids side by side": (
        "holes.tif",
        write_voids,
        {"parts": [np.s_[4, 7:10]], "mark": -32768.0},
        r"holes.tif has 3 voids among 192 cells, the first at .* 45.07000, 7.07000; less than",
    ),
    "a quarter of voids": (
        "a.tif",
        write_voids,
        {"parts": [QUARTER]},
        "has 48 voids among 192 cells, the first",
    ),
    "voids in the area needed": (
        "a.tif",
        write_voids,
        {"parts": [QUARTER, np.s_[9:11, 12]]},
        IN_AREA,
        SOUTH_EAST,
    ),
    "voids of a projected raster": ("utm.tif", write_projected_voids, {}, "has 400 voids"),
    "voids of a projected raster in the area needed": (
        "utm.tif",
        write_projected_voids,
        {},
        r"of the area needed, 45\.14°",
        Area(45.14, 45.15, 9.0, 9.03),
    ),
    "depths from the sea to the land": ("a.nc", sea_floor, {"name": "depth"}, NO_DIRECTION),
    "negative depths": (
        "a.nc",
        sea_floor,
        {"shift": -1000.0, **DEPTHS},
        "depths from -1500 to -250 without a direction",
    ),
    "heights below sea level": ("b.nc", sea_floor, {"units": "m below sea level"}, BELOW_SEA),
    **{
        f"an undeclared void in {unit}": (
            "b.nc",
            sea_floor,
            {"cell": 55555.0, "feet": unit == "ft", "dtype": "float32", "units": unit},
            DECLARE,
        )
        for unit in ("m", "ft")
    },
    "a tile without a place": (
        "mini.hgt",
        content,
        {"data": bytes(2 * 601**2)},
        "must begin with its south-western corner, for example N36W085.hgt",
    ),
    "a tile of swapped bytes": (
        "N46E008.hgt",
        write_tile,
        {"dtype": "<i2"},
        "wrong order, little-endian",
    ),
    "a grid of Geosoft": (
        "a.grd",
        content,
        {"data": GEOSOFT},
        r"is a Geosoft grid, .* as GeoTIFF or as a Surfer grid",
    ),
    "a grid of GMT 3": (
        "a.grd",
        gmt_3,
        {},
        r"format of GMT 3, .* 'gmt grdconvert a.grd=cf new.nc'",
    ),
    "an ASCII grid named as a GeoTIFF": (
        "b.tif",
        ascii_grid,
        {},
        r"b\.tif cannot be read as a raster",
    ),
    **{
        name: ("grid.nc", described, options, message)
        for name, (options, message) in grids.BAD_AXES.items()
    },
    **{
        f"a grid of {text}": ("grid.nc", described, {"long_name": text}, message)
        for text, message in {
            "geoid undulation": "a geoid",
            "free-air anomaly": "a free-air anomaly",
            "slope": "a slope",
            "hillshade": "a slope",
            "canopy height above ground": "a slope",
            "height error": "an error",
        }.items()
    },
}


@pytest.mark.parametrize("kind", BAD)
def test_a_bad_elevation_model_is_refused_in_one_sentence(kind, tmp_path):
    name, write, options, message, *area = BAD[kind]
    path = tmp_path / name
    write(path, **options)
    with refused(TerrainError, message):
        read_terrain(path, *area)
