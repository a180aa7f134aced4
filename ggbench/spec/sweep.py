"""Sweeps: grids of cases, and values that reach a target error.

The axes of a ``[sweep]`` span a grid. Each point is an ordinary case, so campaigns and summaries
need no code for sweeps. A :class:`Sweep` stores the position of each case in the grid.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from .axes import AxisSpec, SweepSpec, number


@dataclass(frozen=True)
class Point:
    """Position of a case in the grid: name of the varied case or "", and index on each axis."""

    base: str
    indices: tuple[int, ...]


@dataclass(frozen=True)
class Sweep:
    """A grid of cases.

    Attributes
    ----------
    axes : axes in the order of the file; figures show the first axis horizontally, the second
        vertically.
    targets_m : target position errors [m]. A report states the value of the first axis at which the
        position error reaches a target.
    bases : titles of the varied cases by name; ``{"": ""}`` if the file has no cases.
    points : position in the grid of every case of the scenario, by name.
    """

    axes: tuple[AxisSpec, ...]
    targets_m: tuple[float, ...]
    bases: Mapping[str, str] = field(hash=False)
    points: Mapping[str, Point] = field(hash=False)


@dataclass(frozen=True)
class Cell:
    """Content of a grid point: varied case, name, title, and changes by each axis."""

    base: str
    name: str
    title: str
    changes: tuple[dict[str, Any], ...]


def lay_out(spec: SweepSpec, bases: Mapping[str, str]) -> tuple[Sweep, list[Cell]]:
    """Return the grid of a ``[sweep]`` table, and a list of the points.

    The points are ordered case by case, with the last axis varying fastest. ``bases`` maps
    the name of each varied case to its title. Without cases, the tables of the file itself are
    varied.
    The name of a point contains the coordinates, and the case's name if several cases are varied.
    """
    bases = bases or {"": ""}
    points, cells = {}, []
    for base, base_title in bases.items():
        for indices in itertools.product(*(range(len(axis.values)) for axis in spec.axis)):
            places = list(zip(spec.axis, indices, strict=True))
            name = "_".join(f"{axis.name}-{number(axis.values[i])}" for axis, i in places)
            title = ", ".join(f"{axis.name} {axis.at(i)}" for axis, i in places)
            if len(bases) > 1:
                name, title = f"{base}_{name}", f"{base_title}: {title}"
            changes = tuple(axis.change(i) for axis, i in places)
            points[name] = Point(base, indices)
            cells.append(Cell(base, name, title, changes))
    return Sweep(spec.axis, spec.targets_m, bases, points), cells


def largest_within(axis: AxisSpec, errors: np.ndarray, target: float) -> float:
    """Return the axis value up to which an error stays within a target.

    Between two grid points the logarithm of the error is linear in the coordinate of the axis (a
    power law on a logarithmic axis).

    Parameters
    ----------
    axis : the axis.
    errors : (n,) errors at the values of the axis; errors from the first NaN on are ignored.
    target : target error, in the unit of ``errors``.

    Returns
    -------
    The value. It is NaN if the first error is NaN, and −∞ if the first error exceeds the target. It
    is ∞ if no error is NaN and none exceeds the target. If all errors before the first NaN are
    within the target, it is the value of the axis at the last of them.
    """
    if math.isnan(errors[0]):
        return math.nan
    beyond = np.flatnonzero(~(errors <= target))
    if not len(beyond):
        return math.inf
    last = int(beyond[0]) - 1
    if last < 0:
        return -math.inf
    if math.isnan(errors[last + 1]):
        return axis.values[last]
    lower, upper = np.log(errors[last : last + 2])
    low, there = axis.coordinates()[last : last + 2]
    coordinate = low + (math.log(target) - lower) / (upper - lower) * (there - low)
    return float(10.0**coordinate if axis.scale == "log" else coordinate)
