"""What makes the documentation's site: generated pages, docstrings, pictures."""

from __future__ import annotations

import inspect
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

from ggbench.gravity.field import Field
from ggbench.report import render
from ggbench.spec import scenario

ROOT = Path(__file__).parents[1]
PICTURES = ROOT / "docs" / "pictures"


@pytest.fixture
def scripts(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "docs" / "scripts"))
    yield
    for name in ("conf", "site_pages", "docstrings", "pictures"):
        sys.modules.pop(name, None)


def cards(text):
    """Return title and content of each card of a grid."""
    return dict(
        re.findall(r"^:::\{grid-item-card\} (.*?)\n(.*?)^:::$", text, re.MULTILINE | re.DOTALL)
    )


def test_the_gallery_shows_every_scenario(scripts):
    """Each with title, purpose, the answer of its report, and a picture; the best come first."""
    import site_pages

    loaded = {name: scenario.load(name) for name in scenario.shipped()}
    names = site_pages.scenarios()
    assert sorted(names) == sorted(loaded) and names[0] == "suite"
    shown = cards(site_pages.gallery())
    assert [*shown] == [loaded[name].title for name in names]
    pictures = 0
    for name in names:
        card = shown[loaded[name].title]
        page = ROOT / "reports" / f"{name}.md"
        assert loaded[name].description in card
        assert f"(../../scenarios/{name}.toml)" in card
        if not page.exists():
            continue
        report = page.read_text(encoding="utf-8")
        answer = site_pages.answer(report)
        assert len(answer) > 40 and f"\n{answer}\n" in report
        assert site_pages.relinked(answer, page, site_pages.GENERATED / "gallery.md") in card
        pictures += f":img-top: thumbnails/{name}.png\n" in card
    assert pictures >= 30


@pytest.mark.long
def test_thumbnails_are_small_and_lead_to_the_reports(scripts, tmp_path):
    """One a report: all together less than a megabyte."""
    import site_pages

    site_pages.write_thumbnails(tmp_path / "thumbnails")
    files = sorted((tmp_path / "thumbnails").iterdir())
    shown = cards(site_pages.thumbnails())
    assert len(files) == len(shown) >= 30
    assert sum(file.stat().st_size for file in files) < 1_000_000
    reports = [
        name for name in site_pages.scenarios() if (tmp_path / f"thumbnails/{name}.png").exists()
    ]
    for name, card in zip(reports, shown.values(), strict=True):
        assert f":img-top: generated/thumbnails/{name}.png\n" in card
        assert f":link: generated/reports/{name}\n" in card
        assert imread(tmp_path / "thumbnails" / f"{name}.png").shape[1] <= 640


def test_the_landing_page_has_findings_pictures_and_three_ways_in(scripts):
    """The findings are the opening of the reports' front page."""
    import site_pages

    index = (ROOT / "docs" / "index.md").read_text(encoding="utf-8")
    assert re.findall(r"^- \*\*(.*?)\*\*", index, re.MULTILINE) == [
        "Compare",
        "Bring your own",
        "Look up",
    ]
    assert index.index("reports/suite/answer.png") < index.index("## Findings")
    for name in ("findings", "thumbnails"):
        assert f"```{{include}} generated/{name}.md\n" in index
    front = (ROOT / "reports" / "README.md").read_text(encoding="utf-8")
    findings = site_pages.findings()
    assert len(findings) > 500 and "\n#" not in findings
    assert findings.splitlines()[0] in front


def test_a_front_page_without_findings_is_an_error(scripts, tmp_path, monkeypatch):
    import site_pages

    (tmp_path / "README.md").write_text("# Title\n\n## Section\n\nText.\n")
    monkeypatch.setattr(site_pages, "_REPORTS", tmp_path)
    with pytest.raises(ValueError, match="has no findings"):
        site_pages.findings()


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
    monkeypatch.setattr(site_pages, "write_thumbnails", lambda folder: None)  # they take seconds
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


def test_signatures_name_array_like(scripts):
    """The API's pages show `ArrayLike`, not the union that it stands for."""
    import conf
    from sphinx.util.inspect import signature, stringify_signature

    texts = [
        stringify_signature(signature(Field.tensor, type_aliases=aliases))
        for aliases in (conf.autodoc_type_aliases, {})
    ]
    assert "latitude: ArrayLike" in texts[0] and "_Supports" not in texts[0]
    assert "_Supports" in texts[1]  # negative control


@pytest.mark.long
@pytest.mark.parametrize("styled", [True, False])
def test_a_wide_table_fits_in_a_window_of_1280_pixels(styled, tmp_path, browser):
    """Eight columns as in the suite's table, and a line of code; not without the style sheet."""
    sheet = ROOT / "docs" / "scripts" / "static"
    settings = [
        'extensions = ["myst_parser"]',
        'html_theme = "furo"',
        f'html_static_path = ["{sheet.as_posix()}"]',
        f"html_css_files = {['site.css'] if styled else []}",
    ]
    (tmp_path / "conf.py").write_text("\n".join(settings))
    cells = "|".join(["22900 (×2600), 6.0% ‡"] * 7)
    heads = "|".join(["Drone over the Rocky Mountains, narrow prior"] * 7)
    lines = [f"|estimator|{heads}|", f"|-|{'-|' * 7}", f"|`factor-graph[loss=cauchy]`|{cells}|"]
    code = f"```text\n{'x' * 300}\n```\n"
    (tmp_path / "index.md").write_text("# Page\n\n" + "\n".join(lines) + f"\n\n{code}")
    build = ["sphinx", "-q", "-b", "html", str(tmp_path), str(tmp_path / "html")]
    subprocess.run([sys.executable, "-m", *build], check=True)
    page = browser.new_page(viewport={"width": 1280, "height": 900})
    page.goto((tmp_path / "html" / "index.html").as_uri())
    table = page.locator(".table-wrapper")
    cut = table.evaluate("e => e.scrollWidth - e.clientWidth")
    whole = page.evaluate("document.documentElement.scrollWidth")
    page.close()
    assert ((cut > 1) is not styled) and whole <= 1280
