"""Tables of a report: under each heading the figure that it names, in its unit."""

from __future__ import annotations

import math
import re
import tomllib
from typing import Any

import numpy as np
import pandas as pd
import pytest
from problems import SMALL

from ggbench.figures.numbers import short
from ggbench.judging.summary import WINDOWS
from ggbench.report import tables
from ggbench.report.outcome import comparable_ratio
from ggbench.spec import scenario

SCENARIO = scenario.parse(tomllib.loads(SMALL), "small", "small")
UNPUBLISHED = scenario.parse(tomllib.loads(re.sub("reference.*", "", SMALL)), "small", "small")
CASES = ("base", "noisy")
LABELS = {"ekf": "filter", "ins": "none", "lagged": "fixed-lag", "late": "batch"}
COLUMNS = (
    "position_mrse_m", "position_mrse_lo", "position_mrse_hi", "position_median_m",
    "position_p95_m", "position_bound_m", "position_efficiency", "velocity_mrse_mps",
    "velocity_mrse_lo", "velocity_mrse_hi", "velocity_median_mps", "velocity_p95_mps",
    "velocity_bound_mps", "velocity_efficiency", "nees_mean", "nees_lo", "nees_hi", "nis_mean",
    "nis_lo", "nis_hi", "ratio_median", "ratio_median_lo", "ratio_median_hi", "ratio_quartile_lo",
    "ratio_quartile_hi", "ratio_p95", "capped_mrse_m",
)  # fmt: skip
SHARES = (0.811, 0.722, 0.933)
"""Share of success with its interval."""


def figure(case: str, label: str, window: str, column: str) -> float:
    """A number that is of no other case, estimator, window and column."""
    place = (CASES.index(case), list(LABELS).index(label), WINDOWS.index(window))
    return 10.0 + COLUMNS.index(column) + 0.01 * (40 * place[0] + 10 * place[1] + 3 * place[2] + 1)


def row(case: str, label: str, window: str) -> dict[str, Any]:
    found = {column: figure(case, label, window, column) for column in COLUMNS}
    index = list(LABELS).index(label)
    return found | {
        "case": case, "label": label, "window": window, "causality": LABELS[label], "runs": 500,
        "failed": 2 + index, "diverged": 12 + index, "seconds_per_run": 0.125 + index,
        "map_evaluations": 700 + index, "coverage": 0.911, "coverage_lo": 0.922,
        "coverage_hi": 0.933, "lock_share": math.nan, "success_share": SHARES[0],
        "success_lo": SHARES[1], "success_hi": SHARES[2], "false_lock_share": math.nan,
    }  # fmt: skip


SUMMARY = pd.DataFrame(
    [row(case, label, window) for case in CASES for label in LABELS for window in WINDOWS]
)


def parsed(markdown: str) -> tuple[list[str], list[list[str]]]:
    """Heading and rows of cells of a markdown table."""
    lines = [line for line in markdown.splitlines() if line.startswith("|")]
    head, _, *rows = ([c.strip() for c in line.strip("|").split(" | ")] for line in lines)
    return head, rows


def numbers(cell: str) -> list[float]:
    return [float(text) for text in re.findall(r"\d+(?:\.\d+)?", cell)]


def shown(case: str, label: str, window: str, *columns: str) -> pytest.approx:
    return pytest.approx([figure(case, label, window, column) for column in columns], abs=0.006)


def test_the_first_table_tells_position_before_velocity_and_milliseconds():
    """Every estimator in the settled window, beside what was published and the bound."""
    head, rows = parsed(tables.glance(SCENARIO, SUMMARY, pairs()))
    assert head[2:] == ["as it is: m, m/s", "failed / diverged", "ms/run"]
    assert rows[0][0] == "*published*" and numbers(rows[0][2]) == [6.0, 0.3]
    for cells in (cells for cells in rows if cells[0].strip("`") in LABELS):
        label = cells[0].strip("`")
        index = list(LABELS).index(label)
        assert cells[1] == LABELS[label]
        wanted = shown("base", label, "settled", "position_mrse_m", "velocity_mrse_mps")
        assert numbers(cells[2]) == wanted
        assert numbers(cells[3]) == [2 + index, 12 + index]
        assert numbers(cells[4]) == pytest.approx([125.0 + 1000.0 * index], abs=1.0)
    bounds = {cells[1].strip("*"): cells[2] for cells in rows if "bound" in cells[0]}
    for label, causality in LABELS.items():
        if causality != "none":
            wanted = shown("base", label, "settled", "position_bound_m", "velocity_bound_mps")
            assert numbers(bounds[causality]) == wanted


@pytest.mark.parametrize("of", [SCENARIO, UNPUBLISHED], ids=["published", "unpublished"])
def test_figures_of_fewer_runs_say_of_how_many(of):
    """Beside the estimator's name, where others flew more; nowhere, where all flew the same."""
    names = [cells[0] for cells in parsed(tables.glance(of, SUMMARY, pairs()))[1]]
    assert not [name for name in names if "run" in name]
    runs = SUMMARY["runs"].mask(SUMMARY["label"] == "late", 7).mask(SUMMARY["label"] == "ins", 1)
    names = [cells[0] for cells in parsed(tables.glance(of, SUMMARY.assign(runs=runs), pairs()))[1]]
    said = [re.search(r"\d+ runs?$", name) for name in names]
    assert [found[0] for found in said if found] == ["1 run", "7 runs"]


def test_many_cases_show_their_errors_over_the_bound():
    """A column for each case: the bounds of each causality, then the median of each estimator."""
    liar = SUMMARY["label"].eq("late")
    summary = SUMMARY.assign(coverage=SUMMARY["coverage"].mask(liar, 0.5))
    summary.loc[SUMMARY["label"] == "lagged", "success_share"] = 1.0
    summary.loc[SUMMARY["label"] == "ins", "ratio_median"] = math.nan
    head, rows = parsed(tables.glance(UNPUBLISHED, summary, pairs()))
    assert len(head) == 1 + len(CASES)
    assert [cells[0] for cells in rows] == [
        "*bound [m]: filter*", "*bound [m]: fixed-lag*", "*bound [m]: batch*",
        "*median [m]: the best causal*", "*median [m]: the INS*", "`ekf`", "`ins`",
        "`lagged` (fixed-lag)", "`late` (batch)",
    ]  # fmt: skip
    for column, name in enumerate(CASES, 1):
        cells = [row[column] for row in rows]
        for label, cell in zip(("ekf", "lagged", "late"), cells[:3], strict=True):
            assert cell == short(figure(name, label, "settled", "position_bound_m"))
        ekf, lagged, late = (
            short(figure(name, label, "settled", "ratio_median"))
            for label in ("ekf", "lagged", "late")
        )
        for label, cell in zip(("ekf", "ins"), cells[3:5], strict=True):
            assert cell == short(figure(name, label, "settled", "position_median_m"))
        assert cells[5:] == [f"**{ekf}** (81 %)", "– (81 %)", lagged, f"{late} (81 %) †"]
    _, rows = parsed(tables.glance(UNPUBLISHED, SUMMARY.assign(coverage=0.5), pairs()))
    assert not any("**" in cell for row in rows for cell in row)  # no best where nobody is honest


def test_who_flew_fewer_runs_has_the_error_that_common_runs_say():
    """The best one's median by the mean ratio in common runs, over its own bound; or its own.

    Its own where hardly any runs are common. In a table of many cases with a mark.
    """
    best = {"label": "ekf", "runs": 500, "ratio_median": 0.9, "position_bound_m": 8.0}
    few = {"label": "late", "runs": 40, "ratio_median": 0.7, "position_bound_m": 4.0}
    pair = {"both_succeeded": 39, "error_ratio": 2.5}  # of the best one over the other
    assert comparable_ratio(few, best, pair) == pytest.approx(0.9 * 8.0 / 2.5 / 4.0)
    for other in (None, pair | {"both_succeeded": 4}, pair | {"error_ratio": math.nan}):
        assert comparable_ratio(few, best, other) == 0.7
    assert comparable_ratio(few | {"runs": 500}, best, pair) == 0.7
    runs = SUMMARY["runs"].mask(SUMMARY["label"] == "ins", 40)
    _, rows = parsed(tables.glance(UNPUBLISHED, SUMMARY.assign(runs=runs), pairs()))
    (cells,) = (cells for cells in rows if cells[0].startswith("`ins`"))
    settled = SUMMARY[(SUMMARY["window"] == "settled") & (SUMMARY["case"] == "base")]
    held = settled.set_index("label")
    wanted = held.loc["ekf", "ratio_median"] * held.loc["ekf", "position_bound_m"] * 2.5
    assert cells[1] == f"~{short(wanted / held.loc['ins', 'position_bound_m'])} (81 %)"


def test_errors_of_a_case_stand_under_their_headings():
    """Success, error over bound, MRSE with its interval, capped, bounds: position, velocity."""
    head, rows = parsed(tables.case_errors(SCENARIO.cases[0], SUMMARY))
    assert head == [
        "estimator", "success", "error / bound: median", "quartiles", "95 %", "position MRSE [m]",
        "capped", "bound [m]", "velocity MRSE [m/s]", "bound", "failed / diverged",
    ]  # fmt: skip
    assert numbers(rows[0][5]) == [6.0] and numbers(rows[0][8]) == [0.3]
    columns = (
        ("ratio_median", "ratio_median_lo", "ratio_median_hi"),
        ("ratio_quartile_lo", "ratio_quartile_hi"),
        ("ratio_p95",),
        ("position_mrse_m", "position_mrse_lo", "position_mrse_hi"),
        ("capped_mrse_m",),
        ("position_bound_m",),
        ("velocity_mrse_mps", "velocity_mrse_lo", "velocity_mrse_hi"),
        ("velocity_bound_mps",),
    )
    seen = [cells[0].strip("`*") for cells in rows]
    assert seen == ["paper", "ekf", "ins", "smoothers", "lagged", "late"]
    for cells in rows:
        if (label := cells[0].strip("`")) in LABELS:
            assert numbers(cells[1]) == [81, 72, 93]
            for cell, names in zip(cells[2:10], columns, strict=True):
                wanted = [figure("base", label, "settled", name) for name in names]
                assert numbers(cell) == pytest.approx(wanted, abs=0.06)
            index = list(LABELS).index(label)
            assert numbers(cells[10]) == [2 + index, 12 + index]


def test_who_never_succeeds_has_no_error_and_who_lies_is_marked():
    """– for what there is none of; † behind what claims more than it knows."""
    none = dict.fromkeys([c for c in COLUMNS if c.startswith("ratio")], math.nan)
    summary = SUMMARY[SUMMARY["label"] == "ekf"].assign(coverage=0.6, **none)
    _, rows = parsed(tables.case_errors(SCENARIO.cases[0], summary))
    assert rows[1][0] == "`ekf` †"
    assert rows[1][2:5] == ["–", "–", "–"]


def test_consistency_and_cost_of_a_case_stand_under_their_headings():
    """NEES, NIS and coverage with their bands; milliseconds of a run and of an update."""
    head, rows = parsed(tables.case_consistency(SCENARIO.cases[1], SUMMARY, updates=20))
    assert head[1:] == [
        "NEES (band)", "NIS (band)", "coverage (band)", "ms/run", "ms/update", "map points",
    ]  # fmt: skip
    for cells in rows:
        if (label := cells[0].strip("`")) in LABELS:
            index = list(LABELS).index(label)
            for cell, name in ((cells[1], "nees"), (cells[2], "nis")):
                columns = (f"{name}_mean", f"{name}_lo", f"{name}_hi")
                assert numbers(cell) == shown("noisy", label, "settled", *columns)
            assert numbers(cells[3]) == [91.1, 92.2, 93.3]
            assert numbers(cells[4]) == [125.0 + 1000.0 * index]
            assert numbers(cells[5]) == [6.25 + 50.0 * index]
            assert numbers(cells[6]) == [700 + index]


def test_efficiencies_of_all_windows_stand_under_their_headings():
    """Position before velocity in each window, the windows in their order, without the INS."""
    head, rows = parsed(tables.efficiency(SCENARIO, SUMMARY))
    assert [title.partition(":")[0] for title in head[2::2]] == list(tables.WINDOW_TITLES.values())
    assert [(c[0], c[1].strip("`")) for c in rows] == [
        (case, label) for case in CASES for label in LABELS if label != "ins"
    ]
    for case, label, *cells in rows:
        for index, window in enumerate(WINDOWS):
            pair = [float(cell) for cell in cells[2 * index : 2 * index + 2]]
            columns = ("position_efficiency", "velocity_efficiency")
            assert pair == shown(case, label.strip("`"), window, *columns)


def test_bounds_are_roots_of_means_over_their_windows():
    """Of the squared bounds of position and velocity over the epochs of each window."""
    times = np.arange(1.0, 21.0)
    squared = np.stack([times**2, (0.1 * times) ** 2], axis=-1)
    arrays = {case: {"times": times, "bound-filter": squared} for case in CASES}
    head, rows = parsed(tables.bounds(SCENARIO, arrays))
    assert head[1:] == list(tables.WINDOW_TITLES.values())
    # Of 1..20, 10..20 and 16..20.
    wanted = [math.sqrt(total / count) for total, count in ((2870, 20), (2585, 11), (1630, 5))]
    for cells in rows:
        for cell, position in zip(cells[1:], wanted, strict=True):
            assert numbers(cell) == pytest.approx([position, 0.1 * position], abs=6e-4)


def pairs() -> pd.DataFrame:
    """The INS against the EKF in both cases, as paired_table has them."""
    pair = {
        "first": "ins", "second": "ekf", "runs": 48, "velocity_relative": 0.25,
        "both_succeeded": 40, "first_succeeded": 1, "second_succeeded": 7, "success_p": 0.07,
        "error_ratio": 2.5, "error_ratio_lo": 2.0, "error_ratio_hi": 3.125, "sign_p": 0.0123,
        "verdict": "worse",
    }  # fmt: skip
    places = (("base", "settled"), ("noisy", "settled"), ("base", "whole"))
    others = ({}, {"error_ratio": 0.2, "verdict": "as good"}, {"verdict": "better"})
    return pd.DataFrame(
        [
            pair | {"case": case, "window": window} | other
            for (case, window), other in zip(places, others, strict=True)
        ]
    )


def test_pairs_are_told_against_the_best_of_their_case():
    """Who succeeds alone, the ratio of errors with its interval, the sign test, the verdict."""
    head, rows = parsed(tables.paired(SCENARIO, SUMMARY, pairs()))
    assert head[3:] == [
        "runs", "succeeds alone", "the other alone", "ratio of errors", "sign test", "verdict",
        "velocity: MRSE ratio",
    ]  # fmt: skip
    assert rows[0] == [
        "base", "`ins`", "`ekf`", "48", "1", "7", "2.5 [2, 3.125]", "0.012", "worse", "1.25",
    ]  # fmt: skip
    assert len(rows) == 2
    nobody = SUMMARY.assign(failed=400)
    assert tables.paired(SCENARIO, nobody, pairs()) == ""


def test_verdicts_of_many_cases_are_counted():
    """In the settled window: how many cases are of which verdict; the farthest ratio."""
    head, rows = parsed(tables.verdicts(pairs()))
    assert head[2:] == [
        "better", "worse", "as good", "not distinguishable", "mean ratio of errors farthest from 1",
    ]  # fmt: skip
    assert rows == [["`ins`", "`ekf`", "0", "1", "1", "0", "0.2"]]
    nothing = pairs().assign(error_ratio=math.nan)
    assert parsed(tables.verdicts(nothing))[1][0][-1] == "–"
    alone = nothing.assign(error_ratio_lo=math.nan, error_ratio_hi=math.nan)
    assert parsed(tables.paired(SCENARIO, SUMMARY, alone))[1][0][6] == "–"


def test_a_study_sets_windows_and_lost_runs_beside_the_paper():
    """The published numbers, the declared ones in three windows; lost runs are said."""
    declared = SUMMARY[SUMMARY["label"] == "ekf"].assign(assumption="")
    head, rows = parsed(tables.study(SCENARIO, declared))
    assert head == ["assumption", "base", "NEES"]
    assert numbers(rows[0][1]) == [6.0, 0.3]
    for cells, window in zip(rows[1:], ("settled", "whole", "last20"), strict=True):
        wanted = shown("base", "ekf", window, "position_mrse_m", "velocity_mrse_mps")
        assert numbers(cells[1].partition(" (")[0]) == wanted
        assert cells[1].endswith("(14 of 500 failed or diverged)")
        assert numbers(cells[2]) == shown("base", "ekf", window, "nees_mean")


def test_a_study_of_the_start_is_told_of_the_whole_flight_too():
    """An error at the start is gone once it has settled; anything else is told of that alone."""
    changes = {
        "start": "initial_error.velocity_mps = 0.7", "noise": "gradiometer.noise_eotvos = 3.0",
    }  # fmt: skip
    text = SMALL + "".join(
        f'\n[[assumption]]\nname = "{name}"\ntitle = "another {name}"\n{change}\n'
        for name, change in changes.items()
    )
    studied = scenario.parse(tomllib.loads(text), "small", "small")
    ekf = SUMMARY[SUMMARY["label"] == "ekf"]
    frame = pd.concat(ekf.assign(assumption=name) for name in ("", *changes))
    _, rows = parsed(tables.study(studied, frame))
    assert [cells[0] for cells in rows[4:]] == [
        "another start", "the same, whole flight", "another noise",
    ]  # fmt: skip
    for cells, window in zip(rows[4:], ("settled", "whole", "settled"), strict=True):
        wanted = shown("base", "ekf", window, "position_mrse_m", "velocity_mrse_mps")
        assert numbers(cells[1].partition(" (")[0]) == wanted


def test_the_first_table_can_be_of_the_whole_flight():
    """Its numbers are that window's, and it says so."""
    settled, whole = (
        parsed(tables.glance(SCENARIO, SUMMARY, pairs(), w)) for w in ("settled", "whole")
    )
    assert (settled[0][0], whole[0][0]) == ("settled window", "whole flight")
    cells = next(row for row in whole[1] if row[0] == "`ekf`")
    assert numbers(cells[2]) == shown(
        "base", "ekf", "whole", "position_mrse_m", "velocity_mrse_mps"
    )
    assert cells[2] != next(row for row in settled[1] if row[0] == "`ekf`")[2]
