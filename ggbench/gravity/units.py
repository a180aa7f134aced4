"""Units and signs of the values of height, geoid and gravity grids."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .quantity_names import contradiction, named_quantities
from .terrain import HIGHEST_M, LOWEST_M, TerrainError
from .unit_names import has_zero_level, unit_at_end, unit_in_brackets, unit_named

Array = NDArray[np.floating]

_KEYS = {"gravity": "value_mgal", "length": "value_m"}
"""Keys of quantities, for :func:`.unit_names.unit_at_end`."""
_DEPTH = re.compile(r"(water|sea.?floor|ocean|bottom)?[ _]?depths?(?![a-z])")


@dataclass(frozen=True)
class Units:
    """Allowed units and limits of a quantity that is read from grids.

    Attributes
    ----------
    what : name of the quantity in messages.
    quantity : name of the quantity in :mod:`.unit_names`.
    allowed : text for messages that lists the allowed units.
    assumed : unit that is assumed if a file names none.
    lowest, highest : smallest and largest value of the quantity on the Earth [SI units].
    says_assumed : whether a remark states that the unit was assumed.
    voids : additional values in the file that mark voids.
    kind : kind of input, see :func:`.quantity_names.contradiction`.
    """

    what: str
    quantity: str
    allowed: str
    assumed: str
    lowest: float
    highest: float
    says_assumed: bool = False
    voids: tuple[float, ...] = ()
    kind: str = ""

    def require_named(self, described: str, name: str) -> None:
        """Raise TerrainError if the description of a file's values names another quantity.

        If the description names no quantity, the name of the file is checked instead, except for
        terrains, whose files are named after places.
        """
        is_named = named_quantities(described) or self.kind == "terrain"
        text = described.strip() if is_named else Path(name).stem
        if self.kind and (reason := contradiction(self.kind, text)):
            raise TerrainError(f"{name} holds {text!r}: {reason}.")

    def factor(self, unit: str, name: str, described: str = "") -> tuple[float, str]:
        """Return the factor from a file's unit to the SI unit, and a remark on the unit.

        ``unit`` is the unit stated by the file. If it is empty, the unit comes from the description
        ``described``: from brackets, as in GMT's ``faa (mGal)``, or from the end of the text.

        Raises TerrainError if the unit belongs to another quantity; the message names the file.
        """
        stated = (
            unit.strip()
            or unit_in_brackets(described)
            or unit_at_end(described, _KEYS[self.quantity])
        )
        usual = unit_named(self.assumed)
        assert usual is not None  # a unit of the tables
        if not stated:
            remark = f"no unit given, {self.assumed} assumed" if self.says_assumed else ""
            return usual.factor, remark
        named = unit_named(stated)
        if named is None or named.quantity != self.quantity:
            raise TerrainError(f"{name} has {self.what} in {stated!r}; {self.allowed} are allowed.")
        if has_zero_level(stated):
            return named.factor, f"heights in {stated!r}"
        return named.factor, "" if named.factor == usual.factor else f"converted from {stated}"


HEIGHTS = Units("heights", "length", "metres or feet", "m", LOWEST_M, HIGHEST_M, kind="terrain")
GEOID = Units("a geoid", "length", "metres or feet", "m", -150.0, 150.0)
GRAVITY = Units(
    what="gravity",
    quantity="gravity",
    allowed="mGal, µGal, Gal or m/s²",
    assumed="mGal",
    lowest=-0.02,
    highest=0.02,
    says_assumed=True,
)


def unit_of(attributes: Mapping[str, Any]) -> str:
    """Return the attribute ``units`` or ``unit`` of a variable; "" if there is neither."""
    stated = (str(v) for k, v in attributes.items() if k.lower() in ("units", "unit"))
    return next(stated, "").strip()


def upward(
    values: Array, attributes: Mapping[str, Any], variable: str, name: str
) -> tuple[Array, str]:
    """Return an array (...) of heights, positive up, and a remark ("" if the values are unchanged).

    Depths are negated. Values are depths if their attribute ``positive`` is ``down``, if their CF
    standard name is that of a depth, or if they are named depth and are nowhere negative.

    Parameters
    ----------
    values : (...) heights or depths in any unit; NaN for missing values.
    attributes : attributes of the netCDF variable.
    variable, name : names of the variable and of the file, for remarks and messages.

    Raises
    ------
    TerrainError
        If it is unclear whether the values are heights or depths.
    """
    positive = str(attributes.get("positive", "")).strip().lower()
    if positive == "down":
        return -values, "depths (positive down) were negated"
    standard, long = (
        str(attributes.get(key, "")).lower() for key in ("standard_name", "long_name")
    )
    by_standard = standard == "depth" or standard.startswith("sea_floor_depth")
    by_name = any(_DEPTH.match(word) for word in (variable.lower(), long))
    finite = values[np.isfinite(values)]
    if positive == "up" or not (by_standard or by_name) or not finite.size:
        return values, ""
    if (by_standard and finite.max() > 0.0) or finite.min() >= 0.0:
        return -values, f"depths ({(standard if by_standard else variable or long)}) were negated"
    if finite.max() <= 0.0 and not by_standard:
        return values, ""
    raise TerrainError(
        f"{name} has depths from {finite.min():g} to {finite.max():g} without a direction: set the "
        "attribute positive of the variable to 'up' or 'down'."
    )
