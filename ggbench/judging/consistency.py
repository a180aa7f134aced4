"""Consistency of reported covariances, judged by tests over many runs.

Every mark needs evidence: of consistent estimators at most 2.5 % get one, whatever the number of
runs, also where their errors have heavy tails. A single run decides nothing.
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
"""Probability of χ² beyond which a run is lost if it ends outside the required error."""
BEYOND = float(chdtri(JUDGED, FARTHEST))
"""NEES that a consistent estimate exceeds with that probability; a run counts with no more."""
LARGE_SHARE = 0.20
_LARGE = float(chdtri(JUDGED, LARGE_SHARE))
_STRICT = 0.02
"""Twice the level at which a mean is surely too large: with the band, marks stay below 2.5 %."""
MISFIT = 1.10
"""Ratio of the mean NIS to the end of its band from which R does not fit."""
UNFIT = "R does not fit"


def trimmed(values: np.ndarray, dimension: float = JUDGED) -> np.ndarray:
    """Return the NEES or NIS of runs (R,), each of them at most the 99.9 % quantile of χ².

    Trimming lowers the mean of a consistent estimator (Jensen), so that no test of a large mean
    loses its false-alarm rate by it.
    """
    return np.asarray(np.minimum(values, chdtri(dimension, FARTHEST)))


def consistency(
    nees: np.ndarray, coverage: np.ndarray, cluster: np.ndarray, false_share_p: float
) -> str:
    """Return whether an estimator's covariances are right.

    - "unsafe": surely more than 5 % of the runs end in a false fix;
    - "overconfident": the trimmed mean NEES lies above its 95 % band and surely above 6, or the
      coverage of the 95 % region is surely below 90 %;
    - "conservative": the mean NEES lies below its band and surely below 6, and surely fewer runs
      than the 20 % of χ² exceed its 80 % quantile;
    - "consistent" otherwise; "" without covariances.

    "Surely" is at 2.5 % by the exact binomial test, and by Student's t over clusters at 2.5 %, or
    at 1 % above 6.

    Parameters
    ----------
    nees : (R,) mean NEES of each finished run in a window.
    coverage : (R,) share of its epochs with the truth inside the 95 % region.
    cluster : (R,) number of the track or map error that runs share.
    false_share_p : p-value of "at most 5 % of the runs end in a false fix".
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
    """Return the p-value of "at most 5 % of the runs end in a false fix" (binomial, exact)."""
    return share_above(false_fix, cluster, MOST_FALSE)


def noise_fit(
    nis: np.ndarray, channels: float, band: tuple[float, float], cluster: np.ndarray
) -> str:
    """Return :data:`UNFIT` where the mean NIS is out of its band by more than 10 %, else "".

    Out of the band by the means of runs as well, whose innovations may have heavy tails: ten runs
    are needed.

    Parameters
    ----------
    nis : (R,) mean NIS of each run that has one.
    channels : mean number of channels of a measurement.
    band : 95 % band of the mean NIS.
    cluster : (R,) number of the track or map error that runs share.
    """
    if len(np.unique(cluster)) < FEWEST_CLUSTERS or channels == 0.0:
        return ""
    large = _above(nis, channels, MISFIT * band[1], cluster)
    return UNFIT if large or _below(nis, channels, band[0] / MISFIT, cluster) else ""


def _above(values: np.ndarray, dimension: float, limit: float, cluster: np.ndarray) -> bool:
    """Return whether a trimmed mean lies above a limit, and surely above the dimension."""
    mean, low, _ = mean_interval(trimmed(values, dimension), cluster, _STRICT)
    return mean > limit and low > dimension


def _below(values: np.ndarray, dimension: float, limit: float, cluster: np.ndarray) -> bool:
    """Return whether a mean lies below a limit, and surely below the dimension."""
    mean, _, high = mean_interval(values, cluster)
    return mean < limit and high < dimension
