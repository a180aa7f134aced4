"""Reader of users' grids of a geoid, gravity anomalies or gravity disturbances."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from ..errors import text_of
from ..files.archives import MOST_ARRAYS, read_arrays
from ..files.netcdf import netcdf_file
from ..gravity.datums import require_wgs84
from ..gravity.gradient_map import MapError
from ..gravity.meridians import Area, turns
from ..gravity.quantity_names import named_quantities
from ..gravity.rasters import read_raster
from ..gravity.regular_grid import axis_of, cut_elsewhere, is_netcdf, refuse_old_gmt
from ..gravity.remove_restore import GravityGrid, linear_weights
from ..gravity.terrain import TerrainError
from ..gravity.units import GEOID, GRAVITY, Units, unit_of
from ..gravity.voids import marks_removed
from .icgem_grid import ReadGrid, read_icgem

if TYPE_CHECKING:
    from ..gravity.terrain import Terrain

Array = NDArray[np.floating]

_UNITS = {"geoid": GEOID, "anomaly": GRAVITY, "disturbance": GRAVITY}
_FEWEST = 16  # nodes per axis
_ON_NODE = 1e-6  # of a step: a bound that rounding puts next to a node
_GENERIC = {"y": "latitude", "x": "longitude"}
_HEIGHT_ANOMALY = re.compile(r"height[ _]?anomal|quasi[ _-]?geoid", re.IGNORECASE)


def read_grid(
    path: Path,
    kind: str,
    height_m: float = 0.0,
    area: Area | None = None,
    voids: Sequence[float] = (),
) -> GravityGrid:
    """Return the grid of a netCDF file (CF or GMT), raster, ``.gdf`` or ``.npz`` file.

    A netCDF file has one variable on latitude x longitude, with its unit in the attribute
    ``units``. The unit of a raster is that of its band. Allowed are metres or feet for a geoid, and
    mGal, µGal, Gal or m/s² for gravity. Without a unit, m or mGal is assumed. A raster is a
    GeoTIFF, ESRI ASCII, GTX, ISG, BYN, GXF or Surfer grid, as its suffix indicates. A ``.gdf`` file
    of ICGEM's calculation service states its quantity, unit and height. An ``.npz`` file contains a
    geoid: ``lat0``, ``lon0``, ``step`` [deg] and ``N_1e4m`` [1e-4 m].

    Parameters
    ----------
    path : path of the file.
    kind : ``geoid``, ``anomaly`` or ``disturbance``.
    height_m : height of the values above the ellipsoid [m].
    area : area in which values are needed; None: everywhere. A grid with gaps is cropped to the
        area. A global grid is rolled in longitude if its edge crosses the area.
    voids : additional values in the file that mark gaps.

    Raises
    ------
    MapError
        If the file cannot be read, has gaps in the area, is not regular, has other units, or has
        impossible values.
    """
    units = dataclasses.replace(_UNITS[kind], voids=tuple(voids), kind=kind)
    try:
        path.open("rb").close()
    except OSError as error:
        raise MapError(f"cannot read the grid {path}: {error.strerror}") from None
    try:
        read = _read(path, kind, area, units)
    except TerrainError as error:
        raise MapError(str(error)) from None
    if read.height_m is not None:
        if height_m not in (0.0, read.height_m):
            raise MapError(
                f"{path} refers to a height of {read.height_m:g} m, not to --grid-height "
                f"{height_m:g}."
            )
        height_m = read.height_m
    latitude, longitude, values = read[:3]
    if np.abs(longitude).max(initial=0.0) <= 360.0:  # else it is refused for that
        longitude = np.unwrap(longitude, period=360.0)
    latitude, values = _ascending(latitude, values, 0)
    longitude, values = _ascending(longitude, values, 1)
    step_lat = _regular_step(path, "latitude", latitude)
    step_lon = _regular_step(path, "longitude", longitude)
    if area is not None:
        values, west = cut_elsewhere(values, float(longitude[0]), step_lon, area)
        longitude = west + step_lon * np.arange(values.shape[1])
        if not np.isfinite(values).all():
            latitude, longitude, values = _cropped(latitude, longitude, values, area)
    gaps = np.argwhere(~np.isfinite(values))
    if gaps.size:
        row, column = gaps[0]
        raise MapError(
            f"{path} has gaps: {len(gaps)} nodes without a value in the area needed, the first "
            f"at {latitude[row]:.5g}° N, {longitude[column]:.5g}° E; fill them, or choose bounds "
            "without gaps."
        )
    largest = units.highest
    if np.abs(values).max() > largest:
        unit = "m" if kind == "geoid" else "m/s²"
        raise MapError(
            f"{path} has values up to {np.abs(values).max():g} {unit}; values of {kind} are at "
            f"most {largest:g} {unit}: check the quantity, the unit, and the void value (--void "
            "VALUE)."
        )
    if longitude[0] >= 180.0:
        longitude = longitude - 360.0
    return GravityGrid(
        kind=kind,
        south_deg=float(latitude[0]),
        west_deg=float(longitude[0]),
        latitude_step_deg=step_lat,
        longitude_step_deg=step_lon,
        values=values,
        height_m=height_m,
        is_height_anomaly=read.is_height_anomaly,
        remarks=read.remarks,
    )


def elevation_at(grid: GravityGrid, terrain: Terrain) -> Array:
    """Return the land heights (n_lat, n_lon) [m] at the nodes of a grid; 0 at sea.

    A terrain finer than the grid is smoothed first, by a Gaussian with a standard deviation of half
    the grid's step.

    Raises MapError if the terrain does not cover the grid.
    """
    land = np.maximum(np.asarray(terrain.height_m, dtype=float), 0.0)
    latitude, longitude = terrain.latitudes_deg, terrain.longitudes_deg
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


def _read(path: Path, kind: str, area: Area | None, units: Units) -> ReadGrid:
    """Read the grid of a file; its suffix or its first bytes determine the format."""
    suffix = path.suffix.lower()
    if suffix == ".npz":
        return _from_archive(path, kind, units)
    if suffix == ".gdf":
        return _from_gdf(path, kind, units)
    if suffix == ".nc" or is_netcdf(path):
        return _from_netcdf(path, kind, units)
    return _from_raster(path, area, units)


def _from_archive(path: Path, kind: str, units: Units) -> ReadGrid:
    if kind != "geoid":
        raise MapError(f"{path}: an .npz file holds a geoid; for gravity give a netCDF file.")
    arrays = read_arrays(path, MapError, str(path), ("lat0", "lon0", "step", "N_1e4m"))
    try:
        written = np.asarray(arrays["N_1e4m"], dtype=float)
        values, _ = marks_removed(written, 1e-4 * written, units)
        south, west, step = (float(arrays[key]) for key in ("lat0", "lon0", "step"))
        n_lat, n_lon = values.shape
    except Exception as error:  # whatever arrays of other kinds make of themselves
        raise MapError(
            f"{path} contains no geoid: {text_of(error)}; the arrays lat0, lon0, step and N_1e4m "
            "are needed."
        ) from None
    return ReadGrid(south + step * np.arange(n_lat), west + step * np.arange(n_lon), values)


def _cropped(
    latitude: Array, longitude: Array, values: Array, area: Area
) -> tuple[Array, Array, Array]:
    """Return the smallest part of a grid that covers an area, as far as the grid extends."""
    placed = area.about(float(longitude.mean()))
    parts = []
    for axis, low, high in ((latitude, *placed[:2]), (longitude, *placed[2:])):
        step = axis[1] - axis[0]
        first = 0 if low is None else math.floor((low - axis[0]) / step + _ON_NODE)
        last = axis.size - 1 if high is None else math.ceil((high - axis[0]) / step - _ON_NODE)
        first = min(max(first, 0), axis.size - _FEWEST)
        parts.append(slice(first, max(last, first + _FEWEST - 1) + 1))
    return latitude[parts[0]], longitude[parts[1]], values[parts[0], parts[1]]


def _from_raster(path: Path, area: Area | None, units: Units) -> ReadGrid:
    grid = read_raster(path, area, units)
    n_lat, n_lon = grid.values.shape
    return ReadGrid(
        grid.south + grid.latitude_step * np.arange(n_lat),
        grid.west + grid.longitude_step * np.arange(n_lon),
        grid.values,
        _named(path, *grid.remarks),
    )


def _from_netcdf(path: Path, kind: str, units: Units) -> ReadGrid:
    with netcdf_file(path, MapError, str(path), "xarray") as dataset:
        if dataset.nbytes > MOST_ARRAYS:
            raise MapError(
                f"{path} contains {dataset.nbytes / 1e6:.0f} MB of arrays; at most "
                f"{MOST_ARRAYS / 1e6:g} are allowed: crop it to the area of the map."
            )
        dataset.load()
    refuse_old_gmt(dataset, path.name)
    kinds = {
        axis_of(str(name), dataset.coords[name], _GENERIC.get(str(name).lower(), ""), path.name): (
            str(name)
        )
        for name in dataset.dims
        if name in dataset.coords
    }
    dims = tuple(kinds.get(kind) for kind in ("latitude", "longitude"))
    if "ggxfVersion" in dataset.attrs:
        raise MapError(
            f"{path} is a GGXF file, which is not supported: convert it to GeoTIFF or to netCDF "
            "with latitude and longitude."
        )
    grids = [
        name
        for name, variable in dataset.data_vars.items()
        if None not in dims
        and set(variable.squeeze().dims) == set(dims)
        and variable.dtype.kind in "fiu"
    ]
    if len(grids) != 1:
        larger = [
            f"{name} on {', '.join(f'{dim} ({size})' for dim, size in variable.sizes.items())}"
            for name, variable in dataset.data_vars.items()
            if set(dims) < set(variable.dims)
        ]
        raise MapError(
            f"{path} must contain one variable on latitude and longitude; found "
            f"{', '.join(map(str, grids or larger)) or 'none'}."
        )
    variable: Any = dataset[grids[0]].squeeze().transpose(*dims)
    called = " ".join(
        [str(grids[0]), *(str(variable.attrs.get(k, "")) for k in ("long_name", "standard_name"))]
    )
    texts = [called, variable.attrs.get("description", ""), dataset.attrs.get("title", "")]
    units.require_named(next(filter(named_quantities, map(str, texts)), called), path.name)
    unit = unit_of(variable.attrs)
    values, remarks = _in_si(path, variable.to_numpy().astype(float), unit, units, called)
    latitude, longitude = (dataset[name].to_numpy().astype(float) for name in dims)
    place = float(longitude.mean()), float(latitude.mean())
    require_wgs84(dataset.variables, variable, place, path)
    is_height_anomaly = kind == "geoid" and _HEIGHT_ANOMALY.search(called) is not None
    return ReadGrid(latitude, longitude, values, remarks, None, is_height_anomaly)


def _from_gdf(path: Path, kind: str, units: Units) -> ReadGrid:
    grid, unit = read_icgem(path, kind)
    values, remarks = _in_si(path, grid.values, unit, units)
    return grid._replace(values=values, remarks=(*remarks, *grid.remarks))


def _in_si(
    path: Path, written: Array, unit: str, units: Units, described: str = ""
) -> tuple[Array, tuple[str, ...]]:
    """Return the values in SI units, NaN at gaps, and remarks on the unit and the gaps."""
    factor, of_unit = units.factor(unit, path.name, described)
    values, of_marks = marks_removed(written, written * factor, units)
    return values, _named(path, of_unit, of_marks)


def _named(path: Path, *remarks: str) -> tuple[str, ...]:
    """Return the non-empty remarks, each with the name of the file in front."""
    return tuple(f"{path.name}: {remark}" for remark in remarks if remark)


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
    limit, unwrapped = (90.0, 90.0) if name == "latitude" else (360.0, 720.0)
    if max(abs(axis[0]), abs(axis[-1])) > unwrapped or not math.isfinite(step):
        raise MapError(f"{path}: its {name} must be in degrees, from -{limit:g} to {limit:g}.")
    return step
