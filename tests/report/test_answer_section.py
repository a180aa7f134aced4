"""What stands beside an answer: its figure, and what it does not say."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from summaries import case

from ggbench.report import answer_section
from ggbench.report.answer_section import answer_figure, caveat, fewer, telling_cases

CASES = tuple(case(name=name, title=name) for name in ("even", "spread", "lost", "empty"))


def row(name: str, label: str, share: float, error: float, **changes: Any) -> dict[str, Any]:
    return {
        "case": name, "label": label, "window": "settled", "causality": "filter", "runs": 100,
        "success_share": share, "success_lo": share - 0.05, "success_hi": share + 0.04,
        "position_median_m": error, "ratio_median": error / 2.0, "ratio_quartile_lo": error / 3.0,
        "ratio_quartile_hi": error, "position_mrse_m": error, "seconds_per_run": 1.0,
    } | changes  # fmt: skip


SUMMARY = pd.DataFrame(
    [
        row("even", "ekf", 1.0, 2.0), row("even", "ukf", 1.0, 2.1),
        row("spread", "ekf", 1.0, 2.0), row("spread", "ukf", 1.0, 14.0),
        row("lost", "ekf", 0.3, 2.0), row("lost", "ukf", 1.0, 2.0),
        row("even", "late", 0.1, 200.0, causality="batch"),
        row("even", "ins", 0.0, 500.0, causality="none"),
    ]
)  # fmt: skip


def test_cases_that_set_estimators_apart_are_shown_first():
    """Success before error; what is not causal tells nothing; what did not run is not there."""
    found = telling_cases(CASES, SUMMARY)
    assert [spec.name for spec in found] == ["lost", "spread", "even"]
    none = SUMMARY.assign(position_median_m=math.nan)
    assert [spec.name for spec in telling_cases(CASES, none)] == ["lost", "even", "spread"]
    alone = SUMMARY[SUMMARY["causality"] != "filter"]
    assert [spec.name for spec in telling_cases(CASES, alone)] == ["even"]


def results(cases=CASES, asked: int = 100, **manifest: Any) -> Any:
    labels = {label: {"parameters": {}} for label in ("ekf", "ukf", "late", "ins")}
    return SimpleNamespace(
        scenario=SimpleNamespace(cases=cases), run_count=asked, estimators=labels,
        manifest=manifest,
    )  # fmt: skip


def test_the_caveat_says_what_figures_are_not_of():
    """Simulated always; the rebuilt map, fewer runs, and who was not run, where it is so."""
    plain = caveat(results(), SUMMARY)
    assert plain == (
        "*Caveat*: simulated flights: truth and estimators share all that the scenario does not "
        "set apart. Words and figures: [definitions](definitions.md)."
    )
    rebuilt = CASES[0].field.model_copy(update={"source": "egm2008_qinling"})
    text = caveat(results((CASES[1], CASES[0].model_copy(update={"field": rebuilt}))), SUMMARY)
    assert "the map is rebuilt from the EGM2008 geoid" in text and "some tenths of an E" in text
    fewer = SUMMARY.assign(runs=np.where(SUMMARY["label"] == "ukf", 40, 100))
    text = caveat(results(), fewer)
    assert "of 100 runs only the first were given to some: `ukf` 40. Words" in text
    text = caveat(results(left_out={"tercom": "it has no map"}), SUMMARY)
    assert "; `tercom` was not run: it has no map. Words" in text


def test_the_figure_gets_what_it_shows(tmp_path, monkeypatch):
    """Cases in their own order, estimators without the INS; shares, then errors over the bound."""
    given: list[Any] = []
    monkeypatch.setattr(answer_section, "save", lambda figure, path: given.append(path.name))
    monkeypatch.setattr(answer_section, "over_cases", lambda *found: given.extend(found))
    text = answer_figure(results(), SUMMARY, tmp_path / "my own")
    names, shares, ratios, file = given
    assert (names, file) == (["even", "spread", "lost"], "answer.png")
    assert set(shares) == set(ratios) == {"ekf", "ukf", "late"}
    assert shares["ekf"].value.tolist() == [1.0, 1.0, 0.3]
    assert shares["ekf"].low.tolist() == pytest.approx([0.95, 0.95, 0.25])
    assert ratios["ukf"].value.tolist() == [1.05, 7.0, 1.0]
    assert ratios["ukf"].high.tolist() == [2.1, 14.0, 2.0]
    assert np.isnan(shares["late"].value[1:]).all()
    assert "](my%20own/answer.png)" in text and "differ most" not in text


def test_of_many_cases_those_are_shown_that_differ_most(tmp_path, monkeypatch):
    """Eight of nine, in their own order, as the caption says. Without estimators there is none."""
    cases = [case(name=f"c{k}", title="c") for k in range(9)]
    table = pd.DataFrame(
        [row(f"c{k}", "ekf", 1.0, 2.0) for k in range(9)]
        + [row(f"c{k}", "ukf", 1.0, 2.0 + (k + 3) % 9) for k in range(9)]
    )
    given: list[Any] = []
    monkeypatch.setattr(answer_section, "save", lambda figure, path: None)
    monkeypatch.setattr(answer_section, "over_cases", lambda *found: given.extend(found))
    text = answer_figure(results(tuple(cases)), table, tmp_path / "s")
    assert given[0] == [f"c{k}" for k in range(9) if k != 6]
    assert "in the cases in which causal estimators differ most" in text
    alone = table.assign(causality="none")
    assert answer_figure(results(tuple(cases)), alone, tmp_path / "s") == ""


def test_of_many_estimators_the_plain_ones_and_the_best_are_shown():
    """The plain one even where a better one stands for it; the best of each case, whoever it is."""
    labels = ["ekf", *(f"ekf[gate=0.{n}]" for n in range(10, 26)), "ukf[points=cubature]"]
    tables = [
        {label: row("c", label, 1.0, 1.0 if label == best else 2.0 + 0.1 * n) | {
            "failed": 0, "coverage": 0.95, "false_lock_share": 0.0, "lock_lo": math.nan}
         for n, label in enumerate(labels)}
        for best in ("ekf[gate=0.13]", "ekf[gate=0.20]")
    ]  # fmt: skip
    shown = ["ekf", "ekf[gate=0.13]", "ekf[gate=0.20]", "ukf[points=cubature]"]
    assert fewer(labels[1:], tables) == shown
    assert fewer(labels[1:5], tables) == labels[1:5]
