"""What a source says of two estimators without a number, judged from errors that are known."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from problems import SMALL
from summaries import RUNS, records, tabled

from ggbench.report.claims_section import claims_section
from ggbench.spec import scenario
from ggbench.spec.scenario import Scenario, ScenarioError

LABELS = ("ekf", "ukf[kappa=1]", "ukf[kappa=2]", "ukf[kappa=3]", "ukf[kappa=4]")


def comparison(**changes: object) -> str:
    keys = {
        "title": "better", "case": "c", "first": "ukf[kappa={}]", "relation": "smaller",
        "second": "ekf", "quantity": "error", "values": ["1", "2", "3", "4"],
    } | changes  # fmt: skip
    return "[[comparison]]\n" + "".join(f"{key} = {value!r}\n" for key, value in keys.items())


def loaded(tmp_path, *comparisons: str) -> Scenario:
    text = SMALL[: SMALL.index("[[case]]")]
    text = text.replace('["ins", "ekf"]', str(list(LABELS)))
    path = tmp_path / "claimed.toml"
    path.write_text(text + '[[case]]\nname = "c"\ntitle = "c"\n' + "".join(comparisons))
    return scenario.load(path)


@pytest.fixture(scope="module")
def tables() -> tuple[pd.DataFrame, pd.DataFrame]:
    """Errors against the first: half, twice, and a little more or less by chance, of two kinds."""
    generator = np.random.default_rng(1)
    base = generator.chisquare(3, RUNS)
    chance = np.exp(0.01 * generator.normal(size=RUNS))
    wide = np.exp(0.8 * generator.normal(size=RUNS) - 0.32)
    squares = (base, 0.25 * base, 4.0 * base, chance * base, generator.permutation(wide * base))
    seconds = (0.01, 0.005, 0.02, 0.0102, 0.01)
    return tabled(
        *(
            records(label, error, seconds=time)
            for label, error, time in zip(LABELS, squares, seconds, strict=True)
        )
    )


def verdicts(found: Scenario, tables: tuple[pd.DataFrame, pd.DataFrame]) -> list[str]:
    lines = "\n\n".join(claims_section(found, *tables)).splitlines()
    rows = [line for line in lines if line.startswith("| ") and line[2] in "1234"]
    return [row.rstrip(" |").split(" | ")[-1] for row in rows]


@pytest.mark.parametrize(
    ("relation", "quantity", "said"),
    [
        ("smaller", "error", ["holds", "**does not hold**", "not distinguishable"]),
        ("larger", "error", ["**does not hold**", "holds", "not distinguishable"]),
        ("equal", "error", ["**does not hold**", "**does not hold**", "holds"]),
        ("smaller", "time", ["holds", "**does not hold**", "not distinguishable"]),
        ("larger", "time", ["**does not hold**", "holds", "not distinguishable"]),
        ("equal", "time", ["**does not hold**", "**does not hold**", "holds"]),
    ],
)
def test_each_value_has_its_verdict(relation, quantity, said, tables, tmp_path):
    """Half, twice and the same error, and so the times; by the interval of pairs, and 5 %."""
    found = loaded(tmp_path, comparison(relation=relation, quantity=quantity))
    assert verdicts(found, tables)[:3] == said


def test_errors_that_differ_by_chance_are_neither_equal_nor_unequal(tables, tmp_path):
    """A ratio beyond 5 % whose interval holds zero decides nothing, whatever is claimed."""
    ratio = tables[0].set_index(["label", "window"]).loc[(LABELS[4], "settled"), "position_mrse_m"]
    ratio /= tables[0].set_index(["label", "window"]).loc[("ekf", "settled"), "position_mrse_m"]
    assert abs(ratio - 1.0) > 0.05
    for relation in ("smaller", "larger", "equal"):
        found = loaded(tmp_path, comparison(relation=relation))
        assert verdicts(found, tables)[3] == "not distinguishable"


def test_the_interval_is_that_of_the_pairs(tables, tmp_path):
    """As seen from the first estimator, whichever comes first in the table of pairs."""
    found = "\n".join(claims_section(loaded(tmp_path, comparison()), *tables))
    pairs = tables[1]
    row = pairs[(pairs["window"] == "settled") & (pairs["second"] == LABELS[1])].iloc[0]
    assert row["first"] == "ekf"
    said = f"{-row['position_difference_m2']:+.3g} [{-row['position_hi']:+.3g}, "
    assert said in found
    assert row["position_difference_m2"] > 0.0


def test_where_nothing_is_claimed_or_was_run_there_is_no_section(tables, tmp_path):
    assert claims_section(loaded(tmp_path), *tables) == []
    summary, pairs = tables
    unrun = summary[summary["label"] == "ekf"]
    assert claims_section(loaded(tmp_path, comparison()), unrun, pairs) == []


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"case": "d"}, r"comparison\[0\]: there is no case 'd'"),
        ({"second": "ekg"}, r"the campaign has no estimator 'ekg' \(did you mean 'ekf'"),
        ({"values": ["1", "5"]}, r"the campaign has no estimator 'ukf\[kappa=5\]'"),
        ({"first": "ekf"}, r"values need a \{\} in first or second"),
        ({"values": []}, r"values is \[\] and must not be empty"),
        ({"relation": "better"}, r"relation is 'better' and must be 'larger', 'smaller' or 'eq"),
        ({"quantity": "cost"}, r"quantity is 'cost' and must be 'error' or 'time'"),
    ],
)
def test_a_comparison_that_cannot_be_is_refused_with_a_sentence(changes, said, tmp_path):
    with pytest.raises(ScenarioError, match=said):
        loaded(tmp_path, comparison(**changes))


def test_comparisons_are_tables(tmp_path):
    path = tmp_path / "claimed.toml"
    path.write_text('comparison = "much"\n' + SMALL)
    with pytest.raises(ScenarioError, match=r"comparison must be written as \[\[comparison\]\]"):
        scenario.load(path)
