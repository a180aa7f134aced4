"""The answer of a page names the estimator that is recommended most often, not the cheapest."""

from __future__ import annotations

import pandas as pd
from reporting import cases, metrics, scenario

from ggbench.report.answers import answer, leading, named_among
from ggbench.report.page_templates import environment


def stated(mine=(), **changes):
    """The answer of two cases in which three filters are recommended, the Gaussian sum in both."""
    table = metrics()
    settled = table["window"] == "settled"
    among = {"c0": ["ekf", "gaussian-sum"], "c1": ["ukf", "gaussian-sum"]}
    for case, labels in among.items():
        own = settled & (table["case"] == case)
        table.loc[own, "recommended"] = table.loc[own, "estimator"].isin(labels)
    named = cases().assign(**({"recommended": ["ekf", "ukf"]} | changes))
    runs = pd.DataFrame(
        {"assumption": [""], "estimator": ["ekf"], "remark": [""], "status": ["ok"], "case": ["a"]}
    )
    return answer(
        scenario(
            scenario=scenario(),
            metrics=lambda: table,
            cases=lambda: named,
            runs=lambda: runs,
            own=[*mine],
        )
    )


def test_the_answer_counts_all_recommendations():
    """The cheapest of each case is another one, each of one case."""
    found = stated()
    assert (found["label"], found["count"], found["recommended"]) == ("gaussian-sum", 2, 2)
    assert found["lead"]["case"] == "c0" and found["row"]["rms_m"] == 4.0


def test_without_a_recommendation_the_answer_says_why():
    found = stated(recommended=["", ""], not_recommended=["", "none is consistent"])
    assert (found["label"], found["recommended"]) == ("gaussian-sum", 0)
    assert found["reason"] == "none is consistent"


def test_the_answer_has_the_error_of_ones_own_estimator():
    """In the case of the answer; not twice where it is the answer itself."""
    words = environment().get_template("answer.j2")
    assert "`ekf` has 5.00 m (95%: 4.50–5.50 m, 1.25× oracle)." in words.render(
        answer=stated(mine=["ekf"])
    )
    assert stated(mine=["gaussian-sum"])["own"] == stated()["own"] == []


def text_of(found, **changes) -> str:
    """The answer as it is printed."""
    return environment().get_template("answer.j2").render(answer=found | changes)


def test_the_answer_counts_the_cases_without_a_recommendation():
    found = stated(recommended=["ekf", ""])
    text = text_of(found, total=3, count=2, cheapest=2, without=["c1"], inconsistent=["ukf"])
    assert "In 2 of 3 cases `gaussian-sum` is recommended, in 1 none." in text
    assert "Its RMS error in “case 0” is 4.00 m (95%: " in text
    others = text_of(found, total=4, count=2, cheapest=1, without=["c1"])
    assert "`gaussian-sum` is recommended (cheapest in 1), in 1 another estimator, in 1" in others
    assert "The RMS error of `gaussian-sum` in “case 0” is 4.00 m (95%: " in others
    assert "; INS: " in text
    text = text_of(stated(), inconsistent=["ukf"])
    assert "In all 2 cases `gaussian-sum` is recommended (cheapest in none)." in text
    assert "Not always consistent: `ukf`." in text
    text = text_of(stated(), total=1, inconsistent=["ukf"])
    assert "is recommended. Its RMS error is 4.00 m" in text and "Not consistent: `ukf`." in text


def test_the_answer_of_a_sweep_lists_the_values_that_reach_each_target():
    """The largest one with its unit, or all of them; the axis is named once."""
    rows = [["1", "a", "–", "none"], ["10", "a", "–", "3.2 E (3–4)"], ["20", "a", "–", "at 1, 5 E"]]
    heads = ["RMS error [m]", "case", "bound", "EKF"]
    several = pd.DataFrame(rows, columns=heads)
    found = stated() | {"axis": "noise"}
    assert text_of(found, targets=several).endswith(
        "In “a” the EKF reaches an RMS error of 1 m for no noise; 10 m for up to 3.2 E (3–4); 20 m "
        "at 1, 5 E."
    )
    text = text_of(found, targets=several.iloc[1:])
    assert "10 m for noise up to 3.2 E (3–4); 20 m at 1, 5 E." in text
    text = text_of(found, targets=several.iloc[2:])
    assert "of 20 m for noise at 1, 5 E." in text
    text = text_of(found, targets=pd.DataFrame([["1", "a", "–", "any"]] * 2, columns=heads))
    assert "1 m for any noise; 1 m for any." in text


def test_the_answer_on_priors_names_the_largest_ratio():
    text = text_of(stated(), recovered=[("ekf", 0.5), ("ukf", 0.0)], runs=40)
    assert text.endswith(
        "At least 95% of 40 runs succeed up to σ/ℓ = 0.50 with `ekf`, at no σ/ℓ tested with `ukf`."
    )


def test_an_answer_on_priors_names_four_estimators_with_ones_own():
    """The widest first; one's own in its place, instead of the fourth."""
    found = [("a", 0.9), ("b", 0.8), ("c", 0.7), ("d", 0.6), ("mine", 0.1), ("e", 0.0)]
    assert named_among(found, []) == found[:4]
    assert named_among(found, ["mine"]) == [*found[:3], ("mine", 0.1)]


def test_the_answer_is_of_a_case_that_the_table_shows():
    """Of twelve cases the table shows the last five, in which the filters differ most."""
    table, named = metrics(12), cases(12, recommended="ekf")
    last = table["case"].isin([f"c{n}" for n in range(7, 12)])
    table.loc[last & (table["estimator"] == "gaussian-sum"), "rms_m"] /= 10.0
    run = {"assumption": "", "estimator": "ekf", "case": "c7", "status": "ok", "remark": ""}
    runs = pd.DataFrame([run])
    found = answer(
        scenario(
            scenario=scenario(),
            metrics=lambda: table,
            cases=lambda: named,
            runs=lambda: runs,
            own=[],
        )
    )
    assert (found["label"], found["count"], found["lead"]["case"]) == ("ekf", 12, "c7")


def test_of_equally_often_recommended_estimators_the_answer_names_the_cheapest():
    """A and b are recommended in both cases; cases name the cheapest. Without, errors decide."""
    table = metrics(errors={"ins": 9.0, "a": 2.0, "b": 2.1})
    table["recommended"] = (table["window"] == "settled") & table["estimator"].isin(["a", "b"])
    named = cases(best="a", recommended="b")
    assert leading(table, named) == "b"
    assert leading(table, named.assign(recommended="a")) == "a"
    assert leading(table, named.assign(recommended="ins")) == "a"
