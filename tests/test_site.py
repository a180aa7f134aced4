"""What makes the documentation's site: generated pages, docstrings, pictures."""

from __future__ import annotations

import inspect
import re
import sys
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

from ggbench.report import render
from ggbench.spec import scenario

ROOT = Path(__file__).parents[1]
PICTURES = ROOT / "docs" / "pictures"


@pytest.fixture
def scripts(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "docs" / "scripts"))
    yield
    for name in ("site_pages", "docstrings", "pictures"):
        sys.modules.pop(name, None)


def test_the_gallery_shows_every_scenario(scripts):
    """Each with title, purpose, the answer of its report word for word, and a picture of it."""
    import site_pages

    sections = dict(re.findall(r"^## (.*?)\n(.*?)(?=^## |\Z)", site_pages.gallery(), re.M | re.S))
    loaded = {name: scenario.load(name) for name in scenario.shipped()}
    assert list(sections) == [found.title for found in loaded.values()]
    for name, found in loaded.items():
        section = sections[found.title]
        page = ROOT / "reports" / f"{name}.md"
        assert found.description in section
        assert f"(scenarios/{name}.toml)" in section
        if not page.exists():
            continue
        report = page.read_text(encoding="utf-8")
        answer = site_pages.answer(report)
        assert len(answer) > 40 and answer in section and f"\n{answer}\n" in report
        (picture,) = re.findall(r"^!\[.*\]\((.*)\)$", section, re.M)
        assert (ROOT / picture).is_file() and f"/{name}/" in picture


def test_a_report_without_an_answer_is_an_error(scripts):
    import site_pages

    with pytest.raises(ValueError, match="without an answer"):
        site_pages.answer("# Title\n\nNothing was found.\n")


def test_links_lead_from_the_site_where_they_led(scripts):
    """To pages that are copied, to files beside them, and nowhere else."""
    import site_pages

    page = ROOT / "docs" / "howto" / "page.md"
    text = "[a](../../reports/suite.md#rules) [b](own_map.md) [c](https://x.org/y) [d](#here)"
    assert site_pages.relinked(text, page, page) == text.replace(
        "../../reports/suite.md", "../generated/reports/suite.md"
    )
    report = ROOT / "reports" / "suite.md"
    text = "[w](wang2013.md) ![p](suite/answer.png) [n](no_such_file.md)"
    assert site_pages.relinked(text, report, site_pages.copies()[report]) == (
        "[w](wang2013.md) ![p](../../../reports/suite/answer.png) [n](no_such_file.md)"
    )


def test_the_sites_definitions_are_those_of_the_reports(scripts, tmp_path, monkeypatch):
    """They are written from the same text, and not copied from a report."""
    import site_pages

    monkeypatch.setattr(site_pages, "GENERATED", tmp_path / "site")
    site_pages.write()
    render.write_definitions(tmp_path)
    written = (tmp_path / "site" / "reports" / "definitions.md").read_text(encoding="utf-8")
    assert written == (tmp_path / "definitions.md").read_text(encoding="utf-8")
    listed = (tmp_path / "site" / "reports" / "index.md").read_text(encoding="utf-8").splitlines()
    for path in (ROOT / "reports").glob("*.md"):
        assert listed.count(path.stem) == 1


def test_docstrings_keep_their_words(scripts):
    """What stands behind a parameter's colon is text, not a type; errors are links."""
    import docstrings

    numpydoc = """Say so.

    Parameters
    ----------
    case : of (K, 3) numbers,
        in E.
    seed, run : as ever.
    jobs : how many.

    Raises
    ------
    OneError, TwoError
        If so.

    Returns
    -------
    A row for each."""
    lines = inspect.cleandoc(numpydoc).splitlines()
    found = [line for line in docstrings.in_sphinx_words(lines) if line.strip()]
    assert found == [
        "Say so.",
        ":Parameters:",
        "    * **case** – of (K, 3) numbers,",
        "      in E.",
        "    * **seed**, **run** – as ever.",
        "    * **jobs** – how many.",
        ":Raises:",
        "    * :exc:`OneError`, :exc:`TwoError` – ",
        "      If so.",
        ":Returns:",
        "      A row for each.",
    ]


def test_every_picture_is_shown_and_every_picture_shown_is_drawn(scripts):
    import pictures

    pages = "".join(path.read_text(encoding="utf-8") for path in (ROOT / "docs").rglob("*.md"))
    assert {path.stem for path in PICTURES.iterdir()} == set(pictures.ALL)
    for name in pictures.ALL:
        assert f"(../pictures/{name}.png)" in pages


@pytest.mark.long
def test_the_pictures_are_those_that_are_drawn(scripts, tmp_path):
    """`make pictures` draws what is committed: simulated errors as they are with this source.

    Fonts and the last bits of a run may differ between machines, so most of the pixels must agree.
    """
    import pictures

    pictures.draw(tmp_path)
    for name in pictures.ALL:
        one, other = (imread(folder / f"{name}.png") for folder in (tmp_path, PICTURES))
        assert one.shape == other.shape, name
        assert np.mean(np.abs(one - other).max(axis=2) > 0.2) < 0.005, name
