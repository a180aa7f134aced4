"""Reader of tracks from CSV text with named columns."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from ..gravity.coordinate_names import contradiction_of_axis, zero_level
from ..gravity.unit_names import examples_for, factor_to_key
from . import column_names
from .csv_text import CsvText
from .manoeuvres import Array, TrajectoryError

FEWEST_ROWS = 5
_ALIASES = {
    "time_s": ("time_s", "time", "t", "t_s", "seconds"),
    "latitude_deg": ("latitude_deg", "latitude", "lat", "lat_deg"),
    "longitude_deg": ("longitude_deg", "longitude", "lon", "lng", "long", "lon_deg", "lng_deg"),
    "height_m": ("height_m", "height", "h", "h_m", "altitude", "altitude_m", "alt", "alt_m"),
    "heading_deg": ("heading_deg", "heading", "yaw", "yaw_deg"),
    "pitch_deg": ("pitch_deg", "pitch"),
    "roll_deg": ("roll_deg", "roll"),
}
_WITH_UNIT = re.compile(r"(.*?)\s*[\[(]\s*([^\])]*?)\s*[\])]")
_KNOWN = {name for aliases in _ALIASES.values() for name in aliases}
_BARE = (
    {"latitude_deg": 0.5 * math.pi, "longitude_deg": math.pi},
    {"heading_deg": math.tau, "pitch_deg": 0.5 * math.pi, "roll_deg": math.pi},
)
"""Groups of angle columns, with the largest value of each in radians."""
_REQUIRED = ("time_s", "latitude_deg", "longitude_deg", "height_m")


def parse(
    content: bytes,
    keys: Sequence[str] = tuple(_ALIASES),
    fewest: int = FEWEST_ROWS,
    columns: str | Mapping[str, str] | None = None,
) -> tuple[dict[str, Array], int, str]:
    """Return the columns (N,) of a CSV text, line number of the first row, and zero level.

    Columns are in a dict by key. A key is the standard name of a column, for example ``height_m``.
    The zero level is the level from which heights count, for example ``sea level``. It is taken
    from the name of the height column, see :func:`.coordinate_names.zero_level`.

    Columns may be separated by commas, semicolons or tabs. Columns with unknown names, or not in
    ``keys``, are ignored. A name may have a unit in brackets, and times may be dates (ISO 8601). At
    least ``fewest`` rows are needed. ``columns`` maps keys to names in the file, see
    :func:`.column_names.find`.

    Raises TrajectoryError if the text is invalid; the message states the line, the value and the
    allowed values.
    """
    required = [key for key in _REQUIRED if key in keys]
    named = column_names.names_of(columns)
    if other := column_names.unused(named, _ALIASES if not isinstance(columns, str) else named):
        raise TrajectoryError(
            f"columns.{other[0]} is not a column of a track; known: {', '.join(_ALIASES)}"
        )
    text = CsvText.of(content, _wanted(required, keys), _KNOWN | column_names.plain_names(named))
    parts = [_WITH_UNIT.fullmatch(name) for name in text.names]
    names = [part[1] if part else name for part, name in zip(parts, text.names, strict=True)]
    where, needed = f"line {text.line}", required.__contains__
    places_given = {
        key: place
        for key in keys
        if key in named and (place := column_names.find(key, text.names, named, where, needed(key)))
    }
    # What the user names is no other column by its own name.
    free = [
        "" if at in {p.at for p in places_given.values()} else name for at, name in enumerate(names)
    ]
    places = _columns(free, [key for key in required if key not in places_given], text.line)
    places = {key: at for key, at in places.items() if key in keys and key not in places_given}
    factors = {
        key: _factor(key, names[at], part[2], text.line)
        for key, at in places.items()
        if (part := parts[at])
    } | {key: place.factor for key, place in places_given.items()}
    if len(text.rows) < fewest:
        raise TrajectoryError(f"has {len(text.rows)} rows; a track needs at least {fewest}")
    read = text.numbers(places | {key: place.at for key, place in places_given.items()})
    for key, factor in factors.items():
        read[key] = factor * read[key]
    at = {key: place.at for key, place in places_given.items()} | places
    for key, values in read.items():
        if reason := contradiction_of_axis(key, text.names[at[key]], values):
            raise TrajectoryError(
                f"line {text.line} names a column '{text.names[at[key]]}', which is read as {key}: "
                f"{reason}"
            )
    level = zero_level(text.names[at["height_m"]]) if "height_m" in at else ""
    plain = [name for name, part in zip(free, parts, strict=True) if not part]
    for group in _BARE:
        _require_degrees({key: read[key] for key in places}, plain, group)
    return read, text.first, level


def _factor(key: str, name: str, unit: str, line: int) -> float:
    """Return the conversion factor of a unit in brackets after a column's name.

    Raises TrajectoryError if the unit is unknown, or contradicts the unit in the name.
    """
    end = key[key.rindex("_") :]
    factor = factor_to_key(unit, key)
    if factor is None:
        raise TrajectoryError(
            f"line {line} names a column '{name}' in '{unit}'; allowed units of {key}: "
            f"{examples_for(key)}"
        )
    if name.endswith(end) and factor != 1.0:
        raise TrajectoryError(
            f"line {line}: the name of the column '{name}' and the unit '{unit}' after it "
            "contradict each other; remove one of these units"
        )
    return factor


def _require_degrees(columns: dict[str, Array], names: list[str], limits: dict[str, float]) -> None:
    """Raise TrajectoryError if angles in columns without a stated unit could be radians."""
    bare = {
        key: name
        for key in limits
        if key in columns
        for name in names
        if name in _ALIASES[key] and not name.endswith("_deg")
    }
    largest = {key: float(np.abs(columns[key]).max()) for key in bare}
    if any(largest.values()) and all(largest[key] <= limits[key] for key in bare):
        raise TrajectoryError(
            f"all of {_and(bare.values())} could be radians, which are not supported; if they "
            f"are degrees, name the columns {_and(bare)}"
        )


def _and(words: Iterable[str]) -> str:
    *others, last = words
    return " and ".join(filter(None, (", ".join(others), last)))


def _columns(names: list[str], required: Sequence[str], line: int) -> dict[str, int]:
    """Return the indices of the known columns by key.

    Raises TrajectoryError if a required column is missing, or a key has two columns.
    """
    places: dict[str, int] = {}
    for key, aliases in _ALIASES.items():
        matches = [n for n, name in enumerate(names) if name in aliases]
        if len(matches) > 1:
            raise TrajectoryError(
                f"line {line} names {key} twice, '{names[matches[0]]}' and '{names[matches[1]]}'"
            )
        if matches:
            places[key] = matches[0]
    for key in required:
        if key not in places:
            header = ", ".join(name[:20] for name in names[:12])
            raise TrajectoryError(
                f"line {line} names no column {key} (found: {header}); allowed names: "
                f"{', '.join(_ALIASES[key])}, in the units of {key}"
            )
    for name in names:
        # A heading in radians must not be passed over as if there were none.
        if re.match(r"(heading|yaw|pitch|roll)\W*_?(m?rad|gon|grad|mil)", name):
            raise TrajectoryError(
                f"line {line} names a column '{name}'; heading, pitch and roll must be in "
                "degrees (heading_deg, pitch_deg, roll_deg)"
            )
    return places


def _wanted(required: Sequence[str], keys: Sequence[str]) -> str:
    others = [key for key in keys if key not in required]
    optional = f", and optionally {', '.join(others)}" if others else ""
    return f"{', '.join(required)}{optional}"
