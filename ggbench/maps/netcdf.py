"""Writer of gravity-gradient maps as self-describing netCDF files (CF conventions 1.11).

Each component of the tensor and of the gravity disturbance is one variable on height x latitude x
longitude, so programs for netCDF grids can draw it. A file is written layer by layer, without the
whole map in memory. Equal maps give files with equal bytes.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..files.netcdf import NETCDF_LOCK, new_netcdf_file
from ..files.writing import end_if_asked, written_whole
from ..gravity.ellipsoid import FLATTENING, SEMI_MAJOR_AXIS
from ..gravity.gradient_map import GradientMap, MapError, unknown
from ..numerics.source import VERSION

Array = NDArray[np.floating]
Layer = tuple[NDArray[Any], NDArray[Any]]
"""Tensor (n_lat, n_lon, 6) [E] and gravity disturbance (n_lat, n_lon, 3) [m/s²] at one height."""
Errors = tuple[NDArray[np.float64], NDArray[np.float64]]
"""Standard errors (9,) of the components, and their correlation distances (9,) [m]; or NaN."""

TENSOR = ("ee", "en", "eu", "nn", "nu", "uu")
VECTOR = ("e", "n", "u")
FORMAT = "ggbench gravity-gradient map 1"
ENU = "East-North-Up"
FRAME = f"geodetic {ENU} (ENU) on the WGS84 ellipsoid"
CONTENT = "disturbing field: normal field of WGS84 removed"
FEWEST_NODES = 4  # per axis, what a cubic spline needs
ERROR_KEYS = ("standard_error", "error_distance_m")
"""Attributes: standard error in the unit of the component; distance of correlation 1/e."""
_CHUNK = 256
AXES: dict[str, dict[str, Any]] = {
    "height": {
        "standard_name": "height_above_reference_ellipsoid",
        "long_name": "height above the WGS84 ellipsoid",
        "units": "m",
        "axis": "Z",
        "positive": "up",
    },
    "latitude": {
        "standard_name": "latitude",
        "long_name": "geodetic latitude",
        "units": "degrees_north",
        "axis": "Y",
    },
    "longitude": {
        "standard_name": "longitude",
        "long_name": "geodetic longitude",
        "units": "degrees_east",
        "axis": "X",
    },
}
BASE = "base_height"
"""Variable of a draped map: its base surface, on latitude x longitude."""
CLEARANCE = "clearance"
"""Dimension of a draped map in the place of the height."""
_CLEARANCE: dict[str, Any] = {
    "long_name": f"height above {BASE}, the base surface of the map",
    "units": "m",
    "axis": "Z",
    "positive": "up",
}
_BASE = {
    "standard_name": "height_above_reference_ellipsoid",
    "long_name": "height of the base surface above the WGS84 ellipsoid",
    "units": "m",
    "grid_mapping": "crs",
}
_CRS = {
    "grid_mapping_name": "latitude_longitude",
    "geographic_crs_name": "WGS 84",
    "reference_ellipsoid_name": "WGS 84",
    "semi_major_axis": SEMI_MAJOR_AXIS,
    "inverse_flattening": 1.0 / FLATTENING,
    "longitude_of_prime_meridian": 0.0,
    "prime_meridian_name": "Greenwich",
}


@dataclass(frozen=True)
class Nodes:
    """Nodes of a map: ascending and regular latitudes, longitudes [deg] and heights [m].

    For a draped map, ``height_m`` are heights above the base surface, and ``base_m`` (n_lat, n_lon)
    are heights of the base surface above the ellipsoid. ``base_m`` is None for level layers.
    """

    latitude_deg: Array
    longitude_deg: Array
    height_m: Array
    base_m: NDArray[np.float64] | None = None

    @property
    def shape(self) -> tuple[int, int, int]:
        """Number of latitudes, of longitudes and of heights."""
        return self.latitude_deg.size, self.longitude_deg.size, self.height_m.size

    def map_of(
        self,
        tensor: NDArray[np.float64],
        gravity_disturbance: NDArray[np.float64],
        provenance: str,
        errors: Errors | None = None,
    ) -> GradientMap:
        """Return a map of a disturbing field on these nodes.

        Parameters
        ----------
        tensor : (n_lat, n_lon, n_h, 6) disturbing gradient [E].
        gravity_disturbance : (n_lat, n_lon, n_h, 3) [m/s²].
        provenance : source of the map, in words.
        errors : standard errors of the components, and correlation distances of the errors [m];
            None: unknown.
        """
        axes = self.latitude_deg, self.longitude_deg, self.height_m
        latitude_step, longitude_step, height_step = map(step_of, axes)
        standard_error, error_distance = errors or (unknown(), unknown())
        return GradientMap(
            latitude0=math.radians(self.latitude_deg[0]),
            longitude0=math.radians(self.longitude_deg[0]),
            height0=float(self.height_m[0]),
            latitude_step=math.radians(latitude_step),
            longitude_step=math.radians(longitude_step),
            height_step=height_step,
            tensor=tensor,
            gravity_disturbance=gravity_disturbance,
            provenance=provenance,
            standard_error=standard_error,
            error_distance=error_distance,
            base=self.base_m,
        )


def axes_of(draped: bool) -> dict[str, dict[str, Any]]:
    """Return the names of the axes, in the order of the file, with their attributes."""
    if not draped:
        return AXES
    return {CLEARANCE: _CLEARANCE, **{name: AXES[name] for name in ("latitude", "longitude")}}


def step_of(axis: Array) -> float:
    """Return the distance between the nodes (N,) of a regular axis."""
    return float((axis[-1] - axis[0]) / (axis.size - 1))


def write_layers(
    path: Path,
    nodes: Nodes,
    layers: Iterable[Layer],
    attributes: Mapping[str, str],
    dtype: str = "float32",
    compression: int = 1,
    errors: Errors | None = None,
) -> None:
    """Write a map layer by layer; the file appears only when it is complete.

    Parameters
    ----------
    path : path of the file; a missing folder is created.
    nodes : nodes of the map.
    layers : tensor and gravity disturbance of each layer, from the lowest up.
    attributes : global attributes: title, source, history, ...
    dtype : ``float32`` (rounding error 1e-5 E in a field of 100 E) or ``float64``.
    compression : level of zlib, 0 (none) to 9.
    errors : standard errors of the map, if known.

    Raises
    ------
    MapError
        If the file cannot be written.
    """
    values = (len(TENSOR) + len(VECTOR)) * math.prod(nodes.shape)
    size = values * np.dtype(dtype).itemsize
    with (
        written_whole(path, MapError, "the map ", size) as temporary,
        new_netcdf_file(temporary) as file,
    ):
        with NETCDF_LOCK:
            _define(file, nodes, attributes, errors, dtype, compression)
        _write_layers(file, nodes, layers, dtype)


def write(path: Path, gradient_map: GradientMap, dtype: str = "float64") -> None:
    """Write a map from memory to a netCDF file.

    Longitudes are shifted by a multiple of 360° such that the middle of the map is within ±180°.

    Raises
    ------
    MapError
        If the file cannot be written.
    """
    n_lat, n_lon, n_h = gradient_map.tensor.shape[:3]
    south, west = math.degrees(gradient_map.latitude0), math.degrees(gradient_map.longitude0)
    longitude = west + math.degrees(gradient_map.longitude_step) * np.arange(n_lon)
    if np.abs(longitude).max() > 360.0:
        longitude = longitude - 360.0 * round(0.5 * (longitude[0] + longitude[-1]) / 360.0)
    nodes = Nodes(
        south + math.degrees(gradient_map.latitude_step) * np.arange(n_lat),
        longitude,
        gradient_map.height0 + gradient_map.height_step * np.arange(n_h),
        gradient_map.base,
    )
    layers = (
        (gradient_map.tensor[:, :, i], gradient_map.gravity_disturbance[:, :, i])
        for i in range(n_h)
    )
    attributes = {"title": "Gravity-gradient map", "source": gradient_map.provenance}
    has_errors = np.isfinite(gradient_map.standard_error).any()
    errors = (gradient_map.standard_error, gradient_map.error_distance) if has_errors else None
    write_layers(path, nodes, layers, attributes, dtype, errors=errors)


def _define(
    file: Any,
    nodes: Nodes,
    attributes: Mapping[str, str],
    errors: Errors | None,
    dtype: str,
    compression: int,
) -> None:
    """Write attributes and coordinates, and create empty variables for the layers."""
    file.setncatts(
        {
            "Conventions": "CF-1.11",
            "format": FORMAT,
            "ggbench_version": VERSION,
            "frame": FRAME,
            "comment": CONTENT,
            **attributes,
        }
    )
    file.createVariable("crs", "i4").setncatts(_CRS)
    axes = axes_of(nodes.base_m is not None)
    for name, axis in zip(
        axes, (nodes.height_m, nodes.latitude_deg, nodes.longitude_deg), strict=True
    ):
        file.createDimension(name, axis.size)
        variable = file.createVariable(name, "f8", (name,))
        variable.setncatts(axes[name])
        variable[:] = axis
    if nodes.base_m is not None:
        variable = file.createVariable(BASE, "f8", ("latitude", "longitude"), fletcher32=True)
        variable.setncatts(_BASE)
        variable[:] = nodes.base_m
    options: dict[str, Any] = {
        "zlib": compression > 0,
        "complevel": compression,
        "fletcher32": True,  # a damaged value is an error, never another number
        "chunksizes": (1, *map(_chunk, nodes.shape[:2])),
        "fill_value": False,
    }
    for index, (name, attrs) in enumerate(variables().items()):
        variable = file.createVariable(name, dtype, tuple(axes), **options)
        variable.setncatts({**attrs, **_error_of(errors, index), "grid_mapping": "crs"})


def _write_layers(file: Any, nodes: Nodes, layers: Iterable[Layer], dtype: str) -> None:
    """Write the values of all layers into the variables of a file."""
    count = 0
    for index, (tensor, disturbance) in enumerate(_ahead(layers)):
        end_if_asked()
        for prefix, names, values in (
            ("gradient_", TENSOR, tensor),
            ("disturbance_", VECTOR, disturbance),
        ):
            for component, name in enumerate(names):
                layer = np.ascontiguousarray(values[..., component], dtype=dtype)
                if not np.isfinite(layer).all():
                    raise MapError(
                        f"the field at {nodes.height_m[index]:g} m has values that are not "
                        "finite: no map is written."
                    )
                with NETCDF_LOCK:
                    file.variables[prefix + name][index] = layer
        count += 1
    if count != nodes.height_m.size:
        raise MapError(
            f"the map has {nodes.height_m.size} heights, but {count} layers were computed."
        )


def _error_of(errors: Errors | None, index: int) -> dict[str, float]:
    """Return the attributes for the standard error of the component ``index``."""
    errors_by_key = (
        {} if errors is None else dict(zip(ERROR_KEYS, (e[index] for e in errors), strict=True))
    )
    return {key: float(value) for key, value in errors_by_key.items() if np.isfinite(value)}


def _chunk(count: int) -> int:
    """Return the number of nodes per chunk for which all chunks are nearly full."""
    return math.ceil(count / math.ceil(count / _CHUNK))


def _ahead(layers: Iterable[Layer]) -> Iterator[Layer]:
    """Yield the layers; a thread computes the next layer while the caller writes this one."""
    iterator = iter(layers)
    with ThreadPoolExecutor(1) as pool:
        coming = pool.submit(next, iterator, None)
        while (layer := coming.result()) is not None:
            coming = pool.submit(next, iterator, None)
            yield layer


def variables() -> dict[str, dict[str, str]]:
    """Return the variable names of the nine components in a file, with their attributes."""
    words = {"e": "east", "n": "north", "u": "up"}
    gradients = {
        f"gradient_{name}": {
            "long_name": "disturbing gravity-gradient tensor, component "
            f"{name.upper()} ({words[name[0]]}-{words[name[1]]})",
            "units": "1e-9 s-2",
            "unit_name": "Eötvös (E)",
        }
        for name in TENSOR
    }
    disturbances = {
        f"disturbance_{name}": {
            "long_name": f"gravity disturbance vector, component {words[name]}",
            "units": "m s-2",
        }
        for name in VECTOR
    }
    return gradients | disturbances


def described(items: Mapping[str, Any]) -> str:
    """Return a mapping as one line of JSON, for an attribute of a file."""
    return json.dumps(dict(items), ensure_ascii=False, default=str)
