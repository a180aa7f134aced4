"""Verdicts on cases: best estimator, recommended estimators, gain of aiding.

Estimators are compared on equal runs. Recommendations are cross-fitted. The best estimator of the
even runs is compared with the others on the odd runs, and vice versa. Both results must agree.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence, Set
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from .bootstrap import root_ratio_intervals
from .consistency import CONSERVATIVE, CONSISTENT
from .pairs import PairedRuns, compared, judged, kind
from .run_errors import JUDGED
from .statistics import ALPHA, BETTER, UNDECIDED

if TYPE_CHECKING:
    import pandas as pd

MOST_FAILED = 0.05
"""Share of failed runs above which an estimator is not compared."""
RECOMMENDED_RATIO = 1.10
"""Largest ratio of a recommended estimator's RMS error to the least RMS error."""
FEWEST_RUNS = 40
"""Runs of a case below which no estimator is recommended."""
LEAST_SUCCESS = 0.5
"""Least success rate of a recommended estimator."""
LEAST_NEES = 0.5 * JUDGED
"""Least mean NEES of a recommended estimator: the covariance is at most twice the correct one."""
ALIKE_TIMES = 2.0
"""Ratio of computing times up to which they count as equal, because they vary with the load."""
_INS = ""
"""Label of the INS among estimators."""


class Verdict(NamedTuple):
    """Verdict on the estimators of one kind (causal or smoother) in a case.

    Attributes
    ----------
    best : label of the estimator with the least RMS error among the consistent or conservative
        estimators. If there are none, it is the best of all estimators. It is "" if none was
        compared. If none is recommended, reports call this estimator the *least bad*.
    recommended : labels of the recommended estimators, the fastest first. Computing times up to
        twice the least time count as equal. Estimators with equal times are in the order of the
        campaign.
    consistent : number of consistent or conservative estimators.
    gain : verdict of the comparison with the INS. The best estimator of each half of the runs is
        compared with the INS in the other half. The verdict is "undecided" if the two halves
        differ, and "" without an INS or with a single run.
    reason : reason why no estimator is recommended; "" if one is.
    """

    best: str = ""
    recommended: tuple[str, ...] = ()
    consistent: int = 0
    gain: str = ""
    reason: str = ""


class UnequalRunsError(ValueError):
    """The compared estimators do not have the same runs."""


def require_equal_runs(runs: pd.DataFrame) -> None:
    """Raise UnequalRunsError unless all estimators of each case have the same runs."""
    for case, group in runs.groupby("case", sort=False):
        flown = {label: frozenset(own["run"]) for label, own in group.groupby("estimator")}
        if len(set(flown.values())) > 1:
            counts = ", ".join(f"{label} {len(own)}" for label, own in flown.items())
            raise UnequalRunsError(f"case {case} compares unequal runs: {counts}")


def with_equal_runs(runs: pd.DataFrame) -> pd.DataFrame:
    """Return the runs of estimators that have all runs and at most 5 % failed runs.

    Both conditions apply to each case separately.
    """
    own = [runs["case"], runs["estimator"]]
    flown = runs["run"].groupby(own).transform("count")
    failed = (runs["status"] != "ok").groupby(own).transform("mean")
    return runs[(flown == flown.groupby(runs["case"]).transform("max")) & (failed <= MOST_FAILED)]


def verdict(runs: pd.DataFrame, metrics: pd.DataFrame, of: str = "causal") -> Verdict:
    """Return the verdict on the estimators of one kind in one case.

    An estimator is *recommended* if

    - it is consistent or conservative, and the mean NEES is at least half of the nominal value;
    - it succeeds in at least half of the runs, and not significantly less often than another
      estimator;
    - in both halves of the runs its RMS error is significantly within 10 % of that of the best
      estimator (:func:`_near`).

    No estimator is recommended with fewer than 40 runs, or if the best estimator is not
    significantly better than the INS in both halves. A failed run counts with the largest error of
    any estimator in this run, including the INS.

    Parameters
    ----------
    runs : table of runs of one case with a column ``draw``, the index of the cluster.
    metrics : table of metrics of these runs (:func:`.summary.metrics`).
    of : kind of estimators, "causal" or "smoother".
    """
    runs = with_equal_runs(runs)
    unaided = runs["causality"] == "none"
    aided = runs[~unaided & (runs["causality"].map(kind) == of)]
    if aided.empty:
        return Verdict()
    require_equal_runs(aided)
    flown = _with_failures(aided, runs[unaided])
    ins = flown.pop(_INS, None)
    table = metrics[metrics["window"] == "settled"].set_index("estimator").loc[list(flown)]
    consistent = set(table.index[table["consistency"].isin([CONSISTENT, CONSERVATIVE])])
    best = _least(flown, consistent or set(flown))
    halves = [{label: _half(own, rest) for label, own in flown.items()} for rest in (0, 1)]
    folds = [(halves[0], halves[1]), (halves[1], halves[0])]
    gain = "" if ins is None else _gain(folds, ins, consistent or set(flown))
    informative = {label for label in consistent if table.loc[label, "nees"] >= LEAST_NEES}
    finding = {label for label in informative if table.loc[label, "success"] >= LEAST_SUCCESS}
    least_often = _succeeding_less(flown) if finding else set()
    near = finding - least_often
    for choosing, comparing in folds if near else ():
        near &= _near(choosing, comparing, consistent)
    reasons = {
        f"fewer than {FEWEST_RUNS} runs": aided["run"].nunique() >= FEWEST_RUNS,
        "none is consistent": consistent,
        "covariances are more than twice the correct ones": informative,
        "no estimator succeeds in half of the runs": finding,
        "no estimator is significantly better than the INS": gain in ("", BETTER),
        "no estimator is near the best in both halves of the runs": near,
    }
    reason = next((text for text, is_met in reasons.items() if not is_met), "")
    seconds = table["seconds_per_run"]
    named = [label for label in flown if label in near and not reason]
    limit = ALIKE_TIMES * min((seconds[label] for label in named), default=0.0)
    cheapest = sorted(named, key=lambda label: max(seconds[label], limit))
    return Verdict(best, tuple(cheapest), len(consistent), gain, reason)


def _half(own: PairedRuns, rest: int) -> PairedRuns:
    """Return the runs with an even (``rest`` = 0) or odd (``rest`` = 1) index."""
    return own.among(own.run[own.run % 2 == rest])


def _with_failures(aided: pd.DataFrame, ins: pd.DataFrame) -> dict[str, PairedRuns]:
    """Return the runs of each estimator by label, and those of the INS under ``_INS``.

    The squared error of a failed run is replaced by the largest squared error of any estimator in
    this run. Without runs of the INS the key ``_INS`` is missing.
    """
    flown = {
        str(label): PairedRuns.of(own) for label, own in aided.groupby("estimator", sort=False)
    }
    if len(ins):
        flown[_INS] = PairedRuns.of(ins)
    largest = np.fmax.reduce([own.squares for own in flown.values()])
    return {
        label: own._replace(squares=np.where(np.isnan(own.squares), largest, own.squares))
        for label, own in flown.items()
    }


def _least(flown: Mapping[str, PairedRuns], among: Set[str]) -> str:
    """Return the label in ``among`` with the least RMS error; the first of equal errors."""
    return min((label for label in flown if label in among), key=lambda one: _mean(flown[one]))


def _mean(own: PairedRuns) -> float:
    """Return the mean squared error; infinite without runs, or if a run has no error."""
    mean = float(own.squares.mean()) if len(own.squares) else math.inf
    return math.inf if math.isnan(mean) else mean


def _near(
    choosing: Mapping[str, PairedRuns], comparing: Mapping[str, PairedRuns], among: Set[str]
) -> set[str]:
    """Return the labels of the estimators near the best one in the half ``comparing``.

    The best estimator is that of the other half, ``choosing``. For a near estimator, the
    RMS error is significantly within 10 % of that of the best estimator. It is also within 10 % of
    the least RMS error in ``comparing``. Without the second condition an estimator would be near
    the best one if both have large errors in the same few runs.
    """
    labels = [label for label in choosing if label in among]
    best = _least(choosing, among)
    reference = comparing[best]
    groups = []
    for label in labels:
        own = comparing[label]
        both = np.isfinite(own.squares) & np.isfinite(reference.squares)
        groups.append((own.squares[both], reference.squares[both], own.draw[both]))
    intervals = root_ratio_intervals(groups, fewest=FEWEST_RUNS // 2)
    least = min(_mean(comparing[label]) for label in labels)
    return {
        label
        for label, (_, _, high) in zip(labels, intervals, strict=True)
        if (label == best or high <= RECOMMENDED_RATIO)
        and _mean(comparing[label]) <= RECOMMENDED_RATIO**2 * least
    }


def _succeeding_less(flown: Mapping[str, PairedRuns]) -> set[str]:
    """Return the labels of estimators that succeed significantly less often than another one."""
    tests = {
        (one, two): compared(flown[one], flown[two])
        for one, two in itertools.combinations(flown, 2)
    }
    return {
        one if tests[one, two]["_lead"] < 0.0 else two
        for (one, two), pair in zip(tests, judged([*tests.values()]), strict=True)
        if pair["success_p"] < ALPHA
    }


def _gain(
    folds: Sequence[tuple[Mapping[str, PairedRuns], Mapping[str, PairedRuns]]],
    ins: PairedRuns,
    among: Set[str],
) -> str:
    """Return the verdict of the comparison with the INS, see :attr:`Verdict.gain`.

    The best estimator of each half is compared with the INS in the other half.
    """
    verdicts = set()
    for choosing, comparing in folds:
        if not all(len(own.run) for own in (*choosing.values(), *comparing.values())):
            return ""
        pair = compared(comparing[_least(choosing, among)], ins)
        verdicts.add(str(judged([pair])[0]["verdict"]))
    return verdicts.pop() if len(verdicts) == 1 else UNDECIDED
