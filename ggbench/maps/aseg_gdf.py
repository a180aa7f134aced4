"""Reader of ASEG-GDF2 tables: a ``.dat`` file of rows and a ``.dfn`` file of definitions.

The standard is revision 4 of ASEG-GDF2 for point located data (Australian Society of Exploration
Geophysicists, 2003). Both layouts in use are read: fields with the defined widths, and fields
separated by blanks, tabs or commas.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..gravity.gradient_map import MapError
from ..gravity.unit_names import unit_named
from .survey_tables import SurveyTable, text_in

_STATEMENT = re.compile(r"DEFN\s*\d*\s*ST\s*=\s*\w+\s*,\s*RT\s*=\s*(\w*)\s*;(.*)", re.IGNORECASE)
_FORMAT = re.compile(r"\s*(\d*)\s*([AIFEDG])(\d+)(?:\.(\d+))?\s*", re.IGNORECASE)
_NULL = re.compile(r"NULL\s*=\s*([-+]?\d+\.?\d*(?:[ED][-+]?\d+)?)", re.IGNORECASE)
_UNIT = re.compile(r"UNITS?\s*[=:]\s*([^,:;]*)", re.IGNORECASE)
_MOST_COLUMNS, _WIDEST = 10_000, 10_000  # of one field
_DATA = ("", "DATA")  # types of the records that hold samples
_IDENTIFIER = "RT"  # field of a record's type, in front of the others where rows have one
_OTHER_RECORDS = ("COMM", "PROJ")


@dataclass(frozen=True)
class Field:
    """Field of a record: ``count`` columns of ``width`` characters each.

    Attributes
    ----------
    name, count, width : name, number of columns, and characters per column.
    number : whether the columns are numeric.
    description : rest of the field's definition, such as unit and comment.
    """

    name: str
    count: int
    width: int
    number: bool
    description: str

    @property
    def labels(self) -> list[str]:
        """Names of the columns of the field."""
        if self.count == 1:
            return [self.name]
        return [f"{self.name}[{number}]" for number in range(self.count)]


def read_gdf2(path: Path, text: str) -> SurveyTable:
    """Return the table of a ``.dat`` file with the content ``text``.

    The ``.dfn`` file must be in the same folder.

    Raises MapError if the definitions are missing, or if rows differ from the definitions.
    """
    fields, other_definitions = _fields(path, text)
    columns = [(label, field) for field in fields for label in field.labels]
    labels = _distinct([label for label, _ in columns])
    numeric = np.array([field.number for _, field in columns])
    rows, numbers = _rows(text)
    cut = len(rows) > 1 and len(rows[-1].split()) < min(len(rows[0].split()), len(columns))
    if cut:
        rows, numbers = rows[:-1], numbers[:-1]
    cells = _cells(path, rows, numbers, [field.width for _, field in columns], numeric)
    described = {
        label: field.description for label, (_, field) in zip(labels, columns, strict=True)
    }
    units = {label: _unit(text) for label, text in described.items()}
    voids = {
        label: float(m[1].upper().replace("D", "E"))
        for label, text in described.items()
        if (m := _NULL.search(text))
    }
    return SurveyTable(
        path=path,
        columns={
            label: [cell.replace("D", "E").replace("d", "e") for cell in column]
            if field.number
            else column
            for label, (_, field), column in zip(
                labels, columns, map(list, zip(*cells, strict=True)), strict=True
            )
        },
        rows=np.array(numbers),
        units=units,
        descriptions={label: _free_text(text) for label, text in described.items()},
        voids=voids,
        cut=cut,
        comments="\n".join(row for row in text.splitlines() if row.startswith(_OTHER_RECORDS))
        + other_definitions,
    )


def _unit(text: str) -> str:
    """Return the unit in a field's description; "" if there is none.

    The unit follows the word UNIT, or is a whole part between colons and commas.
    """
    if match := _UNIT.search(text):
        return match[1].strip(" \"'")
    parts = (part.strip() for part in re.split(r"[:,]", text))
    return next((part for part in parts if len(part) > 1 and unit_named(part)), "")


def _free_text(text: str) -> str:
    """Return a field's description without its unit and its code for missing values."""
    parts = re.split(r"[:,]", _NULL.sub("", _UNIT.sub("", text)))
    return " ".join(filter(None, (part.strip().removeprefix("NAME=") for part in parts)))


def _fields(path: Path, text: str) -> tuple[list[Field], str]:
    """Return the fields of the data records, and the text of all other definitions."""
    stem = path.with_suffix("") if path.suffix.lower() == ".gz" else path
    candidates = [stem.with_suffix(ending) for ending in (".dfn", ".DFN", ".Dfn")]
    definition_file = next((file for file in candidates if file.exists()), None)
    if definition_file is not None:
        text = text_in(definition_file, definition_file.read_bytes())
    fields: list[Field] = []
    others = ""
    for row in text.splitlines():
        statement = _STATEMENT.match(row.strip())
        if statement is None or statement[1].upper() not in _DATA:
            others += f"\n{row}"
            continue
        for definition in statement[2].split(";"):
            name, _, rest = (part.strip() for part in definition.partition(":"))
            if not rest or name.upper() in (_IDENTIFIER, "COMMENTS"):
                continue  # END DEFN, or the type of the record
            shape = _FORMAT.match(rest)
            if shape is not None and not (
                int(shape[1] or 1) <= _MOST_COLUMNS and int(shape[3]) <= _WIDEST
            ):
                raise MapError(
                    f"{path}: field {name} has the format {rest[:40]!r}; at most {_MOST_COLUMNS} "
                    f"columns of {_WIDEST} characters are allowed."
                )
            if shape is None:
                raise MapError(f"{path}: field {name} has the unknown format {rest[:40]!r}.")
            fields.append(
                Field(
                    name=name,
                    count=int(shape[1] or 1),
                    width=int(shape[3]),
                    number=shape[2].upper() != "A",
                    description=rest[shape.end() :].strip(" :,"),
                )
            )
    if not fields:
        if definition_file is not None:
            raise MapError(
                f"{definition_file} defines no field; a definition reads, for example, DEFN 1 "
                "ST=RECD,RT=;LINE:I8."
            )
        raise MapError(f"{path} needs its definition file {candidates[0].name} in the same folder.")
    return fields, others


def _distinct(labels: Sequence[str]) -> list[str]:
    """Return labels with a number appended to each repeated label."""
    return [
        label if label not in labels[:n] else f"{label}__{labels[: n + 1].count(label)}"
        for n, label in enumerate(labels)
    ]


def _rows(text: str) -> tuple[list[str], list[int]]:
    """Return the data rows without their record type, and their line numbers in the file."""
    rows, numbers = [], []
    for number, row in enumerate(text.splitlines(), 1):
        if row.strip(" \x1a") and not row.startswith((*_OTHER_RECORDS, "DEFN")):
            rows.append(row[len("DATA") :] if row.startswith("DATA") else row)
            numbers.append(number)
    if not rows:
        raise ValueError("it has no samples")
    return rows, numbers


def _cells(
    path: Path,
    rows: Sequence[str],
    numbers: Sequence[int],
    widths: Sequence[int],
    numeric: np.ndarray,
) -> list[list[str]]:
    """Return the cells of the rows, split at fixed widths or at separators.

    Fixed widths are rejected if a numeric cell contains no number. They are also rejected if a word
    extends across two fields, and every row has as many words as there are fields.

    Raises MapError if neither way of splitting fits.
    """
    ends = np.cumsum(widths)
    starts = [0, *ends[:-1].tolist()]
    by_width = [
        [row[a:b].strip() for a, b in zip(starts, ends.tolist(), strict=True)] for row in rows
    ]
    separator = next((mark for mark in "\t,;" if mark in rows[0]), None)
    by_words = [[cell.strip() for cell in row.split(separator)] for row in rows]
    fits_words = all(len(row) == len(widths) for row in by_words) and (
        _first_wrong(by_words, numeric) is None
    )
    wrong = _first_wrong(by_width, numeric)
    across = any(
        row[end - 1 : end].strip() and row[end : end + 1].strip()
        for row in rows
        for end in starts[1:]
    )
    if separator is None and wrong is None and not (fits_words and across):
        return by_width
    if fits_words:
        return by_words
    words = {len(row) for row in by_words}
    place = ""
    if wrong is not None:
        row, column = wrong
        place = (
            f"; split at fixed widths, line {numbers[row]} has {by_width[row][column][:40]!r} "
            "where a number is needed"
        )
    raise MapError(
        f"{path}: the rows do not match the definitions, which have {len(widths)} columns with a "
        f"total width of {int(ends[-1])} characters. Split at separators, the rows have "
        f"{min(words)} to {max(words)} values{place}."
    )


def _first_wrong(cells: Sequence[Sequence[str]], numeric: np.ndarray) -> tuple[int, int] | None:
    """Return row and column of the first numeric cell without a number; None if all are valid."""
    columns = np.flatnonzero(numeric).tolist()
    for n, row in enumerate(cells):
        for column in columns:
            if row[column].strip("*") and not _is_number(row[column]):
                return n, column
    return None


def _is_number(cell: str) -> bool:
    try:
        float(cell.upper().replace("D", "E"))
    except ValueError:
        return False
    return True
