"""Reader of untrusted netCDF files of gravity-gradient maps.

:mod:`ggbench.maps.netcdf` describes the format and writes it.
"""

from __future__ import annotations

import contextlib
import json
import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import text_of
from ..files.netcdf import netcdf_file
from ..gravity.gradient_map import GradientMap, MapError, unknown
from ..gravity.meridians import Area
from . import checks
from .netcdf import (
    AXES,
    BASE,
    CLEARANCE,
    ENU,
    ERROR_KEYS,
    FEWEST_NODES,
    TENSOR,
    VECTOR,
    Layer,
    Nodes,
    axes_of,
    step_of,
    variables,
)

Array = NDArray[np.floating]

_MARGIN_NODES = 4  # kept around a crop: there the ends of a spline are felt
_UNITS = {
    "height": {"m", "metre", "metres", "meter", "meters"},
    "latitude": {"degrees_north", "degree_north", "degrees_n", "degree_n"},
    "longitude": {"degrees_east", "degree_east", "degrees_e", "degree_e"},
    "gradient": {"1e-9 s-2", "1e-09 s-2", "1e-9 s^-2", "e", "eotvos", "eötvös"},
    "disturbance": {"m s-2", "m/s2", "m/s^2", "m s^-2", "m/s**2"},
}
_LIMITS = {"height": (-12e3, 1e6), "latitude": (-90.0, 90.0), "longitude": (-360.0, 360.0)}


def read(path: Path, crop: Area | None = None) -> GradientMap:
    """Return the map of a netCDF file in the format of this package.

    Dimensions may be in any order, and latitudes and heights may descend. With ``crop`` only the
    nodes of this area and of a small margin are read.

    Raises MapError if the file does not exist or is not a complete map; the message states the
    fault.
    """
    with _opened(path) as file:
        nodes, slices = _read_nodes(path, file)
        keep = _kept(path, nodes, crop)
        shape = tuple(s.stop - s.start for s in keep.values())
        checks.require_size(str(path), shape, checks.MOST_NODES_READ)
        tensor = _read_components(path, file, "gradient", TENSOR, keep, slices)
        disturbance = _read_components(path, file, "disturbance", VECTOR, keep, slices)
        checks.require_possible(str(path), tensor, disturbance)
        provenance = _text(file, "source") or path.name
        errors = [_errors(path, file, key) for key in ERROR_KEYS]
        base = _read_base(path, file, keep, slices)
    cropped = {name: values[keep[name]] for name, values in nodes.items()}
    return Nodes(cropped["latitude"], cropped["longitude"], cropped["height"], base).map_of(
        tensor, disturbance, provenance, (errors[0], errors[1])
    )


def read_layers(path: Path) -> tuple[Nodes, dict[str, str], Iterator[Layer]]:
    """Return the nodes, the attributes and an iterator over the layers of a file.

    Layers are read one at a time, from the lowest up. Raises MapError in the cases of :func:`read`.
    Invalid values raise MapError when the iterator reaches their layer.
    """
    with _opened(path) as file:
        nodes, descends = _read_nodes(path, file)
        shape = tuple(values.size for values in nodes.values())
        checks.require_size(str(path), shape, checks.MOST_NODES)
        checks.require_size(f"a layer of {path}", shape[:2], checks.MOST_NODES_READ)
        attributes = {key: _text(file, key) for key in file.ncattrs()}
        base = _read_base(path, file, _kept(path, nodes, None), descends)
    return (
        Nodes(nodes["latitude"], nodes["longitude"], nodes["height"], base),
        attributes,
        _layers(path, nodes, descends),
    )


def source_files(path: Path) -> dict[str, str]:
    """Return the name and SHA-256 of each file from which a map was made.

    The result is empty if the map does not state them. Raises MapError if the file does not exist.
    """
    with _opened(path) as file:
        text = _text(file, "source_files")
    try:
        files = json.loads(text)
        return {checks.clean_text(str(name)): checks.clean_text(str(files[name])) for name in files}
    except (ValueError, TypeError):
        return {}


def _layers(path: Path, nodes: Mapping[str, Array], descends: dict[str, bool]) -> Iterator[Layer]:
    """Yield the layers, from the lowest up.

    The file is closed between layers, so that another thread can open another file.
    """
    whole = _kept(path, nodes, None)
    for index, height in enumerate(nodes["height"]):
        keep = whole | {"height": slice(index, index + 1)}
        with _opened(path, again=True) as file:
            tensor, disturbance = (
                _read_components(path, file, prefix, names, keep, descends)[:, :, 0]
                for prefix, names in (("gradient", TENSOR), ("disturbance", VECTOR))
            )
        checks.require_possible(f"{path}, at {height:g} m", tensor, disturbance)
        yield tensor, disturbance


@contextlib.contextmanager
def _opened(path: Path, again: bool = False) -> Iterator[Any]:
    """Open a netCDF file without masking or scaling; raise MapError for another format."""
    if path.suffix == ".npz" and path.is_file():
        raise MapError(
            f"{path} is a NumPy archive; maps are netCDF files: build it again with 'ggbench map "
            "build -o MAP.nc'."
        )
    with netcdf_file(path, MapError, f"the map {path}", again=again) as file:
        file.set_auto_maskandscale(False)
        yield file


def _read_nodes(path: Path, file: Any) -> tuple[dict[str, Array], dict[str, bool]]:
    """Return ascending coordinates by name, and whether each descends in the file.

    ``height`` is the height above the base surface if the map is draped.
    """
    axes = axes_of(_is_draped(file))
    names = [*axes, *([BASE] if _is_draped(file) else []), *variables()]
    missing = [name for name in names if name not in file.variables]
    if missing:
        raise MapError(
            f"{path} is not a gradient map: it lacks {', '.join(missing)}; 'ggbench map build' "
            "writes complete maps."
        )
    frame = _text(file, "frame")
    if frame and ENU not in frame:
        raise MapError(f"{path} states its frame as {frame!r}; it must be geodetic {ENU}.")
    nodes, descends = {}, {}
    for name in ("latitude", "longitude", "height"):
        variable = file.variables[_stored(file, name)]
        _require_units(path, name, variable, _UNITS[name])
        if variable.size > checks.MOST_ON_AXIS:
            raise MapError(
                f"{path}: {name} has {variable.size} values; at most {checks.MOST_ON_AXIS} can be "
                "read."
            )
        values = _values(path, name, variable, ())
        if values.ndim != 1 or values.size < FEWEST_NODES:
            raise MapError(
                f"{path}: {name} must be one axis of at least {FEWEST_NODES} nodes, found shape "
                f"{values.shape}."
            )
        if name == "longitude":  # of a map across the date line
            values = np.unwrap(values, period=360.0)
        descends[name] = bool(values[0] > values[-1])
        if descends[name]:
            values = values[::-1]
        lowest, highest = _LIMITS[name]
        if not (np.isfinite(values).all() and lowest <= values[0] <= values[-1] <= highest):
            raise MapError(f"{path}: {name} must lie between {lowest:g} and {highest:g}.")
        regular = np.linspace(values[0], values[-1], values.size)
        if step_of(values) <= 0.0 or np.abs(values - regular).max() > 1e-4 * step_of(values):
            raise MapError(f"{path}: {name} must be regular, with one step between all nodes.")
        nodes[name] = regular
    if nodes["longitude"][0] >= 180.0:  # a scenario's longitudes go from -180 to 180
        nodes["longitude"] = nodes["longitude"] - 360.0
    for name in variables():
        variable = file.variables[name]
        kind = name.split("_", maxsplit=1)[0]
        _require_units(path, name, variable, _UNITS[kind])
        if sorted(variable.dimensions) != sorted(axes):
            raise MapError(
                f"{path}: {name} must have the dimensions {', '.join(axes)}, in any order; found "
                f"{', '.join(variable.dimensions) or 'none'}."
            )
        _require_numbers(path, name, variable)
        packed = {"scale_factor", "add_offset"} & set(variable.ncattrs())
        if packed or np.dtype(variable.dtype).kind != "f":
            raise MapError(
                f"{path}: {name} must hold floating-point numbers that are not packed, found "
                f"{', '.join(sorted(packed)) or variable.dtype}."
            )
    return nodes, descends


def _kept(path: Path, nodes: Mapping[str, Array], crop: Area | None) -> dict[str, slice]:
    """Return the slice of nodes to read along each axis.

    Raises MapError if ``crop`` does not overlap the map.
    """
    keep = {name: slice(0, values.size) for name, values in nodes.items()}
    if crop is None:
        return keep
    crop = Area(*crop).about(float(nodes["longitude"].mean()))
    for name, low, high in (("latitude", *crop[:2]), ("longitude", *crop[2:])):
        values, step = nodes[name], step_of(nodes[name])
        low = values[0] if low is None else low
        high = values[-1] if high is None else high
        if not (low <= values[-1] + step and high >= values[0] - step and low <= high):
            raise MapError(
                f"{path} covers {name}s from {values[0]:.4f}° to {values[-1]:.4f}°, and the "
                f"region needed is {low:.4f}° to {high:.4f}°."
            )
        first = math.floor((low - values[0]) / step) - _MARGIN_NODES
        last = math.ceil((high - values[0]) / step) + _MARGIN_NODES
        first = min(max(first, 0), values.size - FEWEST_NODES)
        last = max(min(last, values.size - 1), first + FEWEST_NODES - 1)
        keep[name] = slice(first, last + 1)
    return keep


def _read_components(
    path: Path,
    file: Any,
    prefix: str,
    names: tuple[str, ...],
    keep: Mapping[str, slice],
    descends: Mapping[str, bool],
) -> NDArray[np.float64]:
    """Return the components (n_lat, n_lon, n_h, len(names)) at the nodes in ``keep``."""
    order = ("latitude", "longitude", "height")
    shape = tuple(keep[name].stop - keep[name].start for name in order)
    out = np.empty((*shape, len(names)))
    for component, name in enumerate(names):
        variable = file.variables[f"{prefix}_{name}"]
        dims = ["height" if dim == CLEARANCE else dim for dim in variable.dimensions]
        index = tuple(
            _mirrored(keep[dim], size) if descends[dim] else keep[dim]
            for dim, size in zip(dims, variable.shape, strict=True)
        )
        values = _values(path, f"{prefix}_{name}", variable, index)
        values = np.transpose(values, [dims.index(dim) for dim in order])
        flip = tuple(slice(None, None, -1 if descends[dim] else 1) for dim in order)
        out[..., component] = values[flip]
        if not np.isfinite(out[..., component]).all() or _has_fill(variable, values):
            raise MapError(
                f"{path}: {prefix}_{name} has missing values or values that are not finite."
            )
    return out


def _is_draped(file: Any) -> bool:
    """Return whether a map is draped, that is, has layers at heights above a base surface."""
    return CLEARANCE in file.variables


def _stored(file: Any, name: str) -> str:
    """Return the variable name of an axis in a file."""
    return CLEARANCE if name == "height" and _is_draped(file) else name


def _read_base(
    path: Path, file: Any, keep: Mapping[str, slice], descends: Mapping[str, bool]
) -> NDArray[np.float64] | None:
    """Return the base surface (n_lat, n_lon) [m] at the nodes in ``keep``; None if not draped."""
    if not _is_draped(file):
        return None
    variable = file.variables[BASE]
    _require_units(path, BASE, variable, _UNITS["height"])
    order = ("latitude", "longitude")
    if sorted(variable.dimensions) != sorted(order):
        raise MapError(
            f"{path}: {BASE} must have the dimensions latitude, longitude, in any order; found "
            f"{', '.join(variable.dimensions) or 'none'}."
        )
    whole = np.transpose(
        _values(path, BASE, variable, ()), [variable.dimensions.index(name) for name in order]
    )
    flip = tuple(slice(None, None, -1 if descends[name] else 1) for name in order)
    base = np.ascontiguousarray(whole[flip][keep["latitude"], keep["longitude"]])
    lowest, highest = _LIMITS["height"]
    if _has_fill(variable, base) or not ((lowest <= base) & (base <= highest)).all():
        raise MapError(
            f"{path}: {BASE} must be heights of {lowest:g} to {highest:g} m without gaps."
        )
    return base


def _errors(path: Path, file: Any, key: str) -> NDArray[np.float64]:
    """Return the attribute ``key`` (9,) of the nine components; NaN where it is missing."""
    errors = unknown()
    for index, name in enumerate(variables()):
        variable = file.variables[name]
        if key in variable.ncattrs():
            try:
                errors[index] = float(variable.getncattr(key))
            except (TypeError, ValueError):
                errors[index] = -1.0
            if not 0.0 <= errors[index] < math.inf:
                raise MapError(
                    f"{path}: {name} has {key} = {_text(variable, key)!r}; it must be a number of "
                    "at least 0."
                )
    return errors


def _fills(variable: Any) -> dict[str, NDArray[Any]]:
    """Return the codes for missing values that a variable declares, by attribute."""
    names = {"_FillValue", "missing_value"} & set(variable.ncattrs())
    return {name: np.ravel(variable.getncattr(name)) for name in sorted(names)}


def _has_fill(variable: Any, values: Array) -> bool:
    return any((values == fill).any() for fills in _fills(variable).values() for fill in fills)


def _require_numbers(path: Path, name: str, variable: Any) -> None:
    """Raise MapError if a variable's code for missing values is not a number."""
    for key, fills in _fills(variable).items():
        if fills.dtype.kind not in "fiu":
            value = _text(variable, key)
            raise MapError(f"{path}: {name} has {key} = {value!r}; it must be a number.")


def _mirrored(part: slice, size: int) -> slice:
    return slice(size - part.stop, size - part.start)


def _values(path: Path, name: str, variable: Any, index: tuple[slice, ...]) -> NDArray[np.float64]:
    try:
        return np.asarray(variable[index or ...], dtype=float)
    except Exception as error:
        raise MapError(f"{path}: {name} cannot be read: {text_of(error)}") from None


def _require_units(path: Path, name: str, variable: Any, allowed: set[str]) -> None:
    units = _text(variable, "units")
    if units.strip().lower() not in allowed:
        first = (AXES | variables() | {BASE: {"units": "m"}})[name]["units"]
        stated = f"has units {units!r}" if units else "states no units"
        raise MapError(f"{path}: {name} {stated}; it must be in {first!r}.")


def _text(holder: Any, key: str) -> str:
    """Return an attribute as text without control characters; "" if it is missing."""
    return checks.clean_text(str(holder.getncattr(key))) if key in holder.ncattrs() else ""
