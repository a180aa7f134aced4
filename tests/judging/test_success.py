"""Success first, then accuracy among successes."""

from __future__ import annotations

import math

import numpy as np
import pandas as pd
import pytest
from scipy.stats import binomtest
from summaries import RUNS, SAME, chi, records, tabled

from ggbench.judging import success
from ggbench.judging.statistics import BETTER, UNDECIDED, WORSE
from ggbench.judging.success import EQUAL, compared, exact_p, figures


def judged(first: np.ndarray, second: np.ndarray, *good: np.ndarray) -> dict:
    """The comparison of estimators of given mean squared errors; all runs succeed if not said."""
    one, other = good or (np.ones(len(first), bool), np.ones(len(second), bool))
    return compared([(first, one, second, other)])[0]


def test_figures_of_runs_that_succeed_are_not_those_of_lost_ones():
    """By hand: four runs, one of which failed, one diverged; failed ones count as the INS."""
    ms = np.array([4.0, 9.0, math.nan, 1e6])
    found = figures(ms, np.array([5.0, 7.0, math.nan, 1e9]), np.array([True, True, False, False]),
                    2.0, 10.0)  # fmt: skip
    assert tuple(found) == success.COLUMNS
    assert found["success_share"] == 0.5
    assert 0.1 < found["success_lo"] < 0.5 < found["success_hi"] < 0.9
    assert found["ratio_median"] == pytest.approx(1.25)
    assert (found["ratio_quartile_lo"], found["ratio_quartile_hi"]) == (1.125, 1.375)
    assert found["capped_mrse_m"] == pytest.approx(math.sqrt((4.0 + 9.0 + 100.0 + 100.0) / 4.0))
    assert found["nees_median"] == 7.0
    nothing = figures(ms[2:], ms[2:], np.zeros(2, bool), 2.0, math.nan)
    assert nothing["success_share"] == 0.0 and math.isnan(nothing["ratio_median"])


def test_one_lost_run_turns_no_verdict():
    """A run that is lost makes the mean a thousand times worse, and leaves estimators as good."""
    errors = SAME.copy()
    errors[7] = 1e9
    lost = np.arange(RUNS) == 7
    found = judged(SAME, errors, np.ones(RUNS, bool), ~lost)
    assert (found["verdict"], found["second_succeeded"]) == (EQUAL, 0)
    assert found["first_succeeded"] == 1 and found["both_succeeded"] == RUNS - 1


def test_success_goes_before_accuracy():
    """Who succeeds surely more often is better, however near the other is where it does."""
    often, seldom = np.ones(RUNS, bool), np.arange(RUNS) % 3 == 0
    found = judged(100.0 * SAME, SAME, often, seldom)
    assert (found["verdict"], found["error_ratio"]) == (BETTER, pytest.approx(10.0))
    assert judged(SAME, 100.0 * SAME, seldom, often)["verdict"] == WORSE


def test_verdicts_of_those_that_succeed():
    """Nearer in most runs is better; within 5 % as good; few runs say neither."""
    assert judged(SAME, 2.0 * SAME)["verdict"] == BETTER
    assert judged(2.0 * SAME, SAME)["verdict"] == WORSE
    tiny = judged(SAME, 1.02 * SAME)
    assert tiny["verdict"] == EQUAL and tiny["sign_p"] < 1e-9
    assert judged(SAME[:8], 1.02 * SAME[:8])["verdict"] == UNDECIDED
    assert judged(chi(8)[:12], chi(9)[:12])["verdict"] == UNDECIDED
    # Few runs with a huge gain are no majority: the mean of the logarithms alone does not decide.
    few = np.where(np.arange(RUNS) < RUNS // 3, 1e-6, 1.0) * SAME
    gained = judged(few, SAME * np.where(np.arange(RUNS) < RUNS // 3, 1.0, 1.0001))
    assert gained["error_ratio_hi"] < 1.0 and gained["verdict"] == BETTER
    lost = judged(few, SAME * np.where(np.arange(RUNS) < RUNS // 3, 1.0, 0.9999))
    assert lost["error_ratio_hi"] < 1.0 and lost["verdict"] == UNDECIDED


def test_false_alarms_of_verdicts():
    """Of pairs of one law at most 10 % are called better or worse (false alarm: 1e-4)."""
    generator = np.random.default_rng(17)
    pairs = []
    for _ in range(600):
        errors = generator.chisquare(3, (2, 40)) * np.exp(generator.normal(0.0, 1.0, 40))
        good = generator.random((2, 40)) < 0.9
        pairs.append((errors[0], good[0], errors[1], good[1]))
    wrong = sum(found["verdict"] in (BETTER, WORSE) for found in compared(pairs))
    assert binomtest(wrong, 600, 0.10, alternative="greater").pvalue > 1e-4
    assert wrong > 6  # a rule that never decides would pass the other


@pytest.mark.parametrize(("one", "other"), [(0, 0), (3, 3), (0, 6), (11, 2), (90, 60)])
def test_the_exact_test_is_the_binomial(one, other):
    """McNemar's and the sign test are SciPy's two-sided binomial test of one half."""
    wanted = binomtest(one, one + other, 0.5).pvalue if one + other else 1.0
    assert exact_p(one, other) == pytest.approx(wanted)
    assert exact_p(other, one) == exact_p(one, other)


def test_the_summary_and_the_pairs_hold_them():
    """Runs that fail, diverge or do not lock have not succeeded, in both tables alike."""
    summary, pairs = tabled(
        records("ins", 1e4 * SAME, "none", locked=0.0),
        records("fragile", SAME, failed=15, locked=1.0),
        records("lost", SAME, locked=0.5),
        records("wild", SAME, locked=1.0, diverged=True),
        records("good", SAME, locked=1.0),
    )
    rows = summary[summary["window"] == "settled"].set_index("label")
    shares = dict(rows["success_share"])
    assert shares == {"ins": 0.0, "fragile": 0.75, "lost": 0.5, "wild": 0.0, "good": 1.0}
    found = pairs[(pairs["window"] == "settled") & (pairs["second"] == "good")].set_index("first")
    assert dict(found["verdict"]) == dict.fromkeys(("ins", "fragile", "lost", "wild"), WORSE)
    assert found.loc["lost", "second_succeeded"] == RUNS // 2
    assert isinstance(pairs, pd.DataFrame)
    capped = rows["capped_mrse_m"]
    assert capped["fragile"] < rows.loc["ins", "position_mrse_m"]


@pytest.mark.parametrize(
    ("bound", "left", "end", "near"),
    [
        (1.0, 4.0, 10.0, True),
        (1.0, 4.0, 10.1, False),
        (1.0, 100.0, 50.0, True),
        (1.0, 100.0, 50.1, False),
        (math.nan, 100.0, 50.1, False),
        (math.nan, math.nan, 1e9, True),
    ],
)
def test_a_run_succeeds_if_it_ends_near_enough(bound, left, end, near):
    """Within ten bounds, or within half of what the INS has; to be no worse than it is not enough.

    A lost run of the INS does not move the limit of a case alone: it is that of all its runs, each
    counted once, whoever flew it.
    """
    runs = pd.DataFrame(
        {
            "case": "c", "estimator": "e", "run": [0, 1], "status": "ok", "diverged": False,
            "final_position_error_m": [end, 0.0], "lock_time_s": math.nan,
            "final_ins_error_m": [0.0 * left, math.sqrt(2.0) * left],
            "false_lock": pd.array([None, None], dtype="boolean"),
        }
    )  # fmt: skip
    bounds = {} if math.isnan(bound) else {("c", "e"): {"last20": (bound, 1.0)}}
    assert success.succeeded(runs, bounds).tolist() == [near, True]
    # Where locks are judged nothing else is asked.
    locked = runs.assign(
        false_lock=pd.array([False, True], dtype="boolean"), lock_time_s=[5.0, None]
    )
    assert success.succeeded(locked, bounds).tolist() == [True, False]
    other = runs.assign(case="d", status="failed")
    both = pd.concat([locked, other])
    assert success.succeeded(both, bounds).tolist() == [True, False, False, False]
    # A run that many flew counts no more, and a smoother is held to its own bound.
    more = pd.concat(
        [runs, runs.iloc[:1].assign(estimator="other"), runs.iloc[:1].assign(estimator="late")]
    )
    narrow = bounds | {("c", "late"): {"last20": (0.1 * end, 1.0)}}
    assert success.succeeded(more, narrow).tolist()[:2] == [near, True]
    assert success.succeeded(more, narrow)[3]
