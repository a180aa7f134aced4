"""Survey lines read from Geosoft XYZ, ASEG-GDF2 and CSV files."""

from __future__ import annotations

import re
import zlib
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ..errors import text_of
from ..files import MOST_TEXT, content_of, gunzipped
from ..gravity.ellipsoid import normal_gravity
from ..gravity.gradient_map import MapError
from ..gravity.optional_modules import imported
from ..gravity.quantity_names import contradiction
from ..gravity.terrain import TerrainError
from ..gravity.unit_names import examples_for, factor_to_key, without_unit
from .aseg_gdf import read_gdf2
from .geoid import geoid_over
from .survey_lines import (
    ANOMALY,
    COMPONENTS,
    DISTURBANCE,
    PRIMARY,
    Quantity,
    SurveyLines,
    in_our_axes,
)
from .survey_tables import (
    KIND,
    LINE,
    SurveyTable,
    missing_line,
    read_csv,
    read_xyz,
    text_in,
    unreadable,
)

Array = NDArray[np.float64]

REQUIRED = ("time_s", "latitude_deg", "longitude_deg", "height_m")
"""Columns of places, as they are called unless the user says otherwise; times may be missing."""
PROJECTED = ("easting_m", "northing_m")
"""Columns of coordinates of a projection, in place of longitude and latitude."""
_KEYS = (LINE, KIND, *REQUIRED, *PROJECTED, *COMPONENTS, DISTURBANCE, ANOMALY)
_LIMITS = {
    "time_s": (-1e18, 1e18),
    "latitude_deg": (-90.0, 90.0),
    "longitude_deg": (-360.0, 360.0),
    "height_m": (-12_000.0, 100_000.0),
    **dict.fromkeys(PROJECTED, (-4e7, 4e7)),
    **dict.fromkeys(COMPONENTS, (-1e5, 1e5)),
    **dict.fromkeys((DISTURBANCE, ANOMALY), (-2000.0, 2000.0)),
}
"""Of what is measured anywhere: m, degrees, E and mGal."""
_HUGE = 1e20  # no value is as large: 1e32 (Geosoft), 1.7e38 (Surfer)
_ALWAYS_MARKS = re.compile(r"-(?:9{4,}(?:\.[09]*)?|3276[78](?:\.0*)?)")
_MAYBE_MARKS = re.compile(r"[-+]?9{2,}(?:\.[09]*)?")
_ISOLATED = 3.0
"""Distance of a mark of nines from the other values, over their range."""
_CLOCK = re.compile(r"(\d{1,2}):(\d{2}):(\d{2}(?:\.\d*)?)")
_LEAST = 1e-3
"""RMS of values below which their unit is in doubt [E or mGal]."""
_FEWEST = 4  # samples of a line that can be used


class _Column(NamedTuple):
    """A column of a table that is used: its name, and its unit; empty if it has none."""

    name: str
    unit: str


class _Numbers(NamedTuple):
    """The numbers of a column in the unit of its key, NaN where missing, and remarks."""

    values: Array
    remarks: tuple[str, ...]


def read_lines(
    path: Path,
    columns: Mapping[str, str] | None = None,
    components: Sequence[str] = (),
    axes: str = "east-north-up",
    quantity: Quantity = "gradient",
    voids: Sequence[float] = (),
    crs: str | None = None,
) -> SurveyLines:
    """Return the lines of a survey.

    Units that the file states are converted: a ``.dfn`` file's ``UNIT``, and units in brackets
    behind a column's name. Free-air anomalies become disturbances by the geoid of EGM2008 to degree
    120. Missing values are those that the file or the user declares, and marks such as −9999.999.

    Parameters
    ----------
    path : ``*.xyz`` (Geosoft), ``*.dat`` with its ``*.dfn`` (ASEG-GDF2), ``*.csv``; or any ``.gz``.
    columns : what the file calls ``line``, ``kind``, the :data:`REQUIRED`, the :data:`PROJECTED`
        and the components; a unit in brackets behind a name, as in ``Alt [ft]``, holds in place of
        the file's.
    components : to use; none: all that the file has.
    axes : of the file's tensor, a key of :data:`AXES`.
    quantity : ``gradient`` [E], ``disturbance`` or ``anomaly`` (free-air) [mGal].
    voids : values that mark missing ones, as they are in the file.
    crs : reference system of the coordinates, such as ``EPSG:32754``; None: WGS 84.

    Raises
    ------
    MapError
        If the file cannot be read, lacks a column, or one is of another quantity; the message says
        what was found.
    """
    table = _table(path)
    unknown = sorted(set(columns or {}) - set(_KEYS))
    if unknown:
        raise MapError(f"--column {unknown[0]}=... names no column; known: {', '.join(_KEYS)}.")
    names = {key: key for key in _KEYS} | dict(columns or {})
    wanted = _components(path, table, names, components, quantity)
    places = _places(table, names, crs)
    line = _required(table, names, LINE)
    missing_line(table, line.name)
    for key in wanted:
        _require_quantity(path, table, _required(table, names, key), quantity)
    used = {key: _required(table, names, key) for key in (*places, "height_m", *wanted)}
    if (time := _found(table, names["time_s"])) or "time_s" in (columns or {}):
        used["time_s"] = time or _required(table, names, "time_s")
    read = {key: _numbers(table, key, column, voids) for key, column in used.items()}
    remarks = _together((used[key].name, found.remarks) for key, found in read.items())
    values = {key: found.values for key, found in read.items()}
    if "time_s" not in values:
        values["time_s"] = np.zeros(len(table.rows))
        remarks.append("the file has no time_s, which only a model of the noise needs")
    whole = np.isfinite(np.column_stack([*values.values()])).all(axis=1)
    values = {key: found[whole] for key, found in values.items()}
    if "time_s" not in used:
        values["time_s"] = np.full(int(whole.sum()), np.nan)
    if crs is not None:
        values["longitude_deg"], values["latitude_deg"] = _to_degrees(
            path, crs, *(values[key] for key in places)
        )
    _require_limits(table, values, np.flatnonzero(whole))
    _require_size(path, {used[key]: values[key] for key in wanted}, quantity)
    if quantity == ANOMALY:
        values[DISTURBANCE] = values.pop(ANOMALY) + _anomaly_to_disturbance(values)
        remarks.append("free-air anomalies became disturbances by EGM2008's geoid to degree 120")
        wanted = [DISTURBANCE]
    kind = _found(table, names[KIND])
    if kind is not None:
        missing_line(table, kind.name)
    return _lines(
        path=path,
        values=values,
        dropped=int((~whole).sum()) + table.cut,
        names=pd.Series(table.columns[line.name]).str.strip()[whole],
        kinds=pd.Series(table.columns[kind.name] if kind else [PRIMARY] * len(table.rows))[whole],
        wanted=wanted,
        axes=axes,
        remarks=tuple(remarks),
    )


def _lines(
    *,
    path: Path,
    values: Mapping[str, Array],
    dropped: int,
    names: Any,
    kinds: Any,
    wanted: Sequence[str],
    axes: str,
    remarks: tuple[str, ...],
) -> SurveyLines:
    """The lines of those samples that are whole."""
    index, order = pd.factorize(names)
    counts = np.bincount(index, minlength=len(order))
    if not len(order) or counts.max() < _FEWEST:
        raise MapError(f"{path}: no line has {_FEWEST} samples without a missing value.")
    first = [int(np.flatnonzero(index == i)[0]) for i in range(len(order))]
    ours = [(n, 1) if n == DISTURBANCE else in_our_axes(n, axes) for n in wanted]
    numbers = np.column_stack([values[key] for key in wanted])
    found = SurveyLines(
        names=tuple(order),
        kinds=tuple(str(kinds.iloc[i]).strip() for i in first),
        line=index,
        time_s=values["time_s"],
        latitude_deg=values["latitude_deg"],
        longitude_deg=np.unwrap(values["longitude_deg"], period=360.0),
        height_m=values["height_m"],
        components=tuple(name for name, _ in ours),
        values=numbers * [sign for _, sign in ours],
        dropped=dropped,
        remarks=remarks,
    )
    return found.only([i for i in range(len(order)) if counts[i] >= _FEWEST])


def _components(
    path: Path,
    table: SurveyTable,
    names: Mapping[str, str],
    asked: Sequence[str],
    quantity: Quantity,
) -> list[str]:
    """The components to read, each of which the file has."""
    if quantity != "gradient":
        if asked and tuple(asked) != (quantity,):
            raise MapError(f"--components are of a gradient: --quantity {quantity} has one.")
        asked = [quantity]
    unknown = [name for name in asked if name not in (*COMPONENTS, DISTURBANCE, ANOMALY)]
    if unknown or len(set(asked)) < len(asked):
        raise MapError(
            f"--components {','.join(asked)}: allowed are {', '.join(COMPONENTS)}, each once."
        )
    for name in asked:
        _required(table, names, name)
    found = list(asked) or [name for name in COMPONENTS if _found(table, names[name])]
    if not found:
        raise MapError(
            f"{path} has no column of a component ({', '.join(COMPONENTS)}); name them, as in "
            f"--column xx=Txx; it has {', '.join(table.columns)}."
        )
    return found


def _places(table: SurveyTable, names: Mapping[str, str], crs: str | None) -> tuple[str, str]:
    """Return the keys of the coordinates: east and north, or longitude and latitude."""
    if crs is not None and all(_found(table, names[key]) for key in PROJECTED):
        return PROJECTED
    return "longitude_deg", "latitude_deg"


def _found(table: SurveyTable, name: str) -> _Column | None:
    """Return the column of a name, which may have a unit in brackets behind it."""
    if column := table.named(name):
        return _Column(column, table.unit(column))
    bare, unit = without_unit(name)
    if unit and (column := table.named(bare)):
        return _Column(column, unit)
    return None


def _required(table: SurveyTable, names: Mapping[str, str], key: str) -> _Column:
    column = _found(table, names[key])
    if column is None:
        raise MapError(
            f"{table.path} has no column {names[key]!r}; name it, as in --column {key}=COLUMN; it "
            f"has {', '.join(table.columns)}."
        )
    return column


def _require_quantity(path: Path, table: SurveyTable, column: _Column, quantity: Quantity) -> None:
    """Raise MapError if name or description of a column is of another quantity."""
    said = table.descriptions.get(column.name, "")
    described = column.name if said in ("", column.name) else f"{column.name} ({said})"
    if reason := contradiction(quantity, described):
        other = {"disturbance": ANOMALY, ANOMALY: DISTURBANCE}.get(quantity, "")
        option = (
            f" (--quantity {other} --column {other}={column.name})"
            if reason.endswith(f"as {'an' if other == ANOMALY else 'a'} {other}")
            else ""
        )
        raise MapError(f"{path}: the column {described!r} is no {quantity}: {reason}{option}.")


def _numbers(table: SurveyTable, key: str, column: _Column, voids: Sequence[float]) -> _Numbers:
    """Return the numbers of a column in the unit of its key."""
    cells = [cell.strip() for cell in table.columns[column.name]]
    if key == "time_s" and any(_CLOCK.fullmatch(cell) for cell in cells[:1]):
        return _Numbers(np.array([_seconds(cell) for cell in cells]), ())
    written = pd.to_numeric(pd.Series(cells), errors="coerce").to_numpy(dtype=float).copy()
    bad = np.isnan(written) & np.array([cell.casefold() not in ("", "*", "nan") for cell in cells])
    if bad.any():
        row = int(bad.argmax())
        raise table.error(row, f"{column.name} is {cells[row][:40]!r} and must be a number")
    factor, of_unit = _factor(table, key, column)
    for mark in (*voids, *([table.voids[column.name]] if column.name in table.voids else ())):
        written[np.isclose(written, mark, rtol=1e-6, atol=0.0)] = np.nan
    marks = _undeclared(cells, written, factor, _LIMITS[key])
    of_marks = ""
    if marks.any():
        found = ", ".join(sorted({cells[n] for n in np.flatnonzero(marks)})[:3])
        of_marks = f"undeclared {found} taken for missing values, {marks.sum()} times"
        written[marks] = np.nan
    return _Numbers(factor * written, tuple(filter(None, (of_unit, of_marks))))


def _together(remarks: Iterable[tuple[str, Sequence[str]]]) -> list[str]:
    """Return remarks on columns, equal ones once."""
    columns: dict[str, list[str]] = {}
    for name, texts in remarks:
        for text in texts:
            columns.setdefault(text, []).append(name)
    return [f"{', '.join(names)}: {text}" for text, names in columns.items()]


def _seconds(cell: str) -> float:
    """Return the seconds of day of a clock's reading; NaN if it is none."""
    found = _CLOCK.fullmatch(cell)
    return 3600.0 * int(found[1]) + 60.0 * int(found[2]) + float(found[3]) if found else np.nan


def _factor(table: SurveyTable, key: str, column: _Column) -> tuple[float, str]:
    """Return the factor of a column to its key's unit, and a remark.

    Raises MapError if the unit is not known, or is one of another quantity.
    """
    end = {DISTURBANCE: "_mgal", ANOMALY: "_mgal"}.get(key, "_eotvos" if key in COMPONENTS else "")
    named = key + end
    unit = column.unit or _unit_at_end(column.name, named)
    if not unit:
        return 1.0, "no unit given, mGal assumed" if end == "_mgal" else ""
    factor = factor_to_key(unit, named)
    if factor is None:
        raise MapError(
            f"{table.path}: the column {column.name} is in {unit!r}, and {key} may be in "
            f"{examples_for(named)}; state the right unit as in --column "
            f"'{key}={column.name} [UNIT]'."
        )
    return factor, "" if factor == 1.0 else f"converted from {unit}"


def _unit_at_end(name: str, key: str) -> str:
    """Return the unit at the end of a column's name, as of ``ALT_FT`` and ``GFAAGU``; or "".

    It counts if it is one of the key's quantity.
    """
    found = re.search(r"(?:_|(?=(?:gu|mgal)$))([a-z]{2,}|[mse])$", name.casefold())
    return found[1] if found and factor_to_key(found[1], key) is not None else ""


def _undeclared(
    cells: Sequence[str], written: Array, factor: float, limits: tuple[float, float]
) -> NDArray[np.bool_]:
    """Return which values are marks of missing ones that the file does not declare.

    Those of the size 1e20 and more, of four nines and more below zero, and other nines that lie
    beyond the limits or far from all other values.
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


def _require_limits(
    table: SurveyTable, values: Mapping[str, Array], rows: NDArray[np.int64]
) -> None:
    """Raise MapError if a value is beyond its limits; ``rows`` are the samples of the values."""
    for key, found in values.items():
        low, high = _LIMITS[key]
        off = (found < low) | (found > high)
        if not off.any():
            continue
        n = int(off.argmax())
        hint = (
            "it must be in degrees of WGS84, not in metres of a projection; --crs names one"
            if key in ("latitude_deg", "longitude_deg")
            else f"it must lie between {low:g} and {high:g}: is it another unit, another quantity, "
            "or a mark of missing values (--void VALUE declares it)?"
        )
        raise table.error(int(rows[n]), f"{key} is {found[n]:g}; {hint}")


def _require_size(path: Path, values: Mapping[_Column, Array], quantity: Quantity) -> None:
    """Raise MapError if values without a stated unit are too small for any field.

    Such are gradients in s⁻² and gravity in m/s².
    """
    unit, other = ("E", "s^-2") if quantity == "gradient" else ("mGal", "m/s2")
    unstated = [column.name for column in values if not column.unit]
    rms = max(
        (float(np.sqrt(np.mean(found**2))) for found in values.values() if found.size), default=1.0
    )
    if unstated and 0.0 < rms < _LEAST:
        raise MapError(
            f"{path}: the RMS of {', '.join(unstated)} is {rms:.2g} {unit}, too small for any "
            f"instrument: is it in {other}? State the unit, as in --column "
            f"'KEY={unstated[0]} [{other}]', also if it is {unit}."
        )


def _to_degrees(path: Path, crs: str, east: Array, north: Array) -> tuple[Array, Array]:
    """Return longitudes and latitudes of WGS 84 [deg] of coordinates in a reference system.

    Raises MapError if the system is not known, or has no such coordinates.
    """
    try:
        warp = imported("rasterio.warp", path)
        with imported("rasterio", path).Env():  # else GDAL prints its errors itself
            longitude, latitude = warp.transform(crs, "EPSG:4326", east, north)[:2]
    except TerrainError as error:
        raise MapError(str(error)) from None
    except Exception as error:  # rasterio's own, of a text that is no reference system
        raise MapError(
            f"--crs {crs} is no reference system for {path} ({text_of(error)}); give one as "
            "EPSG:32754."
        ) from None
    places = np.array(longitude, dtype=float), np.array(latitude, dtype=float)
    if not all(np.isfinite(axis).all() for axis in places):
        raise MapError(f"{path}: coordinates lie outside of --crs {crs}: is it the right one?")
    return places


def _anomaly_to_disturbance(values: Mapping[str, Array]) -> Array:
    """Return what turns free-air anomalies into disturbances (N,) [mGal].

    Normal gravity at the geoid is subtracted in place of that at the ellipsoid below
    (Hofmann-Wellenhof and Moritz, Physical Geodesy, 2006, sec. 2.12).
    """
    geoid = geoid_over(values["latitude_deg"], values["longitude_deg"])
    middle = float(np.radians(values["latitude_deg"].mean()))
    slope = -normal_gravity(middle, 0.0)[2]
    return 1e5 * slope * geoid


def _table(path: Path) -> SurveyTable:
    """The file's table, missing values as empty texts."""
    packed = path.suffix.lower() == ".gz"
    ending = Path(path.stem).suffix.lower() if packed else path.suffix.lower()
    readers = {".csv": read_csv, ".xyz": read_xyz, ".dat": read_gdf2}
    if ending not in readers:
        raise MapError(
            f"the survey {path} must be named *.xyz (Geosoft), *.dat (ASEG-GDF2) or *.csv, or that "
            "and .gz."
        )
    try:
        content = content_of(path, MapError, MOST_TEXT, "the survey ")
        if packed:
            content = gunzipped(content, MapError, f"the survey {path}")
        return readers[ending](path, text_in(path, content))
    except OSError as error:
        raise MapError(f"cannot read the survey {path}: {error.strerror or error}") from None
    except (ValueError, EOFError, zlib.error) as error:
        raise unreadable(path, ending[1:], error) from None
