"""What each estimator gains if its parameters are chosen on other runs than it is judged on."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pandas as pd
from leagues import dishonest
from summaries import RUNS, SAME, case, records, tabled

from ggbench.figures.numbers import short
from ggbench.report.tuning_section import tuned, tuning_answer, tuning_section

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


def half(**errors: float) -> pd.DataFrame:
    """The summary of half of the runs: of ekf, its two variants and the rest; few got half."""
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
    return tabled(*groups)[0]


def results(tuning: bool, *halves: pd.DataFrame, asked: list[int] | None = None) -> Any:
    """Results whose halves are the same of however many runs; who asks for how many is noted."""

    def of_first(most: int) -> tuple[pd.DataFrame, ...]:
        (asked if asked is not None else []).append(most)
        return halves

    scenario = SimpleNamespace(campaign=SimpleNamespace(tuning=tuning), cases=(case(),))
    whole = half(plain=1.0, scaled=1.0, gated=1.0, whole=True)
    named = whole[whole["label"].isin(halves[0]["label"])]
    return SimpleNamespace(scenario=scenario, labels=LABELS, halves=of_first, summary=lambda: named)


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
    settled = judged[judged["window"] == "settled"].set_index("label")["ratio_median"]
    for cell, label in ((cells[4], "ekf"), (cells[7], "ekf[noise_scale=3]")):
        assert cell.split(" ")[0] == f"{settled[label]:.2f}"


def test_of_a_single_run_nothing_can_be_tuned():
    """There is none of odd number to be judged on."""
    training = half(plain=4.0, scaled=2.0, gated=1.0)
    assert tuning_section(tuned(results(True, training, training[:0]))) == []


def test_what_is_not_tuned_has_no_section():
    """Without the scenario's word, or without variants, nothing is told."""
    halves = half(plain=4.0, scaled=2.0, gated=1.0), half(plain=1.0, scaled=3.0, gated=1.0)
    assert tuning_section(tuned(results(False, *halves))) == []
    alone = [table[~table["label"].str.contains("[", regex=False)] for table in halves]
    assert tuning_section(tuned(results(True, *alone))) == []


def test_gains_are_told_beyond_the_intervals_alone():
    """Success counts before the error; who was dishonest and is not so any more is counted."""
    training = half(plain=4.0, scaled=2.0, gated=1.0)
    told = {
        each.name: each
        for each in tuned(results(True, training, half(plain=9.0, scaled=1.0, gated=1.0)))
    }
    assert told["`ekf`, filter"].gain == "better" and not told["`ekf`, filter"].mends
    worse = tuned(results(True, training, half(plain=1.0, scaled=9.0, gated=1.0)))
    assert worse[0].gain == "worse"
    same = tuned(results(True, half(plain=1.0, scaled=2.0, gated=3.0), training))
    assert same[0].gain == "same"
    assert tuned(results(True, training, half(plain=1.0, scaled=1.0, gated=1.0)))[0].gain == "open"
    fewer = replace(worse[0], chosen={**worse[0].chosen, "success_lo": 0.99, "success_hi": 1.0},
                    plain={**worse[0].plain, "success_lo": 0.5, "success_hi": 0.6})  # fmt: skip
    assert fewer.gain == "better"
    lying = replace(fewer, plain={**fewer.plain, "coverage": 0.1})
    assert lying.mends


def test_the_answer_counts_what_gains():
    """And names what gains most, with both of its figures."""
    training = half(plain=4.0, scaled=2.0, gated=1.0)
    told = tuned(results(True, training, half(plain=9.0, scaled=1.0, gated=1.0)))
    ratios = [short(row["ratio_median"]) for row in (told[0].plain, told[0].chosen)]
    assert (
        f"*the case*: 2 of 2 estimators (most: `ekf[noise_scale=3]` {' → '.join(ratios)} × the bound"
        in tuning_answer(told)
    )
    text = tuning_answer(tuned(results(True, training, half(plain=1.0, scaled=9.0, gated=1.0))))
    assert "1 of 2 estimators" in text and "; 1 lose" in text


def test_the_plain_one_is_that_with_the_fewest_parameters():
    """Wherever it stands among its variants."""
    training = half(plain=4.0, scaled=2.0, gated=1.0)
    swapped = results(True, training, training)
    swapped.labels = ["ekf[noise_scale=3]", "ekf"]
    assert tuned(swapped)[0].plain["label"] == "ekf"
