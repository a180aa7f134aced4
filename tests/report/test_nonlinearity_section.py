"""How lost one may be: figures against σ/ℓ, from a digest that is made up."""

from __future__ import annotations

import dataclasses
import math
import tomllib
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from problems import SMALL

from ggbench.judging.convergence import wilson_of
from ggbench.report import nonlinearity_section
from ggbench.report.nonlinearity_section import (
    NonlinearityReport,
    Widths,
    is_of_the_prior,
    opening_figure,
)
from ggbench.results.digest import Digest
from ggbench.spec import scenario

AXIS = """
[sweep]
targets_m = []

[[sweep.axis]]
name = "prior"
label = "prior"
unit = "m"
scale = "log"
values = [100.0, 400.0, 1600.0]
key = "initial_error.position_m"
"""
SCALES = {"base": 1000.0, "noisy": 900.0}
"""Correlation length in the settings: σ/ℓ is 0.1, 0.4, 1.6 and 0.111, 0.444, 1.78."""
SHARES = {
    "ekf": {"base": (1.0, 0.97, 0.2), "noisy": (0.99, 0.95, 0.4)},
    "search": {"base": (1.0, 1.0, 0.98), "noisy": (1.0, 1.0, 0.96)},
    "poor": {"base": (0.5, 0.4, 0.3), "noisy": (0.9, 0.4, 0.3)},
}
RATIOS = {"base": (2.0, 3.0, 50.0), "noisy": (8.0, 12.0, 2.0)}


def parsed(text: str) -> scenario.Scenario:
    return scenario.parse(tomllib.loads(text), "nonlinearity", "nonlinearity")


@pytest.fixture
def held() -> Digest:
    loaded = parsed(SMALL + AXIS)
    ins = {
        "label": "ins",
        "causality": "none",
        "success_share": 0.0,
        "ratio_median": 1.0,
        "runs": 9,
    }
    rows = [ins | {"case": name, "false_lock_share": 0.0} for name in loaded.sweep.points]
    for name, point in loaded.sweep.points.items():
        (place,) = point.indices
        for label, shares in SHARES.items():
            rows.append(
                {
                    "case": name, "label": label, "causality": "filter",
                    "success_share": shares[point.base][place],
                    "ratio_median": RATIOS[point.base][place] if label == "ekf" else math.nan,
                    "false_lock_share": 0.25, "runs": 100,
                }
            )  # fmt: skip
    lengths = {name: SCALES[point.base] for name, point in loaded.sweep.points.items()}
    return Digest(loaded, {}, pd.DataFrame(rows), pd.DataFrame(), lengths)


def test_a_sweep_is_of_the_prior_if_it_sweeps_its_width_alone():
    """Neither of the noise, nor of the prior and the noise; nor what is no sweep."""
    assert is_of_the_prior(parsed(SMALL + AXIS))
    assert not is_of_the_prior(parsed(SMALL))
    noise = AXIS.replace("initial_error.position_m", "gradiometer.noise_eotvos")
    assert not is_of_the_prior(parsed(SMALL + noise))
    second = AXIS.partition("[[sweep.axis]]")[2].replace('"prior"', '"noise"')
    second = second.replace("initial_error.position_m", "gradiometer.noise_eotvos")
    assert not is_of_the_prior(parsed(f"{SMALL}{AXIS}\n[[sweep.axis]]{second}"))


def test_settings_of_about_one_width_are_taken_together(held):
    """The geometric mean of widths and of ratios, the mean of shares."""
    widths = Widths(held)
    assert widths.labels == ["ekf", "search", "poor"]
    width, share = widths.pooled("ekf", "success_share")
    assert width == pytest.approx(np.array([0.1, 0.4, 1.6]) / math.sqrt(0.9))
    assert share == pytest.approx([0.995, 0.96, 0.3])
    width, ratio = widths.pooled("ekf", "ratio_median")
    assert ratio == pytest.approx([4.0, 6.0])  # of the widest too few succeed to say anything
    assert len(width) == 2
    width, ratio = widths.curve("ekf", "ratio_median", "noisy")
    assert width == pytest.approx(np.array([100.0, 400.0, 1600.0]) / 900.0)
    assert ratio.tolist() == [8.0, 12.0, 2.0]


def test_what_an_estimator_bears_is_told_the_widest_first(held):
    """Up to the first class in which it succeeds in less than 95 %, over all settings."""
    widths = Widths(held)
    root = math.sqrt(0.9)
    assert widths.borne("search") == pytest.approx(1.6 / root)
    assert widths.borne("ekf") == pytest.approx(0.4 / root)
    assert widths.borne("poor") == 0.0
    assert widths.sentence() == (
        "In 95 % of the runs or more one finds back with `search` from every prior flown (σ/ℓ up "
        f"to {1.6 / root:.2g}); with `ekf` up to σ/ℓ of {0.4 / root:.2g}; with `poor` not even "
        "from the narrowest."
    )


def test_what_few_runs_cannot_say_is_said(held):
    """By Wilson's interval, each run once however many settings it flew: 96 of 100 is not sure."""
    widths = Widths(held)
    assert widths.ends("ekf")[:, 0] == pytest.approx(wilson_of(0.995, 100)[1:])
    assert widths.ends("ekf").shape == (2, 3)
    low = wilson_of(0.96, 100)[1], wilson_of(0.97, 100)[1]
    assert widths.sureness() == (
        "The lower ends of these shares' 95 % intervals are 95 % or more, too, but for "
        f"`ekf` ({100.0 * low[0]:.0f} %), `search` ({100.0 * low[1]:.0f} %)."
    )
    sure = held.summary.assign(runs=10000)
    assert Widths(dataclasses.replace(held, summary=sure)).sureness() == (
        "The lower ends of these shares' 95 % intervals are 95 % or more, too."
    )


def test_what_recovers_is_not_borne(held):
    """A class in which it fails ends what it bears, however well it does in a wider one."""
    table = held.summary
    wide = table["label"].eq("ekf") & table["case"].map(lambda name: name.endswith("1600"))
    changed = table.assign(success_share=table["success_share"].mask(wide, 1.0))
    middle = table["label"].eq("ekf") & table["case"].map(lambda name: name.endswith("400"))
    changed["success_share"] = changed["success_share"].mask(middle, 0.9)
    widths = Widths(dataclasses.replace(held, summary=changed))
    assert widths.borne("ekf") == pytest.approx(0.1 / math.sqrt(0.9))


def test_the_parts_of_its_report(held, tmp_path, monkeypatch):
    """The answer and its figure; success, error and false locks of every case under their names."""
    drawn = {}
    monkeypatch.setattr(
        nonlinearity_section, "save", lambda figure, path: drawn.update({path.name: figure})
    )
    report = NonlinearityReport(held, tmp_path / "nonlinearity")
    answer = report.answer()
    widths = Widths(held)
    assert answer.startswith(f"**{widths.sentence()}**\n\n{widths.sureness()}\n\n![")
    assert answer.count("](nonlinearity/answer.png)") == 1
    sections = report.sections()
    assert set(drawn) == {"answer.png", "settings.png"}
    shares, ratios, false = (sections[k].splitlines() for k in (2, 4, 6))
    assert shares[0] == "| case | σ/ℓ | `ekf` | `search` | `poor` |"
    cells = [line.strip("| ").split(" | ") for line in shares[2:]]
    assert [row[1:] for row in cells[:3]] == [
        ["0.1", "100 %", "100 %", "50 %"], ["0.4", "97 %", "100 %", "40 %"],
        ["1.6", "20 %", "98 %", "30 %"],
    ]  # fmt: skip
    assert ratios[2].endswith("| 0.1 | 2 | – | – |") and false[2].endswith("25 % | 25 % | 25 % |")
    titles = [axis.get_title() for axis in drawn["settings.png"].axes[:2]]
    assert titles == ["as it is", "with ten times the noise"]


def test_without_the_study_the_page_has_no_figure(held, tmp_path, monkeypatch):
    """Nor of one that is damaged, or that sweeps something else; with it there is one."""
    drawn: list[Path] = []
    monkeypatch.setattr(nonlinearity_section, "save", lambda figure, path: drawn.append(path))
    assert opening_figure(tmp_path) == ""
    folder = tmp_path / "nonlinearity" / "data"
    folder.mkdir(parents=True)
    (folder / "manifest.json").write_text("{")
    assert opening_figure(tmp_path) == ""
    other = dataclasses.replace(held, scenario=parsed(SMALL))
    for found, wanted in ((other, False), (held, True)):
        reader = SimpleNamespace(FOLDER="data", read=lambda folder, found=found: found)
        monkeypatch.setattr(nonlinearity_section, "digest", reader)
        text = opening_figure(tmp_path)
        assert bool(text) == bool(drawn) == wanted
    assert text.startswith(Widths(held).sentence())
    assert "](README/nonlinearity.png)" in text and "](nonlinearity.md)" in text
    assert drawn == [tmp_path / "README" / "nonlinearity.png"]
