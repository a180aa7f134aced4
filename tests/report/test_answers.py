"""The answer of a page names the estimator that is recommended most often, not the cheapest."""

from __future__ import annotations

import pandas as pd
from reporting import cases, metrics, scenario

from ggbench.report.answers import answer


def stated(**changes):
    """The answer of two cases in which three filters are recommended, the Gaussian sum in both."""
    table = metrics()
    settled = table["window"] == "settled"
    among = {"c0": ["ekf", "gaussian-sum"], "c1": ["ukf", "gaussian-sum"]}
    for case, labels in among.items():
        own = settled & (table["case"] == case)
        table.loc[own, "recommended"] = table.loc[own, "estimator"].isin(labels)
    named = cases().assign(**({"recommended": ["ekf", "ukf"]} | changes))
    runs = pd.DataFrame(
        {"assumption": [""], "estimator": ["ekf"], "remark": [""], "status": ["ok"], "case": ["a"]}
    )
    return answer(
        scenario(scenario=scenario(), metrics=lambda: table, cases=lambda: named, runs=lambda: runs)
    )


def test_the_answer_counts_all_recommendations():
    """The cheapest of each case is another one, each of one case."""
    found = stated()
    assert (found["label"], found["count"], found["recommended"]) == ("gaussian-sum", 2, 2)
    assert found["lead"]["case"] == "c0" and found["row"]["rms_m"] == 4.0


def test_without_a_recommendation_the_answer_says_why():
    found = stated(recommended=["", ""], not_recommended=["", "none is consistent"])
    assert (found["label"], found["recommended"]) == ("gaussian-sum", 0)
    assert found["reason"] == "none is consistent"
