"""Main figure of a scenario: errors by case, or against the swept value."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from textwrap import fill
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes

from .line_styles import is_own, line_styles, stacked
from .style import BOUND, INS, Drawing, legend_below, plain_numbers, styled, subplots

if TYPE_CHECKING:
    import pandas as pd

WIDTH = 7.3
"""Width of a figure [in], 800 pixels."""
_FILLED = {"-": "full", "--": "none", "-.": "left", ":": "bottom"}
"""Filling of markers by the line of an estimator."""
_TITLES = 84
"""Characters in a line of the titles of all panels."""
_NAME = 30
"""Characters in a line of a case's name."""
MOST_BEYOND = 10.0
"""Factor by which an axis of errors extends beyond its outermost values, for intervals."""


class Curve(NamedTuple):
    """RMS errors, confidence intervals and success rates of an estimator in n cases.

    Attributes
    ----------
    rms : (n,) RMS errors [m].
    low, high : (n,) lower and upper ends of the confidence intervals of ``rms`` [m].
    success : (n,) success rates.
    """

    rms: np.ndarray
    low: np.ndarray
    high: np.ndarray
    success: np.ndarray


class Panel(NamedTuple):
    """Curves of one panel of a figure.

    Attributes
    ----------
    title : title of the panel.
    places : (n,) abscissae of n cases.
    curves : curve of each estimator, by label.
    bound : (n,) bounds of filters [m]; NaN if missing.
    smoothing_bound : (n,) bounds of smoothers [m]; NaN if missing. Only panels with a smoother have
        these bounds.
    ins : (n,) RMS errors of the INS [m]; NaN if missing.
    """

    title: str
    places: np.ndarray
    curves: Mapping[str, Curve]
    bound: np.ndarray
    smoothing_bound: np.ndarray
    ins: np.ndarray

    @property
    def references(self) -> list[tuple[str, np.ndarray, str, str]]:
        """Name, values (n,), colour and line style of each available reference (bounds and INS)."""
        all_of_them = [
            ("bound of filters", self.bound, BOUND, "-"),
            ("bound of smoothers", self.smoothing_bound, BOUND, ":"),
            ("INS", self.ins, INS, "--"),
        ]
        return [each for each in all_of_them if np.isfinite(each[1]).any()]


def panel(
    rows: pd.DataFrame,
    names: Sequence[str],
    labels: Sequence[str],
    title: str = "",
    places: np.ndarray | None = None,
) -> Panel:
    """Return the panel with the errors of estimators in the named cases.

    Parameters
    ----------
    rows : metrics of one window, a row for each case and estimator.
    names : names of the n cases.
    labels : labels of the estimators.
    title : title of the panel.
    places : (n,) abscissae of the cases, by default 0 to n − 1.
    """
    table = rows.set_index(["estimator", "case"])

    def values(label: str, key: str) -> np.ndarray:
        index = [(label, name) for name in names]
        array = np.asarray(table[key].reindex(index), dtype=float)
        return np.where(np.isfinite(array), array, np.nan)  # an open interval is not drawn

    curves = {
        label: Curve(*(values(label, key) for key in ("rms_m", "rms_lo", "rms_hi", "success")))
        for label in labels
    }

    def bound(causality: str) -> np.ndarray:
        own = rows[(rows["causality"] == causality) & rows["estimator"].isin(labels)]
        own = own if causality == "batch" else rows[rows["causality"] == causality]
        return np.asarray(own.groupby("case")["bound_m"].first().reindex(names), dtype=float)

    where = np.arange(len(names), dtype=float) if places is None else places
    return Panel(title, where, curves, bound("filter"), bound("batch"), values("ins", "rms_m"))


@styled()
def over_cases(names: Sequence[str], panel: Panel, families: Mapping[str, str]) -> Drawing:
    """Draw RMS errors with a row for each case; bounds and the INS are lines.

    A second column shows success rates if any is below 100 %.

    Parameters
    ----------
    names : titles of the n cases, from the top.
    panel : errors; its abscissae are not used.
    families : family of each estimator, by label. The family sets the colour.
    """
    curves, count = panel.curves, len(names)
    columns = _columns(panel)
    row = 0.26 + 0.075 * len(curves)
    figure, grid = subplots(
        1,
        columns,
        figsize=(WIDTH, 0.9 + max(row, 0.4) * count),
        sharey=True,
        squeeze=False,
        width_ratios=(2.6, 1.0)[:columns],
    )
    errors: Axes = grid[0, 0]
    middle = np.arange(count, dtype=float)
    styles = line_styles(families)
    for number, (label, curve) in enumerate(curves.items()):
        at = middle + 0.7 * ((number + 0.5) / len(curves) - 0.5)
        style = styles[label]
        marks: dict[str, Any] = {
            "color": style.color,
            "marker": style.marker,
            "fillstyle": _FILLED[style.ls],
            "ms": 8.0 if is_own(label, families) else 5.5,
            "zorder": 3.0 if is_own(label, families) else 2.0,
            "ls": "",
        }
        figure.attribute(label, *errors.plot(curve.rms, at, **marks))
        figure.attribute(label, errors.hlines(at, curve.low, curve.high, color=style.color, lw=1.4))
        if columns == 2:
            figure.attribute(label, *grid[0, 1].plot(100.0 * curve.success, at, **marks))
    ends = middle - 0.42, middle + 0.42
    for name, values, colour, line in panel.references:
        figure.attribute(name, errors.vlines(values, *ends, color=colour, ls=line, lw=1.8))
    errors.set(xscale="log", xlabel="RMS position error [m], 95 % interval")
    errors.set_xlim(_limits([panel], errors.get_xlim()))
    errors.set_yticks(middle, [fill(name, _NAME) for name in names])
    errors.set_ylim(count - 0.5, -0.5)
    plain_numbers(errors, "x")
    if columns == 2:
        grid[0, 1].set(xlabel="success [%]", xlim=(-4.0, 104.0))
    for axis in grid[0]:
        axis.grid(False, axis="y")
        for edge in range(1, count):
            axis.axhline(edge - 0.5, color="0.85", lw=0.8, zorder=0)
    legend_below(figure, figure.handles)
    return figure


@styled()
def over_axis(
    panels: Sequence[Panel], label: str, log: bool, families: Mapping[str, str]
) -> Drawing:
    """Draw RMS errors against a swept value; bounds and the INS are lines.

    A second row shows success rates if any is below 100 %.

    Parameters
    ----------
    panels : panels of the figure, from left to right.
    label : label of the abscissa.
    log : whether the axis of the abscissa is logarithmic.
    families : family of each estimator, by label. The family sets the colour.
    """
    rows = max(map(_columns, panels))
    figure, grid = subplots(
        rows,
        len(panels),
        figsize=(WIDTH, 3.3 + 1.5 * (rows - 1)),
        sharex=True,
        sharey="row",
        squeeze=False,
        height_ratios=(2.2, 1.0)[:rows],
    )
    styles = line_styles(families)
    for column, panel in enumerate(panels):
        top: Axes = grid[0, column]
        for name, width, alpha in stacked(panel.curves, families):
            curve, style = panel.curves[name], styles[name]
            look: dict[str, Any] = style._asdict() | {
                "fillstyle": _FILLED[style.ls],
                "ms": 4.5,
                "lw": width,
                "alpha": alpha,
            }
            figure.attribute(name, *top.plot(panel.places, curve.rms, **look))
            interval = top.fill_between(
                panel.places, curve.low, curve.high, color=style.color, alpha=0.15, lw=0.0
            )
            figure.attribute(name, interval)
            if rows == 2:
                success = grid[1, column].plot(panel.places, 100.0 * curve.success, **look)
                figure.attribute(name, *success)
        for name, values, colour, line in panel.references:
            figure.attribute(name, *top.plot(panel.places, values, color=colour, lw=1.6, ls=line))
        top.set(xscale="log" if log else "linear", yscale="log")
        top.set_title(fill(panel.title, _TITLES // len(panels)), fontsize=9)
        grid[-1, column].set_xlabel(fill(label, _TITLES // len(panels)))
    grid[0, 0].set_ylabel("RMS position error [m]")
    grid[0, 0].set_ylim(_limits(panels, grid[0, 0].get_ylim()))
    if rows == 2:
        grid[1, 0].set(ylabel="success [%]", ylim=(-4.0, 104.0))
    plain_numbers(grid[0, 0])
    if log:
        for axis in grid[-1]:
            plain_numbers(axis, "x")
    legend_below(figure, figure.handles)
    return figure


def _limits(panels: Sequence[Panel], limits: tuple[float, float]) -> tuple[float, float]:
    """Return the limits of an axis of errors, at which very long intervals are cut."""
    shown: list[np.ndarray] = []
    for panel in panels:
        shown += [curve.rms for curve in panel.curves.values()]
        shown += [values for _, values, _, _ in panel.references]
    values = np.concatenate(shown)
    values = values[np.isfinite(values) & (values > 0.0)]
    if not len(values):
        return limits
    return (
        max(limits[0], float(values.min()) / MOST_BEYOND),
        min(limits[1], float(values.max()) * MOST_BEYOND),
    )


def _columns(panel: Panel) -> int:
    """Return the number of columns: 2 if a success rate is below 100 %, else 1."""
    return 2 if any((curve.success < 1.0).any() for curve in panel.curves.values()) else 1
