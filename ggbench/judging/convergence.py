"""Convergence of the position: time, share of runs, false fixes.

With a wide prior an estimator converges to the true place in the field or to a wrong one, and the
mean error of both says little. :func:`judge` judges every run by the required error
(``windows.required_m``).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.special import bdtr, ndtri

from .statistics import ALPHA, binomial_quantile

CLAIM = float(ndtri(0.975))
"""Standard deviations of a claimed 95 % radius, see :func:`claimed_radius`."""


def claimed_radius(sigmas: np.ndarray) -> np.ndarray:
    """Return the radius [m] (K,) within which an estimator claims to be with 95 % or more.

    1.96 √tr P of the claimed covariance P of the position. Whatever P's shape, at least 95 % of
    N(0, P) lie within it: of all Gaussian vectors of one trace the one along a single line has
    the most probability outside (Székely & Bakirov 2003). A sphere's own 95 % radius is 1.61 √tr P.

    Parameters
    ----------
    sigmas : (K, 3) claimed standard deviations of the position [m]; NaN without a covariance.
    """
    return np.asarray(CLAIM * np.sqrt(np.sum(sigmas**2, axis=1)))


def judge(
    position_error: np.ndarray, sigmas: np.ndarray, times: np.ndarray, required_m: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return when each run converged, and whether it ends in a false fix.

    Parameters
    ----------
    position_error : (R, K) spherical position errors [m].
    sigmas : (R, 3) claimed standard deviations of the position at the last epoch [m]; NaN without
        a covariance, which claims nothing.
    times : (K,) epochs [s].
    required_m : the error within which the position is found [m].

    Returns
    -------
    Convergence times [s] (R,): the first epoch from which the error stays within ``required_m`` to
    the end of the flight, NaN if there is none. False fixes (R,): at the last epoch the error is
    not within ``required_m``, but the claimed radius (:func:`claimed_radius`) is.
    """
    within = position_error <= required_m
    lasting = np.logical_and.accumulate(within[:, ::-1], axis=1).sum(axis=1)
    converged = lasting > 0
    converged_s = np.where(
        converged, times[np.minimum(len(times) - lasting, len(times) - 1)], math.nan
    )
    return converged_s, (claimed_radius(sigmas) <= required_m) & ~converged


def median_interval(values: Sequence[float] | np.ndarray) -> tuple[float, float, float]:
    """Return the median of values (N,) and its 95 % interval between two order statistics.

    The interval needs no law of the values and holds the median with 95 % or more (binomial); with
    fewer than six values there is none, and its ends are NaN.
    """
    ordered = np.sort(np.asarray(values, dtype=float))
    count = len(ordered)
    if count == 0:
        return math.nan, math.nan, math.nan
    # The largest r with P(at most r of the values lie below the median) ≤ 2.5 %.
    below = binomial_quantile(ALPHA / 2.0, count, 0.5)
    rank = below if bdtr(below, count, 0.5) <= ALPHA / 2.0 else below - 1
    median = float(np.median(ordered))
    if rank < 0:
        return median, math.nan, math.nan
    return median, float(ordered[rank]), float(ordered[count - 1 - rank])
