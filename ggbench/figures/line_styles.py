"""Colour, line and marker of each estimator in a figure.

The colour is that of the estimator's family. The estimators of a family differ by line and marker,
in their order. An estimator that does not belong to the package has a colour of its own.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from typing import NamedTuple, get_args

import numpy as np
from matplotlib.colors import to_hex, to_rgb

from ..problem import Family
from .style import INS

COLOURS: Mapping[str, str] = {
    "inertial": INS,
    "kalman": "#0072b2",
    "sigma-point": "#e69f00",
    "mixture": "#56b4e9",
    "sampled": "#8a1c7c",
    "matching": "#ff7fb0",
    "smoother": "#117733",
    "own": "#d55e00",
}
"""Colours that colour-blind readers can tell apart, mostly of Okabe & Ito (2008)."""
_FAMILIES = get_args(Family)
_MARKERS = "xosD^v<>pP*Xhd8"
_LINES = ("-", "--", "-.", ":")
_LAYERS = {"inertial": 0, "own": 2}
"""Layers of families; others have 1."""
_WIDTHS = 4.2, 1.2
"""Widths of the first and of the last line of a figure [pt]."""


class LineStyle(NamedTuple):
    """Matplotlib's names of a colour, a line and a marker."""

    color: str
    ls: str
    marker: str


def line_styles(families: Mapping[str, str]) -> dict[str, LineStyle]:
    """Return the style of each estimator; no two share one.

    Parameters
    ----------
    families : family of each estimator by its label, in order (:data:`ggbench.problem.Family`).
        A family of a later version counts as ``own``.
    """
    styles: dict[str, LineStyle] = {}
    members: Counter[str] = Counter()
    for label, stated in families.items():
        family = stated if stated in COLOURS else "own"
        number = members[family]
        members[family] += 1
        first = _FAMILIES.index(family)
        styles[label] = LineStyle(
            _lighter(COLOURS[family], number // len(_LINES)),
            _LINES[number % len(_LINES)],
            _MARKERS[(first + number) % len(_MARKERS)],
        )
    return styles


def stacked(labels: Iterable[str], families: Mapping[str, str]) -> list[tuple[str, float]]:
    """Return labels in the order of drawing, each with the width of its line [pt].

    Lines become thinner, so that equal curves stay visible at the sides. The INS comes first and
    estimators of one's own come last, on top.
    """
    order = sorted(labels, key=lambda label: _LAYERS.get(families[label], 1))
    return list(zip(order, np.linspace(*_WIDTHS, len(order)).tolist(), strict=True))


def _lighter(colour: str, steps: int) -> str:
    """Return a colour mixed with white, a quarter of the way at each step, at most half."""
    if not steps:
        return colour
    kept = max(0.75**steps, 0.5)
    red, green, blue = (1.0 - kept + kept * part for part in to_rgb(colour))
    return to_hex((red, green, blue))
