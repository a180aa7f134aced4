"""Maps for scoring, chosen by name: a file, or a shipped region, terrain or survey."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import numpy as np

from ..gravity.ellipsoid import SEMI_MAJOR_AXIS
from ..gravity.gradient_map import GradientMap, MapError
from ..gravity.meridians import Area
from ..maps.recipe import MapRecipe, load_or_build, read
from ..maps.shipped import SOURCES, Limits
from .score import Bounds, Design, cells_between

_LAYERS = 2
"""Layers of nodes below the height of the flights, and above it."""
_WIDEST_STEP_M = 500.0
"""Vertical spacing of nodes [m]; smaller where a recipe demands it."""
_WIDEST_ARCMIN = 2.0
_SHRINK = 0.999
"""Factor that keeps a spacing on the allowed side of a recipe's limit after rounding."""
_STRETCH = 1.01
"""A degree along a meridian is up to 0.7 % shorter than a degree of the equator."""


def named_map(name: str, design: Design, bounds: Bounds) -> tuple[GradientMap, float]:
    """Return a map by its name, and the height of the flights for its score [m].

    Parameters
    ----------
    name : path of a map, ``*.nc``, or the name of a shipped region, terrain or survey.
    design : cells, instrument and tracks. The default height is that of the lowest nodes of a file,
        or the lowest height of a shipped region.
    bounds : area of the cells; a map of a shipped region is built only as large as needed.

    Raises
    ------
    MapError
        If the map does not exist, or a shipped region does not allow this height or size.
    """
    if name not in SOURCES:
        if not name.endswith((".nc", ".npz")):
            raise MapError(
                f"{name} is not a map: give a file *.nc of 'ggbench map build', or one of "
                f"{', '.join(sorted(SOURCES))}"
            )
        gradient_map = read(Path(name))
        return gradient_map, gradient_map.height0 if design.height_m is None else design.height_m
    source = SOURCES[name].limits()
    lowest, highest = source.heights
    height = lowest if design.height_m is None else design.height_m
    if not lowest <= height <= highest:
        raise MapError(
            f"the height {height:g} m is outside {name}, which has {lowest:g} to {highest:g} m"
        )
    around_m = design.reach + (design.track_m or 0.0)
    recipe = _recipe(name, source, height, bounds, around_m)
    # Building a map is slow: first check that it will hold a cell.
    lower = np.array([*np.radians([recipe.south_deg, recipe.west_deg]), recipe.min_height_m])
    upper = np.array([*np.radians([recipe.north_deg, recipe.east_deg]), recipe.max_height_m])
    cells_between(lower, upper, dataclasses.replace(design, height_m=height), bounds, name)
    return load_or_build(recipe), height


def _recipe(name: str, source: Limits, height: float, bounds: Bounds, around_m: float) -> MapRecipe:
    """Return the recipe of a map of five layers about a height, with the widest spacings allowed.

    The map reaches ``around_m`` [m] beyond the bounds, as far as the source has data.
    """
    (lowest, highest), rule = source.heights, source.spacing

    def bottom_of(step: float) -> float:
        return min(max(lowest, height - _LAYERS * step), highest - 2 * _LAYERS * step)

    step, ground = _WIDEST_STEP_M, rule.vertical_ground_m
    if step > rule.vertical_share * (bottom_of(step) - ground):
        # The lowest layer is high enough for its step, also where it is moved below.
        share = rule.vertical_share
        room = share * min(
            (height - ground) / (_LAYERS * share + 1),
            (highest - ground) / (2 * _LAYERS * share + 1),
        )
        step = min(step, _SHRINK * room)
    bottom = bottom_of(step)
    spacing = _spacing_arcmin(rule.share * (bottom + _LAYERS * step - rule.ground_m))
    south, north, west, east = _sides(source, bounds, around_m, spacing / 60.0)
    if not (south < north and west < east):
        latitudes, longitudes = source.latitudes, source.longitudes
        raise MapError(
            f"{name} lies outside the bounds: it covers {latitudes[0]:g}° to "
            f"{latitudes[1] - spacing / 60.0:g}° N and {longitudes[0]:g}° to "
            f"{longitudes[1] - spacing / 60.0:g}° E"
        )
    return MapRecipe(
        source=name,
        south_deg=south,
        north_deg=north,
        west_deg=west,
        east_deg=east,
        min_height_m=bottom,
        max_height_m=bottom + 2 * _LAYERS * step,
        spacing_arcmin=spacing,
        height_spacing_m=step,
    )


def _spacing_arcmin(widest_m: float) -> float:
    """Return the largest spacing [arcmin] for a limit [m], rounded down to 0.001 arcmin."""
    widest = math.degrees(widest_m / SEMI_MAJOR_AXIS) * 60.0
    return min(_WIDEST_ARCMIN, math.floor(1e3 * widest) / 1e3)


def _sides(
    source: Limits, bounds: Bounds, around_m: float, spacing: float
) -> tuple[float, float, float, float]:
    """Return the map's south, north, west and east [deg]; ``spacing`` [deg] separates its nodes."""
    (south, north), (west, east) = source.latitudes, source.longitudes
    # The last nodes may lie up to one spacing beyond the bounds of a recipe.
    north, east = north - spacing, east - spacing
    margin = math.degrees(around_m / SEMI_MAJOR_AXIS) * _STRETCH + spacing
    wide = margin / math.cos(math.radians(max(abs(south), abs(north))))
    area = Area(*bounds).about(0.5 * (west + east)).widened(margin, wide)
    return (
        south if area.south is None else max(south, area.south),
        north if area.north is None else min(north, area.north),
        west if area.west is None else max(west, area.west),
        east if area.east is None else min(east, area.east),
    )
