"""Coloured noise of a survey's readings: a vector autoregression of lines held back from the map.

The residuals of lines held back hold the noise of the readings and the error of the map there.
Their model is n_k = Σ A_i n_{k−i} + e_k, e ~ N(0, C), fitted by least squares to all lines at once
(Lütkepohl 2005, section 3.2). The order is that under which lines held back from this fit are
likeliest.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve

from ..files import written_whole
from ..gravity.gradient_map import MapError
from .survey_fit import FOLDS, SurveyFit

Array = NDArray[np.float64]

FORMAT = "ggbench coloured noise 1"
ORDERS = (1, 2, 3, 4, 5, 6, 8, 10, 12, 15, 20)
_SAMPLES_PER_COEFFICIENT = 10  # fewer leave an order untried
_GAP = 1.5  # intervals: a longer one ends a series


@dataclass(frozen=True)
class Autoregression:
    """A vector autoregression.

    Attributes
    ----------
    coefficients : A_1 ... A_p, (p, m, m).
    covariance : C, (m, m).
    """

    coefficients: Array
    covariance: Array

    @property
    def order(self) -> int:
        """The order p."""
        return len(self.coefficients)

    def innovations(self, series: Array) -> Array:
        """Return e_k of a series (n, m), from its sample p on, (n − p, m)."""
        lagged = _lagged(series, self.order)
        found: Array = series[self.order :] - lagged @ np.concatenate(
            [a.T for a in self.coefficients]
        )
        return found

    def largest_root(self) -> float:
        """Return the largest root's modulus; below 1 the noise is stationary."""
        order, count, _ = self.coefficients.shape
        matrix = np.eye(order * count, k=-count)
        matrix[:count] = np.hstack(list(self.coefficients))
        return float(np.abs(np.linalg.eigvals(matrix)).max())


def autoregression(series: Sequence[Array], order: int) -> Autoregression:
    """Return the autoregression of an order that fits some series (n, m) best.

    Raises
    ------
    MapError
        If it is not stationary, or there are too few samples.
    """
    usable = [rows for rows in series if len(rows) > order]
    lagged = np.concatenate([_lagged(rows, order) for rows in usable])
    targets = np.concatenate([rows[order:] for rows in usable])
    solution = solve(lagged.T @ lagged, lagged.T @ targets, assume_a="pos")
    left = targets - lagged @ solution
    count = targets.shape[1]
    model = Autoregression(
        np.array([block.T for block in np.split(solution, order)]),
        left.T @ left / (len(left) - order * count),
    )
    if not model.largest_root() < 1.0:
        raise MapError(
            f"the noise's autoregression of order {order} is not stationary: its largest root is "
            f"{model.largest_root():.4f}. Are the lines too short, or have they a trend?"
        )
    return model


def noise_of(fit: SurveyFit) -> tuple[Autoregression, float, dict[int, float]]:
    """Return the noise of lines held back, the interval [s], and a score of each order.

    The score is the mean log-likelihood of a sample of lines that the model was not fitted to.

    Raises
    ------
    MapError
        If the samples are too few, too irregular, or the noise is not stationary.
    """
    interval = _interval(fit)
    series = {index: _series(fit, index, interval) for index in fit.held_back}
    folds = [list(series)[first::FOLDS] for first in range(min(FOLDS, len(series)))]
    longest = max(ORDERS)
    count = fit.lines.values.shape[1]
    samples = sum(len(rows) for found in series.values() for rows in found)
    scores = {}
    for order in ORDERS:
        if samples < _SAMPLES_PER_COEFFICIENT * order * count**2:
            continue
        total, number = 0.0, 0
        for fold in folds:
            others = [rows for i in series if i not in fold for rows in series[i]]
            model = autoregression(others, order)
            held = [r for i in fold for r in series[i] if len(r) > longest]
            found = np.concatenate([model.innovations(r)[longest - order :] for r in held])
            total += _log_likelihood(model, found)
            number += len(found)
        scores[order] = total / number
    if not scores:
        raise MapError(f"{samples} samples are too few for a model of the noise.")
    best = max(scores, key=lambda order: scores[order])
    return autoregression([r for found in series.values() for r in found], best), interval, scores


def write_noise(
    path: Path, model: Autoregression, components: Sequence[str], interval_s: float, provenance: str
) -> None:
    """Write a model of noise as JSON. Raises MapError if it cannot be written."""
    content = {
        "format": FORMAT,
        "components": list(components),
        "interval_s": interval_s,
        "coefficients": model.coefficients.round(7).tolist(),
        "innovation_cov_eotvos2": model.covariance.round(7).tolist(),
        "provenance": provenance,
    }
    with written_whole(path, MapError, "the noise ") as temporary:
        temporary.write_text(json.dumps(content, indent=1, ensure_ascii=False) + "\n", "utf-8")


def _interval(fit: SurveyFit) -> float:
    """The interval of samples, to a millisecond."""
    steps = np.concatenate([np.diff(fit.lines.time_s[fit.lines.samples(i)]) for i in fit.held_back])
    interval = round(float(np.median(steps)), 3)
    if not interval > 0.0 or np.mean(np.abs(steps - interval) > 0.1 * interval) > 0.1:
        raise MapError(
            f"the samples must be regular in time; their median interval is {interval:g} s."
        )
    return interval


def _series(fit: SurveyFit, index: int, interval: float) -> list[Array]:
    """The residuals of a line, cut where samples are missing."""
    steps = np.diff(fit.lines.time_s[fit.lines.samples(index)])
    return np.split(fit.held_back[index], np.flatnonzero(np.abs(steps) > _GAP * interval) + 1)


def _lagged(series: Array, order: int) -> Array:
    """The samples before each from the order on, the nearest first, (n − p, p m)."""
    return np.hstack([series[order - lag : len(series) - lag] for lag in range(1, order + 1)])


def _log_likelihood(model: Autoregression, innovations: Array) -> float:
    """Of innovations, in nepers."""
    _, log_det = np.linalg.slogdet(2.0 * np.pi * model.covariance)
    squared = np.einsum("ni,ni->", innovations, np.linalg.solve(model.covariance, innovations.T).T)
    return float(-0.5 * (len(innovations) * log_det + squared))
