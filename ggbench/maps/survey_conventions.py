"""Search for the axis convention of the gradients of survey lines."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from .equivalent_sources import Plane
from .survey_fit import FitOptions, SurveyFit, fit
from .survey_lines import AXES, CONVENTIONS, SurveyLines, Turn, axes_in_words, turned

_MOST_SOURCES = 600
"""Largest number of point masses for the comparison of conventions, which then takes seconds."""
_BETTER = 0.5
"""Largest ratio of the residual of a convention to that of the stated axes, for a remark."""
_FITS = 0.7
"""Largest ratio of residual to measurement, both RMS, of a convention that fits."""
_DIRECTIONS = ("east", "north", "up", "west", "south", "down")


def convention_in_words(survey_fit: SurveyFit, axes: str) -> str:
    """Return a text with the axes that fit the lines much better than the stated axes.

    The text is empty if no axes do so, or if the lines contain no gradients. Eight conventions of
    axes are compared. In each, maps of some lines are fitted and compared with the other lines.

    Parameters
    ----------
    survey_fit : fit of the lines in the stated axes.
    axes : axes of the file as stated by the user, a key of :data:`.survey_lines.AXES`.
    """
    lines = survey_fit.lines
    if lines.quantity != "gradient":
        return ""
    options = _coarse(survey_fit)
    scores = []
    for turn in CONVENTIONS:
        if (other := _turned(lines, turn)) is not None:
            refitted = fit(other, options)
            residual, read = (float(np.sqrt(np.mean(rms**2))) for rms in refitted.rms)
            scores.append((residual / read, turn))
    own = next(score for score, turn in scores if turn is CONVENTIONS[0])
    best, turn = min(scores, key=lambda each: each[0])
    if best > _FITS or best > _BETTER * own:
        return ""
    whole = {axis: _after(step, turn) for axis, step in AXES[axes].items()}
    named = next((name for name, turn_known in AXES.items() if _same(turn_known, whole)), "")
    words = f"--axes {named}" if named else f"axes {axes_in_words(whole, _DIRECTIONS)}"
    return (
        f"held-back lines fit best with {words}: the RMS residual is {best:.2f} times the RMS "
        f"measurement, instead of {own:.2f} times"
    )


def _coarse(survey_fit: SurveyFit) -> FitOptions:
    """Return the settings of the fit with a spacing for few point masses."""
    east, north, _ = Plane.under(survey_fit.lines).metres(survey_fit.lines)
    widest = math.sqrt(float(np.ptp(east) * np.ptp(north)) / _MOST_SOURCES)
    depth, spacing, damping = survey_fit.settings
    return FitOptions(depth, max(spacing, widest), damping)


def _turned(lines: SurveyLines, turn: Turn) -> SurveyLines | None:
    """Return lines with components in other axes; None if two components become the same."""
    pairs = [turned(name, turn) for name in lines.components]
    names = tuple(name for name, _ in pairs)
    if len(set(names)) < len(names):
        return None
    values = lines.values * [sign for _, sign in pairs]
    return dataclasses.replace(lines, components=names, values=values)


def _after(step: tuple[str, int], turn: Turn) -> tuple[str, int]:
    axis, sign = step
    other, further = turn[axis]
    return other, sign * further


def _same(one: Turn, other: Turn) -> bool:
    """Return whether two turns give the same tensor: same axes, signs equal or all opposite."""
    signs = {one[axis][1] * other[axis][1] for axis in one}
    return all(one[axis][0] == other[axis][0] for axis in one) and len(signs) == 1
