"""The table of conditions: from the keys of every shipped scenario, short enough to be read."""

from __future__ import annotations

from reporting import cases
from thinning import thinned

from ggbench.report.conditions import _range_of_texts, conditions, other_conditions
from ggbench.spec import scenario


def test_conditions_are_those_of_the_scenario():
    """What differs between cases is listed."""
    loaded = scenario.load("wang2013")
    table = conditions(loaded.cases, cases(7)).set_index("condition")["value"]
    assert table["INS"].startswith("navigation grade, gyros 0.015 °/h")
    assert table["Initial σ"] == "5 m, 0.1 m/s, 1′"
    yao = conditions(scenario.load("yao2010s").cases, cases(1)).set_index("condition")["value"]
    assert yao["Initial σ"] == "1000 m (height 1 m), 0.1 m/s, 0.17′ (heading 1′)"
    assert table["Gradiometer"].startswith("0.01 E or 0.001 E, every 1 s or every 5 s")
    assert table["Gradiometer"].endswith("low-pass 0.2 Hz or none")  # two cases have one
    filtered = [case for case in loaded.cases if case.gradiometer.filter != "none"]
    assert 0 < len(filtered) < len(loaded.cases)
    same = conditions(filtered, cases(len(filtered))).set_index("condition")["value"]
    assert same["Gradiometer"].endswith("low-pass 0.2 Hz")
    assert table["Flight"] == "1.00 min, 50.0 m/s, height 1000 m"
    assert "Wrongly modelled" not in table  # of none of its cases


def test_differences_of_the_model_are_listed():
    """The keys in which truth and model differ, of cases without any "none"."""
    loaded = scenario.load("below_summits")
    table = conditions(loaded.cases, cases(9)).set_index("condition")["value"]
    assert table["Wrongly modelled"] == "in some cases: map"


def test_equal_errors_of_truth_and_model_are_no_difference():
    """In half of the cases the filter assumes the standard deviation of the true biases."""
    loaded = scenario.load("vinton2008_biases")
    estimated = [case for case in loaded.cases if case.side("model") == case.side("truth")]
    assert estimated and len(estimated) < len(loaded.cases)
    words = conditions(loaded.cases, cases(8)).set_index("condition")["value"]
    assert words["Wrongly modelled"] == "in some cases: gradiometer"
    table = conditions(estimated, cases(8)).set_index("condition")["value"]
    assert "Wrongly modelled" not in table


def test_a_sensor_of_all_cases_is_listed_once_with_its_intervals():
    """Of a sensor of some cases this is said."""
    cases_of = {name: list(scenario.load(name).cases) for name in ("li2011", "gnss_outage")}
    assert other_conditions(cases_of["li2011"]) == "gravimeter 0.5 mGal every 120 or 300 s"
    assert "in some cases" in other_conditions(cases_of["gnss_outage"])


@thinned("name", scenario.shipped())
def test_conditions_of_a_shipped_scenario_are_short(name):
    table = conditions(scenario.load(name).cases, cases(2))
    assert {"INS", "Flight", "Map"} <= set(table["condition"])
    assert {"Gradiometer", "Other sensors"} & set(table["condition"])
    assert len(table) <= 8 and table["value"].str.len().max() < 260


def test_many_values_are_a_range_or_vary():
    """Numbers of one unit are a range, whatever their order; other texts have no range."""
    assert _range_of_texts(["0.01 E", "10 E", "0.001 E"]) == "0.001–10 E"
    assert _range_of_texts(["every 10 s", "every 0.1 s", "every 1 s"]) == "every 0.1–10 s"
    assert _range_of_texts(["none", "field", "gradiometer"]) == "varies by case"
    assert _range_of_texts(["1 E", "0.5 mGal", "2 E"]) == "varies by case"
