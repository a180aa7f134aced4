"""The front page of a folder of reports: findings, the suite's matrix, the scenarios."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from ..errors import GGBenchError
from ..files import reason_of
from ..results import digest
from ..results.digest import Digest
from . import columns
from .findings import SUITE, findings
from .page_templates import markdown
from .render import ReportError, write_definitions
from .tables import MOST_COLUMNS, MOST_ROWS, code, error_cell
from .views import require_equal_runs

FILE = "README.md"
"""Name of the page."""


def write(output: Path) -> tuple[Path, list[str]]:
    """Write the front page of a folder of reports.

    Parameters
    ----------
    output : folder of the reports of the scenarios, each with its digest.

    Returns
    -------
    Path of the page, and a sentence for each report that cannot be read.

    Raises
    ------
    ReportError
        If there is no report, or a file cannot be written.
    """
    digests, remarks = read(output)
    if not digests:
        raise ReportError("; ".join([f"{output} holds no report with its data", *remarks]))
    path = output / FILE
    try:
        path.write_text(text(digests), encoding="utf-8")
        write_definitions(output)
    except OSError as error:
        raise ReportError(f"cannot write to {output}: {reason_of(error)}") from None
    return path, remarks


def read(output: Path) -> tuple[list[Digest], list[str]]:
    """Return the digests of a folder of reports, and a sentence for each that cannot be read."""
    digests, remarks = [], []
    for folder in sorted(output.glob(f"*/{digest.FOLDER}")):
        try:
            digests.append(digest.read(folder))
        except GGBenchError as error:
            remarks.append(str(error))
    return digests, remarks


def text(digests: Sequence[Digest]) -> str:
    """Return the page as markdown."""
    suite = [found for found in digests if found.manifest["scenario"] == SUITE]
    scenarios = [
        {"name": found.manifest["scenario"], "title": found.manifest["title"]} for found in digests
    ]
    return markdown(
        "library.md.j2",
        findings=findings(digests),
        suite=matrix(suite[0]) if suite else [],
        scenarios=scenarios,
    )


def matrix(suite: Digest) -> list[pd.DataFrame]:
    """Return the matrix of the suite, estimators × cases, in tables that fit a page.

    A row for each estimator, at most ten in a table, and columns of at most seven cases; the last
    columns are the cost. Estimators with fewer runs than the suite's have a matrix of their own.
    """
    titles = suite.cases.set_index("case")["title"]
    tables = []
    for runs, rows in sorted(suite.metrics.groupby("runs"), reverse=True, key=lambda item: item[0]):
        require_equal_runs(rows)
        wide = _wide(rows, titles)
        names = list(wide.columns)
        width = MOST_COLUMNS - 1
        for first in range(0, len(wide), MOST_ROWS):
            for left in range(0, len(names), width):
                part = wide.iloc[first : first + MOST_ROWS][names[left : left + width]]
                label = f"estimator ({runs:.0f} runs)"
                tables.append(part.rename_axis(label).reset_index())
    return tables


def _wide(rows: pd.DataFrame, titles: pd.Series) -> pd.DataFrame:
    """Return cells by estimator and title of the case, and the median cost of a run."""
    cells = rows.assign(cell=[error_cell(row) for row in rows.to_dict("records")])
    table = cells.pivot(index="estimator", columns="case", values="cell")
    order = rows["estimator"].drop_duplicates()
    kept = [case for case in titles.index if case in table]
    table = table.loc[order, kept].fillna(columns.NONE)
    table.columns = pd.Index([titles[case] for case in kept])
    cost = rows.groupby("estimator")["seconds_per_run"].median()
    table["time a run"] = [columns.cell("seconds_per_run", cost[label]) for label in order]
    table.index = pd.Index([code(label) for label in order])
    return table
