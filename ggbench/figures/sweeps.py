"""Figures of a sweep: heat maps over its plane, where targets are reached, curves over an axis."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib
import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from matplotlib.ticker import MaxNLocator

from ..spec import sweep
from ..spec.sweep import Axis
from .line_styles import line_styles
from .numbers import short
from .style import INS, Drawing, styled, subplots

MOST_NUMBERS = 150
"""Most cells of a heat map that are shown with their numbers."""


@dataclass(frozen=True)
class HeatMap:
    """One panel of :func:`heat_maps`.

    Attributes
    ----------
    title : above the panel.
    values : (n, m) over the first and the second axis; NaN is left white.
    framed : (n, m) cells to be framed, or None.
    """

    title: str
    values: np.ndarray
    framed: np.ndarray | None = None


@styled()
def heat_maps(
    panels: Sequence[HeatMap], across: Axis, up: Axis, label: str, centre: float | None = None
) -> Drawing:
    """Draw positive values over a grid in panels of one logarithmic colour scale.

    Cells are of equal size, whatever the spacing of the axes, and small grids show their numbers.
    ``label`` is that of the colours; around ``centre``, if given, they diverge.
    """
    wide, high = len(across.values), len(up.values)
    columns = min(len(panels), 2)
    rows = -(-len(panels) // columns)
    size = (columns * max(0.45 * wide + 0.5, 3.0) + 1.0, rows * max(0.27 * high + 1.0, 2.0))
    figure, grid = subplots(rows, columns, figsize=size, squeeze=False, sharex=True, sharey=True)
    colours = ScalarMappable(
        _scale([panel.values for panel in panels], centre),
        "viridis" if centre is None else "RdBu_r",
    )
    for axis in grid.flat[len(panels) :]:
        axis.set_visible(False)
    for axis, panel in zip(grid.flat, panels, strict=False):
        cells = colours.to_rgba(panel.values)
        axis.imshow(cells.swapaxes(0, 1), origin="lower", aspect="auto")
        axis.set_title(panel.title)
        axis.grid(False)
        for place, value in np.ndenumerate(panel.values):
            if wide * high <= MOST_NUMBERS and np.isfinite(value):
                dark = cells[place][:3] @ (0.3, 0.6, 0.1) < 0.5
                axis.text(
                    *place, short(value), ha="center", va="center", fontsize=6.5,
                    color="white" if dark else "black",
                )  # fmt: skip
            if panel.framed is not None and panel.framed[place]:
                corner = (place[0] - 0.46, place[1] - 0.44)
                axis.add_patch(Rectangle(corner, 0.92, 0.88, fill=False, ec="black", lw=1.2))
    for axis in grid[:, 0]:
        _name_cells(axis.yaxis, up)
        axis.set_ylabel(up.title)
    for column in range(columns):
        lowest = grid[(len(panels) - 1 - column) // columns, column]
        _name_cells(lowest.xaxis, across)
        lowest.set_xlabel(across.title)
        lowest.tick_params(labelbottom=True, labelsize=8)
    _colour_bar(figure, colours, grid, label)
    return figure


def _scale(values: Sequence[np.ndarray], centre: float | None) -> LogNorm:
    """Return the colour scale from the least to the largest value, symmetric about a centre."""
    logs = np.log(np.concatenate([v[np.isfinite(v)] for v in values]))
    if centre is not None:
        reach = max(np.abs(logs - np.log(centre)).max(), 0.05)
        return LogNorm(centre * np.exp(-reach), centre * np.exp(reach))
    return LogNorm(np.exp(logs.min()), np.exp(max(logs.max(), logs.min() + 1e-3)))


def _colour_bar(figure: Figure, colours: ScalarMappable, axes: Any, label: str) -> None:
    """Draw a logarithmic colour scale whose numbers are written plainly."""
    bar = figure.colorbar(colours, ax=axes, label=label, shrink=0.95, pad=0.01)
    low, high = colours.get_clim()
    if high < 10.0 * low:
        ticks = MaxNLocator(6).tick_values(low, high)
        bar.set_ticks([tick for tick in ticks if low <= tick <= high], minor=False)
        bar.minorticks_off()
    bar.ax.yaxis.set_major_formatter(lambda value, _: f"{value:g}")


def _name_cells(side: Any, axis: Axis) -> None:
    """Write the axis's values at its cells, each one or as many as are legible."""
    every = -(-len(axis.values) // 14)
    places = range(0, len(axis.values), every)
    side.set_ticks(list(places), [sweep.number(axis.values[i]) for i in places])


@styled()
def requirement(
    errors: np.ndarray,
    bound: np.ndarray,
    targets: Sequence[float],
    across: Axis,
    up: Axis,
    label: str,
) -> Drawing:
    """Draw where in a plane an estimator, and the bound, reach given position errors.

    ``errors`` and ``bound`` are (n, m) over the two axes [m]. The contours interpolate the
    logarithm of the error linearly, as :func:`ggbench.spec.sweep.largest_within` does.
    """
    figure, axis = subplots(figsize=(7.0, 4.8))
    from scipy.interpolate import RegularGridInterpolator  # not at the top: for sweeps only

    x, y = across.coordinates(), up.coordinates()
    fine_x, fine_y = (np.union1d(np.linspace(c[0], c[-1], 300), c) for c in (x, y))
    places = tuple(np.meshgrid(fine_x, fine_y, indexing="ij"))
    on_axes = [10.0**f if a.scale == "log" else f for a, f in ((across, fine_x), (up, fine_y))]
    colour_scale = _scale([errors, bound], None)
    for values, colour, style, width in ((errors, "black", "-", 2.2), (bound, "white", "--", 1.3)):
        fine = 10.0 ** RegularGridInterpolator((x, y), np.log10(values))(places).T
        if values is errors:
            axis.pcolormesh(*on_axes, fine, norm=colour_scale, cmap="viridis", rasterized=True)
        levels = [t for t in sorted(targets) if np.nanmin(values) < t < np.nanmax(values)]
        if not levels:
            continue
        contours = axis.contour(
            *on_axes, np.log10(fine), np.log10(levels), colors=colour, linestyles=style,
            linewidths=width,
        )  # fmt: skip
        if values is errors:
            for target, line in zip(levels, contours.get_paths(), strict=True):
                points = np.asarray(line.vertices)
                if len(points):
                    middle = tuple(points[len(points) // 2])
                    axis.annotate(
                        f"{target:g} m", middle, (-7, 0), textcoords="offset points", ha="right",
                        va="center", bbox={"boxstyle": "round", "fc": "white", "ec": "none"},
                    )  # fmt: skip
    axis.scatter(*np.meshgrid(across.values, up.values), s=5, c="0.85", lw=0, clip_on=False)
    axis.set(xscale=across.scale, yscale=up.scale, xlabel=across.title, ylabel=up.title)
    for side in (axis.xaxis, axis.yaxis):
        side.set_major_formatter(lambda value, _: f"{value:g}")
    axis.grid(False)
    colours = ScalarMappable(colour_scale, "viridis")
    _colour_bar(figure, colours, axis, f"position MRSE of {label} [m]")
    handles = [Line2D([], [], color="black", lw=2.2, label=label),
               Line2D([], [], color="0.7", lw=1.3, ls="--", label="Cramér–Rao bound")]  # fmt: skip
    figure.legend(handles=handles, loc="outside upper center", ncols=2)
    return figure


@dataclass(frozen=True)
class Curve:
    """An error over the first axis: (n,) values, their 95 % interval (2, n), and their bound."""

    label: str
    values: np.ndarray
    interval: np.ndarray
    bound: np.ndarray


@styled()
def curves(
    panels: Mapping[str, Sequence[Curve]],
    unaided: np.ndarray | None,
    across: Axis,
) -> Drawing:
    """Draw position errors over an axis with the bounds dashed; ``unaided`` (n, m) is the INS's.

    The lines of a panel without a title are estimators, those of others values of another axis.
    """
    columns = min(len(panels), 2)
    rows = -(-len(panels) // columns)
    figure, grid = subplots(
        rows, columns, figsize=(4.4 * columns + 0.4, 3.6 * rows + 0.4), squeeze=False,
        sharex=True, sharey=True,
    )  # fmt: skip
    for axis in grid.flat[len(panels) :]:
        axis.set_visible(False)
    for axis, (title, lines) in zip(grid.flat, panels.items(), strict=False):
        if unaided is not None:
            low, high = np.fmin.reduce(unaided, axis=1), np.fmax.reduce(unaided, axis=1)
            axis.fill_between(across.values, low, high, fc=INS, ec=INS, lw=2.0, label="ins")
        drawn = line_styles(line.label for line in lines)
        shades = matplotlib.colormaps["viridis"](np.linspace(0.0, 0.93, len(lines)))
        for line, shade in zip(lines, shades, strict=True):
            colour: Any = shade if title else drawn[line.label].color
            axis.fill_between(across.values, *line.interval, color=colour, alpha=0.2, lw=0)
            axis.plot(across.values, line.values, ".-", color=colour, lw=1.3, label=line.label)
            axis.plot(across.values, line.bound, "--", color=colour, lw=0.9)
        axis.set(title=title, xscale=across.scale, yscale="log", xlabel=across.title)
        for side in (axis.xaxis, axis.yaxis):
            side.set_major_formatter(lambda value, _: f"{value:g}")
    for axis in grid[:, 0]:
        axis.set_ylabel("position MRSE [m]")
    handles, names = grid[0, 0].get_legend_handles_labels()
    handles.append(Line2D([], [], color="0.3", lw=0.9, ls="--"))
    figure.legend(handles, [*names, "Cramér–Rao bound"], loc="outside lower center", ncols=5)
    return figure
