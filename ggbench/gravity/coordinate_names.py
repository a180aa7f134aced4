"""Checks of the names of coordinate columns: axis, sign, datum and zero level of heights."""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import NDArray

_AXES = {
    "latitude_deg": ("longitude", r"(?<![a-z])lon(?:g|gitude)?s?(?![a-z])"),
    "longitude_deg": ("latitude", r"(?<![a-z])lat(?:itude)?s?(?![a-z])"),
    "easting_m": ("northing", r"(?<![a-z])north(?:ing)?s?(?![a-z])"),
    "northing_m": ("easting", r"(?<![a-z])east(?:ing)?s?(?![a-z])"),
}
"""Coordinate that may be confused with each key, and a pattern of its names."""
_SEXAGESIMAL = re.compile(r"(?<![a-z])(?:dms|dmm|dd?mm[a-z.]*|hms)(?![a-z])")
_NED = re.compile(
    r"(?<![a-z])ned(?![a-z])|north[ ,-]*east[ ,-]*down|(?<![a-z])z[ -](?:is |positive |axis )*down"
)
"""Names of axes north, east, down, or of a z axis down."""
_COLATITUDE = re.compile(r"co-?lat")
_NEGATIVE = {
    "latitude_deg": ("south", re.compile(r"south|[_ (\[]s[)\]]?$")),
    "longitude_deg": ("west", re.compile(r"west|[_ (\[]w[)\]]?$")),
    "height_m": ("down", re.compile(r"depth|(?<![a-z])down(?![a-z])")),
}
"""Direction in which the values of each key are negative, and a pattern of its names."""
_OLD_DATUM = re.compile(
    r"(?<![a-z])(agd(?:[_ ]?(?:66|84))?|nad[_ ]?27|ed[_ ]?50|osgb(?:[_ ]?36)?|tokyo|pulkovo|clarke)"
    r"(?![a-z])"
)
"""Datums whose coordinates differ from those of WGS 84 by 50 m or more."""
_WORD = r"(?<![a-z])(?:{})(?![a-z])"
_LEVELS = {
    "the ground": re.compile(
        r"above[ _]*(?:the[ _]*)?(?:ground|terrain|surface|take)|"
        r"clearance|rad(?:ar)?[ _]?alt|laser|agl(?![a-z])|" + _WORD.format("hag|ralt|dtm|dem|radar")
    ),
    "sea level": re.compile(
        r"sea[ _-]?level|geoid|ortho(?:m|h|_|(?![a-z]))|height[ _]datum|msl|"
        + _WORD.format(r"asl|ahd\d*|n[ag]vd\d*|egm\d*")
    ),
}
"""Zero levels of heights, and the words that name them."""


def contradiction_of_axis(key: str, name: str, values: NDArray[np.float64]) -> str:
    """Return the contradiction between a coordinate key and the name of a column; "" if none.

    Parameters
    ----------
    key : ``latitude_deg``, ``longitude_deg``, ``height_m``, ``easting_m`` or ``northing_m``. For
        other keys the result is "".
    name : name of the column, with its description.
    values : (N,) numbers of the column, in the unit of the key; NaN for missing values.
    """
    plain, own = name.casefold(), key.rpartition("_")[0]
    if key in _AXES and own not in plain and re.search(_AXES[key][1], plain):
        other = _AXES[key][0]
        return f"it names a {other}: check whether the columns are swapped"
    if key == "latitude_deg" and _COLATITUDE.search(plain):
        return "colatitudes are not supported; give latitudes, positive north"
    if key in ("latitude_deg", "longitude_deg") and _SEXAGESIMAL.search(plain):
        return "degrees, minutes and seconds are not supported; give decimal degrees"
    if key in _NEGATIVE:
        direction, words = _NEGATIVE[key]
        if words.search(plain) and (values > 0.0).any():
            return (
                f"the column name indicates positive {direction}; {own}s must be negative in that "
                "direction: change the sign"
            )
    return ""


def old_datum(text: str) -> str:
    """Return the name of an old datum in a text; "" if the text contains none.

    Coordinates in an old datum differ by 50 m or more from those in WGS 84.
    """
    match = _OLD_DATUM.search(text.casefold())
    return match[1].upper() if match else ""


def zero_level(name: str) -> str:
    """Return the zero level that the name of a height states; "" if it states none.

    The zero level is a phrase for messages: ``sea level`` or ``the ground``. The result is also ""
    for heights above the ellipsoid.
    """
    plain = name.casefold()
    if "ellips" in plain:
        return ""
    return next((level for level, words in _LEVELS.items() if words.search(plain)), "")


def names_axes_down(text: str) -> bool:
    """Return whether a text names axes north, east, down, or a z axis down."""
    return _NED.search(text.casefold()) is not None
