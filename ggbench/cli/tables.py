"""Writer of the CSV tables of commands."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from ..errors import GGBenchError
from ..files.writing import written_whole
from ..results.csv_cells import csv_text

if TYPE_CHECKING:
    import pandas as pd


class OutputError(GGBenchError):
    """An output file cannot be written, or has a wrong suffix."""


def require_suffix(path: Path | None, suffix: str) -> None:
    """Raise OutputError if the name of an output file has another suffix."""
    if path is not None and path.suffix.lower() != suffix:
        raise OutputError(f"{path} must be named *{suffix}")


def write_csv(table: pd.DataFrame, path: Path) -> None:
    """Write a table as CSV atomically, and print the path.

    Raise OutputError if the file cannot be written.
    """
    with written_whole(path, OutputError, "the table ") as temporary:
        temporary.write_text(csv_text(table, float_format="%.8g"), encoding="utf-8")
    click.echo(f"Wrote {path}")
