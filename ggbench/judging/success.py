"""Shares of success, and accuracy among the runs that succeeded.

One diverged run can dominate the mean squared error of two hundred. So success is judged first;
accuracy is judged among successes, by medians and logarithms.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.special import bdtr

from .convergence import median_interval, wilson
from .statistics import ALPHA, BETTER, UNDECIDED, WORSE, mean_intervals

if TYPE_CHECKING:
    import pandas as pd

COLUMNS = (
    "success_share", "success_lo", "success_hi", "ratio_median", "ratio_median_lo",
    "ratio_median_hi", "ratio_quartile_lo", "ratio_quartile_hi", "ratio_p95", "capped_mrse_m",
    "nees_median",
)  # fmt: skip
"""Columns of a summary, see :func:`figures`."""
PAIRED_COLUMNS = (
    "both_succeeded", "first_succeeded", "second_succeeded", "success_p", "error_ratio",
    "error_ratio_lo", "error_ratio_hi", "sign_p", "verdict",
)  # fmt: skip
"""Columns of a paired comparison, see :func:`compared`."""
EQUIVALENCE_RATIO = 1.05
"""Ratio of errors within which two estimators are as good as each other."""
FEWEST = 20
"""Runs in which two estimators must both have succeeded to be called as good as each other."""
BOUNDS, INS_FRACTION = 10.0, 0.5
"""Success threshold on the final error: 10 × the bound or 0.5 × the INS error, the larger one."""
EQUAL = "as good"
"""Verdict: no sure difference in success, errors surely within :data:`EQUIVALENCE_RATIO`."""


Bounds = Mapping[tuple[str, str], Mapping[str, tuple[float, float]]]
"""(case, estimator) to window to root-mean bounds on position [m] and velocity [m/s]."""


def succeeded(runs: pd.DataFrame, bounds: Bounds) -> np.ndarray:
    """Return which runs (R,) of a table of runs succeeded.

    Those that finished, did not diverge, and are at the end where they should be: where locks are
    judged, locked; elsewhere within :data:`BOUNDS` of the bound at the end (of its kind), or of
    :data:`INS_FRACTION` of the INS's error there, root mean square over the runs of the case. To be
    no worse than the INS is no success: the INS itself succeeds where it need not be aided, and
    else by chance. Without a bound or an INS's error that criterion is left out.

    Parameters
    ----------
    runs : of any cases and estimators.
    bounds : of each of them.
    """
    ends = [
        bounds.get(cell, {}).get("last20", (math.nan,))[0]
        for cell in zip(runs["case"], runs["estimator"], strict=True)
    ]
    keys = [key for key in ("case", "seed", "run") if key in runs]
    flown = runs.dropna(subset=["final_ins_error_m"]).drop_duplicates(keys)
    drift = (flown["final_ins_error_m"] ** 2).groupby(flown["case"]).mean()
    unaided = np.sqrt(runs["case"].map(drift).to_numpy(dtype=float))
    farthest = np.fmax(BOUNDS * np.array(ends, dtype=float), INS_FRACTION * unaided)
    near = ~(runs["final_position_error_m"].to_numpy(dtype=float) > farthest)
    judged = runs["false_lock"].notna().groupby(runs["case"]).transform("any").to_numpy(dtype=bool)
    there = np.where(judged, runs["lock_time_s"].notna().to_numpy(), near)
    good = (runs["status"] == "ok").to_numpy() & ~runs["diverged"].to_numpy(dtype=bool)
    return np.asarray(good & there)


def figures(
    position_ms: np.ndarray, nees: np.ndarray, success: np.ndarray, bound: float, unaided: float
) -> dict[str, float]:
    """Return the figures of :data:`COLUMNS` of an estimator on a case, in a window.

    Parameters
    ----------
    position_ms : (R,) mean squared position error of all runs [m²]; NaN of one that failed.
    nees : (R,) mean NEES of the runs, NaN likewise or without covariances.
    success : (R,) which runs succeeded.
    bound : root-mean bound on the position error [m], NaN if there is none.
    unaided : the INS's MRSE [m]: what is left without an estimate; NaN without an INS.

    Returns
    -------
    Share of success with its Wilson interval; of the runs that succeeded the median with its
    interval, quartiles and 95th percentile of a run's root mean squared error over the bound; the
    MRSE of all runs, none of which counts as worse than the INS's; the median NEES of all runs.
    """
    ratios = np.sqrt(position_ms[success & np.isfinite(position_ms)]) / bound
    quartiles = np.percentile(ratios, [25.0, 75.0, 95.0]) if len(ratios) else [math.nan] * 3
    capped = np.fmin(position_ms, unaided**2)  # what failed is NaN, and counts as the INS's
    known = nees[np.isfinite(nees)]
    found = (
        *wilson(int(success.sum()), len(success)),
        *median_interval(ratios),
        *map(float, quartiles),
        math.sqrt(float(np.mean(capped))) if len(capped) else math.nan,
        float(np.median(known)) if len(known) else math.nan,
    )
    return dict(zip(COLUMNS, found, strict=True))


def exact_p(one: int, other: int) -> float:
    """Return the two-sided p-value of "one and other are equally likely" (binomial, exact).

    McNemar's (1947) exact test of pairs that differ, and the sign test.
    """
    total = one + other
    return min(1.0, 2.0 * float(bdtr(min(one, other), total, 0.5))) if total else 1.0


def compared(pairs: list[tuple[np.ndarray, ...]]) -> list[dict[str, float | int | str]]:
    """Return the figures of :data:`PAIRED_COLUMNS` of pairs of estimators on the same runs.

    Each pair is (position_ms [m²], success) of the first and of the second estimator, (R,) each.

    Returns
    -------
    How many runs both, the first alone and the second alone succeeded in, and McNemar's p-value; of
    the runs in which both did the geometric mean of the ratio of their errors with its 95 %
    bootstrap-t interval, and the p-value of the sign test. The verdict, of the first estimator:

    - "better" or "worse", if it succeeds surely more or less often (p < 5 %); or if neither does,
      the interval of the ratio leaves 1 out, and the sign test says the same (p < 5 %);
    - "as good", if neither does, the interval lies within :data:`EQUIVALENCE_RATIO`, whatever it
      holds, and there are :data:`FEWEST` runs or more;
    - else "not distinguishable": too few runs to say any of these.

    Of estimators that do not differ at most 10 % are called better or worse: each of the two steps
    is wrong in 5 %, and the second asks two tests.
    """
    logs, counts = [], []
    for first, first_good, second, second_good in pairs:
        both = first_good & second_good
        both &= np.isfinite(first) & np.isfinite(second) & (first > 0.0) & (second > 0.0)
        ratio = 0.5 * np.log(first[both] / second[both])
        logs.append(np.where(np.abs(ratio) < 1e-9, 0.0, ratio))
        counts.append((int((first_good & ~second_good).sum()),
                       int((second_good & ~first_good).sum())))  # fmt: skip
    intervals = mean_intervals(logs)
    found: list[dict[str, float | int | str]] = []
    for ratio, (one, other), (low, high) in zip(logs, counts, intervals, strict=True):
        success_p = exact_p(one, other)
        wins, losses = int((ratio < 0.0).sum()), int((ratio > 0.0).sum())
        sign_p = exact_p(wins, losses)
        found.append(
            {
                "both_succeeded": len(ratio),
                "first_succeeded": one,
                "second_succeeded": other,
                "success_p": success_p,
                "error_ratio": float(np.exp(ratio.mean())) if len(ratio) else math.nan,
                "error_ratio_lo": _exp(low),
                "error_ratio_hi": _exp(high),
                "sign_p": sign_p,
                "verdict": _verdict(
                    len(ratio), (one, other), success_p, (low, high), sign_p, wins - losses
                ),
            }
        )
    return found


def _exp(value: float) -> float:
    """Return eˣ, ∞ of what is beyond all numbers: few runs have wide intervals."""
    with np.errstate(over="ignore"):
        return float(np.exp(value))


def _verdict(
    runs: int, alone: tuple[int, int], success_p: float, ends: tuple[float, float], sign_p: float,
    lead: int,
) -> str:  # fmt: skip
    """Return the verdict on the first of a pair, see :func:`compared`.

    ``alone`` are the successes of one alone, ``ends`` those of the interval of the mean of the
    logarithms, ``lead`` the runs in which the first is nearer less those in which the second is.
    """
    low, high = ends
    if success_p < ALPHA:
        return BETTER if alone[0] > alone[1] else WORSE
    if -math.log(EQUIVALENCE_RATIO) <= low and high <= math.log(EQUIVALENCE_RATIO):
        return EQUAL if runs >= FEWEST else UNDECIDED
    if sign_p < ALPHA:
        if high < 0.0 < lead:
            return BETTER
        if low > 0.0 > lead:
            return WORSE
    return UNDECIDED


def opposite(verdict: str) -> str:
    """Return a verdict as seen from the other estimator of a pair."""
    return {BETTER: WORSE, WORSE: BETTER}.get(verdict, verdict)


def swapped(pair: Mapping[str, Any]) -> dict[str, Any]:
    """Return those of :data:`PAIRED_COLUMNS` that differ as seen from a pair's second estimator."""
    ratio = {end: float(pair[f"error_ratio{end}"]) for end in ("", "_lo", "_hi")}
    inverse = {end: 1.0 / value if value else math.inf for end, value in ratio.items()}
    return {
        "first_succeeded": pair["second_succeeded"],
        "second_succeeded": pair["first_succeeded"],
        "error_ratio": inverse[""],
        "error_ratio_lo": inverse["_hi"],
        "error_ratio_hi": inverse["_lo"],
        "verdict": opposite(str(pair["verdict"])),
    }
