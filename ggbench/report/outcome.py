"""What came out of a case: who is best, who is as good, and what aiding gains."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import pandas as pd

from ..judging.ranking import AsGood, as_good, best_causal, consistent, pair_of, rows_of
from ..judging.statistics import BETTER, UNDECIDED, WORSE
from ..judging.success import EQUIVALENCE_RATIO
from ..spec.case import CaseSpec

FEWEST_COMMON = 5
"""Runs in which two estimators must both have succeeded for a ratio to stand for others."""


@dataclass(frozen=True)
class Outcome:
    """What came out of a case.

    Attributes
    ----------
    case : which.
    rows : its ranked summary rows by estimator.
    best, ins : the rows of the best causal estimator and of the INS, None without.
    beside : estimator to whether it is as good as the best, of causal ones.
    pairs : estimator to its comparison with the best, as seen from that one.
    gain : what aiding gains, see :func:`gain`; "" without a best one or an INS.
    """

    case: CaseSpec
    rows: Mapping[str, Mapping[str, Any]]
    best: Mapping[str, Any] | None
    ins: Mapping[str, Any] | None
    beside: Mapping[str, AsGood]
    pairs: Mapping[str, Mapping[str, Any] | None]
    gain: str

    @property
    def nobody_honest(self) -> bool:
        """Whether no causal estimator that finished is honest."""
        causal = [row for row in self.rows.values() if row["causality"] == "filter"]
        return not any(math.isfinite(r["position_mrse_m"]) and consistent(r) for r in causal)

    def good(self, label: str) -> bool:
        """Return whether an estimator is honest, and as good as the best or not told from it."""
        return self.beside.get(label, "no") != "no" and consistent(self.rows[label])


def outcome(case: CaseSpec, summary: pd.DataFrame, pairs: pd.DataFrame) -> Outcome:
    """Return what came out of a case, from summary rows and paired comparisons."""
    rows = rows_of(summary, case, "settled")
    best = best_causal(rows.values())
    unaided = (row for row in rows.values() if row["causality"] == "none")
    ins = next((row for row in unaided if math.isfinite(row["position_mrse_m"])), None)
    if best is None:
        return Outcome(case, rows, None, ins, {}, {}, "")
    beside = {label: pair_of(pairs, case.name, best["label"], label) for label in rows}
    found = {
        label: as_good(row, best, beside[label])
        for label, row in rows.items()
        if row["causality"] == "filter"
    }
    gained = gain(best, ins, beside[str(ins["label"])]) if ins else ""
    return Outcome(case, rows, best, ins, found, beside, gained)


def comparable_ratio(
    row: Mapping[str, Any], best: Mapping[str, Any] | None, pair: Mapping[str, Any] | None
) -> float:
    """Return an estimator's median error over the bound, as far as can be of the best one's runs.

    Of an estimator that got fewer runs the median is of another sample. So it is the best one's
    over all runs, divided by the mean ratio of the two errors over the runs in which both
    succeeded; its own median where there are fewer than :data:`FEWEST_COMMON` of these.

    Parameters
    ----------
    row, best : of the summary.
    pair : their comparison, as seen from the best one.
    """
    if (
        best is None
        or pair is None
        or row["runs"] >= best["runs"]
        or pair["both_succeeded"] < FEWEST_COMMON
        or not pair["error_ratio"] > 0.0
    ):
        return float(row["ratio_median"])
    error = best["ratio_median"] * best["position_bound_m"] / pair["error_ratio"]
    return float(error / row["position_bound_m"])


def gain(best: Mapping[str, Any], ins: Mapping[str, Any], pair: Mapping[str, Any] | None) -> str:
    """Return "gains", "nothing", "unproven" or "worse": the best causal estimator beside the INS.

    By their paired verdict. Where the runs are too few to say, it is nothing if medians of errors
    lie within :data:`.success.EQUIVALENCE_RATIO` of each other, and else a gain (or loss) is
    unproven.
    """
    verdict = pair["verdict"] if pair else UNDECIDED
    if verdict in (BETTER, WORSE):
        return "gains" if verdict == BETTER else "worse"
    ratio = ratio_of(ins["position_median_m"], best["position_median_m"])
    if verdict == UNDECIDED and not 1.0 / EQUIVALENCE_RATIO <= ratio <= EQUIVALENCE_RATIO:
        return "unproven"
    return "nothing"


def ratio_of(one: float, other: float) -> float:
    """Return the ratio of two errors, ∞ of anything to none."""
    return one / other if other > 0.0 else math.inf
