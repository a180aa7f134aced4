"""Reports of results folders: pages, figures and data."""

from __future__ import annotations

from collections.abc import Set
from pathlib import Path

import pandas as pd

from ..errors import GGBenchError
from ..files.writing import reason_of, written_together
from ..results import digest
from . import columns, html_page, libraries, links, markdown_page, pictures
from .page_templates import markdown
from .reported import Reported


class ReportError(GGBenchError):
    """A report cannot be written."""


def write(folder: Path, output: Path, pages: Set[str] = frozenset()) -> list[Path]:
    """Write the report of a results folder: ``NAME.md`` with figures and data, and ``NAME.html``.

    Either all files are written, or none.

    Parameters
    ----------
    folder : results folder of a finished or interrupted campaign.
    output : folder to write to, created if missing.
    pages : files that will exist in ``output`` later, so that links to them are allowed.

    Returns
    -------
    list of Path
        The markdown page, and the HTML page if the packages of the pip extra ``page`` are
        installed.

    Raises
    ------
    StoreError, ScenarioError, ReportError
        If the folder is no results folder, is damaged, or has no finished run.
    """
    results = Reported(folder)
    if results.metrics().empty:
        raise ReportError(f"{folder} contains no finished run")
    name = results.scenario.name
    path = output / f"{name}.md"
    notes = links.without_dead(results.scenario.notes.strip(), output, pages)
    try:
        with written_together(output) as place:
            results.write_data(place / name / digest.FOLDER)
            answer = pictures.of_answer(results)
            text = markdown_page.text(results, answer, place / name, notes)
            (place / path.name).write_text(text, encoding="utf-8")
            write_definitions(place)
            written = [path]
            if libraries.installed():
                html_page.write(results, answer, place / f"{name}.html", notes)
                written.append(output / f"{name}.html")
    except OSError as error:
        raise ReportError(f"cannot write to {output}: {reason_of(error)}") from None
    results.store.close()
    return written


def write_definitions(output: Path) -> None:
    """Write the page of definitions and a table of all columns into a folder."""
    listed = [
        {"column": key, "heading": c.heading, "unit": c.unit, "definition": c.definition}
        for key, c in columns.COLUMNS.items()
    ]
    pd.DataFrame(listed).to_csv(output / "columns.csv", index=False)
    (output / "definitions.md").write_text(definitions(), encoding="utf-8")


def definitions() -> str:
    """Return the page of definitions as markdown."""
    return markdown("definitions.md.j2", columns=[columns.COLUMNS[key] for key in columns.DEFINED])
