"""CSV text that spreadsheets do not execute as formulas.

Spreadsheets execute a cell that begins with ``=``, ``+``, ``-``, ``@``, a tab or a carriage return.
Titles, labels and reasons are untrusted. Therefore :func:`csv_text` writes an apostrophe before
such texts (OWASP, CSV injection), and :func:`restored` removes it.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import pandas as pd

_FORMULA = re.compile(r"'*[=+\-@\t\r]")
"""Start of a formula. It may follow apostrophes, so that texts with apostrophes are restored."""


def csv_text(table: pd.DataFrame, **options: Any) -> str:
    """Return a table as CSV text without the index; ``options`` go to ``DataFrame.to_csv``."""
    changed = table.rename(columns=_safe)
    texts = changed.select_dtypes(exclude=["number", "bool"])
    return changed.assign(**{key: texts[key].map(_safe) for key in texts}).to_csv(
        index=False, **options
    )


def restored(table: pd.DataFrame) -> pd.DataFrame:
    """Return a table from a CSV file without the apostrophes that :func:`csv_text` wrote."""
    texts = table.select_dtypes(exclude=["number", "bool"])
    return table.assign(**{key: texts[key].map(_plain) for key in texts})


def _safe(cell: Any) -> Any:
    return f"'{cell}" if isinstance(cell, str) and _FORMULA.match(cell) else cell


def _plain(cell: Any) -> Any:
    quoted = isinstance(cell, str) and cell.startswith("'") and _FORMULA.match(cell)
    return cell[1:] if quoted else cell
