"""Units and signs of grids of heights, geoid and gravity."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .terrain import HIGHEST_M, LOWEST_M, TerrainError

Array = NDArray[np.floating]

_METRES = {
    **dict.fromkeys(("m", "metre", "meter", "metres", "meters", "metre(s)"), 1.0),
    **dict.fromkeys(("ft", "foot", "feet", "international foot"), 0.3048),
    **dict.fromkeys(("us-ft", "ftus", "us survey foot", "foot_us"), 1200.0 / 3937.0),
    **dict.fromkeys(("dm", "decimetre", "decimeter"), 0.1),
    **dict.fromkeys(("cm", "centimetre", "centimeter"), 0.01),
    **dict.fromkeys(("km", "kilometre", "kilometer"), 1000.0),
}
_MPS2 = {
    **dict.fromkeys(("mgal", "milligal", "milligals", "1e-5 m s-2", "1e-5 m/s2"), 1e-5),
    **dict.fromkeys(("ugal", "μgal", "microgal", "microgals"), 1e-8),
    **dict.fromkeys(("gal", "gals", "cm/s2", "cm/s^2", "cm s-2", "cm s^-2", "cm/s²"), 1e-2),
    **dict.fromkeys(("m/s2", "m/s^2", "m/s**2", "m/s²", "m s-2", "m s^-2", "m s**-2"), 1.0),
}
_ZERO_LEVEL = re.compile(r"[\s,(]+((above|over|rel\w*)\b.*|a\.?\s?s\.?\s?l\.?|a?msl)\)?$")
_DEPTH = re.compile(r"(water|sea.?floor|ocean|bottom)?[ _]?depths?(?![a-z])")


@dataclass(frozen=True)
class Units:
    """The units that a grid of one quantity may have, and its limits.

    Attributes
    ----------
    what : the quantity, as messages call it.
    factors : SI units per unit, by its name in lower case.
    allowed : the units, as messages call them.
    assumed : unit of a file that names none.
    lowest, highest : limits of the quantity on the Earth [SI units].
    says_assumed : whether a remark says that the unit was assumed.
    voids : values that mark voids, as they are in the file, besides the usual ones.
    """

    what: str
    factors: Mapping[str, float]
    allowed: str
    assumed: str
    lowest: float
    highest: float
    says_assumed: bool = False
    voids: tuple[float, ...] = ()

    def factor(self, unit: str, name: str) -> tuple[float, str]:
        """Return SI units per unit of a file, which may be empty, and what to say of it.

        Raises TerrainError, naming the file, if it is no unit of this quantity.
        """
        if not unit.strip():
            remark = f"no unit given, {self.assumed} assumed" if self.says_assumed else ""
            return self.factors[self.assumed.casefold()], remark
        # Of 'meters above mean sea level' the first word is the unit.
        plain = unit.strip().casefold()  # makes one letter of the two that look like µ
        bare = _ZERO_LEVEL.sub("", plain)
        factor = self.factors.get(bare)
        if factor is None:
            raise TerrainError(f"{name} has {self.what} in {unit!r}; {self.allowed} are allowed.")
        if bare != plain:
            return factor, f"heights in {unit!r}"
        usual = self.factors[self.assumed.casefold()]
        return factor, "" if factor == usual else f"converted from {unit}"


HEIGHTS = Units("heights", _METRES, "metres or feet", "m", LOWEST_M, HIGHEST_M)
GEOID = Units("a geoid", _METRES, "metres or feet", "m", -150.0, 150.0)
GRAVITY = Units(
    what="gravity",
    factors=_MPS2,
    allowed="mGal, µGal, Gal or m/s²",
    assumed="mGal",
    lowest=-0.02,
    highest=0.02,
    says_assumed=True,
)


def upward(
    values: Array, attributes: Mapping[str, Any], variable: str, name: str
) -> tuple[Array, str]:
    """Return heights, positive up, and what to say of them.

    Depths are negated: those whose attribute ``positive`` is ``down``; those that the standard
    names of the CF conventions call a depth; those that are called one and are nowhere negative.
    Values are NaN where there is none; ``variable`` is their name, and ``name`` the file's.

    Raises TerrainError if it is not clear which way they count.
    """
    positive = str(attributes.get("positive", "")).strip().lower()
    if positive == "down":
        return -values, "depths, positive down, negated"
    standard, long = (
        str(attributes.get(key, "")).lower() for key in ("standard_name", "long_name")
    )
    by_standard = standard == "depth" or standard.startswith("sea_floor_depth")
    by_name = any(_DEPTH.match(word) for word in (variable.lower(), long))
    known = values[np.isfinite(values)]
    if positive == "up" or not (by_standard or by_name) or not known.size:
        return values, ""
    if (by_standard and known.max() > 0.0) or known.min() >= 0.0:
        return -values, f"depths ({standard if by_standard else variable or long}) negated"
    if known.max() <= 0.0 and not by_standard:
        return values, ""
    raise TerrainError(
        f"{name} has depths from {known.min():g} to {known.max():g}, and does not say which way "
        "they count: set the attribute positive of the variable to 'up' or 'down'."
    )
