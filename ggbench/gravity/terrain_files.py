"""Readers of digital elevation models: rasters, netCDF grids, NumPy archives.

Rasterio and xarray are imported when a file needs them: they are an optional part of the
installation.
"""

from __future__ import annotations

import importlib
import stat
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import map_coordinates, spline_filter

from .meridians import Area, rolled
from .terrain import FEWEST_NODES, Terrain, TerrainError, require_latitudes
from .voids import VOID_MARKS, without_voids

Array = NDArray[np.floating]

_MOST_CELLS = 100_000_000
_IRREGULAR = 0.02  # of a step: more than coordinates in single precision are off
_METRES = {
    **dict.fromkeys(("", "m", "metre", "meter", "metres", "meters", "metre(s)"), 1.0),
    **dict.fromkeys(("ft", "foot", "feet", "international foot"), 0.3048),
    **dict.fromkeys(("us-ft", "ftus", "us survey foot", "foot_us"), 1200.0 / 3937.0),
    **dict.fromkeys(("dm", "decimetre", "decimeter"), 0.1),
    **dict.fromkeys(("cm", "centimetre", "centimeter"), 0.01),
    **dict.fromkeys(("km", "kilometre", "kilometer"), 1000.0),
}
_LATITUDE_NAMES = ("lat", "latitude", "y")
_LONGITUDE_NAMES = ("lon", "long", "longitude", "x")
_HEIGHT_NAMES = ("z", "elevation", "band1", "altitude", "topo", "topography", "height")


def _import(module: str, path: Path) -> Any:
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise TerrainError(
            f"{path.name} needs the package {module.partition('.')[0]} ({error}): pip install "
            "'ggbench[terrain]'."
        ) from None


def _read_raster(path: Path, area: Area | None) -> Terrain:
    """Read whatever GDAL reads, of one band, in degrees or projected."""
    rasterio = _import("rasterio", path)
    try:
        # Its warnings concern what is refused here in a sentence.
        with warnings.catch_warnings(action="ignore"), rasterio.open(path) as dataset:
            return _from_dataset(dataset, path, area)
    except TerrainError:
        raise
    except Exception as error:  # GDAL's, rasterio's own, and those of its parsers of metadata
        raise TerrainError(
            f"{path.name} cannot be read as a raster ({_one_line(error)})."
        ) from None


def _from_dataset(dataset: Any, path: Path, area: Area | None) -> Terrain:
    name, crs, transform = path.name, dataset.crs, dataset.transform
    if dataset.count != 1:
        raise TerrainError(f"{name} has {dataset.count} bands; one, of heights, is allowed.")
    _check_size(name, dataset.shape)
    if transform.is_identity:
        raise TerrainError(f"{name} does not say where it lies; a georeferenced raster is allowed.")
    factor, remark = _metres(dataset.units[0] or "", name)
    band = dataset.read(1, masked=True).astype(float).filled(np.nan)
    band[np.isin(band, VOID_MARKS)] = np.nan
    heights = (band * dataset.scales[0] + dataset.offsets[0]) * factor
    if crs is not None and crs.is_projected:
        return _from_projected(heights, transform, crs, path, [remark], area)
    if not (crs is None or crs.is_geographic):
        raise TerrainError(
            f"{name} has coordinates that are neither geographic nor projected: {crs}."
        )
    if transform.b or transform.d:
        raise TerrainError(
            f"{name} is rotated; rows along parallels and columns along meridians are allowed."
        )
    rows, columns = (np.arange(count) + 0.5 for count in heights.shape)
    # GDAL's transform is that of the corners of cells, for a raster of points, too.
    return _terrain(
        transform.f + transform.e * rows,
        transform.c + transform.a * columns,
        heights,
        name,
        [remark, "no reference system given, taken as degrees" if crs is None else ""],
        area,
    )


def _from_projected(
    heights: Array, transform: Any, crs: Any, path: Path, remarks: list[str], area: Area | None
) -> Terrain:
    """Resample a projected raster, by cubic splines, to a box of degrees within its edges."""
    warp = _import("rasterio.warp", path)

    def to_degrees(row: ArrayLike, column: ArrayLike) -> tuple[Array, Array]:
        row, column = (part.ravel() + 0.5 for part in np.broadcast_arrays(row, column))
        x = transform.a * column + transform.b * row + transform.c
        y = transform.d * column + transform.e * row + transform.f
        longitude, latitude = warp.transform(crs, "EPSG:4326", x, y)
        return np.array(latitude), np.unwrap(longitude, period=360.0)

    heights, remark = without_voids(heights, path.name, to_degrees, area)
    n_rows, n_columns = heights.shape
    rows, columns = np.arange(n_rows), np.arange(n_columns)
    sides = [
        to_degrees(rows, 0), to_degrees(rows, n_columns - 1),
        to_degrees(0, columns), to_degrees(n_rows - 1, columns),
    ]  # fmt: skip
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
            f"{path.name} is projected, and no box of latitudes and longitudes fits into it: warp "
            "it to EPSG:4326 with gdalwarp."
        )
    _check_size(path.name, shape)
    latitude = south + latitude_step * np.arange(shape[0])
    longitude = west + longitude_step * np.arange(shape[1])
    coefficients = spline_filter(heights, 3, mode="mirror")
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
    return _terrain(latitude, longitude, resampled, path.name, remarks, area)


def _read_netcdf(path: Path, area: Area | None) -> Terrain:
    """Read the heights of a netCDF file, of version 3 or 4, with coordinates in degrees."""
    xarray = _import("xarray", path)
    _import("netCDF4", path)
    try:
        with xarray.open_dataset(path, engine="netcdf4", decode_times=False) as dataset:
            return _from_variables(dataset, path.name, area)
    except TerrainError:
        raise
    except Exception as error:  # the engines raise a dozen kinds
        raise TerrainError(
            f"{path.name} cannot be read as a netCDF grid ({_one_line(error)})."
        ) from None


def _from_variables(dataset: Any, name: str, area: Area | None) -> Terrain:
    grids = {}
    for key, variable in dataset.data_vars.items():
        if variable.dtype.kind not in "iuf":
            continue
        squeezed = variable.squeeze(drop=True)
        axes = {_axis_kind(dataset, dim): dim for dim in squeezed.dims}
        if squeezed.ndim == 2 and axes.keys() == {"latitude", "longitude"}:
            grids[str(key)] = squeezed.transpose(axes["latitude"], axes["longitude"])
    if len(grids) > 1:
        named = {key: grid for key, grid in grids.items() if key.lower() in _HEIGHT_NAMES}
        grids = named or grids
    if len(grids) != 1:
        raise TerrainError(
            f"{name} has {len(grids)} grids in latitude and longitude "
            f"({', '.join(grids) or 'none'}); one, or one named {', '.join(_HEIGHT_NAMES)}, with "
            "coordinate variables lat and lon, or x and y, is allowed."
        )
    ((_, grid),) = grids.items()
    _check_size(name, grid.shape)
    latitude, longitude = (dataset[dim] for dim in grid.dims)
    for axis in (latitude, longitude):
        unit = str(axis.attrs.get("units", "degrees"))
        if not unit.lower().startswith("deg"):
            raise TerrainError(f"{name} has {axis.name} in {unit!r}; degrees are allowed.")
    factor, remark = _metres(str(grid.attrs.get("units", "")), name)
    heights = np.asarray(grid.values, dtype=float) * factor
    return _terrain(latitude.values, longitude.values, heights, name, [remark], area)


def _axis_kind(dataset: Any, dimension: Any) -> str | None:
    """Whether a dimension is one of latitude or longitude, by its coordinate variable."""
    if dimension not in dataset.variables:
        return None
    name = str(dimension).lower()
    standard = str(dataset[dimension].attrs.get("standard_name", "")).lower()
    if "projection" in standard:
        raise TerrainError(
            f"The coordinate {dimension} is one of a projection; degrees are allowed: warp the "
            "grid to EPSG:4326 with gdalwarp."
        )
    if standard == "latitude" or name in _LATITUDE_NAMES:
        return "latitude"
    return "longitude" if standard == "longitude" or name in _LONGITUDE_NAMES else None


def _read_npz(path: Path, area: Area | None) -> Terrain:
    """Read a NumPy archive with one of three sets of arrays."""
    try:
        with np.load(path, allow_pickle=False) as archive:
            arrays = {key: archive[key] for key in archive.files}
        return _from_arrays(arrays, path.name, area)
    except TerrainError:
        raise
    except Exception as error:  # whatever a damaged archive makes of itself
        raise TerrainError(
            f"{path.name} cannot be read as a NumPy archive of heights ({_one_line(error)})."
        ) from None


def _from_arrays(arrays: Mapping[str, Any], name: str, area: Area | None) -> Terrain:
    if {"lat", "lon", "z"} <= arrays.keys():
        heights = arrays["z"].astype(float)
        return _terrain(arrays["lat"], arrays["lon"], heights, name, [], area)
    if {"south_deg", "west_deg", "latitude_step_deg", "longitude_step_deg", "height_m"} <= set(
        arrays
    ):
        heights = arrays["height_m"].astype(float)
        rows, columns = (np.arange(count) for count in heights.shape)
        return _terrain(
            float(arrays["south_deg"]) + float(arrays["latitude_step_deg"]) * rows,
            float(arrays["west_deg"]) + float(arrays["longitude_step_deg"]) * columns,
            heights,
            name,
            [str(arrays["name"])] if "name" in arrays else [],
            area,
        )
    if {"elevation", "xmin", "ymax", "dx", "dy"} <= arrays.keys():
        # As matplotlib's sample jacksboro_fault_dem.npz: the first row is the northern one, and
        # the bounds are those of cells. That file's ymin is not used: it lies to the north of
        # ymax by the height of the grid, instead of to the south.
        heights = arrays["elevation"].astype(float)
        rows, columns = (np.arange(count) + 0.5 for count in heights.shape)
        latitude = float(arrays["ymax"]) - float(arrays["dy"]) * rows
        longitude = float(arrays["xmin"]) + float(arrays["dx"]) * columns
        return _terrain(latitude, longitude, heights, name, [], area)
    raise TerrainError(
        f"{name} has the arrays {', '.join(sorted(arrays))}; those of a Terrain, or lat, lon and "
        "z, or elevation, xmin, ymax, dx and dy are allowed."
    )


def _terrain(
    latitude: Array,
    longitude: Array,
    heights: Array,
    name: str,
    remarks: list[str],
    area: Area | None,
) -> Terrain:
    """A terrain of rows and columns in any order, voids being NaN or one of the usual marks."""
    for axis, count in zip((latitude, longitude), heights.shape, strict=True):
        if axis.shape != (count,):
            raise TerrainError(
                f"{name} has heights of shape {heights.shape}, but {latitude.shape} latitudes and "
                f"{longitude.shape} longitudes."
            )
    longitude = np.unwrap(np.asarray(longitude, dtype=float), period=360.0)
    south, latitude_step, flipped = _regular(np.asarray(latitude, dtype=float), "latitudes", name)
    heights = heights[::-1] if flipped else heights
    west, longitude_step, flipped = _regular(longitude, "longitudes", name)
    heights = heights[:, ::-1] if flipped else heights
    require_latitudes(name, south, south + latitude_step * (heights.shape[0] - 1))
    west = (west + 180.0) % 360.0 - 180.0
    if area is not None:
        heights, west = _cut_elsewhere(heights, west, longitude_step, area)

    def to_degrees(row: NDArray[Any], column: NDArray[Any]) -> tuple[Array, Array]:
        return south + latitude_step * row, west + longitude_step * column

    heights, remark = without_voids(heights, name, to_degrees, area)
    shape = " x ".join(map(str, heights.shape))
    words = [f"{name} ({shape})", *filter(None, [*remarks, remark])]
    return Terrain(
        south, west, latitude_step, longitude_step, np.ascontiguousarray(heights), ", ".join(words)
    )


def _regular(axis: Array, what: str, name: str) -> tuple[float, float, bool]:
    """First node and step of ascending coordinates, and whether they were descending."""
    if axis.size < FEWEST_NODES:
        raise TerrainError(f"{name} has {axis.size} {what}; at least {FEWEST_NODES} are allowed.")
    step = float(axis[-1] - axis[0]) / (axis.size - 1)
    nodes = axis[0] + step * np.arange(axis.size)
    if not (step != 0.0 and np.abs(axis - nodes).max() <= _IRREGULAR * abs(step)):  # NaN fails too
        raise TerrainError(
            f"{name} has {what} that are not evenly spaced; a regular grid is allowed."
        )
    if step < 0.0:
        return float(axis[-1]), -step, True
    return float(axis[0]), step, False


def _cut_elsewhere(heights: Array, west: float, step: float, area: Area) -> tuple[Array, float]:
    """Heights and their first longitude, cut opposite to an area that a global grid ends in."""
    width = step * (heights.shape[1] - 1)
    here = area.about(west + 0.5 * width)
    if here.west is None or here.east is None or west <= here.west <= here.east <= west + width:
        return heights, west
    return rolled(heights, west, step, 0.5 * (here.west + here.east))


def _metres(unit: str, name: str) -> tuple[float, str]:
    """Metres per unit of height, and what to say of it."""
    factor = _METRES.get(unit.strip().lower())
    if factor is None:
        raise TerrainError(f"{name} has heights in {unit!r}; metres or feet are allowed.")
    return factor, "" if factor == 1.0 else f"converted from {unit}"


def _check_size(name: str, shape: tuple[int, ...]) -> None:
    if np.prod(shape, dtype=float) > _MOST_CELLS:
        raise TerrainError(
            f"{name} has {' x '.join(map(str, shape))} cells; at most {_MOST_CELLS:.0g} are "
            "allowed: cut out the region with gdal_translate -projwin."
        )


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split()) or type(error).__name__


_READERS: dict[str, Callable[[Path, Area | None], Terrain]] = {
    ".tif": _read_raster,
    ".tiff": _read_raster,
    ".hgt": _read_raster,
    ".asc": _read_raster,
    ".nc": _read_netcdf,
    ".grd": _read_netcdf,
    ".npz": _read_npz,
}
"""Readers by the suffix of the file."""


def read_terrain(path: Path, area: Area | None = None) -> Terrain:
    """Read a digital elevation model.

    Parameters
    ----------
    path : by its suffix, a raster (``.tif``, ``.tiff``, ``.hgt``, ``.asc``), a CF or GMT netCDF
        grid (``.nc``, ``.grd``) or a NumPy archive (``.npz``) with the arrays of a
        :class:`Terrain`, or ``lat``, ``lon`` and ``z``, or ``elevation``, ``xmin``, ``ymax``,
        ``dx`` and ``dy``.
    area : where the heights are needed: voids elsewhere are filled with the nearest cell, however
        many they are, and a grid around the Earth is cut opposite to it. None: everywhere.

    Returns
    -------
    The terrain. Projected rasters are resampled to latitude and longitude, feet become metres, and
    voids of less than one per cent of the cells are filled; its name says so.

    Raises
    ------
    TerrainError : a file missing, damaged or of another kind, an optional package missing, a grid
        that is not regular in latitude and longitude, voids of one per cent or more of the area, an
        unknown unit, heights outside -12000 to 9000 m.
    """
    path = Path(path)
    reader = _READERS.get(path.suffix.lower())
    try:
        is_folder = stat.S_ISDIR(path.stat().st_mode)
    except FileNotFoundError:
        raise TerrainError(f"There is no terrain file {path}.") from None
    except (OSError, ValueError) as error:
        raise TerrainError(f"The terrain file {str(path)!r} cannot be read: {error}.") from None
    if is_folder:
        raise TerrainError(f"{path} is a folder; a terrain is a file ({', '.join(_READERS)}).")
    if reader is None:
        raise TerrainError(
            f"{path.name} is of no kind that is known by its suffix; allowed: "
            f"{', '.join(_READERS)}."
        )
    return reader(path, area)
