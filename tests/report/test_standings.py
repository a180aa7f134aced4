"""The figures of the league, of its advice and of the opening sentences, worked out by hand."""

from __future__ import annotations

import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from summaries import RUNS, SAME, case, records, tabled

from ggbench.report import league, league_page, opening
from ggbench.report.league import Entry, Flown, League

SQUARE = float(SAME.mean())
"""Mean squared error of SAME: its MRSE is the root, beside a bound of 1 m."""
INS = records("ins", 1e4 * SAME, "none")


def flown(name: str, *groups: list[dict[str, Any]], **changes: Any) -> Flown:
    return league._flown(name, case(**changes), *tabled(*groups))


def entry(name: str, *cases: Flown) -> Entry:
    named = SimpleNamespace(name=name, title=name, description="What it is. More.")
    return Entry(Path(name), named, {}, list(cases))


def test_figures_of_a_standing():
    """Lost runs, time, cost, efficiency and consistency, over two cases of two scenarios."""
    one = flown(
        "a",
        INS,
        records("ekf", SAME, seconds=0.02, locked=1.0),
        records("mine", 4.0 * SAME, seconds=0.05, failed=6, locked=0.5),
    )
    two = flown(
        "b",
        INS,
        records("ekf", SAME, seconds=0.01, locked=1.0),
        records("mine", 9.0 * SAME, seconds=0.03, diverged=True, locked=1.0),
    )
    found = {s.label: s for s in league.standings([one, two])}["mine"]
    assert found.lost == pytest.approx((6 + RUNS) / (2 * RUNS))
    assert found.ms == pytest.approx(40.0)
    assert found.cost == pytest.approx(np.median([2.5, 3.0]))
    assert found.locked == pytest.approx(
        np.mean([one.rows["mine"]["lock_share"], two.rows["mine"]["lock_share"]])
    )
    assert found.by_scenario["b"] == pytest.approx(3.0)
    assert found.efficiency["b"] == pytest.approx(math.sqrt(9.0 * SQUARE))
    assert found.own == pytest.approx(math.sqrt(found.by_scenario["a"] * 3.0))
    assert (found.ran, found.coverage, found.judged) == (2, 1.0, 2)


@pytest.mark.parametrize(("nees", "inside"), [(1.0, 0), (6.0, 1), (15.0, 0)])
def test_consistent_is_within_the_band(nees, inside):
    """Neither too much nor too little confidence; 60 runs have a band of 5.2 to 6.9."""
    own = records("ekf", SAME)
    for record in own:
        windows = record["windows"]
        record["windows"] = {k: figures | {"nees": nees} for k, figures in windows.items()}
    (found,) = league.standings([flown("a", own)])
    assert (found.consistent, found.judged) == (inside, 1)


def test_each_estimator_is_set_beside_its_own_bound():
    """The bound of a smoother is not that of the best filter."""
    summary, pairs = tabled(records("ekf", SAME), records("late", SAME, "batch"))
    summary.loc[summary["label"] == "late", "position_bound_m"] = 0.5
    found = league._flown("a", case(), summary, pairs)
    assert found.efficiency("late") == pytest.approx(2.0 * found.efficiency("ekf"))


def test_scenarios_count_equally():
    """Who ran one scenario of three cases, and not one of a single case, ran half of it."""
    ekf = records("ekf", SAME)
    cases = [flown("large", ekf, records("some", SAME)) for _ in range(3)] + [flown("b", ekf)]
    found = {s.label: s for s in league.standings(cases)}
    assert (found["some"].ran, found["some"].coverage) == (3, 0.5)
    held = League([entry("large", *cases[:3]), entry("b", cases[3])])
    assert not any(held.is_partial(s) for s in held.standings)
    rare = records("rare", 0.2 * SAME)
    many = [flown(name, ekf) for name in "abc"] + [flown(name, ekf, rare) for name in "de"]
    held = League([entry(f.scenario, f) for f in many])
    assert [(s.label, held.is_partial(s)) for s in held.standings] == [
        ("ekf", False), ("rare", True),
    ]  # fmt: skip


def test_what_one_scenario_alone_has_run_is_named_and_not_listed(tmp_path):
    """A sentence per scenario, variants counted; of a single scenario everything is listed."""
    ekf = records("ekf", SAME)
    own = [records(f"mine[size={size}]", SAME) for size in (1, 2, 3)]
    held = League([entry("a", flown("a", ekf, *own, records("other", SAME))),
                   entry("b", flown("b", ekf))])  # fmt: skip
    assert [s.label for s in held.standings] == ["ekf"]
    assert held.local == {"a": ["mine[size=1]", "mine[size=2]", "mine[size=3]", "other"]}
    page = league_page.LeagueReport(held, tmp_path)
    assert page._local().endswith("only: [a](a.md): `mine` in 3 variants, `other`.")
    alone = League([entry("a", flown("a", ekf, *own))])
    assert len(alone.standings) == 4
    assert (alone.local, league_page.LeagueReport(alone, tmp_path)._local()) == ({}, "")


def test_who_is_as_good_as_the_best():
    """Within 2 %, or within 10 % and not distinguishable; not who fails in over 5 % of the runs."""
    noise = np.random.default_rng(3).lognormal(0.0, 1.0, RUNS)
    scattered = SAME * noise * 1.16 * SQUARE / np.mean(SAME * noise)
    found = flown(
        "a", records("ekf", SAME), records("near", 1.03 * SAME), records("sure", 1.15 * SAME),
        records("undecided", scattered), records("far", 1.5 * scattered),
        records("frail", 1.001 * SAME, failed=4), records("ins", 1.01 * SAME, "none"),
    )  # fmt: skip
    assert found.best["label"] == "ekf"
    assert 1.02 < found.ratio("undecided") < 1.1 < found.ratio("far")
    good = {label for label in found.rows if found.as_good(label)}
    assert good == {"ekf", "near", "undecided", "ins"}


def test_who_ran_everywhere_is_advised_before_who_did_not():
    """A cheaper one that is as good where it ran, but did not run everywhere, comes second."""
    ekf = records("ekf", SAME)
    cheap = records("cheap", SAME, seconds=0.001)
    held = League([entry("a", flown("a", INS, ekf, cheap)), entry("b", flown("b", INS, ekf))])
    (advice,) = held.advice()
    assert (advice.choice, advice.as_good) == ("ekf", True)
    assert advice.equal == {"ekf": 2, "cheap": 1}


def test_one_bad_case_of_few_is_no_exception():
    """As good in all but one of twenty cases: of two cases, in both."""
    ekf, cheap = records("ekf", SAME), records("cheap", SAME, seconds=0.001)
    worse = records("cheap", 4.0 * SAME, seconds=0.001)
    cases = [flown("a", INS, ekf, cheap), flown("b", INS, ekf, worse)]
    (advice,) = League([entry(f.scenario, f) for f in cases]).advice()
    assert advice.choice == "ekf"


def test_the_geometric_mean():
    """Of 1, 10 and 100 it is 10; what is no number does not count."""
    assert league.geometric_mean([1.0, 10.0, 100.0]) == pytest.approx(10.0)
    assert league.geometric_mean([math.nan, 4.0, 9.0]) == pytest.approx(6.0)
    assert math.isnan(league.geometric_mean([]))


def told(*groups: list[dict[str, Any]]) -> str:
    return opening.case_answer(case(), *tabled(*groups))


def test_a_small_gain_is_said_in_percent_of_the_ins():
    """An INS with 1.25 times the error: aiding leaves 20 % less; efficiency is of the position."""
    summary, pairs = tabled(records("ins", 1.25**2 * SAME, "none"), records("ekf", SAME))
    summary["velocity_efficiency"] = 77.0
    text = opening.case_answer(case(), summary, pairs)
    assert "20 % less than the INS's" in text
    assert f"(efficiency {math.sqrt(SQUARE):.2f})" in text


@pytest.mark.parametrize(("worse", "end"), [(6, " (× 7.00)"), (8, " and 2 more")])
def test_of_many_estimators_the_best_six_are_named(worse, end):
    """A sentence of forty names is none; the others are counted, and stand in the table."""
    others = [records(f"e{i}", (i + 2.0) ** 2 * SAME) for i in range(worse)]
    said = told(records("ins", 400.0 * SAME, "none"), records("ekf", SAME), *others)
    (part,) = (part for part in said.split("; ") if part.startswith("significantly worse"))
    assert part.count("`e") == 6
    assert part.endswith(end)


def test_without_a_verdict_a_gain_is_none_only_near_one():
    """Twice or half the INS's error, undecided, is unproven; within 5 % of it nothing is gained."""
    for ratio, kind in ((2.0, "unproven"), (0.5, "unproven"), (1.04, "nothing"), (0.96, "nothing")):
        rows = {"position_mrse_m": 1.0}, {"position_mrse_m": ratio}
        assert opening.gain(*rows, None) == kind


@pytest.mark.parametrize(("wins", "mostly"), [(36, False), (37, True)])
def test_most_runs_are_so_many_that_a_coin_would_not_do_it(wins, mostly):
    """60 throws of a fair coin show 37 heads or more in 4.6 % of all cases, 36 in 7.8 %."""
    pair = {"runs": 57, "first_only": 2, "second_only": 1, "position_win_rate": wins / 60}
    assert opening._mostly(pair) == mostly


def test_where_no_filter_is_left_the_least_error_is_told():
    """Of a smoother and the INS, the smoother's."""
    text = told(records("ins", 1e4 * SAME, "none"), records("late", SAME, "batch"))
    assert f"the least position MRSE is that of `late` (batch), {math.sqrt(SQUARE):.2f} m" in text


def test_many_cases_are_told_from_the_least_to_the_largest_efficiency():
    """Who is best in how many, and between which multiples of the bound."""
    summaries, pairs = zip(
        *(tabled(records("ekf", factor * SAME), INS) for factor in (1.0, 4.0, 9.0)), strict=True
    )
    names = ("c", "d", "e")
    joined = [
        league.pd.concat(
            [table.assign(case=name) for table, name in zip(tables, names, strict=True)]
        )
        for tables in (summaries, pairs)
    ]
    text = opening._of_many([case(name=name) for name in names], *joined)
    low, high = math.sqrt(SQUARE), 3.0 * math.sqrt(SQUARE)
    assert f"its position MRSE is {low:.2f} to {high:.2f} times the bound" in text
    assert "the best causal estimator is `ekf` in 3" in text
    assert "aiding gains on the INS in 3" in text


def page(*cases: Flown) -> str:
    entries = [entry(name, *(f for f in cases if f.scenario == name))
               for name in dict.fromkeys(f.scenario for f in cases)]  # fmt: skip
    report = league_page.LeagueReport(League(entries), Path("nowhere"))
    advice = "\n".join(report._advice(advice) for advice in report.league.advice())
    return f"{advice}\n{report._scenarios()}"


def test_the_page_tells_of_aiding_that_gains_nothing():
    """Only who is over 10 % worse than the INS is named."""
    same = SAME * (1.0 + 1e-12)
    text = page(
        flown("a", records("ins", SAME, "none"), records("ekf", same), records("bad", 4.0 * SAME))
    )
    assert "the INS alone; no causal estimator beats it in a/c" in text
    assert "More than 10 % worse than the INS: `bad`." in text


def test_the_page_lists_scenarios_with_ins_best_and_bound():
    """Geometric means over the cases: of the INS, of the best, and of its bound."""
    text = page(flown("a", INS, records("ekf", SAME)), flown("a", INS, records("ukf", 16.0 * SAME)))
    line = next(line for line in text.splitlines() if line.startswith("| [a](a.md)"))
    cells = [cell.strip() for cell in line.strip("|").split("|")]
    assert cells[1:4] == ["What it is.", "2", "`ekf` (1), `ukf` (1)"]
    wanted = (100.0 * math.sqrt(SQUARE), 2.0 * math.sqrt(SQUARE), 1.0)
    assert [float(cell) for cell in cells[4:]] == pytest.approx(wanted, rel=0.01)


def test_advice_warns_of_what_is_worse_than_the_ins():
    """If all that is left to advise has larger errors than the INS, by how much is said."""
    unsure = 4.0 * SAME * np.where(np.arange(RUNS) == 7, 1e3, 1.0)
    text = page(flown("a", records("ins", SAME, "none"), records("ekf", unsure)))
    times = math.sqrt(float(unsure.mean()) / SQUARE)
    assert f"Its MRSE is {league_page.number(times)} times the INS's" in text


@pytest.mark.parametrize(("share", "text"), [(0.0, "0 %"), (0.004, "0.4 %"), (0.25, "25 %")])
def test_shares_are_in_percent(share, text):
    """Small ones with a digit behind the point."""
    assert league_page._share(share) == text
