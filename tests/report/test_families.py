"""Estimators that differ in one number: who belongs together, and what is shown of them."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from summaries import SAME, case, records, tabled

from ggbench.report import parameter_section as section
from ggbench.report.families import Family, families, leaders, lines, of_the_best, parameters
from ggbench.report.particles_section import particles_section


def run(**settings: dict[str, Any]) -> dict[str, Any]:
    return {label: {"parameters": held} for label, held in settings.items()}


PLAIN = {"particles": 400, "jitter": 0.25, "kind": "systematic", "on": True}
ESTIMATORS = run(
    **{
        "ekf": {"iterations": 1},
        "cloud[particles=25]": PLAIN | {"particles": 25},
        "cloud": PLAIN,
        "cloud[particles=1000]": PLAIN | {"particles": 1000},
        "cloud[particles=400]": PLAIN,
        "cloud[jitter=0]": PLAIN | {"jitter": 0},
        "cloud[particles=25,kind=residual]": PLAIN | {"particles": 25, "kind": "residual"},
        "cloud[on=false]": PLAIN | {"on": False},
    }
)


def test_families_differ_in_one_number_alone():
    """With the default in its place; a twin of it, texts and truths make none."""
    assert parameters(ESTIMATORS) == ["particles", "jitter"]
    assert families(ESTIMATORS, "particles") == [
        Family(
            "cloud",
            ("cloud[particles=25]", "cloud", "cloud[particles=1000]"),
            (25.0, 400.0, 1000.0),
        )
    ]
    assert families(ESTIMATORS, "jitter") == [
        Family("cloud", ("cloud[jitter=0]", "cloud"), (0, 0.25))
    ]
    assert families(ESTIMATORS, "iterations") == []
    assert parameters({"mine[a=1]": {}, "theirs[b=2]": {"parameters": None}}) == []


def test_of_a_family_with_a_figure_of_its_own_the_best_is_left():
    """In the order of the ranking; two of a kind both stay."""
    ranked = ["cloud[jitter=0]", "cloud[particles=1000]", "ekf", "cloud", "cloud[particles=25]"]
    assert leaders(ESTIMATORS, ranked) == ["cloud[jitter=0]", "cloud[particles=1000]", "ekf"]
    assert leaders(ESTIMATORS, ["ekf", "cloud"]) == ["ekf", "cloud"]
    assert "the best" in of_the_best(ESTIMATORS)
    # Three values of which one is zero make no line on a logarithmic scale.
    bent = run(**{f"cloud[jitter={j}]": PLAIN | {"jitter": j} for j in (0, 1, 2)})
    assert leaders(bent, bent) == list(bent)
    assert families(bent, "jitter") and not lines(bent, "jitter")
    assert of_the_best({label: ESTIMATORS[label] for label in ranked[:3]}) == ""


def results(estimators: dict[str, Any], counters: pd.DataFrame | None = None) -> Any:
    return SimpleNamespace(
        estimators=estimators, labels=list(estimators), counters=lambda: counters,
        scenario=SimpleNamespace(name="s", cases=[case()]),
    )  # fmt: skip


def test_errors_over_a_parameter_are_those_of_its_estimators(monkeypatch, tmp_path):
    """In the order of the values, with intervals; those without the parameter are levels.

    Of smoothers there is none: the bound is that of a filter. Of many cases each is a line.
    """
    given: list[Any] = []
    monkeypatch.setattr(section, "save", lambda figure, path: given.append(path))
    monkeypatch.setattr(section, "over_parameter", lambda *items: given.append(items))
    factors = {"ekf": 4.0, "cloud[particles=25]": 9.0, "cloud": 1.0, "cloud[particles=1000]": 2.0}
    late = records("late", SAME, "batch")
    summary, _ = tabled(*(records(k, f * SAME) for k, f in factors.items()), late)
    everybody = results(ESTIMATORS | run(late={}))
    parts = section.parameter_section(everybody, summary, tmp_path)
    (name, (panel,)), path = given
    assert (name, path) == ("particles", tmp_path / "over_particles.png")
    assert parts[0] == "## Over a parameter" and "](s/over_particles.png)" in parts[1]
    (line,) = panel.lines
    assert (line.title, line.values) == ("cloud", (25.0, 400.0, 1000.0))
    root = np.median(np.sqrt(SAME))
    np.testing.assert_allclose(line.ratios, root * np.sqrt([9.0, 1.0, 2.0]))
    assert (line.interval[0] < line.ratios).all() and (line.ratios < line.interval[1]).all()
    assert panel.levels == {"ekf": pytest.approx(2.0 * root)}
    given.clear()
    names = [f"c{k}" for k in range(5)]
    everybody.scenario.cases = [case(name=name) for name in names]
    many = pd.concat([summary.assign(case=name) for name in names])
    section.parameter_section(everybody, many, tmp_path)
    (_, (panel,)), _ = given
    assert (panel.title, [line.title for line in panel.lines]) == ("cloud", names)
    assert not panel.levels


@pytest.mark.parametrize("run_", [("ekf",), ("ekf", "cloud", "cloud[particles=25]")])
def test_two_values_make_no_line(run_, tmp_path):
    """Nothing is drawn where fewer than three were run, or asked for."""
    summary, _ = tabled(*(records(label, SAME) for label in run_))
    few = {label: ESTIMATORS[label] for label in run_}
    for estimators in (few, ESTIMATORS):
        assert section.parameter_section(results(estimators), summary, Path(tmp_path)) == []


def test_counters_of_particle_filters_stand_in_their_columns():
    """Whatever an estimator calls them; what it does not count is a dash."""
    counters = pd.DataFrame(
        [
            {"case": "c", "estimator": "cloud", "ess_min": 3.5, "unique_min": 12.0},
            {"case": "c", "estimator": "cloud[jitter=0]", "ess_min": 1.0, "unique": 7.0},
            {"case": "c", "estimator": "ekf", "iterations": 4.0},
        ]
    )
    head, reading, table = particles_section(results(ESTIMATORS, counters))
    assert head == "## Inside the particle filters" and "ESS" in reading
    lines = [[cell.strip() for cell in line.strip("|").split("|")] for line in table.splitlines()]
    assert lines[0] == ["case", "estimator", "particles", "least ESS", "fewest distinct"]
    assert lines[2:] == [
        ["c", "`cloud`", "400", "3.50", "12.0"], ["c", "`cloud[jitter=0]`", "400", "1.00", "7.00"],
    ]  # fmt: skip
    assert particles_section(results(ESTIMATORS, counters.iloc[2:].dropna(axis=1))) == []
    assert particles_section(results(ESTIMATORS, pd.DataFrame())) == []
