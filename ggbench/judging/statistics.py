"""Statistics over runs: tests, consistency bands, intervals of shares and means.

The epochs of a run are strongly correlated. Therefore each run is one sample, or each cluster of
runs that share a track or a map error. Innovations are white: for the NIS each epoch is a sample.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache, partial

import numpy as np
from scipy.special import bdtr, bdtrc, chdtri, ndtri, stdtr, stdtrit

ALPHA = 0.05
"""False-alarm rate of every interval, band and verdict."""
FEWEST_CLUSTERS = 10
"""Least number of clusters for intervals of RMS errors and for the verdict on noise."""
BETTER, WORSE, EQUIVALENT, UNDECIDED = "better", "worse", "equivalent", "undecided"
EQUIVALENCE_RATIO = 1.05
"""Ratio of errors within which two estimators are equivalent."""
ROUNDING = 1e-9
"""Relative difference of errors below which two runs count as equal, because rounding differs
between machines.
"""


def cluster_means(values: np.ndarray, cluster: np.ndarray) -> np.ndarray:
    """Return the means (C,) of values (runs,) over the runs of each cluster."""
    _, where = np.unique(cluster, return_inverse=True)
    return np.asarray(np.bincount(where, weights=values) / np.bincount(where))


@dataclass(frozen=True)
class LogRatio:
    """Mean ratio of two estimators' errors in the same runs.

    Attributes
    ----------
    ratio, lo, hi : geometric mean of first / second, with a 95 % interval (Student's t).
    p : two-sided p-value of the hypothesis "the mean logarithm of the ratio is 0" (Student's t).
    p_equivalent : p-value of the hypothesis "the ratio lies outside 1/1.05 to 1.05"
        (:data:`EQUIVALENCE_RATIO`). It is the larger p-value of two one-sided tests
        (Schuirmann 1987).
    """

    ratio: float
    lo: float
    hi: float
    p: float
    p_equivalent: float


def log_ratio(first_ms: np.ndarray, second_ms: np.ndarray, cluster: np.ndarray) -> LogRatio:
    """Return the mean ratio of two estimators' errors in the same runs.

    Each cluster is one sample: the mean logarithm over the runs of the cluster. The tests need at
    least two clusters.

    Parameters
    ----------
    first_ms, second_ms : (runs,) mean squared errors [m²], above 0.
    cluster : (runs,) index of the track or map error that runs share.
    """
    logs = 0.5 * np.log(first_ms / second_ms)
    means = cluster_means(np.where(np.abs(logs) < ROUNDING, 0.0, logs), cluster)
    count = len(means)
    if count == 0:
        return LogRatio(math.nan, math.nan, math.nan, 1.0, 1.0)
    mean = float(means.mean())
    if count == 1:
        return LogRatio(math.exp(mean), math.nan, math.nan, 1.0, 1.0)
    error = float(means.std(ddof=1)) / math.sqrt(count)
    limit, freedom = math.log(EQUIVALENCE_RATIO), count - 1
    if error == 0.0:
        same = abs(mean) < limit
        return LogRatio(
            math.exp(mean), math.exp(mean), math.exp(mean), float(mean == 0.0), float(not same)
        )
    half = float(stdtrit(freedom, 1.0 - ALPHA / 2.0)) * error
    p = 2.0 * float(stdtr(freedom, -abs(mean) / error))
    p_equivalent = float(stdtr(freedom, (abs(mean) - limit) / error))
    with np.errstate(over="ignore"):
        low, high = float(np.exp(mean - half)), float(np.exp(mean + half))
    return LogRatio(math.exp(mean), low, high, p, p_equivalent)


def runs_to_decide(
    first_ms: np.ndarray, second_ms: np.ndarray, cluster: np.ndarray, tests: int
) -> float:
    """Return the number of runs that a verdict on a pair would need.

    With this number the test detects a difference or equivalence with a power of 80 % (normal
    approximation), if further runs have the same statistics. The result is ∞ if no number is
    sufficient, and NaN with fewer than two clusters.

    Parameters
    ----------
    first_ms, second_ms, cluster : (runs,) as in :func:`log_ratio`.
    tests : number of tests of the family; the level for a difference is 5 % / ``tests``
        (Bonferroni).
    """
    means = cluster_means(0.5 * np.log(first_ms / second_ms), cluster) if len(cluster) else cluster
    if len(means) < 2:
        return math.nan
    mean, spread = abs(float(means.mean())), float(means.std(ddof=1))
    power = float(ndtri(0.8))
    differ = float(ndtri(1.0 - ALPHA / (2.0 * tests))) + power
    needed = (differ * spread / mean) ** 2 if mean > 0.0 else math.inf
    room = math.log(EQUIVALENCE_RATIO) - mean
    if room > 0.0:
        needed = min(needed, ((float(ndtri(1.0 - ALPHA)) + power) * spread / room) ** 2)
    return needed * len(first_ms) / len(means)


def exact_p(one: int, other: int) -> float:
    """Return the two-sided p-value of the hypothesis that two outcomes are equally likely.

    ``one`` and ``other`` are the counts of the outcomes. The test is exact (binomial); it is
    McNemar's (1947) test of discordant pairs, and the sign test.
    """
    total = one + other
    return min(1.0, 2.0 * float(bdtr(min(one, other), total, 0.5))) if total else 1.0


def share_interval(hits: np.ndarray, cluster: np.ndarray) -> tuple[float, float, float]:
    """Return the share of runs that are hits, with a 95 % interval (Wilson 1927).

    If the shares of the clusters scatter more than those of independent runs would, the interval is
    computed with the effective number of independent runs. So many independent runs would give the
    share the same variance.

    Parameters
    ----------
    hits : (runs,) mask of the runs that count as hits.
    cluster : (runs,) index of the track or map error that runs share.
    """
    if len(hits) == 0:
        return math.nan, math.nan, math.nan
    count = _independent_runs(hits, cluster)
    return wilson(float(hits.mean()) * count, count)


def _independent_runs(hits: np.ndarray, cluster: np.ndarray) -> float:
    """Return the number of independent runs that give the share the same variance."""
    runs, share = len(hits), float(hits.mean())
    means = cluster_means(hits.astype(float), cluster)
    if not 1 < len(means) < runs:
        return float(runs)
    variance = float(means.var(ddof=1)) / len(means)
    worth = share * (1.0 - share) / variance if variance > 0.0 else float(len(means))
    return min(float(runs), max(worth, 1.0))


def share_above(hits: np.ndarray, cluster: np.ndarray, share: float) -> float:
    """Return the p-value of the hypothesis that at most a given share of runs are hits.

    The test is an exact binomial test with the effective number of independent runs, see
    :func:`share_interval`. Without runs the p-value is 1.

    Parameters
    ----------
    hits : (runs,) mask of the runs that count as hits, or a fraction for each run.
    cluster : (runs,) index of the track or map error that runs share.
    share : share of hits in the hypothesis.
    """
    if len(hits) == 0:
        return 1.0
    count = math.floor(_independent_runs(hits, cluster))
    least = math.floor(float(hits.mean()) * count + ROUNDING)
    return float(bdtrc(least - 1, count, share)) if least else 1.0


def share_below(hits: np.ndarray, cluster: np.ndarray, share: float) -> float:
    """Return the p-value of the hypothesis that at least a given share of runs are hits.

    The test and the arguments ``hits`` (runs,), ``cluster`` (runs,) and ``share`` are those of
    :func:`share_above`.
    """
    return share_above(1.0 - hits.astype(float), cluster, 1.0 - share)


def mean_interval(
    values: np.ndarray, cluster: np.ndarray, alpha: float = ALPHA
) -> tuple[float, float, float]:
    """Average values (runs,) over each cluster; return the mean of these averages and its interval.

    The interval (Student's t) has the confidence level 1 − ``alpha``. Its ends are NaN with a
    single cluster.
    """
    means = cluster_means(values, cluster)
    mean, count = float(means.mean()), len(means)
    if count < 2:
        return mean, math.nan, math.nan
    half = float(stdtrit(count - 1, 1.0 - alpha / 2.0) * means.std(ddof=1)) / math.sqrt(count)
    return mean, mean - half, mean + half


def wilson(hits: float, runs: float) -> tuple[float, float, float]:
    """Return hits / runs with a 95 % interval (Wilson 1927); NaN without runs.

    The runs must be independent.
    """
    if not runs:
        return math.nan, math.nan, math.nan
    share, z2 = hits / runs, float(ndtri(1.0 - ALPHA / 2.0)) ** 2
    centre = (share + z2 / (2.0 * runs)) / (1.0 + z2 / runs)
    half = math.sqrt(z2 * (share * (1.0 - share) / runs + z2 / (4.0 * runs**2))) / (1.0 + z2 / runs)
    # At none and all of the runs rounding would move an end away from its share.
    return share, 0.0 if share == 0.0 else centre - half, 1.0 if share == 1.0 else centre + half


def mean_band(samples: int, dimension: float) -> tuple[float, float]:
    """Return the 95 % band of the mean NEES or NIS of a consistent estimator.

    ``samples`` times the mean has a χ² distribution with samples × dimension degrees of freedom
    (Bar-Shalom et al. 2001, § 5.4.2). For the NEES each run is one sample, because the epochs of a
    run are strongly correlated; the false-alarm rate is then at most 5 %. The innovations of a
    filter are white, so each epoch of each run is a sample of the NIS; the false-alarm rate is 5 %.
    The band is NaN without samples.

    Parameters
    ----------
    samples : number of samples. For the NEES it is the number of runs. For the NIS it is the number
        of epochs with a measurement, added over all runs.
    dimension : number of states, or mean number of channels of a measurement.
    """
    if samples == 0:
        return math.nan, math.nan
    low, high = chdtri(samples * dimension, [1.0 - ALPHA / 2.0, ALPHA / 2.0]) / samples
    return float(low), float(high)


def coverage_band(runs: int, level: float = 0.95) -> tuple[float, float]:
    """Return the 95 % band of a consistent estimator's coverage.

    The coverage is the share of epochs with the truth inside a reported region. The band is
    binomial with one sample per run, because the epochs of a run are strongly correlated. The
    false-alarm rate is at most 5 %. The band is NaN without runs.

    Parameters
    ----------
    runs : number of runs.
    level : nominal probability that the truth lies inside the region.
    """
    if runs == 0:
        return math.nan, math.nan
    ends = (ALPHA / 2.0, 1.0 - ALPHA / 2.0)
    low, high = (binomial_quantile(end, runs, level) / runs for end in ends)
    return low, high


@lru_cache(maxsize=64)
def binomial_quantile(probability: float, count: int, share: float) -> int:
    """Return the least k with P(successes ≤ k) ≥ ``probability`` in a binomial distribution.

    Parameters
    ----------
    probability : number between 0 and 1, both excluded.
    count : number of independent trials.
    share : probability of success in each trial.
    """
    return int(np.searchsorted(bdtr(np.arange(count + 1), count, share), probability))


def _difference(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Return after − before (runs,); 0 where the two are equal except for rounding."""
    if before.shape != after.shape:
        raise ValueError(f"pairs have one shape, not {before.shape} and {after.shape}")
    difference = after - before
    return np.where(np.abs(difference) <= ROUNDING * np.maximum(before, after), 0.0, difference)


def excess_p_value(
    before_ms: np.ndarray, after_ms: np.ndarray, threshold: float, paired: bool
) -> float:
    """Return the p-value of the hypothesis that an RMS error grew by at most ``threshold``.

    The test is one-sided. For pairs it is Student's t-test of the hypothesis that the mean of after
    − (1 + threshold)²·before is not positive. For independent samples it is Welch's test (1947).
    Independent samples should have equal sizes, because squared errors are skewed.

    Parameters
    ----------
    before_ms, after_ms : (runs,) mean squared errors [m² or m²/s²].
    threshold : tolerated relative increase of the RMS error.
    paired : whether both arrays have the errors of the same runs.

    Returns
    -------
    The p-value. It is 1 if an array has fewer than two runs, and 0 or 1 if the values do not
    scatter.

    Raises
    ------
    ValueError
        If pairs differ in shape.
    """
    from scipy import stats  # takes half a second, and only comparisons of folders need it

    allowed = (1.0 + threshold) ** 2 * before_ms
    if min(len(allowed), len(after_ms)) < 2:
        return 1.0
    if paired:
        samples = [_difference(allowed, after_ms)]
        excess = samples[0][:1]
        test = partial(stats.ttest_1samp, popmean=0.0)
    else:
        samples = [after_ms, allowed]
        excess = _difference(allowed[:1], after_ms[:1])
        test = partial(stats.ttest_ind, equal_var=False)
    if all(np.ptp(sample) == 0.0 for sample in samples):
        return 0.0 if excess > 0.0 else 1.0
    return float(test(*samples, alternative="greater").pvalue)


def holm(p_values: Iterable[float]) -> np.ndarray:
    """Return p-values (m,) adjusted for multiple tests by Holm's (1979) step-down procedure.

    If all hypotheses with an adjusted p-value below α are rejected, the probability of rejecting
    any true hypothesis is at most α, for any dependence between the tests.
    """
    p = np.asarray(list(p_values), dtype=float)
    order = np.argsort(p)
    steps = np.maximum.accumulate(p[order] * np.arange(len(p), 0, -1))
    adjusted = np.empty_like(p)
    adjusted[order] = np.minimum(steps, 1.0)
    return adjusted
