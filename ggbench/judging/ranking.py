"""Which estimator of a case is the best, and how two of them compare.

Consistent estimators go first, then success, then the median error of the runs that succeeded.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any, Literal

import pandas as pd

from ..spec.case import CaseSpec
from . import success
from .statistics import BETTER, WORSE
from .success import EQUAL

MOST_FAILED = 0.05
"""Largest share of failed runs with which an estimator can be the best of its case."""
LEAST_COVERAGE = 0.8
"""Share of epochs whose truth lies in the claimed 95 % region, below which none is consistent."""
MOST_FALSE = 0.05
"""Largest share of runs of a consistent estimator that end in a false fix."""
UNCERTAIN = 1.1
"""Ratio of median errors up to which what cannot be told from the best one may be as good."""
ORDER = {"filter": 0, "none": 1, "fixed-lag": 2, "batch": 3}
"""Blocks of a ranking: what is causal, what is there without aiding, smoothers."""
AsGood = Literal["yes", "open", "no"]


def consistent(row: Mapping[str, Any]) -> bool:
    """Return whether an estimator is consistent in a case.

    Its 95 % regions hold the truth in :data:`LEAST_COVERAGE` of the epochs or more, and at most
    :data:`MOST_FALSE` of the runs, or a single one, end in a false fix. Shares are compared and not
    the ends of their intervals, with which few runs would pass where many fail. An estimator
    without a covariance is not found inconsistent.
    """
    return not (row["coverage"] < LEAST_COVERAGE or often_false(row))


def often_false(row: Mapping[str, Any]) -> bool:
    """Return whether an estimator ends in false fixes too often to be consistent."""
    share = row["false_lock_share"]
    return bool(share > MOST_FALSE and round(share * row["runs"]) > 1)


def ranked(rows: pd.DataFrame) -> pd.DataFrame:
    """Return summary rows with the best causal estimator first, smoothers in a block at the end.

    Those that succeed as often as the one that surely succeeds most (:func:`best`) by the median
    ratio of their errors to the bound, those with all runs before those that got fewer; then the
    others by their share of success. Of errors that agree to three digits the cheaper one is the
    better one.
    """
    order = rows["causality"].map(ORDER)
    least = rows.groupby(order)["success_lo"].transform("max")
    keys = pd.DataFrame(
        {
            "order": order,
            "seldom": (1.0 - rows["success_share"]).where(rows["success_hi"] < least, -1.0),
            "fewer": rows["runs"] < rows.groupby(order)["runs"].transform("max"),
            "error": [_digits(value) for value in rows["ratio_median"]],
            "mean": [_digits(value) for value in rows["position_mrse_m"]],
            "cost": rows["seconds_per_run"],
        },
        index=rows.index,
    )
    return rows.loc[keys.sort_values([*keys.columns]).index]


def _digits(value: float) -> float:
    """Return a number with the three digits that count, ∞ for none."""
    return float(f"{value:.2e}") if math.isfinite(value) else math.inf


def rows_of(summary: pd.DataFrame, case: CaseSpec, window: str) -> dict[str, dict[str, Any]]:
    """Return the ranked summary rows of a case and window by estimator."""
    chosen = summary[(summary["case"] == case.name) & (summary["window"] == window)]
    if chosen.empty:
        return {}
    return {str(row["label"]): row for row in ranked(chosen).to_dict("records")}


def best_causal(rows: Iterable[Mapping[str, Any]]) -> dict[str, Any] | None:
    """Return the row of the best causal estimator (:func:`best`) of a case and window, or None."""
    return best(row for row in rows if row["causality"] == "filter")


def best(rows: Iterable[Mapping[str, Any]]) -> dict[str, Any] | None:
    """Return the row of the best of some estimators of a case and window, None without any.

    Of those that succeed as often as the one that surely succeeds most (whose interval begins
    highest: one of few runs never lets in what is surely below one of many) the one whose errors,
    where it succeeds, have the least median ratio to the bound; of ratios that agree to three
    digits the cheaper one. Consistent ones (:func:`consistent`) go before the others, those with
    all runs before those that got fewer, whose medians are of other runs. An estimator that failed
    in more than :data:`MOST_FAILED` of its runs is none: its errors are of the runs that were kind
    to it.
    """
    able = [
        dict(row)
        for row in rows
        if math.isfinite(row["position_mrse_m"]) and row["failed"] <= MOST_FAILED * row["runs"]
    ]
    if not able:
        return None
    least = max(row["success_lo"] for row in able)
    often = [row for row in able if row["success_hi"] >= least]
    most = max(row["runs"] for row in able)
    return min(
        often,
        key=lambda row: (
            not consistent(row), row["runs"] < most, _digits(row["ratio_median"]),
            _digits(row["position_mrse_m"]), row["seconds_per_run"],
        ),
    )  # fmt: skip


def as_good(
    row: Mapping[str, Any], best: Mapping[str, Any], pair: Mapping[str, Any] | None
) -> AsGood:
    """Return whether an estimator is as good as the best causal one of a case.

    "yes" if they are found as good as each other, run by run (:func:`.success.compared`), or it is
    the better one; "open" if the runs are too few to tell, and its errors lie within
    :data:`UNCERTAIN` of the best one's. It must not fail in more than :data:`MOST_FAILED` of its
    runs.

    Parameters
    ----------
    row, best : of the summary.
    pair : their comparison, as seen from the best one.
    """
    if row["label"] == best["label"]:
        return "yes"
    if row["failed"] > MOST_FAILED * row["runs"]:
        return "no"
    verdict = pair["verdict"] if pair else ""
    if verdict in (EQUAL, WORSE):
        return "yes"
    ratio = error_ratio(row, best, pair)
    near = ratio <= UNCERTAIN and row["success_hi"] >= best["success_lo"]
    return "open" if verdict != BETTER and near else "no"


def error_ratio(
    row: Mapping[str, Any], best: Mapping[str, Any], pair: Mapping[str, Any] | None
) -> float:
    """Return an estimator's error over the best one's; NaN where neither is known.

    Run by run if both succeeded in any, else of the medians over the bound.
    """
    if pair and pair.get("error_ratio", math.nan) > 0.0:
        return 1.0 / float(pair["error_ratio"])
    return row["ratio_median"] / best["ratio_median"] if best["ratio_median"] else math.nan


def pair_of(
    pairs: pd.DataFrame, case: str, first: str, second: str, window: str = "settled"
) -> dict[str, Any] | None:
    """Return the paired comparison of two estimators as seen from the first, None without one.

    ``pairs`` are the rows of :func:`.summary.paired_table`, which hold each pair once; those of a
    digest hold what says who succeeds and is nearer alone.
    """
    chosen = pairs[(pairs["case"] == case) & (pairs["window"] == window)]
    for one, other in ((first, second), (second, first)):
        found = chosen[(chosen["first"] == one) & (chosen["second"] == other)]
        if len(found):
            row = found.iloc[0].to_dict()
            return row if one == first else _swapped(row)
    return None


def _swapped(pair: dict[str, Any]) -> dict[str, Any]:
    """Return a pair as seen from its second estimator."""
    swapped = pair | {"first": pair["second"], "second": pair["first"]} | success.swapped(pair)
    if "first_only" in pair:
        swapped |= {"first_only": pair["second_only"], "second_only": pair["first_only"]}
    for quantity, unit in (("position", "m2"), ("velocity", "m2ps2")):
        if f"{quantity}_verdict" not in pair:
            continue
        ratio = 1.0 + pair[f"{quantity}_relative"]
        swapped |= {
            f"{quantity}_difference_{unit}": -pair[f"{quantity}_difference_{unit}"],
            f"{quantity}_lo": -pair[f"{quantity}_hi"],
            f"{quantity}_hi": -pair[f"{quantity}_lo"],
            f"{quantity}_relative": 1.0 / ratio - 1.0 if ratio else math.nan,
            f"{quantity}_win_rate": 1.0 - pair[f"{quantity}_win_rate"],
            f"{quantity}_verdict": success.opposite(pair[f"{quantity}_verdict"]),
        }
    return swapped
