"""Maps of a survey, compared by navigation over lines that they do not know.

Each primary line is flown over a map without its fold, with coloured noise fitted to the residuals
of the other folds. Its own readings are the measurements. INS errors are drawn from their initial
uncertainty, and a batch smoother finds them.
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

_ORDER = 8  # of the noise
_MOST_SAMPLES = 299  # of a flight, from the middle of its line


class Navigation(NamedTuple):
    """What navigation over one map per fold gave.

    Attributes
    ----------
    residual : RMS of reading minus map on lines held back [E].
    slope : coefficient of readings held back on the map, both whitened by the noise.
    rms : RMS horizontal error of each flight (lines, draws) [m].
    nees : normalised estimation error squared of each flight's six INS errors, (lines, draws).
    """

    residual: float
    slope: float
    rms: Array
    nees: Array

    def ratio(self, other: Navigation) -> tuple[float, float]:
        """Return the geometric mean of this RMS error by another's, and its standard error.

        Lines are independent; the draws on one line are not.
        """
        logarithm = np.mean(np.log(self.rms / other.rms), axis=1)
        mean = float(np.exp(logarithm.mean()))
        return mean, mean * float(logarithm.std(ddof=1)) / np.sqrt(len(logarithm))


def navigate(lines: SurveyLines, settings: Settings, draws: int = 2) -> Navigation:
    """Return how primary lines, every fifth one at a time, are flown over maps without them."""
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
    """Return the map without each fold. Damping is relative to the matrix of all lines."""
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
    """Return the noise without each fold, from residuals (n, m) of the lines of all folds."""
    others = [[rows for other in left if other is not own for rows in other] for own in left]
    return [autoregression(series, _ORDER, components) for series in others]


def _slope(
    lines: SurveyLines,
    folds: Sequence[Sequence[int]],
    maps: Sequence[EquivalentSources],
    noises: Sequence[VectorAutoregression],
) -> float:
    """The coefficient of readings held back on the map, both whitened by the noise."""
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
    """Print a row for each setting; RMS errors are compared with those of the first."""
    print("residual [E], slope, median RMS error [m], mean NEES of 6, RMS error by the first's")
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
