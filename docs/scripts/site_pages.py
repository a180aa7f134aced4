"""Pages that each build of the site generates from the repository, in ``docs/generated``.

The pages are

- the definitions, from the same text as ``reports/definitions.md``,
- the reports,
- the descriptions of the data,
- a gallery of the shipped scenarios with the answers of their reports,
- the findings and thumbnails of the landing page.
"""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Iterator
from pathlib import Path

from PIL import Image

from ggbench.report import render
from ggbench.report.findings import FINDINGS
from ggbench.spec import scenario

DOCS = Path(__file__).parents[1]
ROOT = DOCS.parent
GENERATED = DOCS / "generated"
EXTRA = DOCS.parent / "build" / "extra"
"""Files that the site contains unchanged: HTML pages of the reports in ``pages``, if any."""
THUMBNAILS = "thumbnails"
"""Folder of thumbnails, inside the folder of generated pages."""
FIRST = tuple(dict.fromkeys([*(name for name, _ in FINDINGS), "wang2013"]))
"""First scenarios of the gallery: the sources of the findings, and the scenario of the paper."""
_THUMBNAIL_PX, _THUMBNAIL_COLOURS = 640, 64
_REPORTS, _DATA = ROOT / "reports", ROOT / "scenarios" / "data"
_LINK = re.compile(r"\]\(([^)#\s]+)(#[^)\s]*)?\)")
_PICTURE = re.compile(r"^!\[(.*?)\]\((.+?)\)$", re.MULTILINE)


def write() -> None:
    """Write all pages again, after deletion of the old pages."""
    shutil.rmtree(GENERATED, ignore_errors=True)
    shutil.rmtree(EXTRA, ignore_errors=True)
    for source, page in copies().items():
        page.parent.mkdir(parents=True, exist_ok=True)
        if source.name != "definitions.md":
            page.write_text(relinked(_text(source), source, page), encoding="utf-8")
    render.write_definitions(GENERATED / "reports")
    contents = ["# All reports", *_interactive(), "```{toctree}", ":maxdepth: 1", ""]
    contents += ["README", "definitions"]
    contents += sorted({page.stem for page in copies().values() if page.parent.name == "reports"})
    text = "\n".join(dict.fromkeys(contents)) + "\n```\n"
    (GENERATED / "reports" / "index.md").write_text(text, encoding="utf-8")
    pages = sorted(_REPORTS.glob("*.html"))
    (EXTRA / "pages").mkdir(parents=True, exist_ok=True)
    for source in pages:
        shutil.copy(source, EXTRA / "pages")
    write_thumbnails(GENERATED / THUMBNAILS)
    (GENERATED / "gallery.md").write_text(gallery(), encoding="utf-8")
    parts = {"findings": findings(), "thumbnails": thumbnails()}
    for name, text in parts.items():
        (GENERATED / f"{name}.md").write_text(text, encoding="utf-8")


def _interactive() -> list[str]:
    """Return links to the HTML pages of the reports, if `make reports` has written these pages."""
    links = [
        f'<a href="../../pages/{path.name}">{path.stem}</a>'
        for path in sorted(_REPORTS.glob("*.html"))
    ]
    return [f"With all tables and figures: {', '.join(links)}.", ""] if links else []


def copies() -> dict[Path, Path]:
    """Return the page of each text that the site copies from the repository."""
    reports = {path: GENERATED / "reports" / path.name for path in sorted(_REPORTS.glob("*.md"))}
    return reports | {
        _DATA / "README.md": GENERATED / "data.md",
        _DATA / "comma2k19" / "README.md": GENERATED / "comma2k19.md",
        _DATA / "measured" / "README.md": GENERATED / "measured.md",
    }


def relinked(text: str, written: Path, page: Path) -> str:
    """Return a text with links that lead from a page of the site to their original targets.

    Parameters
    ----------
    text : text in Markdown.
    written : file that contains the text.
    page : file that will contain the result.
    """

    def led(link: re.Match[str]) -> str:
        target = Path(os.path.normpath(written.parent / link[1]))
        if "://" in link[1] or not target.exists():
            return link[0]
        place = os.path.relpath(copies().get(target, target), page.parent)
        return f"]({Path(place).as_posix()}{link[2] or ''})"

    return _LINK.sub(led, text)


def scenarios() -> list[str]:
    """Return the names of the shipped scenarios, :data:`FIRST` first."""
    shipped = scenario.shipped()
    return [*FIRST, *(name for name in shipped if name not in FIRST)]


def findings() -> str:
    """Return the opening of the reports' front page, for a page in ``docs``.

    Raises
    ------
    ValueError
        If the front page has no text before its first section.
    """
    front = _REPORTS / "README.md"
    opening = re.search(r"^# [^\n]*\n+(.*?)(?=^## )", _text(front), re.MULTILINE | re.DOTALL)
    if opening is None or not opening[1].strip():
        raise ValueError(f"{front.name} has no findings before its first section")
    return relinked(opening[1], front, DOCS / "index.md")


def write_thumbnails(folder: Path) -> None:
    """Write a small picture ``NAME.png`` of each report that has a picture.

    Parameters
    ----------
    folder : folder of the pictures; it is created.
    """
    folder.mkdir(parents=True)
    for name, source in _pictures().items():
        with Image.open(source) as picture:
            picture.thumbnail((_THUMBNAIL_PX, 2 * _THUMBNAIL_PX))
            small = picture.convert("RGB").quantize(_THUMBNAIL_COLOURS)
        small.save(folder / f"{name}.png", optimize=True)


def _pictures() -> dict[str, Path]:
    """Return the main picture of each shipped scenario whose report has one."""
    found = {}
    for name in scenarios():
        page = _REPORTS / f"{name}.md"
        picture = main_picture(_text(page)) if page.exists() else None
        if picture is not None:
            found[name] = _REPORTS / picture[1]
    return found


def thumbnails() -> str:
    """Return a grid of pictures that link to their reports, for a page in ``docs``."""
    lines = ["::::{grid} 2 3 4 4", ":gutter: 2", ""]
    for name in _pictures():
        lines += [
            f":::{{grid-item-card}} {_plain(scenario.load(name).title)}",
            f":img-top: {GENERATED.name}/{THUMBNAILS}/{name}.png",
            f":link: {GENERATED.name}/reports/{name}",
            ":link-type: doc",
            ":class-title: thumbnail-title",
            ":::",
        ]
    return "\n".join([*lines, "::::"]) + "\n"


def _plain(title: str) -> str:
    """Return a title, escaped for the argument of a directive."""
    return title.replace("`", "\\`").replace("*", "\\*")


def gallery() -> str:
    """Return the text of the gallery, a page in the folder of the generated pages."""
    return "\n\n".join(_gallery()) + "\n"


def _gallery() -> Iterator[str]:
    yield "# Gallery of scenarios"
    yield (
        "The gallery shows every shipped scenario with its purpose. If a report exists, the card "
        "contains its answer and figure. `ggbench run NAME` runs a scenario, and `ggbench report` "
        "writes its report. See the [definitions](reports/definitions.md) of terms."
    )
    yield "::::{grid} 1 2 3 3\n:gutter: 3"
    pictures = _pictures()
    for name in scenarios():
        loaded, page = scenario.load(name), _REPORTS / f"{name}.md"
        options = [f":img-top: {THUMBNAILS}/{name}.png"] if name in pictures else []
        yield "\n".join([f":::{{grid-item-card}} {_plain(loaded.title)}", *options])
        yield loaded.description
        links = f"[scenario file](../../scenarios/{name}.toml)"
        if page.exists():
            yield relinked(answer(_text(page)), page, GENERATED / "gallery.md")
            links = f"[report](reports/{name}.md), {links}"
        yield f"`{name}`: {links}"
        yield ":::"
    yield "::::"


def answer(report: str) -> str:
    """Return the answer of a report: its first paragraph or list that starts in bold.

    Raises
    ------
    ValueError
        If the report has no such paragraph or list.
    """
    for block in re.split(r"\n\s*\n", report):
        if block.startswith(("**", "- **")):
            return block
    raise ValueError(f"a report without an answer: {report[:60]!r}")


def main_picture(report: str) -> tuple[str, str] | None:
    """Return caption and path of the answer's picture, or else of the first picture of a report."""
    pictures = _PICTURE.findall(report)
    of_answer = [found for found in pictures if found[1].endswith("/answer.png")]
    return next(iter([*of_answer, *pictures]), None)


def _text(path: Path) -> str:
    return path.read_text(encoding="utf-8")
