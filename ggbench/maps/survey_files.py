"""Survey lines read from Geosoft XYZ, ASEG-GDF2 and CSV files."""

from __future__ import annotations

import csv
import io
import re
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from ..errors import text_of
from ..files import MOST_TEXT, content_of, gunzipped
from ..gravity.gradient_map import MapError
from .survey_lines import COMPONENTS, DISTURBANCE, PRIMARY, Quantity, SurveyLines, in_our_axes

REQUIRED = ("time_s", "latitude_deg", "longitude_deg", "height_m")
"""Columns that every file must have, as they are called unless the user says otherwise."""
_LINE, _KIND = "line", "kind"
_XYZ_LINE = re.compile(r"^\s*([A-Za-z]+)\s+(\S+)\s*$")
_DEFINITION = re.compile(r"^DEFN\s*\d*\s*ST=RECD\s*,\s*RT=(\w*)\s*;(.*)$", re.IGNORECASE)
_FORMAT = re.compile(r"^(\d*)([AIFEDG])(\d+)(?:\.\d+)?$", re.IGNORECASE)
_NUMBER = re.compile(r"(^|,)\s*[-+]?\d*\.\d*\s*(,|$)")  # of a row, and of no line of names
_FEWEST = 4  # samples of a line that can be used


def read_lines(
    path: Path,
    columns: Mapping[str, str] | None = None,
    components: Sequence[str] = (),
    axes: str = "east-north-up",
    quantity: Quantity = "gradient",
) -> SurveyLines:
    """Return the lines of a survey.

    Parameters
    ----------
    path : ``*.xyz`` (Geosoft), ``*.dat`` with its ``*.dfn`` (ASEG-GDF2), ``*.csv``; or any ``.gz``.
    columns : what the file calls ``line``, ``kind``, the :data:`REQUIRED` and the components.
    components : to use; none: all that the file has.
    axes : of the file's tensor, a key of :data:`AXES`.
    quantity : ``gradient`` [E], or ``disturbance`` [mGal].

    Raises
    ------
    MapError
        If the file cannot be read, or lacks a column; the message says which it has.
    """
    table = _table(path)
    names = {key: key for key in (_LINE, _KIND, *REQUIRED, *COMPONENTS, DISTURBANCE)}
    unknown = sorted(set(columns or {}) - set(names))
    if unknown:
        raise MapError(f"--column {unknown[0]}=... names no column; known: {', '.join(names)}.")
    names |= dict(columns or {})
    wanted = _components(path, table, names, components, quantity)
    for key in (_LINE, *REQUIRED):
        _require(path, table, names, key)
    numbers = np.column_stack([_numbers(path, table, names[key]) for key in (*REQUIRED, *wanted)])
    line_names = table[names[_LINE]].astype(str).str.strip()
    kinds = (
        table[names[_KIND]].astype(str).str.strip()
        if names[_KIND] in table.columns
        else pd.Series(PRIMARY, index=table.index)
    )
    whole = np.isfinite(numbers).all(axis=1)
    return _lines(
        path=path,
        numbers=numbers,
        whole=whole,
        names=line_names[whole],
        kinds=kinds[whole],
        wanted=wanted,
        axes=axes,
    )


def _lines(
    path: Path, numbers: Any, whole: Any, names: Any, kinds: Any, wanted: Sequence[str], axes: str
) -> SurveyLines:
    """The lines of those samples that are whole."""
    index, order = pd.factorize(names)
    numbers, dropped = numbers[whole], int((~whole).sum())
    counts = np.bincount(index, minlength=len(order))
    if not len(order) or counts.max() < _FEWEST:
        raise MapError(f"{path}: no line has {_FEWEST} samples without a missing value.")
    first = [int(np.flatnonzero(index == i)[0]) for i in range(len(order))]
    ours = [(n, 1) if n == DISTURBANCE else in_our_axes(n, axes) for n in wanted]
    latitude, longitude = numbers[:, 1], numbers[:, 2]
    for name, values, most in (("latitude_deg", latitude, 90), ("longitude_deg", longitude, 360)):
        if np.abs(values).max() > most:
            raise MapError(
                f"{path}: {name} reaches {np.abs(values).max():g}; it must be in degrees of WGS84, "
                "not in metres of a projection."
            )
    found = SurveyLines(
        names=tuple(order),
        kinds=tuple(kinds.iloc[i] for i in first),
        line=index,
        time_s=numbers[:, 0],
        latitude_deg=latitude,
        longitude_deg=np.unwrap(longitude, period=360.0),
        height_m=numbers[:, 3],
        components=tuple(name for name, _ in ours),
        values=numbers[:, 4:] * [sign for _, sign in ours],
        dropped=dropped,
    )
    return found.only([i for i in range(len(order)) if counts[i] >= _FEWEST])


def _components(
    path: Path, table: Any, names: Mapping[str, str], asked: Sequence[str], quantity: Quantity
) -> list[str]:
    """The components to read, each of which the file has."""
    if quantity == "disturbance":
        if asked and tuple(asked) != (DISTURBANCE,):
            raise MapError("--components are of a gradient: --quantity disturbance has one.")
        asked = [DISTURBANCE]
    unknown = [name for name in asked if name not in (*COMPONENTS, DISTURBANCE)]
    if unknown or len(set(asked)) < len(asked):
        raise MapError(
            f"--components {','.join(asked)}: allowed are {', '.join(COMPONENTS)}, each once."
        )
    for name in asked:
        _require(path, table, names, name)
    found = list(asked) or [name for name in COMPONENTS if names[name] in table.columns]
    if not found:
        raise MapError(
            f"{path} has no column of a component ({', '.join(COMPONENTS)}); name them, as in "
            f"--column xx=Txx; it has {', '.join(map(str, table.columns))}."
        )
    return found


def _require(path: Path, table: Any, names: Mapping[str, str], key: str) -> None:
    if names[key] not in table.columns:
        raise MapError(
            f"{path} has no column {names[key]!r}; name it, as in --column {key}=COLUMN; it has "
            f"{', '.join(map(str, table.columns))}."
        )


def _numbers(path: Path, table: Any, name: str) -> Any:
    try:
        return pd.to_numeric(table[name]).to_numpy(dtype=float)
    except (TypeError, ValueError) as error:
        raise MapError(f"{path}: column {name!r} must hold numbers: {text_of(error)}.") from None


def _table(path: Path) -> Any:
    """The file as a data frame, missing values as NaN."""
    packed = path.suffix.lower() == ".gz"
    ending = Path(path.stem).suffix.lower() if packed else path.suffix.lower()
    readers = {".csv": _read_csv, ".xyz": _read_xyz, ".dat": _read_gdf2}
    if ending not in readers:
        raise MapError(
            f"the survey {path} must be named *.xyz (Geosoft), *.dat (ASEG-GDF2) or *.csv, or that "
            "and .gz."
        )
    try:
        content = content_of(path, MapError, MOST_TEXT, "the survey ")
        if packed:
            content = gunzipped(content, MapError, f"the survey {path}")
        return readers[ending](path, _text(path, content))
    except OSError as error:
        raise MapError(f"cannot read the survey {path}: {error.strerror or error}") from None
    except (ValueError, EOFError, zlib.error) as error:
        raise MapError(f"{path} is no {ending[1:]} file: {text_of(error)}.") from None


def _text(path: Path, content: bytes) -> str:
    """The text of a survey; raises MapError if it holds other bytes than UTF-8's."""
    try:
        text = content.decode("utf-8-sig")
        bad = text.find("\0")
        place, found = bad, "a null byte"
    except UnicodeDecodeError as error:
        bad, found = error.start, f"the byte 0x{content[error.start]:02x}"
        place, text = bad, content[:bad].decode("latin-1")
    if bad < 0:
        return text
    raise MapError(
        f"the survey {path}: line {text.count(chr(10), 0, place) + 1} has {found}, and must be "
        "UTF-8 text: convert it, for example with 'iconv -f latin1 -t utf-8'."
    )


def _read_csv(path: Path, text: str) -> Any:
    rows = text.splitlines()
    top = next((n for n, row in enumerate(rows) if row.strip() and row[0] != "#"), 0)
    if top and _NUMBER.search(rows[top]):
        above, first = (len(next(csv.reader([row]))) for row in rows[top - 1 : top + 1])
        if above == first:  # the names follow a #, as numpy.savetxt writes them
            rows[top - 1] = rows[top - 1].lstrip("# ")
    return _frame("\n".join(rows), sep=",", comment="#", dtype={_LINE: str, _KIND: str})


def _read_xyz(path: Path, text: str) -> Any:
    """Geosoft XYZ: columns named by the last comment, a heading before each line, ``*`` missing."""
    comments, rows, lines, kinds = [], [], [], []
    name, kind = "", PRIMARY
    for row in text.splitlines():
        heading = _XYZ_LINE.match(row)
        if row.lstrip().startswith("/"):
            comments.append(row.strip().lstrip("/").split())
        elif heading:
            kind, name = heading[1].lower(), heading[2]
            kind = PRIMARY if kind == "line" else kind
        elif row.strip():
            rows.append(row)
            lines.append(name)
            kinds.append(kind)
    if not rows:
        raise ValueError("it has no samples")
    count = len(rows[0].split())
    names = [c for c in comments if len(c) == count and not all(set(w) <= {"=", "-"} for w in c)]
    if not names:
        raise ValueError(f"no comment names its {count} columns")
    table = _frame("\n".join(rows), sep=r"\s+", names=names[-1], na_values=["*"])
    if _LINE not in table.columns:
        table[_LINE] = lines
    table[_KIND] = kinds
    return table


def _read_gdf2(path: Path, text: str) -> Any:
    """ASEG-GDF2: fixed columns, which the ``.dfn`` file of the same name defines."""
    stem = path.with_suffix("") if path.suffix.lower() == ".gz" else path
    definitions = [stem.with_suffix(ending) for ending in (".dfn", ".DFN")]
    known = next((file for file in definitions if file.exists()), None)
    if known is None:
        raise MapError(
            f"{path} needs its definition file {definitions[0].name} in the same folder."
        )
    rows = [row for row in text.splitlines() if row.strip() and not row.startswith("COMM")]
    table, start = {}, 0
    for name, count, width, null in _fields(_text(known, known.read_bytes())):
        for number in range(count):
            cells = pd.Series([row[start : start + width].strip() for row in rows])
            values = pd.to_numeric(cells, errors="coerce")
            if null is not None:
                values = values.where(values != null)
            label = name if count == 1 else f"{name}[{number}]"
            table[label] = cells if values.isna().all() else values
            if label.lower() == _LINE:
                table[_LINE] = cells
            start += width
    return pd.DataFrame(table)


def _fields(text: str) -> list[tuple[str, int, int, float | None]]:
    """Name, count, width and mark of missing values of each field of a definition file."""
    found = []
    for row in text.splitlines():
        definition = _DEFINITION.match(row.strip())
        if not definition or definition[1].upper() not in ("", "DATA"):
            continue
        name, *rest = (part.strip() for part in definition[2].split(":"))
        if not rest:  # the end of the definitions
            continue
        form, *rest = rest
        shape = _FORMAT.match(form)
        if not shape:
            raise ValueError(f"field {name} has the format {form!r}, which is unknown")
        null = re.search(r"NULL\s*=\s*([-+.\dEe]+)", ":".join(rest))
        found.append((name, int(shape[1] or 1), int(shape[3]), float(null[1]) if null else None))
    return found


def _frame(text: str, **options: Any) -> Any:
    return pd.read_csv(io.StringIO(text), skipinitialspace=True, **options)
