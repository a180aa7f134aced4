"""Standing of estimators over the cases of a scenario."""

from __future__ import annotations

import math
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
    "seconds_per_run",
)
"""Columns of :func:`standing`."""


def standing(metrics: pd.DataFrame, cases: pd.DataFrame) -> pd.DataFrame:
    """Return a row for each causal estimator but the INS, with :data:`STANDING`.

    ``recommended_in``: the number of cases in which it is recommended; ``worst_ratio``,
    ``mean_ratio``: largest and geometric mean of its RMS error over that of the best estimator of a
    case; ``seconds_per_run``: the geometric mean. Those recommended most often come first, then
    those of the least mean ratio, then the cheapest. Only estimators that flew all runs of a case
    count in it.

    Parameters
    ----------
    metrics : of the scenario (:func:`.summary.metrics`), with recommendations.
    cases : of the scenario (:func:`.cases.cases`).
    """
    import pandas as pd

    rows = metrics[
        (metrics["window"] == "settled")
        & ~metrics["causality"].isin(["none", *SMOOTHERS])
        & metrics["case"].isin(cases["case"])
    ]
    rows = rows[rows["runs"] == rows.groupby("case")["runs"].transform("max")]
    best = {(case["case"], case["best"]): case["case"] for case in cases.to_dict("records")}
    named = zip(rows["case"], rows["estimator"], rows["rms_m"], strict=True)
    least = {best[case, label]: rms for case, label, rms in named if (case, label) in best}
    ratios = rows["rms_m"] / rows["case"].map(least).astype(float)
    logs = rows.assign(ratio=np.log(ratios.fillna(math.inf)), time=np.log(rows["seconds_per_run"]))
    found = []
    for label, own in logs.groupby("estimator", sort=False):
        time = float(own["time"].mean())
        found.append(
            {
                "estimator": label,
                "recommended_in": int(own["recommended"].astype(bool).sum()),
                "cases_flown": len(own),
                "worst_ratio": math.exp(own["ratio"].max()),
                "mean_ratio": math.exp(own["ratio"].mean()),
                "seconds_per_run": math.exp(time),
            }
        )
    table = pd.DataFrame(found, columns=[*STANDING])
    order = ["recommended_in", "mean_ratio", "seconds_per_run"]
    return table.sort_values(order, ascending=[False, True, True], kind="stable", ignore_index=True)
