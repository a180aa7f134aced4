"""Reading a geoid, gravity anomalies or gravity disturbances on a grid of the user's own."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from ..gravity.gradient_map import MapError
from ..gravity.meridians import Area, rolled, turns
from ..gravity.remove_restore import GravityGrid, linear_weights
from .shipped_regions import read_arrays

if TYPE_CHECKING:
    from ..gravity.terrain import Terrain

Array = NDArray[np.floating]

_TO_SI = {
    "mgal": 1e-5, "ugal": 1e-8, "µgal": 1e-8, "m/s2": 1.0, "m/s^2": 1.0, "m s-2": 1.0,
    "m s^-2": 1.0, "m/s**2": 1.0,
}  # fmt: skip
_METRES = {"m", "metre", "metres", "meter", "meters"}
_LARGEST = {"geoid": 150.0, "anomaly": 0.02, "disturbance": 0.02}  # [m], [m/s²]
_FEWEST = 16  # nodes per axis
_ON_NODE = 1e-6  # of a step: a bound that rounding puts next to a node


def read_grid(
    path: Path, kind: str, height_m: float = 0.0, area: Area | None = None
) -> GravityGrid:
    """Return the grid in a netCDF file (also GMT's), a raster, a ``.gdf`` or an ``.npz`` file.

    A netCDF file has one variable on latitude x longitude; its attribute ``units`` is m for a geoid
    and mGal or m/s² for gravity, in which mGal is taken when nothing is said. A raster (GeoTIFF,
    ESRI ASCII) is one of m or mGal. A ``.gdf`` file of ICGEM's calculation service
    says itself what unit and height it has. An ``.npz`` file has ``lat0``, ``lon0``, ``step``
    [deg] and ``N_1e4m`` [1e-4 m], a geoid.

    Parameters
    ----------
    path : of the file.
    kind : ``geoid``, ``anomaly`` or ``disturbance``.
    height_m : above the ellipsoid, where the values hold [m].
    area : where values are needed. A grid with gaps is cut to it, and one around the Earth opposite
        to it, unless it is held by the grid as it is. None: everywhere.

    Raises
    ------
    MapError
        If the file cannot be read, has gaps in the area, an irregular grid, other units, or values
        that such a grid cannot have.
    """
    try:
        path.open("rb").close()
    except OSError as error:
        raise MapError(f"cannot read the grid {path}: {error.strerror}") from None
    if path.suffix == ".npz":
        latitude, longitude, values = _from_archive(path, kind)
    elif path.suffix == ".gdf":
        latitude, longitude, values, own_height = _from_gdf(path, kind)
        if height_m not in (0.0, own_height):
            raise MapError(f"{path} holds at {own_height:g} m, not at --grid-height {height_m:g}.")
        height_m = own_height
    elif path.suffix in (".tif", ".tiff", ".asc"):
        latitude, longitude, values = _from_raster(path, kind, area)
    else:
        latitude, longitude, values = _from_netcdf(path, kind)
    longitude = np.unwrap(longitude, period=360.0)
    latitude, values = _ascending(latitude, values, 0)
    longitude, values = _ascending(longitude, values, 1)
    step_lat = _regular_step(path, "latitude", latitude)
    step_lon = _regular_step(path, "longitude", longitude)
    if area is not None:
        longitude, values = _cut_elsewhere(longitude, values, area)
        if not np.isfinite(values).all():
            latitude, longitude, values = _cropped(latitude, longitude, values, area)
    gaps = np.argwhere(~np.isfinite(values))
    if gaps.size:
        row, column = gaps[0]
        raise MapError(
            f"{path} has gaps: {len(gaps)} nodes without a value where they are needed, the first "
            f"at {latitude[row]:.5g}° N, {longitude[column]:.5g}° E; fill them, or build a map of "
            "a part without them, by its bounds."
        )
    if np.abs(values).max() > _LARGEST[kind]:
        unit = "m" if kind == "geoid" else "m/s²"
        raise MapError(
            f"{path} has values up to {np.abs(values).max():g} {unit}, which no {kind} grid can "
            f"have (at most {_LARGEST[kind]:g} {unit}): is it another quantity, or another unit?"
        )
    if longitude[0] >= 180.0:
        longitude = longitude - 360.0
    return GravityGrid(
        kind, float(latitude[0]), float(longitude[0]), step_lat, step_lon, values, height_m
    )


def elevation_at(grid: GravityGrid, terrain: Terrain) -> Array:
    """Heights of the land at the nodes of a grid [m], 0 at sea.

    A terrain finer than the grid is averaged first, by a Gaussian of half the grid's step.

    Raises MapError if the terrain does not cover the grid.
    """
    land = np.maximum(np.asarray(terrain.height_m, dtype=float), 0.0)
    latitude = terrain.south_deg + terrain.latitude_step_deg * np.arange(land.shape[0])
    longitude = terrain.west_deg + terrain.longitude_step_deg * np.arange(land.shape[1])
    longitude = longitude + turns(longitude.mean(), grid.longitude_deg.mean())
    axes = (("latitude", latitude, grid.latitude_deg), ("longitude", longitude, grid.longitude_deg))
    for name, has, needs in axes:
        slack = has[1] - has[0]
        if needs[0] < has[0] - slack or needs[-1] > has[-1] + slack:
            raise MapError(
                f"the terrain {terrain.name} covers {name}s from {has[0]:.3f}° to {has[-1]:.3f}°; "
                f"for the land correction it must cover the grid, {needs[0]:.3f}° to "
                f"{needs[-1]:.3f}°."
            )
    ratios = (
        grid.latitude_step_deg / terrain.latitude_step_deg,
        grid.longitude_step_deg / terrain.longitude_step_deg,
    )
    if max(ratios) > 1.0:
        land = gaussian_filter(land, [0.5 * ratio for ratio in ratios], mode="nearest")
    to_rows = linear_weights(latitude, np.clip(grid.latitude_deg, latitude[0], latitude[-1]))
    to_columns = linear_weights(longitude, np.clip(grid.longitude_deg, longitude[0], longitude[-1]))
    elevation: Array = to_rows @ land @ to_columns.T
    return elevation


def _from_archive(path: Path, kind: str) -> tuple[Array, Array, Array]:
    if kind != "geoid":
        raise MapError(f"{path}: an .npz file holds a geoid; for gravity give a netCDF file.")
    try:
        arrays = read_arrays(path.read_bytes(), ("lat0", "lon0", "step", "N_1e4m"))
        values = 1e-4 * np.asarray(arrays["N_1e4m"], dtype=float)
        south, west, step = (float(arrays[key]) for key in ("lat0", "lon0", "step"))
        n_lat, n_lon = values.shape
    except Exception as error:  # whatever a damaged archive makes of itself
        raise MapError(
            f"{path} holds no geoid: {error}; it must hold the arrays lat0, lon0, step and N_1e4m."
        ) from None
    return south + step * np.arange(n_lat), west + step * np.arange(n_lon), values


def _cut_elsewhere(longitude: Array, values: Array, area: Area) -> tuple[Array, Array]:
    """Longitudes and values, cut opposite to an area that a grid around the Earth ends in."""
    here = area.about(float(longitude.mean()))
    if here.west is None or here.east is None:
        return longitude, values
    if longitude[0] <= here.west <= here.east <= longitude[-1]:
        return longitude, values
    step = float(longitude[-1] - longitude[0]) / (longitude.size - 1)
    values, west = rolled(values, float(longitude[0]), step, 0.5 * (here.west + here.east))
    return west + step * np.arange(values.shape[1]), values


def _cropped(
    latitude: Array, longitude: Array, values: Array, area: Area
) -> tuple[Array, Array, Array]:
    """The part of a grid that covers an area, as far as it reaches."""
    here = area.about(float(longitude.mean()))
    parts = []
    for axis, low, high in ((latitude, *here[:2]), (longitude, *here[2:])):
        step = axis[1] - axis[0]
        first = 0 if low is None else math.floor((low - axis[0]) / step + _ON_NODE)
        last = axis.size - 1 if high is None else math.ceil((high - axis[0]) / step - _ON_NODE)
        first = min(max(first, 0), axis.size - _FEWEST)
        parts.append(slice(first, max(last, first + _FEWEST - 1) + 1))
    return latitude[parts[0]], longitude[parts[1]], values[parts[0], parts[1]]


def _from_raster(path: Path, kind: str, area: Area | None) -> tuple[Array, Array, Array]:
    from ..gravity.terrain_files import read_terrain

    raster = read_terrain(path, area)
    values = np.asarray(raster.height_m, dtype=float)
    latitude = raster.south_deg + raster.latitude_step_deg * np.arange(values.shape[0])
    longitude = raster.west_deg + raster.longitude_step_deg * np.arange(values.shape[1])
    return latitude, longitude, values * (1.0 if kind == "geoid" else _TO_SI["mgal"])


def _from_netcdf(path: Path, kind: str) -> tuple[Array, Array, Array]:
    import xarray

    try:
        with xarray.open_dataset(path) as dataset:
            dataset.load()
    except Exception as error:
        reason = str(error).split("\n", maxsplit=1)[0].split(". Consider", maxsplit=1)[0]
        raise MapError(f"{path} is no grid that can be read as netCDF: {reason}") from None
    names = {name: _axis_name(dataset, name) for name in ("latitude", "longitude")}
    dims = tuple(names.values())
    grids = [
        name
        for name, variable in dataset.data_vars.items()
        if None not in dims
        and set(variable.squeeze().dims) == set(dims)
        and variable.dtype.kind in "fiu"
    ]
    if len(grids) != 1:
        raise MapError(
            f"{path} must hold one variable on latitude and longitude; found "
            f"{', '.join(map(str, grids)) or 'none'}."
        )
    variable: Any = dataset[grids[0]].squeeze().transpose(*dims)
    units = str(variable.attrs.get("units", "")).strip().lower()
    values = variable.to_numpy().astype(float) * _factor(path, kind, units)
    latitude, longitude = (dataset[name].to_numpy().astype(float) for name in dims)
    return latitude, longitude, values


def _from_gdf(path: Path, kind: str) -> tuple[Array, Array, Array, float]:
    """Also the height above the ellipsoid at which the values hold [m]."""
    text = path.read_text(errors="replace")
    head, _, body = text.partition("end_of_head")
    header = {words[0]: words[1] for words in map(str.split, head.splitlines()) if len(words) > 1}
    try:
        rows = np.loadtxt(body.splitlines()[1:], ndmin=2)
        shape = int(header["latitude_parallels"]), int(header["longitude_parallels"])
        grid = rows.reshape(*shape, rows.shape[1])
        height = float(header.get("height_over_ell", 0.0)) if kind != "geoid" else 0.0
        gap = float(header.get("gapvalue", "nan"))
    except (ValueError, KeyError, IndexError) as error:
        raise MapError(f"{path} is no grid of ICGEM's format: {error}.") from None
    if grid.shape[2] != 3 and kind != "geoid":
        raise MapError(
            f"{path} has values at heights that vary, on the topography; they must hold at one "
            "height above the ellipsoid."
        )
    values = np.where(grid[:, :, -1] == gap, np.nan, grid[:, :, -1])
    values *= _factor(path, kind, header.get("unit", "").lower())
    return grid[:, 0, 1], grid[0, :, 0], values, height


def _factor(path: Path, kind: str, units: str) -> float:
    """SI units per unit of a file: nothing said is m or mGal."""
    allowed = dict.fromkeys(_METRES, 1.0) if kind == "geoid" else _TO_SI
    if units and units not in allowed:
        best = (
            "a geoid must be in 'm'" if kind == "geoid" else "gravity must be in 'mGal' or 'm/s2'"
        )
        raise MapError(f"{path} has units {units!r}; {best}.")
    return allowed[units or ("m" if kind == "geoid" else "mgal")]


def _axis_name(dataset: Any, wanted: str) -> str | None:
    """Name of the dimension that is the latitude or the longitude."""
    short = wanted[:3]
    for name in dataset.dims:
        coordinate = dataset.coords.get(name)
        standard = "" if coordinate is None else coordinate.attrs.get("standard_name", "")
        if coordinate is not None and (
            standard == wanted
            or str(name).lower() in (wanted, short, {"lat": "y", "lon": "x"}[short])
        ):
            return str(name)
    return None


def _ascending(axis: Array, values: Array, index: int) -> tuple[Array, Array]:
    if axis.size > 1 and axis[0] > axis[-1]:
        return axis[::-1], np.flip(values, index)
    return axis, values


def _regular_step(path: Path, name: str, axis: Array) -> float:
    if axis.size < _FEWEST:
        raise MapError(f"{path} has {axis.size} nodes in {name}; at least {_FEWEST} are needed.")
    step = float((axis[-1] - axis[0]) / (axis.size - 1))
    regular = np.linspace(axis[0], axis[-1], axis.size)
    if not (step > 0.0 and np.abs(axis - regular).max() < 1e-2 * step):
        raise MapError(f"{path}: its {name} must be regular, with one step between all nodes.")
    limit = 90.0 if name == "latitude" else 360.0
    if max(abs(axis[0]), abs(axis[-1])) > limit or not math.isfinite(step):
        raise MapError(f"{path}: its {name} must be in degrees, from -{limit:g} to {limit:g}.")
    return step
