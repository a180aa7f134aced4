"""Numbers and labels for the answer at the top of a report page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import pandas as pd

from ..errors import brief
from ..judging.judgement import OUTSIDE
from ..judging.standing import standing
from ..judging.verdicts import FEWEST_RUNS
from . import published, sweeps, views
from .reported import Reported

MOST_OUTSIDE = 0.05
"""Largest share of runs outside the map for which an answer does not name the estimator."""
MOST_RECOVERED = 4
"""Largest number of estimators that an answer names with their largest σ/ℓ."""
MOST_OWN = 2
"""Largest number of the user's own estimators in an answer."""


def left_the_map(runs: pd.DataFrame) -> list[str]:
    """Return the estimators whose share of runs outside the map exceeds :data:`MOST_OUTSIDE`."""
    own = runs[runs["assumption"] == ""]
    shares = (own["remark"] == OUTSIDE).groupby(own["estimator"], sort=False).mean()
    return [str(label) for label in shares.index[shares > MOST_OUTSIDE]]


def named_among(
    recovered: Sequence[tuple[str, float]], own: Sequence[str]
) -> list[tuple[str, float]]:
    """Select the estimators for which an answer states the largest σ/ℓ.

    σ/ℓ is the initial position uncertainty in correlation lengths of the field. First, at most
    :data:`MOST_OWN` of the user's own estimators are selected. Then other estimators are added in
    the order of ``recovered``. In total at most :data:`MOST_RECOVERED` estimators are selected.

    Parameters
    ----------
    recovered : estimators and their largest σ/ℓ, from :func:`.sweeps.recovered`.
    own : the user's own estimators.
    """
    named = [label for label, _ in recovered if label in own][:MOST_OWN]
    for label, _ in recovered:
        if len(named) < MOST_RECOVERED and label not in named:
            named.append(label)
    return [(label, widest) for label, widest in recovered if label in named]


def failed_in_all(runs: pd.DataFrame, titles: Mapping[str, str]) -> list[dict[str, Any]]:
    """Return the estimators that failed in all runs of at least one case.

    Each item of the result has the ``label`` of an estimator. ``cases`` has the titles of the cases
    in which all its runs failed. ``reason`` is the reason of the first failed run in these cases.
    If the estimator failed in all runs of all cases, ``cases`` is empty.
    """
    own = runs[runs["assumption"] == ""]
    rows = []
    for label, flown in own.groupby("estimator", sort=False):
        failed = (flown["status"] != "ok").groupby(flown["case"], sort=False).all()
        cases = failed.index[failed].tolist()
        if cases:
            reason = flown.loc[flown["case"] == cases[0], "reason"].iloc[0]
            named = [] if failed.all() else [titles[case] for case in cases]
            rows.append({"label": label, "cases": named, "reason": brief(reason)})
    return rows


def leading(metrics: pd.DataFrame, cases: pd.DataFrame) -> str:
    """Return the estimator that is recommended in most cases.

    If several estimators are recommended equally often, a second criterion decides. It is the
    number of cases in which an estimator is the fastest of the recommended ones. If this number is
    zero for all of them, the least mean error ratio decides (:func:`.standing.standing`).

    Parameters
    ----------
    metrics : table of metrics of a scenario.
    cases : table of its cases; at least one case has a recommended estimator.
    """
    ranked = standing(metrics, cases)
    ranked = ranked[ranked["recommended_in"] == ranked["recommended_in"].iloc[0]]
    cheapest = cases.loc[cases["recommended"].isin(ranked["estimator"]), "recommended"]
    return str([*cheapest.value_counts().index, ranked["estimator"].iloc[0]][0])


def answer(results: Reported) -> dict[str, Any]:
    """Return the values for the template ``answer.j2``.

    - ``label``: the estimator that is recommended in most cases (:func:`leading`). If no case has a
      recommended estimator, it is the estimator that is best in the largest number of cases.
    - ``count``: number of cases in which ``label`` is recommended (or best).
    - ``cheapest``: number of cases in which it is the cheapest recommended estimator.
    - ``lead``: first case in which ``label`` is recommended (or best). Cases in the page's table
      have precedence over other cases. ``row``: metrics of ``label`` in this case.
    - ``reason``: reason why the first case without a recommended estimator has none.
    - ``own``: metrics of at most :data:`MOST_OWN` of the user's own estimators in the lead case,
      without ``label`` and without estimators that finished no run.
    """
    metrics, cases = results.metrics(), results.cases()
    recommended = cases["recommended"][cases["recommended"] != ""]
    named = cases["best"][cases["best"] != ""]
    sweep, of_the_prior = results.scenario.sweep, sweeps.is_of_the_prior(results.scenario)
    values: dict[str, Any] = {
        "total": len(cases),
        "recommended": len(recommended),
        "label": "",
        "own": [],
        "without": cases.loc[cases["recommended"] == "", "title"].tolist(),
        "reason": next((text for text in cases["not_recommended"] if text), ""),
        "inconsistent": views.not_consistent(metrics),
        "targets": sweeps.reached(results.scenario, metrics, cases, results.own),
        "axis": sweep.axes[0].label if sweep else "",
        "runs": int(metrics["runs"].max()) if len(metrics) else 0,
        "fewest": FEWEST_RUNS,
        "recovered": named_among(sweeps.recovered(metrics, cases), results.own)
        if of_the_prior
        else [],
        "outside": left_the_map(results.runs()),
        "allowed": published.allowed(metrics),
        "failed": failed_in_all(
            results.runs(), {row.case: row.title for row in cases.itertuples()}
        ),
    }
    if named.empty:
        return values
    settled = metrics[metrics["window"] == "settled"]
    if len(recommended):
        label = leading(metrics, cases)
        of_label = settled[settled["recommended"].astype(bool) & (settled["estimator"] == label)]
        leads = cases["case"].isin(of_label["case"])
    else:
        label = named.value_counts().index[0]
        leads = cases["best"] == label
    in_table = leads & cases["case"].isin(sweeps.shown_cases(results)["case"])
    lead = cases[in_table if in_table.any() else leads].iloc[0]
    settled = settled[settled["case"] == lead["case"]].set_index("estimator", drop=False)
    others = [one for one in results.own if one != label and one in settled.index]
    own = settled.loc[others].dropna(subset="rms_m")
    return values | {
        "label": label,
        "count": int(leads.sum()),
        "cheapest": int((cases.loc[leads, "recommended"] == label).sum()),
        "lead": lead.to_dict(),
        "row": settled.loc[label].to_dict(),
        "own": own.iloc[:MOST_OWN].to_dict("records"),
    }
