"""Which estimator of a case is the best, and how two of them compare."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

import pandas as pd

from ..spec.case import CaseSpec
from .statistics import BETTER, WORSE

MOST_FAILED = 0.05
"""Largest share of failed runs with which an estimator can be the best of its case."""
ORDER = {"filter": 0, "none": 1, "fixed-lag": 2, "batch": 3}
"""Blocks of a ranking: what is causal, what is there without aiding, smoothers."""


def ranked(rows: pd.DataFrame) -> pd.DataFrame:
    """Return summary rows with the best causal estimator first, smoothers in a block at the end.

    Of estimators whose position errors agree to three digits the cheaper one is the better one.
    """
    keys = pd.DataFrame(
        {
            "order": rows["causality"].map(ORDER),
            "error": [float(f"{error:.2e}") for error in rows["position_mrse_m"]],
            "cost": rows["seconds_per_run"],
        },
        index=rows.index,
    )
    return rows.loc[keys.sort_values(["order", "error", "cost"]).index]


def rows_of(summary: pd.DataFrame, case: CaseSpec, window: str) -> dict[str, dict[str, Any]]:
    """Return the ranked summary rows of a case and window by estimator."""
    chosen = summary[(summary["case"] == case.name) & (summary["window"] == window)]
    return {row["label"]: row for row in ranked(chosen).to_dict("records")}


def best_causal(rows: Iterable[Mapping[str, Any]]) -> dict[str, Any] | None:
    """Return the row of the best causal estimator of a case and window, None without any.

    The least position MRSE; of errors that agree to three digits the cheaper one. An estimator that
    failed in more than :data:`MOST_FAILED` of its runs is none: its errors are of the runs that
    were kind to it. Where locks are judged, nor is one that locks surely less often than another
    one: whose interval lies below that of the largest share.
    """
    able = [
        dict(row)
        for row in rows
        if row["causality"] == "filter"
        and math.isfinite(row["position_mrse_m"])
        and row["failed"] <= MOST_FAILED * row["runs"]
    ]
    locking = [row for row in able if not math.isnan(row["lock_share"])]
    if locking:
        surest = max(locking, key=lambda row: row["lock_share"])["lock_lo"]
        able = [row for row in locking if row["lock_hi"] >= surest]
    if not able:
        return None
    return min(
        able, key=lambda row: (float(f"{row['position_mrse_m']:.2e}"), row["seconds_per_run"])
    )


def pair_of(
    pairs: pd.DataFrame, case: str, first: str, second: str, window: str = "settled"
) -> dict[str, Any] | None:
    """Return the paired comparison of two estimators as seen from the first, None without one.

    ``pairs`` are the rows of :func:`.summary.paired_table`, which hold each pair once.
    """
    for one, other in ((first, second), (second, first)):
        found = pairs[
            (pairs["case"] == case)
            & (pairs["window"] == window)
            & (pairs["first"] == one)
            & (pairs["second"] == other)
        ]
        if len(found):
            row = found.iloc[0].to_dict()
            return row if one == first else _turned(row)
    return None


def _turned(pair: dict[str, Any]) -> dict[str, Any]:
    """Return a pair as seen from its second estimator."""
    opposite = {BETTER: WORSE, WORSE: BETTER}
    turned = pair | {
        "first": pair["second"],
        "second": pair["first"],
        "first_only": pair["second_only"],
        "second_only": pair["first_only"],
    }
    for quantity, unit in (("position", "m2"), ("velocity", "m2ps2")):
        ratio = 1.0 + pair[f"{quantity}_relative"]
        turned |= {
            f"{quantity}_difference_{unit}": -pair[f"{quantity}_difference_{unit}"],
            f"{quantity}_lo": -pair[f"{quantity}_hi"],
            f"{quantity}_hi": -pair[f"{quantity}_lo"],
            f"{quantity}_relative": 1.0 / ratio - 1.0 if ratio else math.nan,
            f"{quantity}_win_rate": 1.0 - pair[f"{quantity}_win_rate"],
            f"{quantity}_verdict": opposite.get(
                pair[f"{quantity}_verdict"], pair[f"{quantity}_verdict"]
            ),
        }
    return turned
