"""What is said beside published numbers: which are reached, over which part of the flight."""

from __future__ import annotations

import math

import pandas as pd
import pytest

from ggbench.report.published_section import beside_published, frameworks


def summary(settled: float, whole: float, *further: dict) -> pd.DataFrame:
    """Rows of one estimator that has these errors [m], and half of them in m/s; of 3 m, 1.5 m/s."""
    row = {
        "case": "c", "label": "ekf", "causality": "filter", "runs": 60, "failed": 0, "diverged": 0,
        "paper_position_m": 3.0, "paper_velocity_mps": 1.5, "ratio_median": 0.9,
    }  # fmt: skip
    rows = [
        row | {"window": window, "position_mrse_m": error, "velocity_mrse_mps": 0.5 * error}
        for window, error in (("settled", settled), ("whole", whole))
    ]
    return pd.DataFrame([*rows, *(rows[0] | other for other in further)])


@pytest.mark.parametrize(
    ("settled", "whole", "told"),
    [
        (3.0, 3.0, "every causal estimator (`ekf`) is at or below the paper's 2 numbers in the "
                   "settled window; over the whole flight the best of them reach all, too;"),
        (2.0, 4.0, "is at or below the paper's 2 numbers in the settled window; over the whole "
                   "flight nobody reaches 2 of these (4.00 m for 3.00, 2.00 m/s for 1.50"),
        (3.1, 2.0, "At 60 runs per case no causal estimator is at or below"),
        (math.nan, 2.0, "no causal estimator is at or below"),
    ],
)  # fmt: skip
def test_which_published_numbers_are_reached(settled, whole, told):
    """In the settled window by everybody, some or nobody; over the whole flight by the best."""
    text = beside_published(summary(settled, whole))
    assert told in text
    assert text.endswith("0.90 to 0.90 times the Cramér–Rao bound; no runs failed or diverged.**")


def test_who_falls_short_is_named_and_few_lucky_runs_reach_nothing_for_all():
    """One above the number is named; one of fewer runs does not speak for the whole flight."""
    late = {"label": "slow", "position_mrse_m": 9.0, "diverged": 2}
    few = {"label": "few", "window": "whole", "runs": 10, "position_mrse_m": 0.1}
    text = beside_published(summary(2.0, 4.0, late, few))
    assert "not every causal estimator (not `slow` in c) is" in text
    assert "nobody reaches 2 of these (4.00 m for 3.00" in text
    assert text.endswith("; 2 runs failed or diverged.**")


def test_without_a_filter_or_a_published_number_nothing_is_said():
    table = summary(2.0, 2.0)
    assert beside_published(table.assign(causality="batch")) == ""
    assert beside_published(table.assign(paper_position_m=math.nan)) == ""
    nobody = beside_published(table.assign(ratio_median=math.nan))
    assert "; no run succeeds; no runs failed" in nobody


def test_times_of_frameworks_are_set_apart_from_compiled_ones():
    """Only where there are some."""
    text = frameworks(["ins", "ekf", "filterpy-ukf[points=merwe]", "gtsam"])
    assert "`filterpy-ukf[points=merwe]`, `gtsam` call a framework" in text
    assert "ekf`" not in text
    assert frameworks(["ins", "ekf", "mine.py"]) == ""
