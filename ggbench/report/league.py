"""League of estimators over the cases of a scenario: content of the figure, and a table."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from ..figures.league import League
from ..judging.summary import SMOOTHERS
from . import columns, tables

CAPTION = "League of the estimators"
EXPLANATION = "Lower panel: share of cases with an RMS error up to x times the best filter's."
"""Words below the figure."""


def league(metrics: pd.DataFrame, cases: pd.DataFrame) -> League:
    """Return the content of the league figure for the settled window.

    A cell has the ratio of the RMS error to that of the oracle, or to the bound if there is no
    oracle. If most runs are lost, the cell has the share of lost runs. Estimators are in the order
    of the metrics, with smoothers last. The performance profile has the causal estimators. For each
    case it uses only the estimators with all runs of this case.

    Parameters
    ----------
    metrics : metrics of the scenario (:func:`.judging.summary.metrics`).
    cases : table of the cases (:func:`.judging.cases.cases`).
    """
    rows = metrics[(metrics["window"] == "settled") & metrics["case"].isin(cases["case"])]
    late = rows.groupby("estimator", sort=False)["causality"].first().isin(SMOOTHERS)
    labels = [*late.index[~late], *late.index[late]]
    cells = rows.set_index(["case", "estimator"]).to_dict("index")
    flown = [case for case in cases.to_dict("records") if case["case"] in set(rows["case"])]
    names = [case["case"] for case in flown]
    grid = [[cells.get((name, label)) for label in labels] for name in names]
    most = rows.groupby("case")["runs"].max()
    squares = {
        label: np.array([_of_all_runs(cells.get((name, label)), most[name]) for name in names])
        for label in late.index[~late]
    }
    least = np.fmin.reduce([*squares.values(), np.full(len(names), math.nan)])
    return League(
        cases=[
            f"{case['title']} ({columns.cell('bound_m', case['bound_m'])}\N{NO-BREAK SPACE}m)"
            for case in flown
        ],
        estimators=labels,
        smoothers=int(late.sum()),
        ratios=np.array([[ratio_of(cell) for cell in row] for row in grid]),
        texts=np.array([[_text(cell) for cell in row] for row in grid]),
        framed=np.array(
            [[cell is not None and bool(cell["recommended"]) for cell in row] for row in grid]
        ),
        to_best={label: errors / least for label, errors in squares.items()},
    )


def _of_all_runs(cell: Mapping[str, Any] | None, most: int) -> float:
    """Return the RMS error [m] of an estimator with all runs of a case, else NaN."""
    return math.nan if cell is None or cell["runs"] < most else float(cell["rms_m"])


def ratio_of(cell: Mapping[str, Any] | None) -> float:
    """Return the ratio of an RMS error to that of the oracle, or to the bound without an oracle.

    The ratio is infinite if most runs are lost.
    """
    if cell is None or cell["failed"] == cell["runs"]:
        return math.nan
    if tables.is_lost(cell):
        return math.inf
    over_oracle = float(cell["efficiency"])
    return over_oracle if math.isfinite(over_oracle) else float(cell["rms_m"] / cell["bound_m"])


def _text(cell: Mapping[str, Any] | None) -> str:
    """Return the text of a cell."""
    if cell is None:
        return columns.NONE
    if cell["failed"] == cell["runs"]:
        return "failed"
    if tables.is_lost(cell):
        share = columns.share(cell["lost"] / cell["runs"])
        return columns.marked(f"lost\n{share}", cell["consistency"]).replace(" ", "")
    ratio = ratio_of(cell)
    if math.isnan(ratio):
        return columns.NONE
    text = columns.efficiency(ratio) if ratio < 999.5 else ">999"
    return columns.marked(text, cell["consistency"]).replace(" ", "")


def errors(metrics: pd.DataFrame, cases: pd.DataFrame) -> pd.DataFrame:
    """Return a table of errors with a row for each case and a column for each estimator.

    Cells are made by :func:`.tables.error_cell` for the settled window. If an estimator has fewer
    runs than others, the cell states the number of runs.
    """
    rows = metrics[(metrics["window"] == "settled") & metrics["case"].isin(cases["case"])]
    most = rows["case"].map(rows.groupby("case")["runs"].max())
    texts = [tables.error_cell(row) for row in rows.to_dict("records")]
    fewer = [
        f" ({count} runs)" if count < of else ""
        for count, of in zip(rows["runs"], most, strict=True)
    ]
    cells = rows.assign(cell=[text + more for text, more in zip(texts, fewer, strict=True)])
    wide = cells.pivot(index="case", columns="estimator", values="cell")
    order = [name for name in cases["case"] if name in wide.index]
    wide = wide.loc[order, rows["estimator"].unique()].fillna("")
    about = cases.set_index("case").loc[order, ["title", "bound_m"]]
    return pd.concat([about, wide], axis=1).reset_index()
