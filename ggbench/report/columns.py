"""Registry of all table columns: heading, unit, format and definition.

This module reads ``templates/columns.csv`` for markdown tables, HTML pages and the page of
definitions.
"""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..figures.numbers import limited
from ..judging.consistency import MARKS

TEMPLATES = Path(__file__).parent / "templates"


@dataclass(frozen=True)
class Column:
    """A column of a table.

    Attributes
    ----------
    heading : heading without the unit.
    unit : unit of the values; may be empty.
    form : format of the values: "text", or a key of :data:`_FORMS`.
    definition : definition in one sentence. It is empty if the values are the lower or upper ends
        of intervals.
    """

    heading: str
    unit: str = ""
    form: str = "text"
    definition: str = ""

    @property
    def head(self) -> str:
        """Heading with the unit, except for times, whose cells contain the unit."""
        has_unit = self.unit and self.form != "time"
        return f"{self.heading} [{self.unit}]" if has_unit else self.heading


def _registered() -> dict[str, Column]:
    """Return the columns of ``templates/columns.csv``, and those of the ends of intervals.

    ``interval`` is the stem of the keys of an interval's ends, ``<stem>_lo`` and ``<stem>_hi``.
    """
    columns: dict[str, Column] = {}
    with (TEMPLATES / "columns.csv").open(encoding="utf-8", newline="") as file:
        for row in csv.DictReader(file):
            key, stem = row.pop("key"), row.pop("interval")
            columns[key] = Column(**row)
            for end, name in (("lo", "lower"), ("hi", "upper")) if stem else ():
                heading = f"{row['heading']}, {name} end"
                columns[f"{stem}_{end}"] = Column(heading, row["unit"], row["form"])
    return columns


COLUMNS = _registered()
"""All columns of the tables, by their keys."""
DEFINED = (
    "rms_m",
    "median_m",
    "lost",
    "bound_m",
    "efficiency",
    "success",
    "required_m",
    "false_fixes",
    "nees",
    "trimmed_nees",
    "coverage",
    "nis",
    "noise_fit",
    "consistency",
    "recommended",
    "error_ratio",
    "verdict",
    "correlation_m",
    "width",
)
"""Columns on the page of definitions."""

SYMBOLS = MARKS
"""Symbols of estimators that are not consistent."""
NONE = "–"
"""Text of a cell without a value."""


def column(key: str) -> Column:
    """Return the column for a key.

    A key that is not registered is the name of a counter. Its column has this name as heading.
    """
    return COLUMNS.get(key) or Column(key.replace("_", " "), form="number")


def significant(value: float, digits: int) -> str:
    """Return a number as text with ``digits`` significant digits.

    An exponent is used for magnitudes below 1e-4 or from 1e6 on. NaN is a dash, infinity is ∞.
    """
    if value == 0.0:
        return "0"
    if not math.isfinite(value):
        return NONE if math.isnan(value) else f"{'-' if value < 0.0 else ''}∞"
    rounded = float(f"{value:.{digits - 1}e}")
    exponent = math.floor(math.log10(abs(rounded)))
    if not -4 <= exponent < 6:
        return f"{value:.{digits - 1}e}"
    return f"{rounded:.{max(0, digits - 1 - exponent)}f}"


def metres(value: float) -> str:
    """Return an error [m] as text with three significant digits.

    Values beyond :data:`.numbers.LARGEST` are ``>1e7``.
    """
    return _limited(value, 3)


def ratio(value: float) -> str:
    """Return a ratio as text with two significant digits.

    Values beyond :data:`.numbers.LARGEST` are ``>1e7``.
    """
    return _limited(value, 2)


def efficiency(value: float) -> str:
    """Return a ratio to the oracle as text with two decimals.

    From a value of 10 on, the text is that of :func:`ratio`.
    """
    return f"{value:.2f}" if abs(value) < 9.995 else ratio(value)


def _limited(value: float, digits: int) -> str:
    return limited(value, significant(value, digits))


def share(value: float) -> str:
    """Return a share as text in per cent with two significant digits.

    Only a share of exactly 1 becomes 100%.
    """
    text = significant(100.0 * value, 2)
    if not math.isfinite(value):
        return text
    return ">99%" if text == "100" and value < 1.0 else f"{text}%"


def duration(value: float) -> str:
    """Return the computing time of a run [s] as text with unit and one significant digit."""
    if value >= 1.0:
        return f"{significant(value, 1)} s"
    return f"{significant(1e3 * value, 1)} ms"


_FORMS = {
    "count": lambda value: f"{value:.0f}",
    "number": lambda value: significant(value, 3),
    "metres": metres,
    "ratio": ratio,
    "efficiency": efficiency,
    "share": share,
    "time": duration,
    "p": lambda value: "< 0.001" if value < 1e-3 else significant(value, 2),
}


def marked(text: str, consistency: str) -> str:
    """Append the symbol of an inconsistent estimator (†, ‡) to a text."""
    return f"{text} {SYMBOLS.get(consistency, '')}".rstrip()


def cell(key: str, value: Any) -> str:
    """Return a value as text for a table.

    Parameters
    ----------
    key : key of the column.
    value : number, text or truth value; NaN and None become a dash.
    """
    if isinstance(value, str):
        return value
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return NONE
    if isinstance(value, bool) or type(value).__name__ == "bool":
        return "yes" if value else "no"
    form = column(key).form
    if math.isinf(value):
        return "∞"
    return str(value) if form == "text" else _FORMS[form](float(value))
