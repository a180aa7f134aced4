"""Tests of reported covariances for consistency over many runs.

The marks are † (overconfident) and ‡ (unsafe). At most 2.5 % of consistent estimators receive a
mark, for any number of runs, also with heavy-tailed errors. A single run gives no mark.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.special import chdtri

from .run_errors import JUDGED
from .statistics import ALPHA, FEWEST_CLUSTERS, mean_band, mean_interval, share_above, share_below

CONSISTENT, CONSERVATIVE, OVERCONFIDENT, UNSAFE = (
    "consistent",
    "conservative",
    "overconfident",
    "unsafe",
)
MARKS = {OVERCONFIDENT: "†", UNSAFE: "‡"}
"""Symbols of estimators that are not consistent."""
LEAST_COVERAGE, MOST_FALSE = 0.90, 0.05
"""Least coverage of a 95 % region; largest share of false fixes."""
FARTHEST = 0.001
"""Tail probability of χ² beyond :data:`BEYOND`."""
BEYOND = float(chdtri(JUDGED, FARTHEST))
"""NEES that a consistent estimate exceeds with probability :data:`FARTHEST`.

:func:`trimmed` limits the NEES to this value. A run with a larger NEES that ends outside the
required error is lost.
"""
LARGE_SHARE = 0.20
_LARGE = float(chdtri(JUDGED, LARGE_SHARE))
_STRICT = 0.02
"""Two-sided level of the test for a large mean NEES or NIS; keeps false marks below 2.5 %."""
MISFIT = 1.10
"""Ratio of the mean NIS to the end of its band beyond which R does not fit."""
UNFIT = "R does not fit"


def trimmed(values: np.ndarray, dimension: float = JUDGED) -> np.ndarray:
    """Limit the NEES or NIS of runs (R,) to the 99.9 % quantile of χ².

    ``dimension`` is the number of degrees of freedom of χ². The limit lowers the mean of a
    consistent estimator, so it does not increase the false-alarm rate of a test for large means.
    """
    return np.asarray(np.minimum(values, chdtri(dimension, FARTHEST)))


def consistency(
    nees: np.ndarray, coverage: np.ndarray, cluster: np.ndarray, false_share_p: float
) -> str:
    """Return the consistency of an estimator's covariances.

    - "unsafe": significantly more than 5 % of the runs end in a false fix;
    - "overconfident": the trimmed mean NEES lies above its 95 % band and significantly above 6, or
      the coverage of the 95 % region is significantly below 90 %;
    - "conservative": the mean NEES lies below its band and significantly below 6, and significantly
      less than 20 % of the runs exceed the 80 % quantile of χ²;
    - "consistent" otherwise; "" without covariances.

    The significance level is 1 % for "significantly above 6", and 2.5 % for all other tests. Shares
    are tested by the exact binomial test, means by Student's t-test over clusters.

    Parameters
    ----------
    nees : (R,) mean NEES of each finished run in a window. The NEES of position and velocity has
        the nominal value 6.
    coverage : (R,) share of the epochs of each run at which the truth is inside the 95 % region.
    cluster : (R,) index of the track or map error that runs share.
    false_share_p : p-value of the hypothesis "at most 5 % of the runs end in a false fix".
    """
    if len(nees) == 0 or math.isnan(nees.mean()):
        return ""
    if false_share_p < ALPHA / 2.0:
        return UNSAFE
    band = mean_band(len(np.unique(cluster)), JUDGED)
    covered = share_below(coverage, cluster, LEAST_COVERAGE)
    if _above(nees, JUDGED, band[1], cluster) or covered < ALPHA / 2.0:
        return OVERCONFIDENT
    few = share_below(nees > _LARGE, cluster, LARGE_SHARE) < ALPHA / 2.0
    return CONSERVATIVE if few and _below(nees, JUDGED, band[0], cluster) else CONSISTENT


def false_share_p(false_fix: np.ndarray, cluster: np.ndarray) -> float:
    """Return the p-value of the hypothesis "at most 5 % of the runs end in a false fix".

    The test is exact (binomial). ``false_fix`` (R,) is a mask; ``cluster`` (R,) is the index of the
    track or map error that runs share.
    """
    return share_above(false_fix, cluster, MOST_FALSE)


def noise_fit(
    nis: np.ndarray, channels: float, band: tuple[float, float], cluster: np.ndarray
) -> str:
    """Return :data:`UNFIT` if the mean NIS does not fit the assumed noise, else "".

    The noise does not fit if two conditions hold:

    - the mean NIS is above 1.1 times the upper end of ``band``, or below the lower end divided by
      1.1;
    - the mean NIS differs significantly from ``channels`` in Student's t-test over clusters.

    The second condition is needed because innovations may have heavy tails. With fewer than ten
    clusters the result is "".

    Parameters
    ----------
    nis : (R,) mean NIS of each run; NaN if not available.
    channels : mean number of channels of a measurement.
    band : 95 % band of the mean NIS.
    cluster : (R,) index of the track or map error that runs share.
    """
    if len(np.unique(cluster)) < FEWEST_CLUSTERS or channels == 0.0:
        return ""
    large = _above(nis, channels, MISFIT * band[1], cluster)
    return UNFIT if large or _below(nis, channels, band[0] / MISFIT, cluster) else ""


def _above(values: np.ndarray, dimension: float, limit: float, cluster: np.ndarray) -> bool:
    """Return whether a trimmed mean is above a limit and significantly above the dimension."""
    mean, low, _ = mean_interval(trimmed(values, dimension), cluster, _STRICT)
    return mean > limit and low > dimension


def _below(values: np.ndarray, dimension: float, limit: float, cluster: np.ndarray) -> bool:
    """Return whether a mean is below a limit and significantly below the dimension."""
    mean, _, high = mean_interval(values, cluster)
    return mean < limit and high < dimension
