"""Quantities of the gravity field in names and descriptions of columns and grids."""

from __future__ import annotations

import re

_WORD = r"(?<![a-z])(?:{})\d*(?:mgal|gu|um)?(?![a-z])"
_REDUCED = "a Bouguer or isostatic anomaly"
_NAMES = {
    _REDUCED: r"boug|isostat|" + _WORD.format("[cgs]?ba|scba|bga"),
    "a free-air anomaly": r"free[ _-]?air|gravity[ _]?anomal|f_a_anom|" + _WORD.format("g?faa?"),
    "a gravity disturbance": r"disturb",
    "a correction": r"correction|" + _WORD.format("[a-z_]*_corr?|[eg]?fac"),
    "observed gravity": r"(?:observed|absolute)[ _]?grav|" + _WORD.format("obs_?g(?:rav)?"),
    "a gravity gradient": r"vgg|gradient|eotvos|eötvös|" + _WORD.format("[gt][xyz][xyz]"),
    "a geoid": r"geoid|undulation|height[ _]?anomal",
    "a magnetic field": r"magnet|" + _WORD.format("tmi|rtp|mag"),
}
_PATTERNS = {quantity: re.compile(pattern) for quantity, pattern in _NAMES.items()}
_OF_KIND = {
    "anomaly": "a free-air anomaly",
    "disturbance": "a gravity disturbance",
    "gradient": "a gravity gradient",
    "geoid": "a geoid",
}
_NEVER_GRADIENTS = {_REDUCED, "observed gravity", "a geoid", "a magnetic field"}
"""What a column of a gradient may not be called: free-air gradients are gradients."""
_REASONS = {
    _REDUCED: (
        "only free-air anomalies or disturbances are allowed: others exclude the attraction of "
        "the rock"
    ),
    "a free-air anomaly": (
        "anomalies differ from disturbances by 0.3 mGal per metre of geoid height: give it as an "
        "anomaly"
    ),
    "a gravity disturbance": "give it as a disturbance",
}


def named_quantities(text: str) -> set[str]:
    """Return the gravity-field quantities that a text names, in the words of messages."""
    plain = text.casefold()
    return {quantity for quantity, pattern in _PATTERNS.items() if pattern.search(plain)}


def contradiction(kind: str, text: str) -> str:
    """Return the contradiction between a kind of input and its description; "" if none.

    Parameters
    ----------
    kind : ``anomaly``, ``disturbance``, ``gradient`` or ``geoid``.
    text : name and description of a column or a grid.
    """
    named = named_quantities(text)
    allowed = _OF_KIND[kind]
    if kind == "gradient":
        named &= _NEVER_GRADIENTS
    if not named or (allowed in named and _REDUCED not in named):
        return ""
    stated = next(quantity for quantity in _PATTERNS if quantity in named)
    return f"that is {stated}; {_REASONS.get(stated, f'{allowed} is allowed')}"
