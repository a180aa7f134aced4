"""Gravity-gradient maps: the disturbing field on a grid, made from real data and kept in a cache.

The field itself is the work of :mod:`.maps.shipped_regions`. The normal field is no part of a
map: :mod:`.gravity.ellipsoid` has it exactly. Tensor components are ordered
[EE, EN, EU, NN, NU, UU], x = east, y = north, z = up.
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import io
import json
import math
import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..files import written_whole
from ..gravity.ellipsoid import SEMI_MAJOR_AXIS
from ..gravity.gradient_map import GradientMap, MapError
from ..gravity.meridians import Area
from ..numerics.cache import cache_folder, exclusive_lock
from ..numerics.source import MAP_ROOMS, rooms_hash
from . import checks, netcdf, netcdf_reader
from .shipped_regions import (
    SOURCES,
    check_relief_smoothing,
    data_bytes,
    disturbing_field,
    extent_deg,
    read_arrays,
)
from .shipped_terrains import (
    TERRAINS,
    highest_ground_m,
    terrain_disturbing_field,
    terrain_extent_deg,
    terrain_heights_m,
)

Array = NDArray[np.float64]

SPACING_PER_HEIGHT = 0.25
"""Widest horizontal spacing of nodes, per height above the sources of a region."""
SPACING_PER_CLEARANCE = 0.6
"""The same of a terrain, per height above its highest ground."""
_FEWEST_NODES = 4  # per axis, what a cubic spline needs
_MOST_NODES = 5_000_000  # in all: about half a gigabyte
_MARGIN_NODES = 2  # lowest layers, which serve as the margin of an interpolation in height


@dataclass(frozen=True)
class MapRecipe:
    """What map to make: the same recipe always gives the same map.

    Nodes start at the south-western, lowest corner; the last ones lie on the other bounds, or
    beyond them by less than one spacing.

    Attributes
    ----------
    source : a key of :data:`SOURCES` or of :data:`ggbench.maps.shipped_terrains.TERRAINS`.
    south_deg, north_deg, west_deg, east_deg : bounds [deg], longitudes in any turn.
    min_height_m, max_height_m : bounds [m above the ellipsoid].
    spacing_arcmin : in latitude and in longitude. At most a quarter of the height above the
        sources (on land, above the ellipsoid) in all but the two lowest layers of nodes; the error
        of a cubic spline is then below 1e-3 E.
        Of a terrain: at most 0.6 of the height above its highest ground there; the error at a
        tenth of a kilometre above it is then 0.01 E rms.
    height_spacing_m : at most a quarter of the lowest height above half the sources' depth; of a
        terrain, at most the lowest height above its highest ground.
    land_correction : whether to turn the geoid into the height anomaly with the topography.
    relief_smoothing_deg : standard deviation of a Gaussian that smooths the topography before;
        0, no smoothing, is the field that the benchmark declares. At most 1.
    density_kg_m3 : of the ground of a terrain.
    """

    source: str
    south_deg: float
    north_deg: float
    west_deg: float
    east_deg: float
    min_height_m: float
    max_height_m: float
    spacing_arcmin: float = 1.25
    height_spacing_m: float = 500.0
    land_correction: bool = True
    relief_smoothing_deg: float = 0.0
    density_kg_m3: float = 2670.0


def load_or_build(recipe: MapRecipe) -> GradientMap:
    """Return the map of a recipe from the cache, or build it and put it there.

    The cache is a folder of files named by a hash of the recipe, the data and the code that
    builds, so it never goes stale. A damaged file is replaced; a folder that cannot be written
    costs only time. :data:`ggbench.numerics.cache.CACHE_VARIABLE` moves it.

    Raises MapError as :func:`build` does.
    """
    recipe = checked(recipe)
    path = cached_path(recipe)
    with contextlib.suppress(MapError):
        return read(path)
    with exclusive_lock(path):
        with contextlib.suppress(MapError):
            return read(path)
        gradient_map = build(recipe)
        # Without a copy on disk the map itself is as good.
        with contextlib.suppress(MapError):
            write(path, gradient_map)
        return gradient_map


def build(recipe: MapRecipe) -> GradientMap:
    """Make the map of a recipe.

    Raises
    ------
    MapError : unknown source; bounds in the wrong order or outside the source; a spacing too wide
        for the height; a smoothing outside 0 to 1 deg; a data file missing or damaged.
    """
    recipe = checked(recipe)
    step = math.radians(recipe.spacing_arcmin / 60.0)
    south, west = math.radians(recipe.south_deg), math.radians(recipe.west_deg)
    n_lat, n_lon, n_h = _node_counts(recipe)
    latitude = south + step * np.arange(n_lat)
    longitude = west + step * np.arange(n_lon)
    height = recipe.min_height_m + recipe.height_spacing_m * np.arange(n_h)
    smoothing = recipe.relief_smoothing_deg
    relief = f"relief smoothed by {smoothing} deg" if smoothing > 0.0 else "relief not smoothed"
    if recipe.source in TERRAINS:
        tensor, gravity_disturbance = terrain_disturbing_field(
            recipe.source, latitude, longitude, height, recipe.density_kg_m3, smoothing
        )
        made = f"{TERRAINS[recipe.source].provenance}; {recipe.density_kg_m3:g} kg/m³, {relief}"
    else:
        tensor, gravity_disturbance = disturbing_field(
            recipe.source, latitude, longitude, height, recipe.land_correction, smoothing
        )
        correction = f"with land correction, {relief}"
        if not recipe.land_correction:
            correction = "without land correction"
        made = f"{SOURCES[recipe.source].provenance}; {correction}"
    return GradientMap(
        latitude0=south,
        longitude0=west,
        height0=float(recipe.min_height_m),
        latitude_step=step,
        longitude_step=step,
        height_step=float(recipe.height_spacing_m),
        tensor=tensor,
        gravity_disturbance=gravity_disturbance,
        provenance=made,
    )


def cached_path(recipe: MapRecipe) -> Path:
    """Return where the map of a recipe is kept, or would be; the recipe is a checked one."""
    return cache_folder() / "maps" / f"{content_key(recipe)}.npz"


def checked(recipe: MapRecipe) -> MapRecipe:
    """Return a recipe with its longitudes counted as its source counts them.

    Raises MapError, as :func:`build` does, if it cannot be followed.
    """
    # Comparisons are such that NaN fails.
    known = [*SOURCES, *TERRAINS]
    if recipe.source not in known:
        raise MapError(
            f"Unknown map source {recipe.source!r}; allowed: {', '.join(sorted(known))}, normal, "
            "or the path of a map, *.nc or *.npz."
        )
    check_relief_smoothing(recipe.relief_smoothing_deg)
    for name in ("spacing_arcmin", "height_spacing_m"):
        if not 0.0 < getattr(recipe, name) < math.inf:
            raise MapError(f"{name} = {getattr(recipe, name)} must be positive and finite.")

    if recipe.source in TERRAINS:
        latitudes, longitudes = terrain_extent_deg(recipe.source)
        heights = terrain_heights_m(recipe.source)
        if not recipe.land_correction:
            raise MapError(f"land_correction has no meaning for a terrain, {recipe.source!r}.")
    else:
        files = SOURCES[recipe.source]
        latitudes, longitudes = extent_deg(files)
        heights = files.lowest_height_m, files.highest_height_m
        if recipe.density_kg_m3 != MapRecipe.density_kg_m3:
            raise MapError(
                f"density_kg_m3 belongs to a terrain ({', '.join(TERRAINS)}), not to "
                f"{recipe.source!r}."
            )
    bounds = Area(west=recipe.west_deg, east=recipe.east_deg).about(0.5 * sum(longitudes))
    assert bounds.west is not None and bounds.east is not None  # as both were given
    recipe = dataclasses.replace(recipe, west_deg=bounds.west, east_deg=bounds.east)
    limits = (
        ("south_deg", "north_deg", *latitudes),
        ("west_deg", "east_deg", *longitudes),
        ("min_height_m", "max_height_m", *heights),
    )
    for low, high, least, most in limits:
        lower, upper = getattr(recipe, low), getattr(recipe, high)
        if not lower < upper:
            raise MapError(f"{low} = {lower} must be less than {high} = {upper}.")
        for name, value in ((low, lower), (high, upper)):
            if not least <= value <= most:
                raise MapError(
                    f"{name} = {value} lies outside what source {recipe.source!r} can give: "
                    f"{least:g} to {most:g} is allowed."
                )

    _check_spacings(recipe)
    counts = _node_counts(recipe)
    if min(counts) < _FEWEST_NODES or math.prod(counts) > _MOST_NODES:
        raise MapError(
            f"Bounds and spacings give {counts} nodes in latitude, longitude and height: at least "
            f"{_FEWEST_NODES} in each and at most {_MOST_NODES} in all are allowed."
        )
    return recipe


def _check_spacings(recipe: MapRecipe) -> None:
    """Raise MapError if the nodes lie too far apart for the height above the sources."""
    if recipe.source in TERRAINS:
        ground = highest_ground_m(recipe.source)
        depth, deepest, share = -ground, -ground, SPACING_PER_CLEARANCE
        vertical_share = 1.0
        vertical_rule = f"the height above the highest ground, {ground:g} m"
        rule = f"{share:g} of {vertical_rule}"
    else:
        depth = SOURCES[recipe.source].source_depth_m
        deepest, share = 0.5 * depth, SPACING_PER_HEIGHT
        vertical_share = share
        rule = "a quarter of that height"
        if depth > 0.0:
            rule += f" above sources {depth:g} m deep (vertically: above half that depth)"
        vertical_rule = rule
    # Half the depth: the error of a spline is largest in the lowest layer, where it ends.
    widest = vertical_share * (recipe.min_height_m + deepest)
    if recipe.height_spacing_m > widest:
        raise MapError(
            f"height_spacing_m = {recipe.height_spacing_m} is too wide for min_height_m = "
            f"{recipe.min_height_m}: at most {widest:g} is allowed, {vertical_rule}."
        )
    height = recipe.min_height_m + _MARGIN_NODES * recipe.height_spacing_m
    widest = math.degrees(share * (height + depth) / SEMI_MAJOR_AXIS) * 60.0
    if recipe.spacing_arcmin > widest:
        raise MapError(
            f"spacing_arcmin = {recipe.spacing_arcmin} is too wide for a map that serves heights "
            f"from {height:g} m: at most {widest:.3g} is allowed, {rule}."
        )


def _node_counts(recipe: MapRecipe) -> tuple[int, int, int]:
    step_deg = recipe.spacing_arcmin / 60.0
    cells = (
        (recipe.north_deg - recipe.south_deg) / step_deg,
        (recipe.east_deg - recipe.west_deg) / step_deg,
        (recipe.max_height_m - recipe.min_height_m) / recipe.height_spacing_m,
    )
    # A bound that rounding puts a hair beyond a node needs no further node.
    n_lat, n_lon, n_h = (math.ceil(count - 1e-6) + 1 for count in cells)
    return n_lat, n_lon, n_h


def content_key(recipe: MapRecipe) -> str:
    """Hash of all that determines the map: recipe, data, code."""
    values = [v if isinstance(v, str) else float(v) for v in dataclasses.astuple(recipe)]
    digest = hashlib.sha256(json.dumps(values).encode())
    digest.update(rooms_hash(*MAP_ROOMS).encode())
    for name in data_names(recipe):
        digest.update(hashlib.sha256(data_bytes(name)).digest())
    return digest.hexdigest()[:32]


def data_names(recipe: MapRecipe) -> tuple[str, ...]:
    """Return the names of the shipped files of which a map is built."""
    if recipe.source in TERRAINS:
        return (TERRAINS[recipe.source].file,)
    files = SOURCES[recipe.source]
    return files.geoid, files.topography, files.coefficients


def read(path: Path | str, crop: Area | None = None) -> GradientMap:
    """Return the map in a netCDF file, or in an ``.npz`` file that :func:`write` wrote.

    Parameters
    ----------
    path : of the file.
    crop : of a netCDF file, only the nodes of this area and a few around it are read.

    Raises
    ------
    MapError
        If there is no such file, or it is no complete map; the message says what is missing.
    """
    path = Path(path)
    if path.suffix != ".npz":
        return netcdf_reader.read(path, crop)
    fields = dataclasses.fields(GradientMap)
    names = [item.name for item in fields if item.default_factory is dataclasses.MISSING]
    optional = [item.name for item in fields if item.name not in names]
    try:
        content = path.read_bytes()
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            unpacked = sum(entry.file_size for entry in archive.infolist())
            stored = {entry.filename.removesuffix(".npy") for entry in archive.infolist()}
        if unpacked > checks.MOST_BYTES_READ:
            raise MapError(
                f"{path} unpacks to {unpacked / 1e9:.3g} GB; at most "
                f"{checks.MOST_BYTES_READ / 1e9:.3g} GB can be read"
            )
        arrays = read_arrays(content, [*names, *(key for key in optional if key in stored)])
    except OSError as error:
        raise MapError(f"cannot read the map {path}: {error.strerror}") from None
    except MapError:
        raise
    except Exception as error:  # whatever a damaged archive makes of itself
        raise MapError(
            f"{path} is not a gradient map: {error}; it must hold the arrays {', '.join(names)}"
        ) from None
    tensor, disturbance = arrays["tensor"], arrays["gravity_disturbance"]
    shape = tensor.shape
    grids = (
        len(shape) == 4
        and min(shape[:3]) >= _FEWEST_NODES
        and shape[3] == 6
        and disturbance.shape == (*shape[:3], 3)
        and all(a.dtype.kind == "f" and np.isfinite(a).all() for a in (tensor, disturbance))
    )
    if not grids:
        raise MapError(
            f"{path} is not a gradient map: tensor must be (n_lat, n_lon, n_h, 6) and "
            f"gravity_disturbance (n_lat, n_lon, n_h, 3), finite numbers at no less than "
            f"{_FEWEST_NODES} nodes per axis; found {shape} and {disturbance.shape}"
        )
    scalars = {key: arrays[key] for key in names if key.endswith(("0", "_step"))}
    for key, value in scalars.items():
        if value.shape != () or value.dtype.kind not in "fi" or not np.isfinite(value):
            raise MapError(f"{path} is not a gradient map: {key} must be one finite number")
        if key.endswith("_step") and value <= 0:
            raise MapError(f"{path} is not a gradient map: {key} must be positive, not {value}")
    checks.require_possible(str(path), tensor, disturbance)
    errors = {key: arrays[key] for key in optional if key in arrays}
    for key, value in errors.items():
        if value.shape != (9,) or value.dtype.kind != "f" or (value < 0.0).any():
            raise MapError(f"{path} is not a gradient map: {key} must be nine numbers or NaN")
    return GradientMap(
        **{key: float(value) for key, value in scalars.items()},
        **errors,
        tensor=tensor.astype(float),
        gravity_disturbance=disturbance.astype(float),
        provenance=checks.clean_text(str(arrays["provenance"])),
    )


def write(path: Path | str, gradient_map: GradientMap) -> None:
    """Write a map to a file, ``*.nc`` (netCDF) or ``*.npz`` (NumPy), in double precision.

    In one stroke: a reader sees a whole file or none. The folder is made if need be.

    Raises
    ------
    MapError
        If the file is named otherwise, or cannot be written.
    """
    path = Path(path)
    if path.suffix == ".nc":
        netcdf.write(path, gradient_map)
    elif path.suffix == ".npz":
        _write_archive(path, gradient_map)
    else:
        raise MapError(f"the map file {path} must be named *.nc or *.npz")


def _write_archive(path: Path, gradient_map: GradientMap) -> None:
    with written_whole(path, MapError, "the map ") as temporary, temporary.open("wb") as file:
        np.savez(file, allow_pickle=False, **vars(gradient_map))
