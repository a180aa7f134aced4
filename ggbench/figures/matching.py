"""The figure of matchers' fixes: what another threshold of acceptance would have brought."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from . import style
from .line_styles import line_styles
from .style import Drawing, legend_below, styled

_FIRST = 0.01
"""Share of false fixes up to which the scale is linear."""


@dataclass(frozen=True)
class Operation:
    """A matcher on a case: shares of the fixes that it tried.

    Attributes
    ----------
    false, right : (J,) what would be accepted, by falling thresholds.
    at : false and right ones that were.
    """

    false: np.ndarray
    right: np.ndarray
    at: tuple[float, float]


@styled()
def operating_curves(
    panels: Sequence[tuple[str, Mapping[str, Operation]]], labels: Sequence[str]
) -> Drawing:
    """Draw accepted right fixes over accepted false ones, a panel (title, matchers) for each case.

    A curve goes over all thresholds; its mark is where the matcher's own lies.
    """
    names = "accepted and false", "accepted and right"
    figure, grid = style.panels(len(panels), (3.4, 3.0), 5.5, names, sharex=True)
    drawn = line_styles(labels)
    handles = {}
    for axis, (title, held) in zip(grid, panels, strict=True):
        for number, label in enumerate(label for label in labels if label in held):
            curve, look = held[label], drawn[label]
            # Thinner from line to line: what is below another one is seen at its sides.
            width = max(2.8 - 0.4 * number, 1.0)
            axis.plot(curve.false, curve.right, color=look.color, ls=look.ls, lw=width)
            (handles[label],) = axis.plot(
                *curve.at, color=look.color, marker=look.marker, ls=look.ls, ms=6.0,
                clip_on=False, zorder=3,
            )  # fmt: skip
        # Logarithmic but for the first per cent: good matchers stand near none, and far from some.
        axis.set_xscale("symlog", linthresh=_FIRST)
        axis.set(title=title, xlim=(-0.1 * _FIRST, 1.1), ylim=(-0.02, 1.02))
        axis.set_xticks([0.0, _FIRST, 0.1, 1.0])
        for side in (axis.xaxis, axis.yaxis):
            side.set_major_formatter(lambda value, _: f"{100.0 * value:.0f} %")
    legend_below(figure, {label: handles[label] for label in labels if label in handles})
    return figure
