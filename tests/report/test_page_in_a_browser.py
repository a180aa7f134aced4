"""The HTML page in a browser, offline: it fits, sorts by numbers, switches and filters."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from campaigns import ran

from ggbench.report import render

pytestmark = pytest.mark.long
LABELS = ("ins", "ekf", "ukf[points=merwe]", "factor-graph[mode=batch]")
READY = "body[data-ready=yes]"


@pytest.fixture(scope="module")
def path(tmp_path_factory) -> Path:
    """The page of the small scenario."""
    folder = tmp_path_factory.mktemp("page")
    ran(folder, labels=LABELS).store.close()
    return render.write(folder / "out", folder)[1]


@pytest.fixture(params=[400, 1280])
def page(request, browser, path) -> Iterator[Any]:
    """The page at the width of a telephone and of a screen; it says and asks for nothing."""
    context = browser.new_context(viewport={"width": request.param, "height": 900}, offline=True)
    opened, said = context.new_page(), []
    opened.on("console", lambda message: said.append(message.text))
    opened.on("pageerror", lambda error: said.append(str(error)))
    opened.on("request", lambda asked: said.append(asked.url) if "http" in asked.url else None)
    opened.goto(path.as_uri())
    opened.wait_for_selector(READY)
    yield opened
    assert said == []
    context.close()


def choose(page: Any, title: str) -> None:
    page.get_by_role("tab", name=title, exact=True).click()
    page.wait_for_selector(READY)


def test_figures_and_page_fit_the_width(page):
    """A figure that is wider than a telephone is scrolled in its frame, and stays legible."""
    for title in ("All cases", "with ten times the noise"):
        choose(page, title)
        width = page.viewport_size["width"]
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        frame, box = (page.locator(name).first.bounding_box() for name in (".chart", ".chart svg"))
        assert frame["x"] >= 0 and frame["x"] + frame["width"] <= width
        assert 500 < box["width"] < 1000 and box["height"] > 100


def test_a_table_is_sorted_by_numbers_and_filtered(page):
    choose(page, "as it is")
    table = page.locator("#panel table").first
    heads = table.locator("thead th").all_inner_texts()
    place = next(k for k, head in enumerate(heads) if " ".join(head.split()) == "RMS error [m]")
    table.locator("thead th").nth(place).click()
    page.wait_for_timeout(300)
    cells = table.locator(f"tbody td:nth-child({place + 1})").all_inner_texts()
    values = [float(cell) for cell in cells]
    assert len(values) == 12 and values == sorted(values)
    page.locator("#panel input[type=search]").first.fill("merwe")
    page.wait_for_timeout(300)
    assert table.locator("tbody tr").count() == 3


def test_all_cases_begin_with_the_table_of_errors(page):
    """Before the figure; sorted by the number with which a cell begins; counters come last."""
    heads = page.locator("#panel h2").all_inner_texts()
    assert heads[:2] == ["All cases", "Errors"] and heads[-1] == "Counters of estimators"
    table = page.locator("#panel table").first
    assert table.bounding_box()["y"] < page.locator("#panel figure").bounding_box()["y"]
    names = [" ".join(head.split()) for head in table.locator("thead th").all_inner_texts()]
    place = names.index("ekf [m]")
    for click, order in enumerate((1.0, -1.0)):
        table.locator("thead th").nth(place).click()
        page.wait_for_timeout(300)
        cells = table.locator(f"tbody td:nth-child({place + 1})").all_inner_texts()
        values = [order * float(cell.split()[0].rstrip(",")) for cell in cells]
        assert len(values) == 2 and values == sorted(values), click


def test_an_estimator_is_switched_in_the_legend(page):
    """Its lines and intervals vanish and come back."""
    choose(page, "as it is")
    lines = page.locator(".chart [id^=series-0-]").first
    name = page.locator(".chart [id=legend-0-0]")
    assert name.text_content().strip() == "INS" and lines.is_visible()
    name.click()
    assert not lines.is_visible()
    name.click()
    assert lines.is_visible()


VERTEX = """(name) => {
  const path = document.querySelector(`.chart [id=${name}] path`);
  const [, x, y] = path.getAttribute("d").match(/^M ([-\\d.]+) ([-\\d.]+)/);
  const point = new DOMPoint(Number(x), Number(y)).matrixTransform(path.getScreenCTM());
  return [point.x, point.y];
}"""


def test_the_value_under_the_pointer_is_shown(page):
    """Name, time and error of the nearest point; nothing away from all lines."""
    choose(page, "as it is")
    place = page.evaluate(VERTEX, "series-0-0")
    page.mouse.move(*place)
    tip = page.locator(".tip")
    series, time, error = tip.inner_text().split("\n")
    assert "INS" in series and time.startswith("time [s]: 1.00")
    assert re.fullmatch(r"RMS position \[m\]: [\d.]+", error)
    page.mouse.move(place[0], place[1] - 300)
    assert not tip.is_visible()


def test_a_figure_is_zoomed_and_reset(page):
    choose(page, "as it is")
    svg = page.locator(".chart svg")
    whole = svg.get_attribute("viewBox")
    page.mouse.move(*page.evaluate(VERTEX, "series-0-0"))
    page.mouse.wheel(0, -300)
    page.wait_for_timeout(100)
    before, after = (float(box.split()[2]) for box in (whole, svg.get_attribute("viewBox")))
    assert after < 0.7 * before
    page.mouse.dblclick(*page.evaluate(VERTEX, "series-0-0"))
    assert svg.get_attribute("viewBox") == whole


def test_heads_are_explained(page):
    choose(page, "as it is")
    head = page.locator("#panel th", has_text="NEES").first
    assert "6 if consistent" in head.get_attribute("title")
