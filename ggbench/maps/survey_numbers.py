"""Conversion of columns of survey files to numbers: units, missing values and limits."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ..gravity.gradient_map import MapError
from ..gravity.unit_names import examples_for, factor_to_key, unit_at_end, unit_in_brackets
from .survey_lines import ANOMALY, COMPONENTS, DISTURBANCE, Quantity
from .survey_tables import SurveyTable

Array = NDArray[np.float64]

PROJECTED = ("easting_m", "northing_m")
"""Columns of projected coordinates, in place of longitude and latitude."""
_LIMITS = {
    "time_s": (-1e18, 1e18),
    "latitude_deg": (-90.0, 90.0),
    "longitude_deg": (-360.0, 360.0),
    "height_m": (-12_000.0, 100_000.0),
    **dict.fromkeys(PROJECTED, (-4e7, 4e7)),
    **dict.fromkeys(COMPONENTS, (-1e5, 1e5)),
    **dict.fromkeys((DISTURBANCE, ANOMALY), (-2000.0, 2000.0)),
}
"""Limits of values, by key, in its unit."""
_HUGE = 1e20  # no value is as large: 1e32 (Geosoft), 1.7e38 (Surfer)
_ALWAYS_MARKS = re.compile(r"-(?:9{4,}(?:\.[09]*)?|3276[78](?:\.0*)?)")
_MAYBE_MARKS = re.compile(r"[-+]?9{2,}(?:\.[09]*|\.25)?")
_ISOLATED = 3.0
"""Smallest distance of a code of nines from all other values, in units of their range."""
_CLOCK = re.compile(r"(\d{1,2}):(\d{2}):(\d{2}(?:\.\d*)?)")
_LEAST = 1e-3
"""RMS below which the unit of values is doubtful [E or mGal]."""


class Column(NamedTuple):
    """Used column of a table: its name, and its unit ("" if not stated)."""

    name: str
    unit: str


class Numbers(NamedTuple):
    """Numbers of a column, and remarks.

    Missing values are NaN. The unit is that of the argument ``key`` of :func:`read_numbers`.
    """

    values: Array
    remarks: tuple[str, ...]


def read_numbers(table: SurveyTable, key: str, column: Column, voids: Sequence[float]) -> Numbers:
    """Return the numbers of a column, converted to the unit of ``key``.

    The key is the standard name of the quantity, such as ``height_m``, ``xx`` or ``disturbance``.

    Raises MapError if a cell is not a number (the message states the line of the file), or if the
    unit of the column is unknown or of another quantity.
    """
    cells = [cell.strip() for cell in table.columns[column.name]]
    if key == "time_s" and any(_CLOCK.fullmatch(cell) for cell in cells[:1]):
        seconds = np.array([_seconds(cell) for cell in cells])
        _require_numbers(table, column, cells, seconds, "a time, hh:mm:ss")
        return Numbers(seconds, ())
    written = _written(cells)
    allowed = "a number" + (", seconds or hh:mm:ss" if key == "time_s" else "")
    _require_numbers(table, column, cells, written, allowed)
    factor, of_unit = _factor(table, key, column)
    for mark in (*voids, *([table.voids[column.name]] if column.name in table.voids else ())):
        written[np.isclose(written, mark, rtol=1e-6, atol=0.0)] = np.nan
    marks = _undeclared(cells, written, factor, _LIMITS[key])
    of_marks = ""
    if marks.any():
        examples = ", ".join(sorted({cells[n] for n in np.flatnonzero(marks)})[:3])
        of_marks = f"undeclared values {examples} are treated as missing ({marks.sum()} times)"
        written[marks] = np.nan
    return Numbers(factor * written, tuple(filter(None, (of_unit, of_marks))))


def _require_numbers(
    table: SurveyTable, column: Column, cells: Sequence[str], values: Array, allowed: str
) -> None:
    """Raise MapError if a cell contains neither a number nor a code for a missing value."""
    bad = np.isnan(values) & np.array(
        [cell.strip("*").casefold() not in ("", "nan") for cell in cells]
    )
    if not bad.any():
        return
    row = int(bad.argmax())
    cell = cells[row][:40]
    hint = "leave missing values empty"
    if re.fullmatch(r"[-+]?\d+,\d+", cell):
        hint = "write 33.5, not a decimal comma"
    elif re.search(r"\d\W*[NSEW]$|\d\s*[°:]", cell) and "hh" not in allowed:
        hint = "write degrees with a sign, negative in the south and the west"
    raise table.error(row, f"{column.name} is {cell!r} and must be {allowed}; {hint}")


def written_numbers(table: SurveyTable, columns: Sequence[str]) -> Array:
    """Return the numbers (N, c) in c columns of text, in the file's units; NaN for other text."""
    texts = ([cell.strip() for cell in table.columns[name]] for name in columns)
    return np.column_stack([_written(cells) for cells in texts])


def _written(cells: Sequence[str]) -> Array:
    return pd.to_numeric(pd.Series(cells), errors="coerce").to_numpy(dtype=float).copy()


def _seconds(cell: str) -> float:
    """Return the seconds of day of a time ``hh:mm:ss``; NaN for other text."""
    match = _CLOCK.fullmatch(cell)
    return 3600.0 * int(match[1]) + 60.0 * int(match[2]) + float(match[3]) if match else np.nan


def _factor(table: SurveyTable, key: str, column: Column) -> tuple[float, str]:
    """Return the conversion factor from a column's unit to the unit of ``key``, and a remark.

    Raises MapError if the unit is unknown, or is a unit of another quantity.
    """
    end = {DISTURBANCE: "_mgal", ANOMALY: "_mgal"}.get(key, "_eotvos" if key in COMPONENTS else "")
    named = key + end
    described = table.descriptions.get(column.name, "")
    unit = (
        column.unit
        or unit_at_end(column.name, named)
        or unit_in_brackets(described)
        or unit_at_end(f"_{described}", named)
    )
    if not unit:
        return 1.0, "no unit given, mGal assumed" if end == "_mgal" else ""
    factor = factor_to_key(unit, named)
    if factor is None:
        raise MapError(
            f"{table.path}: the column {column.name} is in {unit!r}; units of {key} are "
            f"{examples_for(named)}: state the right unit, as in --column '{key}={column.name} "
            "[UNIT]'."
        )
    return factor, "" if factor == 1.0 else f"converted from {unit}"


def _undeclared(
    cells: Sequence[str], written: Array, factor: float, limits: tuple[float, float]
) -> NDArray[np.bool_]:
    """Return the mask of values that are codes for missing values, but not declared by the file.

    Such codes are magnitudes of at least 1e20, and negative numbers of at least four nines, as well
    as −32767 and −32768. Other numbers of nines are codes if they lie beyond the limits or far from
    all other values.
    """
    huge = np.abs(written) >= _HUGE
    always = np.array([_ALWAYS_MARKS.fullmatch(cell) is not None for cell in cells])
    maybe = np.array([_MAYBE_MARKS.fullmatch(cell) is not None for cell in cells]) & ~always
    marks = huge | (always & np.isfinite(written))
    others = written[np.isfinite(written) & ~marks & ~maybe]
    if maybe.any() and others.size:
        low, high = others.min(), others.max()
        apart = np.maximum(low - written, written - high)
        beyond = (factor * written < limits[0]) | (factor * written > limits[1])
        marks |= maybe & (beyond | ((apart > _ISOLATED * (high - low)) & (high > low)))
    return np.asarray(marks)


def require_limits(
    table: SurveyTable, values: Mapping[str, Array], rows: NDArray[np.int64]
) -> None:
    """Raise MapError if a value is outside the limits of its key.

    ``values`` contains the numbers (N,) by key, such as ``height_m`` or ``xx``. ``rows`` (N,)
    are the indices of the samples in the table, for the message.
    """
    for key, column in values.items():
        low, high = _LIMITS[key]
        off = (column < low) | (column > high)
        if not off.any():
            continue
        n = int(off.argmax())
        hint = (
            "it must be in degrees of WGS84; for metres in a projection give --crs"
            if key in ("latitude_deg", "longitude_deg")
            else (
                f"it must lie between {low:g} and {high:g}: check the unit, the quantity, and "
                "the void value (--void VALUE)"
            )
        )
        raise table.error(int(rows[n]), f"{key} is {column[n]:g}; {hint}")


def require_size(path: Path, values: Mapping[Column, Array], quantity: Quantity) -> None:
    """Raise MapError if values (N,) without a stated unit are too small for the assumed unit.

    This detects gradients in s⁻² and gravity in m/s².
    """
    unit, other = ("E", "s^-2") if quantity == "gradient" else ("mGal", "m/s2")
    unstated = [column.name for column in values if not column.unit]
    rms = max(
        (float(np.sqrt(np.mean(readings**2))) for readings in values.values() if readings.size),
        default=1.0,
    )
    if unstated and 0.0 < rms < _LEAST:
        raise MapError(
            f"{path}: the RMS of {', '.join(unstated)} is {rms:.2g} {unit}, smaller than the "
            f"noise of any instrument: state the unit with --column 'KEY={unstated[0]} [{other}]' "
            f"or --column 'KEY={unstated[0]} [{unit}]'."
        )
