"""Pages of the site that are made from the repository at each build, into ``docs/generated``.

The definitions (from the text of which ``reports/definitions.md`` is made, too), the reports, what
is said of the data, and a gallery of the shipped scenarios with their answers.
"""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Iterator
from pathlib import Path

from ggbench.report import render
from ggbench.spec import scenario

DOCS = Path(__file__).parents[1]
ROOT = DOCS.parent
GENERATED = DOCS / "generated"
EXTRA = DOCS.parent / "build" / "extra"
"""Files that the site has as they are: the reports' HTML pages, in ``pages``, if any."""
_REPORTS, _DATA = ROOT / "reports", ROOT / "scenarios" / "data"
_LINK = re.compile(r"\]\(([^)#\s]+)(#[^)\s]*)?\)")
_PICTURE = re.compile(r"^!\[(.*?)\]\((.+?)\)$", re.MULTILINE)


def write() -> None:
    """Write all pages anew."""
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
    page = GENERATED / "gallery.md"
    page.write_text(relinked(gallery(), ROOT / "gallery.md", page), encoding="utf-8")


def _interactive() -> list[str]:
    """Return links to the HTML pages of the reports, if `make reports` has written them here."""
    links = [
        f'<a href="../../pages/{path.name}">{path.stem}</a>'
        for path in sorted(_REPORTS.glob("*.html"))
    ]
    return [f"With all tables and figures: {', '.join(links)}.", ""] if links else []


def copies() -> dict[Path, Path]:
    """Return the page of each text of the repository that the site has."""
    reports = {path: GENERATED / "reports" / path.name for path in sorted(_REPORTS.glob("*.md"))}
    return reports | {
        _DATA / "README.md": GENERATED / "data.md",
        _DATA / "comma2k19" / "README.md": GENERATED / "comma2k19.md",
        _DATA / "measured" / "README.md": GENERATED / "measured.md",
    }


def relinked(text: str, written: Path, page: Path) -> str:
    """Return a text whose links lead from a page of the site where they led from its own place.

    Parameters
    ----------
    text : markdown. written : the file whose links they are. page : the file that will hold it.
    """

    def led(link: re.Match[str]) -> str:
        target = Path(os.path.normpath(written.parent / link[1]))
        if "://" in link[1] or not target.exists():
            return link[0]
        place = os.path.relpath(copies().get(target, target), page.parent)
        return f"]({Path(place).as_posix()}{link[2] or ''})"

    return _LINK.sub(led, text)


def gallery() -> str:
    """Return the page of the shipped scenarios, as if it stood in the root of the repository."""
    return "\n\n".join(_gallery()) + "\n"


def _gallery() -> Iterator[str]:
    yield "# Gallery of scenarios"
    yield (
        "Every shipped scenario with its purpose, and with the answer and figure of its report if "
        "it has one. `ggbench run NAME` runs one again, `ggbench report` writes its report. Terms "
        "are [defined](reports/definitions.md) once."
    )
    for name in scenario.shipped():
        loaded = scenario.load(name)
        yield f"## {loaded.title}"
        yield loaded.description
        if not (_REPORTS / f"{name}.md").exists():
            yield f"`{name}`: [the scenario's file](scenarios/{name}.toml)"
            continue
        report = _text(_REPORTS / f"{name}.md")
        yield answer(report)
        picture = main_picture(report)
        if picture is not None:
            yield f"![{picture[0]}](reports/{picture[1]})"
        yield (
            f"`{name}`: [the report](reports/{name}.md), "
            f"[the scenario's file](scenarios/{name}.toml)"
        )


def answer(report: str) -> str:
    """Return what a report says first, in bold or as a list: its answer.

    Raises
    ------
    ValueError
        If it says nothing.
    """
    for block in re.split(r"\n\s*\n", report):
        if block.startswith(("**", "- **")):
            return block
    raise ValueError(f"a report without an answer: {report[:60]!r}")


def main_picture(report: str) -> tuple[str, str] | None:
    """Return caption and path of the picture of a report's answer, else of its first."""
    pictures = _PICTURE.findall(report)
    of_answer = [found for found in pictures if found[1].endswith("/answer.png")]
    return next(iter([*of_answer, *pictures]), None)


def _text(path: Path) -> str:
    return path.read_text(encoding="utf-8")
