"""Colour, line and marker of each estimator in a figure.

The colour and the marker are those of the estimator's name, the same in every figure. Variants of a
name differ by the line, in the order in which a figure names them.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple
from zlib import crc32

from matplotlib.colors import to_hex, to_rgb

from ..estimator_spec import EstimatorSpec
from .style import INS

_COLOURS = ("#0072b2", "#e69f00", "#009e73", "#d55e00", "#cc79a7", "#56b4e9", "#a08a00")
"""The palette of Okabe & Ito (2008), which colour-blind readers can tell apart; darker yellow."""
_MARKERS = "osD^v<>pP*Xhd8H"
_LINES = ("-", "--", "-.", ":")
_NAMES = (
    "ekf",
    "ukf",
    "factor-graph",
    "gaussian-sum",
    "gauss-newton",
    "rao-blackwellised",
    "tercom",
    "particle",
    "unscented-particle",
    "gaussian-particle",
    "correlation",
    "sitan",
    "iccp",
    "viterbi",
    "closed-loop",
    "reduced",
    "point-mass",
    "filterpy-ekf",
    "filterpy-ukf",
    "gtsam",
)
"""Names in the order in which they take colours and markers; others take theirs by a hash."""


class LineStyle(NamedTuple):
    """Matplotlib's names of a colour, a line and a marker."""

    color: str
    ls: str
    marker: str


def line_styles(labels: Iterable[str]) -> dict[str, LineStyle]:
    """Return the style of each label; no two labels of a figure share one.

    The fifth variant of a name begins with the first line again, in a lighter colour.
    """
    styles: dict[str, LineStyle] = {}
    taken: dict[str, int] = {}
    for label in dict.fromkeys(labels):
        name = EstimatorSpec.parse(label).name
        count = taken.setdefault(name, 0)
        taken[name] += 1
        colour, marker = _of_name(name)
        style = LineStyle(_lighter(colour, count // len(_LINES)), _LINES[count % 4], marker)
        while style in styles.values():  # two names that a hash gave the same
            style = style._replace(marker=_MARKERS[_MARKERS.index(style.marker) - 1])
        styles[label] = style
    return styles


def _of_name(name: str) -> tuple[str, str]:
    if name == "ins":
        return INS, "x"
    number = _NAMES.index(name) if name in _NAMES else crc32(name.encode())
    return _COLOURS[number % len(_COLOURS)], _MARKERS[number % len(_MARKERS)]


def _lighter(colour: str, steps: int) -> str:
    """Return a colour mixed with white, a third of the way at each step."""
    if not steps:
        return colour
    kept = (2.0 / 3.0) ** steps
    red, green, blue = (1.0 - kept + kept * part for part in to_rgb(colour))
    return to_hex((red, green, blue))
