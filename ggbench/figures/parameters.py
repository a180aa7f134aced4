"""The figure of a parameter of estimators: what becomes of their errors if it is turned."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.ticker import NullFormatter

from .looks import looks
from .style import BOUND, INS, Drawing, legend_below, plain_numbers, styled, subplots

_MARKERS = "os^vDPX*"


@dataclass(frozen=True)
class Line:
    """Estimators that differ in the parameter alone.

    Attributes
    ----------
    title : what they have in common. labels : of each (n,).
    values, errors : of the parameter and of the position [m] (n,). interval : of the errors (2, n).
    """

    title: str
    labels: Sequence[str]
    values: Sequence[float]
    errors: np.ndarray
    interval: np.ndarray


@dataclass(frozen=True)
class Panel:
    """A case: its lines, the errors [m] of estimators without the parameter, and the bound [m]."""

    title: str
    lines: Sequence[Line]
    levels: Mapping[str, float]
    bound: float


@styled()
def over_parameter(name: str, panels: Sequence[Panel]) -> Drawing:
    """Draw position errors over a parameter, both on logarithmic scales, a panel for each case.

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
    handles = {}
    for axis, panel in zip(grid.flat, panels, strict=False):
        for number, line in enumerate(panel.lines):
            reach = np.abs(np.nan_to_num([line.errors, line.errors] - line.interval))
            # Thinner from line to line: what is below another one is seen at its sides.
            handles[line.title] = axis.errorbar(
                line.values, line.errors, reach, color=looks(line.labels)[line.labels[0]].color,
                marker=_MARKERS[number % len(_MARKERS)], ms=7.0 - 0.4 * number, capsize=1.5,
                lw=max(3.2 - 0.4 * number, 1.0), elinewidth=0.9,
            )  # fmt: skip
        for label, error in panel.levels.items():
            colour = INS if label == "ins" else looks([label])[label].color
            handles[label] = axis.axhline(error, color=colour, lw=1.6, ls="-.")
        handles["Cramér–Rao bound"] = axis.axhline(panel.bound, color=BOUND, lw=1.0, ls="--")
        axis.set(title=panel.title, xscale="log", yscale="log", xlabel=name)
        plain_numbers(axis)
        axis.set_xticks(sorted({value for line in panel.lines for value in line.values}))
        axis.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
        axis.xaxis.set_minor_formatter(NullFormatter())
    for axis in grid[:, 0]:
        axis.set_ylabel("position MRSE [m]")
    legend_below(figure, handles)
    return figure
