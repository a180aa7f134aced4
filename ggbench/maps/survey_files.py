"""Reader of survey lines from Geosoft XYZ, ASEG-GDF2 and CSV files."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ..errors import text_of
from ..files.archives import gunzipped
from ..files.writing import content_of
from ..gravity.coordinate_names import (
    contradiction_of_axis,
    names_axes_down,
    old_datum,
    zero_level,
)
from ..gravity.ellipsoid import normal_gravity
from ..gravity.gradient_map import MapError
from ..gravity.optional_modules import imported
from ..gravity.quantity_names import contradiction, is_corrected_for_terrain, names_gravity
from ..gravity.terrain import TerrainError
from ..gravity.unit_names import without_unit
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
    zero_rows,
)
from .survey_numbers import (
    PROJECTED,
    Column,
    read_numbers,
    require_limits,
    require_size,
    written_numbers,
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
"""Default names of the columns of times and positions; times may be missing."""
_KEYS = (LINE, KIND, *REQUIRED, *PROJECTED, *COMPONENTS, DISTURBANCE, ANOMALY)
_FEWEST = 4  # samples of a line that can be used


def read_lines(
    path: Path,
    columns: Mapping[str, str] | None = None,
    components: Sequence[str] = (),
    axes: str = "east-north-up",
    quantity: Quantity = "gradient",
    voids: Sequence[float] = (),
    crs: str | None = None,
) -> SurveyLines:
    """Return the survey lines of a file.

    Values are converted from the units that the file states (``UNIT`` in a ``.dfn`` file, or a unit
    in brackets after a column's name). Free-air anomalies are converted to gravity disturbances
    with the EGM2008 geoid to degree 120. Missing values are marked by codes that the file or the
    user declares, or by common codes such as −9999.999. If at least two components are measured and
    all of them are exactly 0, all gradients of the sample are missing.

    Parameters
    ----------
    path : ``*.xyz`` (Geosoft), ``*.dat`` with its ``*.dfn`` (ASEG-GDF2) or ``*.csv``; each may be
        compressed (``.gz``).
    columns : the file's column names, by key: ``line``, ``kind``, keys in :data:`REQUIRED` and
        :data:`PROJECTED`, and components. A unit in brackets after a name, as in ``Alt [ft]``,
        replaces the unit of the file.
    components : components to use; empty: all components in the file.
    axes : axes of the file's tensor, a key of :data:`.survey_lines.AXES`.
    quantity : ``gradient`` [E], ``disturbance`` or ``anomaly`` (free-air) [mGal].
    voids : values in the file that mark missing values.
    crs : coordinate reference system, such as ``EPSG:32754``; None: WGS 84.

    Raises
    ------
    MapError
        If the file cannot be read, a column is missing, or a column has another quantity; the
        message states the fault.
    """
    table = _table(path)
    unknown = sorted(set(columns or {}) - set(_KEYS))
    if unknown:
        raise MapError(f"--column {unknown[0]}=... has an unknown key; known: {', '.join(_KEYS)}.")
    names = {key: key for key in _KEYS} | dict(columns or {})
    components_read = _components(path, table, names, components, quantity)
    places = _places(table, names, crs)
    line = _required(table, names, LINE)
    missing_line(table, line.name)
    for key in components_read:
        _require_quantity(path, table, _required(table, names, key), quantity)
    named_columns = {
        key: _required(table, names, key) for key in (*places, "height_m", *components_read)
    }
    if (time := _found(table, names["time_s"])) or "time_s" in (columns or {}):
        named_columns["time_s"] = time or _required(table, names, "time_s")
    read = {key: read_numbers(table, key, column, voids) for key, column in named_columns.items()}
    remarks = _together(
        (named_columns[key].name, column_numbers.remarks) for key, column_numbers in read.items()
    )
    values = {key: column_numbers.values for key, column_numbers in read.items()}
    for key in (*places, "height_m"):
        _require_axis(table, key, named_columns[key], values[key])
    if crs is None:
        for column in (named_columns[key] for key in places):
            if datum := old_datum(_described(table, column)):
                raise MapError(
                    f"{path}: the name of the column {column.name} indicates the datum {datum}, "
                    "not WGS84: give --crs, the EPSG code of its latitudes and longitudes, for "
                    "example EPSG:4202 for AGD66."
                )
        _require_degrees(table, {named_columns[key]: values[key] for key in places})
    corrected = [
        described
        for key in components_read
        if is_corrected_for_terrain(described := _described(table, named_columns[key]))
    ]
    if corrected:
        remarks.append(
            f"{', '.join(corrected)}: the name indicates a terrain correction, so the map excludes "
            "the attraction of the terrain"
        )
    remarks += _remarks_on_comments(table, crs)
    texts = [table.comments, *(_described(table, named_columns[key]) for key in components_read)]
    if axes == "east-north-up" and quantity == "gradient" and any(map(names_axes_down, texts)):
        remarks.append(
            "a column name or a comment indicates axes north, east, down or z down: if the "
            "components have these axes, give --axes"
        )
    if "time_s" not in values:
        values["time_s"] = np.zeros(len(table.rows))
        remarks.append("the file has no time_s; only the noise model needs it")
    whole = np.asarray(np.isfinite(np.column_stack([*values.values()])).all(axis=1))
    if quantity == "gradient":
        remarks += _without_zeros(table, names, whole)
    values = {key: column[whole] for key, column in values.items()}
    if "time_s" not in named_columns:
        values["time_s"] = np.full(int(whole.sum()), np.nan)
    if crs is not None:
        _require_metres(path, crs, places, values)
        values["longitude_deg"], values["latitude_deg"] = _to_degrees(
            path, crs, *(values[key] for key in places)
        )
    require_limits(table, values, np.flatnonzero(whole))
    height = named_columns["height_m"]
    remarks += _above_ellipsoid(f"{_described(table, height)} {height.unit}".strip(), values)
    require_size(path, {named_columns[key]: values[key] for key in components_read}, quantity)
    if quantity == ANOMALY:
        values[DISTURBANCE] = values.pop(ANOMALY) + _anomaly_to_disturbance(values)
        remarks.append(
            "free-air anomalies were converted to disturbances with EGM2008's geoid to degree 120"
        )
        components_read = [DISTURBANCE]
    kind = _found(table, names[KIND])
    if kind is not None:
        missing_line(table, kind.name)
    return _lines(
        path=path,
        values=values,
        dropped=int((~whole).sum()) + table.cut,
        names=pd.Series(table.columns[line.name]).str.strip()[whole],
        kinds=pd.Series(table.columns[kind.name] if kind else [PRIMARY] * len(table.rows))[whole],
        components=components_read,
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
    components: Sequence[str],
    axes: str,
    remarks: tuple[str, ...],
) -> SurveyLines:
    """Return the survey lines of complete samples, in east-north-up axes.

    Lines with too few samples are omitted.
    """
    index, order = pd.factorize(names)
    counts = np.bincount(index, minlength=len(order))
    if not len(order) or counts.max() < _FEWEST:
        raise MapError(f"{path}: no line has {_FEWEST} samples without a missing value.")
    first = [int(np.flatnonzero(index == i)[0]) for i in range(len(order))]
    ours = [(n, 1) if n == DISTURBANCE else in_our_axes(n, axes) for n in components]
    numbers = np.column_stack([values[key] for key in components])
    lines = SurveyLines(
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
    return lines.only([i for i in range(len(order)) if counts[i] >= _FEWEST])


def _components(
    path: Path,
    table: SurveyTable,
    names: Mapping[str, str],
    requested: Sequence[str],
    quantity: Quantity,
) -> list[str]:
    """Return the names of the components to read.

    Raises MapError if a requested component is unknown or missing, or if the file has none.
    """
    if quantity != "gradient":
        if requested and tuple(requested) != (quantity,):
            raise MapError(
                f"--components is for gradients: --quantity {quantity} has one component."
            )
        requested = [quantity]
    unknown = [name for name in requested if name not in (*COMPONENTS, DISTURBANCE, ANOMALY)]
    if unknown or len(set(requested)) < len(requested):
        raise MapError(
            f"--components {','.join(requested)}: allowed are {', '.join(COMPONENTS)}, each at "
            "most once."
        )
    for name in requested:
        _required(table, names, name)
    present = list(requested) or [name for name in COMPONENTS if _found(table, names[name])]
    if not present:
        raise MapError(
            f"{path} has no column of a component ({', '.join(COMPONENTS)}); name them, as in "
            f"--column xx=Txx; it has {', '.join(table.columns)}."
        )
    return present


def _places(table: SurveyTable, names: Mapping[str, str], crs: str | None) -> tuple[str, str]:
    """Return the keys of the coordinates: east and north, or longitude and latitude."""
    if crs is not None and all(_found(table, names[key]) for key in PROJECTED):
        return PROJECTED
    return "longitude_deg", "latitude_deg"


def _found(table: SurveyTable, name: str) -> Column | None:
    """Return the column with a name, which may end with a unit in brackets; None if missing."""
    if column := table.named(name):
        return Column(column, table.unit(column))
    bare, unit = without_unit(name)
    if unit and (column := table.named(bare)):
        return Column(column, unit)
    return None


def _required(table: SurveyTable, names: Mapping[str, str], key: str) -> Column:
    column = _found(table, names[key])
    if column is None:
        raise MapError(
            f"{table.path} has no column {names[key]!r}; name it, as in --column {key}=COLUMN; it "
            f"has {', '.join(table.columns)}."
        )
    return column


def _require_quantity(path: Path, table: SurveyTable, column: Column, quantity: Quantity) -> None:
    """Raise MapError if a column's name or description indicates another quantity."""
    described = _described(table, column)
    if quantity == "gradient" and not column.unit and names_gravity(described):
        raise MapError(
            f"{path}: the name of the column {described!r} indicates gravity, not a gradient: give "
            "--quantity disturbance if it is gravity, and --column "
            f"'KEY={column.name} [E]' if it is a gradient."
        )
    if reason := contradiction(quantity, described):
        other = {"disturbance": ANOMALY, ANOMALY: DISTURBANCE}.get(quantity, "")
        option = (
            f" (--quantity {other} --column {other}={column.name})"
            if reason.endswith(f"as {'an' if other == ANOMALY else 'a'} {other}")
            else ""
        )
        raise MapError(f"{path}: the column {described!r} is not a {quantity}: {reason}{option}.")


def _described(table: SurveyTable, column: Column) -> str:
    """Return the name of a column with its description."""
    description = table.descriptions.get(column.name, "")
    return column.name if description in ("", column.name) else f"{column.name} ({description})"


def _require_axis(table: SurveyTable, key: str, column: Column, values: Array) -> None:
    """Raise MapError if a column's name or description indicates another coordinate."""
    described = _described(table, column)
    if reason := contradiction_of_axis(key, described, values):
        raise MapError(f"{table.path}: the column {described!r} is given as {key}: {reason}.")


def _require_degrees(table: SurveyTable, places: Mapping[Column, Array]) -> None:
    """Raise MapError if longitudes and latitudes without a unit could be radians."""
    named = [column for column in places if not column.unit and not column.name.endswith("_deg")]
    largest = [float(np.nanmax(np.abs(values), initial=0.0)) for values in places.values()]
    limits = (np.pi, 0.5 * np.pi)
    if len(named) == len(places) and any(largest) and all(np.less_equal(largest, limits)):
        names = " and ".join(column.name for column in places)
        raise MapError(
            f"{table.path}: all of {names} could be radians: state the unit, as in --column "
            f"'longitude_deg={named[0].name} [deg]'."
        )


def _remarks_on_comments(table: SurveyTable, crs: str | None) -> list[str]:
    """Return remarks on a datum or a zero level of heights that a comment in the file states."""
    remarks = []
    if crs is None and (datum := old_datum(table.comments)):
        remarks.append(
            f"a comment names the datum {datum}: if the coordinates refer to this datum, give --crs"
        )
    if level := zero_level(table.comments):
        remarks.append(
            f"a comment names heights above {level}: heights above the ellipsoid are needed"
        )
    return remarks


def _above_ellipsoid(height: str, values: dict[str, Array]) -> list[str]:
    """Convert heights above sea level to ellipsoidal heights; return remarks on the zero level.

    ``height`` is the column's name and description. ``values`` are the columns by key.
    """
    level = zero_level(height)
    if level == "sea level":
        geoid = geoid_over(values["latitude_deg"], np.unwrap(values["longitude_deg"], period=360.0))
        values["height_m"] = values["height_m"] + geoid
        return [
            f"{height}: heights are above sea level by their name: the geoid height of EGM2008 to "
            f"degree 120, {geoid.mean():.0f} m on average, was added"
        ]
    if level:
        return [
            f"{height}: by their name heights are above {level}, but heights above the "
            "ellipsoid are needed"
        ]
    return []


def _without_zeros(
    table: SurveyTable, names: Mapping[str, str], whole: NDArray[np.bool_]
) -> list[str]:
    """Mark samples with 0 in all measured components as incomplete; return a remark.

    ``whole`` (N,) is the mask of complete samples, changed in place.

    Raises MapError if no complete sample remains.
    """
    columns = [_found(table, names[key]) for key in COMPONENTS]
    measured = list(dict.fromkeys(column.name for column in columns if column))
    zeros = whole & zero_rows(written_numbers(table, measured))
    if not zeros.any():
        return []
    whole &= ~zeros
    if not whole.any():
        raise MapError(f"{table.path}: {', '.join(measured)} are 0 in all samples.")
    return [f"{', '.join(measured)}: rows of zeros read as missing values, {zeros.sum()} times"]


def _together(remarks: Iterable[tuple[str, Sequence[str]]]) -> list[str]:
    """Return remarks on columns, with columns of equal remarks listed together."""
    columns: dict[str, list[str]] = {}
    for name, texts in remarks:
        for text in texts:
            columns.setdefault(text, []).append(name)
    return [f"{', '.join(names)}: {text}" for text, names in columns.items()]


def _require_metres(
    path: Path, crs: str, places: tuple[str, str], values: Mapping[str, Array]
) -> None:
    """Raise MapError if ``crs`` is a projection in metres, but the coordinates are degrees."""
    limits = (360.0, 90.0)
    small = [
        bool(np.abs(values[key]).max(initial=0.0) <= limit)
        for key, limit in zip(places, limits, strict=True)
    ]
    try:
        system = imported("rasterio.crs", path).CRS.from_user_input(crs)
    except Exception:  # of a text that is no reference system, which is said below
        return
    if system.is_projected and all(small):
        raise MapError(
            f"{path}: --crs {crs} is a projection in metres, but all coordinates lie within ±360 "
            "and ±90, as degrees do. Give the EPSG code of a system of latitude and longitude, or "
            "the columns in metres with --column easting_m=COLUMN --column northing_m=COLUMN."
        )


def _to_degrees(path: Path, crs: str, east: Array, north: Array) -> tuple[Array, Array]:
    """Convert coordinates in a reference system to WGS 84 longitudes and latitudes [deg].

    Raises MapError if the reference system is unknown, or coordinates are outside its area.
    """
    try:
        warp = imported("rasterio.warp", path)
        with imported("rasterio", path).Env():  # else GDAL prints its errors itself
            longitude, latitude = warp.transform(crs, "EPSG:4326", east, north)[:2]
    except TerrainError as error:
        raise MapError(str(error)) from None
    except Exception as error:  # rasterio's own, of a text that is no reference system
        raise MapError(
            f"--crs {crs} is not a coordinate reference system for {path} ({text_of(error)}); "
            "give one such as EPSG:32754."
        ) from None
    places = np.array(longitude, dtype=float), np.array(latitude, dtype=float)
    if not all(np.isfinite(axis).all() for axis in places):
        raise MapError(f"{path}: coordinates lie outside --crs {crs}: check the reference system.")
    return places


def _anomaly_to_disturbance(values: Mapping[str, Array]) -> Array:
    """Return the correction (N,) from free-air anomalies to gravity disturbances [mGal].

    It replaces normal gravity at the ellipsoid by normal gravity at the geoid
    (Hofmann-Wellenhof and Moritz, Physical Geodesy, 2006, sec. 2.12).
    """
    geoid = geoid_over(values["latitude_deg"], values["longitude_deg"])
    middle = float(np.radians(values["latitude_deg"].mean()))
    slope = -normal_gravity(middle, 0.0)[2]
    return 1e5 * slope * geoid


def _table(path: Path) -> SurveyTable:
    """Return the table of a survey file, with missing values as empty texts."""
    packed = path.suffix.lower() == ".gz"
    ending = Path(path.stem).suffix.lower() if packed else path.suffix.lower()
    readers = {".csv": read_csv, ".xyz": read_xyz, ".dat": read_gdf2}
    if ending not in readers:
        raise MapError(
            f"the survey {path} must be named *.xyz (Geosoft), *.dat (ASEG-GDF2) or *.csv, "
            "optionally with .gz."
        )
    content = content_of(path, MapError, "the survey ")
    if packed:
        content = gunzipped(content, MapError, f"the survey {path}")
    try:
        return readers[ending](path, text_in(path, content))
    except OSError as error:
        raise MapError(f"cannot read the survey {path}: {error.strerror or error}") from None
    except ValueError as error:
        raise unreadable(path, ending[1:], error) from None
