"""Correlation length of the gravity gradient along a track."""

from __future__ import annotations

import math

import numpy as np

from ..gravity.ellipsoid import metres_along

LINEAR, AMBIGUOUS = 0.2, 0.8
"""Widths of a prior in correlation lengths, see reports/nonlinearity.md."""


def correlation_m(positions: np.ndarray, vertical: np.ndarray) -> float:
    """Return the correlation length ℓ [m] of the vertical gradient along a track.

    ℓ is the lag at which the autocorrelation of the vertical gradient, after subtraction of the
    mean, first falls to 1/e (:func:`correlation_length`). ℓ is NaN for fewer than three samples, a
    constant field, or a track without motion.

    Parameters
    ----------
    positions : (K, 3) latitude, longitude [rad], height [m] of the samples.
    vertical : (K,) Γ_UU at the samples [E].
    """
    if len(vertical) < 3 or np.ptp(vertical) == 0.0:  # less its mean it may be rounding
        return math.nan
    steps = np.diff(positions[:, [1, 0]], axis=0) * metres_along(positions[:-1])
    step = float(np.hypot(*steps.T).mean())
    length = correlation_length((vertical - vertical.mean())[np.newaxis], step)
    return length if length > 0.0 else math.nan


def on_the_prior(position_m: float, correlation_m: float) -> str:
    """Return a sentence that compares the prior's width with the field's correlation length.

    Parameters
    ----------
    position_m : standard deviation of the initial position per axis [m].
    correlation_m : correlation length of the field along the track [m].
    """
    width = position_m / correlation_m
    if width < LINEAR:
        consequence = "the field is nearly linear within it, and an EKF is efficient"
    elif width < AMBIGUOUS:
        consequence = "a filter that linearises once can converge to a wrong position"
    else:
        consequence = (
            "several positions fit the first measurements: use a filter bank, a search or particles"
        )
    return (
        f"the initial uncertainty is {width:.2g} correlation lengths of the field "
        f"({1e-3 * correlation_m:.3g} km): {consequence}"
    )


def correlation_length(g: np.ndarray, step_m: float) -> float:
    """Return the lag [m] along the rows of ``g`` at which the autocorrelation first falls to 1/e.

    No mean is subtracted. The autocorrelation at a lag is the mean over all products at this lag
    (unbiased), interpolated linearly between lags. The result is the length of a row if the
    autocorrelation stays above 1/e, and NaN if all values are zero.

    Parameters
    ----------
    g : scalar values, (m, n) at the nodes of a grid or (1, n) along a track.
    step_m : distance between neighbours in a row [m].
    """
    n = g.shape[1]
    zero = float(np.mean(g**2))
    if zero == 0.0:
        return math.nan
    before = 1.0
    for lag in range(1, n):
        correlation = float(np.mean(g[:, lag:] * g[:, :-lag])) / zero
        if correlation <= math.exp(-1.0):
            return step_m * (lag - (math.exp(-1.0) - correlation) / (before - correlation))
        before = correlation
    return step_m * (n - 1)
