"""Convergence of the position: whether and when, and false fixes.

With a wide prior an estimator converges to the true place in the field or to a wrong one, and the
mean error of both says little. With ``windows.lock_m`` every run is judged by :func:`judge`, and
:func:`figures` counts over runs. Columns and keys of records say ``lock`` for convergence and
``false_lock`` for a false fix at the end of a run.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from scipy.special import bdtr, ndtri

from .statistics import ALPHA, binomial_quantile

if TYPE_CHECKING:
    import pandas as pd

CLAIM = float(ndtri(0.975))
"""Standard deviations of a claimed 95 % radius, see :func:`claimed_radius`."""
COLUMNS = (
    "lock_share", "lock_lo", "lock_hi", "false_lock_share", "false_lock_lo", "false_lock_hi",
    "lock_time_median_s", "lock_time_lo", "lock_time_hi",
)  # fmt: skip
"""Columns of a summary, NaN where convergence is not judged."""


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
    position_error: np.ndarray, sigmas: np.ndarray, times: np.ndarray, lock_m: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return when each run converged, and whether it ends in a false fix.

    Parameters
    ----------
    position_error : (R, K) spherical position errors [m].
    sigmas : (R, 3) claimed standard deviations of the position at the last epoch [m]; NaN without
        a covariance, which claims nothing.
    times : (K,) epochs [s].
    lock_m : the error below which the position is found [m].

    Returns
    -------
    Convergence times [s] (R,): the first epoch from which the error stays below ``lock_m`` to the
    end of the flight, NaN if there is none. False fixes (R,): at the last epoch the error is not
    below ``lock_m``, but the claimed radius (:func:`claimed_radius`) is.
    """
    below = position_error < lock_m
    lasting = np.logical_and.accumulate(below[:, ::-1], axis=1).sum(axis=1)
    locked = lasting > 0
    found = np.where(locked, times[np.minimum(len(times) - lasting, len(times) - 1)], math.nan)
    return found, (claimed_radius(sigmas) < lock_m) & ~locked


def wilson(hits: int, runs: int) -> tuple[float, float, float]:
    """Return a share and its 95 % interval (Wilson 1927); NaN without runs."""
    return wilson_of(hits / runs, runs) if runs else (math.nan, math.nan, math.nan)


def wilson_of(share: float, runs: int) -> tuple[float, float, float]:
    """Return a share of so many runs and its 95 % interval (Wilson 1927)."""
    z2 = CLAIM**2
    centre = (share + z2 / (2.0 * runs)) / (1.0 + z2 / runs)
    half = math.sqrt(z2 * (share * (1.0 - share) / runs + z2 / (4.0 * runs**2))) / (1.0 + z2 / runs)
    # At none and all of the runs rounding would leave an end beside its share.
    low = 0.0 if share == 0.0 else centre - half
    high = 1.0 if share == 1.0 else centre + half
    return share, low, high


def median_interval(values: Sequence[float] | np.ndarray) -> tuple[float, float, float]:
    """Return a median and its 95 % interval between two order statistics.

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


def figures(lock_times: np.ndarray, false_locks: int, runs: int) -> dict[str, float]:
    """Return the figures of :data:`COLUMNS` over the runs of an estimator on a case.

    Shares are of all runs: a run that failed has neither converged nor ended in a false fix. The
    median time is of the runs that converged.

    Parameters
    ----------
    lock_times : (m,) convergence times [s] of finished runs, NaN of those that did not converge.
    false_locks : number of runs that end in a false fix.
    runs : number of all runs.
    """
    times = lock_times[~np.isnan(lock_times)]
    found = (*wilson(len(times), runs), *wilson(false_locks, runs), *median_interval(times))
    return dict(zip(COLUMNS, found, strict=True))


def table(summary: pd.DataFrame) -> pd.DataFrame:
    """Return the rows of a summary with convergence judged: one per case and estimator."""
    rows = summary[(summary["window"] == "settled") & summary["lock_share"].notna()]
    return rows[["case", "label", "causality", "runs", *COLUMNS]].reset_index(drop=True)


def share_by_time(lock_times: np.ndarray, runs: int, times: np.ndarray) -> np.ndarray:
    """Return the share of runs (K,) that had converged by each of the times.

    Parameters
    ----------
    lock_times : (m,) convergence times [s], NaN of runs that did not converge.
    runs : number of all runs.
    times : (K,) increasing [s].
    """
    found = np.sort(lock_times[np.isfinite(lock_times)])
    return np.asarray(np.searchsorted(found, times + 1e-9, side="right") / max(runs, 1))
