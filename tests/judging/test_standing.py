"""Standing of estimators over cases: counts, ratios and order on hand numbers."""

from __future__ import annotations

import math

import pytest
from reporting import cases, metrics

from ggbench.judging.standing import STANDING, standing

ERRORS = {"ins": 9.0, "a": 2.0, "b": 2.0, "c": 4.0, "factor-graph[mode=batch]": 1.0}


def test_the_standing_counts_recommendations_not_the_cheapest_alone():
    """A and b are both recommended in both cases; b is cheaper; c is twice the best in one."""
    table = metrics(errors=ERRORS)
    settled = table["window"] == "settled"
    table["recommended"] = settled & table["estimator"].isin(["a", "b"])
    table.loc[table["estimator"] == "b", "seconds_per_run"] = 0.001
    table.loc[(table["estimator"] == "b") & (table["case"] == "c1"), "seconds_per_run"] = 0.004
    table.loc[(table["estimator"] == "c") & (table["case"] == "c1"), "rms_m"] = 4.0
    found = standing(table, cases(best="a"))
    assert tuple(found.columns) == STANDING
    assert found["estimator"].tolist() == ["b", "a", "c"]  # no INS, no smoother
    assert found["recommended_in"].tolist() == [2, 2, 0]
    assert found["cases_flown"].tolist() == [2, 2, 2]
    assert found["worst_ratio"].tolist() == pytest.approx([1.0, 1.0, 2.0])
    assert found.loc[0, ["least_seconds", "most_seconds"]].tolist() == [0.001, 0.004]
    assert found["mean_ratio"].tolist() == pytest.approx([1.0, 1.0, math.sqrt(2.0)])


def test_estimators_of_fewer_runs_do_not_stand():
    table = metrics(errors=ERRORS, runs={"c": 10})
    assert "c" not in set(standing(table, cases(best="a"))["estimator"])
