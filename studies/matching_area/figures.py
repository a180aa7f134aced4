"""Figure of the study: errors of tracks against three indices."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.ticker import LogLocator, NullFormatter

from ggbench.figures.style import Drawing, legend_below, plain_numbers, styled, subplots

from .design import REGIONS
from .findings import Ranking

SHOWN = {
    "roughness": "roughness of Γ_UU [E/km]",
    "track_m": "CRLB along the track [m]",
    "bound_m": "bound of the flight [m]",
}
_PER_KM = {"roughness": 1e3}


@styled()
def scatter(table: pd.DataFrame, near: Ranking) -> Drawing:
    """Return a figure of track errors against three indices, which get worse to the right."""
    figure, axes = subplots(1, 3, figsize=(8.4, 3.2), sharey=True)
    ends = [table["error_m"].min(), table["error_m"].max()]
    handles = {}
    for axis, (column, label) in zip(axes, SHOWN.items(), strict=True):
        for region, colour in zip(REGIONS, ("C0", "C1"), strict=True):
            part = table[table["region"] == region.name]
            values = _PER_KM.get(column, 1.0) * part[column]
            handles[region.title] = axis.scatter(
                values, part["error_m"], s=7, alpha=0.6, lw=0, color=colour
            )
        axis.set(xscale="log", yscale="log", xlabel=label)
        axis.set_title(f"Spearman correlation {near.order.value[near.at(column)]:.2f}")
        axis.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axis.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
        axis.xaxis.set_minor_formatter(NullFormatter())
        if column not in _PER_KM:
            handles["error = bound"] = axis.plot(ends, ends, "k-", lw=0.8)[0]
    axes[0].invert_xaxis()
    axes[0].set_ylabel("horizontal RMS error [m]")
    axes[0].set_yticks(np.array([20.0, 50.0, 100.0, 200.0]))
    plain_numbers(axes[0])
    legend_below(figure, handles)
    return figure
