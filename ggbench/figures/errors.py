"""Figures of errors over time: many runs with bounds, or components of one run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from textwrap import fill
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes

from .line_styles import line_styles, stacked
from .style import BOUND, INS, Drawing, legend_below, plain_numbers, styled, subplots

AXES = ("east", "north", "up")
_TITLE = 70
"""Characters of titles that fit in a line above all panels."""


class Flight(NamedTuple):
    """Errors of one case over time.

    Attributes
    ----------
    title : title of the case.
    times : (K,) epochs [s].
    errors : RMS errors (K, 2) of position [m] and velocity [m/s], by estimator.
    bounds : bounds (K, 2) on the same errors, by name of the bound.
    """

    title: str
    times: np.ndarray
    errors: Mapping[str, np.ndarray]
    bounds: Mapping[str, np.ndarray]


@styled()
def error_over_time(flights: Sequence[Flight], families: Mapping[str, str]) -> Drawing:
    """Draw the RMS position and velocity errors of many runs, and the bounds, against time.

    Each of at most three ``flights`` is a column. ``families`` has the family of each estimator.
    """
    count = len(flights)
    figure, grid = subplots(2, count, figsize=(7.3, 5.2), sharex="col", squeeze=False)
    styles = line_styles(families)
    for column, (title, times, errors, bounds) in enumerate(flights):
        for row, quantity in enumerate(("position [m]", "velocity [m/s]")):
            axis: Axes = grid[row, column]
            for label, width, alpha in stacked(errors, families):
                style, name = styles[label], "INS" if label == "ins" else label
                line = axis.semilogy(
                    times,
                    errors[label][:, row],
                    ls=style.ls,
                    color=style.color,
                    lw=width,
                    alpha=alpha,
                    label=name,
                )
                figure.attribute(name, *line)
            for number, (name, bound) in enumerate(bounds.items()):
                line = axis.semilogy(
                    times,
                    bound[:, row],
                    color=BOUND,
                    lw=1.1,
                    ls=("-", ":", "--")[number % 3],
                    label=name,
                )
                figure.attribute(name, *line)
            plain_numbers(axis)
            axis.tick_params(which="both", labelsize=8)
            if row == 0:
                axis.set_title(fill(title, _TITLE // count), fontsize=9)
            else:
                axis.set_xlabel("time [s]")
            if column == 0:
                axis.set_ylabel(f"RMS {quantity}")
    legend_below(figure, figure.handles)
    return figure


@styled()
def component_errors(
    times: np.ndarray,
    aided: np.ndarray,
    ins: np.ndarray | None,
    first: int,
    unit: str,
    label: str,
    families: Mapping[str, str],
) -> Drawing:
    """Draw ENU errors of an estimator and of the INS in one run, in two columns.

    The left column shows both errors. The right column shows the errors of the estimator and the
    reported ±3σ.

    ``times`` (K,) are in seconds. ``aided`` (K, ...) belongs to the estimator. The first six
    columns of ``aided`` and of ``ins`` (K, ...) are position and velocity errors. The next six
    columns of ``aided`` are standard deviations, or NaN. If ``ins`` is None, it is not drawn.

    ``first`` is the first of the three error columns to draw (0: position, 3: velocity).
    ``unit`` is the unit of the errors, and ``label`` is the label of the estimator. ``families``
    has the family of each estimator.
    """
    bounded = bool(np.isfinite(aided[:, 6:12]).any())
    colour = line_styles(families)[label].color
    figure, axes = subplots(3, 2, figsize=(8.0, 6.0), sharex=True)
    for axis in range(3):
        error, sigma = aided[:, first + axis], aided[:, 6 + first + axis]
        left, right = axes[axis]
        if ins is not None:
            left.plot(times, ins[:, first + axis], color=INS, lw=1.5, label="INS")
        left.plot(times, error, color=colour, lw=1.2, label=label)
        left.set_ylabel(f"{AXES[axis]} [{unit}]")
        if bounded:
            right.fill_between(times, -3 * sigma, 3 * sigma, color=colour, alpha=0.15, label="±3σ")
        right.plot(times, error, color=colour, lw=1.2, label=label)
        limit = 1.05 * np.percentile(np.fmax(3 * sigma, np.abs(error)), 98)
        if limit > 0.0:
            right.set_ylim(-limit, limit)
    aided_title = "aided, with ±3σ" if bounded else "aided, without covariance"
    for axis, title in zip(axes[0], ("INS and aided", aided_title), strict=True):
        axis.set_title(title)
        axis.legend()
    for axis in axes[-1]:
        axis.set_xlabel("time [s]")
    return figure


@styled()
def with_deviations(times: np.ndarray, components: np.ndarray, sigmas: np.ndarray) -> Drawing:
    """Draw position and velocity errors over time with the reported ±3σ.

    ``times`` (K,) are in seconds. ``components`` and ``sigmas`` (K, 6) are errors and their
    standard deviations, ENU [m, m/s]; without covariances ``sigmas`` is NaN.
    """
    figure, axes = subplots(3, 2, figsize=(8.0, 6.0), sharex=True)
    for column in range(6):
        axis = axes[column % 3, column // 3]
        sigma = sigmas[:, column]
        axis.fill_between(times, -3 * sigma, 3 * sigma, alpha=0.2, label="±3σ")
        axis.plot(times, components[:, column], lw=1.2, label="error")
        axis.set_ylabel(f"{AXES[column % 3]} [{('m', 'm/s')[column // 3]}]")
    axes[0, 0].set_title("position")
    axes[0, 1].set_title("velocity")
    axes[0, 0].legend()
    for axis in axes[-1]:
        axis.set_xlabel("time [s]")
    return figure
