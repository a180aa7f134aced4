"""Committed reports: short, small, and of the scenarios as they are.

Pages of an earlier layout, which do not carry the marker of today's, are not looked at.
"""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from ggbench.campaign.result_keys import RESULTS_VERSION
from ggbench.report import page_templates, tables
from ggbench.spec import scenario

REPORTS = Path(__file__).parents[2] / "reports"
MOST_WORDS, MOST_BYTES = 12_500, 8_000_000
PAGES = [
    path
    for path in sorted(REPORTS.glob("*.md"))
    if path.read_text(encoding="utf-8").startswith(
        f"<!--ggbench-page-{page_templates.PAGE_VERSION}-->"
    )
]
CURRENT = bool(PAGES) and (REPORTS / "README.md") in PAGES
"""Whether the whole library is of today's layout."""
MANIFESTS = [
    path
    for path in sorted(REPORTS.glob("*/data/manifest.json"))
    if REPORTS / f"{path.parents[1].name}.md" in PAGES
]


def too_long(pages: list[str], most: int = MOST_WORDS) -> str:
    """What is wrong with the number of words of pages together, "" if nothing is."""
    words = sum(len(page.split()) for page in pages)
    return f"{words} words, at most {most} are allowed" if words > most else ""


def too_large(folder: Path, most: int = MOST_BYTES) -> str:
    """What is wrong with the size of a folder, pages for browsers left out."""
    found = [path for path in folder.rglob("*") if path.is_file() and path.suffix != ".html"]
    size = sum(path.stat().st_size for path in found)
    return f"{size} bytes, at most {most} are allowed" if size > most else ""


def large_tables(page: str) -> list[tuple[int, int]]:
    """Rows and columns of the tables of a page that exceed the limits."""
    found = []
    for block in re.findall(r"(?:^\|.*\n?)+", page, re.MULTILINE):
        rows = block.strip().splitlines()
        shape = len(rows) - 2, len(re.findall(r"(?<!\\)\|", rows[0])) - 1
        if shape[0] > tables.MOST_ROWS or shape[1] > tables.MOST_COLUMNS:
            found.append(shape)
    return found


def test_limits_find_what_exceeds_them(tmp_path):
    """Negative controls of the three checks."""
    assert too_long(["a b c", "d"], 4) == "" and "5 words" in too_long(["a b c", "d e"], 4)
    (tmp_path / "a.csv").write_text("12345")
    (tmp_path / "a.html").write_text("12345")
    assert too_large(tmp_path, 5) == "" and "5 bytes" in too_large(tmp_path, 4)
    row = "|a|b|\n"
    assert large_tables(row + "|---|---|\n" + 10 * row) == []
    assert large_tables(row + "|---|---|\n" + 11 * row) == [(11, 2)]
    assert large_tables("|" + 9 * "a|" + "\n|" + 9 * "---|" + "\n") == [(0, 9)]


@pytest.mark.skipif(not CURRENT, reason="reports/ is of an earlier layout: make reports")
def test_the_library_is_short_and_small():
    texts = [path.read_text(encoding="utf-8") for path in sorted(REPORTS.glob("*.md"))]
    assert too_long(texts) == ""
    assert too_large(REPORTS) == ""


@pytest.mark.skipif(not CURRENT, reason="reports/ is of an earlier layout: make reports")
def test_every_scenario_has_its_report():
    """The front page leads to each."""
    held = {path.parents[1].name for path in REPORTS.glob("*/data/manifest.json")}
    front = (REPORTS / "README.md").read_text(encoding="utf-8")
    assert held == set(scenario.shipped())
    assert [name for name in held if f"]({name}.md)" not in front] == []


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.stem)
def test_tables_of_a_page_fit(path):
    assert large_tables(path.read_text(encoding="utf-8")) == []


@pytest.mark.parametrize("path", MANIFESTS, ids=lambda path: path.parents[1].name)
def test_a_report_is_of_this_version_of_results_and_of_its_scenario(path):
    """The data carry the version and the scenario's hash; notes are copied."""
    manifest = json.loads(path.read_text(encoding="utf-8"))
    assert manifest["results_version"] == RESULTS_VERSION, "'make library' runs it again"
    loaded = scenario.load(manifest["scenario"])
    assert manifest["scenario_hash"] == loaded.content_hash, "'make library' runs it again"
    text = (REPORTS / f"{manifest['scenario']}.md").read_text(encoding="utf-8")
    assert loaded.notes.strip() in text, "'make reports' renews it"
