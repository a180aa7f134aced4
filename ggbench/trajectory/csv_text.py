"""The text of a CSV file of numbers whose first line names its columns."""

from __future__ import annotations

import csv
import io
import os
import re
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from .manoeuvres import Array, TrajectoryError


@dataclass(frozen=True)
class CsvText:
    """Rows of fields, as many in each as there are columns.

    Attributes
    ----------
    names : of the columns, in lower case.
    separator : between fields.
    rows : the lines below.
    line : number of the line that names the columns, from 1.
    """

    names: list[str]
    separator: str
    rows: list[str]
    line: int

    @classmethod
    def of(cls, content: bytes, wanted: str) -> CsvText:
        """Return the rows of a file, separated by commas, semicolons or tabs.

        Lines before the names that begin with # are passed over.

        Parameters
        ----------
        content : of the file.
        wanted : which columns it is to have, as a message says it.

        Raises
        ------
        TrajectoryError
            With a sentence that names the line and what was found.
        """
        try:
            text = content.decode("utf-8-sig")
        except UnicodeDecodeError:
            text = "\0"
        if "\0" in text:
            raise TrajectoryError("is not UTF-8 text; it must be a CSV file")
        text = text.replace('"', "")  # around fields; none of those that count needs them
        lines = text.replace("\r\n", "\n").replace("\r", "\n").rstrip().split("\n")
        top = next((n for n, line in enumerate(lines) if line.strip() and line[0] != "#"), None)
        if top is None:
            raise TrajectoryError(f"is empty; its first line must name the columns, {wanted}")
        separator = max(",;\t", key=lines[top].count)
        names = [name.strip().lower() for name in lines[top].split(separator)]
        for n in range(top + 1, len(lines)):
            if lines[n].count(separator) != len(names) - 1:
                found = lines[n].count(separator) + 1 if lines[n].strip() else 0
                hint = (
                    "; a decimal comma is not understood, write 33.5"
                    if separator == "," and found >= 2 * len(names) - 1
                    else ""
                )
                raise TrajectoryError(
                    f"line {n + 1} has {found} fields and line {top + 1} names {len(names)} columns"
                    f"{hint}"
                )
        return cls(names, separator, lines[top + 1 :], top + 1)

    def numbers(
        self, columns: Mapping[str, int], may_be_empty: frozenset[str] = frozenset()
    ) -> dict[str, Array]:
        """Return columns as numbers.

        Parameters
        ----------
        columns : which they are, by what messages call them.
        may_be_empty : those of which a field may be empty or say nan: NaN.

        Raises
        ------
        TrajectoryError
            If a field is no finite number, with a sentence that names its line.
        """
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                table = pd.read_csv(
                    io.StringIO("\n".join(self.rows)),
                    sep=self.separator,
                    header=None,
                    usecols=list(columns.values()),
                    skip_blank_lines=False,
                    skipinitialspace=True,
                    keep_default_na=False,
                    na_values=["", "nan", "NaN", "NAN"] if may_be_empty else [""],
                    float_precision="round_trip",
                    low_memory=False,
                    quoting=csv.QUOTE_NONE,
                )
        except ValueError as error:
            raise TrajectoryError(f"is no table of numbers: {str(error).splitlines()[0]}") from None
        first = self.line + 1
        return {
            key: _numbers(table[at], key, first, key in may_be_empty) for key, at in columns.items()
        }


def _numbers(column: pd.Series, key: str, first: int, may_be_empty: bool) -> Array:
    """Return a column as finite numbers, or NaN where it may be empty and is."""
    if column.dtype.kind in "iuf":
        values = column.to_numpy(dtype=float)
    else:
        # As texts, for which a truth is no number.
        values = pd.to_numeric(column.astype(str), errors="coerce").to_numpy(dtype=float)
    bad = ~np.isfinite(values)
    if may_be_empty:
        bad &= ~column.isna().to_numpy()
    if bad.any():
        n = int(np.argmax(bad))
        cell = column.iloc[n]
        found = "empty" if cell is None or cell != cell else f"'{str(cell)[:40]}'"
        hint = ""
        if re.fullmatch(r"\s*[-+]?\d+,\d+\s*", str(cell)):
            hint = "; a decimal comma is not understood, write 33.5"
        elif key == "time_s" and re.match(r"\s*\d+[-:/]", str(cell)):
            hint = "; a date or a time of day is not understood, give seconds"
        raise TrajectoryError(f"line {first + n}: {key} is {found} and must be a number{hint}")
    return values


def status_of(file: str, what: str) -> os.stat_result:
    """Return size and times of a file.

    Parameters
    ----------
    file : path. what : what it holds, for the message.

    Raises
    ------
    TrajectoryError
        If there is none.
    """
    try:
        return Path(file).stat()
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else "not a path"
        raise TrajectoryError(f"cannot read the {what} {file}: {reason}") from None
