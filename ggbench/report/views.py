"""Selections of the tables of metrics, pairs and cases for pages and figures.

``metrics``, ``pairs`` and ``cases`` are the tables of :class:`ggbench.results.folder.Results`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from ..judging.pairs import pair_of
from ..judging.verdicts import UnequalRunsError
from . import columns
from .tables import MOST_COLUMNS, MOST_ROWS, code, error_cell

MOST_CASES = 5
"""Largest number of cases in a table of a page."""
_FIXED_ROWS = 5
"""Rows of a table without the user's own estimators: bound, INS, EKF, recommended, smoother."""
MOST_DRAWN = 6
"""Largest number of estimators in a figure."""
ALIKE = 1.01
"""Largest ratio of errors for which estimators count as equal: they share a row or a rank."""
_OF_SEVERAL = {"recommended": "cheapest "}
"""Headings of a column that names another estimator in each case."""


def require_equal_runs(rows: pd.DataFrame) -> None:
    """Raise UnequalRunsError unless the rows of each case have equal numbers of runs."""
    for case, group in rows.groupby("case", sort=False):
        counts = group.set_index("estimator")["runs"]
        if counts.nunique() > 1:
            counted = ", ".join(f"{label}: {count}" for label, count in counts.items())
            raise UnequalRunsError(f"case {case} compares unequal runs ({counted})")


def comparable(metrics: pd.DataFrame, window: str = "settled") -> pd.DataFrame:
    """Return the metrics in a window, without estimators that lack runs of a case.

    An estimator is omitted only from the cases in which it has fewer runs than others. Its errors
    in these cases belong to another sample of runs.
    """
    rows = metrics[metrics["window"] == window]
    rows = rows[rows["runs"] == rows.groupby("case")["runs"].transform("max")]
    require_equal_runs(rows)
    return rows


def left_out(metrics: pd.DataFrame, cases: pd.DataFrame) -> list[str]:
    """Return the estimators that have fewer runs than others in every case that they flew."""
    rows = metrics[(metrics["window"] == "settled") & metrics["case"].isin(cases["case"])]
    comparable_labels = comparable(rows)["estimator"]
    return [label for label in rows["estimator"].unique() if label not in set(comparable_labels)]


def below_bound(metrics: pd.DataFrame, cases: pd.DataFrame) -> bool:
    """Return whether any error is significantly below a bound.

    Two kinds of errors are not tested: those that are compared with the oracle, and those of batch
    smoothers. The bound is an expectation over the specified error statistics. Measured
    data, a single gravity field or few runs can therefore have an error below the bound.
    """
    rows = metrics[(metrics["window"] == "settled") & metrics["case"].isin(cases["case"])]
    rows = rows[rows["efficiency"].isna() & (rows["causality"] != "batch")]
    return bool((rows["rms_hi"] < rows["bound_m"]).any())


def deciding_cases(
    metrics: pd.DataFrame, cases: pd.DataFrame, most: int = MOST_CASES
) -> pd.DataFrame:
    """Return at most ``most`` cases that distinguish estimators, in the scenario's order.

    The ratio of a case is the largest RMS error of a causal estimator divided by the least one.
    Cases with the same recommended estimators form a group. First the case with the largest ratio
    in each group is chosen. Remaining places go to the other cases with the largest ratios.
    """
    if len(cases) <= most:
        return cases
    rows = comparable(metrics[metrics["case"].isin(cases["case"])])
    rows = rows[rows["causality"] == "filter"]
    errors = rows.groupby("case")["rms_m"]
    spread = (errors.max() / errors.min()).reindex(cases["case"]).fillna(1.0)
    chosen = rows[rows["recommended"].astype(bool)].groupby("case")["estimator"].agg(frozenset)
    ordered = spread.sort_values(ascending=False, kind="stable").index
    verdicts = [chosen.get(name, frozenset()) for name in ordered]
    again = pd.Series(verdicts, index=ordered).duplicated()
    decisive = [*ordered[~again], *ordered[again]][:most]
    return cases[cases["case"].isin(decisive)]


def few_cases(cases: pd.DataFrame, most: int = MOST_CASES) -> pd.DataFrame:
    """Return at most ``most`` cases, evenly spread in the scenario's order.

    The first and the last case are included.
    """
    if len(cases) <= most:
        return cases
    return cases.iloc[np.unique(np.linspace(0, len(cases) - 1, most).round().astype(int))]


def answer_table(
    metrics: pd.DataFrame, pairs: pd.DataFrame, cases: pd.DataFrame, own: Sequence[str] = ()
) -> pd.DataFrame:
    """Return a table with bound, INS, EKF, recommended estimator and best smoother by case.

    Of several recommended estimators the fastest is shown. If none is recommended, the best causal
    estimator is shown. Each of the first five of the user's own estimators has a column. If the
    table has too many columns, it is transposed: it then has a column for each case and a row for
    each estimator.
    """
    causal = [case["recommended"] or case["best"] for case in cases.to_dict("records")]
    plain = (cases["recommended"] != "").to_numpy()
    kind = "recommended" if plain.any() else "least bad"
    if plain.any() and not plain.all():
        kind = "recommended or *least bad*"
    named = {kind: causal, "smoother": cases["best_smoother"].tolist()}
    single = {key: len(set(labels)) == 1 and bool(labels[0]) for key, labels in named.items()}
    heads = {
        key: f"{code(labels[0])} ({key})"
        if single[key]
        else _OF_SEVERAL.get(key.split()[0], "") + key
        for key, labels in named.items()
    }
    fixed = {"EKF": "ekf"} | {code(label): label for label in own[: MOST_ROWS - _FIXED_ROWS]}
    rows = []
    for number, case in enumerate(cases.to_dict("records")):
        cells = _Cells(case["case"], metrics, pairs)
        row = {
            "case": case["title"],
            "bound_m": case["bound_m"],
            "INS": cells.of("ins"),
        } | {head: cells.of(label) for head, label in fixed.items()}
        for key, labels in named.items():
            label = labels[number]
            text = cells.of(label)
            if alike := bool(label) and cells.alike(label, "ekf"):
                text = "EKF" if label == "ekf" else "≈ EKF"
            if label not in ("", "ekf") and not single[key]:
                text = f"{code(label)} ({text})" if alike else f"{code(label)} {text}"
            causal_one = key == kind and not case["recommended"] and text != columns.NONE
            row[heads[key]] = f"*{text}*" if causal_one else text
        rows.append(row)
    table = pd.DataFrame(rows)
    for head, label in fixed.items():
        for key in (key for key, labels in named.items() if set(labels) == {label}):
            if key == kind:
                table[head] = table[head].where(plain, "*" + table[head] + "*")
            table = table.drop(columns=heads[key]).rename(columns={head: f"{head} ({key})"})
    empty = [key for key in table if table[key].eq(columns.NONE).all()]
    table = table.drop(columns=empty)
    return table if len(table.columns) <= MOST_COLUMNS else _transposed(table)


def _transposed(table: pd.DataFrame) -> pd.DataFrame:
    """Transpose a table of cases: return a column for each case, and a row for each quantity."""
    bounds = [columns.cell("bound_m", value) for value in table["bound_m"]]
    turned = table.assign(bound_m=bounds).rename(columns={"bound_m": "bound"}).set_index("case").T
    return turned.rename_axis("RMS error [m]").rename_axis(None, axis=1).reset_index()


class _Cells:
    """Cells of one case.

    Parameters
    ----------
    case : name of the case.
    metrics, pairs : tables of the scenario.
    """

    def __init__(self, case: str, metrics: pd.DataFrame, pairs: pd.DataFrame) -> None:
        own = metrics[(metrics["case"] == case) & (metrics["window"] == "settled")]
        self.case = case
        self.rows = {row["estimator"]: row for row in own.to_dict("records")}
        self.most = own["runs"].max() if len(own) else 0
        self.pairs = pairs

    def of(self, label: str) -> str:
        """Return the error of an estimator as text; with fewer runs, the ratio to the EKF."""
        row = self.rows.get(label)
        if row is None:
            return columns.NONE
        if row["runs"] == self.most:
            return error_cell(row)
        pair = pair_of(self.pairs, self.case, label, "ekf")
        if pair is None or pd.isna(pair["error_ratio"]):
            return columns.marked(f"{row['runs']} runs", row["consistency"])
        text = f"{columns.ratio(pair['error_ratio'])} × EKF ({pair['runs']:.0f} runs)"
        return columns.marked(text, row["consistency"])

    def alike(self, label: str, other: str) -> bool:
        """Return whether the cells of two estimators are equal, with errors equal within 1%."""
        one, two = self.rows.get(label), self.rows.get(other)
        if one is None or two is None or one["runs"] != two["runs"]:
            return False
        same = (one["success"], one["consistency"]) == (two["success"], two["consistency"])
        return same and 1.0 / ALIKE <= one["rms_m"] / two["rms_m"] <= ALIKE


def drawn_estimators(
    metrics: pd.DataFrame, cases: pd.DataFrame, own: Sequence[str] = (), most: int = MOST_DRAWN
) -> list[str]:
    """Return at most ``most`` estimators to draw in a figure.

    The order is: the EKF, the user's own estimators, the recommended and best estimators of the
    cases, then all others. The others are sorted by the geometric mean of error / bound over the
    cases, least first. Three kinds of estimators are not drawn:

    - The INS.
    - Estimators that have all runs in fewer of the ``cases`` than another estimator.
    - Of several parameter sets of one estimator with the same causality, all but the first in this
      order. This rule does not apply to the user's own estimators.
    """
    rows = comparable(metrics[metrics["case"].isin(cases["case"])])
    rows = rows[rows["causality"] != "none"]
    rows = rows.assign(merit=np.log(rows["rms_m"] / rows["bound_m"]))
    table = rows.groupby("estimator", sort=False).agg(
        merit=("merit", "mean"), count=("case", "count"), causality=("causality", "first")
    )
    table = table[table["count"] == table["count"].max()]
    named = ["ekf", *own]
    for key in ("recommended", "best", "best_smoother"):
        named += cases[key].value_counts().index.tolist()
    labels = [label for label in dict.fromkeys(named) if label in table.index]
    order = [*labels, *table.sort_values("merit").index]
    drawn: dict[tuple[str, str], str] = {}
    for label in dict.fromkeys(order):
        kind = label if label in own else label.partition("[")[0], table.loc[label, "causality"]
        drawn.setdefault(kind, label)
    return list(drawn.values())[:most]


def together(labels: Sequence[str], values: pd.DataFrame) -> list[list[str]]:
    """Group estimators whose numbers agree within 1%, in the given order.

    Parameters
    ----------
    labels : labels of the estimators.
    values : positive numbers, with a row for each estimator and a column for each number.
    """
    groups: list[list[str]] = []
    logs = np.log(values.loc[list(labels)])
    for label in labels:
        for group in groups:
            gap = (logs.loc[label] - logs.loc[group[0]]).abs()
            if gap.max() <= np.log(ALIKE) and not gap.isna().any():
                group.append(label)
                break
        else:
            groups.append([label])
    return groups


def not_consistent(metrics: pd.DataFrame) -> list[str]:
    """Return causal estimators that are overconfident or unsafe in any case.

    The estimator with the largest number of such cases comes first.
    """
    rows = metrics[(metrics["window"] == "settled") & (metrics["causality"] == "filter")]
    marked = rows[rows["consistency"].isin(list(columns.SYMBOLS))]
    return marked["estimator"].value_counts().index.tolist()
