"""The answer that a report begins with, from runs that are made up."""

from __future__ import annotations

import math
import re
from typing import Any

import numpy as np
import pandas as pd
import pytest
from leagues import dishonest
from summaries import RUNS, SAME, case, records, tabled

from ggbench.figures.numbers import short
from ggbench.report import opening, outcome
from ggbench.spec import scenario

INS = records("ins", 1e4 * SAME, "none")
MEDIAN = float(np.median(np.sqrt(SAME)))
"""Median error of SAME [m], beside a bound of 1 m."""


def told(*groups: list[dict[str, Any]]) -> str:
    return opening.case_answer(outcome.outcome(case(), *tabled(*groups)))


def part(text: str, beginning: str) -> str:
    """What is said after some words, up to the next semicolon."""
    (found,) = (p for p in text.rstrip(".").split("; ") if p.startswith(beginning))
    return found.removeprefix(beginning)


def test_aiding_that_gains_is_said_with_its_figures():
    """Success with its interval, median over bound, its 95th percentile, and what the INS has."""
    text = told(INS, records("good", 4.0 * SAME), records("later", SAME, "batch"))
    p95 = 2.0 * float(np.percentile(np.sqrt(SAME), 95.0))
    assert text.startswith(
        f"`good` succeeds in 100 % [94 %, 100 %] of 60 runs, and where it does has "
        f"{short(2.0 * MEDIAN)} times the bound of 1.00 m (median; 95 % of them below "
        f"{short(p95)}); the INS alone has {short(100.0 * MEDIAN)} m (median)"
    )
    assert text.endswith("; no run failed or diverged.")
    assert "later" not in text


def test_the_others_are_told_by_what_sets_them_apart():
    """As good, too few runs, farther off, seldom successful, not to be trusted: each once."""
    text = told(
        INS,
        records("best", SAME, locked=1.0),
        records("same", 1.01 * SAME, locked=1.0),
        records("maybe", np.roll(1.1 * SAME, 11), locked=1.0),
        records("unsure", 1.28 * np.roll(SAME, 23), locked=1.0),
        records("poor", 9.0 * SAME, locked=1.0),
        records("seldom", SAME, locked=0.5),
        dishonest(records("liar", 0.5 * SAME, locked=1.0)),
    )
    assert text.startswith("`best` succeeds")
    assert part(text, "as good: ") == "`same`"
    assert part(text, "farther off, by the mean ratio of errors: ") == "`poor` (× 3.00)"
    assert part(text, "successful less often: ") == "`seldom` (50 %)"
    reason = "not to be trusted (share of the truth in 95 % regions, or of wrong locks): "
    assert part(text, reason) == "`liar` (50 %)"
    assert part(text, "too few runs to tell from it: ") == f"`maybe` (× {math.sqrt(1.1):.2f})"
    off = part(text, "farther off, but too few runs to be sure: ")
    assert off == f"`unsure` (× {math.sqrt(1.28):.2f})"


def test_one_lost_run_does_not_decide_the_answer():
    """Its error of a thousand kilometres is not in any figure of those that succeed."""
    errors = 4.0 * SAME
    errors[7] = 1e12
    lost = records("good", errors)
    lost[7]["diverged"] = True
    text = told(INS, lost, records("poor", 36.0 * SAME))
    assert text.startswith("`good` succeeds in 98 % [91 %, 99.7 %] of 60 runs")
    assert "`poor` (× 3.00)" in text and "of 60 runs `good` 1 diverged" in text


@pytest.mark.parametrize(
    ("aided", "phrase"),
    [
        (SAME * (1.0 + 1e-12), "aiding gains nothing over the INS, which has "),
        (1.3 * SAME, "aiding is worse than the INS alone, which has "),
        (np.roll(2.0 * SAME, 7), "too few runs to tell whether it is better or worse than the INS"),
        (0.5 * SAME, "the INS alone has "),
    ],
)
def test_aiding_that_gains_nothing_is_said_plainly(aided, phrase):
    """Where an estimator cannot be told from the INS, or is worse, that is the answer."""
    if "too few" in phrase:
        aided = np.where(np.arange(RUNS) < 34, 2.0, 0.4) * SAME
    text = told(records("ins", SAME, "none"), records("aided", aided))
    assert f"; {phrase}" in text


def test_without_a_verdict_a_gain_is_none_only_near_one():
    """Twice or half the INS's error, undecided, is unproven; within 5 % of it nothing is gained."""
    for ratio, kind in ((2.0, "unproven"), (0.5, "unproven"), (1.04, "nothing"), (0.96, "nothing")):
        best = {"position_median_m": 1.0, "lock_share": 0.9}
        rows = best, {"position_median_m": ratio}
        assert outcome.gain(*rows, None) == kind
        assert outcome.gain(*rows, {"verdict": "better"}) == "gains"
        assert outcome.gain(*rows, {"verdict": "worse"}) == "worse"
        assert outcome.gain(*rows, {"verdict": "as good"}) == "nothing"


def test_where_nobody_is_honest_that_is_said_of_the_best():
    """It is still the best, and what it claims wrongly is said."""
    text = told(INS, dishonest(records("best", SAME)), dishonest(records("poor", 9.0 * SAME), 0.3))
    assert text.startswith("`best` succeeds")
    assert "**no causal estimator is honest here**: its 95 % regions hold the truth in 50" in text
    seldom = records("seldom", SAME)
    for record in seldom[:30]:
        record["diverged"] = True
    other = told(records("ins", 1e4 * SAME, "none"), dishonest(records("best", SAME)), seldom)
    assert "; **it is not honest**: its 95 % regions hold the truth in 50 %" in other
    assert part(text, "farther off, by the mean ratio of errors: ") == "`poor` (× 3.00)"
    assert "not to be trusted" not in text


def test_lost_runs_are_said_and_losers_are_not_best():
    """An estimator that failed in many runs is not the best for the runs that it finished."""
    text = told(
        records("fragile", 0.25 * SAME, failed=20), records("robust", SAME), INS,
    )  # fmt: skip
    assert text.startswith("`robust` succeeds")
    assert text.endswith("of 60 runs `fragile` 20 failed.")
    nothing = told(records("fragile", SAME, failed=RUNS))
    assert nothing == (
        "no estimator finished a run that could be judged: of 60 runs `fragile` 60 failed."
    )


def test_where_no_filter_is_left_the_least_error_is_told():
    """Of a smoother and the INS, the smoother's."""
    text = told(INS, records("late", SAME, "batch"))
    mrse = math.sqrt(SAME.mean())
    assert f"the least position MRSE is that of `late` (batch), {mrse:.2f} m" in text


@pytest.mark.parametrize(("worse", "end"), [(6, " (× 7.00)"), (8, " and 2 more")])
def test_of_many_estimators_the_best_six_are_named(worse, end):
    """A sentence of forty names is none; the others are counted, and stand in the table."""
    others = [records(f"e{i}", (i + 2.0) ** 2 * SAME) for i in range(worse)]
    text = told(INS, records("ekf", SAME), *others)
    named = part(text, "farther off, by the mean ratio of errors: ")
    assert named.count("`e") == 6
    assert named.endswith(end)


def answered(*cases: list[list[dict[str, Any]]]) -> str:
    """The answer to a scenario of cases c0, c1, ..."""
    from problems import SMALL

    names = [f"c{k}" for k in range(len(cases))]
    source = SMALL[: SMALL.index("[[case]]")]
    source += "".join(f'[[case]]\nname = "{c}"\ntitle = "{c}"\n' for c in names)
    tables = [tabled(*groups) for groups in cases]
    joined = [
        pd.concat([t[i].assign(case=c) for t, c in zip(tables, names, strict=True)]) for i in (0, 1)
    ]
    return opening.answer(scenario.from_text(source, "s", ""), *joined)


def test_of_many_cases_the_answer_counts():
    """Who is as good as the best in how many, how near the bound; where nothing is gained."""
    poor = records("ukf", 9.0 * SAME)
    text = answered(
        [INS, records("ekf", SAME), records("ukf", SAME)],
        [INS, records("ekf", 4.0 * SAME), poor],
        [records("ins", SAME, "none"), records("ekf", SAME, failed=1), poor],
        [INS, records("ekf", SAME, failed=RUNS)],
    )
    assert text == (
        "**As good as the best causal estimator and honest in 2 of 4 cases: `ekf` (success in "
        f"100 %, {short(MEDIAN)} to {short(2.0 * MEDIAN)} × the bound); less often: `ukf` in 1; "
        "no causal estimator can be judged in 1; the best causal one gains nothing over the INS in "
        "1 (c2); 61 runs failed, 0 diverged.**"
    )


def test_errors_of_fewer_runs_are_told_by_common_runs():
    """Whose runs were the kind ones is no nearer than who flew these, too."""
    many = records("ekf", np.where(np.arange(RUNS) < RUNS // 2, 1.0, 16.0) * SAME)
    few = records("ukf", SAME[: RUNS // 2])
    text = answered([INS, many, few], [INS, many, few])
    first, second = re.findall(r"`(?:ekf|ukf)` \(success in 100 %, ([\d.]+) × the bound", text)
    assert first == second


def test_the_dishonest_count_for_nothing_in_many_cases():
    """As good as the best, but not honest: not among those that are named first."""
    liar = dishonest(records("liar", 0.9 * SAME))
    text = answered([INS, EKF, liar], [INS, EKF, liar])
    assert text.startswith(
        "**As good as the best causal estimator and honest in all 2 cases: `ekf`"
    )
    assert "liar" not in text
    nobody = answered([INS, liar], [INS, liar])
    assert nobody.startswith("**No causal estimator is honest in any case")


EKF = records("ekf", SAME)


def test_of_one_case_the_answer_is_that_of_the_case():
    """Bold, and it begins with the estimator."""
    groups = [INS, EKF]
    assert answered(groups) == f"**{told(*groups)}**"


@pytest.mark.parametrize(
    ("left", "told"), [(1e4, ["gains"] * 4), (4.0, ["gains"] * 2 + ["worse"] * 2)]
)
def test_runs_that_are_lost_weigh_against_what_the_ins_itself_is_good_for(left, told):
    """An INS that is lost in nearly all runs is beaten by who finds a third of them."""
    ins = records("ins", left * SAME, "none")

    def gained(lost: int) -> str:
        rows = records("ekf", SAME)
        for record in rows[:lost]:
            record["diverged"] = True
        return outcome.outcome(case(), *tabled(ins, rows)).gain

    assert [gained(lost) for lost in (0, 3, 15, 40)] == told
