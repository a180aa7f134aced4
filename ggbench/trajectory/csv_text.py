"""Reader of CSV text with named columns of numbers."""

from __future__ import annotations

import csv
import datetime
import io
import math
import os
import re
import warnings
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from ..errors import text_of
from ..gravity.unit_names import unit_named
from .manoeuvres import Array, TrajectoryError

_EXCEL = re.compile(r"sep=([,;\t])\s*", re.IGNORECASE)  # its first line, which names the separator
_IN_BRACKETS = re.compile(r"\s*[\[(][^\])]*[\])]")
_DATE = re.compile(r"\s*\d{4}-\d\d-\d\d[T ]\d")
_EPOCH = datetime.datetime(1970, 1, 1, tzinfo=datetime.UTC)
_COMMENT = re.compile(r"#|//|%[^,;\t]*$")
_QUOTED = re.compile(r'"[^"]*"')
_PERIODS = ((604_800.0, "GPS week"), (86_400.0, "day"))  # after which clocks begin at 0 [s]
_NEAR = 100.0  # of such an end, where times fall [s]
_FEWEST_KNOWN = 2  # names by which a comment is known to be the line of names


@dataclass(frozen=True)
class CsvText:
    """Content of a CSV file; each row has as many fields as there are columns.

    Attributes
    ----------
    names : names of the columns, in lower case.
    separator : separator of the fields.
    rows : lines after the line of the names.
    line : number of the line with the column names, from 1.
    first : number of the line with the first row, from 1.
    """

    names: list[str]
    separator: str
    rows: list[str]
    line: int
    first: int

    @classmethod
    def of(cls, content: bytes, needed: str, known_names: Collection[str]) -> CsvText:
        """Return the content of a file with fields separated by commas, semicolons or tabs.

        Fields may be quoted. Comments before the line of names are ignored: lines that begin with
        #, // or %. A line that begins with % may be the line of names if it contains a separator
        and a known name. If the first line after the comments contains no known name, the last
        comment with at least two known names is the line of names (format of ``numpy.savetxt``).

        Parameters
        ----------
        content : content of the file.
        needed : description of the required columns, for messages.
        known_names : known names of columns, in lower case.

        Raises
        ------
        TrajectoryError
            If the text is invalid; the message states the line and the value.
        """
        try:
            text = content.decode("utf-8-sig")
        except UnicodeDecodeError:
            text = "\0"
        if "\0" in text:
            raise TrajectoryError(
                "is not UTF-8 text; it must be a CSV file: unpack it, or convert its characters"
            )
        lines = text.replace("\r\n", "\n").replace("\r", "\n").rstrip().split("\n")
        excel = _EXCEL.fullmatch(lines[0])
        lines[0] = "" if excel else lines[0]
        top = next(
            (n for n, line in enumerate(lines) if line.strip() and not _COMMENT.match(line)), None
        )
        if top is None:
            raise TrajectoryError(f"is empty; its first line must name the columns, {needed}")
        named, first = _line_of_names(lines, top, known_names)
        separator = excel[1] if excel else _separator(lines[named])
        header = lines[named].lstrip("# ").removeprefix("% ")
        header = _unquoted(header, separator, named + 1)
        names = [name.strip().lower() for name in header.split(separator)]
        rows = [_unquoted(lines[n], separator, n + 1) for n in range(first, len(lines))]
        if all(row.count(separator) == len(names) and row.endswith(separator) for row in rows):
            rows = [row.removesuffix(separator) for row in rows]
        for n, row in enumerate(rows, first + 1):
            if row.count(separator) != len(names) - 1:
                count = row.count(separator) + 1 if row.strip() else 0
                hint = (
                    "; write 33.5, not a decimal comma"
                    if separator == "," and count >= 2 * len(names) - 1
                    else ""
                )
                raise TrajectoryError(
                    f"line {n} has {count} fields, but line {named + 1} names {len(names)} "
                    f"columns{hint}"
                )
        return cls(names, separator, rows, named + 1, first + 1)

    def numbers(
        self, columns: Mapping[str, int], may_be_empty: frozenset[str] = frozenset()
    ) -> dict[str, Array]:
        """Return columns (N,) as numbers, by name.

        ``columns`` maps names to column indices. ``may_be_empty`` contains the names of columns in
        which a field may be empty or "nan". The result has NaN for such a field.

        Raises TrajectoryError if any other field is not a finite number; the message states the
        line.
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
            raise TrajectoryError(f"is not a table of numbers: {text_of(error)}") from None
        return {
            key: _numbers(table[at], key, self.first, key in may_be_empty)
            for key, at in columns.items()
        }


def _line_of_names(lines: list[str], top: int, known_names: Collection[str]) -> tuple[int, int]:
    """Return the indices of the line of the names and of the first row.

    ``top`` is the index of the first line that is not a comment.
    """

    def count(line: str) -> int:
        plain = _IN_BRACKETS.sub("", line.strip("# ").removeprefix("% ").replace('"', "").lower())
        words = plain.split(_separator(line))
        return sum(word.strip() in known_names for word in words)

    if lines[top].startswith("%") and not count(lines[top]):  # a comment with a separator
        rest = range(top, len(lines))
        top = next((n for n in rest if not lines[n].startswith("%") and lines[n].strip()), top)
    comments = [n for n in range(top) if count(lines[n]) >= _FEWEST_KNOWN]
    return (comments[-1], top) if comments and not count(lines[top]) else (top, top + 1)


def _separator(line: str) -> str:
    """Return the separator of a line of names."""
    return max(",;\t", key=_QUOTED.sub("", line).count)


def _unquoted(line: str, separator: str, number: int) -> str:
    """Return a line without quotes; separators inside quoted fields become blanks (RFC 4180)."""
    if '"' not in line:
        return line
    try:
        (fields,) = csv.reader([line], delimiter=separator, skipinitialspace=True, strict=True)
    except csv.Error as error:
        raise TrajectoryError(
            f"line {number}: its quotes cannot be read ({text_of(error)}): close each quoted "
            'field on its line, and double a quote inside, as in "48.1 ""N"""'
        ) from None
    return separator.join(field.replace(separator, " ") for field in fields)


def _numbers(column: pd.Series, key: str, first: int, may_be_empty: bool) -> Array:
    """Return a column as finite numbers; NaN for empty cells if they are allowed."""
    if column.dtype.kind in "iuf":
        values = column.to_numpy(dtype=float)
    elif key == "time_s" and _DATE.match(str(column.iloc[0])):
        values = iso_seconds(column)
    else:
        # As texts, for which a truth is no number.
        values = pd.to_numeric(column.astype(str), errors="coerce").to_numpy(dtype=float)
    bad = ~np.isfinite(values)
    if may_be_empty:
        bad &= ~column.isna().to_numpy()
    if bad.any():
        n = int(np.argmax(bad))
        cell = column.iloc[n]
        stated = "empty" if cell is None or cell != cell else f"'{str(cell)[:40]}'"
        hint = ""
        if re.fullmatch(r"\s*[-+]?\d+[, ]\d+\s*", str(cell)):
            hint = "; write 33.5, not a decimal comma"
        elif n == 0 and unit_named(str(cell)):
            hint = f"; write units in brackets behind the names, as in {key} [{str(cell).strip()}]"
        elif re.search(r"[NSEW]\s*$|\d\s*[°:]", str(cell)) and key[:3] in ("lat", "lon"):
            hint = "; give degrees with a sign, negative in the south and the west"
        elif key == "time_s" and re.match(r"\s*\d+[-:/]", str(cell)):
            hint = "; give seconds, or dates as 2024-05-01T10:00:00Z (ISO 8601)"
        raise TrajectoryError(f"line {first + n}: {key} is {stated} and must be a number{hint}")
    return values


def iso_seconds(texts: Iterable[str]) -> Array:
    """Convert ISO 8601 dates to seconds (N,) since 1970; other texts give NaN.

    A date without a time zone is UTC.
    """
    return np.array([_iso_second(str(text).strip()) for text in texts])


def _iso_second(text: str) -> float:
    try:
        date = datetime.datetime.fromisoformat(text)
    except ValueError:
        return math.nan
    zoned = date if date.tzinfo else date.replace(tzinfo=datetime.UTC)
    return (zoned - _EPOCH) / datetime.timedelta(seconds=1)


def rollover(before: float, after: float) -> str:
    """Return a hint if times decrease because a clock restarted, else "".

    ``before`` and ``after`` are the times of two consecutive rows [s].
    """
    for period, name in _PERIODS:
        if abs(before - period) < _NEAR and 0.0 <= after < _NEAR:
            return f"; the seconds of the {name} restart there: add {period:.0f} from that row on"
    return ""


def status_of(file: str, what: str) -> os.stat_result:
    """Return the ``os.stat`` result of a file; ``what`` describes the file in a message.

    Raises TrajectoryError if the file cannot be accessed, for example if it does not exist.
    """
    try:
        return Path(file).stat()
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else "not a path"
        raise TrajectoryError(f"cannot read the {what} {file}: {reason}") from None
