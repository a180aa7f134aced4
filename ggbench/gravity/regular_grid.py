"""Grids regular in latitude and longitude, made from rows and columns in any order."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .meridians import Area, rolled
from .terrain import FEWEST_NODES, TerrainError, require_latitudes
from .voids import without_voids

Array = NDArray[np.floating]

_MOST_CELLS = 100_000_000
_IRREGULAR = 0.02  # of a step: more than coordinates in single precision are off
_AXIS_UNITS = {
    "latitude": re.compile(r"deg(?:ree)?s?_?n(?:orth)?"),
    "longitude": re.compile(r"deg(?:ree)?s?_?e(?:ast)?"),
}
"""Patterns of the units of latitude and longitude in the CF conventions."""
_SHORT = {"latitude": ("lat",), "longitude": ("lon", "long")}
_DEGREES = re.compile(r"deg|°")
_REVERSED = re.compile(r"(?:west|south|_w|_s)$")
_NETCDF = (b"CDF", b"\x89HDF")


class Grid(NamedTuple):
    """Values on a regular grid, from south to north and from west to east, without voids.

    Attributes
    ----------
    south, west : the first node [deg].
    latitude_step, longitude_step : distances between nodes, positive [deg].
    values : (n_lat, n_lon), in SI units.
    remarks : texts on changes that were made to the values.
    """

    south: float
    west: float
    latitude_step: float
    longitude_step: float
    values: Array
    remarks: list[str]


def regular_grid(
    latitude: Array,
    longitude: Array,
    values: Array,
    name: str,
    remarks: Sequence[str],
    area: Area | None,
) -> Grid:
    """Return a grid from rows and columns in any order, with voids filled.

    Parameters
    ----------
    latitude, longitude : latitudes of the rows (n_lat,) and longitudes of the columns (n_lon,)
        [deg].
    values : (n_lat, n_lon); voids are NaN.
    name : name of the file, for messages.
    remarks : texts on earlier changes of the values; empty texts are omitted.
    area : area in which values are needed; None: everywhere.

    Raises
    ------
    TerrainError
        If the nodes are not regular, or there are too many voids.
    """
    for axis, count in zip((latitude, longitude), values.shape, strict=True):
        if axis.shape != (count,):
            raise TerrainError(
                f"{name} has heights of shape {values.shape}, but {latitude.shape} latitudes and "
                f"{longitude.shape} longitudes."
            )
    longitude = np.unwrap(np.asarray(longitude, dtype=float), period=360.0)
    south, latitude_step, flipped = _regular(np.asarray(latitude, dtype=float), "latitudes", name)
    values = values[::-1] if flipped else values
    west, longitude_step, flipped = _regular(longitude, "longitudes", name)
    values = values[:, ::-1] if flipped else values
    require_latitudes(name, south, south + latitude_step * (values.shape[0] - 1))
    west = (west + 180.0) % 360.0 - 180.0
    if area is not None:
        values, west = cut_elsewhere(values, west, longitude_step, area)

    def to_degrees(row: NDArray[Any], column: NDArray[Any]) -> tuple[Array, Array]:
        return south + latitude_step * row, west + longitude_step * column

    values, remark = without_voids(values, name, to_degrees, area)
    all_remarks = list(filter(None, [*remarks, remark]))
    return Grid(
        south, west, latitude_step, longitude_step, np.ascontiguousarray(values), all_remarks
    )


def _regular(axis: Array, what: str, name: str) -> tuple[float, float, bool]:
    """Return first node and step of the coordinates in ascending order, and a flag.

    The flag is True if ``axis`` is descending. ``what`` names the coordinates in messages.

    Raises TerrainError if the coordinates are too few or not evenly spaced.
    """
    if axis.size < FEWEST_NODES:
        raise TerrainError(f"{name} has {axis.size} {what}; at least {FEWEST_NODES} are needed.")
    step = float(axis[-1] - axis[0]) / (axis.size - 1)
    nodes = axis[0] + step * np.arange(axis.size)
    if not (step != 0.0 and np.abs(axis - nodes).max() <= _IRREGULAR * abs(step)):  # NaN fails too
        raise TerrainError(
            f"{name} has {what} that are not evenly spaced; a regular grid is needed."
        )
    if step < 0.0:
        return float(axis[-1]), -step, True
    return float(axis[0]), step, False


def cut_elsewhere(values: Array, west: float, step: float, area: Area) -> tuple[Array, float]:
    """Return a grid (n_lat, n_lon) with the area in one piece, and the grid's first longitude.

    A global grid is rolled in longitude if its edge crosses the area. The edge is then opposite to
    the area. Other grids are unchanged.

    Parameters
    ----------
    values : (n_lat, n_lon) values of the grid.
    west, step : first longitude and spacing of the columns [deg].
    area : area in which values are needed.
    """
    width = step * (values.shape[1] - 1)
    placed = area.about(west + 0.5 * width)
    if (
        placed.west is None
        or placed.east is None
        or west <= placed.west <= placed.east <= west + width
    ):
        return values, west
    return rolled(values, west, step, 0.5 * (placed.west + placed.east))


def check_size(name: str, shape: tuple[int, ...]) -> None:
    """Raise TerrainError if a grid of this shape has too many cells."""
    if np.prod(shape, dtype=float) > _MOST_CELLS:
        raise TerrainError(
            f"{name} has {' x '.join(map(str, shape))} cells; at most {_MOST_CELLS:.0g} are "
            "allowed: cut out the region with gdal_translate -projwin."
        )


def is_netcdf(path: Path) -> bool:
    """Return whether a file has the signature of netCDF version 3 or 4."""
    with path.open("rb") as file:
        return file.read(4).startswith(_NETCDF)


def axis_of(name: str, coordinate: Any, generic: str, file: str) -> str | None:
    """Return ``latitude`` or ``longitude`` for a coordinate of a netCDF file; None if neither.

    The units, the standard name and the name of the coordinate determine the result. If none of
    them does, the result is ``generic``, or None if ``generic`` is "". Callers pass ``latitude``
    for a coordinate named y, and ``longitude`` for x.

    Raises TerrainError if units, standard name and name contradict each other; if the coordinate is
    not in degrees north or east; if a latitude is described as colatitude or geocentric.
    """
    attributes = {key: str(value).strip().lower() for key, value in coordinate.attrs.items()}
    unit = attributes.get("units", "")
    by_unit = next((kind for kind, form in _AXIS_UNITS.items() if form.fullmatch(unit)), None)
    standard = attributes.get("standard_name", "")
    by_name = next((kind for kind in _AXIS_UNITS if name.lower() in (kind, *_SHORT[kind])), None)
    stated = {by_unit, standard if standard in _AXIS_UNITS else None, by_name} - {None}
    if len(stated) > 1:
        raise TerrainError(
            f"{file}: units {unit!r} or standard_name {standard!r} contradict the name of the "
            f"coordinate {name}."
        )
    kind = str(stated.pop()) if stated else generic
    if not kind:
        return None
    if (unit and not _DEGREES.match(unit)) or _REVERSED.search(unit):
        raise TerrainError(
            f"{file} has {name} in {unit!r}; degrees are needed, positive north and east: warp "
            "the grid to EPSG:4326, for example with gdalwarp."
        )
    if re.search(r"co-?lat|geocentric", attributes.get("long_name", "")):
        raise TerrainError(
            f"{file} has {name} described as {attributes['long_name']!r}; geodetic latitudes are "
            "needed."
        )
    return kind


def refuse_old_gmt(dataset: Any, name: str) -> None:
    """Raise TerrainError if an open netCDF file is a grid of GMT version 3.

    Such grids store all values in one row.
    """
    if {"x_range", "y_range", "dimension", "z"} <= set(map(str, dataset.variables)):
        raise TerrainError(
            f"{name} is a grid in the format of GMT 3, without coordinates; convert it with "
            f"'gmt grdconvert {name}=cf new.nc'."
        )
