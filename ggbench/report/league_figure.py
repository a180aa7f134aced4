"""The figure of the league."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ..figures.numbers import short
from ..figures.style import Drawing, styled, subplots
from .league import SMOOTHERS, Standing


@styled()
def draw(shown: Sequence[Standing], names: Sequence[str]) -> Drawing:
    """Draw the league as a heat map: share of success as colour, error over bound as number.

    Parameters
    ----------
    shown : the estimators.
    names : of the scenarios.
    """
    shares = np.array([[s.success.get(n, math.nan) for n in names] for s in shown])
    width, height = 0.78 * len(names) + 3.6, 0.31 * len(shown) + 1.9
    figure, axis = subplots(figsize=(max(width, 5.0), height))
    image = axis.imshow(
        np.ma.masked_invalid(shares), aspect="auto", cmap="cividis", vmin=0.0, vmax=1.0
    )
    for row, standing in enumerate(shown):
        for column, name in enumerate(names):
            known = name in standing.ratio
            dark = known and standing.success[name] < 0.5
            axis.text(
                column, row, number(standing.ratio[name]) if known else "–", ha="center",
                va="center", fontsize=7.5, color="white" if dark else "black",
            )  # fmt: skip
    axis.grid(False)
    axis.set_xticks(range(len(names)), names, rotation=35, ha="right",
                    rotation_mode="anchor")  # fmt: skip
    axis.set_yticks(range(len(shown)), [s.label for s in shown])
    for before, after in zip(range(len(shown)), shown[1:], strict=False):
        if after.causality in SMOOTHERS and shown[before].causality not in SMOOTHERS:
            axis.axhline(before + 0.5, color="black", lw=1.2)
    bar = figure.colorbar(image, ax=axis, label="share of success", pad=0.02)
    bar.set_ticks([0.0, 0.5, 1.0], labels=["0 %", "50 %", "100 %"])
    return figure


def number(value: float) -> str:
    """Return a number with three digits, – for none."""
    if not math.isfinite(value):
        return "–" if math.isnan(value) else "∞"
    return short(float(f"{value:.2e}"))
