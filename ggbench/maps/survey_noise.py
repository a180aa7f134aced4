"""Coloured noise of a survey: vector autoregression of the residuals of held-back lines.

The residuals n_k of held-back lines contain measurement noise and map error. The model n_k = Σ A_i
n_{k−i} + e_k, e_k ~ N(0, C), is fitted by least squares to all lines together (Lütkepohl 2005,
section 3.2). The chosen order maximises the likelihood of lines that are excluded from this fit.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve

from ..gravity.coloured_noise import VectorAutoregression
from ..gravity.gradient_map import MapError
from .survey_fit import FOLDS, SurveyFit

Array = NDArray[np.float64]

ORDERS = (1, 2, 3, 4, 5, 6, 8, 10, 12, 15, 20)
_DECIMALS = 7  # of what is stored; a file is the same on all machines
_SAMPLES_PER_COEFFICIENT = 10  # fewer leave an order untried
_GAP = 1.5  # intervals: a longer one ends a series


def innovations(model: VectorAutoregression, series: Array) -> Array:
    """Return the innovations e_k (n − p, m) of a series (n, m), from sample p on.

    p is the order of the model, n the number of samples, and m the number of components.
    """
    lagged = _lagged(series, model.order)
    white: Array = series[model.order :] - lagged @ np.concatenate(
        [a.T for a in model.coefficients]
    )
    return white


def autoregression(
    series: Sequence[Array], order: int, components: Sequence[str], interval: float = 1.0
) -> VectorAutoregression:
    """Return the least-squares autoregression of a given order for several series (n, m).

    n is the number of samples of a series, and m the number of components.

    Raises ColouredNoiseError if the autoregression is not stationary or there are too few samples.
    """
    usable = [rows for rows in series if len(rows) > order]
    lagged = np.concatenate([_lagged(rows, order) for rows in usable])
    targets = np.concatenate([rows[order:] for rows in usable])
    solution = solve(lagged.T @ lagged, lagged.T @ targets, assume_a="pos")
    white = targets - lagged @ solution
    count = targets.shape[1]
    return VectorAutoregression(
        tuple(components),
        interval,
        np.array([block.T for block in np.split(solution, order)]).round(_DECIMALS),
        (white.T @ white / (len(white) - order * count)).round(_DECIMALS),
    )


def noise_of(fit: SurveyFit) -> tuple[VectorAutoregression, dict[int, float]]:
    """Return the noise model of held-back lines, and the score of each tested order.

    The score is the mean log-likelihood per sample of lines that are excluded from the fit.

    Raises MapError if samples are too few or irregular in time, or if the noise is not stationary.
    """
    interval = _interval(fit)
    series = {index: _series(fit, index, interval) for index in fit.held_back}
    folds = [list(series)[first::FOLDS] for first in range(min(FOLDS, len(series)))]
    longest = max(ORDERS)
    names, count = fit.lines.components, len(fit.lines.components)
    samples = sum(len(rows) for white in series.values() for rows in white)
    scores = {}
    for order in ORDERS:
        if samples < _SAMPLES_PER_COEFFICIENT * order * count**2:
            continue
        total, number = 0.0, 0
        for fold in folds:
            others = [rows for i in series if i not in fold for rows in series[i]]
            model = autoregression(others, order, names, interval)
            pieces = [r for i in fold for r in series[i] if len(r) > longest]
            white = np.concatenate([innovations(model, r)[longest - order :] for r in pieces])
            total += _log_likelihood(model, white)
            number += len(white)
        scores[order] = total / number
    if not scores:
        raise MapError(f"{samples} samples are too few for a noise model.")
    best = max(scores, key=lambda order: scores[order])
    rows = [r for white in series.values() for r in white]
    return autoregression(rows, best, names, interval), scores


def _interval(fit: SurveyFit) -> float:
    """Return the sampling interval, rounded to a millisecond [s].

    Raises MapError if times are missing or irregular.
    """
    steps = np.concatenate([np.diff(fit.lines.time_s[fit.lines.samples(i)]) for i in fit.held_back])
    if np.isnan(steps).any():
        raise MapError("a noise model needs time_s, which the file of lines lacks.")
    interval = round(float(np.median(steps)), 3)
    if not interval > 0.0 or np.mean(np.abs(steps - interval) > 0.1 * interval) > 0.1:
        raise MapError(
            f"the samples must be regular in time; their median interval is {interval:g} s."
        )
    return interval


def _series(fit: SurveyFit, index: int, interval: float) -> list[Array]:
    """Return the residuals of the line ``index``, as pieces without missing samples."""
    steps = np.diff(fit.lines.time_s[fit.lines.samples(index)])
    return np.split(fit.held_back[index], np.flatnonzero(np.abs(steps) > _GAP * interval) + 1)


def _lagged(series: Array, order: int) -> Array:
    """Return the p previous samples (n − p, p m) of each sample from p on, the latest first."""
    return np.hstack([series[order - lag : len(series) - lag] for lag in range(1, order + 1)])


def _log_likelihood(model: VectorAutoregression, errors: Array) -> float:
    """Return the log-likelihood (natural logarithm) of innovations ``errors`` (n, m)."""
    _, log_det = np.linalg.slogdet(2.0 * np.pi * model.innovation_cov)
    squared = np.einsum("ni,ni->", errors, np.linalg.solve(model.innovation_cov, errors.T).T)
    return float(-0.5 * (len(errors) * log_det + squared))
