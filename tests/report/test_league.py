"""The league over the library: who counts where, who is advised, what is left out."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from leagues import EKF, INS, digest_of, dishonest, entry, league_of, renamed, with_cases
from summaries import RUNS, SAME, records

from ggbench.report import league
from ggbench.report.league import Entry, Flown, League

CUBATURE = "ukf[points=cubature]"
MEDIAN = float(np.median(np.sqrt(SAME)))
"""Median error over bound of SAME."""


def ekf(factor: float) -> list[dict]:
    return records("ekf", factor**2 * SAME, seconds=0.01)


def test_figures_of_a_standing():
    """Lost runs, time, cost, success and error over bound, over two cases of two scenarios."""
    lost = records("mine", 9.0 * SAME, seconds=0.03)
    for record in lost[:15]:
        record["diverged"] = True
    held = league_of(
        a=[[INS, EKF, records("mine", 4.0 * SAME, seconds=0.05, failed=6)]],
        b=[[INS, records("ekf", SAME, seconds=0.02), lost]],
    )
    found = league.standing("mine", held.cases)
    assert (found.causality, found.cases, found.scenarios) == ("filter", 2, 2)
    assert found.lost == pytest.approx((6 + 15) / (2 * RUNS))
    assert found.ms == pytest.approx(40.0)
    assert found.cost == pytest.approx(np.median([5.0, 1.5]))
    assert found.success == pytest.approx({"a": 0.9, "b": 0.75})
    assert found.mean_success == pytest.approx(0.825)
    ratios = [2.0 * np.median(np.sqrt(SAME[:-6])), 3.0 * np.median(np.sqrt(SAME[15:]))]
    assert found.ratio == pytest.approx({"a": ratios[0], "b": ratios[1]})
    assert found.mean_ratio == pytest.approx(math.sqrt(ratios[0] * ratios[1]))
    assert (found.good, found.open, found.honest) == (0.0, 0.0, 1.0)


def test_errors_of_who_flew_fewer_runs_are_of_the_others_runs():
    """The first third of the runs is the easy one: its median is not set beside others'."""
    order = np.sort(SAME)
    few = [record for record in records("few", order) if record["run"] < RUNS // 3]
    held = league_of(s=[[INS, records("ekf", order), few]])
    (flown,) = held.cases
    assert flown.rows["few"]["ratio_median"] < 0.7 * MEDIAN
    assert flown.ratio("few") == pytest.approx(MEDIAN) == flown.ratio("ekf")
    assert league.standing("few", held.cases).mean_ratio == pytest.approx(MEDIAN)


def test_scenarios_count_equally():
    """As good in three cases of one scenario and not in the only one of another is one half."""
    mine, bad = records("mine", SAME), records("mine", 25.0 * SAME)
    held = league_of(large=[[INS, EKF, mine]] * 3, small=[[INS, EKF, bad]])
    found = league.standing("mine", held.cases)
    assert (found.cases, found.scenarios, found.good) == (4, 2, 0.5)
    assert found.mean_ratio == pytest.approx(math.sqrt(MEDIAN * 5.0 * MEDIAN))


def test_ranks_are_of_common_cases_and_nothing_is_imputed():
    """Who stays away from the hard scenario is ranked beside the others' easy one alone."""
    held = league_of(
        easy=[[INS, EKF, records(CUBATURE, 1.21 * SAME)]],
        hard=[[INS, ekf(10.0), records("mine", SAME)]],
    )
    assert [flown.scenario for flown in held.common] == ["easy"]
    found = {s.label: s for s in held.standings}
    assert list(found) == ["ekf", CUBATURE, "ins"]
    assert {s.scenarios for s in found.values()} == {1}
    assert found["ekf"].mean_ratio == pytest.approx(MEDIAN)
    assert list(found[CUBATURE].ratio) == ["easy"]
    (beyond,) = held.others
    assert (beyond.label, beyond.scenarios, list(beyond.ratio)) == ("mine", 1, ["hard"])


def test_standings_are_ordered_by_good_then_success_error_and_cost():
    """Causal ones, the INS, smoothers; as good as the best in more scenarios comes first."""
    held = league_of(
        a=[[INS, EKF, records(CUBATURE, SAME, seconds=0.001), records("tercom", 4.0 * SAME),
            records("gauss-newton", 0.5 * SAME, "batch"),
            records("factor-graph[mode=fixed-lag]", 0.4 * SAME, "fixed-lag")]],
        b=[[INS, ekf(2.0), records(CUBATURE, SAME), records("tercom", 9.0 * SAME),
            records("gauss-newton", 0.5 * SAME, "batch"),
            records("factor-graph[mode=fixed-lag]", 0.7 * SAME, "fixed-lag")]],
    )  # fmt: skip
    assert [s.label for s in held.standings] == [
        CUBATURE, "ekf", "tercom", "ins", "gauss-newton", "factor-graph[mode=fixed-lag]",
    ]  # fmt: skip


def test_holes_have_their_reasons():
    """What the manifest says of what was left out; or that the scenario does not ask for it."""
    whole = [INS, *(renamed(EKF, label) for label in league.STANDARD)]
    told = {"tercom": "it wants a map", "mine": "it is broken"}
    held = League([entry("whole", whole), entry("some", [INS, EKF], left_out=told)])
    found = held.holes()
    assert list(found) == ["some"]
    assert set(found["some"]) == set(league.STANDARD) - {"ekf"}
    assert found["some"].pop("tercom") == "it wants a map"
    assert set(found["some"].values()) == {"the scenario does not ask for it"}


def test_advice_is_the_cheapest_of_the_best():
    """Of estimators as good as the best the cheapest; an error of 30 % more is not as good."""
    held = league_of(
        s=[[INS, EKF, records("slow", SAME, seconds=0.1),
            records("poor", 1.7 * SAME, seconds=0.001)]]
    )  # fmt: skip
    (advice,) = held.advice()
    assert (advice.situation, advice.choice.label) == ("plain", "ekf")
    assert {s.label: s.good for s in advice.standings} == {"ekf": 1.0, "slow": 1.0, "poor": 0.0}
    costs = {s.label: s.cost for s in advice.standings}
    assert costs == pytest.approx({"ekf": 1.0, "slow": 10.0, "poor": 0.1})


@pytest.mark.parametrize(
    ("seconds", "choice"), [(0.0085, "ekf"), (0.0078, "ekf[gate=0.999]"), (0.0101, "ekf")]
)
def test_a_little_time_does_not_pay_for_a_parameter(seconds, choice):
    """Of two that take about the same time, whichever is the faster, the plain one is advised."""
    held = league_of(s=[[INS, EKF, records("ekf[gate=0.999]", SAME, seconds=seconds)]])
    (advice,) = held.advice()
    assert advice.choice.label == choice


@pytest.mark.parametrize(("scenarios", "choice"), [(20, "cheap"), (19, "ekf")])
def test_advice_allows_one_exception_in_twenty(scenarios, choice):
    """A cheaper estimator may be far off in one scenario of twenty, and not in one of nineteen."""
    good, bad = (
        entry("s", [INS, EKF, records("cheap", factor * SAME, seconds=0.001)]).cases[0]
        for factor in (1.0, 9.0)
    )
    cases = [dataclasses.replace(good, scenario=f"s{k}") for k in range(scenarios - 1)]
    (advice,) = advised(*cases, dataclasses.replace(bad, scenario="other"))
    assert advice.choice.label == choice


def advised(*cases: Flown) -> list[league.Advice]:
    held = League([])
    held.cases = list(cases)
    return list(held.advice())


def test_the_dishonest_are_never_advised():
    """However near and cheap: of an estimator that lies the best is not advised, nor alone."""
    liar = dishonest(records("liar", SAME, seconds=0.001))
    (advice,) = league_of(s=[[INS, EKF, liar]]).advice()
    assert advice.choice.label == "ekf"
    assert {s.label: (s.good, s.honest) for s in advice.standings}["liar"] == (0.0, 0.0)
    (advice,) = league_of(s=[[INS, liar]]).advice()
    assert advice.choice is None and [s.label for s in advice.standings] == ["liar"]


def test_who_did_not_run_everywhere_is_not_advised():
    """A cheaper one that is as good where it ran is not set beside the others."""
    cheap = records("cheap", SAME, seconds=0.001)
    (advice,) = league_of(a=[[INS, EKF, cheap]], b=[[INS, EKF]]).advice()
    assert [s.label for s in advice.standings] == ["ekf"]
    assert (advice.choice.label, advice.scenarios) == ("ekf", ["a", "b"])


def test_where_nothing_is_gained_nobody_is_advised():
    """The situation is that of the outcome, and there is no choice."""
    (advice,) = league_of(s=[[records("ins", SAME, "none"), EKF]]).advice()
    assert (advice.situation, advice.choice) == ("nothing", None)


def test_who_succeeds_less_often_is_not_as_good():
    """Where locks are judged a small error of those found does not make up for lost runs."""
    (flown,) = entry(
        "s", [INS, records("ekf", 0.5 * SAME, locked=0.5), records("sure", SAME, locked=1.0)]
    ).cases
    assert flown.found.best["label"] == "sure"
    assert not flown.good("ekf") and flown.good("sure")


def test_too_few_runs_to_tell_are_counted_as_such():
    """As good as the best or maybe so: both are good, the second is said to be open."""
    held = league_of(s=[[INS, EKF, records("maybe", 1.1 * np.roll(SAME, 11))]])
    found = league.standing("maybe", held.cases)
    assert (found.good, found.open) == (1.0, 1.0)
    assert league.standing("ekf", held.cases).open == 0.0


def test_the_width_of_the_prior_is_over_the_fields_scale():
    """A prior of 5 m: over 100 m it is narrow, over 4 m wide; over none known it is neither."""
    for scale, situation in ((100.0, "plain"), (10.0, "between"), (4.0, "wide")):
        (flown,) = entry("s", [INS, EKF], scale_m=scale).cases
        assert (flown.width, flown.situation) == (5.0 / scale, situation)
    (flown,) = entry("s", [INS, EKF]).cases
    assert math.isnan(flown.width) and flown.situation == "plain"


@pytest.mark.parametrize(
    ("label", "name"),
    [
        ("ekf", "ekf"),
        ("ekf[iterations=5]", "ekf[iterations=5]"),
        ("factor-graph[mode=fixed-lag,lag=60]", "factor-graph[mode=fixed-lag]"),
        ("tercom[window=60,longest=60]", "tercom[window=60,longest=60]"),
    ],
)
def test_the_league_knows_estimators_without_lag(label, name):
    """Everything else is another estimator."""
    assert league.name_of(label) == name


def test_of_two_labels_of_one_name_the_first_counts():
    """In rows and in pairs: the second one's figures are nowhere."""
    first = renamed(EKF, "ekf[lag=5]")
    (flown,) = entry("s", [INS, first, records("ekf", 81.0 * SAME), records("ukf", SAME)]).cases
    assert list(flown.rows) == ["ekf", "ukf", "ins"]
    assert flown.rows["ekf"]["ratio_median"] == pytest.approx(MEDIAN)
    assert {k: pair["verdict"] for k, pair in flown.found.pairs.items() if pair}["ukf"] == "as good"


def test_what_is_not_finished_is_left_out_with_a_sentence():
    """Nobody has all runs in all cases; if anybody has, the others' fewer runs are shown."""
    text = league.entry_of(digest_of("s", [INS, EKF], asked=RUNS + 1))
    assert text == "s is left out: it is not finished, of 61 runs 60 are done in all cases"
    held = digest_of("s", [INS, EKF])
    short = with_cases(held, done={"ins": RUNS, "ekf": 40})
    found = league.entry_of(short)
    assert isinstance(found, Entry) and found.fewer == {"ekf": 40}
    nobody = league.entry_of(with_cases(held, done={}))
    assert nobody == "s is left out: it is not finished, of 60 runs 0 are done in all cases"


def test_what_the_league_does_not_count_is_left_out_with_a_sentence():
    """A study of its own, as its scenario says."""
    why = 'league = { value = false, provenance = "its flights are those of ship" }'
    text = league.entry_of(digest_of("s", [INS, EKF], campaign=why))
    assert text == "s is left out: its flights are those of ship"
    plain = league.entry_of(digest_of("s", [INS, EKF], campaign="league = false"))
    assert plain == "s is left out: its scenario asks for it"


def test_means():
    """The geometric one of 1, 10 and 100 is 10; what is no number does not count."""
    assert league.geometric_mean([1.0, 10.0, 100.0]) == pytest.approx(10.0)
    assert league.geometric_mean([math.nan, 4.0, 9.0]) == pytest.approx(6.0)
    assert league.geometric_mean([0.0, 4.0]) == 0.0
    assert league.mean([math.nan, 1.0, 3.0]) == 2.0
    assert math.isnan(league.geometric_mean([])) and math.isnan(league.mean([math.nan]))
