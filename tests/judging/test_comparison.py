"""Two campaigns beside each other: false alarms counted per comparison, real changes found."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pandas as pd
import pytest
from scipy.stats import binomtest, fisher_exact

from ggbench.judging.comparison import (
    ROW_COLUMNS,
    UNFINISHED,
    Comparison,
    ComparisonError,
    compare,
    groups_of_runs,
    unfinished_runs,
)
from ggbench.judging.summary import WINDOWS


def campaign(
    errors: dict[str, np.ndarray],
    case: str = "c",
    assumption: str = "",
    problem: str = "hash",
    lost: Sequence[int] = (),
    diverged: Sequence[int] = (),
) -> pd.DataFrame:
    """A table of runs with given squared position errors by estimator; velocity a hundredth."""
    tables = []
    for label, squares in errors.items():
        run = np.arange(len(squares))
        failed = np.isin(run, lost)
        columns = {
            "assumption": assumption,
            "case": case,
            "problem": problem,
            "estimator": label,
            "name": label,
            "seed": 1,
            "run": run,
            "status": np.where(failed, "failed", "ok"),
            "diverged": np.isin(run, diverged),
        }
        squares = np.where(failed, np.nan, squares)
        for window in WINDOWS:
            columns |= {f"{window}_position_ms": squares, f"{window}_velocity_ms": squares / 100.0}
        tables.append(pd.DataFrame(columns))
    return pd.concat(tables, ignore_index=True)


def verdicts(comparison: Comparison) -> dict[str, str]:
    return dict(zip(comparison.rows["quantity"], comparison.rows["verdict"], strict=True))


def squares(seed: int, runs: int = 300) -> np.ndarray:
    return np.random.default_rng(seed).chisquare(3, runs)


def noisy(seed: int, runs: int = 300) -> np.ndarray:
    """Factors around 1, by which an estimator differs from a similar one on the same run."""
    return np.random.default_rng(seed).lognormal(0.0, 0.1, runs)


def test_the_same_campaign_is_the_same():
    """Bit-identical data are "same" in every row, in whatever order they are stored."""
    table = campaign({"a": squares(1), "b": squares(2)}, lost=[3], diverged=[4])
    result = compare(table, table.iloc[::-1], threshold=0.0)
    assert tuple(result.rows.columns) == ROW_COLUMNS
    assert len(result.rows) == 6
    assert set(result.rows["verdict"]) == {"same"}
    assert not result.worse
    assert result.rows["paired"].all()
    assert (result.only_before, result.only_after) == ((), ())
    ratios = result.rows[result.rows["quantity"] != UNFINISHED]
    assert (ratios[["ratio", "lo", "hi"]] == 1.0).all(axis=None)
    assert (ratios["runs"] == 299).all()


def test_rounding_is_not_worse():
    """Another order of summation changes every run a little, and nothing became worse."""
    before = squares(1)
    result = compare(campaign({"a": before}), campaign({"a": before * (1 + 1e-12)}), 0.0)
    assert verdicts(result)["position"] == "undecided"
    assert not result.worse


def test_ten_percent_worse_is_found():
    """10 % more MRSE in 300 runs: worse than a threshold of 5 %, not of 20 %; or better."""
    before = campaign({"a": squares(1)})
    after = campaign({"a": 1.21 * squares(1) * noisy(2)})
    result = compare(before, after, 0.05)
    row = result.rows.iloc[0]
    assert (row["verdict"], result.worse) == ("worse", True)
    assert row["lo"] < row["ratio"] < row["hi"]
    assert row["ratio"] == pytest.approx(1.1, abs=0.02)
    assert row["ratio"] == pytest.approx(row["after"] / row["before"])
    assert not compare(before, after, 0.2).worse
    turned = compare(after, before, 0.05)
    assert verdicts(turned) == {"position": "better", "velocity": "better", UNFINISHED: "same"}
    assert not turned.worse
    assert set(verdicts(compare(after, before, 0.2)).values()) == {"undecided", "same"}


def test_the_window_is_the_one_asked_for():
    """Only the asked window is compared."""
    before, after = campaign({"a": squares(1)}), campaign({"a": squares(1)})
    after["last20_position_ms"] *= 2.0
    assert not compare(before, after, 0.0).worse
    assert compare(before, after, 0.0, window="last20").worse


def test_pairs_are_of_the_same_problems():
    """With another case or seed the samples are independent; a common drift then hides more."""
    before, after = campaign({"a": squares(1)}), campaign({"a": 1.05 * squares(1)})
    assert compare(before, after, 0.0).worse
    for other in (after.assign(problem="other"), after.assign(seed=2)):
        result = compare(before, other, 0.0)
        assert not result.rows["paired"].any()
        assert not result.worse


def test_runs_that_only_one_campaign_has():
    """Pairs are of common runs; independent samples are cut to equally many; losses count all."""
    long, short = campaign({"a": squares(1)}), campaign({"a": squares(1, 300)[:100]})
    mrse = math.sqrt(squares(1)[:100].mean())  # of the first ones, of either
    for before, after in ((long, short), (long, short.assign(problem="other"))):
        rows = compare(before, after, 0.0).rows.set_index("quantity")
        assert tuple(rows.loc["position", ["before", "after"]]) == pytest.approx((mrse, mrse))
        turned = compare(after, before, 0.0).rows.set_index("quantity")
        assert tuple(turned.loc["position", ["before", "after"]]) == pytest.approx((mrse, mrse))
        assert rows.loc["position", "runs_before"] == rows.loc["position", "runs"] == 100
        assert (rows.loc[UNFINISHED, "runs_before"], rows.loc[UNFINISHED, "runs"]) == (300, 100)


def test_an_estimator_that_fails_always_is_worse():
    """No ratio is left, and the failed runs show it."""
    before = campaign({"a": squares(1, 20)})
    after = campaign({"a": squares(1, 20)}, lost=range(20))
    result = compare(before, after, 0.5)
    assert verdicts(result) == {
        "position": "undecided",
        "velocity": "undecided",
        UNFINISHED: "worse",
    }
    assert result.worse
    rows = result.rows.set_index("quantity")
    assert tuple(rows.loc[UNFINISHED, ["before", "after"]]) == (0, 20)
    assert math.isnan(rows.loc["position", "ratio"])
    assert verdicts(compare(after, before, 0.5))[UNFINISHED] == "better"


@pytest.mark.parametrize("kind", ["lost", "diverged"])
def test_lost_runs_need_to_be_more_than_one(kind):
    """A single run that fails or diverges of 300 is no evidence; ten are."""
    before = campaign({"a": squares(1)})
    one = compare(before, campaign({"a": squares(1)}, **{kind: [7]}), 0.0)
    assert verdicts(one)[UNFINISHED] == "undecided"
    assert not one.worse
    ten = compare(before, campaign({"a": squares(1)}, **{kind: range(10)}), 0.0)
    assert verdicts(ten)[UNFINISHED] == "worse"


@pytest.mark.parametrize(("old", "new"), [(3, 20), (9, 4), (0, 5), (6, 6)])
def test_evidence_of_lost_runs_is_that_of_exact_tests(old, new):
    """Fisher's of independent samples of 40 and 90 runs, McNemar's of pairs; both one-sided."""
    before, after = (
        next(iter(groups_of_runs(campaign({"a": squares(1, runs)}, lost=lost)).values()))
        for runs, lost in ((40, range(old)), (90, range(2, 2 + new)))
    )
    found = unfinished_runs(before, after, paired=False)
    table = [[new, 90 - new], [old, 40 - old]]
    assert (found["before"], found["after"]) == (old, new)
    assert found["p"] == pytest.approx(fisher_exact(table, alternative="greater").pvalue)
    assert found["p_better"] == pytest.approx(fisher_exact(table, alternative="less").pvalue)
    pairs = unfinished_runs(before, after, paired=True)
    one, other = set(range(old)), set(range(2, 2 + new))
    differing = len(one ^ other)
    for name, count in (("p", len(other - one)), ("p_better", len(one - other))):
        wanted = binomtest(count, differing, 0.5, alternative="greater").pvalue if differing else 1
        assert pairs[name] == pytest.approx(wanted)


def test_infinite_errors_are_lost_runs():
    """An error beyond all numbers has no mean; its run diverged, and is counted there."""
    errors = squares(1)
    errors[:10] = np.inf
    result = compare(campaign({"a": squares(1)}), campaign({"a": errors}, diverged=range(10)), 0.0)
    assert verdicts(result) == {"position": "same", "velocity": "same", UNFINISHED: "worse"}


@pytest.mark.long
@pytest.mark.parametrize(("comparisons", "most"), [(10, 3), (120, 13)])
def test_false_alarms_of_a_whole_comparison(comparisons, most):
    """Of comparisons in which nothing became worse 5 % at most say so, and as many "better".

    Of five estimators on 30 runs, of which one in ten is lost: ten rows of errors and five of lost
    runs; every second one paired. A rate of 5 % leads to more than these alarms with a probability
    of 0.3 %.
    """
    generator = np.random.default_rng(31)
    before = campaign(dict.fromkeys("abcde", np.ones(30)))
    after = before.copy()
    worse = better = 0
    for number in range(comparisons):
        paired = number % 2
        common = paired * generator.chisquare(3, 150)
        for table in (before, after):
            lost = generator.random(150) < 0.1
            table["status"] = np.where(lost, "failed", "ok")
            table["settled_position_ms"] = np.where(
                lost, np.nan, common + generator.chisquare(3, 150)
            )
            table["settled_velocity_ms"] = np.where(
                lost, np.nan, common + generator.chisquare(3, 150)
            )
        after["seed"] = 1 if paired else 2
        result = compare(before, after, threshold=0.0)
        worse += result.worse
        better += (result.rows["verdict"] == "better").any()
    assert max(worse, better) <= most


def test_what_only_one_campaign_holds():
    """Estimators, cases and assumptions of one side are named once; studies are compared too."""
    before = pd.concat(
        [
            campaign({"a": squares(1, 5), "old": squares(2, 5)}),
            campaign({"a": squares(3, 5), "old": squares(3, 5)}, case="gone"),
            campaign({"a": squares(4, 5)}, assumption="wind"),
        ]
    )
    after = pd.concat(
        [
            campaign({"a": squares(1, 5), "new": squares(2, 5)}),
            campaign({"new": squares(2, 5)}, case="added"),
            campaign({"a": squares(4, 5)}, assumption="wind"),
            campaign({"a": squares(4, 5)}, assumption="rain"),
            campaign({"a": squares(4, 5)}, case="d", assumption="wind"),
        ]
    )
    result = compare(before, after, 0.1)
    assert list(result.rows["assumption"].unique()) == ["", "wind"]
    assert result.only_before == ("estimator old", "case gone")
    assert result.only_after == ("estimator new", "assumption rain", "case d of assumption wind")


def named(table: pd.DataFrame) -> pd.DataFrame:
    """The runs, whose estimators have the labels NAME[parameter=...]."""
    return table.assign(name=table["estimator"].str.partition("[")[0])


def test_an_estimator_with_changed_parameters_is_compared_with_itself():
    """It has one label on each side; of two variants on one side none is the other's successor."""
    before = named(campaign({"a": squares(1, 5), "pf[particles=100]": squares(2, 5)}))
    after = named(campaign({"a": squares(1, 5), "pf[particles=200]": squares(2, 5)}))
    label = "pf[particles=100] → pf[particles=200]"
    assert list(compare(before, after, 0.1).rows["estimator"].unique()) == ["a", label]
    variants = {"pf[particles=100]": squares(2, 5), "pf[particles=200]": squares(2, 5)}
    gone = compare(named(campaign({"a": squares(1, 5)} | variants)), after[:5], 0.1)
    assert list(gone.rows["estimator"].unique()) == ["a"]
    assert gone.only_before == ("estimator pf[particles=100]", "estimator pf[particles=200]")


def test_runs_that_all_finished_are_no_test_of_lost_runs():
    """Position and velocity remain; one lost run makes a third test."""
    before = campaign({"a": squares(1)})
    assert compare(before, campaign({"a": squares(2)}), 0.1).tests == 2
    assert compare(before, campaign({"a": squares(2)}, lost=[3]), 0.1).tests == 3


def test_nothing_to_compare():
    """One sentence that names what each holds; a wrong threshold or window is one, too."""
    one, two = campaign({"a": squares(1, 5)}), campaign({"b": squares(1, 5)}, case="d")
    with pytest.raises(ComparisonError, match=r"cases c and .* a, the other .* d and .* b"):
        compare(one, two, 0.1)
    with pytest.raises(ComparisonError, match="no runs"):
        compare(one, two[:0], 0.1)
    for threshold in (-0.1, math.nan, math.inf):
        with pytest.raises(ComparisonError, match="threshold"):
            compare(one, one, threshold)
    with pytest.raises(ComparisonError, match="settled"):
        compare(one, one, 0.1, window="middle")
