"""Recorded numbers in columns: reader of CSV and netCDF files, writer of CSV files.

Column names contain units.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import GGBenchError
from ..files.archives import MOST_ARRAYS
from ..files.netcdf import netcdf_file
from ..files.writing import written_whole
from ..gravity.coordinate_names import contradiction_of_axis, zero_level
from ..gravity.unit_names import factor_to_key
from ..spec.flight import FlightError
from ..trajectory.column_names import (
    PRESETS,
    Names,
    Place,
    find,
    names_of,
    plain_names,
    preset_of,
    unused,
)
from ..trajectory.csv_text import CsvText

_LARGEST = 4_000_000_000
"""Largest file [bytes]."""


@dataclass(frozen=True)
class Columns:
    """Columns of numbers from a file.

    Attributes
    ----------
    path : path of the file.
    values : numbers (N,) by name of the column; NaN for empty cells.
    first_line : line number of the first row; None for netCDF.
    stated : names of the columns whose unit the file or the user states.
    """

    path: Path
    values: Mapping[str, np.ndarray]
    first_line: int | None
    stated: frozenset[str] = frozenset()

    def __getitem__(self, name: str) -> np.ndarray:
        return self.values[name]

    def __contains__(self, name: str) -> bool:
        return name in self.values

    @property
    def rows(self) -> int:
        """Number of rows N."""
        return len(next(iter(self.values.values())))

    def states_unit(self, name: str) -> bool:
        """Return whether the file or the user states the unit of a column.

        Otherwise the unit is the unit in the standard name of the column.
        """
        return name in self.stated

    def stacked(self, names: Sequence[str]) -> np.ndarray:
        """Return several columns as an array (N, len(names))."""
        return np.stack([self.values[name] for name in names], axis=-1)

    def require_within(self, limits: Mapping[str, tuple[float, float]]) -> None:
        """Raise FlightError if a number lies outside the limits (lowest, highest) of its column."""
        for name, (lowest, highest) in limits.items():
            values = self.values[name]
            off = (values < lowest) | (values > highest)
            if off.any():
                row = int(off.argmax())
                raise self.error(
                    f"{name} is {values[row]:g} and must lie between {lowest:g} and {highest:g}",
                    row,
                )

    def error(self, sentence: str, row: int | None = None) -> FlightError:
        """Return an error whose message names this file and optionally a row."""
        where = ""
        if row is not None:
            where = (
                f"record {row + 1}" if self.first_line is None else f"line {self.first_line + row}"
            )
            where = f"{where}: "
        return FlightError(f"{self.path}: {where}{sentence}")


def read(
    path: Path,
    required: Sequence[str],
    optional: Sequence[str] = (),
    may_be_empty: Iterable[str] = (),
    names: str | Mapping[str, str] | None = None,
) -> Columns:
    """Read required and optional columns of a CSV or netCDF (``.nc``) file.

    All other columns are ignored. Only the columns in ``may_be_empty`` may have missing numbers.
    ``names`` maps standard column names to those of the file, or is the name of a preset; see
    :func:`.column_names.find`.

    Raises FlightError if the file is invalid; the message states the file, the place, the value and
    the allowed values.
    """
    needed_columns = ("time_s", *required)
    empty = frozenset(may_be_empty)
    called = _called(path, names, (*needed_columns, *optional))
    try:
        if path.stat().st_size > _LARGEST:
            raise FlightError(f"{path}: is larger than {_LARGEST / 1e9:g} GB")
        if path.suffix == ".nc":
            return _read_netcdf(path, needed_columns, optional, empty, called)
        content = path.read_bytes()
    except OSError as error:
        raise FlightError(f"{path}: cannot be read: {error.strerror or error}") from None
    try:
        known_names = {*needed_columns, *plain_names(called)}.union(
            *map(plain_names, PRESETS.values())
        )
        text = CsvText.of(content, ", ".join(needed_columns), known_names)
        places = _places(path, text.names, needed_columns, optional, called, f"line {text.line}")
        if not text.rows:
            raise FlightError(f"{path}: has no rows below the column names")
        values = text.numbers({key: place.at for key, place in places.items()}, empty)
        _require_named(path, text.names, values, places)
        stated = frozenset(key for key, place in places.items() if place.stated)
        return Columns(path, _scaled(values, places), text.first, stated)
    except FlightError:
        raise
    except GGBenchError as error:
        raise FlightError(f"{path}: {error}") from None


def _called(path: Path, names: str | Mapping[str, str] | None, keys: Sequence[str]) -> Names:
    """Return the names of the columns in a file, by key; raise FlightError for an unknown key."""
    try:
        called = names_of(names)
    except GGBenchError as error:
        raise FlightError(f"{path}: {error}") from None
    if not isinstance(names, str) and (other := unused(called, keys)):
        raise FlightError(
            f"{path}: columns.{other[0]} is not a column of this table; known: {', '.join(keys)}"
        )
    return called


def _require_named(
    path: Path,
    header: Sequence[str],
    values: Mapping[str, np.ndarray],
    places: Mapping[str, Place],
) -> None:
    """Raise FlightError if the name of a column contradicts its key."""
    for key, place in places.items():
        name = header[place.at]
        reason = contradiction_of_axis(key, name, values[key])
        if key == "height_m" and zero_level(name) == "sea level":
            reason = "heights above the ellipsoid are needed: add the height of the geoid"
        if reason:
            raise FlightError(f"{path}: the column '{name}' is read as {key}: {reason}")


def _scaled(values: Mapping[str, np.ndarray], places: Mapping[str, Place]) -> dict[str, np.ndarray]:
    """Return columns in the units of their keys."""
    return {
        key: array if places[key].factor == 1.0 else places[key].factor * array
        for key, array in values.items()
    }


def _places(
    path: Path,
    header: Sequence[str],
    required: Sequence[str],
    optional: Sequence[str],
    called: Names,
    where: str,
) -> dict[str, Place]:
    """Return index, name and unit factor of the columns, by key.

    Raises FlightError if a required column is missing or duplicate.
    """
    keys = list(dict.fromkeys((*required, *optional)))
    twice = [name for name in keys if list(header).count(name) > 1]
    if twice:
        raise FlightError(f"{path}: {where} names {twice[0]} twice")
    try:
        places = {
            key: place
            for key in keys
            if (place := find(key, header, called, where, needed=key in required))
        }
    except GGBenchError as error:
        raise FlightError(f"{path}: {error}") from None
    missing = [name for name in required if name not in places]
    if missing:
        header_text = ", ".join(name[:30] for name in header[:16])
        preset = preset_of(header)
        hint = (
            f'; these are names of {preset}: give columns = "{preset}", or --preset {preset}'
            if preset
            else ("; give the names and units of the file in columns")
        )
        raise FlightError(
            f"{path}: {where} names no column {missing[0]} (found: {header_text}); needed are "
            f"{', '.join(required)}{hint}"
        )
    return places


def _read_netcdf(
    path: Path,
    required: Sequence[str],
    optional: Sequence[str],
    empty: frozenset[str],
    called: Names,
) -> Columns:
    with netcdf_file(path, FlightError, f"the record {path}") as file:
        variables = list(file.variables)
        places = _places(path, variables, required, optional, called, "it")
        size = 8 * sum(int(file.variables[variables[place.at]].size) for place in places.values())
        if size > MOST_ARRAYS:
            raise FlightError(
                f"{path}: holds {size / 1e6:.0f} MB of columns; at most {MOST_ARRAYS / 1e6:g} are "
                "allowed"
            )
        values = {
            key: _variable(path, file.variables[variables[place.at]], key, place, empty)
            for key, place in places.items()
        }
    lengths = {len(array) for array in values.values()}
    if len(lengths) > 1:
        raise FlightError(f"{path}: its variables are of different lengths, {sorted(lengths)}")
    if lengths == {0}:
        raise FlightError(f"{path}: has no rows")
    return Columns(path, values, None)


def _variable(
    path: Path, variable: Any, name: str, place: Place, empty: frozenset[str]
) -> np.ndarray:
    """Return the numbers (N,) of a variable in the unit of its key; NaN where masked."""
    if variable.ndim != 1 or np.dtype(variable.dtype).kind not in "fiu":
        raise FlightError(f"{path}: {name} must be one row of numbers")
    stated = str(getattr(variable, "units", "")).strip()
    factor = place.factor
    if stated and factor == 1.0 and not stated.lower().startswith("seconds since "):
        own = factor_to_key(stated, name)
        if own is None or (own != 1.0 and place.name == name):
            raise FlightError(f"{path}: {name} has units {stated!r}, which contradict its name")
        factor = own
    values = np.asarray(np.ma.filled(variable[:].astype(float), np.nan), dtype=float)
    bad = ~np.isfinite(values)
    if name in empty:
        bad &= ~np.isnan(values)
    if bad.any():
        raise FlightError(
            f"{path}: record {int(bad.argmax()) + 1}: {name} is missing or not a number"
        )
    return factor * values


def write(path: Path, columns: Mapping[str, np.ndarray], comment: str = "") -> None:
    """Write columns (N,) to a CSV file, atomically and without loss of digits.

    NaN becomes an empty cell. ``comment`` is written after a # in a line above the names.

    Raises FlightError if the file cannot be written.
    """
    rows = zip(*(array.tolist() for array in columns.values()), strict=True)
    lines = [f"# {comment}"] if comment else []
    lines.append(",".join(columns))
    lines += [",".join("" if value != value else repr(value) for value in row) for row in rows]
    write_text(path, "\n".join(lines) + "\n")


def write_text(path: Path, text: str) -> None:
    """Write a text file atomically; a missing folder is created.

    Raises FlightError if the file cannot be written.
    """
    with written_whole(path, FlightError) as temporary:
        temporary.write_text(text, encoding="utf-8", newline="\n")
