"""Tables at any width from 60 columns: names fold, no number is cut, no line is too long."""

from __future__ import annotations

import dataclasses
import io

import pytest
from campaigns import ran
from command import invoke
from problems import SMALL
from rich.cells import cell_len
from rich.console import Console
from thinning import thinned

from ggbench.cli import screen
from ggbench.cli.terminal import print_comparison, print_metrics
from ggbench.display.progress import Progress
from ggbench.display.responsive_table import ResponsiveTable
from ggbench.display.timing import COLD
from ggbench.judging.comparison import compare

WIDTHS = (60, *(pytest.param(width, marks=pytest.mark.long) for width in (80, 120)))
LABELS = (
    "ins",
    "ekf",
    "ukf[points=cubature,noise_scale=10,loss=cauchy]",
    "ukf[points=merwe]",
    "factor-graph[mode=fixed-lag,lag=4]",
)


@pytest.fixture(params=WIDTHS)
def console(request) -> Console:
    """A console of a width whose text can be read back."""
    return Console(width=request.param, file=io.StringIO(), highlight=False)


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """A campaign with long names."""
    return ran(tmp_path_factory.mktemp("tables"), labels=LABELS, runs=2)


def text_of(console: Console) -> str:
    """What was printed, all of whose lines must fit."""
    text = console.file.getvalue()
    assert max(map(cell_len, text.splitlines())) <= console.width
    return text


def names_of(text: str, before: tuple[str, ...] = ()) -> str:
    """The names in a table's first column, after words of a column before it, unfolded."""
    lines = ([word for word in line.split() if word not in before] for line in text.splitlines())
    return "".join(words[0] for words in lines if words)


def test_names_and_numbers_are_whole(console):
    """A table of a whole campaign's size, with names that are longer than a line."""
    numbers = [[f"{1000.0 * row + column:.4f}" for column in range(9)] for row in range(3)]
    names = (
        "factor-graph[mode=fixed-lag,lag=600]",
        "/a/folder/of/somebody/else/with_an_estimator_of_a_very_long_name_indeed.py[size=3]",
        "ins",
    )
    table = ResponsiveTable(
        "a title", [("estimator", "name"), *((f"distance [m] {n}", "number") for n in range(9))]
    )
    for name, row in zip(names, numbers, strict=True):
        table.add_row(name, *row)
    table.print(console)
    text = text_of(console)
    assert "…" not in text
    for column in range(9):
        assert f"distance [m] {column}" in text
    for row in numbers:
        for number in row:
            assert number in text.split()
    for name in names:
        assert names_of(text).count(name) == len(table.tables(console.width))


def test_the_final_table_of_a_campaign(results, console):
    """Every estimator is named, every number is whole, and first runs alone carry a star."""
    metrics, runs = results.metrics(), results.runs()
    runs.loc[runs["estimator"] == "ekf", "cold"] = True
    print_metrics(metrics, runs, results.scenario, console)
    text = text_of(console)
    assert "…" not in text
    settled = metrics[metrics["window"] == "settled"]
    for row in settled.to_dict("records"):
        assert f"{row['rms_m']:.3f}" in text.split()
        assert f"{row['nees']:.2f}" in text.split()
        cell = runs[(runs["case"] == row["case"]) & (runs["estimator"] == row["estimator"])]
        star = "*" if cell["cold"].all() else ""
        assert f"{1e3 * row['seconds_per_run']:.1f}{star}" in text.split()
        assert star or row["estimator"] != "ekf"
    assert COLD in text.replace("\n", " ") or console.width < len(COLD)
    for label in LABELS:
        assert names_of(text).count(label) >= 2  # in either case


@pytest.mark.parametrize(
    ("tests", "words"),
    [
        (0, "All results are equal: no test was made"),
        (1, "p needs no adjustment"),
        (7, "p is adjusted for 7 tests"),
    ],
)
def test_p_values_are_explained_by_the_number_of_tests(tests, words, results):
    compared = compare(results.runs(), results.runs(), 0.0, "settled")
    assert compared.tests == 0
    recorded = Console(record=True, width=400, file=io.StringIO())
    print_comparison(dataclasses.replace(compared, tests=tests), recorded)
    text = text_of(recorded)
    assert words in text and ("5 % of comparisons" in text) == (tests > 0)


def test_equal_results_have_no_p_value(results):
    """As a control, results that differ have one."""
    before, after = results.runs(), results.runs()
    changed = after["estimator"] == "ekf"
    after.loc[changed, "settled_position_ms"] *= [1.1, 0.8] * (changed.sum() // 2)
    compared = compare(before, after, 0.0, "settled")
    recorded = Console(record=True, width=400, file=io.StringIO())
    print_comparison(compared, recorded)
    rows = [line.split() for line in text_of(recorded).splitlines()]
    rows = [row for row in rows if row and row[-1] in ("same", "undecided")]
    assert {row[-1] for row in rows} == {"same", "undecided"}
    for row in rows:
        p = row[row.index("2") + 1 : -1]  # behind the number of runs
        assert len(p) == (row[-1] == "undecided")
    undecided = [row for row in rows if row[-1] == "undecided"]
    assert {(row[1], row[2]) for row in undecided} == {("ekf", "m")}


def test_a_comparison(results, console):
    compared = compare(results.runs(), results.runs(), 0.0, "settled")
    print_comparison(compared, console)
    text = text_of(console)
    assert "…" not in text
    for label in LABELS:
        held = compared.rows["estimator"] == label
        shown = (held & (compared.rows["before"] != 0)).sum()  # no counts of diverged runs here
        assert names_of(text, ("base", "noisy")).count(label) >= shown >= 2
    for row in compared.rows.to_dict("records"):
        if row["before"]:
            assert f"{row['before']:.4g}" in text.split()
    assert text.count("verdict") == 1


@thinned("width", WIDTHS)
@pytest.mark.parametrize(
    "arguments",
    [["list"], ["show", "out"], ["bound", "small.toml"], ["compare", "out", "out"]],
    ids=lambda words: words[0],
)
def test_commands_fit_their_terminal(arguments, width, results, tmp_path, monkeypatch):
    """Whole numbers and names at every width: what is printed at 60 is what is printed at 120."""
    (tmp_path / "small.toml").write_text(SMALL)
    (tmp_path / "out").symlink_to(results.folder)

    def words(columns: int) -> set[str]:
        monkeypatch.setattr(screen.console, "width", columns)
        done = invoke(arguments, tmp_path)
        assert done.returncode == 0, done.stderr
        tables = [line for line in done.stdout.splitlines() if "ggbench run" not in line]
        assert "…" not in done.stdout
        assert max(map(cell_len, tables)) <= max(columns, 100)
        return {word for word in done.stdout.split() if word.replace(".", "").isdigit()}

    assert words(width) == words(400)


def test_the_live_table_keeps_names(results, console):
    """While runs run, too, cases that do not fit are counted and names are whole."""
    progress = Progress(console, "small")
    progress._cases, progress._names = (
        [f"a_case_of_number_{n}" for n in range(7)],
        dict.fromkeys(LABELS, ""),
    )
    progress.add_task("", total=4)
    console.print(progress.get_renderable())
    text = text_of(console)
    assert "…" not in text.replace("–", "")
    assert all(label in names_of(text) for label in LABELS)
    shown = text.count("a_case_of_number_")
    assert f"and of {7 - shown} other case" in " ".join(text.split())
