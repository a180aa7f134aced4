"""The figure of the league."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.colors import TwoSlopeNorm

from ..figures.numbers import short
from ..figures.style import Drawing, styled, subplots
from .league import SMOOTHERS, Standing

_FARTHEST = (0.1, 1000.0)
"""Ratios beyond which the colour of the league's figure does not change."""


@styled()
def draw(shown: Sequence[Standing], names: Sequence[str]) -> Drawing:
    """Draw the ratios of the league as a heat map: estimators over scenarios, on a log scale.

    Parameters
    ----------
    shown : the estimators. names : of the scenarios.
    """
    ratios = np.array([[s.by_scenario.get(n, math.nan) for n in names] for s in shown])
    with np.errstate(divide="ignore"):
        logs = np.log10(np.clip(ratios, *_FARTHEST))
    width, height = 0.78 * len(names) + 3.6, 0.31 * len(shown) + 1.9
    figure, axis = subplots(figsize=(max(width, 5.0), height))
    low, high = (math.log10(end) for end in _FARTHEST)
    image = axis.imshow(
        np.ma.masked_invalid(logs), aspect="auto", cmap="RdBu_r",
        norm=TwoSlopeNorm(0.0, low, high),
    )  # fmt: skip
    for (row, column), value in np.ndenumerate(ratios):
        if math.isnan(value):
            axis.text(column, row, "–", ha="center", va="center", color="0.6")
            continue
        strong = logs[row, column] / (high if logs[row, column] > 0.0 else -low)
        axis.text(
            column, row, number(value), ha="center", va="center", fontsize=7.5,
            color="white" if abs(strong) > 0.65 else "black",
        )  # fmt: skip
    axis.grid(False)
    axis.set_xticks(range(len(names)), names, rotation=35, ha="right",
                    rotation_mode="anchor")  # fmt: skip
    axis.set_yticks(range(len(shown)), [s.label for s in shown])
    for before, after in zip(range(len(shown)), shown[1:], strict=False):
        if after.causality in SMOOTHERS and shown[before].causality not in SMOOTHERS:
            axis.axhline(before + 0.5, color="black", lw=1.2)
    bar = figure.colorbar(image, ax=axis, label="MRSE / best causal", pad=0.02)
    ticks = [-1.0, 0.0, 1.0, 2.0, 3.0]
    bar.set_ticks(ticks, labels=["≤ 0.1", "1", "10", "100", "≥ 1000"])
    return figure


def number(value: float) -> str:
    """Return a number with three digits, – for none."""
    if not math.isfinite(value):
        return "–" if math.isnan(value) else "∞"
    return short(float(f"{value:.2e}"))
