"""The figure of a parameter of estimators: what becomes of their errors if it is turned."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib import colormaps
from matplotlib.ticker import NullFormatter

from .line_styles import line_styles
from .style import BOUND, INS, Drawing, legend_below, plain_numbers, styled, subplots

_MARKERS = "os^vDPX*"


@dataclass(frozen=True)
class Line:
    """Estimators that differ in the parameter alone, on one case.

    Attributes
    ----------
    title : what the line is called.
    colour : of the line; "" for one of a scale over all lines.
    values, ratios : of the parameter and of the error over the bound (n,).
    interval : of the ratios (2, n).
    """

    title: str
    colour: str
    values: Sequence[float]
    ratios: np.ndarray
    interval: np.ndarray


@dataclass(frozen=True)
class Panel:
    """What has one title: its lines, and the errors over the bound of what lacks the parameter."""

    title: str
    lines: Sequence[Line]
    levels: Mapping[str, float]


@styled()
def over_parameter(name: str, panels: Sequence[Panel]) -> Drawing:
    """Draw errors over the bound over a parameter, both on logarithmic scales, panel by panel.

    Bars are 95 % intervals. What does not have the parameter is a level.
    """
    columns = min(len(panels), 2)
    rows = -(-len(panels) // columns)
    figure, grid = subplots(
        rows, columns, figsize=(7.4 if columns == 1 else 10.4, 4.2 * rows + 0.2), squeeze=False,
        sharey=True,
    )  # fmt: skip
    for axis in grid.flat[len(panels) :]:
        axis.set_visible(False)
    titles = list(dict.fromkeys(line.title for panel in panels for line in panel.lines))
    scale = colormaps["turbo"](np.linspace(0.05, 0.95, len(titles)))
    handles = {}
    for axis, panel in zip(grid.flat, panels, strict=False):
        for line in panel.lines:
            number = titles.index(line.title)
            reach = np.abs(np.nan_to_num([line.ratios, line.ratios] - line.interval))
            # Thinner from line to line: what is below another one is seen at its sides.
            handles[line.title] = axis.errorbar(
                line.values, line.ratios, reach, color=line.colour or scale[number],
                marker=_MARKERS[number % len(_MARKERS)], ms=max(7.0 - 0.4 * number, 4.0),
                capsize=1.5, lw=max(3.2 - 0.4 * number, 1.0), elinewidth=0.9,
            )  # fmt: skip
        for label, ratio in panel.levels.items():
            colour = INS if label == "ins" else line_styles([label])[label].color
            handles[label] = axis.axhline(ratio, color=colour, lw=1.6, ls="-.")
        handles["Cramér–Rao bound"] = axis.axhline(1.0, color=BOUND, lw=1.0, ls="--")
        axis.set(title=panel.title, xscale="log", yscale="log", xlabel=name)
        plain_numbers(axis)
        axis.set_xticks(sorted({value for line in panel.lines for value in line.values}))
        axis.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
        axis.xaxis.set_minor_formatter(NullFormatter())
    for axis in grid[:, 0]:
        axis.set_ylabel("error / bound (median)")
    legend_below(figure, handles)
    return figure
