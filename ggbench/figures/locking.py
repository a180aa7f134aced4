"""The figures of locking on: over the cases, against time, and against what it costs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import FixedLocator, NullLocator

from . import style
from .line_styles import LineStyle, line_styles
from .numbers import short
from .style import INS, Drawing, legend_below, plain_numbers, styled, subplots


@dataclass(frozen=True)
class Series:
    """A figure over the cases between two ends, each (n,); NaN where there is none."""

    value: np.ndarray
    low: np.ndarray
    high: np.ndarray


@dataclass(frozen=True)
class Panels:
    """One row of :func:`over_cases`: cases that differ in their prior alone, or any cases.

    Attributes
    ----------
    title : of the row, "" for none.
    names : (n,) of the cases.
    priors : (n,) σ of the initial position error [km], strictly increasing; None: categories.
    shares, false_locks, times : by estimator; shares of the runs, and median times to lock [s].
    """

    title: str
    names: Sequence[str]
    priors: Sequence[float] | None
    shares: Mapping[str, Series]
    false_locks: Mapping[str, Series]
    times: Mapping[str, Series]


@styled()
def over_cases(rows: Sequence[Panels], labels: Sequence[str]) -> Drawing:
    """Draw the share of runs locked, of false locks, and the median time to lock over the cases.

    Bars are 95 % intervals; the estimators of one case stand beside each other.
    """
    widest = max(len(row.names) for row in rows)
    columns = 3
    figure, grid = subplots(
        len(rows), columns, figsize=(10.8, 3.3 * len(rows) + 0.1),
        squeeze=False,
    )  # fmt: skip
    drawn = line_styles(labels)
    for panels, axes in zip(rows, grid, strict=True):
        contents = (
            ("share locked", panels.shares),
            ("share of false locks", panels.false_locks),
            ("median time to lock [s]", panels.times),
        )
        for axis, (title, series) in zip(axes, contents, strict=True):
            _over(axis, panels, series, labels, drawn)
            axis.set_title(title)
        for axis in axes[:2]:
            axis.set_ylim(-0.04, 1.04)
            axis.yaxis.set_major_formatter(lambda value, _: f"{100.0 * value:.0f} %")
        axes[2].set_ylim(bottom=0.0)
        if panels.title:
            axes[0].annotate(
                panels.title, (0.0, 1.0), (0.0, 20.0), xycoords="axes fraction",
                textcoords="offset points", weight="bold",
            )  # fmt: skip
        if panels.priors is None and widest > 3:
            for axis in axes:
                axis.tick_params(axis="x", labelrotation=40)
                for name in axis.get_xticklabels():
                    name.set(ha="right", rotation_mode="anchor")
    handles = {
        name: handle
        for axis in grid.flat
        for handle, name in zip(*axis.get_legend_handles_labels(), strict=True)
    }
    legend_below(figure, {label: handles[label] for label in labels if label in handles})
    return figure


def _over(
    axis: Axes, panels: Panels, series: Mapping[str, Series], labels: Sequence[str],
    drawn: Mapping[str, LineStyle],
) -> None:  # fmt: skip
    """Draw one figure of every estimator over the cases of a row."""
    places = np.arange(len(panels.names), dtype=float)
    if panels.priors is not None:
        places = np.log10(panels.priors)
    gap = float(np.diff(places).min()) if len(places) > 1 else 1.0
    held = [label for label in labels if label in series]
    for number, label in enumerate(held):
        line = series[label]
        # Side by side, so that equal shares do not hide each other.
        shift = 0.5 * gap * ((number + 0.5) / len(held) - 0.5)
        reach = np.abs(np.nan_to_num([line.value - line.low, line.high - line.value]))
        look: dict[str, Any] = drawn[label]._asdict()
        if panels.priors is None:
            look["ls"] = ""
        axis.errorbar(
            places + shift, line.value, reach, label=label, lw=1.2, ms=4.0, elinewidth=0.9,
            capsize=1.5, **look,
        )  # fmt: skip
    axis.xaxis.set_major_locator(FixedLocator(places.tolist()))
    axis.xaxis.set_minor_locator(NullLocator())
    axis.set_xlim(places[0] - 0.5 * gap, places[-1] + 0.5 * gap)
    if panels.priors is None:
        axis.set_xticklabels(list(panels.names))
    else:
        axis.set_xticklabels([short_km(prior) for prior in panels.priors])
        axis.set_xlabel("σ of the initial position per axis [km]")
        # Of priors too close to each other every name would lie on its neighbour's.
        if gap < 0.09 * (places[-1] - places[0]):
            axis.tick_params(axis="x", labelrotation=90)


def short_km(prior: float) -> str:
    """Return a prior's σ [km] as an axis shows it."""
    return f"{prior:g}" if len(f"{prior:g}") <= 5 else short(prior)


@styled()
def against_time(
    panels: Sequence[tuple[str, np.ndarray, Mapping[str, np.ndarray]]],
    labels: Sequence[str],
) -> Drawing:
    """Draw the share of runs that have locked on by each time, a panel for each case.

    Each panel is (title, times (K,), estimator to shares (K,)).
    """
    names = "time [s]", "share of runs locked"
    figure, grid = style.panels(len(panels), (3.6, 2.6), 5.5, names)
    drawn = line_styles(labels)
    handles = {}
    for axis, (title, times, curves) in zip(grid, panels, strict=True):
        for number, label in enumerate(label for label in labels if label in curves):
            # Thinner from line to line: what is below another one is seen at its sides.
            look = drawn[label]
            width = max(3.2 - 0.5 * number, 1.0)
            (handles[label],) = axis.step(
                times, curves[label], where="post", lw=width,
                color=look.color, ls=look.ls,
            )  # fmt: skip
        axis.set(title=title, ylim=(-0.04, 1.04))
        axis.yaxis.set_major_formatter(lambda value, _: f"{100.0 * value:.0f} %")
    legend_below(figure, {label: handles[label] for label in labels if label in handles})
    return figure


@dataclass(frozen=True)
class Success:
    """One panel of :func:`against_cost`: a case.

    Attributes
    ----------
    title : of the case.
    seconds : estimator to its median time of a run [s].
    shares : estimator to the share of its runs that locked, and the ends of its 95 % interval.
    """

    title: str
    seconds: Mapping[str, float]
    shares: Mapping[str, tuple[float, float, float]]


@styled()
def against_cost(
    panels: Sequence[Success], labels: Sequence[str], joined: Mapping[str, Mapping[str, str]]
) -> Drawing:
    """Draw the share of runs locked over the time of a run, a panel for each case.

    Bars are 95 % intervals. Lines join estimators that differ in one number alone, which stands
    beside each mark: ``joined`` has for each line's name such estimators with these texts.
    """
    named = {label: title for title, line in joined.items() for label in line}
    shown = list(dict.fromkeys(named.get(label, label) for label in labels))
    names = "time of a run [s]", "share of runs locked"
    figure, grid = style.panels(len(panels), (3.6, 3.4), 7.4, names)
    drawn = line_styles(labels)
    handles = {}
    for axis, panel in zip(grid, panels, strict=True):
        held = [label for label in labels if label in panel.seconds]
        for line in joined.values():
            members = [label for label in line if label in held]
            axis.plot(
                [panel.seconds[k] for k in members], [panel.shares[k][0] for k in members],
                color=drawn[members[0]].color if members else INS, lw=1.0, zorder=1,
            )  # fmt: skip
            for label in members:
                axis.annotate(
                    line[label], (panel.seconds[label], panel.shares[label][0]), (4, -10),
                    textcoords="offset points", fontsize=7, color=drawn[label].color,
                )  # fmt: skip
        for label in held:
            value, low, high = panel.shares[label]
            handles[named.get(label, label)] = axis.errorbar(
                panel.seconds[label], value, [[value - low], [high - value]], ls="",
                color=drawn[label].color, marker=drawn[label].marker, ms=5.5, elinewidth=0.8,
                capsize=1.5,
            )  # fmt: skip
        axis.set(title=panel.title, xscale="log", ylim=(-0.06, 1.06))
        plain_numbers(axis, "x")
        axis.yaxis.set_major_formatter(lambda value, _: f"{100.0 * value:.0f} %")
    legend_below(figure, {name: handles[name] for name in shown if name in handles})
    return figure
