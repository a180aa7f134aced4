"""League figure: a table of cases and estimators, and a performance profile below it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from textwrap import fill
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap, LogNorm
from matplotlib.patches import Patch, Rectangle
from matplotlib.transforms import ScaledTranslation

from .line_styles import COLOURS, line_styles, stacked
from .style import INS, Drawing, legend_below, plain_numbers, styled, subplots

WIDTH = 7.3
"""Width of the figure [in], 800 pixels."""
WORST = 30.0
"""Ratio at which the colour scale and the profile end."""
SCALE = LinearSegmentedColormap.from_list(
    "league", ["#4a90c9", "#a9cfe8", "#f4f1e6", "#f2b077", "#d5702a", "#a8460d"]
)
"""Colours of cells from blue over white to orange; colour-blind readers see the same order."""
_MISSING = "0.9"
"""Colour of a cell without a ratio."""
_ROW, _HEAD, _PROFILE = 0.29, 1.35, 2.1
"""Heights [in] of a row of the grid, of its head, of the profile."""
KEY = (
    "Number: RMS error / oracle's error\n"
    "(wrong model: RMS error / bound)\n"
    "In brackets: bound of filters\n"
    "Frame: recommended\n"
    "\N{DAGGER} overconfident, \N{DOUBLE DAGGER} unsafe\n"
    "lost: share of lost runs, above half"
)
"""Explanation of the cells, in the corner above the names of the cases."""
_TITLE = 34
"""Characters in a line of a case's name."""
_LABELS, _NARROWEST, _GAP = 2.3, 0.28, 0.35
"""Widths of the names of cases and of the narrowest cell [in]; of the gap before smoothers, in
cells.
"""


class League(NamedTuple):
    """Content of the league figure for n cases and m estimators.

    Attributes
    ----------
    cases : names of the n cases, from the top.
    estimators : labels of the m estimators; smoothers come last.
    smoothers : number of smoothers.
    ratios : (n, m) ratios that set the colours of the cells; NaN if missing.
    texts : (n, m) texts in the cells.
    framed : (n, m) mask of recommended estimators, whose cells have a frame.
    to_best : for each causal estimator, by label, the ratios (n,) of its RMS errors to those of the
        best causal estimator; NaN if missing.
    """

    cases: Sequence[str]
    estimators: Sequence[str]
    smoothers: int
    ratios: np.ndarray
    texts: np.ndarray
    framed: np.ndarray
    to_best: Mapping[str, np.ndarray]


@styled()
def league(of: League, families: Mapping[str, str]) -> Drawing:
    """Draw the league of estimators.

    Parameters
    ----------
    of : content of the figure.
    families : family of each estimator by label. Labels of estimators of the family ``own`` are
        drawn in the colour of this family.
    """
    rows, width = _ROW * len(of.cases), _LABELS + _NARROWEST * (_places(of)[-1] + 1.0)
    figure, (grid, profile) = subplots(
        2,
        1,
        figsize=(max(WIDTH, width), _HEAD + rows + _PROFILE),
        height_ratios=(rows, _PROFILE - 0.5),
    )
    _draw_grid(figure, grid, of, families)
    _draw_profile(figure, profile, of, families)
    return figure


def _places(of: League) -> np.ndarray:
    """Return the abscissae (m,) of the columns, with a gap before the smoothers."""
    places = np.arange(len(of.estimators), dtype=float)
    causal = len(places) - of.smoothers
    places[causal:] += _GAP if causal else 0.0
    return places


def _draw_grid(figure: Drawing, axes: Axes, of: League, families: Mapping[str, str]) -> None:
    """Draw the cells with their texts, estimators above them and cases at the left."""
    places, norm = _places(of), LogNorm(1.0, WORST, clip=True)
    # A number in the cells as large as their width allows.
    points = 72.0 * (figure.get_figwidth() - _LABELS) / (places[-1] + 1.0)
    size = float(np.clip(points / 3.7, 5.2, 7.5))
    for (row, column), ratio in np.ndenumerate(of.ratios):
        x = float(places[column])
        colour = _MISSING if np.isnan(ratio) else SCALE(norm(min(ratio, WORST)))
        axes.add_patch(Rectangle((x - 0.5, row - 0.5), 1.0, 1.0, fc=colour, ec="w", lw=0.8))
        axes.text(
            x,
            row,
            str(of.texts[row, column]),
            ha="center",
            va="center",
            fontsize=size,
            linespacing=0.9,
            color="w" if ratio > 0.6 * WORST else "k",
            weight="bold" if of.framed[row, column] else "normal",
            zorder=4,
        )
        if of.framed[row, column]:
            frame = Rectangle((x - 0.44, row - 0.42), 0.88, 0.84, fill=False, lw=1.1, zorder=3)
            axes.add_patch(frame)
    axes.set_xlim(-0.5, places[-1] + 0.5)
    axes.set_ylim(len(of.cases) - 0.5, -0.5)
    axes.set_yticks(range(len(of.cases)), [fill(name, _TITLE) for name in of.cases], fontsize=7.5)
    axes.xaxis.tick_top()
    names = ["INS" if name == "ins" else name for name in of.estimators]
    axes.set_xticks(places, names, rotation=50, ha="left", fontsize=7.5)
    shift = ScaledTranslation(-0.06, -0.03, figure.dpi_scale_trans)
    for label, name in zip(axes.get_xticklabels(), of.estimators, strict=True):
        label.set(rotation_mode="anchor", transform=label.get_transform() + shift)
        if families.get(name) == "own":
            label.set(color=COLOURS["own"], weight="bold")
    axes.annotate(
        KEY, (0.0, 1.0), (-6.0, 4.0), "axes fraction", "offset points", ha="right", fontsize=7.5
    )
    causal = len(places) - of.smoothers
    for block, name in ((places[:causal], "in flight"), (places[causal:], "after landing")):
        if len(block) and of.smoothers:
            below = len(of.cases) - 0.4
            axes.text(block.mean(), below, name, ha="center", va="top", fontsize=7.5)
    axes.tick_params(length=0.0)
    axes.grid(False)
    for spine in axes.spines.values():
        spine.set_visible(False)


def _draw_profile(figure: Drawing, axes: Axes, of: League, families: Mapping[str, str]) -> None:
    """Draw the share of cases against the ratio to the best error, and the legend of the figure."""
    styles = line_styles(families)
    for label, width, alpha in stacked(of.to_best, families):
        own = of.to_best[label]
        reached = np.sort(own[np.isfinite(own) & (own <= WORST)])
        shares = 100.0 * np.arange(1, len(reached) + 1) / len(own)
        steps = np.concatenate([[1.0], reached, [WORST]])
        heights = np.concatenate([[0.0], shares, shares[-1:] if len(shares) else [0.0]])
        style = styles[label]
        line = axes.plot(
            steps,
            heights,
            color=INS if families.get(label) == "inertial" else style.color,
            ls=style.ls,
            lw=width,
            alpha=alpha,
            drawstyle="steps-post",
        )
        figure.attribute("INS" if label == "ins" else label, *line)
    axes.set(xscale="log", xlim=(1.0, WORST), ylim=(-3.0, 103.0))
    axes.set(xlabel="RMS error over that of the best filter of the case", ylabel="cases [%]")
    plain_numbers(axes, "x")
    colours = {
        f"× {ratio:g}": Patch(facecolor=SCALE(LogNorm(1.0, WORST)(ratio)))
        for ratio in (1.0, 3.0, 10.0, WORST)
    }
    frame = {"recommended": Patch(facecolor="w", edgecolor="k", lw=1.1)}
    legend_below(figure, figure.handles | frame | colours)
