"""Ranking of causal estimators over the cases of a scenario."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .summary import SMOOTHERS

if TYPE_CHECKING:
    import pandas as pd

STANDING = (
    "estimator",
    "recommended_in",
    "cases_flown",
    "worst_ratio",
    "mean_ratio",
    "least_seconds",
    "most_seconds",
)
"""Columns of :func:`standing`."""


def standing(metrics: pd.DataFrame, cases: pd.DataFrame) -> pd.DataFrame:
    """Return a table with a row for each causal estimator except the INS.

    The columns are :data:`STANDING`. ``recommended_in`` is the number of cases in which the
    estimator is recommended. The error ratio of a case is the RMS error divided by the RMS error of
    the best estimator. ``worst_ratio`` and ``mean_ratio`` are the largest value and the geometric
    mean of the error ratios over the cases. ``least_seconds`` and ``most_seconds`` are the least
    and the largest median time per run [s] over the cases. The order is by number of
    recommendations, then mean ratio, then geometric mean of the times. A case is ignored for
    estimators that have fewer runs of it than others.

    Parameters
    ----------
    metrics : metrics of the scenario (:func:`.summary.metrics`), with recommendations.
    cases : table of the cases (:func:`.cases.cases`).
    """
    rows = metrics[
        (metrics["window"] == "settled")
        & ~metrics["causality"].isin(["none", *SMOOTHERS])
        & metrics["case"].isin(cases["case"])
    ]
    rows = rows[rows["runs"] == rows.groupby("case")["runs"].transform("max")]
    best = dict(zip(cases["case"], cases["best"], strict=True))
    least = rows[rows["estimator"] == rows["case"].map(best)].set_index("case")["rms_m"]
    logs = rows.assign(
        ratio=np.log(rows["rms_m"] / rows["case"].map(least).astype(float)),
        time=np.log(rows["seconds_per_run"]),
        recommended=rows["recommended"].astype(bool),
    )
    table = logs.groupby("estimator", sort=False).agg(
        recommended_in=("recommended", "sum"),
        cases_flown=("case", "count"),
        worst_ratio=("ratio", "max"),
        mean_ratio=("ratio", "mean"),
        least_seconds=("seconds_per_run", "min"),
        most_seconds=("seconds_per_run", "max"),
        time=("time", "mean"),
    )
    for key in ("worst_ratio", "mean_ratio"):
        table[key] = np.exp(table[key])
    order = ["recommended_in", "mean_ratio", "time"]
    ascending = [False, True, True]
    table = table.reset_index().sort_values(order, ascending=ascending, ignore_index=True)
    return table.drop(columns="time")
