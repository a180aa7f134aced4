"""The figure of matchers' fixes: what another threshold of acceptance would have brought."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from .looks import looks
from .style import Drawing, legend_below, styled, subplots


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
    columns = min(len(panels), 3)
    rows = -(-len(panels) // columns)
    figure, grid = subplots(
        rows, columns, squeeze=False, sharex=True, sharey=True,
        figsize=(max(3.4 * columns + 0.3, 5.5), 3.0 * rows + 0.2),
    )  # fmt: skip
    drawn = looks(labels)
    for axis in grid.flat[len(panels) :]:
        axis.set_visible(False)
    handles = {}
    for axis, (title, held) in zip(grid.flat, panels, strict=False):
        for number, label in enumerate(label for label in labels if label in held):
            curve, look = held[label], drawn[label]
            # Thinner from line to line: what is below another one is seen at its sides.
            width = max(2.8 - 0.4 * number, 1.0)
            axis.plot(curve.false, curve.right, color=look.color, ls=look.ls, lw=width)
            (handles[label],) = axis.plot(
                *curve.at, color=look.color, marker=look.marker, ls=look.ls, ms=6.0,
                clip_on=False, zorder=3,
            )  # fmt: skip
        axis.set(title=title, xlim=(-0.02, 1.02), ylim=(-0.02, 1.02))
        for side in (axis.xaxis, axis.yaxis):
            side.set_major_formatter(lambda value, _: f"{100.0 * value:.0f} %")
    for column in range(columns):
        grid[(len(panels) - 1 - column) // columns, column].set_xlabel("accepted and false")
    for axis in grid[:, 0]:
        axis.set_ylabel("accepted and right")
    legend_below(figure, {label: handles[label] for label in labels if label in handles})
    return figure
