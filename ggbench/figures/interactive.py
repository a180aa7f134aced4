"""Interactive SVG figures for a browser.

The script ``figure.js`` of the HTML page shows the values under the pointer, hides and shows series
by clicks in the legend, and zooms. The image equals that of :func:`.style.save`.
"""

from __future__ import annotations

import io
import re
from collections.abc import Set
from typing import Any, Literal

from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedLocator

from .style import Drawing

_DECIMALS = re.compile(r"(\.\d\d)\d+")


def picture(figure: Drawing, hidden: Set[str] = frozenset()) -> dict[str, Any]:
    """Return a figure as SVG, with the data that ``figure.js`` needs.

    The SVG groups have ids with two numbers from zero: the index of the series, and the index of
    the artist within the series. For the third series, ``series-2-0`` are the points, and
    ``range-2-1`` is an interval, the second artist. ``legend-2-0`` is the name of this series in
    the legend, and ``legend-2-1`` is its symbol there. ``panel-0`` are the first axes.

    Parameters
    ----------
    figure : figure whose series have been assigned by :meth:`.style.Drawing.attribute`.
    hidden : names of the series that are hidden at first.

    Returns
    -------
    dict
        ``svg``; ``names``, the names of the series; ``hidden``, indices of the series that are
        hidden at first; ``panels``, the ``x`` and ``y`` scales of each axes.
    """
    for number, (name, artists) in enumerate(figure.series.items()):
        for place, artist in enumerate(artists):
            # Intervals and bands have no points that can be pointed at.
            kind = "series" if isinstance(artist, Line2D) or place == 0 else "range"
            artist.set_gid(f"{kind}-{number}-{place}")
        for legend in figure.legends:
            texts = [text.get_text() for text in legend.get_texts()]
            if name in texts:
                at = texts.index(name)
                legend.get_texts()[at].set_gid(f"legend-{number}-0")
                handle = legend.legend_handles[at]
                if handle is not None:
                    handle.set_gid(f"legend-{number}-1")
    for number, axis in enumerate(figure.axes):
        axis.patch.set_gid(f"panel-{number}")
    drawn = io.StringIO()
    figure.savefig(drawn, format="svg", metadata={"Date": None, "Creator": None})
    names = list(figure.series)
    return {
        "svg": _compact(drawn.getvalue()),
        "names": names,
        "hidden": [k for k, name in enumerate(names) if name in hidden],
        "panels": [{"x": _scale(axis, "x"), "y": _scale(axis, "y")} for axis in figure.axes],
    }


def _scale(axes: Axes, which: Literal["x", "y"]) -> dict[str, Any]:
    """Return the limits, kind (logarithmic or not), label and tick names of an axis.

    The limits are from left to right, or from bottom to top.
    """
    axis = axes.xaxis if which == "x" else axes.yaxis
    limits = axes.get_xlim() if which == "x" else axes.get_ylim()
    sharing = axes.get_shared_x_axes() if which == "x" else axes.get_shared_y_axes()
    siblings = sharing.get_siblings(axes)
    labels = [each.get_xlabel() if which == "x" else each.get_ylabel() for each in siblings]
    named = isinstance(axis.get_major_locator(), FixedLocator)
    names = [text.get_text() for text in axis.get_ticklabels()] if named else []
    return {
        "limits": [float(limit) for limit in limits],
        "log": axis.get_scale() == "log",
        "label": max(labels).replace("\n", " "),
        "names": [name.replace("\n", " ") for name in names],
    }


def _compact(svg: str) -> str:
    """Return the ``svg`` element of an SVG file, without width and height, with two decimals."""
    element = svg[svg.index("<svg") :].strip()
    element = re.sub(r'^(<svg[^>]*?) width="[^"]*"', r"\1", element)
    element = re.sub(r'^(<svg[^>]*?) height="[^"]*"', r"\1", element)
    element = re.sub(r"\n\s*", "\n", element)
    return re.sub(r' (?:d|x|y)="[^"]*"', lambda match: _DECIMALS.sub(r"\1", match[0]), element)
