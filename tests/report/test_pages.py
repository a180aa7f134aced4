"""Pages of a small campaign: markdown, data and HTML are of the same numbers."""

from __future__ import annotations

import html
import json
import re
import shutil
from html.parser import HTMLParser
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from campaigns import ran, small
from problems import SMALL

from ggbench.figures.league import league as draw_league
from ggbench.figures.line_styles import COLOURS
from ggbench.report import (
    answers,
    columns,
    html_page,
    libraries,
    library,
    markdown_page,
    pictures,
    render,
    reported,
    views,
)
from ggbench.report.league import league as league_of
from ggbench.report.reported import Reported
from ggbench.results.folder import Results

LABELS = ("ins", "ekf", "ukf", "factor-graph[mode=batch]")
NOTES = "## Set-up\n\nIt is [short](../docs/short.md#why), and [wide](wide_prior.md) is another.\n"
HOSTILE = "</script><script>alert(1)</script>"


@pytest.fixture(scope="module")
def output(tmp_path_factory) -> Path:
    """A folder of the reports of a small campaign."""
    folder = tmp_path_factory.mktemp("pages")
    (folder / "small_notes.md").write_text(NOTES)
    text = 'notes = "small_notes.md"\n' + SMALL.replace("as it is", f"as it is | {HOSTILE}")
    loaded = small(folder, text)
    ran(folder, labels=LABELS, runs=6, scenario=loaded).store.close()
    render.write(folder / "out", folder / "reports")
    return folder / "reports"


@pytest.fixture(scope="module")
def page(output) -> str:
    return (output / "small.md").read_text(encoding="utf-8")


OWN = """
from dataclasses import dataclass
import numpy as np
from ggbench.problem import Estimate, Estimator

@dataclass(frozen=True)
class Mine(Estimator):
    name = "{name}"
    causality = "filter"

    def estimate(self, problem, rng):
        if {fails}:
            raise ValueError("the gain is singular")
        shape = problem.epochs, len(problem.prior_mean)
        cov = np.broadcast_to(1e6 * np.eye(shape[1]), (*shape, shape[1]))
        return Estimate(np.zeros(shape), cov.copy(), self.causality)
"""


@pytest.fixture(scope="module")
def with_own(tmp_path_factory) -> Path:
    """A folder of the report of two own estimators next to the EKF; one fails in every run."""
    folder = tmp_path_factory.mktemp("own")
    for name, fails in (("mine", False), ("broken", True)):
        (folder / f"{name}.py").write_text(OWN.format(name=f"{name}-filter", fails=fails))
    labels = ("ins", *(str(folder / f"{name}.py") for name in ("mine", "broken")), "ekf", "ukf")
    ran(folder, labels=labels, runs=4).store.close()
    render.write(folder / "out", folder / "reports")
    return folder


def test_a_report_shows_the_estimators_of_ones_own(with_own):
    """In the first table, that of published numbers, and the table of errors, by one name."""
    text = (with_own / "reports" / "small.md").read_text(encoding="utf-8")
    first = next(block for block in text.split("\n\n") if block.startswith("|"))
    head = first.splitlines()[0].split("|")
    metrics = pd.read_csv(with_own / "reports" / "small" / "data" / "metrics.csv")
    own = metrics[metrics["estimator"] == "mine-filter"].set_index("case")["rms_m"]
    (row,) = [line.split("|") for line in first.splitlines() if line.startswith("|as it is|")]
    assert columns.metres(own["base"]) in row[head.index("`mine-filter`")]
    assert row[head.index("`broken-filter`")] == "failed"
    published = text.partition("## Published numbers")[2]
    assert "|`mine-filter`|" in published and "|`broken-filter`|failed|" in published
    errors = pd.read_csv(with_own / "reports" / "small" / "data" / "errors.csv")
    assert errors["mine-filter"].str.startswith(columns.metres(own["base"]))[0]
    assert "mine.py" not in text.partition("Reproduce: ")[0]


def test_a_report_of_an_estimator_that_fails_says_why(with_own):
    text = (with_own / "reports" / "small.md").read_text(encoding="utf-8")
    assert "`broken-filter` failed in all runs: ValueError: the gain is singular" in text


def test_a_report_of_failing_estimators_alone_is_written(with_own, monkeypatch, tmp_path):
    """No error, no bound and no curve, but the reason, and published errors."""
    monkeypatch.setattr(libraries, "_PACKAGES", ("no_such_package",))
    labels = ("ins", str(with_own / "broken.py"))
    ran(tmp_path, labels=labels, runs=2).store.close()
    render.write(tmp_path / "out", tmp_path / "reports")
    text = (tmp_path / "reports" / "small.md").read_text(encoding="utf-8")
    assert " No causal estimator finished." in text
    assert "`broken-filter` failed in all runs: ValueError: the gain is singular" in text
    assert not re.search(r"\bnan\b", text) and "|*published*|" in text


def test_figures_have_the_estimators_of_ones_own_in_their_colour(with_own):
    """By case, over time, and in the league."""
    results = Reported(with_own / "out")
    assert results.own == ["mine-filter", "broken-filter"]
    labels = views.drawn_estimators(results.metrics(), results.cases(), results.own)
    league = draw_league(league_of(results.metrics(), results.cases()), results.families)
    figures = [
        pictures.of_answer(results).figure,
        league,
        pictures.over_time(results, ["base"], labels).figure,
    ]
    for figure in figures:
        colour = figure.series["mine-filter"][0].get_color()
        assert colour == COLOURS["own"] != figure.series["ekf"][0].get_color()
    results.store.close()


def test_all_cases_begin_with_errors_and_end_with_counters(with_own):
    """Tables of the page for browsers, by name and column."""
    data = data_of(with_own / "reports" / "small.html")
    names = [name for name in data["tables"] if name not in ("metrics", "pairs", "cases")]
    assert names[0] == "errors" and ("counters" not in names or names[-1] == "counters")
    heads = {key: data["columns"][key] for key in data["tables"]["errors"]["columns"]}
    assert heads["error of mine-filter"]["head"] == "mine-filter [m]"
    assert heads["error of mine-filter"]["form"] == "error"


def test_counters_come_last(output):
    names = list(Reported(output.parent / "out").further_tables())
    assert names[0] == "errors" and names[-1] == "counters"


def test_the_suite_is_answered_by_its_league(output, monkeypatch):
    """With an explanation below it; other scenarios have errors by case."""
    results = Reported(output.parent / "out")
    assert pictures.of_answer(results).explanation == ""
    monkeypatch.setattr(pictures, "SUITE", results.scenario.name)
    picture = pictures.of_answer(results)
    assert (
        len(picture.figure.axes) == 2
        and "recommended" in picture.figure.legends[0].get_texts()[-5].get_text()
    )
    text = markdown_page.text(results, picture, output / "league", "")
    assert "Lower panel: share of cases with an RMS error up to x" in text
    results.store.close()


def test_a_remark_on_the_map_is_below_the_table(output, monkeypatch, tmp_path):
    """The first sentence is the answer; what to do about it is said once, in both pages."""
    monkeypatch.setattr(answers, "left_the_map", lambda runs: ["ekf", "ukf"])
    results = Reported(output.parent / "out")
    picture = pictures.of_answer(results)
    text = markdown_page.text(results, picture, tmp_path / "small", "")
    page = html_page.text(results, {}, "")
    results.store.close()
    remark = "`ekf` and `ukf` sometimes left the map."
    assert text.count(remark) == 1 and text.index(remark) > text.index("|case|bound [m]|")
    assert "**Answer.** Estimates" not in text
    assert page.index("left the map") > page.index('id="panel"')


def scripts_of(text: str) -> list[str | None]:
    """The types of the script elements of a page."""

    class Parser(HTMLParser):
        def handle_starttag(self, tag, attrs):
            if tag == "script":
                types.append(dict(attrs).get("type"))

    types: list[str | None] = []
    Parser().feed(text)
    return types


def data_of(page: Path) -> dict:
    """The data of an HTML page."""

    class Parser(HTMLParser):
        found, inside = "", False

        def handle_starttag(self, tag, attrs):
            self.inside = ("id", "data") in attrs

        def handle_data(self, data):
            self.found += data if self.inside else ""
            self.inside = False

    parser = Parser()
    parser.feed(page.read_text(encoding="utf-8"))
    return json.loads(parser.found)


@pytest.mark.long
def test_a_page_has_its_parts_in_order(page):
    """Answer, figure, table, conditions, command; the notes' place is before the command."""
    marks = [
        "<!--ggbench-page-",
        "# A short flight",
        "**Answer.**",
        "](small/answer.png)",
        "|case|bound [m]|",
        "## Published numbers",
        "## Conditions",
        "Reproduce: `ggbench run small.toml -n 6",
    ]
    places = [page.index(mark) for mark in marks]
    assert places == sorted(places)


def links_of(text: str) -> list[str]:
    """The relative links of a page, of markdown or HTML, without places within pages."""
    above = text.partition('<script type="application/json"')[0]
    found = re.findall(r"\]\(([^)#]+)|<a [^>]*href=\"([^\"#]+)", above)
    return [link for pair in found for link in pair if link and "://" not in link]


def dead(text: str, folder: Path) -> list[str]:
    """The relative links of a page in a folder that lead nowhere."""
    return [link for link in links_of(text) if not (folder / link).exists()]


@pytest.mark.parametrize("name", ["small.md", "small.html"])
def test_links_of_a_page_lead_somewhere(output, name):
    """Notes that link to what is not there keep their words."""
    text = (output / name).read_text(encoding="utf-8")
    assert dead(text, output) == []
    assert "It is short, and wide is another." in text


def test_a_dead_link_is_found(page, output):
    """Negative controls: the notes as written, in both languages; a page has links."""
    assert len(links_of(page)) >= 3
    written = ["../docs/short.md", "wide_prior.md"]
    html_notes = libraries.package("markdown_it").MarkdownIt("commonmark").render(NOTES)
    assert dead(NOTES, output) == dead(html_notes, output) == written


def test_numbers_of_a_page_are_those_of_the_data(page, output):
    """The table's cells, with their digits, come from metrics.csv of the settled window."""
    metrics = pd.read_csv(output / "small" / "data" / "metrics.csv")
    assert set(metrics["window"]) == {"settled"} and len(metrics) == 2 * len(LABELS)
    rows = metrics.set_index(["case", "estimator"])
    for case, title in (("base", "as it is"), ("noisy", "with ten times the noise")):
        (line,) = [line for line in page.splitlines() if line.startswith(f"|{title}")]
        ekf, ins = rows.loc[(case, "ekf")], rows.loc[(case, "ins")]
        assert f"|{columns.metres(ekf['bound_m'])}|{columns.metres(ins['rms_m'])}" in line
        cell = f"{columns.metres(ekf['rms_m'])} (×{columns.efficiency(ekf['efficiency'])})"
        # In italics where no estimator is surely better than the INS.
        assert f"|{cell}" in line or f"|*{cell}*|" in line


def test_the_answer_is_short(page):
    """At most seventy words."""
    (answer,) = [line for line in page.splitlines() if line.startswith("**Answer.**")]
    assert 10 < len(re.findall(r"[\w.]+", answer)) <= 70


def test_the_html_page_has_all_windows_and_their_numbers(output):
    """Numbers of the page, which sort its tables, are those of the tables to four digits."""
    data = data_of(output / "small.html")
    results = Results(output.parent / "out")
    for name, table in (("metrics", results.metrics()), ("cases", results.cases())):
        held = data["tables"][name]
        column = held["columns"].index("bound_m")
        shown = np.array(held["packed"][column]["values"], dtype=float)
        wanted = table["bound_m"].to_numpy()
        assert np.sort(shown) == pytest.approx(np.sort(wanted), rel=1e-3, nan_ok=True)
    windows = held_texts(data, "metrics", "window")
    assert windows == {"settled", "whole", "last20"}
    assert set(data["figures"]) == {"", "base", "noisy"}
    assert {"INS", *LABELS[1:]} <= set(data["figures"]["base"]["picture"]["names"])
    assert {case["title"] for case in data["cases"]} >= {"with ten times the noise"}
    results.store.close()


def held_texts(data: dict, table: str, column: str) -> set[str]:
    held = data["tables"][table]
    return set(held["packed"][held["columns"].index(column)]["texts"])


def test_the_html_page_is_small_and_loads_nothing(output):
    """Its policy allows the one script that it carries, and names in it are text."""
    text = (output / "small.html").read_text(encoding="utf-8")
    assert len(text.encode()) < html_page.MOST_BYTES
    policy = html.unescape(text.partition("<title>")[0])
    assert "default-src 'none'" in policy and len(re.findall(r"'sha256-[^']+'", policy)) == 1
    assert "unsafe-eval" not in policy
    executed = [tag for tag in scripts_of(text) if tag in (None, "module")]
    assert len(executed) == 1
    assert HOSTILE not in text.partition("</title>")[2].partition("<script")[0]
    assert not re.findall(r"(?:src|href)=\"(?!#)[^\"]+\"", text.partition("<script")[0])


@pytest.mark.long
def test_a_page_that_is_too_large_loses_pairs_then_windows(output, monkeypatch, tmp_path):
    """What is left out is in the data; a page that is too large even so is refused."""
    results = Reported(output.parent / "out")
    picture = pictures.of_answer(results)
    monkeypatch.setattr(html_page, "_MOST_DRAWN", 1)
    figures = html_page._figures(results, picture)
    sizes = [len(html_page.text(results, figures, "", *size).encode()) for size in html_page._SIZES]
    assert sizes == sorted(sizes, reverse=True) and sizes[0] > sizes[2]
    monkeypatch.setattr(html_page, "MOST_BYTES", sizes[2])
    data = data_of(html_page.write(results, picture, tmp_path / "page.html", ""))
    assert held_texts(data, "metrics", "window") == {"settled"}
    monkeypatch.setattr(html_page, "MOST_BYTES", sizes[2] - 1)
    with pytest.raises(libraries.PageError, match="report fewer cases or estimators"):
        html_page.write(results, picture, tmp_path / "page.html", "")
    results.store.close()


def test_a_page_warns_of_an_estimator_that_may_have_seen_the_truth(output, monkeypatch, tmp_path):
    """Above all numbers."""
    monkeypatch.setattr(Reported, "seeking", {"spy.py": "gc"})
    results = Reported(output.parent / "out")
    picture = pictures.of_answer(results)
    text = markdown_page.text(results, picture, tmp_path / "small", "")
    results.store.close()
    assert 0 < text.index("**Read with care.** `spy.py` uses gc and may") < text.index("\n|")


def test_an_estimator_has_its_own_name_in_tables_figures_and_data(output, monkeypatch, tmp_path):
    """Tables, figures and series know the shown name; the command keeps the file."""
    monkeypatch.setattr(
        reported, "shown_names", lambda names: {k: "mine" if k == "ekf" else k for k in names}
    )
    results = Reported(output.parent / "out")
    picture = pictures.of_answer(results)
    text = markdown_page.text(results, picture, tmp_path / "small", "")
    results.write_data(tmp_path / "data")
    assert "`mine`" in text and "`ekf`" not in text.partition("## Conditions")[0]
    assert "mine" in picture.figure.series and "ekf" not in picture.figure.series
    assert "mine" in set(pd.read_csv(tmp_path / "data" / "metrics.csv")["estimator"])
    assert results.families["mine"] == "kalman" and len(results.series("base", "mine")) == 6
    assert "-e ekf" in results.rerun()
    results.store.close()


def test_the_command_leaves_out_the_estimators_of_the_scenario():
    """Whatever the order of their parameters."""
    entries = {"argument": "small", "runs": 2, "seed": 1, "cases": [], "assumptions": False}

    def command(flown: str, *own: str) -> str:
        campaign = SimpleNamespace(estimators=own, seed=1)
        results = SimpleNamespace(
            manifest=entries | {"estimators": {flown: {}}},
            scenario=SimpleNamespace(campaign=campaign),
            whole_scenario=SimpleNamespace(cases=()),
        )
        return Reported.rerun(results)

    assert command("a[x=1,y=2]", "a[y=2,x=1]") == "ggbench run small -n 2"
    assert command("a[x=1,y=2]", "a[y=3,x=1]") == "ggbench run small -n 2 -e 'a[x=1,y=2]'"
    assert command("a", "a", "b") == command("a", "a", "b[") == "ggbench run small -n 2 -e a"


def test_without_the_extra_there_is_markdown_alone(output, monkeypatch, tmp_path):
    monkeypatch.setattr(libraries, "_PACKAGES", ("no_such_package",))
    assert render.write(output.parent / "out", tmp_path) == [tmp_path / "small.md"]


def test_the_front_page_is_made_of_the_data_alone(output, tmp_path):
    """Results folders need not be kept."""
    shutil.copytree(output / "small" / "data", tmp_path / "small" / "data")
    path, remarks = library.write(tmp_path)
    assert remarks == [] and "- [small](small.md): A short flight" in path.read_text()
    assert (tmp_path / "definitions.md").exists()


def test_columns_of_the_data_are_documented(output):
    listed = set(pd.read_csv(output / "columns.csv")["column"])
    for name in ("metrics", "cases", "pairs"):
        assert set(pd.read_csv(output / "small" / "data" / f"{name}.csv")) <= listed
