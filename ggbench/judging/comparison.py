"""Comparison of two campaigns, with verdicts worse, better, same or undecided.

All verdicts of a comparison form one family of tests, so more cases and estimators require stronger
evidence for each verdict.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from scipy.special import bdtrc

from ..errors import GGBenchError
from .bootstrap import ratio_interval
from .run_errors import WINDOWS
from .statistics import ALPHA, BETTER, UNDECIDED, WORSE, excess_p_value, holm

SAME = "same"
UNFINISHED = "failed or diverged"
ROW_COLUMNS = (
    "assumption",
    "case",
    "estimator",
    "quantity",
    "before",
    "after",
    "ratio",
    "lo",
    "hi",
    "runs_before",
    "runs",
    "paired",
    "p",
    "p_better",
    "verdict",
)
_QUANTITIES = ("position", "velocity")
_KEY = ["assumption", "case", "estimator"]
_RUN = ["seed", "run"]


class ComparisonError(GGBenchError):
    """Two campaigns cannot be compared."""


@dataclass(frozen=True, eq=False)
class Comparison:
    """Changes from one campaign to another.

    Attributes
    ----------
    rows : table with the columns :data:`ROW_COLUMNS`, and three rows for each common assumption,
        case and estimator. For the quantities "position" [m] and "velocity" [m/s], ``before`` and
        ``after`` are RMS errors. ``ratio`` is after / before, and ``lo`` and ``hi`` are the ends of
        its 95 % interval (:func:`ratio_interval`). ``runs_before`` and ``runs`` are both the number
        of runs whose errors are compared. For the quantity "failed or diverged", ``before`` and
        ``after`` are the numbers of such runs, and there is no ratio. ``runs_before`` and ``runs``
        are then the numbers of all runs before and after. ``paired`` states whether the two
        campaigns have the same simulated problems. ``p`` and ``p_better`` are adjusted p-values of
        the hypotheses "not worse" and "not better". ``verdict`` is "worse", "better", "same" (equal
        data, bit for bit) or "undecided".
    only_before, only_after : texts that name the items in only one of the campaigns, for example
        "case a" or "estimator ekf in case a".
    tests : number of rows in the family of tests, over which the p-values are adjusted. Rows with
        equal data, and rows without any failed or diverged run, are not tested.
    """

    rows: pd.DataFrame
    only_before: tuple[str, ...]
    only_after: tuple[str, ...]
    tests: int

    @property
    def worse(self) -> bool:
        """Whether the verdict of any row is "worse"."""
        return bool((self.rows["verdict"] == WORSE).any())


def compare(
    before: pd.DataFrame, after: pd.DataFrame, threshold: float, window: str = "settled"
) -> Comparison:
    """Compare two tables of runs.

    Runs of the same simulated problem (equal case hash and seed) are paired. Their errors are
    compared on the runs that finished in both campaigns. Runs of different problems are compared as
    independent samples of equal size: the larger campaign contributes its first runs. Samples of
    unequal size would cause false alarms, because squared errors are skewed. With 30 against 300
    runs, a third of the comparisons of ten pairs of case and estimator had a false alarm. Numbers
    of failed and diverged runs refer to all runs.

    If the parameters of an estimator change, its label changes, too. The old label is only in
    ``before``, and the new label only in ``after``. The two labels are compared in rows with
    the label "old → new".

    Errors are worse if the RMS error grew by more than ``threshold`` (:func:`excess_p_value`).
    Failures are worse if their number grew; ``threshold`` does not apply. The tests of failures are
    one-sided and exact: McNemar's for pairs, Fisher's for independent samples. Each verdict needs a
    p-value below 0.05 after Holm's procedure over all rows that differ. The false-alarm rate of
    :attr:`Comparison.worse` is thus 5 % for the whole comparison. The false-alarm rate of the
    verdict "better" is 5 %, too. The measured rate is at most 6 % with ten rows, 5 to 300 runs, and
    χ² or log-normal errors, paired or not. The rate is larger if only the shape of the distribution
    changes. It is 18 % with 30 runs and 9 % with 300, for independent samples of χ² with 1 and with
    3 degrees of freedom and equal means.

    Parameters
    ----------
    before, after : tables of runs with a row for each run and estimator.
    threshold : tolerated relative increase of the RMS error, ≥ 0.
    window : window of the flight, one of :data:`ggbench.judging.run_errors.WINDOWS`.

    Raises
    ------
    ComparisonError
        If the tables have no case and estimator in common, or threshold or window is invalid.
    """
    if window not in WINDOWS:
        raise ComparisonError(f"there is no window {window!r}; choose one of {', '.join(WINDOWS)}")
    if not (math.isfinite(threshold) and threshold >= 0.0):
        raise ComparisonError(f"the threshold is {threshold} and must be at least 0")
    renamed = _changed_parameters(before, after)
    before, after = (table.replace({"estimator": renamed}) for table in (before, after))
    groups_before, groups_after = groups_of_runs(before), groups_of_runs(after)
    common = [key for key in groups_before if key in groups_after]
    if not common:
        raise ComparisonError(
            f"the folders have no case and estimator in common: one has {_content(before)}, the "
            f"other {_content(after)}"
        )
    rows = pd.DataFrame(
        [
            dict(zip(_KEY, key, strict=True)) | row
            for key in common
            for row in _rows(groups_before[key], groups_after[key], threshold, window)
        ]
    )
    # What could not have been found, whatever its margins, takes part in no family of tests.
    open_rows = (rows["verdict"] != SAME) & ~(
        (rows["quantity"] == UNFINISHED) & (rows["before"] + rows["after"] == 0.0)
    )
    for column, verdict in (("p", WORSE), ("p_better", BETTER)):
        rows.loc[open_rows, column] = holm(rows.loc[open_rows, column])
        rows.loc[open_rows & (rows[column] < ALPHA), "verdict"] = verdict
    return Comparison(
        rows[list(ROW_COLUMNS)],
        _missing(groups_before, groups_after),
        _missing(groups_after, groups_before),
        int(open_rows.sum()),
    )


def _changed_parameters(before: pd.DataFrame, after: pd.DataFrame) -> dict[str, str]:
    """Return a common label "old → new" for the old and the new label of an estimator.

    The estimator has one label only in ``before`` and one only in ``after``, because its parameters
    differ.
    """
    old, new = (dict(zip(t["estimator"], t["name"], strict=True)) for t in (before, after))
    alone_old = {label: name for label, name in old.items() if label not in new}
    alone_new = {label: name for label, name in new.items() if label not in old}
    renamed: dict[str, str] = {}
    for name in set(alone_old.values()) & set(alone_new.values()):
        pair = [
            label for alone in (alone_old, alone_new) for label in alone if alone[label] == name
        ]
        if len(pair) == 2:
            renamed |= dict.fromkeys(pair, " → ".join(pair))
    return renamed


def groups_of_runs(table: pd.DataFrame) -> dict[tuple[str, ...], pd.DataFrame]:
    """Return the runs of each assumption, case and estimator, indexed by seed and run."""
    ordered = table.set_index(_RUN).sort_index(kind="stable")
    return dict(list(ordered.groupby(_KEY, sort=False)))


def _rows(
    before: pd.DataFrame, after: pd.DataFrame, threshold: float, window: str
) -> list[dict[str, Any]]:
    """Return the rows of one assumption, case and estimator, with p-values not yet adjusted."""
    paired = _problems(before) == _problems(after)
    columns = [f"{window}_{quantity}_ms" for quantity in _QUANTITIES]
    # An error beyond all numbers has no mean: such a run diverged, and is counted there.
    old_runs, new_runs = (
        runs.loc[np.isfinite(runs[columns].to_numpy(float)).all(axis=1), columns]
        for runs in (before, after)
    )
    if paired:
        common = old_runs.index.intersection(new_runs.index)
        old_runs, new_runs = old_runs.loc[common], new_runs.loc[common]
    runs = min(len(old_runs), len(new_runs))
    old_runs, new_runs = old_runs.iloc[:runs], new_runs.iloc[:runs]
    rows = []
    for quantity, column in zip(_QUANTITIES, columns, strict=True):
        one, two = old_runs[column], new_runs[column]
        old, new = one.to_numpy(float), two.to_numpy(float)
        ratio, low, high = ratio_interval(old, new, paired)
        rows.append(
            {
                "quantity": quantity,
                "before": math.sqrt(old.mean()) if runs else math.nan,
                "after": math.sqrt(new.mean()) if runs else math.nan,
                "ratio": ratio,
                "lo": low,
                "hi": high,
                "runs_before": runs,
                "runs": runs,
                "paired": paired,
                "p": excess_p_value(old, new, threshold, paired),
                "p_better": excess_p_value(new, old, threshold, paired),
                "verdict": SAME if runs and one.equals(two) else UNDECIDED,
            }
        )
    return [*rows, unfinished_runs(before, after, paired)]


def _problems(runs: pd.DataFrame) -> set[tuple[str, int]]:
    """Return the simulated problems of runs, as pairs of case hash and seed."""
    return set(zip(runs["problem"], runs.index.get_level_values("seed"), strict=True))


def unfinished_runs(before: pd.DataFrame, after: pd.DataFrame, paired: bool) -> dict[str, Any]:
    """Return the row that compares the numbers of failed and diverged runs."""
    is_lost = [(runs["status"] != "ok") | runs["diverged"].astype(bool) for runs in (before, after)]
    old, new = (int(runs.sum()) for runs in is_lost)
    if paired:
        # McNemar's exact test, on the runs that only one of the two failed.
        one, other = is_lost[0].align(is_lost[1], join="inner")
        only_old, only_new = int((one & ~other).sum()), int((other & ~one).sum())
        p, p_better = (
            float(bdtrc(only - 1, only_old + only_new, 0.5)) for only in (only_new, only_old)
        )
    else:
        from scipy.stats import hypergeom  # not at the top: it loads slowly, most runs are paired

        # Fisher's exact test: given all that are lost, how many of them are after's.
        runs = len(before) + len(after)
        p = float(hypergeom.sf(new - 1, runs, old + new, len(after)))
        p_better = float(hypergeom.sf(old - 1, runs, old + new, len(before)))
    return {
        "quantity": UNFINISHED,
        "before": float(old),
        "after": float(new),
        "runs_before": len(before),
        "runs": len(after),
        "paired": paired,
        "p": p,
        "p_better": p_better,
        "verdict": SAME if is_lost[0].equals(is_lost[1]) else UNDECIDED,
    }


def _missing(
    one: dict[tuple[str, ...], pd.DataFrame], other: dict[tuple[str, ...], pd.DataFrame]
) -> tuple[str, ...]:
    """Return descriptions of the groups of ``one`` that are missing in ``other``.

    An estimator, assumption or case that is missing as a whole has one description.
    """
    cases, estimators = {key[:2] for key in other}, {key[2] for key in other}
    assumptions = {key[0] for key in other}
    named: list[str] = []
    for assumption, case, estimator in (key for key in one if key not in other):
        where = f"case {case}" + (f" of assumption {assumption}" if assumption else "")
        if estimator not in estimators:
            named.append(f"estimator {estimator}")
        elif assumption and assumption not in assumptions:
            named.append(f"assumption {assumption}")
        elif (assumption, case) not in cases:
            named.append(where)
        else:
            named.append(f"estimator {estimator} in {where}")
    return tuple(dict.fromkeys(named))


def _content(table: pd.DataFrame) -> str:
    """Return a text with the cases and the estimators of a table of runs."""
    if table.empty:
        return "no runs"
    return " and ".join(
        f"the {title} {', '.join(map(str, table[column].unique()))}"
        for title, column in (("cases", "case"), ("estimators", "estimator"))
    )
