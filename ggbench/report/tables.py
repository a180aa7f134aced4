"""Markdown tables, and cells with the errors of estimators."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import pandas as pd

from ..errors import line_of
from . import columns

_LONGEST_TEXT = 1000
_MARKUP = re.compile(r"[\\`*_\[\]<>~&]")
"""Characters with a meaning in markdown: emphasis, links, images, HTML."""

MOST_ROWS, MOST_COLUMNS = 10, 8
"""Largest numbers of rows and columns of a table on a markdown page."""
FAILED = "failed"
"""A cell of an estimator without a finished run."""
MOST_LOST = 0.5
"""Share of lost runs above which a cell has no RMS error."""


def markdown(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a markdown table."""
    lines = [head, ["---"] * len(head), *rows]
    escaped = ([" ".join(cell.split()).replace("|", "\\|") for cell in line] for line in lines)
    return "\n".join(f"|{'|'.join(line)}|" for line in escaped)


def code(text: object) -> str:
    """Return an untrusted text, such as an estimator's label, as a markdown code span.

    The fence is longer than any sequence of backticks in the text (CommonMark, section 6.1).
    """
    line = line_of(str(text), _LONGEST_TEXT)
    fence = "`" * (1 + max(map(len, re.findall("`+", line)), default=0))
    pad = " " if "`" in line else ""
    return f"{fence}{pad}{line}{pad}{fence}"


def plain(text: object) -> str:
    """Return an untrusted text, such as the reason of a failure, as escaped markdown."""
    return _MARKUP.sub(r"\\\g<0>", line_of(str(text), _LONGEST_TEXT))


def text(table: pd.DataFrame) -> str:
    """Return a data frame as a markdown table.

    The names of the columns are headings, or registered keys (:func:`.columns.column`).

    Raises
    ------
    ValueError
        If the table is too large for a page.
    """
    if len(table) > MOST_ROWS or len(table.columns) > MOST_COLUMNS:
        raise ValueError(f"a table of shape {table.shape} does not fit a page")
    head = [columns.COLUMNS[key].head if key in columns.COLUMNS else key for key in table]
    rows = [
        [columns.cell(key, value) for key, value in zip(table, row, strict=True)]
        for row in table.itertuples(index=False)
    ]
    return markdown(head, rows)


SUCCESS_SHOWN = "success (100% omitted)"
"""Caption on the success rates in the cells of :func:`error_cell`."""


def error_cell(row: Mapping[str, Any]) -> str:
    """Return the cell of an estimator, ``RMS (× oracle), success †``, from a row of metrics.

    The success rate is omitted at 100%. The cell of the INS has the RMS error and the success
    rate. If most runs are lost, the cell has only the share of lost runs. If all runs failed, the
    cell is "failed". The suffix "≤ INS" marks a success rate that is not significantly higher
    than that of the INS.
    """
    if row["failed"] == row["runs"]:
        return FAILED
    if is_lost(row):
        return columns.marked(
            f"lost {columns.share(row['lost'] / row['runs'])}", row["consistency"]
        )
    parts = columns.cell("rms_m", row["rms_m"])
    if row.get("causality") == "none":
        return f"{parts}, {columns.share(row['success'])}" if row["success"] < 1.0 else parts
    if pd.notna(row["efficiency"]):
        parts += f" (×{columns.efficiency(row['efficiency'])})"
    if row["success"] < 1.0:
        parts += f", {columns.share(row['success'])}"
    if row["as_ins"]:
        parts += " (≤ INS)" if row["success"] < 1.0 else ", ≤ INS"
    return columns.marked(parts, row["consistency"])


def is_lost(row: Mapping[str, Any]) -> bool:
    """Return whether more than half of the runs in a row of metrics are lost.

    A lost run ends outside the required error without warning (:func:`.judging.summary.lost`).
    """
    return bool(row["lost"] > MOST_LOST * row["runs"])


def names(labels: Sequence[str], most: int = 3) -> str:
    """Return the first ``most`` labels as code, and the number of remaining labels."""
    first = [code(label) for label in labels[:most]]
    more = len(labels) - most
    if more > 0:
        return ", ".join(first) + f" and {more} more"
    return " and ".join(filter(None, (", ".join(first[:-1]), *first[-1:])))
