"""What gravity that the INS does not know does to it, and what of it can be known."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes

from .line_styles import line_styles
from .style import BOUND, Drawing, plain_numbers, styled, subplots

_ARCSECONDS = np.degrees(1.0) * 3600.0
_MGAL = 1e5
_PANELS = (
    ("position [m]", ("east", "north", "up"), 1.0),
    ("velocity [m/s]", ("east", "north", "up"), 1.0),
    ("attitude [″]", ("pitch", "roll", "heading"), _ARCSECONDS),
)
_DASHES = ("-", (0, (5, 2)), (0, (1, 1.5)), (0, (5, 1.5, 1, 1.5)))
_COLOURS = ("tab:blue", "tab:orange", "tab:green")


@styled()
def response(times: np.ndarray, errors: np.ndarray) -> Drawing:
    """Draw the errors (K, 9) of an INS that errs in nothing but the gravity, at times (K,) [s]."""
    figure, axes = subplots(3, 1, figsize=(7.0, 6.5), sharex=True)
    for part, (axis, (label, names, factor)) in enumerate(zip(axes, _PANELS, strict=True)):
        for i, name in enumerate(names):
            values = factor * errors[:, 3 * part + i]
            axis.plot(times / 3600.0, values, color=_COLOURS[i], lw=1.2, label=name)
        axis.set_ylabel(label)
        axis.legend(ncols=3)
    _in_hours(axes[-1])
    return figure


@styled()
def estimates(times: np.ndarray, true: np.ndarray, details: Mapping[str, np.ndarray]) -> Drawing:
    """Draw the gravity disturbance, true and as estimators find it in one run, with ±3σ.

    Parameters
    ----------
    times : (K,) [s].
    true : (K, 3) ENU [m/s²].
    details : (K, 18) of each estimator, see :meth:`.store.Store.detail`.
    """
    figure, axes = subplots(3, 1, figsize=(7.0, 6.5), sharex=True)
    shown = line_styles(list(details))
    for i, (axis, name) in enumerate(zip(axes, ("east", "north", "up"), strict=True)):
        axis.plot(times / 3600.0, _MGAL * true[:, i], color=BOUND, ls="--", lw=0.9, label="true")
        for label, detail in details.items():
            found = _MGAL * (true[:, i] - detail[:, 12 + i])
            sigma = 3.0 * _MGAL * detail[:, 15 + i]
            colour = shown[label].color
            axis.plot(times / 3600.0, found, color=colour, lw=1.2, label=label)
            axis.fill_between(
                times / 3600.0, found - sigma, found + sigma, color=colour, alpha=0.15, lw=0.0
            )
        # What the prior alone says, in the first minutes, is off the scale.
        settled = [_MGAL * detail[len(detail) // 10 :] for detail in details.values()]
        room = max(
            float(np.abs(some[:, 12 + i]).max() + 3.0 * some[:, 15 + i].max()) for some in settled
        )
        middle = _MGAL * true[:, i].mean()
        axis.set_ylim(middle - 1.05 * room, middle + 1.05 * room)
        axis.set_ylabel(f"{name} [mGal]")
    axes[0].legend(ncols=2)
    _in_hours(axes[-1])
    return figure


@styled()
def knowledge(times: np.ndarray, cases: Mapping[str, np.ndarray]) -> Drawing:
    """Draw how well the horizontal disturbance can be told, and how far from tilt, over time.

    Parameters
    ----------
    times : (K,) [s].
    cases : title of each case to (K, 8): the disturbance, the bound's σ of it [m/s²], correlations
        of its east part with the tilt about north and of its north part with that about east.
    """
    figure, axes = subplots(2, 2, figsize=(8.5, 5.5), sharex=True, sharey="row")
    for case, (title, values) in enumerate(cases.items()):
        # What hardly differs lies one on the other: dashes let both be seen.
        look = {"color": f"C{case}", "ls": _DASHES[case % len(_DASHES)], "lw": 1.4}
        for column, name in enumerate(("east", "north")):
            top, bottom = axes[0, column], axes[1, column]
            sigma, correlation = _MGAL * values[:, 3 + column], np.abs(values[:, 6 + column])
            top.semilogy(times / 3600.0, sigma, label=title, **look)
            bottom.plot(times / 3600.0, correlation, **look)
            top.set_title(name)
            plain_numbers(top)
    axes[0, 0].set_ylabel("bound of σ [mGal]")
    axes[1, 0].set_ylabel("|correlation| with tilt")
    lines = axes[0, 0].get_lines()
    figure.legend(lines, list(cases), loc="upper center", bbox_to_anchor=(0.5, 0.02), ncols=1)
    for axis in axes[1]:
        _in_hours(axis)
    return figure


def _in_hours(axis: Axes) -> None:
    axis.set_xlabel("time [h]")
