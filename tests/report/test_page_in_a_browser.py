"""The HTML page in a browser, offline: it fits, sorts by numbers, switches and filters."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from campaigns import ran

from ggbench.report import render

pytestmark = pytest.mark.long
LABELS = ("ins", "ekf", "ukf[points=merwe]", "factor-graph[mode=batch]")
BROWSERS = ("chromium", "chromium-browser", "google-chrome")
READY = "body[data-ready=yes]"


@pytest.fixture(scope="module")
def path(tmp_path_factory) -> Path:
    """The page of the small scenario."""
    folder = tmp_path_factory.mktemp("page")
    ran(folder, labels=LABELS).store.close()
    return render.write(folder / "out", folder)[1]


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """Chromium, as the system has it; ``make browser`` installs it."""
    sync_api = pytest.importorskip("playwright.sync_api")
    found = next(filter(None, map(shutil.which, BROWSERS)), None)
    if found is None:
        pytest.skip("there is no Chromium on the path; 'make browser' installs it")
    with sync_api.sync_playwright() as playwright:
        # The sandbox asks for rights that a container has not.
        opened = playwright.chromium.launch(executable_path=found, args=["--no-sandbox"])
        yield opened
        opened.close()


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
    """Nothing is cut: neither of all cases, nor of one."""
    for title in ("All cases", "with ten times the noise"):
        choose(page, title)
        width = page.viewport_size["width"]
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        box = page.locator(".chart svg").first.bounding_box()
        assert box["x"] >= 0 and box["x"] + box["width"] <= width
        assert box["width"] > 0.85 * width and box["height"] > 200


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


def test_an_estimator_is_switched_in_the_legend(page):
    choose(page, "as it is")
    lines = page.locator(".chart g.mark-line.role-mark path")
    before = lines.count()
    page.locator(".chart g.role-legend-label text", has_text="ins").first.click()
    page.wait_for_timeout(300)
    assert lines.count() == before - 1


def test_heads_are_explained(page):
    choose(page, "as it is")
    head = page.locator("#panel th", has_text="NEES").first
    assert "6 if consistent" in head.get_attribute("title")
