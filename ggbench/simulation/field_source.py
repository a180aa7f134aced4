"""Gravity fields from ``[field]`` tables: normal field, map file or built map."""

from __future__ import annotations

import dataclasses
import hashlib
import math
from collections.abc import Iterator, Sequence
from functools import lru_cache
from pathlib import Path

import numpy as np

from ..files.writing import sha256_of
from ..gravity.degraded_map import MapDegradation, degrade
from ..gravity.field import Field
from ..gravity.gradient_map import GradientMap, MapError
from ..gravity.meridians import Area, eastern, turns
from ..maps.netcdf_reader import source_files
from ..maps.package_data import data_bytes
from ..maps.recipe import MapRecipe, content_key, load_or_build, read
from ..maps.shipped import SOURCES
from ..maps.survey_lines import COMPONENTS
from ..sensors.aiding import MGAL
from ..spec.sensors import FieldSpec, MapErrorSpec

FILE_SUFFIXES = (".nc", ".npz")
"""Suffixes of map files; NumPy archives of earlier versions are refused by the reader."""


def is_file(source: str) -> bool:
    """Return whether a ``source`` key is the path of a map file."""
    return source.endswith(FILE_SUFFIXES)


def make_field(spec: FieldSpec, constant: tuple[float, ...] = ()) -> Field:
    """Return the field of a ``[field]`` table; the latest fields are cached.

    ``constant`` is an additional gravity disturbance ENU [mGal].

    Raises
    ------
    MapError
        If the map cannot be built; the message states the reason and the allowed values.
    """
    # What the accelerometers feel is no part of the map.
    field = _make(spec.model_copy(update={"gravity_disturbance": False}), map_version(spec))
    return field if not any(constant) else _with_constant(field, constant)


def map_version(spec: FieldSpec) -> tuple[int, int]:
    """Return modification time [ns] and size [bytes] of a map file.

    They are zeros for a built map, and for a missing file.
    """
    return version_of(Path(spec.source)) if is_file(spec.source) else (0, 0)


def version_of(path: Path) -> tuple[int, int]:
    """Return modification time [ns] and size [bytes] of a file; zeros if it does not exist.

    If the result changes, a user has overwritten the file while the process runs.
    """
    try:
        status = path.stat()
    except (OSError, ValueError):  # its reader says what is wrong
        return 0, 0
    return status.st_mtime_ns, status.st_size


@lru_cache(maxsize=8)
def _with_constant(field: Field, constant: tuple[float, ...]) -> Field:
    return dataclasses.replace(field, constant_disturbance=np.array(constant) / MGAL)


def channel_errors(spec: FieldSpec, channels: Sequence[str]) -> tuple[float, ...]:
    """Return the map's standard error [E] in each gradiometer channel.

    Raises
    ------
    MapError
        If the map states no standard error.
    """
    error = make_field(spec).standard_error[:6]
    if not np.isfinite(error).all():
        raise MapError(
            f'model.field.standard_error: the map "{spec.source}" contains no standard error'
            + (" of some components" if np.isfinite(error).any() else "")
            + "; 'ggbench map build --lines' stores one only if residuals on held-back lines are "
            "larger than on fitted lines"
        )
    return tuple(float(np.linalg.norm(COMPONENTS[name] * error)) for name in channels)


def beside(field: Field, longitude: float) -> Field:
    """Return a field with its map moved close to a flight, by full turns of longitude.

    ``longitude`` is a longitude of the flight [rad]. For example, 275.7° and −84.3° are equal, and
    maps across the date line may end at 181° or begin at −181°.
    """
    if not field.has_map:
        return field
    turn = float(turns(0.5 * (field.lower[1] + field.upper[1]), longitude, math.tau))
    return field if turn == 0.0 else _turned(field, turn)


@lru_cache(maxsize=8)
def _turned(field: Field, turn: float) -> Field:
    return dataclasses.replace(field, origin=field.origin + np.array([0.0, turn, 0.0]))


@lru_cache(maxsize=8)
def _make(spec: FieldSpec, version: tuple[int, int]) -> Field:
    if spec.source == "normal" or is_file(spec.source):
        _refuse_recipe(spec)
    if spec.source == "normal":
        if spec.error is not None:
            raise MapError('field.error: source = "normal" has no map')
        return Field.normal()
    gradient_map = _exact_map(spec.model_copy(update={"error": None}), version)
    if spec.error is not None:
        gradient_map = degrade(gradient_map, _degradation(spec.error))
    return Field.from_map(gradient_map)


@lru_cache(maxsize=2)
def _exact_map(spec: FieldSpec, version: tuple[int, int]) -> GradientMap:
    """Return the map of a ``[field]`` table without added errors.

    The latest maps are cached, because maps with many error seeds start from the same map.
    """
    if is_file(spec.source):
        return read(Path(spec.source), _crop(spec))
    return load_or_build(map_recipe(spec))


def _crop(spec: FieldSpec) -> Area | None:
    """Return the bounds to which a map file is cropped, or None without bounds.

    Raises MapError if the bounds are not in ascending order.
    """
    bounds = spec.south_deg, spec.north_deg, spec.west_deg, spec.east_deg
    if not any(bounds):
        return None
    south, north, west, east = bounds
    if not (south < north and west < eastern(west, east)):
        raise MapError(
            f"the bounds of the map {spec.source} are {south:g}° to {north:g}° N and {west:g}° "
            f"to {east:g}° E: give south_deg, north_deg, west_deg and east_deg in ascending "
            "order, or none of them (across the date line: 179 to -179)"
        )
    return Area(*bounds)


def _refuse_recipe(spec: FieldSpec) -> None:
    """Raise MapError if a table has keys for building a map, but its map is not built."""
    for key in ("land_correction", "relief_smoothing_deg", "density_kg_m3", "drape"):
        value, usual = getattr(spec, key), FieldSpec.model_fields[key].default
        if value != usual:
            raise MapError(
                f'field.{key} is {value}, but source = "{spec.source}" does not use it: it is '
                "for maps built from a shipped source"
            )


def _degradation(spec: MapErrorSpec) -> MapDegradation:
    return MapDegradation(
        resolution_m=1e3 * (spec.resolution_km or 0.0),
        density_factor=spec.density_factor,
        white_noise_eotvos=spec.white_noise_eotvos,
        correlated_noise_eotvos=spec.correlated_noise_eotvos,
        correlation_m=1e3 * spec.correlation_km,
        seed=spec.seed,
    )


def map_recipe(spec: FieldSpec) -> MapRecipe:
    """Return the recipe for building the map of a ``[field]`` table.

    The ``source`` of the table must be a key of :data:`ggbench.maps.shipped.SOURCES`.
    """
    return MapRecipe(
        source=spec.source,
        south_deg=spec.south_deg,
        north_deg=spec.north_deg,
        west_deg=spec.west_deg,
        east_deg=spec.east_deg,
        min_height_m=spec.lowest_m,
        max_height_m=spec.highest_m,
        spacing_arcmin=spec.spacing_arcmin,
        height_spacing_m=spec.height_spacing_m,
        land_correction=spec.land_correction,
        relief_smoothing_deg=spec.relief_smoothing_deg,
        density_kg_m3=spec.density_kg_m3,
        drape=spec.drape,
    )


def map_content(spec: FieldSpec) -> str | None:
    """Return a hash of the content of a ``[field]`` table's map, or None without a map.

    Raises
    ------
    MapError
        If the map file cannot be read.
    """
    if spec.source == "normal":
        return None
    if not is_file(spec.source):
        return content_key(map_recipe(spec))
    return sha256_of(Path(spec.source), MapError, "the map ")


def map_files(spec: FieldSpec) -> Iterator[tuple[str, str, str]]:
    """Yield role, name and SHA-256 of each input file of a map.

    The role is the use of the file: "map" or "data of the map". The inputs of a built map are its
    data files. The inputs of a map file are the file itself and the data files that it lists.

    Raises
    ------
    MapError
        If a file cannot be read.
    """
    if spec.source == "normal":
        return
    if not is_file(spec.source):
        for name in SOURCES[spec.source].files:
            yield "data of the map", name, hashlib.sha256(data_bytes(name)).hexdigest()
        return
    path = Path(spec.source)
    yield "map", path.name, sha256_of(path, MapError, "the map ")
    for name, key in source_files(path).items():
        yield "data of the map", name, key
