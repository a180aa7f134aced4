"""Sweeps: a grid of cases, and the sensor that a required error needs.

The axes of a ``[sweep]`` span a grid. Each of its points is an ordinary case, so that running,
resuming and summarizing know nothing of sweeps; a :class:`Sweep` says which case lies where.
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
    """Where a case lies: the case of the file it varies ("" for none), and its index per axis."""

    base: str
    indices: tuple[int, ...]


@dataclass(frozen=True)
class Sweep:
    """A grid of cases.

    Attributes
    ----------
    axes : in the file's order; figures show the first across and the second up.
    targets_m : position errors that a report finds the first axis's values for [m].
    bases : name to title of the cases over which the grid is laid; {"": ""} if there are none.
    points : name of every case of the scenario to its place in the grid.
    """

    axes: tuple[AxisSpec, ...]
    targets_m: tuple[float, ...]
    bases: Mapping[str, str] = field(hash=False)
    points: Mapping[str, Point] = field(hash=False)


@dataclass(frozen=True)
class Cell:
    """A grid point before it is a case: case that it varies, name, title, each axis's change."""

    base: str
    name: str
    title: str
    changes: tuple[dict[str, Any], ...]


def lay_out(spec: SweepSpec, bases: Mapping[str, str]) -> tuple[Sweep, list[Cell]]:
    """Return the grid of a ``[sweep]`` table and its points, case by case, the last axis fastest.

    ``bases`` is name to title of the cases to vary; without any, the base of the file is varied.
    A point is named after its coordinates, and after its case if there are several.
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
    """Return the largest value of an axis up to which an error stays within a target.

    Between two grid points the logarithm of the error is linear in the axis's coordinate (a power
    law on a logarithmic axis).

    Parameters
    ----------
    axis : the axis.
    errors : (n,) errors at its values; NaN where there is none, and nothing is known beyond it.
    target : the error to stay within, in the same unit.

    Returns
    -------
    The value; −∞ if already the first error is larger, ∞ if none is, NaN if the first is NaN.
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
