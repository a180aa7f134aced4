"""Messages of map files."""

from __future__ import annotations

import re
from collections import deque

import netCDF4
import numpy as np
import pytest
import xarray
from small_maps import some_map
from thinning import thinned

from ggbench.gravity.gradient_map import MapError
from ggbench.maps import netcdf, netcdf_reader
from ggbench.maps.recipe import read


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The bytes of a map without faults."""
    path = tmp_path_factory.mktemp("map") / "whole.nc"
    netcdf.write(path, some_map())
    return path.read_bytes()


def edit(path, variable, **changes):
    """Change attributes of one variable."""
    with netCDF4.Dataset(path, "a") as data:
        data[variable].setncatts(changes)


def turn(path, frame):
    with netCDF4.Dataset(path, "a") as data:
        data.frame = frame


def put(path, variable, index, value):
    with netCDF4.Dataset(path, "a") as data:
        data[variable][index] = value


def rename(path, variable):
    with netCDF4.Dataset(path, "a") as data:
        data.renameVariable(variable, "other")


def missing(path, variable):
    """Name one of the values the mark of what is missing."""
    with netCDF4.Dataset(path, "a") as data:
        data[variable].missing_value = data[variable][1, 2, 3]


def scale(path, variables, factor=1.0, shift=0.0):
    """Change all values of variables whose names begin alike."""
    with netCDF4.Dataset(path, "a") as data:
        for each in data.variables:
            if each.startswith(variables):
                data[each][:] = factor * data[each][:] + shift


def cut(path, share):
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])


def rewrite(path, part=None, **encoding):
    """Have xarray write a part of it, with an encoding of variables."""
    with xarray.open_dataset(path) as data:
        data.load()
    data.isel(part or {}).to_netcdf(path, encoding=encoding)


def overwrite(path, content):
    path.write_bytes(content)


def other_netcdf(path):
    xarray.Dataset({"z": ("x", np.zeros(4))}).to_netcdf(path)


def remove(path):
    path.unlink()


def make_folder(path):
    path.unlink()
    path.mkdir()


def missing_value(variable, value):
    return {"variable": variable, "missing_value": value}


PACKED = {"dtype": "i2", "scale_factor": 0.01, "_FillValue": -9}
NODE = (1, 2, 3)
ALL = slice(None)
OUTSIDE = (33.0, 33.1, 10.0, 11.0)
NO_NETCDF = "cannot be read as a netCDF file"
BAD = {
    "no vertical gradient": (rename, {"variable": "gradient_uu"}, "lacks gradient_uu"),
    "no disturbance": (rename, {"variable": "disturbance_e"}, "lacks disturbance_e"),
    "gradients per second squared": (
        edit,
        {"variable": "gradient_ee", "units": "s-2"},
        "gradient_ee has units 's-2'; it must be in '1e-9 s-2'",
    ),
    "disturbances in mGal": (
        edit,
        {"variable": "disturbance_n", "units": "mGal"},
        "disturbance_n has units 'mGal'",
    ),
    "latitudes in radians": (
        edit,
        {"variable": "latitude", "units": "radians"},
        "latitude has units 'radians'",
    ),
    "heights in kilometres": (
        edit,
        {"variable": "height", "units": "km"},
        "height has units 'km'; it must be in 'm'",
    ),
    "no units": (edit, {"variable": "gradient_nn", "units": ""}, "gradient_nn states no units"),
    "a scale factor": (
        edit,
        {"variable": "gradient_nn", "scale_factor": 2.0},
        "not packed, found scale_factor",
    ),
    "a value marked as missing": (
        missing,
        {"variable": "gradient_nn"},
        "gradient_nn has missing values",
    ),
    "a mark that is a word": (
        edit,
        missing_value("gradient_nn", "none"),
        "missing_value = 'none'; it must be a number",
    ),
    "a mark that moves the cursor": (
        edit,
        missing_value("disturbance_e", "\x1b[2J"),
        "missing_value = '�.2J'; it must be a",
    ),
    "a gradient that is not a number": (
        put,
        {"variable": "gradient_en", "index": NODE, "value": np.nan},
        "gradient_en has missing values",
    ),
    "an infinite disturbance": (
        put,
        {"variable": "disturbance_u", "index": NODE, "value": np.inf},
        "disturbance_u has missing values",
    ),
    "uneven latitudes": (
        put,
        {"variable": "latitude", "index": 3, "value": 33.0305},
        "latitude must be regular",
    ),
    "a longitude that is not a number": (
        put,
        {"variable": "longitude", "index": 3, "value": np.nan},
        "longitude must lie between",
    ),
    "one latitude for all": (
        put,
        {"variable": "latitude", "index": ALL, "value": 33.0},
        "latitude must be regular",
    ),
    "latitudes beyond the pole": (
        put,
        {"variable": "latitude", "index": ALL, "value": np.arange(9) + 85.0},
        "latitude must lie between -90 and 90",
    ),
    "heights in space": (
        put,
        {"variable": "height", "index": ALL, "value": np.arange(5) * 1e6},
        "height must lie between",
    ),
    "another frame": (turn, {"frame": "North-East-Down"}, "states its frame as 'North-East-Down'"),
    "one height": (rewrite, {"part": {"height": 0}}, "height must be one axis"),
    "three longitudes": (rewrite, {"part": {"longitude": slice(0, 3)}}, "at least 4 nodes"),
    "packed gradients": (rewrite, {"gradient_uu": PACKED}, "not packed"),
    "an empty file": (overwrite, {"content": b""}, NO_NETCDF),
    "words for a file": (overwrite, {"content": b"not a map" * 1000}, NO_NETCDF),
    "zeros below a header": (
        overwrite,
        {"content": b"\x89HDF\r\n\x1a\n" + b"\0" * 5000},
        NO_NETCDF,
    ),
    "half a file": (cut, {"share": 0.5}, "cannot be read"),
    "a file without its end": (cut, {"share": 0.98}, "cannot be read"),
    "no file": (remove, {}, "No such file"),
    "a folder": (make_folder, {}, "Is a directory"),
    "variables of another file": (
        other_netcdf,
        {},
        "lacks height, latitude, longitude, gradient_ee",
    ),
    "a region outside": (
        edit,
        {"variable": "height"},
        r"covers longitudes from 107.5000° to 107.7000°, and the region",
        OUTSIDE,
    ),
}
"""Changes of a map, their arguments, the message, and a region that is read."""
VALUES = {
    "a vertical gradient with a trace": (
        {"variables": "gradient_uu", "shift": 0.01},
        r"EE \+ NN \+ UU reaches 0.01 E and",
    ),
    "an eastern gradient with a trace": (
        {"variables": "gradient_ee", "factor": 1.001},
        r"EE \+ NN \+ UU reaches .* rounding allows",
    ),
    "gradients without measure": (
        {"variables": "gradient", "factor": 1e300},
        r"largest gradient is .*e\+300 E; .*10000 E",
    ),
    "gradients of a black hole": (
        {"variables": "gradient", "factor": 5e3},
        "at most 10000 E are allowed: correct the values or",
    ),
    "gradients per second squared": (
        {"variables": "gradient", "factor": 1e-9},
        "seem to be in s⁻²: multiply",
    ),
    "disturbances in mGal": (
        {"variables": "disturbance", "factor": 1e5},
        "m/s²; at most 0.1 m/s² are allowed: .*1 mGal is",
    ),
}
"""Values that no field has."""


@pytest.mark.parametrize("kind", BAD)
def test_a_bad_map_is_refused_with_its_path(kind, whole, tmp_path):
    change, options, message, *region = BAD[kind]
    path = tmp_path / "map.nc"
    path.write_bytes(whole)
    change(path, **options)
    with pytest.raises(MapError, match=message) as error:
        read(path, *region)
    assert str(path) in str(error.value)


@thinned("kind", VALUES)
def test_values_that_no_field_has_are_refused_in_all_readings(kind, whole, tmp_path):
    """Read as a whole or layer by layer."""
    options, message = VALUES[kind]
    path = tmp_path / "map.nc"
    path.write_bytes(whole)
    scale(path, **options)
    with pytest.raises(MapError, match=message):
        deque(netcdf_reader.read_layers(path)[2], maxlen=0)
    with pytest.raises(MapError, match=f"^{re.escape(str(path))}: .*{message}"):
        read(path)


@pytest.mark.parametrize("use", [read, netcdf_reader.read_layers, netcdf_reader.source_files])
def test_an_archive_of_an_earlier_version_is_refused_with_what_to_do(use, tmp_path):
    np.savez(tmp_path / "map.npz", **vars(some_map()))
    with pytest.raises(MapError, match=r"map.npz is a NumPy archive.* build it again"):
        use(tmp_path / "map.npz")
