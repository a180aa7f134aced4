"""Reader of single-band rasters, in GDAL formats with all values in one file.

Rasterio is an optional package, imported when needed.
"""

from __future__ import annotations

import contextlib
import os
import struct
import sys
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import map_coordinates, spline_filter

from ..errors import text_of
from .datums import is_another, name_of, vertical
from .meridians import Area
from .optional_modules import imported
from .regular_grid import Grid, check_size, regular_grid
from .terrain import FEWEST_NODES, TerrainError
from .units import HEIGHTS, Units, upward
from .voids import marks_removed, without_voids

Array = NDArray[np.floating]

_DRIVERS = {
    ".tif": "GTiff",
    ".tiff": "GTiff",
    ".asc": "AAIGrid",
    ".gtx": "GTX",
    ".isg": "ISG",
    ".byn": "BYN",
    ".gxf": "GXF",
}
"""Drivers of GDAL by suffix.

GDAL itself would choose the driver by content. A virtual raster with any suffix could then refer to
other files or to the network.
"""
_SURFER = {b"DSAA": "GSAG", b"DSBB": "GSBG", b"DSRB": "GS7BG"}
"""Drivers of Surfer's three formats, all named ``.grd``, by their first bytes."""
_NO_NETWORK = {"CPL_VSIL_CURL_ALLOWED_EXTENSIONS": ".none"}
_GEOSOFT_ELEMENTS = {1, 2, 4, 8, 1025, 1026, 1028, 1032}  # bytes, and with compression


def read_raster(path: Path, area: Area | None, units: Units) -> Grid:
    """Return the values of a single-band raster, in geographic or projected coordinates.

    ``area`` is the area in which values are needed; None: everywhere.

    Raises TerrainError if GDAL cannot read the file, if the file's format differs from the format
    of its suffix, or if the raster has a mask file.

    GDAL does not access the network. Besides the raster, GDAL reads files of the same name with
    other suffixes, such as ``.prj``, ``.tfw``, ``.wld`` and ``.aux.xml``.
    """
    rasterio = imported("rasterio", path)
    driver = _driver(path)
    _require_no_mask(path)
    try:
        # Its warnings concern what is refused here in a sentence.
        with (
            _silent(),
            warnings.catch_warnings(action="ignore"),
            rasterio.Env(**_NO_NETWORK),
            rasterio.open(path.absolute(), driver=driver) as dataset,
        ):
            return _from_dataset(dataset, path, area, units)
    except TerrainError:
        raise
    except Exception as error:  # GDAL's, rasterio's own, and those of its parsers of metadata
        raise TerrainError(_why_not(path, text_of(error))) from None


def _driver(path: Path) -> str:
    """Return the driver that may open a raster; raise TerrainError if its format is not allowed."""
    suffix = path.suffix.lower()
    driver = _DRIVERS.get(suffix)
    if suffix == ".grd":
        try:
            with path.open("rb") as file:
                driver = _SURFER.get(file.read(4))
        except OSError as error:
            raise TerrainError(f"{path} cannot be read: {error.strerror}.") from None
        if driver is None:
            raise TerrainError(_why_not(path, "it is not in a format of Surfer"))
    if driver is None:
        raise TerrainError(
            f"{path.name} cannot be read as a raster; allowed suffixes are "
            f"{', '.join([*_DRIVERS, '.grd'])}: convert it with gdal_translate."
        )
    return driver


def _require_no_mask(path: Path) -> None:
    """Raise TerrainError if a raster has a mask file.

    GDAL would choose the driver of the mask by content. A virtual mask could refer to other files
    or to the network.
    """
    for suffix in (".msk", ".MSK"):
        mask = path.with_name(path.name + suffix)
        if os.path.lexists(mask):
            raise TerrainError(
                f"{path.name} has a mask file, {mask.name}, which could refer to other files: give "
                "missing nodes a no-data value in the raster, and remove the mask file."
            )


@contextlib.contextmanager
def _silent() -> Iterator[None]:
    """Suppress the tracebacks that rasterio prints for messages of GDAL that it cannot decode.

    Such messages quote bytes of a damaged file. The fault is also raised as an exception.
    """
    hook = sys.unraisablehook
    sys.unraisablehook = lambda _: None
    try:
        yield
    finally:
        sys.unraisablehook = hook


def _why_not(path: Path, message: str) -> str:
    """Return the error message for a raster that GDAL cannot read.

    ``message`` is the message of GDAL.
    """
    if "proj.db" in message or "database context" in message:
        variables = [key for key in ("PROJ_DATA", "PROJ_LIB") if os.environ.get(key)]
        cause = (
            f"{variables[0]} = {os.environ[variables[0]]!r} points to another installation: "
            "unset it"
            if variables
            else "install rasterio again"
        )
        return f"{path.name} needs PROJ's database proj.db, which is not found; {cause}."
    if _is_geosoft(path):
        return (
            f"{path.name} is a Geosoft grid, which is not supported: export it from Oasis montaj "
            "or the free Geosoft Viewer as GeoTIFF or as a Surfer grid."
        )
    return f"{path.name} cannot be read as a raster ({message})."


def _is_geosoft(path: Path) -> bool:
    """Return whether a ``.grd`` file begins with the header of a Geosoft binary grid.

    The header has five integers: element size, sign, columns, rows and direction.
    """
    with path.open("rb") as file:
        head = file.read(20)
    if path.suffix.lower() != ".grd" or len(head) < 20:
        return False
    size, sign, columns, rows, direction = struct.unpack("<5i", head)
    is_valid = size in _GEOSOFT_ELEMENTS and sign in range(4) and abs(direction) == 1
    return is_valid and min(columns, rows) > 0


def _from_dataset(dataset: Any, path: Path, area: Area | None, units: Units) -> Grid:
    name, crs, transform = path.name, dataset.crs, dataset.transform
    if dataset.count != 1:
        raise TerrainError(
            f"{name} has {dataset.count} bands; exactly one band, with {units.what}, is allowed."
        )
    check_size(name, dataset.shape)
    if transform.is_identity:
        raise TerrainError(f"{name} is not georeferenced; add coordinates.")
    values, remarks = _values(dataset, name, units)
    rows, columns = (np.arange(count) + 0.5 for count in values.shape)
    # GDAL's transform is that of the corners of cells, for a raster of points, too.
    latitude, longitude = transform.f + transform.e * rows, transform.c + transform.a * columns
    if crs is not None and crs.is_geographic:
        if is_another(crs, float(longitude.mean()), float(latitude.mean()), path):
            remarks.append(f"from {name_of(crs)} to WGS 84")
            return _from_projected(values, transform, crs, path, remarks, area)
    elif crs is not None and crs.is_projected:
        return _from_projected(values, transform, crs, path, remarks, area)
    elif crs is not None:
        raise TerrainError(
            f"{name} has coordinates that are neither geographic nor projected: {crs}."
        )
    if transform.b or transform.d:
        raise TerrainError(
            f"{name} is rotated; rows must lie along parallels and columns along meridians."
        )
    return regular_grid(
        latitude,
        longitude,
        values,
        name,
        [*remarks, "no reference system given, degrees assumed" if crs is None else ""],
        area,
    )


def _values(dataset: Any, name: str, units: Units) -> tuple[Array, list[str]]:
    """Return the values of the band in SI units, with NaN for voids, and remarks."""
    described = dataset.descriptions[0] or ""
    units.require_named(described, name)
    factor, of_unit = units.factor(dataset.units[0] or "", name, described)
    band = dataset.read(1, masked=True).astype(float).filled(np.nan)
    values = (band * dataset.scales[0] + dataset.offsets[0]) * factor
    values, of_marks = marks_removed(band, values, units)
    of_sign = of_datum = ""
    if units.what == HEIGHTS.what:
        of_datum, down = vertical(dataset.crs)
        tags = {"positive": "down"} if down else dataset.tags(1)
        values, of_sign = upward(values, tags, described, name)
    return values, [of_unit, of_marks, of_sign, of_datum]


def _from_projected(
    values: Array, transform: Any, crs: Any, path: Path, remarks: Sequence[str], area: Area | None
) -> Grid:
    """Resample a projected raster to a grid regular in latitude and longitude.

    The grid lies within the edges of the raster. Values are interpolated by cubic splines.
    """
    warp = imported("rasterio.warp", path)

    def to_degrees(row: ArrayLike, column: ArrayLike) -> tuple[Array, Array]:
        row, column = (part.ravel() + 0.5 for part in np.broadcast_arrays(row, column))
        x = transform.a * column + transform.b * row + transform.c
        y = transform.d * column + transform.e * row + transform.f
        longitude, latitude = warp.transform(crs, "EPSG:4326", x, y)
        return np.array(latitude), np.unwrap(longitude, period=360.0)

    values, remark = without_voids(values, path.name, to_degrees, area)
    n_rows, n_columns = values.shape
    rows, columns = np.arange(n_rows), np.arange(n_columns)
    sides = [
        to_degrees(rows, 0),
        to_degrees(rows, n_columns - 1),
        to_degrees(0, columns),
        to_degrees(n_rows - 1, columns),
    ]
    (southern, *_, northern), (western, *_, eastern) = (
        sorted((side[axis] for side in sides), key=np.mean) for axis in (0, 1)
    )
    south, north = southern.max(), northern.min()
    west, east = western.max(), eastern.min()
    # Spacings as in the middle of the raster, so that all detail is kept.
    middle = (n_rows - 1) / 2, (n_columns - 1) / 2
    d_row, d_column = (
        np.ravel(to_degrees(middle[0] + step, middle[1] + 1.0 - step))
        - np.ravel(to_degrees(middle[0], middle[1]))
        for step in (1.0, 0.0)
    )
    latitude_step, longitude_step = np.maximum(np.abs(d_row), np.abs(d_column))
    shape = (int((north - south) / latitude_step) + 1, int((east - west) / longitude_step) + 1)
    if not (south < north and west < east and min(shape) >= FEWEST_NODES):
        raise TerrainError(
            f"{path.name} is not on WGS 84, and no latitude-longitude grid of at least "
            f"{FEWEST_NODES} x {FEWEST_NODES} nodes fits inside it: warp it to EPSG:4326 with "
            "gdalwarp."
        )
    check_size(path.name, shape)
    latitude = south + latitude_step * np.arange(shape[0])
    longitude = west + longitude_step * np.arange(shape[1])
    coefficients = spline_filter(values, 3, mode="mirror")
    resampled, inverse = np.empty(shape), ~transform
    for index, parallel in enumerate(latitude):
        x, y = (
            np.array(a)
            for a in warp.transform("EPSG:4326", crs, longitude, np.full(shape[1], parallel))
        )
        where = (
            inverse.d * x + inverse.e * y + inverse.f - 0.5,
            inverse.a * x + inverse.b * y + inverse.c - 0.5,
        )
        resampled[index] = map_coordinates(coefficients, where, mode="mirror", prefilter=False)
    remarks = [*remarks, remark, "resampled to latitude and longitude"]
    return regular_grid(latitude, longitude, resampled, path.name, remarks, area)
