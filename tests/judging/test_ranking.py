"""Which estimator is the best: who may be, who is, and how two of them stand to each other."""

from __future__ import annotations

import math
from typing import Any

import pandas as pd
import pytest
from small_cases import small_case

from ggbench.judging.ranking import as_good, best_causal, consistent, pair_of, ranked, rows_of


def row(label: str, error: float, **changes: Any) -> dict[str, Any]:
    """A summary row of an estimator in 100 runs, all of which succeeded; the bound is 1 m."""
    return {
        "label": label, "case": "base", "window": "settled", "causality": "filter", "runs": 100,
        "failed": 0, "position_mrse_m": error, "ratio_median": error, "seconds_per_run": 1.0,
        "success_share": 1.0, "success_lo": 0.96, "success_hi": 1.0, "coverage": 0.95,
        "false_lock_share": math.nan,
    } | changes  # fmt: skip


def best(*rows: dict[str, Any]) -> str | None:
    found = best_causal(rows)
    return None if found is None else found["label"]


def test_the_best_is_the_causal_one_of_the_least_error():
    """Neither the INS nor a smoother, nor what has no figure."""
    others = row("ins", 0.1, causality="none"), row("late", 0.1, causality="batch")
    assert best(row("a", 3.0), row("b", 2.0), *others) == "b"
    assert best(row("a", 3.0), row("b", math.nan), row("c", math.inf)) == "a"
    assert best(*others) is None


def test_a_few_lost_runs_decide_nothing():
    """The median of those that succeed goes before the mean of all."""
    lost = row("lost", 50.0, ratio_median=1.0, success_share=0.99, success_lo=0.95)
    assert best(lost, row("whole", 2.0)) == "lost"


def test_of_equal_errors_the_cheaper_one_is_the_better():
    """Equal to three digits; a difference in the third one counts."""
    dear, cheap = row("dear", 2.001), row("cheap", 2.004, seconds_per_run=0.5)
    assert best(dear, cheap) == "cheap"
    assert best(dear, cheap | {"ratio_median": 2.016}) == "dear"
    assert list(ranked(pd.DataFrame([dear, cheap]))["label"]) == ["cheap", "dear"]


def test_who_fails_in_more_than_one_of_twenty_runs_is_not_the_best():
    """Five failures of a hundred are allowed, six are not."""
    sound = row("sound", 3.0)
    assert best(row("frail", 1.0, failed=5), sound) == "frail"
    assert best(row("frail", 1.0, failed=6), sound) == "sound"


def test_who_succeeds_surely_less_often_is_not_the_best():
    """Where the intervals of two shares overlap the smaller error decides, else the share."""
    sure = row("sure", 3.0, success_share=0.9, success_lo=0.82, success_hi=0.95)
    sharp = row("sharp", 1.0, success_share=0.78, success_lo=0.69)
    assert best(sharp | {"success_hi": 0.85}, sure) == "sharp"
    assert best(sharp | {"success_hi": 0.82}, sure) == "sharp"
    assert best(sharp | {"success_hi": 0.81}, sure) == "sure"
    table = pd.DataFrame([sharp | {"success_hi": 0.81}, sure, row("ins", 9.0, causality="none")])
    assert list(ranked(table)["label"]) == ["sure", "sharp", "ins"]


def test_what_claims_to_know_what_it_does_not_is_not_the_best():
    """Neither what is sure of a wrong place, nor what is often outside its own region.

    By what was found: few runs let nobody pass whom many would not.
    """
    sound = row("sound", 3.0)
    assert consistent(sound) and consistent(row("silent", 1.0, coverage=math.nan))
    liar = row("liar", 1.0, coverage=0.7)
    assert not consistent(row("few", 1.0, coverage=0.79, runs=20))
    assert not consistent(liar) and best(liar, sound) == "sound"
    assert best(liar | {"coverage": 0.8}, sound) == "liar"
    assert consistent(row("once", 1.0, false_lock_share=0.1, runs=10))  # a single one may be chance
    mistaken = row("mistaken", 1.0, false_lock_share=0.051)
    assert not consistent(mistaken) and best(mistaken, sound) == "sound"
    assert best(liar, mistaken | {"ratio_median": 2.0}) == "liar"  # where nobody is consistent


def test_one_of_few_runs_lets_in_nobody_who_succeeds_surely_less_often():
    """40 of 40 is 91 % at least, 199 of 200 is 97 %: who has 95 % at most is not the best."""
    few = row("few", 2.0, runs=40, success_lo=0.912)
    many = row("many", 1.2, runs=200, success_share=0.995, success_lo=0.972)
    seldom = row("seldom", 1.0, runs=200, success_share=0.92, success_lo=0.874, success_hi=0.95)
    assert best(few, many, seldom) == "many"
    assert best(few, many, seldom | {"success_hi": 0.98}) == "seldom"
    assert list(ranked(pd.DataFrame([few, seldom, many]))["label"]) == ["many", "few", "seldom"]


def test_what_got_fewer_runs_stands_behind_those_with_all():
    """In its own block: among filters, and not among smoothers."""
    rows = [
        row("few", 1.0, runs=40), row("all", 1.2),
        row("short", 1.0, runs=40, causality="batch"), row("ins", 9.0, causality="none"),
    ]  # fmt: skip
    assert list(ranked(pd.DataFrame(rows))["label"]) == ["all", "few", "ins", "short"]


def test_what_got_fewer_runs_is_the_best_only_alone():
    """Its median is of other runs than the others'; it may be found as good."""
    few = row("few", 1.0, runs=40)
    assert best(few, row("all", 1.2)) == "all"
    assert best(few, row("all", 1.2, coverage=0.5)) == "few"


@pytest.mark.parametrize(
    ("verdict", "changes", "wanted"),
    [
        ("as good", {"ratio_median": 9.0}, "yes"),
        ("worse", {}, "yes"),
        ("better", {"ratio_median": 1.0}, "no"),
        ("not distinguishable", {"ratio_median": 1.1}, "open"),
        ("not distinguishable", {"ratio_median": 1.11}, "no"),
        ("not distinguishable", {"success_hi": 0.95}, "no"),
        ("not distinguishable", {"ratio_median": 9.0, "error_ratio": 0.95}, "open"),
        ("not distinguishable", {"ratio_median": 1.0, "error_ratio": 0.9}, "no"),
        ("as good", {"failed": 6}, "no"),
    ],
)
def test_who_is_as_good_as_the_best(verdict, changes, wanted):
    """Found so run by run; or the runs are too few, and it may be: by the ratio of common runs."""
    other = row("other", 1.0) | changes
    pair = {"verdict": verdict} | {k: v for k, v in changes.items() if k == "error_ratio"}
    assert as_good(other, row("best", 1.0), pair) == wanted
    assert as_good(other, row("other", 1.0), None) == "yes"


def test_blocks_of_a_ranking():
    """Filters, the INS, fixed lags, batch solutions; within each the least error first."""
    rows = [
        row("batch", 1.0, causality="batch"), row("lag", 2.0, causality="fixed-lag"),
        row("ins", 0.1, causality="none"), row("worse", 9.0), row("better", 8.0),
        row("elsewhere", 1.0, case="noisy"), row("early", 1.0, window="whole"),
    ]  # fmt: skip
    found = rows_of(pd.DataFrame(rows), small_case(), "settled")
    assert list(found) == ["better", "worse", "ins", "lag", "batch"]
    assert found["worse"]["position_mrse_m"] == 9.0


def test_a_pair_is_swapped_in_all_of_its_figures():
    """Seen from the second: counts, differences, intervals, ratios, wins and verdicts."""
    pair = {
        "case": "c", "window": "settled", "first": "a", "second": "b", "runs": 9,
        "first_only": 2, "second_only": 5,
        "position_difference_m2": 4.0, "position_lo": 1.0, "position_hi": 6.0,
        "position_relative": 0.25, "position_win_rate": 0.3, "position_verdict": "worse",
        "velocity_difference_m2ps2": -2.0, "velocity_lo": -5.0, "velocity_hi": 1.0,
        "velocity_relative": -0.5, "velocity_win_rate": 0.6,
        "velocity_verdict": "not distinguishable",
        "both_succeeded": 8, "first_succeeded": 1, "second_succeeded": 3, "success_p": 0.6,
        "error_ratio": 2.0, "error_ratio_lo": 0.5, "error_ratio_hi": 4.0, "sign_p": 0.1,
        "verdict": "worse",
    }  # fmt: skip
    table = pd.DataFrame([pair, pair | {"window": "whole", "runs": 1}])
    assert pair_of(table, "c", "a", "b") == pair
    assert pair_of(table, "c", "b", "a") == pytest.approx({
        "case": "c", "window": "settled", "first": "b", "second": "a", "runs": 9,
        "first_only": 5, "second_only": 2,
        "position_difference_m2": -4.0, "position_lo": -6.0, "position_hi": -1.0,
        "position_relative": -0.2, "position_win_rate": 0.7, "position_verdict": "better",
        "velocity_difference_m2ps2": 2.0, "velocity_lo": -1.0, "velocity_hi": 5.0,
        "velocity_relative": 1.0, "velocity_win_rate": 0.4,
        "velocity_verdict": "not distinguishable",
        "both_succeeded": 8, "first_succeeded": 3, "second_succeeded": 1, "success_p": 0.6,
        "error_ratio": 0.5, "error_ratio_lo": 0.25, "error_ratio_hi": 2.0, "sign_p": 0.1,
        "verdict": "better",
    })  # fmt: skip
    assert pair_of(table, "c", "a", "b", "whole")["runs"] == 1
    assert pair_of(table, "d", "a", "b") is None
