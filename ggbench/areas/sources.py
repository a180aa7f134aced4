"""The field of a map that is named: a file, or a region that the package carries."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import numpy as np

from ..gravity.ellipsoid import SEMI_MAJOR_AXIS
from ..gravity.gradient_map import GradientMap, MapError
from ..gravity.meridians import Area
from ..maps.recipe import MapRecipe, load_or_build, read
from ..maps.shipped_regions import SOURCES, extent_deg
from ..maps.shipped_terrains import (
    TERRAINS,
    highest_ground_m,
    terrain_extent_deg,
    terrain_heights_m,
)
from .score import Bounds, Design, cells_between

_WIDEST_HEIGHT_SPACING_M = 500.0
_LAYERS = 2  # below the height and above it
_WIDEST_ARCMIN = 2.0


def named_map(name: str, design: Design, bounds: Bounds) -> tuple[GradientMap, float]:
    """Return the map of a name, and the height at which it is to be scored [m].

    Parameters
    ----------
    name : the path of a map, ``*.nc`` or ``*.npz``, or the name of a shipped region or terrain.
    design : what is asked of its cells; without a height, it is that of a file's lowest nodes, of a
        shipped region the lowest that it gives.
    bounds : of the cells; of a shipped region no more is made than they need.

    Raises
    ------
    MapError
        If there is no such map, or a shipped region does not give the height or so many nodes.
    """
    if name not in SOURCES and name not in TERRAINS:
        if not name.endswith((".nc", ".npz")):
            raise MapError(
                f"{name} is no map: give a file *.nc or *.npz of 'ggbench map build', or one of "
                f"{', '.join(sorted([*SOURCES, *TERRAINS]))}"
            )
        found = read(Path(name))
        return found, found.height0 if design.height_m is None else design.height_m
    if name in TERRAINS:
        lowest, highest = terrain_heights_m(name)
    else:
        lowest, highest = SOURCES[name].lowest_height_m, SOURCES[name].highest_height_m
    height = lowest if design.height_m is None else design.height_m
    if not lowest <= height <= highest:
        raise MapError(
            f"the height {height:g} m is not in what {name} gives: {lowest:g} to {highest:g} m is"
        )
    around_m = design.reach + (design.track_m or 0.0)
    recipe = _recipe(name, height, lowest, highest, bounds, around_m)
    # A map takes its time: that it will hold a cell is found out before.
    lower = np.array([*np.radians([recipe.south_deg, recipe.west_deg]), recipe.min_height_m])
    upper = np.array([*np.radians([recipe.north_deg, recipe.east_deg]), recipe.max_height_m])
    cells_between(lower, upper, dataclasses.replace(design, height_m=height), bounds, name)
    return load_or_build(recipe), height


def _recipe(
    name: str, height: float, lowest: float, highest: float, bounds: Bounds, around_m: float
) -> MapRecipe:
    """A map of five layers about a height, its nodes as far apart as :class:`MapRecipe` allows."""
    step, share = _WIDEST_HEIGHT_SPACING_M, 0.25
    if name in TERRAINS:
        (south, north), (west, east) = terrain_extent_deg(name)
        ground, share = highest_ground_m(name), 0.6
        # The lowest layer is as far above the ground, wherever the limits of the heights put it.
        room = min((height - ground) / (_LAYERS + 1), (highest - ground) / (2 * _LAYERS + 1))
        step = min(step, 0.999 * room)
    else:
        (south, north), (west, east) = extent_deg(SOURCES[name])
        ground = -SOURCES[name].source_depth_m
    bottom = min(max(lowest, height - _LAYERS * step), highest - 2 * _LAYERS * step)
    widest = math.degrees(share * (bottom + _LAYERS * step - ground) / SEMI_MAJOR_AXIS) * 60.0
    # Rounded down: what the recipe allows is reckoned to the last digit.
    spacing = min(_WIDEST_ARCMIN, math.floor(1e3 * widest) / 1e3)
    # The last nodes may lie beyond the bounds by less than a spacing.
    north, east = north - spacing / 60.0, east - spacing / 60.0
    margin = math.degrees(around_m / SEMI_MAJOR_AXIS) * 1.01 + spacing / 60.0
    wide = margin / math.cos(math.radians(max(abs(south), abs(north))))
    bounds = Bounds(*Area(*bounds).about(0.5 * (west + east)))
    sides = (
        south if bounds.south is None else max(south, bounds.south - margin),
        north if bounds.north is None else min(north, bounds.north + margin),
        west if bounds.west is None else max(west, bounds.west - wide),
        east if bounds.east is None else min(east, bounds.east + wide),
    )
    if not (sides[0] < sides[1] and sides[2] < sides[3]):
        raise MapError(
            f"nothing of {name} lies in the bounds: it covers {south:g}° to {north:g}° N and "
            f"{west:g}° to {east:g}° E"
        )
    return MapRecipe(
        source=name,
        south_deg=sides[0],
        north_deg=sides[1],
        west_deg=sides[2],
        east_deg=sides[3],
        min_height_m=bottom,
        max_height_m=bottom + 2 * _LAYERS * step,
        spacing_arcmin=spacing,
        height_spacing_m=step,
    )
