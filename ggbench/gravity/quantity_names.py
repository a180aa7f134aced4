"""Quantities of the gravity field in names and descriptions of columns and grids."""

from __future__ import annotations

import re

_WORD = r"(?<![a-z])(?:{})\d*(?:mgal|gu|um)?(?![a-z])"
_REDUCED = "a Bouguer or isostatic anomaly"
_ERROR = "an error"
_OTHER_RASTER = "a slope, a shading or another raster"
_GRAVITY = re.compile(r"(?<![a-z])(?:grav(?:ity)?|g_?z|gd)(?![a-z])")
"""Pattern of names of gravity, in contrast to gravity gradients."""
_TERRAIN = re.compile(
    r"terrain|(?<![a-z])tc(?![a-z])|(?<!\d)(?:1[._p]?[89]\d?|2[._p]?[2-9]\d)(?![\dm])"
)
"""Pattern of names of values with a terrain correction: ``terrain``, ``tc`` or a rock density."""
_NAMES = {
    _REDUCED: r"boug|isostat|" + _WORD.format("[cgs]?ba|scba|bga"),
    "a free-air anomaly": r"free[ _-]?air|gravity[ _]?anomal|f_a_anom|" + _WORD.format("g?faa?"),
    "a gravity disturbance": r"disturb",
    "a correction": r"correction|(?:lat|drift|tide|eotvos)corr|"
    + _WORD.format("[a-z_]*_corr?|[eg]?fac|tc"),
    "normal gravity": r"(?:theoretical|normal)[ _]?grav|" + _WORD.format("igf"),
    _ERROR: r"standard[ _]dev|uncertaint|" + _WORD.format("err(?:or)?s?|std|stdev|sigma"),
    "observed gravity": r"(?:observed|absolute)[ _]?grav|" + _WORD.format("obs_?g(?:rav)?"),
    "a gravity gradient": r"vgg|gradient|eotvos|eötvös|"
    + _WORD.format("[gtuvw]?(?:[xyz]{2}|[ned]{2})|guv"),
    "a geoid": r"geoid|undulation|height[ _]?anomal",
    "a magnetic field": r"magnet|" + _WORD.format("tmi|rtp|mag(?:tf)?"),
    "a height of a surface": r"elevation|topograph|bathymetr|sea[ _]?surface|"
    + _WORD.format("dem|dsm|dtm|mss|mdt"),
    _OTHER_RASTER: r"slope|hill[ _]?shade|canopy|above[ _]ground|"
    + _WORD.format("aspect|intensity|amplitude"),
}
_PATTERNS = {quantity: re.compile(pattern) for quantity, pattern in _NAMES.items()}
_OF_KIND = {
    "anomaly": "a free-air anomaly",
    "disturbance": "a gravity disturbance",
    "gradient": "a gravity gradient",
    "geoid": "a geoid",
    "terrain": "a height of a surface",
}
_PARTS_OF_GRADIENTS = {"a correction", "a height of a surface"}
"""Other quantities that the name of a gradient column may contain."""
_REASONS = {
    _REDUCED: (
        "only free-air anomalies or disturbances are allowed: Bouguer and isostatic anomalies "
        "exclude the attraction of the rock"
    ),
    "a free-air anomaly": (
        "anomalies differ from disturbances by 0.3 mGal per metre of geoid height: give it as an "
        "anomaly"
    ),
    "a gravity disturbance": "give it as a disturbance",
}


def named_quantities(text: str) -> set[str]:
    """Return the gravity-field quantities that occur in a text.

    The quantities are phrases for messages, such as ``a geoid``.
    """
    plain = text.casefold()
    return {quantity for quantity, pattern in _PATTERNS.items() if pattern.search(plain)}


def contradiction(kind: str, text: str) -> str:
    """Return the contradiction between a kind of input and its description; "" if none.

    Parameters
    ----------
    kind : ``anomaly``, ``disturbance``, ``gradient``, ``geoid`` or ``terrain``.
    text : name and description of a column or a grid.
    """
    named = named_quantities(text)
    allowed = _OF_KIND[kind]
    if kind == "gradient":
        named -= _PARTS_OF_GRADIENTS
    if kind == "terrain" and "height above" in text.casefold().replace("_", " "):
        named.discard("a geoid")  # their zero level
    if not named or (allowed in named and named.isdisjoint({_REDUCED, _ERROR, _OTHER_RASTER})):
        return ""
    others = named - {allowed}
    stated = _ERROR if _ERROR in named else next(each for each in _PATTERNS if each in others)
    return f"that is {stated}; {_REASONS.get(stated, f'{allowed} is allowed')}"


def names_gravity(name: str) -> bool:
    """Return whether the name of a column names gravity and no other quantity."""
    return not named_quantities(name) and _GRAVITY.search(name.casefold()) is not None


def is_corrected_for_terrain(name: str) -> bool:
    """Return whether the name of a column indicates a terrain correction."""
    return _TERRAIN.search(name.casefold()) is not None
