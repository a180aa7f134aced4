"""Files of recorded numbers, CSV or netCDF: a column for each quantity, its unit in the name."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import GGBenchError, text_of
from ..files import MOST_ARRAYS, written_whole
from ..spec.flight import FlightError
from ..trajectory.csv_text import CsvText

_LARGEST = 4_000_000_000
"""Largest file [bytes]."""
_UNITS = {
    "_deg": {"deg", "degree", "degrees", "degrees_north", "degrees_east", "°"},
    "_m": {"m", "metre", "metres", "meter", "meters"},
    "_mps": {"m/s", "m s-1", "m s**-1", "m s^-1", "mps"},
    "_mps2": {"m/s2", "m/s^2", "m s-2", "m s**-2"},
    "_rad": {"rad", "radian", "radians"},
    "_radps": {"rad/s", "rad s-1", "radian s-1", "radians/s"},
    "_s": {"s", "second", "seconds"},
    "_eotvos": {"e", "eotvos", "eötvös", "1e-9 s-2"},
    "_mgal": {"mgal", "1e-5 m s-2"},
}
"""What the ``units`` of a netCDF variable may say, by the end of its name."""


@dataclass(frozen=True)
class Columns:
    """Numbers of a file, a column for each name.

    Attributes
    ----------
    path : of the file.
    values : (N,) of each column; NaN where one that may be empty is.
    first_line : number of the line of the first row; None of a file that has no lines.
    """

    path: Path
    values: Mapping[str, np.ndarray]
    first_line: int | None

    def __getitem__(self, name: str) -> np.ndarray:
        return self.values[name]

    def __contains__(self, name: str) -> bool:
        return name in self.values

    @property
    def rows(self) -> int:
        """Number of rows N."""
        return len(next(iter(self.values.values())))

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
) -> Columns:
    """Read columns of a file, ``.nc`` or else CSV; others than those named are passed over.

    A number may be missing in those that ``may_be_empty``.

    Raises FlightError with a sentence that names the file and the place, what was found and what is
    allowed.
    """
    names = ("time_s", *required)
    empty = frozenset(may_be_empty)
    try:
        if path.stat().st_size > _LARGEST:
            raise FlightError(f"{path}: is larger than {_LARGEST / 1e9:g} GB")
        if path.suffix == ".nc":
            return _read_netcdf(path, names, optional, empty)
        content = path.read_bytes()
    except OSError as error:
        raise FlightError(f"{path}: cannot be read: {error.strerror or error}") from None
    try:
        text = CsvText.of(content, ", ".join(names), names)
        known = _places(path, text.names, names, optional, f"line {text.line}")
        if not text.rows:
            raise FlightError(f"{path}: has no rows below the names of its columns")
        return Columns(path, text.numbers(known, empty), text.first)
    except FlightError:
        raise
    except GGBenchError as error:
        raise FlightError(f"{path}: {error}") from None


def _places(
    path: Path, found: Sequence[str], required: Sequence[str], optional: Sequence[str], where: str
) -> dict[str, int]:
    """Return where the columns are."""
    twice = [name for name in (*required, *optional) if list(found).count(name) > 1]
    if twice:
        raise FlightError(f"{path}: {where} names {twice[0]} twice")
    missing = [name for name in required if name not in found]
    if missing:
        shown = ", ".join(name[:30] for name in found[:16])
        raise FlightError(
            f"{path}: {where} names no column {missing[0]} (found: {shown}); wanted are "
            f"{', '.join(required)}, and no other units are read"
        )
    return {name: found.index(name) for name in (*required, *optional) if name in found}


def _read_netcdf(
    path: Path, required: Sequence[str], optional: Sequence[str], empty: frozenset[str]
) -> Columns:
    import netCDF4  # not at the top: it loads slowly, and most files are CSV

    try:
        file = netCDF4.Dataset(path)
    except (OSError, RuntimeError) as error:
        raise FlightError(f"{path}: is no netCDF file ({text_of(error)})") from None
    with file:
        known = _places(path, list(file.variables), required, optional, "it")
        size = 8 * sum(int(file.variables[name].size) for name in known)
        if size > MOST_ARRAYS:
            raise FlightError(
                f"{path}: holds {size / 1e6:.0f} MB of columns; at most {MOST_ARRAYS / 1e6:g} are "
                "allowed"
            )
        values = {name: _variable(path, file.variables[name], name, empty) for name in known}
    lengths = {len(array) for array in values.values()}
    if len(lengths) > 1:
        raise FlightError(f"{path}: its variables are of different lengths, {sorted(lengths)}")
    if lengths == {0}:
        raise FlightError(f"{path}: has no rows")
    return Columns(path, values, None)


def _variable(path: Path, variable: Any, name: str, empty: frozenset[str]) -> np.ndarray:
    """Return a variable's numbers (N,), NaN where they are masked."""
    if variable.ndim != 1 or np.dtype(variable.dtype).kind not in "fiu":
        raise FlightError(f"{path}: {name} must be one row of numbers")
    stated = str(getattr(variable, "units", "")).strip().lower()
    allowed = next(units for end, units in _UNITS.items() if name.endswith(end))
    if stated and stated not in allowed and not stated.startswith("seconds since "):
        raise FlightError(f"{path}: {name} has units {stated!r}, which is not what its name says")
    values = np.asarray(np.ma.filled(variable[:].astype(float), np.nan), dtype=float)
    bad = ~np.isfinite(values)
    if name in empty:
        bad &= ~np.isnan(values)
    if bad.any():
        raise FlightError(f"{path}: record {int(bad.argmax()) + 1}: {name} is missing or no number")
    return values


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
