"""Figures of planned flights: the bound on the position error along the track and over time."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import LogNorm
from matplotlib.figure import SubFigure
from matplotlib.ticker import LogLocator, NullFormatter

from ..gravity.ellipsoid import SEMI_MAJOR_AXIS, metres_along
from ..gravity.field import Field
from .style import BOUND, Drawing, styled, subplots

if TYPE_CHECKING:
    import pandas as pd

_AROUND = 0.15
"""Width of the margin around the track, divided by the longer side of the track."""
_SQUARE = 0.7
"""Least ratio of the shorter to the longer side of the plan."""
_NODES = 150
_ARROW = 0.45
"""Length of an arrow, divided by the distance between neighbouring starts."""
_MOST_POINTS = 2000
_COLOURS = {"east": "tab:blue", "north": "tab:orange", "up": "tab:green"}


@styled()
def planned_bound(bounds: pd.DataFrame, field: Field, title: str) -> Drawing:
    """Draw the bound on the position error along a track and over time.

    ``bounds`` comes from :func:`ggbench.judging.planned.planned`. The disturbing Γ_UU of the field
    is drawn at the mean height of the track.
    """
    figure = Drawing(figsize=(11.0, 5.2), layout="constrained")
    parts: Any = figure.subfigures(1, 2, width_ratios=(4, 5))
    left, right = parts
    _plan(left, bounds, field)
    axes = right.subplots(2, 1, sharex=True)
    times = bounds["time_s"]
    panels = (("position", "m", "m"), ("velocity", "mps", "m/s"))
    for axis, (name, unit, unit_shown) in zip(axes, panels, strict=True):
        for along, colour in _COLOURS.items():
            axis.semilogy(times, bounds[f"{along}_{unit}"], color=colour, lw=1.0, label=along)
        axis.semilogy(times, bounds[f"{name}_{unit}"], color=BOUND, lw=1.6, label="spherical")
        axis.semilogy(
            times,
            bounds[f"{name}_smoothed_{unit}"],
            color=BOUND,
            lw=1.0,
            ls="--",
            label="spherical, smoother",
        )
        axis.set_ylabel(f"{name} [{unit_shown}]")
        axis.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axis.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
        axis.yaxis.set_minor_formatter(NullFormatter())
    axes[1].set_xlabel("time since the start [s]")
    handles, names = axes[0].get_legend_handles_labels()
    right.legend(handles, names, loc="outside lower center", ncols=3)
    figure.suptitle(f"Cramér–Rao bound: {title}", fontsize=9, wrap=True)
    return figure


def _plan(figure: SubFigure, bounds: pd.DataFrame, field: Field) -> None:
    """Draw the track from above, coloured by the bound, over the field."""
    axis = figure.subplots()
    track = bounds[["longitude_deg", "latitude_deg"]].to_numpy()
    values = bounds["position_m"].to_numpy()
    low, high = track.min(axis=0), track.max(axis=0)
    stretch = 1.0 / math.cos(math.radians(0.5 * (low[1] + high[1])))
    across = (high - low) / (stretch, 1.0)
    around = max(_AROUND * float(across.max()), math.degrees(100.0 / SEMI_MAJOR_AXIS))
    half = np.maximum(0.5 * across + around, _SQUARE * (0.5 * float(across.max()) + around))
    middle = 0.5 * (low + high)
    low, high = middle - half * (stretch, 1.0), middle + half * (stretch, 1.0)
    if field.has_map:
        edges = np.degrees(field.lower[[1, 0]]), np.degrees(field.upper[[1, 0]])
        low, high = np.maximum(low, edges[0]), np.minimum(high, edges[1])
        flown = np.radians(bounds[["latitude_deg", "longitude_deg", "height_m"]].to_numpy())
        flown[:, 2] = bounds["height_m"]
        longitude, latitude = np.linspace(low, high, _NODES).T
        _draw_field(figure, axis, field, flown, (longitude, latitude), (longitude, latitude))
    step = 1 + len(track) // _MOST_POINTS
    track, values = track[::step], values[::step]
    smallest, largest = values.min(), values.max()
    line = LineCollection(
        [*np.stack([track[:-1], track[1:]], axis=1)],
        cmap="plasma",
        lw=4.0,
        capstyle="round",
        norm=LogNorm(smallest, max(largest, 1.001 * smallest)),
    )
    line.set_array(values[1:])
    axis.add_collection(line)
    axis.plot(*track[0], "o", color="k", mfc="w", ms=6)
    subs = (1.0, 2.0, 5.0) if largest < 20.0 * smallest else (1.0,)
    figure.colorbar(
        line,
        ax=axis,
        location="bottom",
        shrink=0.8,
        label="bound of the position [m]",
        ticks=LogLocator(subs=subs),
        format=lambda value, _: f"{value:g}",
    ).minorticks_off()
    axis.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect=stretch)
    axis.set(xlabel="longitude [°]", ylabel="latitude [°]")
    axis.ticklabel_format(useOffset=False)
    axis.grid(visible=False)


def _draw_field(
    figure: Any,
    axis: Axes,
    field: Field,
    flown: np.ndarray,
    degrees: tuple[np.ndarray, np.ndarray],
    coordinates: tuple[np.ndarray, np.ndarray],
) -> None:
    """Draw Γ_UU at the mean height of a track on a grid of longitudes and latitudes.

    Parameters
    ----------
    figure, axis : panel.
    field : field with a map.
    flown : (K, 3) latitude, longitude [rad], height [m] of the track.
    degrees : longitudes and latitudes of the nodes [deg].
    coordinates : coordinates of the nodes on the axes of the panel.
    """
    height = float(field.coordinates(flown)[:, 2].mean())
    longitude, latitude = (np.radians(each) for each in degrees)
    vertical = field.vertical_disturbance(*field.over_nodes(latitude[:, None], longitude, height))
    limit = float(np.abs(vertical).max()) or 1.0
    mesh = axis.pcolormesh(
        *coordinates, vertical, cmap="RdBu_r", vmin=-limit, vmax=limit, alpha=0.6, rasterized=True
    )
    figure.colorbar(mesh, ax=axis, location="bottom", shrink=0.8, label="disturbing Γ_UU [E]")


@styled()
def planned_tracks(tracks: pd.DataFrame, field: Field, flown: np.ndarray, title: str) -> Drawing:
    """Draw an arrow for the start and heading of each track, coloured by the bound of the track.

    Tracks that cannot be flown are omitted. The disturbing Γ_UU of the field is the background. The
    original flight is black.

    Parameters
    ----------
    tracks : tracks with bounds, from :func:`ggbench.judging.planned.tracks`.
    field : true field.
    flown : (K, 3) latitude, longitude [rad], height [m] of the original flight.
    title : title of the case.
    """
    able = tracks[tracks["reason"] == ""]
    # The reverse: the smallest bound is drawn last, above the others.
    able = able.iloc[::-1]
    starts = able[["east_km", "north_km"]].to_numpy()
    track = 1e-3 * (flown[:, [1, 0]] - flown[0, [1, 0]]) * metres_along(flown[:1])
    length = _arrow_length(tracks[["east_km", "north_km"]].to_numpy(), track)
    heading = np.radians(able["heading_deg"].to_numpy())
    along = length * np.column_stack([np.sin(heading), np.cos(heading)])
    corners = np.vstack([starts, starts + along, track])
    middle = 0.5 * (corners.max(axis=0) + corners.min(axis=0))
    half = 0.5 * float(np.ptp(corners, axis=0).max()) * (1.0 + _AROUND)
    figure, axis = subplots(figsize=(6.8, 7.2))
    axis.set_xlim(middle[0] - half, middle[0] + half)
    axis.set_ylim(middle[1] - half, middle[1] + half)
    axis.set_aspect("equal")
    if field.has_map:
        per_km = 1e3 / metres_along(flown[:1])[0]
        sides = [
            np.linspace(
                max(middle[k] - half, (field.lower[1 - k] - flown[0, 1 - k]) / per_km[k]),
                min(middle[k] + half, (field.upper[1 - k] - flown[0, 1 - k]) / per_km[k]),
                _NODES,
            )
            for k in range(2)
        ]
        east, north = sides
        degrees = [np.degrees(flown[0, 1 - k] + sides[k] * per_km[k]) for k in range(2)]
        _draw_field(figure, axis, field, flown, (degrees[0], degrees[1]), (east, north))
    axis.plot(*track.T, color="k", lw=1.0, label="present flight", zorder=4)
    axis.plot(0.0, 0.0, "o", color="k", mfc="w", ms=6, zorder=6)
    bounds = able["bound_m"].to_numpy()
    if len(bounds):
        smallest, largest = bounds.min(), bounds.max()
        arrows = axis.quiver(
            *starts.T,
            *along.T,
            bounds,
            norm=LogNorm(smallest, max(largest, 1.001 * smallest)),
            cmap="plasma",
            angles="uv",
            scale_units="xy",
            scale=1.0,
            width=0.008,
            edgecolor=["k" if present else "none" for present in able["present"]],
            linewidth=1.2,
            zorder=5,
        )
        figure.colorbar(
            arrows,
            ax=axis,
            location="bottom",
            shrink=0.8,
            label="bound of the RMS position error [m]",
            ticks=LogLocator(subs=(1.0, 2.0, 5.0)),
            format=lambda value, _: f"{value:g}",
        ).minorticks_off()
    axis.legend(loc="upper right")
    axis.grid(visible=False)
    axis.set(xlabel="east of the present start [km]", ylabel="north of the present start [km]")
    axis.set_title(f"Where to fly: {title}", fontsize=9, wrap=True)
    return figure


def _arrow_length(starts: np.ndarray, track: np.ndarray) -> float:
    """Return the length of arrows [km].

    The length is at most the largest distance of the track from its start. With several starts it
    is also limited to a fraction of the distance between neighbouring starts.

    Parameters
    ----------
    starts : (n, 2) east and north of the starts [km].
    track : (K, 2) east and north of the original flight from its start [km].
    """
    apart = [np.diff(np.unique(starts[:, k])).min(initial=np.inf) for k in range(2)]
    reach = float(np.hypot(*track.T).max())
    return min(_ARROW * float(min(apart)), reach)
