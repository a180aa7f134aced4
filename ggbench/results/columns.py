"""Columns of a record: the results of one run of one estimator.

Only this module declares the columns. The database tables with their constraints, blank records and
the table of runs are derived from it.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from ..judging import references, run_errors
from ..judging.run_errors import WINDOWS
from ..spec.limits import MOST_RUNS, MOST_SEED

_TYPES = {str: "TEXT", int: "INTEGER", bool: "INTEGER", float: "REAL"}
_COUNT = ">= 0"
_POSITIVE = ">= 0.0"
"""Condition on a number that may be infinite, such as the error of a diverged filter."""
_FINITE = f"BETWEEN 0.0 AND {sys.float_info.max!r}"


@dataclass(frozen=True)
class Column:
    """Declaration of a column of a database table.

    Attributes
    ----------
    name, kind : name of the column, and type of the values.
    check : SQL condition on the values, written after the column's name.
    finished : whether only finished runs have a value. If so, failed runs have NULL.
    defined : whether a value is required. If not, a missing float is NaN in records and NULL in
        SQL.
    tabled : whether the table of runs has the column.
    """

    name: str
    kind: type
    check: str = ""
    finished: bool = False
    defined: bool = True
    tabled: bool = True

    @property
    def blank(self) -> Any:
        """Default value in a record, for runs that fail."""
        if self.kind is float:
            return math.nan
        return None if self.finished else self.kind()

    @property
    def schema(self) -> str:
        """SQL definition of the column, with type and constraints."""
        name, sql_type = self.name, _TYPES[self.kind]
        rule = f"typeof({name}) = '{sql_type.lower()}'"
        if self.check:
            rule += f" AND {name} {self.check}"
        if self.kind is bool:
            rule += f" AND {name} IN (0, 1)"
        if not self.defined:
            rule = f"{name} IS NULL OR {rule}"
        if self.finished:
            rule = f"CASE status WHEN 'ok' THEN {rule} ELSE {name} IS NULL END"
        return f"{name} {sql_type} CONSTRAINT {name} CHECK ({rule})"

    @property
    def selected(self) -> str:
        """SQL expression that selects the column in a query."""
        return f"{self.name} IS 1 AS {self.name}" if self.kind is bool else self.name

    @property
    def dtype(self) -> type | None:
        """Type of the column in a pandas table; None (the default of pandas) for text."""
        if self.kind is str:
            return None
        return float if self.kind is int and self.finished else self.kind


_METRICS = {**run_errors.METRICS, **references.METRICS}
_OF_WINDOWS = [
    Column(f"{window}_{name}", float, _POSITIVE if defined else "", True, defined)
    for window in WINDOWS
    for name, defined in _METRICS.items()
]
WINDOW_COLUMNS = tuple(column.name for column in _OF_WINDOWS)
"""Columns of the metrics of each window: one window after the other."""
COLUMNS = (
    Column("name", str),
    Column("parameters", str),
    Column("causality", str, "IN ('none', 'filter', 'fixed-lag', 'batch')"),
    Column("seed", int, f"BETWEEN 0 AND {MOST_SEED}"),
    Column("run", int, f"BETWEEN 0 AND {MOST_RUNS}"),
    Column("status", str, "IN ('ok', 'failed')"),
    Column("reason", str),
    Column("remark", str),
    Column("diverged", bool, finished=True),
    Column("seconds", float, _FINITE, defined=False),
    Column("cold", bool),
    Column("map_evaluations", int, _COUNT, finished=True),
    Column("peak_memory_mb", float, _FINITE, finished=True),
    Column("final_position_error_m", float, _POSITIVE, finished=True),
    Column("final_ins_error_m", float, _POSITIVE, finished=True),
    Column("bound", str, finished=True),
    Column("required_m", float, _FINITE, finished=True),
    Column("converged_s", float, _FINITE, finished=True, defined=False),
    Column("false_fix", bool, finished=True),
    *_OF_WINDOWS,
    Column("fixes", int, _COUNT, finished=True, defined=False, tabled=False),
    Column("traceback", str, tabled=False),
    Column("output", str, tabled=False),
    Column("info", str, tabled=False),
)
"""Columns of a record. ``fixes`` is the number of attempted fixes of a matcher; ``info`` is
JSON.
"""
NAMES = tuple(column.name for column in COLUMNS)
BLANK: dict[str, Any] = {column.name: column.blank for column in COLUMNS} | {"info": {}}
"""Record of a run without any result."""
TABLED = tuple(column for column in COLUMNS if column.tabled)
FIX_COLUMNS = (
    Column("run", int, f"BETWEEN 0 AND {MOST_RUNS}"),
    Column("number", int, _COUNT, tabled=False),
    Column("time_s", float, _FINITE),
    Column("error_m", float, _POSITIVE),
    Column("nees", float, _POSITIVE),
    Column("statistic", float),
    Column("accepted", bool),
)
"""Columns of the fixes of a run: index in the run, and :data:`.judging.fix_metrics.ROWS`."""


def _definitions(columns: Sequence[Column]) -> str:
    return ",\n    ".join(column.schema for column in columns)


SCHEMA = f"""
CREATE TABLE records (
    key TEXT NOT NULL,
    retry_above REAL,
    {_definitions(COLUMNS)},
    PRIMARY KEY (key, run)
);
CREATE INDEX lost ON records (retry_above) WHERE retry_above IS NOT NULL;
CREATE TABLE fixes (
    key TEXT NOT NULL,
    {_definitions(FIX_COLUMNS)},
    PRIMARY KEY (key, run, number),
    FOREIGN KEY (key, run) REFERENCES records ON DELETE CASCADE
);
CREATE TABLE curves (
    key TEXT NOT NULL,
    run INTEGER NOT NULL,
    series BLOB NOT NULL CHECK (typeof(series) = 'blob' AND length(series) % 16 = 0),
    detail BLOB CHECK (detail IS NULL OR typeof(detail) = 'blob' AND length(detail) % 72 = 0),
    PRIMARY KEY (key, run),
    FOREIGN KEY (key, run) REFERENCES records ON DELETE CASCADE
);
CREATE TABLE shared (key TEXT PRIMARY KEY, arrays BLOB NOT NULL);
"""
"""Tables of the database; replacing a record deletes its fixes and time series."""
