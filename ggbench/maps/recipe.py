"""Recipes of maps from shipped data, and the cache of built maps.

:mod:`ggbench.maps.shipped` defines the sources. Maps exclude the normal field, which
:mod:`.gravity.ellipsoid` computes exactly. Tensor components are ordered [EE, EN, EU, NN, NU, UU],
x = east, y = north, z = up.
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..gravity.ellipsoid import SEMI_MAJOR_AXIS
from ..gravity.gradient_map import GradientMap, MapError
from ..gravity.meridians import Area
from ..gravity.terrain import TerrainError
from ..numerics.cache import cache_folder, exclusive_lock
from ..numerics.source import MAP_ROOMS, rooms_hash
from . import netcdf, netcdf_reader
from .netcdf import Layer, Nodes
from .package_data import data_bytes
from .parts import Part, TerrainPart, summed
from .shipped import SOURCES, Limits
from .shipped_parts import PartOptions, ShippedTerrain, SpacingRule

Array = NDArray[np.float64]

_WIDEST_SMOOTHING_DEG = 1.0
_MOST_NODES = 5_000_000  # in all: about half a gigabyte
_LEAST_CLEARANCE_M = 10.0
"""Smallest height of the lowest layer of a draped map above the base surface [m]."""
_TOLERANCE_EOTVOS = 0.5
"""Largest error from approximating terrain masses in a draped map [E]."""
_MARGIN_NODES = 2  # lowest layers, which serve as the margin of an interpolation in height


@dataclass(frozen=True)
class MapRecipe:
    """Recipe of a map from shipped data; equal recipes give equal maps.

    The first node is the south-western, lowest corner. The last nodes lie on the northern, eastern
    and upper bounds, or beyond these bounds by less than one spacing.

    Attributes
    ----------
    source : a key of :data:`ggbench.maps.shipped.SOURCES`.
    south_deg, north_deg, west_deg, east_deg : bounds [deg]. Longitudes may differ from those of the
        source by whole turns.
    min_height_m, max_height_m : bounds [m above the ellipsoid].
    spacing_arcmin : distance between nodes in latitude and in longitude. Its upper limit depends on
        the height of the third layer. For a geoid the limit is a quarter of this layer's height
        above the masses. On land these masses lie at the ellipsoid; at sea they lie deeper. The
        error of a cubic spline is then below 1e-3 E. For a terrain the limit is 0.6 of the height
        above the highest ground. The error 100 m above the highest ground is then 0.01 E RMS. For
        point masses the limit is 0.35 of the height above the highest mass.
    height_spacing_m : distance between layers. Its upper limit depends on the height of the lowest
        layer. For a geoid the limit is a quarter of a height that counts from half the depth of
        the masses. For a terrain the limit is the height above the highest ground. For point masses
        it is 0.35 of the height above the highest mass.
    land_correction : whether to convert the geoid to the height anomaly with the topography.
    relief_smoothing_deg : standard deviation of a Gaussian that smooths topography or terrain
        before use; 0 (no smoothing) to 1. The benchmark uses 0.
    density_kg_m3 : density of the ground of a terrain.
    drape : whether heights count from the base surface of a terrain (:mod:`.drape`). The limit of
        ``spacing_arcmin`` is then the height of the third layer above the base surface. The limit
        of ``height_spacing_m`` is the height of the lowest layer above the base surface.
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
    drape: bool = False


def load_or_build(recipe: MapRecipe) -> GradientMap:
    """Return the map of a recipe from the cache, or build and cache it.

    The cache is a folder of netCDF files. The name of a file is a hash of recipe, data and code, so
    an outdated file is never used. A damaged file is replaced. If the folder is not writable, maps
    are built each time. The environment variable with the name
    :data:`ggbench.numerics.cache.CACHE_VARIABLE` sets the folder.

    Raises MapError in the cases of :func:`build`.
    """
    recipe = checked(recipe)
    path = cached_path(recipe)
    with contextlib.suppress(MapError):
        return _kept(path, recipe)
    with exclusive_lock(path):
        with contextlib.suppress(MapError):
            return _kept(path, recipe)
        gradient_map = build(recipe)
        # Without a copy on disk the map itself is as good.
        with contextlib.suppress(MapError):
            _keep(path, nodes_of(recipe), gradient_map)
        return gradient_map


def build(recipe: MapRecipe) -> GradientMap:
    """Build the map of a recipe.

    Raises
    ------
    MapError : if the source is unknown; if bounds are in the wrong order or outside the source; if
        a spacing is too wide for the height; if the smoothing is outside 0 to 1 deg; if a data file
        is missing or damaged.
    """
    recipe = checked(recipe)
    source, nodes, options = SOURCES[recipe.source], nodes_of(recipe), options_of(recipe)
    tensor, disturbance = np.empty((*nodes.shape, 6)), np.empty((*nodes.shape, 3))
    try:
        parts = source.loaded(options)
        layers = _draped(parts, nodes) if recipe.drape else summed(parts, nodes)
        for index, layer in enumerate(layers):
            tensor[:, :, index], disturbance[:, :, index] = layer
    except TerrainError as error:
        raise MapError(str(error)) from None
    provenance = source.described(options)
    return nodes.map_of(tensor, disturbance, provenance, source.errors)


def nodes_of(recipe: MapRecipe) -> Nodes:
    """Return the nodes of a map; ``recipe`` must be a result of :func:`checked`."""
    step = recipe.spacing_arcmin / 60.0
    n_lat, n_lon, n_h = _node_counts(recipe)
    latitude = recipe.south_deg + step * np.arange(n_lat)
    longitude = recipe.west_deg + step * np.arange(n_lon)
    heights = recipe.min_height_m + recipe.height_spacing_m * np.arange(n_h)
    base = None
    if recipe.drape:
        from .drape import base_surface

        (part,) = SOURCES[recipe.source].loaded(options_of(recipe))
        assert isinstance(part, TerrainPart)
        base = base_surface(part.terrain, part.geoid_height_m, latitude, longitude)
    return Nodes(latitude, longitude, heights, base)


def _draped(parts: Sequence[Part], nodes: Nodes) -> Iterator[Layer]:
    """Yield the draped layers of a source whose only part is a terrain."""
    from .drape import DrapedTerrain

    (part,) = parts
    assert isinstance(part, TerrainPart)
    return DrapedTerrain.of(part, nodes, _TOLERANCE_EOTVOS)[0].layers(nodes)


def options_of(recipe: MapRecipe) -> PartOptions:
    """Return the options of a recipe that change the parts of its source."""
    return PartOptions(recipe.land_correction, recipe.relief_smoothing_deg, recipe.density_kg_m3)


def _kept(path: Path, recipe: MapRecipe) -> GradientMap:
    """Return the map of a recipe from the cache. Raises MapError if it is not there."""
    gradient_map = netcdf_reader.read(path)
    nodes = nodes_of(recipe)
    blank = nodes.map_of(
        np.broadcast_to(0.0, (*nodes.shape, 6)),
        np.broadcast_to(0.0, (*nodes.shape, 3)),
        SOURCES[recipe.source].described(options_of(recipe)),
    )
    if _identity(gradient_map) != _identity(blank):
        raise MapError(f"{path} was built from another recipe.")
    return gradient_map


def _identity(gradient_map: GradientMap) -> tuple[object, ...]:
    """Return the nodes and the provenance of a map."""
    m = gradient_map
    first = (m.latitude0, m.longitude0, m.height0)
    steps = (m.latitude_step, m.longitude_step, m.height_step)
    return *first, *steps, m.tensor.shape, m.provenance


def _keep(path: Path, nodes: Nodes, gradient_map: GradientMap) -> None:
    """Write a map into the cache, in double precision, with checksums and without compression.

    Raises MapError if the file cannot be written.
    """
    tensor, disturbance = gradient_map.tensor, gradient_map.gravity_disturbance
    netcdf.write_layers(
        path,
        nodes,
        ((tensor[:, :, index], disturbance[:, :, index]) for index in range(tensor.shape[2])),
        {"title": "Gravity-gradient map", "source": gradient_map.provenance},
        dtype="float64",
        compression=0,
        errors=(gradient_map.standard_error, gradient_map.error_distance),
    )


def cached_path(recipe: MapRecipe) -> Path:
    """Return the path of a map in the cache; ``recipe`` must be a result of :func:`checked`."""
    return cache_folder() / "maps" / f"{content_key(recipe)}.nc"


def checked(recipe: MapRecipe) -> MapRecipe:
    """Return a valid recipe, with longitudes shifted by whole turns to those of its source.

    Raises MapError in the cases of :func:`build`.
    """
    # Comparisons are such that NaN fails.
    if recipe.source not in SOURCES:
        raise MapError(
            f"Unknown map source {recipe.source!r}; allowed: {', '.join(sorted(SOURCES))}, normal, "
            "or the path of a map, *.nc."
        )
    if not 0.0 <= recipe.relief_smoothing_deg <= _WIDEST_SMOOTHING_DEG:
        raise MapError(
            f"relief_smoothing_deg = {recipe.relief_smoothing_deg} must lie between 0 (no "
            f"smoothing) and {_WIDEST_SMOOTHING_DEG:g}."
        )
    for name in ("spacing_arcmin", "height_spacing_m"):
        if not 0.0 < getattr(recipe, name) < math.inf:
            raise MapError(f"{name} = {getattr(recipe, name)} must be positive and finite.")
    _check_options(recipe)
    source_limits = SOURCES[recipe.source].limits()
    if recipe.drape:
        source_limits = _over_ground(recipe.source, source_limits)
    bounds = Area(west=recipe.west_deg, east=recipe.east_deg).about(
        0.5 * sum(source_limits.longitudes)
    )
    assert bounds.west is not None and bounds.east is not None  # as both were given
    recipe = dataclasses.replace(recipe, west_deg=bounds.west, east_deg=bounds.east)
    limits = (
        ("south_deg", "north_deg", *source_limits.latitudes),
        ("west_deg", "east_deg", *source_limits.longitudes),
        ("min_height_m", "max_height_m", *source_limits.heights),
    )
    for low, high, least, most in limits:
        lower, upper = getattr(recipe, low), getattr(recipe, high)
        if not lower < upper:
            raise MapError(f"{low} = {lower} must be less than {high} = {upper}.")
        for name, value in ((low, lower), (high, upper)):
            if not least <= value <= most:
                raise MapError(
                    f"{name} = {value} is outside the range of source {recipe.source!r}: "
                    f"{least:g} to {most:g} is allowed."
                )

    _check_spacings(recipe, source_limits)
    counts = _node_counts(recipe)
    if min(counts) < netcdf.FEWEST_NODES or math.prod(counts) > _MOST_NODES:
        raise MapError(
            f"Bounds and spacings give {counts} nodes in latitude, longitude and height: at least "
            f"{netcdf.FEWEST_NODES} in each and at most {_MOST_NODES} in all are allowed."
        )
    return recipe


def _over_ground(name: str, limits: Limits) -> Limits:
    """Return the limits of a draped map. Raises MapError if the source is no terrain."""
    if [type(part) for part in SOURCES[name].parts] != [ShippedTerrain]:
        sources = [
            name
            for name, source in SOURCES.items()
            if [type(part) for part in source.parts] == [ShippedTerrain]
        ]
        raise MapError(f"drape is not allowed for {name!r}; it is for {', '.join(sources)}.")
    words = "the height above the ground"
    return limits._replace(
        heights=(_LEAST_CLEARANCE_M, SOURCES[name].highest_m),
        spacing=SpacingRule(1.0, 1.0, 0.0, 0.0, words, words),
    )


def _check_options(recipe: MapRecipe) -> None:
    """Raise MapError if an option differs from its default but does not affect the source."""
    for option in dataclasses.fields(PartOptions):
        changed = getattr(recipe, option.name) != option.default
        if changed and option.name not in SOURCES[recipe.source].options:
            sources = [name for name, source in SOURCES.items() if option.name in source.options]
            raise MapError(
                f"{option.name} is not allowed for {recipe.source!r}; it is for "
                f"{', '.join(sources)}."
            )


def _check_spacings(recipe: MapRecipe, limits: Limits) -> None:
    """Raise MapError if the nodes lie too far apart for the height above the sources."""
    rule = limits.spacing
    widest = rule.vertical_share * (recipe.min_height_m - rule.vertical_ground_m)
    if recipe.height_spacing_m > widest:
        raise MapError(
            f"height_spacing_m = {recipe.height_spacing_m} is too wide for min_height_m = "
            f"{recipe.min_height_m}: at most {widest:g} is allowed, which is {rule.vertical_words}."
        )
    height = recipe.min_height_m + _MARGIN_NODES * recipe.height_spacing_m
    widest = math.degrees(rule.share * (height - rule.ground_m) / SEMI_MAJOR_AXIS) * 60.0
    if recipe.spacing_arcmin > widest:
        raise MapError(
            f"spacing_arcmin = {recipe.spacing_arcmin} is too wide for a map from a height of "
            f"{height:g} m: at most {widest:.3g} is allowed, which is {rule.words}."
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
    """Return the hash of all inputs of a map: recipe, source declaration, data files, code."""
    values = [v if isinstance(v, str) else float(v) for v in dataclasses.astuple(recipe)]
    digest = hashlib.sha256(json.dumps(values).encode())
    digest.update(rooms_hash(*MAP_ROOMS).encode())
    source = SOURCES[recipe.source]
    digest.update(source.declaration.encode())
    for name in source.files:
        digest.update(hashlib.sha256(data_bytes(name)).digest())
    return digest.hexdigest()[:32]


def read(path: Path | str, crop: Area | None = None) -> GradientMap:
    """Return the map of a netCDF file.

    With ``crop`` only the nodes of this area and of a margin are read.

    Raises
    ------
    MapError
        If the file does not exist or is not a complete map; the message states the fault.
    """
    return netcdf_reader.read(Path(path), crop)


def write(path: Path | str, gradient_map: GradientMap) -> None:
    """Write a map to a netCDF file, ``*.nc``, in double precision.

    The file is written atomically. A missing folder is created.

    Raises
    ------
    MapError
        If the file has another suffix, or cannot be written.
    """
    path = Path(path)
    if path.suffix != ".nc":
        raise MapError(f"the map file {path} must be named *.nc")
    netcdf.write(path, gradient_map)
