"""Tables of sweeps: axes of a grid of cases."""

from __future__ import annotations

import itertools
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, model_validator

from . import quantities as q
from .named_sensors import short_key
from .tables import Finite, FreeTable, Listed, Section, Title, nested

AxisName = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9.]*$", max_length=20)]
MOST_POINTS = 10_000
"""Most grid points of a sweep."""


class AxisSpec(Section):
    """``[[sweep.axis]]``: an axis of the grid, with values and the change for each value."""

    name: AxisName
    """Short name of the axis in names of cases."""
    label: Title
    """Label of the axis in a figure."""
    unit: str = ""
    """Unit of the values."""
    scale: Literal["linear", "log"] = "linear"
    """Scale of the axis in figures."""
    values: Annotated[Listed[Finite | int], Field(min_length=2)]
    """Increasing values; at least two."""
    key: Title | None = None
    """Dotted key that is set to the value; or give `changes`."""
    changes: Listed[FreeTable] | None = None
    """List of tables, one for each value, with the changes to make; or give `key`."""

    @model_validator(mode="after")
    def _check(self) -> AxisSpec:
        axis = f"axis '{self.name}'"
        if any(b <= a for a, b in itertools.pairwise(self.values)):
            raise ValueError(f"values of {axis} must increase strictly, found {[*self.values]}")
        if self.scale == "log" and self.values[0] <= 0.0:
            raise ValueError(
                f"values of {axis} must be positive on a logarithmic scale, found {self.values[0]}"
            )
        if (self.key is None) == (self.changes is None):
            raise ValueError(f"{axis} needs exactly one of 'key' and 'changes'")
        if self.changes is not None and len(self.changes) != len(self.values):
            raise ValueError(
                f"{axis} has {len(self.values)} values and {len(self.changes)} changes; give one "
                "change for each value"
            )
        for key in sorted(self.changed_keys()):
            if key.partition(".")[0] in ("name", "title", "reference"):
                raise ValueError(f"{axis} changes '{key}', which does not affect the flight")
        return self

    def change(self, index: int) -> dict[str, Any]:
        """Return the changes of a case that belong to the value at ``index``, as nested tables."""
        if self.changes is not None:
            return dict(self.changes[index].content())
        assert self.key is not None  # checked above
        return nested(self.key, self.values[index])

    @property
    def title(self) -> str:
        """Label of the axis with the unit."""
        return f"{self.label} [{self.unit}]" if self.unit else self.label

    def at(self, index: int) -> str:
        """Return the value at ``index`` as text with the unit, for example ``0.01 E``."""
        return f"{number(self.values[index])} {self.unit}".rstrip()

    def coordinates(self) -> np.ndarray:
        """Return the values (n,) on the scale of the axis: log10 for a logarithmic axis."""
        values = np.array(self.values, dtype=float)
        return np.log10(values) if self.scale == "log" else values

    def changed_keys(self) -> set[str]:
        """Return the dotted keys that the axis changes.

        If a sensor is named like its kind, its keys have the short form ``gnss.period_s``, without
        ``sensor.``.
        """
        return {short_key(key) for i in range(len(self.values)) for key in _dotted(self.change(i))}


class SweepSpec(Section):
    """``[sweep]``: axes of a grid of cases, and target errors."""

    axis: Listed[AxisSpec] = ()
    targets_m: Listed[q.PositionTarget] = ()
    """Target position errors. For each target the report gives the value on the first axis at
    which the error reaches it.
    """

    @model_validator(mode="after")
    def _check(self) -> SweepSpec:
        if not self.axis:
            raise ValueError("needs at least one [[sweep.axis]]")
        for one, other in itertools.combinations(self.axis, 2):
            if one.name == other.name:
                raise ValueError(f"axis '{one.name}' is defined twice")
            for key, other_key in itertools.product(one.changed_keys(), other.changed_keys()):
                if f"{key}.".startswith(f"{other_key}.") or f"{other_key}.".startswith(f"{key}."):
                    raise ValueError(f"axes '{one.name}' and '{other.name}' both change {key}")
        return self


def number(value: float) -> str:
    """Return a number as short, exact text for names and tables: ``0.0001``, ``3e-6``."""
    short = f"{value:g}"
    if float(short) != value:
        short = repr(value)
    mantissa, e, exponent = short.partition("e")
    return f"{mantissa}e{int(exponent)}" if e else short


def _dotted(table: dict[str, Any]) -> list[str]:
    """Return the dotted keys of nested tables."""
    return [
        f"{key}.{rest}" if rest else key
        for key, value in table.items()
        for rest in (_dotted(value) if isinstance(value, dict) else [""])
    ]
