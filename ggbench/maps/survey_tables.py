"""Readers of survey tables with cells as texts: CSV and Geosoft XYZ."""

from __future__ import annotations

import csv
import io
import re
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ..errors import text_of
from ..gravity.gradient_map import MapError
from ..gravity.unit_names import unit_named, without_unit
from .survey_lines import PRIMARY, TIE

LINE, KIND = "line", "kind"
_COMMENT = re.compile(r"\s*(?:#|//|%[^,;\t]*$)")
_NUMBER = re.compile(r"(^|[,;\t])\s*[-+]?\d*\.\d*\s*([,;\t]|$)")  # of a row, not of names
_KINDS = {
    "line": PRIMARY,
    "l": PRIMARY,
    "tie": TIE,
    "t": TIE,
    "base": "base",
    "b": "base",
    "trend": "trend",
    "p": "trend",
    "test": "test",
    "s": "test",
    "special": "test",
    "random": "random",
    "r": "random",
}
"""Kinds of survey lines, by the word or letter at the start of a Geosoft heading."""
_HEADING = re.compile(
    rf"\s*({'|'.join(sorted(_KINDS, key=len, reverse=True))})(?:\s*:\s*|\s+|(?=\d))(\S+)(\s.*)?",
    re.IGNORECASE,
)
_OTHER_HEADING = re.compile(r"\s*([A-Za-z]+)\s+(\S+)\s*")
_RULES = {"=", "-"}  # what a line below the names is made of


@dataclass(frozen=True)
class SurveyTable:
    """Table of the samples of a survey file, with cells as texts.

    Attributes
    ----------
    path : path of the file.
    columns : cells (N,) of each column, by name; an empty cell is a missing value.
    rows : (N,) line number of each sample in the file.
    units : units stated by the file, by column.
    descriptions : descriptions stated by the file, by column.
    voids : values that the file declares as missing, by column.
    cut : whether an incomplete last row was omitted.
    comments : comments of the file.
    """

    path: Path
    columns: Mapping[str, Sequence[str]]
    rows: NDArray[np.int64]
    units: Mapping[str, str] = field(default_factory=dict)
    descriptions: Mapping[str, str] = field(default_factory=dict)
    voids: Mapping[str, float] = field(default_factory=dict)
    cut: bool = False
    comments: str = ""

    def named(self, name: str) -> str:
        """Return the full name of a column; "" if it does not exist.

        The comparison ignores case and a unit in brackets.
        """
        if name in self.columns:
            return name
        for key in (
            lambda c: without_unit(c)[0],
            str.casefold,
            lambda c: without_unit(c)[0].lower(),
        ):
            matching = [column for column in self.columns if key(column) in (name, name.casefold())]
            if len(matching) == 1:
                return matching[0]
        return ""

    def unit(self, name: str) -> str:
        """Return the unit that the file states for a column; empty if it states none."""
        return self.units.get(name) or without_unit(name)[1]

    def error(self, row: int, sentence: str) -> MapError:
        """Return a MapError about the sample ``row``, counted from 0."""
        return MapError(f"{self.path}: line {self.rows[row]}: {sentence}.")


def text_in(path: Path, content: bytes) -> str:
    """Return the text of a survey file.

    Raises MapError if the content is not UTF-8 or has a null byte.
    """
    try:
        text = content.decode("utf-8-sig")
        bad = text.find("\0")
        place, flaw = bad, "a null byte"
    except UnicodeDecodeError as error:
        bad, flaw = error.start, f"the byte 0x{content[error.start]:02x}"
        place, text = bad, content[:bad].decode("latin-1")
    if bad < 0:
        return text
    if content[:2] in (b"\xff\xfe", b"\xfe\xff"):
        raise MapError(
            f"the survey {path} is UTF-16 text, and must be UTF-8: convert it, for example with "
            "'iconv -f utf-16 -t utf-8'."
        )
    raise MapError(
        f"the survey {path}: line {text.count(chr(10), 0, place) + 1} has {flaw}, and must be "
        "UTF-8 text: convert it, for example with 'iconv -f latin1 -t utf-8'."
    )


def read_csv(path: Path, text: str) -> SurveyTable:
    """Return the table of a CSV text.

    Cells are separated by commas, semicolons or tabs. Lines that begin with # or // are comments.
    Lines that begin with % are comments if they contain no separator. A row of units may follow
    the names.

    The first line that is no comment names the columns. If this line contains numbers, the comment
    before it must name the columns (format of ``numpy.savetxt``).

    Raises ValueError or MapError if the text is not a table.
    """
    rows = text.splitlines()
    filled = [n for n, row in enumerate(rows) if row.strip() and not _COMMENT.match(row)]
    if not filled:
        raise ValueError("it has no samples")
    top = filled[0]
    separator = max(",;\t", key=rows[top].count)
    if top and _NUMBER.search(rows[top]):
        above = rows[top - 1].lstrip("# ")
        if len(_cells(above, separator)) == len(_cells(rows[top], separator)):
            rows[top - 1], filled = above, [top - 1, *filled]
    head, *numbers = filled
    names = [name.strip() for name in _cells(rows[head], separator)]
    _require_distinct(path, names)
    units: dict[str, str] = {}
    if numbers and (words := _units_in([c.strip() for c in _cells(rows[numbers[0]], separator)])):
        units = dict(zip(names, words, strict=False))
        numbers = numbers[1:]
    if not numbers:
        raise ValueError("it has no samples below the column names")
    labels = [name or f"(column {n})" for n, name in enumerate(names, 1)]
    frame = _frame(path, [rows[n] for n in numbers], numbers, labels, separator)
    columns = {name: frame[name].tolist() for name in labels}
    comments = "\n".join(row for row in rows[:head] if _COMMENT.match(row))
    return SurveyTable(path, columns, np.array(numbers) + 1, units, comments=comments)


def _units_in(words: Sequence[str]) -> list[str]:
    """Return the units in a row that contains only units; an empty list for other rows.

    A unit may be in brackets. An empty cell or a dash gives "".
    """
    bare = ["" if set(word) <= {"-"} else word.strip("[]() ") for word in words]
    named = [unit_named(word) for word in bare if word]
    return bare if len(named) >= _FEWEST_UNITS and all(named) else []


_FEWEST_UNITS = 2


def _cells(row: str, separator: str) -> list[str]:
    return next(csv.reader([row], delimiter=separator, skipinitialspace=True), [])


def _require_distinct(path: Path, names: Sequence[str]) -> None:
    twice = next((name for name in names if name and names.count(name) > 1), None)
    if twice is not None:
        raise MapError(f"{path} names the column {twice!r} twice.")


def _frame(
    path: Path, rows: Sequence[str], numbers: Sequence[int], names: Sequence[str], separator: str
) -> pd.DataFrame:
    """Return the cells of rows as texts; ``numbers`` are the line numbers of the rows, from 0.

    Raises MapError if a row has more cells than there are columns. An empty cell at the end is not
    counted.
    """
    last = f"(column {len(names) + 1})"
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # on rows that are refused below
            frame = pd.read_csv(
                io.StringIO("\n".join(rows)),
                sep=separator,
                header=None,
                names=[*names, last],
                index_col=False,
                dtype=str,
                keep_default_na=False,
                skipinitialspace=True,
                on_bad_lines="error",
            )
    except ValueError as error:
        match = re.search(r"Expected (\d+) fields in line (\d+), saw (\d+)", str(error))
        if match is None:
            raise
        wide = numbers[int(match[2]) - 1] + 1
        raise _too_wide(path, wide, int(match[3]), names) from None
    if len(frame) != len(rows):
        raise MapError(f"{path}: a quoted field does not end on its line.")
    frame = frame.fillna("")
    surplus = np.flatnonzero(frame.pop(last).str.strip() != "")
    if surplus.size:
        first = int(surplus[0])
        raise _too_wide(path, numbers[first] + 1, len(_cells(rows[first], separator)), names)
    return frame


def _too_wide(path: Path, line: int, count: int, names: Sequence[str]) -> MapError:
    return MapError(
        f"{path}: line {line} has {count} fields, but there are {len(names)} columns: "
        "write 33.5, not a decimal comma, and quote cells that contain the separator."
    )


def read_xyz(path: Path, text: str) -> SurveyTable:
    """Return the table of a Geosoft XYZ text.

    The names of the columns are the last comment with as many words as a row has cells. A comment
    of units may follow it. A heading before each survey line names the line, in any of the forms
    ``Line 1000``, ``L1000``, ``LINE:1000`` and ``Line 1000 2008/07/03``. ``*`` is a missing value.

    Raises ValueError or MapError if the text is not a table.
    """
    comments: list[list[str]] = []
    cells: list[list[str]] = []
    numbers: list[int] = []
    lines: list[str] = []
    kinds: list[str] = []
    name, kind = "", PRIMARY
    for number, row in enumerate(text.splitlines(), 1):
        heading = _heading(row)
        if row.lstrip().startswith("/"):
            comments.append(_words(row.strip().lstrip("/")))
        elif heading is not None:
            kind, name = heading
        elif row.strip():
            cells.append(_words(row))
            numbers.append(number)
            lines.append(name)
            kinds.append(kind)
    if not cells:
        raise ValueError("it has no samples")
    count = len(cells[0])
    named = [words for words in comments if len(words) == count and not _is_rule(words)]
    if not named:
        raise ValueError(
            f"no comment line (/) names its {count} columns; the first row is "
            f"{' '.join(cells[0])[:80]!r}"
        )
    cut = len(cells) > 1 and len(cells[-1]) < count
    if cut:
        for rows in (cells, numbers, lines, kinds):
            rows.pop()
    odd = next((n for n, row in enumerate(cells) if len(row) != count), None)
    if odd is not None:
        raise MapError(
            f"{path}: line {numbers[odd]} has {len(cells[odd])} fields, but there are {count} "
            "columns: write missing values as *."
        )
    units = _units_in(named[-1]) if len(named) > 1 else []
    names = named[-2] if units else named[-1]
    _require_distinct(path, names)
    columns: dict[str, Sequence[str]] = {
        column: ["" if cell == "*" else cell for cell in values]
        for column, values in zip(names, zip(*cells, strict=True), strict=True)
    }
    columns.setdefault(LINE, lines)
    columns.setdefault(KIND, kinds)
    stated = dict(zip(names, units, strict=False))
    text = "\n".join(" ".join(words) for words in comments if words is not names)
    return SurveyTable(path, columns, np.array(numbers), stated, cut=cut, comments=text)


def _heading(row: str) -> tuple[str, str] | None:
    """Return kind and name of the survey line if a row is a heading; None for other rows."""
    words = row.split()
    if match := _HEADING.fullmatch(row):
        # A row of numbers behind a text such as L1000 is a sample, a date or a flight is not.
        if len(words) <= 3 or not all(map(_is_number, words[1:])):
            return _KINDS[match[1].lower()], match[2]
    elif match := _OTHER_HEADING.fullmatch(row):
        return match[1].lower(), match[2]
    return None


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return word == "*"
    return True


def _words(row: str) -> list[str]:
    return [cell.strip() for cell in row.split(",")] if "," in row else row.split()


def _is_rule(words: Sequence[str]) -> bool:
    return all(set(word) <= _RULES for word in words)


def missing_line(table: SurveyTable, column: str) -> None:
    """Raise MapError if a cell of a text column is empty; the message states the line."""
    for row, cell in enumerate(table.columns[column]):
        if not str(cell).strip():
            raise table.error(row, f"{column} is empty; every sample needs a value")


def unreadable(path: Path, ending: str, error: BaseException) -> MapError:
    """Return a MapError that states why a file cannot be read.

    ``ending`` is the suffix of the file without the dot, such as ``csv``.
    """
    return MapError(f"{path} is not a {ending} file: {text_of(error)}.")
