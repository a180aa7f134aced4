"""Pages of a small campaign: markdown, data and HTML are of the same numbers."""

from __future__ import annotations

import html
import json
import re
import shutil
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from campaigns import ran, small
from problems import SMALL

from ggbench.report import (
    columns,
    html_page,
    libraries,
    library,
    markdown_page,
    pictures,
    render,
    reported,
)
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
    marks = ["<!-- ggbench page", "# A short flight", "**Answer.**", "](small/answer.png)",
             "|case|bound [m]|", "## Published numbers", "## Conditions", "## Again",
             "`ggbench run small.toml -n 6"]  # fmt: skip
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
    text = markdown_page.text(results, picture, tmp_path / "small", "", with_cost=False)
    results.store.close()
    assert 0 < text.index("**Read with care.** `spy.py` uses gc and may") < text.index("\n|")


def test_an_estimator_has_its_own_name_in_tables_figures_and_data(output, monkeypatch, tmp_path):
    """Tables, figures and series know the shown name; the command keeps the file."""
    monkeypatch.setattr(
        reported, "shown_names", lambda names: {k: "mine" if k == "ekf" else k for k in names}
    )
    results = Reported(output.parent / "out")
    picture = pictures.of_answer(results)
    text = markdown_page.text(results, picture, tmp_path / "small", "", with_cost=False)
    results.write_data(tmp_path / "data")
    assert "`mine`" in text and "`ekf`" not in text.partition("## Conditions")[0]
    assert "mine" in picture.figure.series and "ekf" not in picture.figure.series
    assert "mine" in set(pd.read_csv(tmp_path / "data" / "metrics.csv")["estimator"])
    assert results.families["mine"] == "kalman" and len(results.series("base", "mine")) == 6
    assert "-e ekf" in results.rerun()
    results.store.close()


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
