"""Who finds back, and how near the bound, against the prior's width over the field's scale."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from .line_styles import line_styles
from .style import Drawing, legend_below, plain_numbers, styled, subplots

Curve = tuple[np.ndarray, np.ndarray]
"""σ/ℓ (n,), increasing, and a figure at each (n,)."""
Ends = Mapping[str, np.ndarray]
"""Estimator to the ends (2, n) of the intervals of its figure."""


@styled()
def against_width(shares: Mapping[str, Curve], ends: Ends, ratios: Mapping[str, Curve]) -> Drawing:
    """Draw the share of success and the error over the bound against σ/ℓ, estimators as lines.

    Parameters
    ----------
    shares : estimator to its share of success.
    ends : of their intervals, which are bars.
    ratios : estimator to the median of error over bound.
    """
    figure, (left, right) = subplots(1, 2, figsize=(9.6, 4.0))
    drawn = line_styles(shares)
    handles = {}
    for number, (label, (width, share)) in enumerate(shares.items()):
        look = drawn[label]
        # Thinner from line to line: what is below another one is seen at its sides.
        (handles[label],) = left.plot(
            width, share, lw=max(3.4 - 0.25 * number, 1.0), ms=4.0, **look._asdict()
        )
        # Beside each other, or the bars of those at 100 % would be one.
        beside = width * 1.02 ** (number - 0.5 * (len(shares) - 1))
        left.vlines(beside, *ends[label], color=look.color, lw=0.9)
    for label, (width, ratio) in ratios.items():
        right.plot(width, ratio, lw=1.2, ms=4.0, **drawn[label]._asdict())
    left.set(xscale="log", xlabel="σ/ℓ: prior's σ per axis over the field's correlation length",
             ylabel="share of runs that succeed", ylim=(-0.04, 1.04))  # fmt: skip
    left.yaxis.set_major_formatter(lambda value, _: f"{100.0 * value:.0f} %")
    right.set(xscale="log", yscale="log", xlabel="σ/ℓ",
              ylabel="error / bound of those that succeed (median)")  # fmt: skip
    right.axhline(1.0, color="black", lw=0.9, ls=":")
    for axis in (left, right):
        plain_numbers(axis, "x")
    plain_numbers(right)
    legend_below(figure, handles)
    return figure


@styled()
def each_setting(
    titles: Sequence[str], panels: Sequence[Mapping[str, Curve]], columns: int
) -> Drawing:
    """Draw the share of success against σ/ℓ in a panel for each setting.

    Parameters
    ----------
    titles : (n,) of the panels.
    panels : (n,) estimator to its share of success.
    columns : panels in a row.
    """
    rows = -(-len(panels) // columns)
    figure, grid = subplots(
        rows, columns, figsize=(3.2 * columns + 0.4, 2.3 * rows + 0.3), squeeze=False,
        sharex=True, sharey=True,
    )  # fmt: skip
    labels = list(dict.fromkeys(label for panel in panels for label in panel))
    drawn, handles = line_styles(labels), {}
    for axis, title, panel in zip(grid.flat, titles, panels, strict=False):
        for number, (label, (width, share)) in enumerate(panel.items()):
            (handles[label],) = axis.plot(
                width, share, lw=max(3.0 - 0.22 * number, 0.9), ms=3.0, **drawn[label]._asdict()
            )
        axis.set_title(title)
        axis.set(xscale="log", ylim=(-0.04, 1.04))
        axis.yaxis.set_major_formatter(lambda value, _: f"{100.0 * value:.0f} %")
    for axis in grid[-1]:
        axis.set_xlabel("σ/ℓ")
        plain_numbers(axis, "x")
    for axis in grid[:, 0]:
        axis.set_ylabel("success")
    legend_below(figure, {label: handles[label] for label in labels})
    return figure
