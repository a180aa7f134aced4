"""Settings and colours of figures, applied only while a figure is drawn.

Matplotlib's global settings and backend stay unchanged. Figures are not registered in pyplot, so
they are freed as soon as no reference exists.
"""

from __future__ import annotations

import io
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal

import matplotlib.style
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

from ..errors import GGBenchError
from ..files.writing import written_whole

INS, BOUND = "0.55", "black"
"""Colours of the INS and the bound."""
_SETTINGS = {
    "figure.dpi": 110,
    "font.size": 9,
    "axes.grid": True,
    "grid.alpha": 0.3,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.frameon": False,
    "savefig.bbox": "tight",
    "svg.hashsalt": "ggbench",
    "svg.fonttype": "none",  # text stays text; Verdana has the widths of Matplotlib's own font
    "font.sans-serif": ["DejaVu Sans", "Verdana", "sans-serif"],
    "text.parse_math": False,  # a $ in somebody's title is a $
}

_CHARACTER, _HANDLE, _LINE = 0.068, 0.55, 0.19
"""Widths [in] of a character of a legend and of what stands before a name; height of a line."""


class FigureError(GGBenchError):
    """A figure cannot be written."""


@contextmanager
def styled() -> Iterator[None]:
    """Apply the style of the package within the context, regardless of the user's settings.

    The function is also used as a decorator.
    """
    with matplotlib.style.context(["default", _SETTINGS]):
        yield


class Drawing(Figure):
    """A Matplotlib figure that is always drawn in the style of this package.

    Ticks and numbers are created only when the figure is drawn.

    Attributes
    ----------
    series : artists of each series, by name.
    """

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.series: dict[str, list[Artist]] = {}

    @property
    def handles(self) -> dict[str, Artist]:
        """First artist of each series, for a legend."""
        return {name: artists[0] for name, artists in self.series.items()}

    def attribute(self, name: str, *artists: Artist) -> None:
        """Add artists to the series with this name."""
        self.series.setdefault(name, []).extend(artists)

    def draw(self, renderer: Any) -> None:
        """Draw the figure in the style of the package."""
        with styled():
            super().draw(renderer)

    def savefig(self, *args: Any, **kwargs: Any) -> None:
        """Write the figure in the style of the package.

        Arguments are those of :meth:`matplotlib.figure.Figure.savefig`.
        """
        with styled():
            super().savefig(*args, **kwargs)

    def _repr_png_(self) -> bytes:
        """Return the picture that a notebook shows, even if it has not loaded pyplot."""
        picture = io.BytesIO()
        self.savefig(picture, format="png")
        return picture.getvalue()


def subplots(
    rows: int = 1, columns: int = 1, *, figsize: tuple[float, float], **options: Any
) -> tuple[Drawing, Any]:
    """Return a figure and its axes, like :func:`matplotlib.pyplot.subplots`.

    ``figsize`` is in inches. The layout is constrained automatically.
    """
    figure = Drawing(figsize=figsize, layout="constrained")
    return figure, figure.subplots(rows, columns, **options)


def plain_numbers(axes: Axes, which: Literal["x", "y"] = "y") -> None:
    """Label a logarithmic axis with plain numbers.

    An axis with at most one power of ten also has labels between the powers of ten.
    """
    low, high = axes.get_xlim() if which == "x" else axes.get_ylim()
    axis = axes.xaxis if which == "x" else axes.yaxis
    axis.set_major_formatter(lambda value, _: f"{value:g}")
    axis.set_minor_formatter(NullFormatter())
    if high < 3.0 * low:
        axis.set_minor_formatter(lambda value, _: f"{value:g}")
    elif np.floor(np.log10(high)) - np.ceil(np.log10(low)) < 1.0:  # fewer than two powers of ten
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))


def legend_below(figure: Figure, handles: Mapping[str, Any]) -> None:
    """Put a legend of up to four columns below the panels, and enlarge the figure for it.

    The panels keep their size.
    """
    width, height = figure.get_size_inches()
    longest = max(map(len, handles), default=1)
    columns = max(1, min(4, int(width / (_CHARACTER * longest + _HANDLE))))
    figure.set_size_inches(width, height + _LINE * -(-len(handles) // columns))
    figure.legend(handles.values(), handles.keys(), loc="outside lower center", ncols=columns)


def save(figure: Figure, path: Path) -> None:
    """Write a figure to a file; equal figures give equal bytes.

    A missing folder is created. Raise FigureError if the file cannot be written.
    """
    with written_whole(path, FigureError, "the figure ") as temporary:
        kind = path.suffix[1:] or None
        figure.savefig(temporary, format=kind, metadata={"Software": "ggbench"})
