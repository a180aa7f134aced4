"""Figure of a scored map: grades of the cells, accuracy of tracks, ambiguity."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PatchCollection
from matplotlib.colors import BoundaryNorm, ListedColormap, LogNorm
from matplotlib.patches import Rectangle
from matplotlib.ticker import LogLocator, MaxNLocator

from ..figures.style import Drawing, styled, subplots
from .components import GRADES

if TYPE_CHECKING:
    import pandas as pd

    from .score import Scored

GRADE_COLOURS = dict(zip(GRADES, ("#c0392b", "#f2d16b", "#2e8b57"), strict=True))
_LEAST_SHARE = 1e-4
"""Least shown probability of a wrong place; smaller bounds have the same colour."""
_TICK = 0.35  # half the length of a heading's line, in sides of a cell


@styled()
def map_score(scored: Scored, source: str) -> Drawing:
    """Draw the cells of a scored map in three panels; ``source`` is the map's name."""
    table = scored.table
    south, north = table["south_deg"].min(), table["north_deg"].max()
    west, east = table["west_deg"].min(), table["east_deg"].max()
    stretch = 1.0 / math.cos(math.radians(0.5 * (south + north)))
    shape = (north - south) * stretch / (east - west)
    size = (12.0, min(9.0, 2.4 + 3.6 * shape))
    figure, axes = subplots(1, 3, figsize=size, sharex=True, sharey=True)
    grades, track, doubt = axes
    classes = PatchCollection(_patches(table), edgecolor="w", lw=0.3)
    classes.set_cmap(ListedColormap([*GRADE_COLOURS.values()]))
    classes.set_norm(BoundaryNorm([-0.5, 0.5, 1.5, 2.5], 3))
    numbers = [GRADES.index(grade) if grade else np.nan for grade in table["grade"]]
    classes.set_array(np.array(numbers, dtype=float))
    grades.add_collection(classes)
    few = scored.components is None
    grades.set_title("too few cells for an index" if few else "index by principal components")
    bar = figure.colorbar(
        classes, ax=grades, location="bottom", shrink=0.9, label="rank among these cells"
    )
    bar.set_ticks(range(3), labels=GRADES)
    bar.minorticks_off()
    values = _coloured(figure, track, table, "best_track_m", "viridis_r", "RMS position error [m]")
    track.set_title("track error on the best heading")
    _headings(track, table, values)
    percent = table.assign(percent=100.0 * np.maximum(table["false_fix"], _LEAST_SHARE))
    _coloured(figure, doubt, percent, "percent", "magma_r", "probability, at most [%]")
    doubt.set_title("false fix")
    for axis in axes:
        axis.set_xlim(west, east)
        axis.set_ylim(south, north)
        axis.set_aspect(stretch)
        axis.grid(visible=False)
        axis.set_xlabel("longitude [°]")
        axis.xaxis.set_major_locator(MaxNLocator(4))
    grades.set_ylabel("latitude [°]")
    design = scored.design
    instrument = {"tensor": "six components", "uu": "Γ_UU", "gravity": "gravimeter"}[
        design.instrument.kind
    ]
    figure.suptitle(
        f"{source}: cells of {design.cell_deg:g}° at {scored.height}; {instrument}, "
        f"{design.instrument.noise:g} {design.instrument.unit}; tracks of "
        f"{(design.track_m or 0.0) / 1e3:.3g} km, {design.readings} measurements; prior σ of "
        f"{design.sigma_m / 1e3:g} km",
        fontsize=9,
        wrap=True,
    )
    return figure


def _patches(table: pd.DataFrame) -> list[Rectangle]:
    return [
        Rectangle((west, south), east - west, north - south)
        for south, north, west, east in table[
            ["south_deg", "north_deg", "west_deg", "east_deg"]
        ].to_numpy()
    ]


def _coloured(
    figure: Drawing, axis: Axes, table: pd.DataFrame, column: str, colours: str, label: str
) -> Any:
    """Colour the cells of a panel by a column, on a logarithmic scale; return its values."""
    values = table[column].to_numpy(dtype=float)
    usable = np.isfinite(values) & (values > 0.0)
    cells = PatchCollection(_patches(table), cmap=colours, edgecolor="w", lw=0.3)
    masked = np.where(usable, values, np.nan)
    cells.set_array(masked)
    low, high = np.percentile(values[usable], [1.0, 99.0]) if usable.any() else (1.0, 1.0)
    cells.set_norm(LogNorm(low, high if high > low else low * 1.1))
    axis.add_collection(cells)
    figure.colorbar(
        cells,
        ax=axis,
        location="bottom",
        shrink=0.9,
        label=label,
        extend="both",
        ticks=LogLocator(subs=(1.0,) if high > 50.0 * low else (1.0, 2.0, 5.0)),
        format=lambda value, _: f"{value:g}",
    ).minorticks_off()
    return masked


def _headings(axis: Axes, table: pd.DataFrame, values: Any) -> None:
    """Draw the best heading of each cell as a line through its centre."""
    if len(table) > 1000:
        return
    finite = np.isfinite(values)
    turned = np.radians(table["best_heading_deg"].to_numpy()[finite])
    latitude = 0.5 * (table["south_deg"] + table["north_deg"]).to_numpy()[finite]
    longitude = 0.5 * (table["west_deg"] + table["east_deg"]).to_numpy()[finite]
    half = _TICK * (table["north_deg"] - table["south_deg"]).to_numpy()[finite]
    for sign in (-1.0, 1.0):
        axis.plot(
            [longitude, longitude + sign * half * np.sin(turned)],
            [latitude, latitude + sign * half * np.cos(turned)],
            color="k",
            lw=0.6,
        )
