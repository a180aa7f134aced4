"""Colour, line and marker of each estimator in a figure.

Each family of estimators has a colour. The estimators of a family differ by line and marker. Users'
own estimators are a family too.
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
"""Drawing order of families; other families have 1."""
_WIDTHS = 3.4, 1.2
"""Widths of the first and the last line of shipped estimators in a figure [pt]."""
_OWN = 4.2, 0.75
"""Width [pt] and opacity of lines of users' own estimators; equal lines shine through."""


class LineStyle(NamedTuple):
    """Colour, line style and marker, as named by Matplotlib."""

    color: str
    ls: str
    marker: str


def line_styles(families: Mapping[str, str]) -> dict[str, LineStyle]:
    """Return the line style of each estimator; all styles are different.

    Parameters
    ----------
    families : family (:data:`ggbench.problem.Family`) of each estimator by label. The
        estimators of a family get their styles in the order of ``families``. An unknown family,
        from a later version, counts as ``own``.
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


class Layer(NamedTuple):
    """A line of a figure: label, width [pt] and opacity."""

    label: str
    width: float
    alpha: float


def is_own(label: str, families: Mapping[str, str]) -> bool:
    """Return whether an estimator is a user's own, not shipped with this package."""
    return families.get(label, "own") not in set(COLOURS) - {"own"}


def stacked(labels: Iterable[str], families: Mapping[str, str]) -> list[Layer]:
    """Return the lines of a figure in drawing order.

    The INS comes first, then the other shipped estimators. Each of their lines is thinner than the
    line before, so that equal curves stay visible. Users' own estimators come last, on top of all
    others. The lines of users' own estimators are the thickest, and translucent.
    """
    order = sorted(labels, key=lambda label: _LAYERS.get(families[label], 1))
    shipped = [label for label in order if not is_own(label, families)]
    widths = np.linspace(*_WIDTHS, len(shipped)).tolist()
    lines = [Layer(label, width, 1.0) for label, width in zip(shipped, widths, strict=True)]
    return lines + [Layer(label, *_OWN) for label in order if is_own(label, families)]


def _lighter(colour: str, steps: int) -> str:
    """Return a colour mixed with white, a quarter of the way at each step, at most half."""
    if not steps:
        return colour
    share = max(0.75**steps, 0.5)
    red, green, blue = (1.0 - share + share * part for part in to_rgb(colour))
    return to_hex((red, green, blue))
