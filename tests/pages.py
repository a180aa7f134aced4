"""Pages as a browser gets them: their tables, their scripts, and what they ask for elsewhere."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import pytest

from ggbench.report.page import writing
from ggbench.report.page.charts import Chart

HOSTILE = "</script><script>alert(1)</script>"
BROWSERS = ("chromium", "chromium-browser", "google-chrome")


class Page(HTMLParser):
    """What a page holds.

    Attributes
    ----------
    tables : of each, its rows of cells' texts, the head first; hidden cells are left out.
    charts : specifications of the figures by the id of their element.
    loaded : addresses that a browser would fetch by itself.
    policy : the content security policy. scripts : how many elements hold code that runs.
    terms : ids of what explains a word of the page. ids : of all elements.
    """

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.tables: list[list[list[str]]] = []
        self.charts: dict[str, Any] = {}
        self.loaded: list[str] = []
        self.policy, self.scripts = "", 0
        self.terms: set[str] = set()
        self.ids: set[str] = set()
        self._within: list[tuple[str, dict[str, str]]] = []
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        found = {key: value or "" for key, value in attrs}
        self.ids.add(found.get("id", ""))
        self.terms |= {found["data-term"]} if "data-term" in found else set()
        fetched = ("src", "srcset", "data", "poster") if tag != "link" else ("href",)
        self.loaded += [found[key] for key in fetched if key in found]
        if found.get("http-equiv") == "Content-Security-Policy":
            self.policy = found["content"]
        if tag == "script" and found.get("type", "module") == "module":
            self.scripts += 1
        if tag == "table":
            self.tables.append([])
        elif tag == "tr":
            self.tables[-1].append([])
        elif tag in ("td", "th") and found.get("class") != "block":
            self.tables[-1][-1].append("")
        if tag not in ("meta", "img", "br", "link", "input"):
            self._within.append((tag, found))

    def handle_endtag(self, tag: str) -> None:
        assert self._within.pop()[0] == tag

    def handle_data(self, data: str) -> None:
        tag, found = self._within[-1] if self._within else ("", {})
        if tag == "script" and found.get("type") == "application/json":
            self.charts[found["id"]] = json.loads(data)
        if tag == "style":
            self.loaded += [a or b for a, b in re.findall(r"url\(([^)]*)|@import([^;]*)", data)]
        cells = [held.get("class") for name, held in self._within if name in ("td", "th")]
        if cells and cells[-1] != "block":
            self.tables[-1][-1][-1] += data


def tables_of(text: str) -> list[list[list[str]]]:
    """The tables of a markdown text, as :class:`Page` has those of a page."""
    found = []
    for block in re.findall(r"(?:^\|.*\n?)+", text, re.MULTILINE):
        lines = [re.split(r"(?<!\\)\|", line)[1:-1] for line in block.splitlines()]
        plain = [[_plain(cell) for cell in line] for line in lines]
        found.append([plain[0], *plain[2:]])
    return found


def _plain(cell: str) -> str:
    words = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", cell.strip().replace("\\|", "|"))
    return re.sub(r"\*{1,2}(?=\S)(.*?)(?<=\S)\*{1,2}", r"\1", words.replace("`", ""))


def written(path: Path, text: str, *charts: Chart, **estimators: str) -> Page:
    """A page of a text, its figures behind the answer."""
    return Page(writing.write(path, text, path.parent, {}, estimators, charts))


@pytest.fixture(scope="session")
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
