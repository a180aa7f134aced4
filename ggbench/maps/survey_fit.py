"""Cross-validation of maps of survey lines: best settings, residuals of held-back lines.

In each of five folds every fifth line is held back from the fit. With fewer than five lines, there
is one fold for each line. Whole lines are held back, because neighbouring samples have correlated
noise. Tie lines are never held back, because they cross the other lines and level them.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..gravity.gradient_map import MapError
from .equivalent_sources import (
    Equations,
    EquivalentSources,
    Plane,
    Settings,
    metres_along,
    residuals,
)
from .survey_lines import TIE, SurveyLines

Array = NDArray[np.float64]

FOLDS = 5
_DEPTHS = (1.6, 2.2, 3.0)  # distances between lines
_SPACING = 0.6  # of the depth
_USUAL_SOURCES = 3500  # at most, unless the user sets a spacing: a minute or two for each depth
_NARROWEST_M = 10.0  # distance between lines
_DAMPINGS = (0.03, 0.1, 0.3, 1.0)


@dataclass(frozen=True)
class FitOptions:
    """Fixed settings of a fit; None: not fixed.

    Attributes
    ----------
    depth_m : depth of the masses below the flights [m]; None: chosen by cross-validation.
    spacing_m : distance between the masses [m]; None: 0.6 of the depth, or more if this gives too
        many masses.
    damping : relative damping; None: chosen by cross-validation.
    """

    depth_m: float | None = None
    spacing_m: float | None = None
    damping: float | None = None


@dataclass(frozen=True)
class SurveyFit:
    """Point masses of survey lines, with the residuals of held-back lines.

    Attributes
    ----------
    lines : lines of the survey.
    settings : settings of the fit to all lines.
    sources : point masses of the fit to all lines.
    held_back : residuals (N, components) of each line except ties, by index of the line. Residuals
        are measurements minus a map. The map is a fit without this line. The mean residual of each
        component over the line is subtracted.
    scores : RMS residual of held-back lines, for each tested setting.
    """

    lines: SurveyLines
    settings: Settings
    sources: EquivalentSources
    held_back: dict[int, Array]
    scores: dict[Settings, float]

    @cached_property
    def fitted(self) -> dict[int, Array]:
        """Residuals (N, components) of each line in ``held_back``, from the fit to all lines."""
        return {index: residuals(self.sources, self.lines, index) for index in self.held_back}

    @cached_property
    def rms(self) -> tuple[Array, Array]:
        """RMS of the residuals, and RMS of the measurements, of held-back lines.

        Both have the shape (components,). The mean of the measurements over each line is
        subtracted first.
        """
        readings = [self.lines.values[self.lines.samples(index)] for index in self.held_back]
        differences = np.concatenate(list(self.held_back.values()))
        read = np.concatenate([rows - rows.mean(axis=0) for rows in readings])
        return np.sqrt(np.mean(differences**2, axis=0)), np.sqrt(np.mean(read**2, axis=0))


def fit(
    lines: SurveyLines, options: FitOptions, progress: Callable[[str], None] = lambda _: None
) -> SurveyFit:
    """Return a fit to all lines, with the settings that predict held-back lines best.

    ``progress`` is called with a message for each tested setting.

    Raises MapError if fewer than two lines can be held back.
    """
    folds = _folds(lines)
    ties = [index for index, kind in enumerate(lines.kinds) if kind == TIE]
    best: SurveyFit | None = None
    scores: dict[Settings, float] = {}
    depths, dampings = _candidates(lines, options)
    for depth, spacing in depths:
        equations = Equations(lines, depth, spacing)
        parts = [equations.of(fold) for fold in folds]
        matrix, right = (sum(both) for both in zip(*parts, equations.of(ties), strict=True))
        for damping in dampings:
            settings = Settings(depth, spacing, damping)
            held_back: dict[int, Array] = {}
            for fold, part in zip(folds, parts, strict=True):
                sources = equations.solved(matrix - part[0], right - part[1], damping)
                held_back |= {index: residuals(sources, lines, index) for index in fold}
            rows = np.concatenate(list(held_back.values()))
            scores[settings] = float(np.sqrt(np.mean(rows**2)))
            progress(f"{settings}: {scores[settings]:.3f} {lines.unit} on held-back lines")
            if best is None or scores[settings] < scores[best.settings]:
                sources = equations.solved(matrix, right, damping)
                best = SurveyFit(lines, settings, sources, held_back, scores)
    assert best is not None
    return best


def _folds(lines: SurveyLines) -> list[list[int]]:
    """Return the indices of the held-back lines of each fold: every fifth line except ties.

    Raises MapError if fewer than two lines are not tie lines.
    """
    others = [i for i, kind in enumerate(lines.kinds) if kind != TIE]
    if len(others) < 2:
        raise MapError(
            f"lines other than tie lines: {len(others)}; at least 2 are needed: "
            "they are held back in turn to choose the settings and to estimate the standard error."
        )
    return [others[first::FOLDS] for first in range(min(FOLDS, len(others)))]


def _candidates(
    lines: SurveyLines, options: FitOptions
) -> tuple[list[tuple[float, float]], tuple[float, ...]]:
    """Return the pairs of depth and spacing [m], and the relative dampings, to test."""
    east, north, _ = Plane.under(lines).metres(lines)
    area = float(np.ptp(east) * np.ptp(north))
    depths = [options.depth_m] if options.depth_m else _depths(lines, area)
    narrowest = math.sqrt(area / _USUAL_SOURCES)
    pairs = [(d, options.spacing_m or round(max(_SPACING * d, narrowest), -1)) for d in depths]
    return pairs, (options.damping,) if options.damping else _DAMPINGS


def _depths(lines: SurveyLines, area: float) -> list[float]:
    """Return the depths to test [m], multiples of the distance between lines.

    The distance between lines is the area [m²] divided by the total length of the lines.
    """
    length = sum(
        float(metres_along(lines, index)[-1])
        for index, kind in enumerate(lines.kinds)
        if kind != TIE
    )
    distance = area / max(length, 1.0)
    if distance < _NARROWEST_M:
        raise MapError(
            "the lines cover no area, so the depth of the point masses cannot be derived from the "
            "line spacing: give --depth and --source-spacing."
        )
    return [round(factor * distance, -1) for factor in _DEPTHS]
