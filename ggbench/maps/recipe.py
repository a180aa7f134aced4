"""Gravity-gradient maps: the disturbing field on a grid, made from real data and kept in a cache.

The field itself is the work of :mod:`.maps.shipped_regions`. The normal field is no part of a
map: :mod:`.gravity.ellipsoid` has it exactly. Tensor components are ordered
[EE, EN, EU, NN, NU, UU], x = east, y = north, z = up.
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..gravity.ellipsoid import SEMI_MAJOR_AXIS
from ..gravity.gradient_map import GradientMap, MapError
from ..gravity.meridians import Area
from ..numerics.cache import cache_folder, exclusive_lock
from ..numerics.source import MAP_ROOMS, rooms_hash
from . import archive, netcdf, netcdf_reader
from .shipped_regions import (
    SOURCES,
    data_bytes,
    disturbing_field,
    extent_deg,
)
from .shipped_surveys import (
    SURVEYS,
    highest_mass_m,
    survey_disturbing_field,
    survey_errors,
    survey_extent_deg,
    survey_heights_m,
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
SPACING_PER_MASS = 0.35
"""The same of a survey, per height above its highest mass, also vertically: 0.1 E rms."""
_WIDEST_SMOOTHING_DEG = 1.0
_MOST_NODES = 5_000_000  # in all: about half a gigabyte
_MARGIN_NODES = 2  # lowest layers, which serve as the margin of an interpolation in height


@dataclass(frozen=True)
class MapRecipe:
    """What map to make: the same recipe always gives the same map.

    Nodes start at the south-western, lowest corner; the last ones lie on the other bounds, or
    beyond them by less than one spacing.

    Attributes
    ----------
    source : a key of :data:`SOURCES`, of :data:`ggbench.maps.shipped_terrains.TERRAINS` or of
        :data:`ggbench.maps.shipped_surveys.SURVEYS`.
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
    errors: dict[str, Array] = {}
    relief = f"relief smoothed by {smoothing} deg" if smoothing > 0.0 else "relief not smoothed"
    if recipe.source in TERRAINS:
        tensor, gravity_disturbance = terrain_disturbing_field(
            recipe.source, latitude, longitude, height, recipe.density_kg_m3, smoothing
        )
        made = f"{TERRAINS[recipe.source].provenance}; {recipe.density_kg_m3:g} kg/m³, {relief}"
    elif recipe.source in SURVEYS:
        tensor, gravity_disturbance = survey_disturbing_field(
            recipe.source, latitude, longitude, height
        )
        made = SURVEYS[recipe.source].provenance
        error, distance = survey_errors(recipe.source)
        errors = {"standard_error": error, "error_distance": distance}
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
        **errors,
    )


def cached_path(recipe: MapRecipe) -> Path:
    """Return where the map of a recipe is kept, or would be; the recipe is a checked one."""
    return cache_folder() / "maps" / f"{content_key(recipe)}.npz"


def checked(recipe: MapRecipe) -> MapRecipe:
    """Return a recipe with its longitudes counted as its source counts them.

    Raises MapError, as :func:`build` does, if it cannot be followed.
    """
    # Comparisons are such that NaN fails.
    known = [*SOURCES, *TERRAINS, *SURVEYS]
    if recipe.source not in known:
        raise MapError(
            f"Unknown map source {recipe.source!r}; allowed: {', '.join(sorted(known))}, normal, "
            "or the path of a map, *.nc or *.npz."
        )
    if not 0.0 <= recipe.relief_smoothing_deg <= _WIDEST_SMOOTHING_DEG:
        raise MapError(
            f"relief_smoothing_deg = {recipe.relief_smoothing_deg} must lie between 0, which is no "
            f"smoothing, and {_WIDEST_SMOOTHING_DEG:g}."
        )
    for name in ("spacing_arcmin", "height_spacing_m"):
        if not 0.0 < getattr(recipe, name) < math.inf:
            raise MapError(f"{name} = {getattr(recipe, name)} must be positive and finite.")

    if recipe.source not in SOURCES and not recipe.land_correction:
        raise MapError(
            f"land_correction has no meaning for {recipe.source!r}, which is no region of EGM2008."
        )
    if recipe.source in SURVEYS and recipe.relief_smoothing_deg != 0.0:
        raise MapError(f"relief_smoothing_deg has no meaning for a survey, {recipe.source!r}.")
    given = limits_of(recipe.source)
    if recipe.source not in TERRAINS and recipe.density_kg_m3 != MapRecipe.density_kg_m3:
        raise MapError(
            f"density_kg_m3 belongs to a terrain ({', '.join(TERRAINS)}), not to {recipe.source!r}."
        )
    bounds = Area(west=recipe.west_deg, east=recipe.east_deg).about(0.5 * sum(given.longitudes))
    assert bounds.west is not None and bounds.east is not None  # as both were given
    recipe = dataclasses.replace(recipe, west_deg=bounds.west, east_deg=bounds.east)
    limits = (
        ("south_deg", "north_deg", *given.latitudes),
        ("west_deg", "east_deg", *given.longitudes),
        ("min_height_m", "max_height_m", *given.heights),
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

    _check_spacings(recipe, given)
    counts = _node_counts(recipe)
    if min(counts) < netcdf.FEWEST_NODES or math.prod(counts) > _MOST_NODES:
        raise MapError(
            f"Bounds and spacings give {counts} nodes in latitude, longitude and height: at least "
            f"{netcdf.FEWEST_NODES} in each and at most {_MOST_NODES} in all are allowed."
        )
    return recipe


class Limits(NamedTuple):
    """What a source can give, and how far apart nodes may be.

    Attributes
    ----------
    latitudes, longitudes, heights : from and to [deg], [m].
    ground : height from which the limits of spacings count [m].
    share : widest horizontal spacing, as a share of the height above it.
    vertical : the same vertically; of a region, of the height above half its depth.
    """

    latitudes: tuple[float, float]
    longitudes: tuple[float, float]
    heights: tuple[float, float]
    ground: float
    share: float
    vertical: float


def limits_of(source: str) -> Limits:
    """Return the limits of a region, a terrain or a survey."""
    if source in TERRAINS:
        return Limits(
            *terrain_extent_deg(source), terrain_heights_m(source), highest_ground_m(source),
            SPACING_PER_CLEARANCE, 1.0,
        )  # fmt: skip
    if source in SURVEYS:
        return Limits(
            *survey_extent_deg(source), survey_heights_m(source), highest_mass_m(source),
            SPACING_PER_MASS, SPACING_PER_MASS,
        )  # fmt: skip
    files = SOURCES[source]
    return Limits(
        *extent_deg(files), (files.lowest_height_m, files.highest_height_m), -files.source_depth_m,
        SPACING_PER_HEIGHT, SPACING_PER_HEIGHT,
    )  # fmt: skip


def _check_spacings(recipe: MapRecipe, limits: Limits) -> None:
    """Raise MapError if the nodes lie too far apart for the height above the sources."""
    ground = deepest = limits.ground
    if recipe.source in TERRAINS:
        vertical_rule = f"the height above the highest ground, {ground:g} m"
        rule = f"{limits.share:g} of {vertical_rule}"
    elif recipe.source in SURVEYS:
        rule = vertical_rule = (
            f"{limits.share:g} of the height above the highest point mass, {ground:.0f} m"
        )
    else:
        # Half the depth: the error of a spline is largest in the lowest layer, where it ends.
        deepest = 0.5 * ground
        rule = "a quarter of that height"
        if ground < 0.0:
            rule += f" above sources {-ground:g} m deep (vertically: above half that depth)"
        vertical_rule = rule
    widest = limits.vertical * (recipe.min_height_m - deepest)
    if recipe.height_spacing_m > widest:
        raise MapError(
            f"height_spacing_m = {recipe.height_spacing_m} is too wide for min_height_m = "
            f"{recipe.min_height_m}: at most {widest:g} is allowed, {vertical_rule}."
        )
    height = recipe.min_height_m + _MARGIN_NODES * recipe.height_spacing_m
    widest = math.degrees(limits.share * (height - ground) / SEMI_MAJOR_AXIS) * 60.0
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
    if recipe.source in SURVEYS:
        return (SURVEYS[recipe.source].file,)
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
    return archive.read(path)


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
        archive.write(path, gradient_map)
    else:
        raise MapError(f"the map file {path} must be named *.nc or *.npz")
