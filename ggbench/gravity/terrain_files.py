"""Readers of digital elevation models: rasters, netCDF grids, NumPy archives.

Rasterio and xarray are optional packages, imported when needed.
"""

from __future__ import annotations

import math
import re
import stat
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import text_of
from ..files.archives import read_arrays
from ..files.netcdf import netcdf_file
from .datums import require_wgs84
from .meridians import Area
from .rasters import read_raster
from .regular_grid import Grid, axis_of, check_size, is_netcdf, refuse_old_gmt, regular_grid
from .terrain import Terrain, TerrainError
from .units import HEIGHTS, Units, unit_of, upward
from .voids import marks_removed

Array = NDArray[np.floating]

_GENERIC = {"y": "latitude", "x": "longitude"}
_HEIGHT_NAMES = ("z", "elevation", "band1", "altitude", "topo", "topography", "height")
_OF_A_TERRAIN = {"south_deg", "west_deg", "latitude_step_deg", "longitude_step_deg", "height_m"}
_TILE_NAME = re.compile(r"([NS])(\d{2})([EW])(\d{3})", re.IGNORECASE)
_TILE_VOID = -32768
_ROUGH = 200.0  # median step between neighbours that no terrain has [m]
_HALF_TILE = (3601, 1801)  # rows and columns, near the poles


def _read_grd(path: Path, area: Area | None, units: Units) -> Grid:
    """Read a ``.grd`` file: netCDF of GMT, or a format of Surfer."""
    return _read_netcdf(path, area, units) if is_netcdf(path) else read_raster(path, area, units)


def _read_tile(path: Path, area: Area | None, units: Units) -> Grid:
    """Read a tile of one degree: big-endian 16-bit integers.

    The name of the file states the south-western corner, for example N36W085.hgt.
    """
    corner = _TILE_NAME.match(path.name)
    if corner is None:
        raise TerrainError(
            f"{path.name} has no position: the name of a .hgt file must begin with its "
            "south-western corner, for example N36W085.hgt."
        )
    values = np.fromfile(path, ">i2")
    shape = (math.isqrt(values.size),) * 2
    if values.size == _HALF_TILE[0] * _HALF_TILE[1]:
        shape = _HALF_TILE
    if 2 * shape[0] * shape[1] != path.stat().st_size or shape[0] < 2:
        raise TerrainError(
            f"{path.name} has {path.stat().st_size} bytes; a square of 16-bit integers is "
            "needed, for example 1201 x 1201 or 3601 x 3601."
        )
    check_size(path.name, shape)
    _require_big_endian(path.name, values)
    written = np.where(values == _TILE_VOID, np.nan, values.astype(float)).reshape(shape)
    heights, of_marks = marks_removed(written, written, units)
    south = int(corner[2]) * (1 if corner[1] in "nN" else -1)
    west = int(corner[4]) * (1 if corner[3] in "eE" else -1)
    latitude, longitude = (np.linspace(0.0, 1.0, count) for count in shape)
    return regular_grid(
        south + latitude[::-1], west + longitude, heights, path.name, [of_marks], area
    )


def _require_big_endian(name: str, values: NDArray[np.int16]) -> None:
    """Raise TerrainError if heights (N,) are much smoother with their bytes swapped."""
    roughness, swapped = (
        float(np.median(np.abs(np.diff(each.astype(float)))))
        for each in (values, values.byteswap())
    )
    if roughness > _ROUGH and swapped < 0.1 * roughness:
        raise TerrainError(
            f"{name} has its bytes in the wrong order, little-endian: swap them, for example with "
            "'dd conv=swab'."
        )


def _read_netcdf(path: Path, area: Area | None, units: Units) -> Grid:
    """Read the heights of a netCDF file, of version 3 or 4, with coordinates in degrees."""
    with netcdf_file(path, TerrainError, path.name, "xarray") as dataset:
        return _from_variables(dataset, path, area, units)


def _from_variables(dataset: Any, path: Path, area: Area | None, units: Units) -> Grid:
    name = path.name
    refuse_old_gmt(dataset, name)
    grids = {}
    for key, variable in dataset.data_vars.items():
        if variable.dtype.kind not in "iuf":
            continue
        squeezed = variable.squeeze(drop=True)
        axes = {_axis_kind(dataset, dim, name): dim for dim in squeezed.dims}
        if squeezed.ndim == 2 and axes.keys() == {"latitude", "longitude"}:
            grids[str(key)] = squeezed.transpose(axes["latitude"], axes["longitude"])
    if len(grids) > 1:
        named = {key: grid for key, grid in grids.items() if key.lower() in _HEIGHT_NAMES}
        grids = named or grids
    if len(grids) != 1:
        raise TerrainError(
            f"{name} has {len(grids)} variables on latitude and longitude "
            f"({', '.join(grids) or 'none'}); it must have one, or name exactly one of them "
            f"{', '.join(_HEIGHT_NAMES[:-1])} or {_HEIGHT_NAMES[-1]}. The coordinates may be "
            "named lat and lon, or x and y."
        )
    ((key, grid),) = grids.items()
    check_size(name, grid.shape)
    latitude, longitude = (dataset[dim] for dim in grid.dims)
    place = float(longitude.values.mean()), float(latitude.values.mean())
    require_wgs84(dataset.variables, grid, place, path)
    described = str(grid.attrs.get("long_name", ""))
    units.require_named(f"{key} {described}", name)
    factor, of_unit = units.factor(unit_of(grid.attrs), name, described)
    written = np.asarray(grid.values, dtype=float)
    heights, of_marks = marks_removed(written, written * factor, units)
    heights, of_sign = upward(heights, grid.attrs, key, name)
    remarks = [of_unit, of_marks, of_sign]
    return regular_grid(latitude.values, longitude.values, heights, name, remarks, area)


def _axis_kind(dataset: Any, dimension: Any, file: str) -> str | None:
    """Return whether a dimension is latitude or longitude, or None if it is neither.

    The coordinate variable of the dimension decides, see :func:`.regular_grid.axis_of`.
    """
    if dimension not in dataset.variables:
        return None
    name = str(dimension)
    standard = str(dataset[dimension].attrs.get("standard_name", "")).lower()
    if "projection" in standard:
        raise TerrainError(
            f"The coordinate {dimension} belongs to a projection; degrees are needed: warp the "
            "grid to EPSG:4326 with gdalwarp."
        )
    return axis_of(name, dataset[dimension], _GENERIC.get(name.lower(), ""), file)


def _read_npz(path: Path, area: Area | None, units: Units) -> Grid:
    """Read a NumPy archive with one of three sets of arrays."""
    arrays = read_arrays(path, TerrainError, path.name)
    try:
        return _from_arrays(arrays, path.name, area, units)
    except TerrainError:
        raise
    except Exception as error:  # whatever arrays of other kinds make of themselves
        raise TerrainError(
            f"{path.name} cannot be read as a NumPy archive of heights ({text_of(error)})."
        ) from None


def _from_arrays(arrays: Mapping[str, Any], name: str, area: Area | None, units: Units) -> Grid:
    remarks = []
    if {"lat", "lon", "z"} <= arrays.keys():
        written = arrays["z"].astype(float)
        latitude, longitude = arrays["lat"], arrays["lon"]
    elif arrays.keys() >= _OF_A_TERRAIN:
        written = arrays["height_m"].astype(float)
        rows, columns = (np.arange(count) for count in written.shape)
        latitude = float(arrays["south_deg"]) + float(arrays["latitude_step_deg"]) * rows
        longitude = float(arrays["west_deg"]) + float(arrays["longitude_step_deg"]) * columns
        remarks = [str(arrays["name"])] if "name" in arrays else []
    elif {"elevation", "xmin", "ymax", "dx", "dy"} <= arrays.keys():
        # As matplotlib's sample jacksboro_fault_dem.npz: the first row is the northern one, and
        # the bounds are those of cells. That file's ymin is not used: it lies to the north of
        # ymax by the height of the grid, instead of to the south.
        written = arrays["elevation"].astype(float)
        rows, columns = (np.arange(count) + 0.5 for count in written.shape)
        latitude = float(arrays["ymax"]) - float(arrays["dy"]) * rows
        longitude = float(arrays["xmin"]) + float(arrays["dx"]) * columns
    else:
        raise TerrainError(
            f"{name} has the arrays {', '.join(sorted(arrays))}; it must have one of these sets: "
            "(lat, lon, z), (elevation, xmin, ymax, dx, dy) or "
            f"({', '.join(sorted(_OF_A_TERRAIN))})."
        )
    heights, of_marks = marks_removed(written, written, units)
    return regular_grid(latitude, longitude, heights, name, [*remarks, of_marks], area)


_READERS: dict[str, Callable[[Path, Area | None, Units], Grid]] = {
    ".tif": read_raster,
    ".tiff": read_raster,
    ".hgt": _read_tile,
    ".asc": read_raster,
    ".nc": _read_netcdf,
    ".grd": _read_grd,
    ".npz": _read_npz,
}
"""Readers by the suffix of the file."""


def read_terrain(path: Path, area: Area | None = None, voids: Sequence[float] = ()) -> Terrain:
    """Read a digital elevation model.

    Parameters
    ----------
    path : by its suffix, a raster (``.tif``, ``.tiff``, ``.asc``), a tile (``.hgt``), a CF or GMT
        netCDF grid (``.nc``, ``.grd``), a Surfer grid (``.grd``) or a NumPy archive (``.npz``). An
        archive has the arrays of a :class:`Terrain`; or ``lat``, ``lon`` and ``z``; or
        ``elevation``, ``xmin``, ``ymax``, ``dx`` and ``dy``.
    area : area in which heights are needed; None: everywhere. Voids outside the area are filled,
        however many there are. A global grid is rolled in longitude if its edge crosses the area.
    voids : additional values in the file that mark voids.

    Returns
    -------
    The terrain. Projected rasters are resampled to latitude and longitude, feet are converted to
    metres, depths become negative heights, and voids in less than one per cent of the cells are
    filled. The name of the terrain states these changes.

    Raises
    ------
    TerrainError : if the file is missing, damaged or of another kind; if an optional package is
        missing; if the grid is not regular in latitude and longitude; if voids cover one per cent
        or more of the area; if a unit is unknown; if heights are outside -12000 to 9000 m.
    """
    path = Path(path)
    reader = _READERS.get(path.suffix.lower())
    try:
        is_folder = stat.S_ISDIR(path.stat().st_mode)
    except FileNotFoundError:
        raise TerrainError(f"There is no terrain file {path}.") from None
    except (OSError, ValueError) as error:
        raise TerrainError(
            f"The terrain file {str(path)!r} cannot be read: {text_of(error)}."
        ) from None
    if is_folder:
        raise TerrainError(f"{path} is a folder; a terrain is a file ({', '.join(_READERS)}).")
    if reader is None:
        raise TerrainError(f"{path.name} has an unknown suffix; allowed: {', '.join(_READERS)}.")
    grid = reader(path, area, replace(HEIGHTS, voids=tuple(voids)))
    shape = " x ".join(map(str, grid.values.shape))
    return Terrain(*grid[:5], ", ".join([f"{path.name} ({shape})", *grid.remarks]))
