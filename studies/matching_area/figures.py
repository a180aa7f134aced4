"""The figures of the study: errors over indices, and how well each index orders them."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.ticker import LogLocator, NullFormatter

from ggbench.figures.style import Drawing, legend_below, plain_numbers, styled, subplots

from .design import REGIONS
from .findings import Ranking

COLOURS = {region.name: colour for region, colour in zip(REGIONS, ("C0", "C1"), strict=True)}
SHOWN = {
    "roughness": "roughness of Γ_UU [E/km]",
    "track_m": "CRLB along the track [m]",
    "bound_m": "bound of the flight [m]",
}


@styled()
def scatter(table: pd.DataFrame, near: Ranking) -> Drawing:
    """Draw the error of each track over three indices, the worst on the right."""
    figure, axes = subplots(1, 3, figsize=(10.5, 3.6), sharey=True)
    handles = {}
    for axis, (column, label) in zip(axes, SHOWN.items(), strict=True):
        scale = 1e3 if column == "roughness" else 1.0
        for region in REGIONS:
            part = table[table["region"] == region.name]
            dots = axis.scatter(
                scale * part[column], part["error_m"], s=6, alpha=0.6, lw=0,
                color=COLOURS[region.name],
            )  # fmt: skip
            handles[region.title] = dots
        axis.set_xscale("log")
        axis.set_yscale("log")
        axis.set_xlabel(label)
        axis.set_title(f"Spearman {near.order.value[near.at(column)]:.2f}")
        axis.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axis.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
        axis.xaxis.set_minor_formatter(NullFormatter())
        if column != "roughness":
            ends = np.array([table["error_m"].min(), table["error_m"].max()])
            handles["error = index"] = axis.plot(ends, ends, "k-", lw=0.8)[0]
    axes[0].invert_xaxis()
    axes[0].set_ylabel("horizontal error of the filter [m]")
    plain_numbers(axes[0])
    legend_below(figure, handles)
    return figure


@styled()
def forest(near: Ranking, weak: Ranking) -> Drawing:
    """Draw the correlations of all indices with their intervals, and those of each region."""
    figure, axes = subplots(1, 2, figsize=(10.5, 3.8), sharex=True)
    handles = {}
    titles = ("smallness of the error (near)", "share of right fixes (weak)")
    for axis, ranking, title in zip(axes, (near, weak), titles, strict=True):
        order = ranking.order
        places = np.arange(len(ranking.indices))[::-1]
        spread = np.abs(np.stack([order.low, order.high]) - order.value)
        handles["mean of the regions, 95 % over cells"] = axis.errorbar(
            order.value, places, xerr=spread, fmt="ks", ms=4, lw=1.2
        )
        for region in REGIONS:
            if region.name in order.regions:
                handles[region.title] = axis.scatter(
                    order.regions[region.name][0], places, marker="|", s=60,
                    color=COLOURS[region.name],
                )  # fmt: skip
        axis.axvline(0.0, color="0.4", lw=0.8)
        axis.axvline(order.value[ranking.at("roughness")], color="0.4", lw=0.8, ls=":")
        axis.set_yticks(places, [index.title for index in ranking.indices])
        axis.set_xlabel("Spearman's correlation")
        axis.set_title(title)
    legend_below(figure, handles)
    return figure
