"""What each estimator gains if its parameters are chosen on other runs than it is judged on."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pandas as pd
import pytest
from leagues import dishonest
from summaries import RUNS, SAME, case, records, tabled

from ggbench.figures.numbers import short
from ggbench.report import tuning_section as tuning_module
from ggbench.report.families import plain_of
from ggbench.report.tuning_section import SAME as PLAIN
from ggbench.report.tuning_section import Tuned, on_other_maps, tuned, tuning_answer, tuning_section

LABELS = [
    "ins",
    "ekf",
    "ekf[noise_scale=3]",
    "ekf[gate=0.999]",
    "ukf",
    "few",
    "few[a=2]",
    "few[a=3]",
]


def half(**errors: float) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Summary and pairs of half of the runs: ekf with two variants, and the rest; few got half."""
    groups = [
        records("ins", 1e4 * SAME, "none"),
        records("ekf", errors["plain"] ** 2 * SAME),
        records("ekf[noise_scale=3]", errors["scaled"] ** 2 * SAME),
        dishonest(records("ekf[gate=0.999]", errors["gated"] ** 2 * SAME)),
        records("ukf", SAME),
        records("few", 9.0 * SAME[: RUNS // 2]),
        records("few[a=2]", 4.0 * SAME[: RUNS // 2]),
        records("few[a=3]", SAME if errors.get("whole") else SAME[: RUNS // 2]),
    ]
    return tabled(*groups)


def results(
    tuning: bool,
    *halves: tuple[pd.DataFrame, pd.DataFrame],
    asked: list[int] | None = None,
    labels: list[str] = LABELS,
) -> Any:
    """Results whose halves are the same of however many runs; who asks for how many is noted."""

    def of_first(most: int) -> tuple[pd.DataFrame, ...]:
        (asked if asked is not None else []).append(most)
        return tuple(summary for summary, _ in halves)

    scenario = SimpleNamespace(campaign=SimpleNamespace(tuning=tuning), cases=(case(),))
    whole, _ = half(plain=1.0, scaled=1.0, gated=1.0, whole=True)
    named = whole[whole["label"].isin(labels)]
    return SimpleNamespace(
        scenario=scenario, labels=labels, halves=of_first, summary=lambda: named,
        judged_pairs=lambda case, labels, most: halves[1][1],
    )  # fmt: skip


def test_the_best_on_one_half_is_judged_on_the_other():
    """Not what is best where it is judged; nor what is not honest; the plain one stands beside."""
    training = half(plain=4.0, scaled=2.0, gated=1.0)
    judged = half(plain=1.0, scaled=3.0, gated=1.0)
    asked: list[int] = []
    text = "\n".join(tuning_section(tuned(results(True, training, judged, asked=asked))))
    rows = [line for line in text.splitlines() if line.startswith("| the case")]
    assert len(rows) == 2  # the others have no variants
    assert "`few[a=3]`" in rows[1]  # which has more runs, of which those of the others count
    assert asked == [RUNS, RUNS // 2]
    cells = [cell.strip() for cell in rows[0].strip("|").split(" | ")]
    assert cells[1:4] == ["`ekf`, filter", str(RUNS // 2), "100 %"]
    assert cells[5] == "`ekf[noise_scale=3]`"
    settled = judged[0][judged[0]["window"] == "settled"].set_index("label")["ratio_median"]
    for cell, label in ((cells[4], "ekf"), (cells[7], "ekf[noise_scale=3]")):
        assert cell.split(" ")[0] == f"{settled[label]:.2f}"


def test_of_a_single_run_nothing_can_be_tuned():
    """There is none of odd number to be judged on."""
    training = half(plain=4.0, scaled=2.0, gated=1.0)
    assert tuning_section(tuned(results(True, training, (training[0][:0], training[1])))) == []


def test_what_is_not_tuned_has_no_section():
    """Without the scenario's word, or without variants, nothing is told."""
    halves = half(plain=4.0, scaled=2.0, gated=1.0), half(plain=1.0, scaled=3.0, gated=1.0)
    assert tuning_section(tuned(results(False, *halves))) == []
    alone = [label for label in LABELS if "[" not in label]
    assert tuning_section(tuned(results(True, *halves, labels=alone))) == []


def test_gains_are_the_verdict_run_by_run():
    """On the runs that judge; who was dishonest and is not so any more is seen."""
    training = half(plain=4.0, scaled=2.0, gated=1.0)

    def gain(**judged: float) -> Tuned:
        return tuned(results(True, training, half(gated=1.0, **judged)))[0]

    assert gain(plain=9.0, scaled=1.0).gain == "better" and not gain(plain=9.0, scaled=1.0).mends
    assert gain(plain=1.0, scaled=9.0).gain == "worse"
    assert gain(plain=1.0, scaled=1.0).gain == "as good"
    assert tuned(results(True, half(plain=1.0, scaled=2.0, gated=3.0), training))[0].gain == PLAIN
    lying = gain(plain=9.0, scaled=1.0)
    assert replace(lying, plain={**lying.plain, "coverage": 0.1}).mends


def test_errors_are_over_the_bound_of_the_plain_one():
    """A variant with a bound of its own, as of another lag, is not better for having less of it."""
    training, judged = (half(plain=2.0, scaled=3.0, gated=9.0) for _ in range(2))
    other = training[0]["label"] == "ekf[noise_scale=3]"
    ratios = [name for name in training[0] if name.startswith("ratio_")]
    for table, _ in (training, judged):  # over twice the bound three looks like less than two
        table.loc[other, "position_bound_m"] *= 2.0
        table.loc[other, ratios] *= 0.5
    assert tuned(results(True, training, judged))[0].label == "ekf"
    training[0].loc[other, ratios] *= 0.1
    found = tuned(results(True, training, judged))[0]
    assert found.label == "ekf[noise_scale=3]"
    ratio = found.chosen["ratio_median"] / found.plain["ratio_median"]
    assert ratio == pytest.approx(1.5)


def test_the_answer_counts_what_gains():
    """And names what gains most, with both of its figures."""
    training = half(plain=4.0, scaled=2.0, gated=1.0)
    told = tuned(results(True, training, half(plain=9.0, scaled=1.0, gated=1.0)))
    ratios = [short(row["ratio_median"]) for row in (told[0].plain, told[0].chosen)]
    most = f"(most: `ekf[noise_scale=3]` {' → '.join(ratios)} × the bound"
    assert f"*the case*: 2 of 2 estimators {most}" in tuning_answer(told)
    text = tuning_answer(tuned(results(True, training, half(plain=1.0, scaled=9.0, gated=1.0))))
    assert "1 of 2 estimators" in text and "; 1 estimator worse" in text


def test_the_plain_one_is_that_with_the_fewest_parameters():
    """Wherever it stands among its variants; or that of the standard roster."""
    training = half(plain=4.0, scaled=2.0, gated=1.0)
    swapped = results(True, training, training, labels=["ekf[noise_scale=3]", "ekf"])
    assert tuned(swapped)[0].plain["label"] == "ekf"
    assert plain_of(["ukf[points=julier]", "ukf[points=cubature]"]) == "ukf[points=cubature]"


def test_what_was_chosen_over_one_map_is_judged_over_the_others(monkeypatch):
    """By all of their runs; without a second map, or with the plain one chosen, nothing is told."""
    maps = [case(name=name, title=f"map {name}") for name in ("first", "second", "third")]
    sizes = {"first": (4.0, 2.0), "second": (4.0, 1.0), "third": (1.0, 3.0)}
    tables = [
        [table.assign(case=name) for table in half(plain=plain, scaled=scaled, gated=9.0)]
        for name, (plain, scaled) in sizes.items()
    ]
    summary, pairs = (pd.concat(kind, ignore_index=True) for kind in zip(*tables, strict=True))
    held = SimpleNamespace(
        scenario=SimpleNamespace(campaign=SimpleNamespace(tuning=True), cases=maps),
        labels=["ekf", "ekf[noise_scale=3]"], summary=lambda: summary, paired=lambda: pairs,
    )  # fmt: skip
    monkeypatch.setattr(tuning_module, "groups", lambda cases: [("maps", list(cases))])
    told = on_other_maps(held)
    assert [(each.case, each.label, each.gain) for each in told] == [
        ("map second", "ekf[noise_scale=3]", "better"),
        ("map third", "ekf[noise_scale=3]", "worse"),
    ]
    text = "\n".join(tuning_section(told, told))
    assert "better than the plain one in 1 of 2, worse in 1, and not honest in 0" in text
    monkeypatch.setattr(tuning_module, "groups", lambda cases: [("flights", list(cases))])
    assert on_other_maps(held) == []
    held.scenario.campaign.tuning = False
    assert on_other_maps(held) == []
