"""The numbers of a page's answer, for the sentences of its template."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pandas as pd

from ..errors import brief
from ..judging.judgement import OUTSIDE
from ..judging.standing import standing
from ..judging.verdicts import FEWEST_RUNS
from ..results.folder import Results
from . import published, sweeps, views

MOST_OUTSIDE = 0.05
"""Share of an estimator's runs that may leave the map before an answer says so."""


def left_the_map(runs: pd.DataFrame) -> list[str]:
    """Return the estimators of which more runs left the map than :data:`MOST_OUTSIDE`."""
    own = runs[runs["assumption"] == ""]
    shares = (own["remark"] == OUTSIDE).groupby(own["estimator"], sort=False).mean()
    return [str(label) for label in shares.index[shares > MOST_OUTSIDE]]


def failed_in_all(runs: pd.DataFrame, titles: Mapping[str, str]) -> list[dict[str, Any]]:
    """Return the estimators that failed in all runs of cases.

    ``label``; ``cases``, the titles of these cases, none if they are all cases; ``reason`` of the
    first of these failures.
    """
    own = runs[runs["assumption"] == ""]
    rows = []
    for label, flown in own.groupby("estimator", sort=False):
        failed = (flown["status"] != "ok").groupby(flown["case"], sort=False).all()
        lost = failed.index[failed].tolist()
        if lost:
            reason = flown.loc[flown["case"] == lost[0], "reason"].iloc[0]
            named = [] if failed.all() else [titles[case] for case in lost]
            rows.append({"label": label, "cases": named, "reason": brief(reason)})
    return rows


def answer(results: Results) -> dict[str, Any]:
    """Return what the template ``answer.j2`` states.

    ``label`` is the estimator recommended in most cases (:func:`.standing.standing`), else the
    best in most; ``row`` its metrics in the ``lead`` case, the first in which it is that;
    ``reason`` says why none is recommended in the first case without.
    """
    metrics, cases = results.metrics(), results.cases()
    recommended = cases["recommended"][cases["recommended"] != ""]
    named = cases["best"][cases["best"] != ""]
    sweep, of_the_prior = results.scenario.sweep, sweeps.is_of_the_prior(results.scenario)
    found: dict[str, Any] = {
        "total": len(cases),
        "recommended": len(recommended),
        "label": "",
        "without": cases.loc[cases["recommended"] == "", "title"].tolist(),
        "reason": next((text for text in cases["not_recommended"] if text), ""),
        "inconsistent": views.not_consistent(metrics),
        "targets": sweeps.reached(results.scenario, metrics, cases),
        "axis": sweep.axes[0].label if sweep else "",
        "runs": int(metrics["runs"].max()) if len(metrics) else 0,
        "fewest": FEWEST_RUNS,
        "recovered": sweeps.recovered(metrics, cases) if of_the_prior else [],
        "outside": left_the_map(results.runs()),
        "allowed": published.allowed(metrics),
        "failed": failed_in_all(
            results.runs(), {row.case: row.title for row in cases.itertuples()}
        ),
    }
    if named.empty:
        return found
    settled = metrics[metrics["window"] == "settled"]
    if len(recommended):
        label = standing(metrics, cases)["estimator"].iloc[0]
        of_label = settled[settled["recommended"].astype(bool) & (settled["estimator"] == label)]
        leads = cases["case"].isin(of_label["case"])
    else:
        label = named.value_counts().index[0]
        leads = cases["best"] == label
    lead = cases[leads].iloc[0]
    settled = settled[settled["case"] == lead["case"]]
    return found | {
        "label": label,
        "count": int(leads.sum()),
        "lead": lead.to_dict(),
        "row": settled[settled["estimator"] == label].iloc[0].to_dict(),
    }
