"""Numbers of the league, and the table of errors: ratios, lost and failed runs, equal runs."""

from __future__ import annotations

import math

import pandas as pd
import pytest
from reporting import cases, metrics

from ggbench.report.league import errors, league

LABELS = ["ins", "ekf", "ukf", "gaussian-sum", "factor-graph[mode=batch]"]


def planted() -> pd.DataFrame:
    """The case c1 has a wrong model; the UKF is lost in c0, the Gaussian sum failed in c1."""
    table = metrics()
    wrong, lost = table["case"] == "c1", (table["case"] == "c0") & (table["estimator"] == "ukf")
    table.loc[wrong, "efficiency"] = math.nan
    table.loc[lost, ["lost", "consistency"]] = [38, "unsafe"]
    gone = wrong & (table["estimator"] == "gaussian-sum")
    table.loc[gone, "failed"] = 40
    table.loc[gone, ["rms_m", "bound_m", "consistency"]] = [math.nan, math.nan, ""]
    table.loc[wrong & (table["estimator"] == "ekf"), "consistency"] = "overconfident"
    return table


def test_cells_are_over_the_oracle_else_over_the_bound():
    """Of the EKF 5 m over 4 m, in both cases; lost runs are infinite, failed ones have no ratio."""
    found = league(planted(), cases())
    assert list(found.estimators) == LABELS and found.smoothers == 1
    assert found.ratios[:, 1].tolist() == [1.25, 1.25]
    assert found.ratios[0, 2] == math.inf and math.isnan(found.ratios[1, 3])
    assert found.texts.tolist() == [
        ["25", "1.25", "lost\n95%‡", "1.00", "1.00"],
        ["25", "1.25†", "1.26", "failed", "1.00"],
    ]
    assert found.framed.tolist() == [[False, True, False, False, False]] * 2
    assert list(found.cases) == ["case 0 (4.00\u00a0m)", "case 1 (8.00\u00a0m)"]


def test_the_oracle_comes_before_the_bound():
    """An error of 5 m is 1.25 × bound; planted 1.02 × oracle."""
    table = metrics()
    table.loc[table["estimator"] == "ekf", "efficiency"] = 1.02
    assert league(table, cases()).texts[0, 1] == "1.02"


def test_the_profile_is_of_filters_with_all_runs():
    """Not of smoothers. The best of c0 has 4 m; with fewer runs it is not in the profile."""
    found = league(metrics(), cases()).to_best
    assert set(found) == set(LABELS) - {"factor-graph[mode=batch]"}
    assert found["ekf"].tolist() == pytest.approx([1.25, 1.25])
    fewer = league(metrics(runs={"gaussian-sum": 10}), cases()).to_best
    assert fewer["gaussian-sum"].tolist() == pytest.approx([math.nan] * 2, nan_ok=True)
    assert fewer["ekf"].tolist() == pytest.approx([1.0, 1.0])


def test_the_table_of_errors_has_a_row_for_each_case():
    """Estimators with fewer runs have their number, failed ones a word."""
    table = errors(planted(), cases())
    assert list(table) == ["case", "title", "bound_m", *LABELS]
    assert table["ekf"].tolist() == ["5.00 (×1.25)", "10.0 †"]
    assert table["ukf"].tolist() == ["lost 95% ‡", "10.1"]
    assert table["gaussian-sum"].tolist() == ["4.00 (×1.00)", "failed"]
    fewer = errors(metrics(runs={"ukf": 10}), cases())
    assert fewer["ukf"].tolist() == ["5.04 (×1.26) (10 runs)", "10.1 (×1.26) (10 runs)"]
