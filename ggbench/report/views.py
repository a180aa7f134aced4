"""Views of the three tables of a scenario: data frames in, data frames out.

``metrics``, ``pairs`` and ``cases`` are those of :class:`ggbench.results.folder.Results`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from ..judging.pairs import pair_of
from ..judging.verdicts import UnequalRunsError
from . import columns
from .tables import code, error_cell

MOST_CASES = 5
"""Cases of a page's table."""
MOST_DRAWN = 6
"""Estimators of a figure."""
ALIKE = 1.01
"""Ratio of errors up to which estimators share a row."""


def require_equal_runs(rows: pd.DataFrame) -> None:
    """Raise UnequalRunsError unless the rows of each case have equal numbers of runs."""
    for case, group in rows.groupby("case", sort=False):
        counts = group.set_index("estimator")["runs"]
        if counts.nunique() > 1:
            found = ", ".join(f"{label}: {count}" for label, count in counts.items())
            raise UnequalRunsError(f"case {case} compares unequal runs ({found})")


def comparable(metrics: pd.DataFrame, window: str = "settled") -> pd.DataFrame:
    """Return the rows of a window that are of all runs of their case.

    Estimators with fewer runs are left out: their errors are of another sample.
    """
    rows = metrics[metrics["window"] == window]
    rows = rows[rows["runs"] == rows.groupby("case")["runs"].transform("max")]
    require_equal_runs(rows)
    return rows


def left_out(metrics: pd.DataFrame, cases: pd.DataFrame) -> list[str]:
    """Return the estimators that flew fewer runs than others of a case, and are not compared."""
    rows = metrics[(metrics["window"] == "settled") & metrics["case"].isin(cases["case"])]
    kept = comparable(rows)["estimator"]
    return [label for label in rows["estimator"].unique() if label not in set(kept)]


def below_bound(metrics: pd.DataFrame, cases: pd.DataFrame) -> bool:
    """Return whether an error is surely below a bound, which is then not that of the truth."""
    rows = metrics[(metrics["window"] == "settled") & metrics["case"].isin(cases["case"])]
    rows = rows[rows["efficiency"].isna() & (rows["causality"] != "batch")]
    return bool((rows["rms_hi"] < rows["bound_m"]).any())


def few_cases(cases: pd.DataFrame, most: int = MOST_CASES) -> pd.DataFrame:
    """Return at most so many cases, evenly spread in the order of the file, both ends included."""
    if len(cases) <= most:
        return cases
    return cases.iloc[np.unique(np.linspace(0, len(cases) - 1, most).round().astype(int))]


def answer_table(metrics: pd.DataFrame, pairs: pd.DataFrame, cases: pd.DataFrame) -> pd.DataFrame:
    """Return the page's table: bound, INS, EKF, recommended and best smoother of each case."""
    causal = [case["recommended"] or case["best"] for case in cases.to_dict("records")]
    named = {"recommended": causal, "best smoother": cases["best_smoother"].tolist()}
    heads = {
        key: f"{key}: {code(labels[0])}" if len(set(labels)) == 1 and labels[0] else key
        for key, labels in named.items()
    }
    rows = []
    for number, case in enumerate(cases.to_dict("records")):
        cells = _Cells(case["case"], metrics, pairs)
        row = {
            "case": case["title"],
            "bound_m": case["bound_m"],
            "INS": cells.of("ins"),
            "EKF": cells.of("ekf"),
        }
        for key, labels in named.items():
            text = cells.of(labels[number])
            if labels[number] and cells.alike(labels[number], "ekf"):
                text = "= EKF"
            if labels[number] not in ("", "ekf") and heads[key] == key:
                text = f"{code(labels[number])} {text}"
            plain = key != "recommended" or case["recommended"] or text == columns.NONE
            row[heads[key]] = text if plain else f"*{text}*"
        rows.append(row)
    table = pd.DataFrame(rows)
    empty = [key for key in table if table[key].eq(columns.NONE).all()]
    table = table.drop(columns=empty)
    if set(causal) == {"ekf"}:
        table = table.drop(columns=heads["recommended"])
        plain = (cases["recommended"] != "").to_numpy()
        table["EKF"] = table["EKF"].where(plain, "*" + table["EKF"] + "*")
        kind = "recommended" if plain.any() else "best"
        table = table.rename(columns={"EKF": f"EKF ({kind})"})
    return table


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
        """Return the error of an estimator; with fewer runs, its ratio to the EKF's."""
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
        """Return whether the cells of two estimators agree, errors within 1%."""
        one, two = self.rows.get(label), self.rows.get(other)
        if one is None or two is None or one["runs"] != two["runs"]:
            return False
        same = (one["success"], one["consistency"]) == (two["success"], two["consistency"])
        return same and 1.0 / ALIKE <= one["rms_m"] / two["rms_m"] <= ALIKE


def drawn_estimators(
    metrics: pd.DataFrame, cases: pd.DataFrame, most: int = MOST_DRAWN
) -> list[str]:
    """Return the estimators of a figure: the EKF, those that a table names, then the best ones.

    Of each name and causality one is drawn, with the least mean logarithm of error over the bound.
    Only estimators that flew all runs of every case shown count.
    """
    rows = comparable(metrics[metrics["case"].isin(cases["case"])])
    rows = rows[rows["causality"] != "none"]
    rows = rows.assign(merit=np.log(rows["rms_m"] / rows["bound_m"]))
    table = rows.groupby("estimator", sort=False).agg(
        merit=("merit", "mean"), count=("case", "count"), causality=("causality", "first")
    )
    table = table[table["count"] == table["count"].max()]
    named = ["ekf"]
    for key in ("recommended", "best", "best_smoother"):
        named += cases[key].value_counts().index.tolist()
    wanted = [label for label in dict.fromkeys(named) if label in table.index]
    order = [*wanted, *table.sort_values("merit").index]
    drawn: dict[tuple[str, str], str] = {}
    for label in dict.fromkeys(order):
        kind = label.partition("[")[0], table.loc[label, "causality"]
        drawn.setdefault(kind, label)
    return list(drawn.values())[:most]


def together(labels: Sequence[str], values: pd.DataFrame) -> list[list[str]]:
    """Return groups of estimators whose numbers agree within 1%, in the order given.

    Parameters
    ----------
    labels : estimators.
    values : their positive numbers: a row for each estimator, a column for each number.
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
    """Return causal estimators that are overconfident or unsafe in any case, most often first."""
    rows = metrics[(metrics["window"] == "settled") & (metrics["causality"] == "filter")]
    marked = rows[rows["consistency"].isin(list(columns.SYMBOLS))]
    return marked["estimator"].value_counts().index.tolist()
