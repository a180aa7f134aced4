"""The page in a browser, without a network: it sorts, filters, switches, explains and prints."""

from __future__ import annotations

import io
import re
import shutil
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from campaigns import ran
from pages import HOSTILE, Page, browser, written

from ggbench.figures.locking import Series
from ggbench.report import definitions, scenario_report
from ggbench.report.page import reports
from ggbench.report.page.charts import Places, over_cases

__all__ = ["browser"]
pytestmark = pytest.mark.long
LABELS = ("ins", "ekf", "ukf[points=merwe]", "factor-graph[mode=batch]")
SHEET = 1032
"""Pixels across a sheet of A4 on its side, less the margins."""
LINES = "g.mark-line.role-mark path"


@pytest.fixture(scope="module")
def path(tmp_path_factory) -> Path:
    """The page of the small scenario."""
    folder = tmp_path_factory.mktemp("page")
    ran(folder, labels=LABELS).store.close()
    text = scenario_report.write(folder / "out", folder)
    return reports.write_report(folder / "out", folder, {"ekf": "The filter of the house."}, text)


class Opened:
    """A page in a browser that is offline, and what it said and asked for."""

    def __init__(self, browser: Any, path: Path, width: int = 1280) -> None:
        self.said: list[str] = []
        self.asked: list[str] = []
        self.context = browser.new_context(viewport={"width": width, "height": 900}, offline=True)
        self.page = self.context.new_page()
        self.page.on("console", lambda message: self.said.append(message.text))
        self.page.on("pageerror", lambda error: self.said.append(str(error)))
        self.page.on("dialog", lambda dialog: self.said.append(dialog.message))
        self.page.on("request", lambda request: self.asked.append(request.url))
        self.page.goto(path.as_uri())
        self.page.wait_for_selector("body[data-ready]")
        self.page.wait_for_selector(".chart g[class*='role-legend-entry']")

    def column(self, number: int, table: int) -> list[str]:
        """The texts of a column of a table, as they are shown."""
        cells = f"main table >> nth={table} >> tbody tr td:nth-child({number})"
        return [text.strip() for text in self.page.locator(cells).all_inner_texts()]

    def table(self, head: str) -> int:
        """Number of the first table with a column of that head."""
        heads = self.page.locator("main thead").all_inner_texts()
        return next(number for number, text in enumerate(heads) if head in text)

    def becomes(self, wanted: list[Any], read: Callable[[], list[Any]]) -> None:
        """Until a table reads as wanted: the browser sorts and filters when it comes to it."""
        for _ in range(100):
            if read() == wanted:
                return
            self.page.wait_for_timeout(50.0)
        assert read() == wanted

    def waits_for(self, count: int, lines: str, chart: Any) -> None:
        """Until so many lines are drawn."""
        chart.locator(lines).nth(count - 1).wait_for(state="attached")
        self.page.wait_for_function(
            "([chart, lines, count]) => chart.querySelectorAll(lines).length === count",
            arg=[chart.element_handle(), lines, count],
        )


@pytest.fixture
def opened(browser, path) -> Iterator[Opened]:
    found = Opened(browser, path)
    yield found
    found.context.close()


def test_it_says_and_asks_nothing(opened, path):
    """No word on the console, and nothing fetched but the file and what is in it."""
    assert opened.said == []
    assert opened.asked[0] == path.as_uri()
    assert [url for url in opened.asked[1:] if not url.startswith(("blob:", "data:"))] == []


@pytest.mark.parametrize("width", [1280, 400])
def test_it_fits_the_screen(browser, path, width):
    """No part of it is wider than the screen: what is too wide scrolls by itself."""
    found = Opened(browser, path, width)
    assert found.page.evaluate("document.documentElement.scrollWidth") <= width
    found.context.close()


def test_a_table_is_sorted_within_its_blocks(opened):
    """By numbers, upwards and downwards; smoothers stay below their title."""
    table = opened.table("ms/update")
    rows = opened.column(1, table)
    place = rows.index("smoothers")
    head = opened.page.locator(f"main table >> nth={table} >> th:has-text('ms/run')")
    numbers = sorted(float(text) for text in opened.column(5, table)[:place])
    assert len(set(numbers)) > 1
    for wanted in (numbers, numbers[::-1]):
        head.click()
        opened.becomes(wanted, lambda: [float(x) for x in opened.column(5, table)[:place]])
    assert opened.column(1, table)[place:] == rows[place:]


def test_a_table_is_filtered(opened):
    """Rows that hold what is typed are left, and all of them come back."""
    table = opened.table("error / bound")
    before = opened.column(1, table)
    box = opened.page.locator("div.dt-container").nth(table).locator("input")
    box.fill("merwe")
    opened.becomes(["ukf[points=merwe]"], lambda: opened.column(1, table))
    box.fill("")
    opened.becomes(before, lambda: opened.column(1, table))


def test_an_estimator_is_switched_off_and_on(opened):
    """In both panels, by a click on its name; with Shift it is alone; no other figure changes."""
    chart = opened.page.locator("figure:has(select) .chart")
    every = len(LABELS) + 2  # with the bounds of filter and of smoother
    opened.waits_for(2 * every, LINES, chart)
    name = chart.locator("g.role-legend-label text", has_text=re.compile("^ekf$"))
    name.click()
    opened.waits_for(2 * (every - 1), LINES, chart)
    name.click()
    opened.waits_for(2 * every, LINES, chart)
    name.click(modifiers=["Shift"])
    opened.waits_for(2, LINES, chart)


def test_a_case_is_chosen(opened):
    """The figure over time then is another one, and says of which case it is."""
    chart = opened.page.locator("figure:has(select) .chart")
    before = chart.locator(LINES).first.get_attribute("d")
    opened.page.locator("select").select_option("with ten times the noise")
    chart.locator("g.role-title text", has_text="with ten times the noise").wait_for()
    assert chart.locator(LINES).first.get_attribute("d") != before


def test_a_word_is_explained(opened):
    """By its definition, when the pointer is on it; an estimator by what it is; Escape ends it."""
    tip = opened.page.locator("#tip")
    opened.page.locator("th:has-text('NEES (band)')").first.hover()
    paragraph = definitions.text().partition("**Consistency.** ")[2].partition("\n\n")[0]
    assert tip.inner_text() == "Consistency. " + " ".join(paragraph.replace("*", "").split())
    opened.page.locator("td code.term", has_text=re.compile("^ekf$")).first.focus()
    assert tip.inner_text().startswith("ekf The filter of the house. Parameters: iterations = 1,")
    opened.page.keyboard.press("Escape")
    assert not tip.is_visible()


def test_on_paper_all_tables_are_there_and_no_controls(opened, path, tmp_path):
    """In print: every cell of every table in the text of the PDF, and nothing to click."""
    opened.page.emulate_media(media="print")
    for control in ("input", "select", "nav", ".hint", "#tip"):
        found = opened.page.locator(control)
        assert [k for k in range(found.count()) if found.nth(k).is_visible()] == []
    tables = opened.page.locator("main table")
    assert tables.count() == len(Page(path).tables)
    assert all(tables.nth(k).is_visible() for k in range(tables.count()))
    content = opened.page.pdf(prefer_css_page_size=True)
    assert content.startswith(b"%PDF")
    if shutil.which("pdftotext"):
        text = subprocess.run(
            ["pdftotext", "-", "-"], input=content, capture_output=True, check=True
        ).stdout.decode()
        said = re.sub(r"\s", "", text)
        cells = {cell for table in Page(path).tables for row in table for cell in row}
        assert [cell for cell in cells if re.sub(r"\s", "", cell) not in said] == []
    assert io.BytesIO(content).getbuffer().nbytes > 20_000


def test_wide_tables_fit_the_paper(browser, tmp_path):
    """Columns that scroll on a screen are all on the sheet: A4 on its side, without its margins."""
    figure = Series(np.array([0.5]), np.array([0.4]), np.array([0.6]))
    chart = over_cases("answer", Places(["c"]), {"ekf": figure}, {"ekf": figure}, ["ekf"], "Words")
    head = "|".join(f"a case with a long name, number {k}" for k in range(16))
    row = "|".join("1.234 [1.111, 2.222]" for _ in range(16))
    text = f"# Title\n\nAnswer.\n\n|{head}|\n|{'---|' * 16}\n|{row}|\n"
    written(tmp_path / "page.html", text, chart)
    found = Opened(browser, tmp_path / "page.html")
    width = found.page.locator("main table").evaluate("table => table.offsetWidth")
    assert width > 1280 >= found.page.evaluate("document.documentElement.scrollWidth")
    found.page.emulate_media(media="print")
    found.page.set_viewport_size({"width": SHEET, "height": 700})
    assert found.page.evaluate("document.documentElement.scrollWidth") <= SHEET
    assert found.page.locator("main table").evaluate("table => table.offsetWidth") <= SHEET
    found.context.close()


def test_names_run_nothing(browser, tmp_path):
    """An estimator that is called like a script is a name in figure, legend, table and tip."""
    figure = Series(np.array([0.5]), np.array([0.4]), np.array([0.6]))
    figures = {HOSTILE: figure, "<img src=x onerror=alert(1)>": figure}
    chart = over_cases("answer", Places([HOSTILE]), figures, figures, figures, HOSTILE)
    text = f"# {HOSTILE}\n\nAnswer.\n\n| estimator | n |\n|---|---|\n| `{HOSTILE}` | 1 |\n"
    written(tmp_path / "page.html", text, chart, **{HOSTILE: HOSTILE})
    found = Opened(browser, tmp_path / "page.html")
    found.page.locator("td code.term").hover()
    assert HOSTILE in found.page.locator("#tip").inner_text()
    point = found.page.locator("g.mark-symbol.role-mark path").first
    point.hover()
    assert HOSTILE in found.page.locator("#vg-tooltip-element.visible").inner_text()
    assert found.page.locator("h1").inner_text() == HOSTILE
    labels = found.page.locator("g.role-legend-label text").all_text_contents()
    assert labels == list(figures)
    assert found.said == []
    found.context.close()
