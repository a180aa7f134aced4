"""Files of recorded numbers, CSV or netCDF: a column for each quantity, its unit in the name."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..archives import MOST_ARRAYS
from ..errors import GGBenchError, text_of
from ..files import written_whole
from ..gravity.unit_names import factor_to_key
from ..linked_files import require_own_values
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
    """Numbers of a file, a column for each name.

    Attributes
    ----------
    path : of the file.
    values : (N,) of each column; NaN where one that may be empty is.
    first_line : number of the line of the first row; None of a file that has no lines.
    stated : columns whose unit the file or the user states.
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
        """Return whether the unit of a column is stated, not taken from its key."""
        return name in self.stated

    def stacked(self, names: Sequence[str]) -> np.ndarray:
        """Return columns (N, len(names))."""
        return np.stack([self.values[name] for name in names], axis=-1)

    def require_within(self, limits: Mapping[str, tuple[float, float]]) -> None:
        """Raise FlightError if a number of a column is beyond its lowest or highest."""
        for name, (lowest, highest) in limits.items():
            values = self.values[name]
            off = (values < lowest) | (values > highest)
            if off.any():
                row = int(off.argmax())
                raise self.error(
                    f"{name} is {values[row]:g} and must lie between {lowest:g} and {highest:g}",
                    row,
                )

    def error(self, said: str, row: int | None = None) -> FlightError:
        """Return an error of this file, of one of its rows."""
        where = ""
        if row is not None:
            where = (
                f"record {row + 1}" if self.first_line is None else f"line {self.first_line + row}"
            )
            where = f"{where}: "
        return FlightError(f"{self.path}: {where}{said}")


def read(
    path: Path,
    required: Sequence[str],
    optional: Sequence[str] = (),
    may_be_empty: Iterable[str] = (),
    names: str | Mapping[str, str] | None = None,
) -> Columns:
    """Read columns of a file, ``.nc`` or else CSV; others than those named are passed over.

    A number may be missing in those that ``may_be_empty``. ``names`` is what the file calls its
    columns, a table or a preset; see :func:`.column_names.find`.

    Raises FlightError with a sentence that names the file and the place, what was found and what is
    allowed.
    """
    wanted = ("time_s", *required)
    empty = frozenset(may_be_empty)
    called = _called(path, names, (*wanted, *optional))
    try:
        if path.stat().st_size > _LARGEST:
            raise FlightError(f"{path}: is larger than {_LARGEST / 1e9:g} GB")
        if path.suffix == ".nc":
            return _read_netcdf(path, wanted, optional, empty, called)
        content = path.read_bytes()
    except OSError as error:
        raise FlightError(f"{path}: cannot be read: {error.strerror or error}") from None
    try:
        known = {*wanted, *plain_names(called)}.union(*map(plain_names, PRESETS.values()))
        text = CsvText.of(content, ", ".join(wanted), known)
        places = _places(path, text.names, wanted, optional, called, f"line {text.line}")
        if not text.rows:
            raise FlightError(f"{path}: has no rows below the names of its columns")
        values = text.numbers({key: place.at for key, place in places.items()}, empty)
        stated = frozenset(key for key, place in places.items() if place.stated)
        return Columns(path, _scaled(values, places), text.first, stated)
    except FlightError:
        raise
    except GGBenchError as error:
        raise FlightError(f"{path}: {error}") from None


def _called(path: Path, names: str | Mapping[str, str] | None, keys: Sequence[str]) -> Names:
    """Return what a file calls its columns; FlightError if a key is no column of such a file."""
    try:
        called = names_of(names)
    except GGBenchError as error:
        raise FlightError(f"{path}: {error}") from None
    if not isinstance(names, str) and (other := unused(called, keys)):
        raise FlightError(
            f"{path}: columns.{other[0]} is no column of this file; known: {', '.join(keys)}"
        )
    return called


def _scaled(values: Mapping[str, np.ndarray], places: Mapping[str, Place]) -> dict[str, np.ndarray]:
    """Return columns in the units of their keys."""
    return {
        key: array if places[key].factor == 1.0 else places[key].factor * array
        for key, array in values.items()
    }


def _places(
    path: Path,
    found: Sequence[str],
    required: Sequence[str],
    optional: Sequence[str],
    called: Names,
    where: str,
) -> dict[str, Place]:
    """Return where the columns are, and their units."""
    keys = list(dict.fromkeys((*required, *optional)))
    twice = [name for name in keys if list(found).count(name) > 1]
    if twice:
        raise FlightError(f"{path}: {where} names {twice[0]} twice")
    try:
        places = {
            key: place
            for key in keys
            if (place := find(key, found, called, where, needed=key in required))
        }
    except GGBenchError as error:
        raise FlightError(f"{path}: {error}") from None
    missing = [name for name in required if name not in places]
    if missing:
        shown = ", ".join(name[:30] for name in found[:16])
        preset = preset_of(found)
        hint = (
            f'; these are names of {preset}: say columns = "{preset}", or --preset {preset}'
            if preset
            else ("; say what the file calls them and in which unit (columns)")
        )
        raise FlightError(
            f"{path}: {where} names no column {missing[0]} (found: {shown}); wanted are "
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
    import netCDF4  # not at the top: it loads slowly, and most files are CSV

    require_own_values(path, FlightError, f"the record {path}")
    try:
        file = netCDF4.Dataset(path)
    except (OSError, RuntimeError) as error:
        raise FlightError(f"{path}: is no netCDF file ({text_of(error)})") from None
    with file:
        variables = list(file.variables)
        known = _places(path, variables, required, optional, called, "it")
        size = 8 * sum(int(file.variables[variables[place.at]].size) for place in known.values())
        if size > MOST_ARRAYS:
            raise FlightError(
                f"{path}: holds {size / 1e6:.0f} MB of columns; at most {MOST_ARRAYS / 1e6:g} are "
                "allowed"
            )
        values = {
            key: _variable(path, file.variables[variables[place.at]], key, place, empty)
            for key, place in known.items()
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
    """Return a variable's numbers (N,) in the unit of its key, NaN where they are masked."""
    if variable.ndim != 1 or np.dtype(variable.dtype).kind not in "fiu":
        raise FlightError(f"{path}: {name} must be one row of numbers")
    stated = str(getattr(variable, "units", "")).strip()
    factor = place.factor
    if stated and factor == 1.0 and not stated.lower().startswith("seconds since "):
        own = factor_to_key(stated, name)
        if own is None or (own != 1.0 and place.name == name):
            raise FlightError(
                f"{path}: {name} has units {stated!r}, which is not what its name says"
            )
        factor = own
    values = np.asarray(np.ma.filled(variable[:].astype(float), np.nan), dtype=float)
    bad = ~np.isfinite(values)
    if name in empty:
        bad &= ~np.isnan(values)
    if bad.any():
        raise FlightError(f"{path}: record {int(bad.argmax()) + 1}: {name} is missing or no number")
    return factor * values


def write(path: Path, columns: Mapping[str, np.ndarray], comment: str = "") -> None:
    """Write columns (N,) as CSV, whole or not at all; each number is read back to its last bit.

    NaN becomes an empty field. ``comment`` goes before the names, behind a #.

    Raises FlightError if the file cannot be written.
    """
    rows = zip(*(array.tolist() for array in columns.values()), strict=True)
    lines = [f"# {comment}"] if comment else []
    lines.append(",".join(columns))
    lines += [",".join("" if value != value else repr(value) for value in row) for row in rows]
    write_text(path, "\n".join(lines) + "\n")


def write_text(path: Path, text: str) -> None:
    """Write a file, whole or not at all; its folder is made if need be.

    Raises FlightError if it cannot be written.
    """
    with written_whole(path, FlightError) as temporary:
        temporary.write_text(text, encoding="utf-8", newline="\n")
