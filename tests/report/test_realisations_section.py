"""Errors of a map that were drawn more than once: what they have in common."""

from __future__ import annotations

import math
import re
import tomllib

import numpy as np
import pandas as pd
import pytest
from problems import SMALL
from scipy import stats

from ggbench.report.realisations_section import _interval, groups, realisations_section
from ggbench.spec import scenario

ERROR = "model.field.error.white_noise_eotvos = 3.0\n"
DRAWN = {"a": 1, "b": 2, "c": 3}


def drawn(*more: str) -> scenario.Scenario:
    """A scenario with three maps of one error, and other cases."""
    text = re.sub("reference.*", "", SMALL)
    for name, seed in DRAWN.items():
        text += f'\n[[case]]\nname = "{name}"\ntitle = "map {name}"\n{ERROR}'
        text += f"model.field.error.seed = {seed}\n"
    return scenario.parse(tomllib.loads(text + "".join(more)), "small", "small")


def summary(**ratios: dict[str, float]) -> pd.DataFrame:
    """Rows of the settled window: a median error over bound for each case and label."""
    rows = [
        {
            "case": case, "label": label, "window": "settled", "causality": "filter", "runs": 60,
            "failed": 0, "diverged": 0, "ratio_median": ratio, "success_share": share,
            "coverage": 0.95 if label == "ekf" else 0.3, "false_lock_share": 0.0,
            "position_mrse_m": 1.0, "position_median_m": 1.0, "success_lo": 0.8,
            "success_hi": 1.0, "lock_lo": math.nan, "seconds_per_run": 0.01,
        }
        for label, of in ratios.items()
        for case, ratio in of.items()
        for share in [0.9 if case == "a" else 1.0]
    ]  # fmt: skip
    return pd.DataFrame(rows)


def test_cases_that_differ_in_the_seed_alone_are_realisations():
    """Another size of the error, or no error at all, is another case."""
    other = '\n[[case]]\nname = "d"\ntitle = "d"\nmodel.field.error.seed = 2\n'
    other += ERROR.replace("3.0", "4.0")
    found = groups(drawn(other).cases)
    assert [(what, [case.name for case in group]) for what, group in found] == [
        ("maps", ["a", "b", "c"])
    ]


def test_where_nothing_is_drawn_flights_differ():
    """Where a map is wrong; a seed says nothing there, and another error is another case."""
    smoothed = "model.field.error.resolution_km = 0.2\n"
    text = ""
    for name, error, heading in (
        ("d", smoothed, 80.0), ("e", smoothed, 100.0), ("f", ERROR, 80.0),
        ("g", f"{smoothed}model.field.error.seed = 2\n", 80.0), ("h", "", 80.0), ("i", "", 100.0),
    ):  # fmt: skip
        text += f'\n[[case]]\nname = "{name}"\ntitle = "{name}"\n{error}'
        text += f"trajectory.heading_deg = {heading}\n"
    found = [(what, [case.name for case in group]) for what, group in groups(drawn(text).cases)]
    assert found == [("maps", ["a", "b", "c"]), ("flights", ["d", "e"])]
    ratios = dict.fromkeys("abcde", 2.0)
    (_, _, table) = realisations_section(drawn(text), summary(ekf=ratios))
    assert "| d (2 flights) | `ekf` | – | 2.00, 2.00 | 2 of 2 |" in table  # chosen: no interval


def test_intervals_are_over_the_realisations():
    """Student's t of the mean logarithm; what was lost over a map stands beside its median."""
    ratios = {"a": 2.0, "b": 4.0, "c": 8.0}
    (_, _, table) = realisations_section(drawn(), summary(ekf=ratios))
    cells = [cell.strip() for cell in table.splitlines()[2].strip("|").split(" | ")]
    assert cells[0] == "map a (3 maps)" and cells[1] == "`ekf`"
    t, deviation = stats.t.ppf(0.975, 2), math.log(2.0)
    ends = 4.0 * np.exp(np.array([-1.0, 1.0]) * t * deviation / math.sqrt(3.0))
    shown = [float(text) for text in re.findall(r"[\d.]+", cells[2])]
    assert shown == pytest.approx([4.0, *ends], rel=5e-3)
    assert cells[3:] == ["2.00 (90 %), 4.00, 8.00", "3 of 3"]


def test_intervals_hold_the_truth():
    """Of 400 triples of normal logarithms 95 % hold their mean; beyond 92 to 98 % once in 100."""
    draws = np.random.default_rng(7).normal(size=(400, 3))
    held = sum(low <= 0.0 <= high for low, high in map(_interval, draws))
    assert 0.92 <= held / 400 <= 0.98


def test_who_did_not_fly_all_maps_has_no_row_and_who_lies_is_told():
    """Nor has a logarithm of nothing: of an estimator that never succeeds there is no ratio."""
    found = realisations_section(
        drawn(),
        summary(
            ekf={"a": 2.0, "b": 4.0, "c": math.nan}, liar=dict.fromkeys(DRAWN, 1.0),
            absent={"a": 1.0, "b": 1.0},
        ),
    )  # fmt: skip
    rows = [line.strip("| ").split(" | ") for line in found[2].splitlines()[2:]]
    told = {row[1]: row[2:] for row in rows}
    assert told == {
        "`ekf`": ["–", "2.00 (90 %), 4.00, –", "3 of 3"],
        "`liar`": ["1.00 [1.00, 1.00]", "1.00 (90 %), 1.00, 1.00", "0 of 3"],
    }


def test_without_realisations_there_is_no_section():
    alone = scenario.parse(tomllib.loads(SMALL), "small", "small")
    assert realisations_section(alone, summary(ekf={"base": 1.0})) == []
