"""Pairs and verdicts: equal runs, and false-alarm rates through the package's own functions."""

from __future__ import annotations

import functools
import math

import numpy as np
import pandas as pd
import pytest

from ggbench.judging import verdicts
from ggbench.judging.pairs import FAMILY, PAIRS, family, pair_of, pairs
from ggbench.judging.run_errors import WINDOWS
from ggbench.judging.summary import metrics
from ggbench.judging.verdicts import (
    UnequalRunsError,
    Verdict,
    require_equal_runs,
    with_equal_runs,
)
from ggbench.results.columns import WINDOW_COLUMNS


def flown(
    errors: dict[str, np.ndarray],
    *,
    case: str = "c",
    draws: int = 10**6,
    required: float = math.inf,
    nees: dict[str, float] | None = None,
) -> pd.DataFrame:
    """A table of runs with these squared errors; "ins" is unaided, "batch..." smooths."""
    table = _template(tuple((label, len(squares)) for label, squares in errors.items())).copy()
    squares = np.concatenate([*errors.values()])
    for window in WINDOWS:
        table[f"{window}_position_ms"] = squares
        table[f"{window}_nees"] = [(nees or {}).get(label, 6.0) for label in table["estimator"]]
    return table.assign(
        case=case,
        draw=table["run"] % draws,
        status=np.where(np.isfinite(squares), "ok", "failed"),
        required_m=required,
        final_position_error_m=np.sqrt(squares),
    )


@functools.cache
def _template(cells: tuple[tuple[str, int], ...]) -> pd.DataFrame:
    tables = []
    for label, count in cells:
        kind = "none" if label == "ins" else "batch" if label.startswith("batch") else "filter"
        table = pd.DataFrame(dict.fromkeys(WINDOW_COLUMNS, 1.0), index=range(count))
        table = table.assign(**{f"{window}_coverage": 0.95 for window in WINDOWS})
        tables.append(
            table.assign(
                estimator=label,
                name=label,
                parameters="",
                causality=kind,
                run=range(count),
                false_fix=False,
                diverged=False,
                cold=False,
                converged_s=1.0,
                map_evaluations=1.0,
                seconds=0.001 * (1 + len(tables)),
            )
        )
    return pd.concat(tables, ignore_index=True)


LAWS = {
    "chi-square": lambda generator, runs: generator.chisquare(3, runs),
    "log-normal": lambda generator, runs: generator.lognormal(0.0, 1.5, runs),
}
"""Light and heavy tails of squared errors."""
each_law = pytest.mark.parametrize("law", LAWS.values(), ids=LAWS)


def verdict(runs: pd.DataFrame, of: str = "causal") -> Verdict:
    """The verdict on a table of runs, from its own metrics."""
    return verdicts.verdict(runs, metrics(runs, {}), of)


def common(generator: np.random.Generator, runs: int, labels: tuple[str, ...]) -> dict:
    """Squared errors of one law, half of whose variation the estimators share."""
    shared = generator.chisquare(3, runs)
    return {label: shared + generator.chisquare(3, runs) for label in labels}


def test_pairs_are_of_a_kind_and_of_common_runs():
    generator = np.random.default_rng(1)
    errors = common(generator, 40, ("ins", "a", "b", "batch-a", "batch-b"))
    errors["b"] = errors["b"][:30].copy()
    errors["b"][3] = math.nan  # failed
    table = pairs(flown(errors))
    assert tuple(table.columns) == PAIRS
    named = list(zip(table["first"], table["second"], strict=True))
    assert named == [("ins", "a"), ("ins", "b"), ("a", "b"), ("batch-a", "batch-b")]
    assert table["runs"].tolist() == [40, 29, 29, 40]
    assert pair_of(table, "c", "a", "batch-a") is None


def test_a_pair_reads_the_same_from_both_sides():
    generator = np.random.default_rng(4)
    first = generator.chisquare(3, 60)
    errors = {"a": first, "b": 1.3 * first * generator.lognormal(0.0, 0.1, 60)}
    table = pairs(flown(errors, required=2.0))
    one, two = pair_of(table, "c", "a", "b"), pair_of(table, "c", "b", "a")
    assert (one["verdict"], two["verdict"]) == ("better", "worse")
    assert one["error_ratio"] * two["error_ratio"] == pytest.approx(1.0)
    assert one["lo"] * two["hi"] == pytest.approx(1.0)
    assert (one["first_only"], one["second_only"]) == (two["second_only"], two["first_only"])


def test_success_comes_before_errors_and_a_failed_run_is_none():
    """B has the smaller errors where it finishes, and fails in a third of the runs."""
    generator = np.random.default_rng(5)
    errors = common(generator, 90, ("a", "b"))
    errors["b"] = 0.5 * errors["a"]
    errors["b"][::3] = math.nan
    row = pairs(flown(errors)).iloc[0]
    assert (row["first_only"], row["second_only"], row["verdict"]) == (30, 0, "better")
    assert row["error_ratio"] == pytest.approx(math.sqrt(2.0))


def test_few_runs_are_undecided_and_never_equivalent():
    errors = {"a": np.full(19, 4.0), "b": np.full(19, 4.0)}
    assert pairs(flown(errors))["verdict"].tolist() == ["undecided"]
    errors = {"a": np.full(20, 4.0), "b": np.full(20, 4.0)}
    assert pairs(flown(errors))["verdict"].tolist() == ["equivalent"]
    # 200 runs over two maps are two samples.
    many = {label: np.tile(squares, 10) for label, squares in errors.items()}
    assert pairs(flown(many, draws=2))["verdict"].tolist() == ["undecided"]


@pytest.mark.long
@pytest.mark.parametrize("draws", [20, 10**6])
@pytest.mark.parametrize("runs", [20, 60, 200])
@each_law
def test_false_alarms_of_a_table(law, runs, draws):
    """Five estimators of one law: any "better" or "worse" in 5 % of the tables at most.

    With success and errors judged, alone and with 20 maps that runs share. Of 100 tables the rate
    has a standard error of 2.2 %; two of them.
    """
    generator, alarms = np.random.default_rng(37), 0
    for _ in range(100):
        shared = law(generator, 20)[np.arange(runs) % 20] if draws == 20 else law(generator, runs)
        errors = {label: shared + law(generator, runs) for label in "abcde"}
        table = pairs(flown(errors, draws=draws, required=3.0))
        alarms += table["verdict"].isin(["better", "worse"]).any()
    assert alarms / 100 < 0.05 + 2.0 * math.sqrt(0.05 * 0.95 / 100)


@pytest.mark.long
def test_power_of_a_table():
    """A third more error is found among ten pairs in most tables of 100 runs."""
    generator, found = np.random.default_rng(38), 0
    for _ in range(40):
        errors = common(generator, 100, ("a", "b", "c", "d", "e"))
        errors["e"] = errors["a"] * 1.33**2
        pair = pair_of(pairs(flown(errors)), "c", "a", "e")
        found += pair["verdict"] == "better"
    assert found >= 30


def test_unequal_runs_are_rejected():
    """The guard passes equal runs and fails on a planted case with one run less."""
    errors = common(np.random.default_rng(2), 20, ("a", "b"))
    require_equal_runs(flown(errors))
    errors["b"] = errors["b"][:19]
    with pytest.raises(UnequalRunsError, match=r"case c compares unequal runs: a 20, b 19"):
        require_equal_runs(flown(errors))
    assert set(with_equal_runs(flown(errors))["estimator"]) == {"a"}


def test_estimators_that_fail_are_not_compared():
    errors = common(np.random.default_rng(2), 20, ("a", "b"))
    errors["b"] = 0.01 * errors["b"]
    errors["b"][:2] = math.nan
    assert verdict(flown(errors)).best == "a"


def test_the_best_is_consistent_and_the_cheapest_near_one_is_recommended():
    generator = np.random.default_rng(3)
    base = generator.chisquare(3, 200)
    errors = {
        "ins": 100.0 * generator.chisquare(3, 200),
        "cheap": 1.02**2 * base,
        "best": base,
        "overconfident": 0.5 * base,
        "far": 1.5 * base,
        "batch": 0.1 * base,
    }
    found = verdict(flown(errors, nees={"overconfident": 9.0}))
    assert found == Verdict("best", ("cheap", "best"), 3, "better")
    smoothers = verdict(flown(errors), "smoother")
    assert (smoothers.best, smoothers.recommended) == ("batch", ("batch",))


def test_where_none_is_consistent_the_least_bad_is_named_and_none_recommended():
    base = np.random.default_rng(3).chisquare(3, 200)
    found = verdict(flown({"a": base, "b": 2.0 * base}, nees={"a": 9.0, "b": 9.0}))
    assert found == Verdict("a", (), 0, "", "none is consistent")


def test_where_the_best_is_no_better_than_the_ins_none_is_recommended():
    """A matcher that refuses every fix repeats the INS, consistently; control: half its error."""
    base = np.random.default_rng(3).chisquare(3, 200)
    idle = verdict(flown({"ins": base, "idle": base}))
    assert idle == Verdict(
        "idle", (), 1, "equivalent", "no estimator is significantly better than the INS"
    )
    assert verdict(flown({"ins": base, "aided": 0.25 * base})).recommended == ("aided",)


@pytest.mark.parametrize(("runs", "recommended"), [(39, ()), (40, ("a",))])
def test_few_runs_recommend_nothing(runs, recommended):
    """Each half chooses the best of the other; without an INS as well."""
    base = np.random.default_rng(3).chisquare(3, runs)
    found = verdict(flown({"a": base, "b": 100.0 * base}))
    assert (found.best, found.recommended) == ("a", recommended)
    assert found.reason == ("" if recommended else "fewer than 40 runs")


def honest(runs: int = 200) -> dict[str, np.ndarray]:
    """Squared errors of an INS and of three filters within 3 % of each other."""
    generator = np.random.default_rng(3)
    base = generator.chisquare(3, runs)
    return {
        "ins": 25.0 * generator.chisquare(3, runs),
        "ekf": base,
        "ukf": base * generator.lognormal(0.02, 0.02, runs),
        "sum": base * generator.lognormal(0.04, 0.02, runs),
    }


def test_honest_filters_are_recommended():
    """The control of the ways to cheat."""
    assert set(verdict(flown(honest())).recommended) == {"ekf", "ukf", "sum"}


@pytest.mark.parametrize("count", [3, 6])
@pytest.mark.parametrize("rest", [0, 1])
@pytest.mark.parametrize("cheat", ["ekf", "ukf"])
def test_a_few_catastrophes_lose_the_recommendation(cheat, rest, count):
    """A hundred times the error in a few runs of one half, be it the best's or another's."""
    errors = honest()
    errors[cheat][rest : rest + 2 * count : 2] *= 1e4
    found = verdict(flown(errors))
    assert set(found.recommended) == {"ekf", "ukf", "sum"} - {cheat}
    assert found.best != cheat


@pytest.mark.parametrize("rest", [0, 1])
def test_near_the_best_in_one_half_of_the_runs_is_not_enough(rest):
    """In the other half the error is 30 % larger; over all runs it is 15 % larger."""
    errors = honest()
    errors["ukf"][rest::2] *= 1.3**2
    assert set(verdict(flown(errors)).recommended) == {"ekf", "sum"}


def test_near_the_best_by_chance_is_not_enough():
    """The errors are independent; their means agree within 10 %, and their ratio is uncertain."""
    errors = honest()
    means = [errors["ekf"][rest::2].mean() for rest in (0, 1)]
    errors["ukf"] = np.random.default_rng(4).lognormal(0.0, 1.5, 200)
    for rest, mean in enumerate(means):
        errors["ukf"][rest::2] *= 1.05 * mean / errors["ukf"][rest::2].mean()
    assert set(verdict(flown(errors)).recommended) == {"ekf", "sum"}


@pytest.mark.parametrize("count", [1, 6])
@pytest.mark.parametrize("rest", [0, 1])
def test_failing_in_the_same_runs_as_the_best_does_not_help(rest, count):
    """Two filters with the same catastrophes in one half: near each other there, and far off."""
    errors = honest()
    for cheat in ("ekf", "ukf"):
        errors[cheat][rest : rest + 2 * count : 2] *= 1e4
    assert verdict(flown(errors)).recommended == ("sum",)


def test_an_inflated_covariance_loses_the_recommendation():
    """It hides no error: an estimator three times too uncertain is consistent with anything."""
    errors = honest()
    runs = flown(errors, nees={"ekf": 2.0, "ukf": 4.0})
    assert set(verdict(runs).recommended) == {"ukf", "sum"}
    found = verdict(flown(errors, nees={"ekf": 2.0, "ukf": 2.0, "sum": 2.0}))
    assert found.recommended == ()
    assert found.reason == "covariances are more than twice the correct ones"
    # With catastrophes that its covariance covers it is not near the best, either.
    errors["ekf"][::40] *= 1e4
    assert "ekf" not in verdict(flown(errors, nees={"ekf": 3.5})).recommended


@pytest.mark.parametrize("share", [0.02, 0.05])
def test_failing_in_hard_runs_loses_the_recommendation(share):
    """A filter that fails in its hardest runs has less error in the others, and as much success.

    A failed run counts with the largest error of the run, here the INS's.
    """
    errors = honest()
    errors["ins"] *= 4.0
    hardest = np.argsort(errors["ekf"])[-round(200 * share) :]
    cheating = errors | {"cheat": errors["ekf"].copy()}
    cheating["cheat"][hardest] = math.nan
    runs = flown(cheating, required=math.inf)
    assert np.nanmean(cheating["cheat"]) < errors["ekf"].mean()
    assert set(verdict(runs).recommended) == {"ekf", "ukf", "sum"}
    assert verdict(runs).best == "ekf"


@pytest.mark.parametrize(("share", "recommended"), [(0.45, ()), (0.55, ("a",))])
def test_little_success_is_not_recommended(share, recommended):
    """The least bad of estimators of which none succeeds in half of the runs is not recommended."""
    base = np.random.default_rng(3).chisquare(3, 200)
    runs = flown({"ins": 100.0 * base, "a": base})
    runs.loc[(runs["run"] >= 200 * share), "final_position_error_m"] = math.inf
    runs["required_m"] = 1e6
    found = verdict(runs)
    assert (found.best, found.recommended) == ("a", recommended)
    assert found.reason == ("" if recommended else "no estimator succeeds in half of the runs")


def test_a_gain_in_one_half_is_undecided():
    """An estimator that is better than the INS in even runs alone gains nothing for sure."""
    base = np.random.default_rng(3).chisquare(3, 200)
    aided = np.where(np.arange(200) % 2 == 0, 0.25, 1.0) * base
    found = verdict(flown({"ins": base, "aided": aided}))
    assert (found.gain, found.recommended) == ("undecided", ())


def test_claims_are_a_family_of_their_own():
    """A difference that 45 pairs hide is found among one; an open one says what it needs."""
    generator = np.random.default_rng(11)
    errors = common(generator, 60, tuple("abcdefghij"))
    spread = generator.standard_normal(60)
    spread = (spread - spread.mean()) / spread.std(ddof=1)
    errors["b"] = errors["a"] * np.exp(spread + 3.0 / math.sqrt(60))  # t = 3: p = 0.4 %
    runs = flown(errors, required=math.inf)
    among_all = pair_of(pairs(runs), "c", "a", "b")
    (alone,) = family(runs, [("c", "a", "b")]).to_dict("records")
    assert tuple(family(runs, [("c", "a", "b")]).columns) == FAMILY
    assert alone["error_ratio"] == among_all["error_ratio"]
    assert alone["p"] < 0.05 < among_all["p"]
    assert (alone["verdict"], among_all["verdict"]) == ("better", "undecided")
    assert math.isnan(alone["needed_runs"])
    claims = [("c", "c", "d"), ("c", "a", "b"), ("c", "b", "a")]
    table = family(runs, claims)
    assert list(zip(table["case"], table["first"], table["second"], strict=True)) == claims
    undecided = table[table["verdict"] == "undecided"]
    assert len(undecided) and (undecided["needed_runs"] > 60).all()


@pytest.mark.parametrize(("ratio", "first"), [(0.6, "a"), (0.4, "b")])
def test_of_equals_the_first_is_named_unless_another_is_surely_cheaper(ratio, first):
    """Times differ between machines: they are alike within a factor of two."""
    base = np.random.default_rng(3).chisquare(3, 40)
    runs = flown({"a": base, "b": base})
    runs.loc[runs["estimator"] == "a", "seconds"] = 1e-3
    runs.loc[runs["estimator"] == "b", "seconds"] = ratio * 1e-3
    assert verdict(runs).recommended[0] == first


def test_who_succeeds_surely_less_often_is_not_recommended():
    """B ends outside the required error in a tenth of the runs, with the same RMS error."""
    base = np.full(200, 4.0)
    runs = flown({"a": base, "b": base}, required=2.5)
    outside = (runs["estimator"] == "b") & (runs["run"] % 10 < 2)
    runs.loc[outside, "final_position_error_m"] = 9.0
    assert verdict(runs).recommended == ("a",)


@pytest.mark.long
@each_law
@pytest.mark.parametrize("runs", [40, 60, 200])
def test_false_alarms_of_a_recommendation(law, runs):
    """An estimator whose RMS error is 10 % above the best one's is recommended in 5 % at most.

    150 cases: a standard error of 1.8 %, two of them.
    """
    generator, alarms = np.random.default_rng(39), 0
    for _ in range(150):
        shared = law(generator, runs)
        best, other = (shared * generator.lognormal(0.0, 0.1, runs) for _ in range(2))
        found = verdict(flown({"best": best, "other": 1.1**2 * other}))
        alarms += "other" in found.recommended
    assert alarms / 150 < 0.086


@pytest.mark.long
@each_law
@pytest.mark.parametrize("runs", [20, 60, 200])
def test_false_alarms_of_a_gain(law, runs):
    """The best of four estimators no better than the INS is called better in 5 % at most.

    It is chosen on other runs than it is compared on. 150 cases.
    """
    generator, alarms = np.random.default_rng(40), 0
    for _ in range(150):
        shared = law(generator, runs)
        errors = {label: shared + law(generator, runs) for label in ("ins", "a", "b", "c", "d")}
        alarms += verdict(flown(errors, required=3.0)).gain == "better"
    assert alarms / 150 < 0.086
