"""Convergence of the position: convergence times and false fixes.

With a wide prior an estimator converges to the true position or to a wrong position. A mean error
over both outcomes is not informative. :func:`judge` compares every run with the required error
(``windows.required_m``).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.special import bdtr, ndtri

from .statistics import ALPHA, binomial_quantile

CLAIM = float(ndtri(0.975))
"""Factor from √tr P to the reported 95 % radius, see :func:`claimed_radius`."""


def claimed_radius(sigmas: np.ndarray) -> np.ndarray:
    """Return the radius (K,) [m] of a sphere with at least 95 % reported probability.

    The radius is 1.96 √tr P, with the reported covariance P of the position. For any P the sphere
    contains at least 95 % of N(0, P). For a given trace of P the probability outside the sphere is
    largest if P has rank one (Székely & Bakirov 2003). For an isotropic P the 95 % radius would be
    1.61 √tr P.

    Parameters
    ----------
    sigmas : (K, 3) reported standard deviations of the position [m]; NaN without a covariance.
    """
    return np.asarray(CLAIM * np.sqrt(np.sum(sigmas**2, axis=1)))


def judge(
    position_error: np.ndarray, sigmas: np.ndarray, times: np.ndarray, required_m: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the convergence times of runs, and a mask of the runs that end in a false fix.

    Parameters
    ----------
    position_error : (R, K) 3-D position errors [m].
    sigmas : (R, 3) reported standard deviations of the position at the last epoch [m]; NaN without
        a covariance.
    times : (K,) epochs [s].
    required_m : required error [m].

    Returns
    -------
    Convergence times (R,) [s] and mask of false fixes (R,). The convergence time is the first epoch
    from which the error stays within ``required_m`` to the end of the flight. It is NaN if there is
    no such epoch. A run ends in a false fix if the error at the last epoch exceeds ``required_m``,
    but the reported radius (:func:`claimed_radius`) does not.
    """
    within = position_error <= required_m
    lasting = np.logical_and.accumulate(within[:, ::-1], axis=1).sum(axis=1)
    converged = lasting > 0
    converged_s = np.where(
        converged, times[np.minimum(len(times) - lasting, len(times) - 1)], math.nan
    )
    return converged_s, (claimed_radius(sigmas) <= required_m) & ~converged


def median_interval(values: Sequence[float] | np.ndarray) -> tuple[float, float, float]:
    """Return the median of values (N,), with a 95 % interval between two order statistics.

    The interval assumes no distribution and contains the median with a probability of at least 95 %
    (binomial). With fewer than six values the ends are NaN.
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
