"""Comparison of survey maps by navigation over held-back lines.

Each primary line is flown over a map that excludes the fold of the line. The model of the coloured
noise is fitted to the residuals of the other folds. The samples of the line are the measurements.
INS errors are drawn from their prior, and a batch smoother estimates them.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ggbench.gravity.coloured_noise import VectorAutoregression
from ggbench.maps.equivalent_sources import Equations, EquivalentSources, Settings, residuals
from ggbench.maps.survey_fit import FOLDS
from ggbench.maps.survey_lines import PRIMARY, TIE, SurveyLines
from ggbench.maps.survey_noise import autoregression, innovations

from .smoothing import GriddedMap, fly

Array = NDArray[np.float64]

_ORDER = 8  # order of the noise model
_MOST_SAMPLES = 299  # largest number in a flight, from the middle of its line


class Navigation(NamedTuple):
    """Results of navigation over one map per fold.

    Attributes
    ----------
    residual : RMS of measurement minus map on held-back lines [E].
    slope : regression coefficient of held-back measurements on the map, both whitened by the noise.
    rms : (lines, draws) RMS horizontal error of each flight [m].
    nees : (lines, draws) normalised estimation error squared (NEES) of the six INS errors.
    """

    residual: float
    slope: float
    rms: Array
    nees: Array

    def ratio(self, other: Navigation) -> tuple[float, float]:
        """Return the geometric mean of ``rms`` divided by ``other.rms``, and its standard error.

        Lines are independent, but draws on one line are not.
        """
        logarithm = np.mean(np.log(self.rms / other.rms), axis=1)
        mean = float(np.exp(logarithm.mean()))
        return mean, mean * float(logarithm.std(ddof=1)) / np.sqrt(len(logarithm))


def navigate(lines: SurveyLines, settings: Settings, draws: int = 2) -> Navigation:
    """Return the results of navigation over primary lines, with maps that exclude their fold.

    A fold contains every fifth primary line. ``draws`` is the number of draws of INS errors per
    line.
    """
    primary = [i for i, kind in enumerate(lines.kinds) if kind == PRIMARY]
    folds = [primary[first::FOLDS] for first in range(FOLDS)]
    maps = maps_without(lines, settings, folds)
    left = [
        [residuals(sources, lines, index) for index in fold]
        for sources, fold in zip(maps, folds, strict=True)
    ]
    noises = noise_without(left, lines.components)
    flown: list[list[tuple[float, float]]] = []
    for fold, sources, noise in zip(folds, maps, noises, strict=True):
        field, points = GriddedMap(sources, lines), sources.plane.metres(lines).T
        for index in fold:
            samples = lines.samples(index)
            first = max(0, len(samples) - _MOST_SAMPLES) // 2
            samples = samples[first : first + _MOST_SAMPLES]
            drawn = [np.random.default_rng([index, d]).standard_normal(6) for d in range(draws)]
            flown.append(
                [fly(field, noise, points[samples], lines.values[samples], d) for d in drawn]
            )
    rows = np.concatenate([rows for own in left for rows in own])
    rms, nees = np.moveaxis(np.array(flown), -1, 0)
    slope = _slope(lines, folds, maps, noises)
    return Navigation(float(np.sqrt(np.mean(rows**2))), slope, rms, nees)


def maps_without(
    lines: SurveyLines, settings: Settings, folds: Sequence[Sequence[int]]
) -> list[EquivalentSources]:
    """Return one map per fold, without the lines of the fold.

    Damping is relative to the matrix of all lines.
    """
    equations = Equations(lines, settings.depth_m, settings.spacing_m)
    parts = [equations.of(fold) for fold in folds]
    ties = [i for i, kind in enumerate(lines.kinds) if kind == TIE]
    matrix, right = (sum(both) for both in zip(*parts, equations.of(ties), strict=True))
    found = []
    for own_matrix, own_right in parts:
        others = matrix - own_matrix
        damping = settings.damping * np.trace(matrix) / np.trace(others)
        found.append(equations.solved(others, right - own_right, float(damping)))
    return found


def noise_without(
    left: Sequence[Sequence[Array]], components: Sequence[str]
) -> list[VectorAutoregression]:
    """Return one noise model per fold, without the residuals of the fold.

    ``left`` contains the residuals (n, m) of each line, by fold.
    """
    others = [[rows for other in left if other is not own for rows in other] for own in left]
    return [autoregression(series, _ORDER, components) for series in others]


def _slope(
    lines: SurveyLines,
    folds: Sequence[Sequence[int]],
    maps: Sequence[EquivalentSources],
    noises: Sequence[VectorAutoregression],
) -> float:
    """Return the regression coefficient of held-back measurements on the map, both whitened."""
    product = square = 0.0
    for fold, sources, noise in zip(folds, maps, noises, strict=True):
        for index in fold:
            samples = lines.samples(index)
            both = (sources.along(lines, samples), lines.values[samples])
            mapped, read = (innovations(noise, rows - rows.mean(axis=0)) for rows in both)
            weighted = np.linalg.solve(noise.innovation_cov, mapped.T).T
            product += float(np.sum(weighted * read))
            square += float(np.sum(weighted * mapped))
    return product / square


def print_table(lines: SurveyLines, tried: Sequence[Settings]) -> None:
    """Print one row per setting; RMS errors are compared with those of the first setting."""
    print("residual [E], slope, median RMS error [m], mean NEES (expected: 6), RMS error ratio")
    first = None
    for settings in tried:
        found = navigate(lines, settings)
        first = first or found
        ratio, error = found.ratio(first)
        print(
            f"{settings}: {found.residual:.2f} {found.slope:.2f} {np.median(found.rms):.0f} "
            f"{found.nees.mean():.1f} {ratio:.2f} ± {error:.2f}",
            flush=True,
        )
