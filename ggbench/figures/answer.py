"""The figure that a report begins with: who succeeds, and how near the bound, case by case."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.container import ErrorbarContainer

from .line_styles import LineStyle, line_styles
from .locking import Series
from .style import Drawing, legend_below, plain_numbers, styled, subplots

_WIDEST = 11.0
"""Width of a figure [in] at most."""


@styled()
def over_cases(
    names: Sequence[str], shares: Mapping[str, Series], ratios: Mapping[str, Series]
) -> Drawing:
    """Draw the share of success, and below it the error over the bound where it succeeds.

    Parameters
    ----------
    names : (n,) of the cases.
    shares : estimator to its share of success with a 95 % interval.
    ratios : estimator to the median of error over bound, and its quartiles.
    """
    width = min(1.8 + 0.13 * len(shares) * len(names) + 0.5 * len(names), _WIDEST)
    figure, (top, bottom) = subplots(
        2, 1, figsize=(max(width, 6.0), 5.2), sharex=True, height_ratios=(2.0, 3.0)
    )
    drawn = line_styles(shares)
    handles = {}
    for axis, figures in ((top, shares), (bottom, ratios)):
        for number, (label, line) in enumerate(figures.items()):
            shift = 0.8 * ((number + 0.5) / len(figures) - 0.5)
            handles[label] = _points(axis, np.arange(len(names)) + shift, line, drawn[label])
        for edge in range(1, len(names)):
            axis.axvline(edge - 0.5, color="0.85", lw=0.8, zorder=0)
        axis.grid(False, axis="x")
    top.set(ylabel="share of success", ylim=(-0.06, 1.06))
    top.yaxis.set_major_formatter(lambda value, _: f"{100.0 * value:.0f} %")
    bottom.set(ylabel="error / bound of those\n(median, quartiles)", yscale="log")
    bottom.axhline(1.0, color="black", lw=0.9, ls=":")
    if not any(np.isfinite(line.value).any() for line in ratios.values()):
        bottom.set_ylim(0.5, 2.0)  # where nobody succeeds there is nothing to scale by
    plain_numbers(bottom)
    bottom.set_xlim(-0.5, len(names) - 0.5)
    long = max(map(len, names)) * len(names) > 9.0 * figure.get_size_inches()[0]
    bottom.set_xticks(range(len(names)), names, rotation=35 if long else 0,
                      ha="right" if long else "center", rotation_mode="anchor")  # fmt: skip
    legend_below(figure, handles)
    return figure


def _points(axis: Axes, places: np.ndarray, line: Series, look: LineStyle) -> ErrorbarContainer:
    """Draw an estimator's figures with bars between their ends; return what a legend shows."""
    reach = np.abs(np.nan_to_num([line.value - line.low, line.high - line.value]))
    return axis.errorbar(
        places, line.value, reach, ls="", color=look.color, marker=look.marker, ms=4.5,
        elinewidth=1.0, capsize=0.0,
    )  # fmt: skip
