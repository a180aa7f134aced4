"""What a case says: its best estimator, those recommended, and what aiding gains.

Estimators are compared on equal runs. The best one is chosen on the runs of even number, and
compared on those of odd number.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Set
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from .pairs import ERRORS, PairedRuns, compared, judged, kind
from .statistics import ALPHA, BETTER, root_ratio_intervals
from .summary import CONSERVATIVE, CONSISTENT

if TYPE_CHECKING:
    import pandas as pd

MOST_FAILED = 0.05
"""Share of failed runs above which an estimator is not compared."""
RECOMMENDED_RATIO = 1.10
"""Ratio of RMS errors to the best estimator's within which one is recommended."""
FEWEST_RUNS = 10
"""Runs of a case below which no estimator is recommended: half of them choose, half compare."""
ALIKE_TIMES = 2.0
"""Ratio of times of a run up to which they are alike: they differ between machines and loads."""


class Verdict(NamedTuple):
    """The verdict on the estimators of one kind in a case.

    Attributes
    ----------
    best : the estimator of least RMS error among the consistent ones, else among all; "" if none
        was compared.
    recommended : labels of those recommended: first those as cheap as any, in the campaign's order.
    consistent : number of consistent estimators.
    gain : verdict on the best against the INS, "" without an INS.
    """

    best: str = ""
    recommended: tuple[str, ...] = ()
    consistent: int = 0
    gain: str = ""


class UnequalRunsError(ValueError):
    """Estimators are compared that did not fly the same runs."""


def require_equal_runs(runs: pd.DataFrame) -> None:
    """Raise UnequalRunsError unless all estimators of each case flew the same runs."""
    for case, group in runs.groupby("case", sort=False):
        flown = {label: frozenset(own["run"]) for label, own in group.groupby("estimator")}
        if len(set(flown.values())) > 1:
            counts = ", ".join(f"{label} {len(own)}" for label, own in flown.items())
            raise UnequalRunsError(f"case {case} compares unequal runs: {counts}")


def with_equal_runs(runs: pd.DataFrame) -> pd.DataFrame:
    """Return the runs of those estimators that flew all runs of a case and seldom failed."""
    own = [runs["case"], runs["estimator"]]
    flown = runs["run"].groupby(own).transform("count")
    failed = (runs["status"] != "ok").groupby(own).transform("mean")
    return runs[(flown == flown.groupby(runs["case"]).transform("max")) & (failed <= MOST_FAILED)]


def verdict(runs: pd.DataFrame, metrics: pd.DataFrame, of: str = "causal") -> Verdict:
    """Return the verdict on the estimators of a kind in one case.

    An estimator is *recommended* if it is consistent or conservative, does not succeed surely less
    often than another one, and its RMS error is surely within 10 % of the best one's. These
    comparisons are on the runs of odd number. None is where the best one is not surely better than
    the INS, if that flew, or where there are fewer than ten runs.

    Parameters
    ----------
    runs : table of runs of one case with a column ``draw``, the number of the cluster.
    metrics : their metrics (:func:`.summary.metrics`).
    of : "causal" or "smoother".
    """
    runs = with_equal_runs(runs)
    aided = runs[(runs["causality"] != "none") & (runs["causality"].map(kind) == of)]
    if aided.empty:
        return Verdict()
    require_equal_runs(aided)
    even, odd = (aided[aided["run"] % 2 == rest] for rest in (0, 1))
    if odd.empty:  # a single run chooses and compares nothing
        return Verdict()
    squares = even.groupby("estimator", sort=False)[ERRORS].mean()
    table = metrics[metrics["window"] == "settled"].set_index("estimator").loc[squares.index]
    consistent = set(table.index[table["consistency"].isin([CONSISTENT, CONSERVATIVE])])
    best = str((squares[squares.index.isin(consistent)] if consistent else squares).idxmin())
    flown = {str(label): PairedRuns.of(own) for label, own in odd.groupby("estimator", sort=False)}
    gain = _gain(runs, flown[best])
    enough = aided["run"].nunique() >= FEWEST_RUNS
    near = _surely_near(flown, best, consistent) if enough and gain in ("", BETTER) else []
    seconds = table["seconds_per_run"]
    limit = ALIKE_TIMES * min((seconds[label] for label in near), default=0.0)
    cheapest = sorted(near, key=lambda label: max(seconds[label], limit))
    return Verdict(best, tuple(cheapest), len(consistent), gain)


def _surely_near(flown: Mapping[str, PairedRuns], best: str, among: Set[str]) -> list[str]:
    """Return which of some estimators are recommended, given the best one."""
    labels = [label for label in flown if label in among]
    reference = flown[best]
    groups = []
    for label in labels:
        own = flown[label]
        both = np.isfinite(own.squares) & np.isfinite(reference.squares)
        groups.append((own.squares[both], reference.squares[both], own.draw[both]))
    tests = {
        (one, two): compared(flown[one], flown[two])
        for one, two in itertools.combinations(labels, 2)
    }
    lower = set()
    for (one, two), pair in zip(tests, judged([*tests.values()]), strict=True):
        if pair["success_p"] < ALPHA:
            lower.add(one if tests[one, two]["_lead"] < 0.0 else two)
    return [
        label
        for label, (_, _, high) in zip(labels, root_ratio_intervals(groups), strict=True)
        if label not in lower and (label == best or high <= RECOMMENDED_RATIO)
    ]


def _gain(runs: pd.DataFrame, best: PairedRuns) -> str:
    """Return the verdict on the best estimator against the INS, on its runs."""
    ins = runs[runs["causality"] == "none"]
    if ins.empty:
        return ""
    return str(judged([compared(best, PairedRuns.of(ins))])[0]["verdict"])
