"""Views: estimators are compared on equal runs, and tables fit a page."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from reporting import CAUSALITY, ERRORS, cases, metric, metrics, pairs, scenario

from ggbench.report import columns, tables, views
from ggbench.report.published import (
    allowed,
    claimed,
    claims_in_words,
    from_starts,
    published_table,
)
from ggbench.spec.claims import ComparisonSpec


def test_a_planted_case_of_unequal_runs_is_refused():
    """The guard has a negative control: one run fewer in one case."""
    settled = metrics()[lambda table: table["window"] == "settled"].copy()
    views.require_equal_runs(settled)
    settled.loc[(settled["case"] == "c1") & (settled["estimator"] == "ukf"), "runs"] = 39
    with pytest.raises(views.UnequalRunsError, match=r"c1 compares unequal runs .*ukf: 39"):
        views.require_equal_runs(settled)


def test_estimators_with_fewer_runs_are_left_out_of_a_comparison():
    """Of tables, figures and groups; a page names them."""
    table = metrics(runs={"gaussian-sum": 10})
    assert "gaussian-sum" not in set(views.comparable(table)["estimator"])
    assert "gaussian-sum" not in views.drawn_estimators(table, cases())
    assert "gaussian-sum" in views.drawn_estimators(metrics(), cases())
    assert views.left_out(table, cases()) == ["gaussian-sum"]


def test_an_estimator_with_fewer_runs_is_compared_run_by_run():
    """Its cell is the ratio to the EKF's error on common runs, whichever comes first."""
    table, named = metrics(runs={"gaussian-sum": 10}), cases(recommended="gaussian-sum")
    for row in (("gaussian-sum", "ekf", 0.8), ("ekf", "gaussian-sum", 1.25)):
        first, second, ratio = row
        found = pairs(*((case, first, second, ratio, 10, "better") for case in ("c0", "c1")))
        shown = views.answer_table(table, found, named)
        assert shown["`gaussian-sum` (recommended)"].tolist() == ["0.80 × EKF (10 runs)"] * 2


def test_cells_have_error_ratio_success_and_symbol():
    row = metric("c0", "ekf", "settled", 6.0)
    assert tables.error_cell(row) == "6.00 (×1.50)"
    assert tables.error_cell(row | {"success": 0.5, "consistency": "unsafe"}) == (
        "6.00 (×1.50), 50% ‡"
    )
    assert tables.error_cell(row | {"efficiency": float("nan")}) == "6.00"
    assert tables.error_cell(metric("c0", "ins", "settled", 100.0)) == "100, 0%"


def test_a_cell_of_lost_runs_has_their_share():
    """Of most runs, not of half of them."""
    row = metric("c0", "ekf", "settled", 22900.0) | {"consistency": "unsafe", "success": 0.05}
    assert tables.error_cell(row | {"lost": 38}) == "lost 95% ‡"
    assert tables.error_cell(row | {"lost": 20}) == "22900 (×5700), 5.0% ‡"


def test_a_cell_says_where_the_ins_succeeds_as_often():
    row = metric("c0", "ekf", "settled", 6.0) | {"as_ins": True}
    assert tables.error_cell(row) == "6.00 (×1.50), ≤ INS"
    assert tables.error_cell(row | {"success": 0.84}) == "6.00 (×1.50), 84% (≤ INS)"


def test_the_cell_of_the_ins_has_its_success_rate():
    """Unless it succeeds in all runs, as any estimator's."""
    row = metric("c0", "ins", "settled", 6.0) | {"causality": "none", "success": 0.0}
    assert tables.error_cell(row) == "6.00, 0%"
    assert tables.error_cell(row | {"success": 1.0}) == "6.00"


def test_a_column_with_least_bad_estimators_says_so():
    """They are in italics. A column of recommended estimators alone has no such word."""
    named = cases().assign(recommended=["gaussian-sum", "ukf"])
    assert "cheapest recommended" in views.answer_table(metrics(), pairs(), named)
    named = named.assign(recommended=["ukf", ""])
    shown = views.answer_table(metrics(), pairs(), named)["cheapest recommended or *least bad*"]
    assert shown.str.startswith("*").tolist() == [False, True]


def test_the_recommended_ekf_is_one_column():
    shown = views.answer_table(metrics(), pairs(), cases())
    assert list(shown) == [
        "case",
        "bound_m",
        "INS",
        "EKF (recommended)",
        "`factor-graph[mode=batch]` (smoother)",
    ]
    assert shown["EKF (recommended)"].tolist() == ["5.00 (×1.25)", "10.0 (×1.25)"]


def test_the_best_is_in_italics_where_none_is_recommended():
    """Where that is so in all cases, the column is of the least bad."""
    shown = views.answer_table(metrics(), pairs(), cases(recommended=""))
    assert shown["`gaussian-sum` (least bad)"].tolist() == ["*4.00 (×1.00)*", "*8.00 (×1.00)*"]
    named = cases().assign(recommended=["gaussian-sum", ""])
    shown = views.answer_table(metrics(), pairs(), named)
    column = shown["`gaussian-sum` (recommended or *least bad*)"]
    assert column.tolist() == ["4.00 (×1.00)", "*8.00 (×1.00)*"]


def test_the_ekf_alone_is_called_the_least_bad_where_it_is_not_recommended():
    shown = views.answer_table(metrics(), pairs(), cases(recommended="", best="ekf"))
    assert shown["EKF (least bad)"].tolist() == ["*5.00 (×1.25)*", "*10.0 (×1.25)*"]


def test_an_error_surely_below_a_bound_is_remarked_where_the_model_is_wrong():
    """Not where the model is right: there the page has the ratio."""
    right, wrong = metrics(), metrics().assign(efficiency=math.nan)
    assert not views.below_bound(right.assign(rms_hi=0.5 * right["bound_m"]), cases())
    assert not views.below_bound(wrong.assign(rms_hi=wrong["bound_m"]), cases())
    assert views.below_bound(wrong.assign(rms_hi=0.5 * wrong["bound_m"]), cases())


def test_cells_that_agree_within_one_per_cent_are_said_to_be_equal():
    """The UKF is 0.8 % from the EKF, the Gaussian sum 20 %."""
    named = cases()
    named["recommended"] = ["ukf", "gaussian-sum"]
    shown = views.answer_table(metrics(), pairs(), named)
    assert shown["cheapest recommended"].tolist() == [
        "`ukf` (≈ EKF)",
        "`gaussian-sum` 8.00 (×1.00)",
    ]


def test_estimators_of_ones_own_have_columns():
    """Next to the EKF, with RMS errors, even if no table would name them; merged if recommended."""
    errors = ERRORS | {"mine": 6.0, "mine[gain=2]": 5.0}
    own = ["mine", "mine[gain=2]"]
    table = metrics(errors=errors)
    shown = views.answer_table(table, pairs(), cases(), own)
    assert list(shown)[3:6] == ["EKF (recommended)", "`mine`", "`mine[gain=2]`"]
    assert shown["`mine`"].tolist() == ["6.00 (×1.50)", "12.0 (×1.50)"]
    merged = views.answer_table(table, pairs(), cases(recommended="mine"), own)
    assert merged["`mine` (recommended)"].tolist() == shown["`mine`"].tolist()
    assert not [head for head in merged if head.startswith("recommended")]


def test_many_estimators_of_ones_own_have_rows():
    """A row for each of five, and a column for each case, within the limits of a table."""
    own = [f"mine-{k}" for k in range(7)]
    table = metrics(5, ERRORS | dict.fromkeys(own, 6.0))
    shown = views.answer_table(table, pairs(), cases(5, recommended="gaussian-sum"), own)
    assert shown["RMS error [m]"].tolist() == [
        "bound",
        "INS",
        "EKF",
        *(f"`{label}`" for label in own[:5]),
        "`gaussian-sum` (recommended)",
        "`factor-graph[mode=batch]` (smoother)",
    ]
    assert shown["case 1"].tolist()[:4] == ["8.00", "200, 0%", "10.0 (×1.25)", "12.0 (×1.50)"]
    assert tables.text(shown)


def test_an_estimator_that_failed_everywhere_has_its_column():
    table = metrics(errors=ERRORS | {"mine": 6.0})
    table.loc[table["estimator"] == "mine", ["rms_m", "efficiency"]] = math.nan
    table.loc[table["estimator"] == "mine", "failed"] = 40
    shown = views.answer_table(table, pairs(), cases(), ["mine"])
    assert shown["`mine`"].tolist() == ["failed", "failed"]


def test_published_errors_are_set_against_those_of_ones_own():
    """Before nearer ones, in a row that others share; also of an estimator that failed."""
    table = metrics(1, ERRORS | {"mine": 5.01, "wrong": 1.0}).assign(published_m=7.0)
    gone = table["estimator"] == "wrong"
    table.loc[gone, ["rms_m", "rms_lo", "rms_hi", "bound_m"]] = math.nan
    table.loc[gone, "failed"] = 40
    shown = published_table(table, {"c0": "first"}, ["mine", "wrong"])
    assert shown["RMS error [m]"].tolist()[3:] == [
        "`ins`",
        "`wrong`",
        "`ekf`, `mine`, `ukf`",
        "`factor-graph[mode=batch]`",
        "`gaussian-sum`",
    ]
    assert shown["first: settled"].tolist()[4:6] == ["failed", "5.00"]


def test_windows_from_several_starts_have_the_estimators_of_ones_own():
    """Planted errors fall from 20 m to 10 m at 100 s; of three cases there are three rows each."""
    times = np.arange(1.0, 201.0)
    series = np.zeros((4, 200, 2))
    series[:, :, 0] = np.where(times < 100.0, 20.0, 10.0)
    arrays = {"times": times, "kept": np.arange(200), "bound-filter": np.full((200, 2), 9.0)}
    results = SimpleNamespace(
        arrays=lambda case: arrays,
        series=lambda case, label: series if label != "broken" else series[:0],
        scenario=SimpleNamespace(case=lambda name: SimpleNamespace(title=f"case {name}")),
    )
    table = metrics(3).assign(published_m=7.0)
    found = from_starts(results, table, ["ekf", "broken", "mine", "second"])
    assert found.iloc[:, 0].tolist() == [
        f"case c{n}: {name}" for n in range(3) for name in ("bound", "`ekf`", "`mine`")
    ]
    assert found["100 s"].tolist() == ["3.00", "10.0", "10.0"] * 3
    assert found["0 s"].tolist()[2] == columns.metres(np.sqrt((99 * 400 + 101 * 100) / 200))
    assert tables.text(found)
    assert from_starts(results, table, ["broken"]).empty


def test_published_errors_are_shown_where_every_filter_failed():
    table = metrics(1, {"ekf": 1.0}).assign(published_m=7.0, bound_m=math.nan, rms_m=math.nan)
    assert allowed(table).empty
    shown = published_table(table, {"c0": "first"}, ["ekf"])
    assert shown["first: whole"].tolist() == ["7.00", "–", "failed"]


def test_a_page_shows_the_cases_that_decide():
    """One case of each set of recommended estimators, then those in which estimators differ most.

    Of twelve cases the EKF is recommended in all but c3 and c7; in c5, c6 and c9 the Gaussian sum
    is planted 10, 30 and 20 times better than in the others.
    """
    table, named = metrics(12), cases(12)
    settled = table["window"] == "settled"
    for case, label in (("c3", "ukf"), ("c7", "")):
        own = settled & (table["case"] == case)
        table.loc[own, "recommended"] = table.loc[own, "estimator"] == label
    for case, factor in (("c5", 10.0), ("c6", 30.0), ("c9", 20.0)):
        own = (table["case"] == case) & (table["estimator"] == "gaussian-sum")
        table.loc[own, "rms_m"] /= factor
    few = views.deciding_cases(table, named)
    assert few["case"].tolist() == ["c3", "c5", "c6", "c7", "c9"]
    assert len(views.deciding_cases(table, named.iloc[:4])) == 4


def test_cases_are_spread_evenly():
    """Of figures over time and parts of a sweep: in order, with the first and the last one."""
    few = views.few_cases(cases(20))
    assert len(few) == 5 and few["case"].iloc[[0, -1]].tolist() == ["c0", "c19"]
    assert few["case"].tolist() == [f"c{n}" for n in sorted(int(k[1:]) for k in few["case"])]
    assert len(views.few_cases(cases(3))) == 3


def test_a_figure_has_six_families_at_most():
    """One estimator of each name and causality; those of the table come first."""
    errors = {"ins": 9.0, "ekf": 5.0, "ekf[iterations=5]": 4.0, "factor-graph": 3.0}
    errors |= {"factor-graph[mode=batch]": 2.0} | {f"filter-{k}": 10.0 + k for k in range(9)}
    found = views.drawn_estimators(metrics(errors=errors), cases(best="filter-8"))
    assert found[:3] == ["ekf", "filter-8", "factor-graph[mode=batch]"]
    assert len(found) == 6 and "ins" not in found and "ekf[iterations=5]" not in found
    assert CAUSALITY["factor-graph[mode=batch]"] == "batch" and "factor-graph" in found


def test_a_figure_has_all_estimators_of_ones_own():
    """Behind the EKF, though others are better; variants of one name, too."""
    own = ["mine", "mine[gain=2]"]
    errors = ERRORS | dict.fromkeys(own, 90.0) | {f"filter-{k}": 1.0 for k in range(9)}
    found = views.drawn_estimators(metrics(errors=errors), cases(), own)
    assert found[:3] == ["ekf", *own] and len(found) == 6
    assert not set(own) & set(views.drawn_estimators(metrics(errors=errors), cases()))


def test_tables_that_do_not_fit_are_refused():
    for shape in ((11, 2), (2, 9)):
        with pytest.raises(ValueError, match="does not fit a page"):
            tables.text(pd.DataFrame([["x"] * shape[1]] * shape[0]).rename(columns=str))
    assert tables.text(pd.DataFrame({"a|b": ["c|d"], "rms_m": [1.0]})) == (
        "|a\\|b|RMS error [m]|\n|---|---|\n|c\\|d|1.00|"
    )


def test_published_errors_are_set_against_the_bound():
    """8 m over the whole flight: 7 m lies below; estimators within 1 % share a row."""
    table = metrics(1).assign(published_m=7.0)
    assert allowed(table)["allowed"].tolist() == [False, True]
    shown = published_table(table, {"c0": "first"})
    assert shown["first: whole"].tolist() == [
        "7.00 (below filter bound)",
        "8.00",
        "4.00",
        "200",
        "4.00",
        "8.00",
        "10.0",
    ]
    assert shown["RMS error [m]"].tolist()[-2:] == ["`gaussian-sum`", "`ekf`, `ukf`"]


@pytest.mark.parametrize(
    ("relation", "verdict", "needed", "row"),
    [
        ("smaller", "better", math.nan, {"holds": "holds"}),
        ("smaller", "worse", math.nan, {"holds": "does not hold"}),
        ("larger", "worse", math.nan, {"holds": "holds"}),
        ("equal", "equivalent", math.nan, {"holds": "holds"}),
        ("equal", "better", math.nan, {"holds": "does not hold"}),
        ("smaller", "undecided", 151.3, {"holds": "open", "needed_runs": "160"}),
        ("smaller", "undecided", 4000.0, {"holds": "open", "needed_runs": "> 400"}),
    ],
)
def test_claims_on_pairs_follow_the_verdict(relation, verdict, needed, row):
    """Of the family of claims; an open one says how many runs would decide it."""
    claim = ComparisonSpec(
        title="A", case="c0", first="ukf", relation=relation, quantity="error", second="ekf"
    )
    absent = claim.model_copy(update={"first": "not-flown"})
    asked = []

    def pairs_of(wanted: list[tuple[str, str, str]]) -> pd.DataFrame:
        asked.extend(wanted)
        held = pairs(*((*names, 0.5, 40, verdict) for names in wanted))
        return held.assign(needed_runs=needed)

    results = scenario(
        scenario=scenario(comparisons=(absent, claim)), metrics=metrics, pairs_of=pairs_of
    )
    (found,) = claimed(results).to_dict("records")
    assert asked == [("c0", "ukf", "ekf")]
    assert found == {"claim": "A", "first": "`ukf`", "second": "`ekf`", "error_ratio": 0.5} | row


def test_a_claim_finds_its_estimators_whatever_the_order_of_their_parameters():
    """A scenario states ``window`` first, and the labels of the runs sort by the class."""
    label = "correlation[association=nearest,window=12]"
    claim = ComparisonSpec(
        title="A",
        case="c0",
        first="correlation[window=12,association=nearest]",
        relation="smaller",
        quantity="error",
        second="ekf",
    )
    table = metrics().replace({"estimator": {"ukf": label}})
    results = scenario(
        scenario=scenario(comparisons=(claim,)),
        metrics=lambda: table,
        pairs_of=lambda wanted: pairs(*((*names, 0.5, 40, "better") for names in wanted)),
        shown={label: label, "ekf": "ekf"},
    )
    found = claimed(results)
    assert found[["first", "holds"]].values.tolist() == [[f"`{label}`", "holds"]]


@pytest.mark.parametrize(
    ("first", "value", "title"),
    [
        ("reduced[filter=particle,noise={}]", "1e-05", "A (noise=1e-05)"),
        ("{}", "ukf", "A (ukf)"),
        ("ukf", "", "A"),
    ],
)
def test_the_title_of_a_claim_states_the_parameter_of_its_value(first, value, title):
    values = {"values": (value,)} if value else {}
    claim = ComparisonSpec(
        title="A",
        case="c0",
        first=first,
        relation="smaller",
        quantity="error",
        second="ekf",
        **values,
    )
    assert claim.title_of(value) == title


def test_the_caption_of_claims_counts_the_verdicts():
    verdicts = pd.DataFrame({"holds": ["open", "holds", "does not hold", "open"]})
    words = claims_in_words(verdicts)
    assert words == "Claims tested: 1 hold, 1 do not, 2 are open. Ratio: first over second"
    assert claims_in_words(verdicts[:0]) == ""
    assert claims_in_words(verdicts[1:2]).startswith("Claims tested: 1 hold. ")
