"""Tables at any width from 60 columns: no name is lost, no number is cut, no line is too long."""

from __future__ import annotations

import io

import pytest
from campaigns import ran
from command import invoke
from problems import SMALL
from rich.cells import cell_len
from rich.console import Console
from rich.text import Text

from ggbench.cli import screen
from ggbench.cli.clocks import COLD
from ggbench.cli.fitting import FittedTable, wrapped
from ggbench.cli.progress import Progress
from ggbench.cli.terminal import print_comparison, print_summary
from ggbench.judging.comparison import compare

WIDTHS = (60, 80, 120)
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


def test_no_name_and_no_number_is_lost(console):
    """Of a table of the size of a whole campaign, with names that are longer than a line."""
    numbers = [[f"{1000.0 * row + column:.4f}" for column in range(9)] for row in range(3)]
    names = (
        "factor-graph[mode=fixed-lag,lag=600]",
        "/a/folder/of/somebody/else/with_an_estimator_of_a_very_long_name_indeed.py[size=3]",
        "ins",
    )
    table = FittedTable(
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
    for block in table.fitted(console.width):
        shown = [Text.from_markup(str(cell)).plain for cell in block.columns[0].cells]
        whole = ["".join(line.strip() for line in cell.splitlines()) for cell in shown]
        assert tuple(whole) == names
        for cell in shown:
            assert all(line in text for line in cell.splitlines())


@pytest.mark.parametrize("width", [8, 12, 20, 40])
def test_a_name_is_broken_where_its_parts_end(width):
    name = "factor-graph[mode=fixed-lag,lag=600]"
    lines = wrapped(name, width).split("\n")
    assert max(map(len, lines)) <= width
    assert "".join(line.strip() for line in lines) == name
    if width == 20:
        assert lines == ["factor-graph[", "  mode=fixed-lag,", "  lag=600]"]


def test_the_final_table_of_a_campaign(results, console):
    """Every estimator is named, every number is whole, and first runs alone carry a star."""
    summary, runs = results.summary(), results.runs()
    runs.loc[runs["estimator"] == "ekf", "cold"] = True
    print_summary(summary, runs, results.scenario, console)
    text = text_of(console)
    assert "…" not in text
    settled = summary[summary["window"] == "settled"]
    for row in settled.to_dict("records"):
        assert f"{row['position_mrse_m']:.3f}" in text.split()
        assert f"{row['nees_mean']:.2f}" in text.split()
        star = "*" if row["label"] == "ekf" else ""
        if star or (~runs["cold"] & (runs["estimator"] == row["label"])).any():
            assert f"{1e3 * row['seconds_per_run']:.1f}{star}" in text.split()
    assert COLD in text.replace("\n", " ") or console.width < len(COLD)
    for piece in ("points=cubature,", "noise_scale=10,", "loss=cauchy]", "lag=4]"):
        assert text.count(piece) >= 2  # in either case


def test_a_comparison(results, console):
    compared = compare(results.runs(), results.runs(), 0.0, "settled")
    print_comparison(compared, console)
    text = text_of(console)
    assert "…" not in text
    for piece in ("points=cubature,", "loss=cauchy]", "mode=fixed-lag,", "lag=4]"):
        assert text.count(piece) >= 4  # two quantities of two cases
    for row in compared.rows.to_dict("records"):
        if row["before"]:
            assert f"{row['before']:.4g}" in text.split()
    assert text.count("verdict") == 1


@pytest.mark.parametrize("width", WIDTHS)
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
    progress._total, progress._cases = 4, [f"a_case_of_number_{n}" for n in range(7)]
    progress._labels = LABELS
    console.print(progress._shown())
    text = text_of(console)
    assert "…" not in text.replace("–", "")
    assert "loss=cauchy]" in text and "lag=4]" in text
    shown = text.count("a_case_of_number_")
    assert f"and of {7 - shown} other case" in " ".join(text.split())
