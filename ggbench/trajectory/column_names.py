"""Names and units of the columns of a track file or of a recorded flight."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

from ..gravity.unit_names import examples_for, factor_to_key, unit_at_end, without_unit
from .manoeuvres import TrajectoryError

_FEWEST_KNOWN = 3  # names of a preset by which its files are known

Names = Mapping[str, Sequence[str]]
"""Names of a file's columns by key, the preferred one first; a unit may follow in brackets."""


def _axes(key: str, name: str, axes: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Return the column names of x, y and z by key; ``{}`` is replaced by the axis."""
    return {key.format(axis): (name.format(own),) for axis, own in zip("xyz", axes, strict=True)}


_RATE, _FORCE = "angular_rate_{}_radps", "specific_force_{}_mps2"
PRESETS: Mapping[str, Names] = {
    "euroc": {
        "time_s": ("timestamp [ns]",),
        **_axes(_RATE, "w_RS_S_{} [rad s^-1]", "xyz"),
        **_axes(_FORCE, "a_RS_S_{} [m s^-2]", "xyz"),
    },
    "px4": {
        "time_s": ("timestamp [us]",),
        **_axes(_RATE, "gyro_rad[{}]", "012"),
        **_axes(_FORCE, "accelerometer_m_s2[{}]", "012"),
        "latitude_deg": ("latitude_deg", "lat [1e-7 deg]"),
        "longitude_deg": ("longitude_deg", "lon [1e-7 deg]"),
        "height_m": ("altitude_ellipsoid_m", "alt_ellipsoid [mm]"),
    },
    "ros": {
        "time_s": ("%time [ns]",),
        **_axes(_RATE, "field.angular_velocity.{}", "xyz"),
        **_axes(_FORCE, "field.linear_acceleration.{}", "xyz"),
        "latitude_deg": ("field.latitude",),
        "longitude_deg": ("field.longitude",),
        "height_m": ("field.altitude",),
    },
}
"""Columns of EuRoC MAV, of PX4's sensor_combined and vehicle_gps_position, of ``rostopic echo``."""


class Place(NamedTuple):
    """Column of a file: index, name and unit.

    The key of a column is its standard name, for example ``height_m``. ``factor`` converts numbers
    from the unit of the file to the unit of the key. ``stated`` is True if the user or the column
    name states the unit of the file.
    """

    at: int
    name: str
    factor: float
    stated: bool


def names_of(columns: str | Mapping[str, str] | None) -> Names:
    """Return the column names of a file by key.

    A key is the standard name of a column, for example ``height_m``. ``columns`` is the name of a
    preset, or a mapping of keys to column names. The result is empty if it is None.

    Raises TrajectoryError if the preset does not exist.
    """
    if columns is None:
        return {}
    if isinstance(columns, str):
        if columns not in PRESETS:
            raise TrajectoryError(
                f"columns is {columns!r} and must be {', '.join(PRESETS)}, or a table of names"
            )
        return PRESETS[columns]
    return {key: (name,) for key, name in columns.items()}


def plain_names(names: Names) -> set[str]:
    """Return the column names in lower case, both with and without the text in brackets.

    They serve to recognise the line of a file that contains the names.
    """
    return {
        part.casefold()
        for options in names.values()
        for name in options
        for part in (name.partition("[")[0].strip(), name)
    }


def find(
    key: str, columns: Sequence[str], names: Names, where: str, needed: bool = True
) -> Place | None:
    """Return the column for a key, or None if the file has no such column.

    A key is the standard name of a column, for example ``height_m``. Its suffix states the target
    unit. The unit of the column is the unit in brackets after the column name. Without brackets it
    is the unit at the end of the column name, as in ``alt_ft``.

    Parameters
    ----------
    key : standard name of the column.
    columns : column names of the file, in lower case.
    names : column names by key. If a key has no entry, its column name is the key itself.
    where : description of the line with the names, for messages.
    needed : whether a missing column is an error. If ``names`` has no entry for the key, a missing
        column is never an error.

    Raises
    ------
    TrajectoryError
        If a needed column is missing, or if a column has a unit of another quantity.
    """
    for name in names.get(key, (key,)):
        if (match := _matching(name.casefold(), columns)) is None:
            continue
        at, unit = match
        if not unit and columns[at] != key:
            unit = unit_at_end(columns[at], key)
        factor = factor_to_key(unit, key) if unit else 1.0
        if factor is None:
            raise TrajectoryError(
                f"{where} names a column '{columns[at]}' in '{unit}'; allowed units of {key}: "
                f"{examples_for(key)}"
            )
        return Place(at, columns[at], factor, bool(unit))
    if key in names and needed:
        header = ", ".join(column[:30] for column in columns[:16])
        raise TrajectoryError(
            f"{where} names no column {' or '.join(map(repr, names[key]))} for {key} "
            f"(found: {header})"
        )
    return None


def _matching(name: str, columns: Sequence[str]) -> tuple[int, str] | None:
    """Return the index of the column with a name, and its unit; None if there is no such column.

    A unit in ``name`` has priority over a unit in the column name of the file.
    """
    if name in columns:
        return columns.index(name), without_unit(name)[1]
    bare, unit = without_unit(name)
    for spelling, own in ((name, ""), (bare, unit)):
        for at, column in enumerate(columns):
            plain, stated = without_unit(column)
            if spelling in (plain, column):
                return at, own or stated
    return None


def unused(names: Names, keys: Iterable[str]) -> list[str]:
    """Return the keys of ``names`` that are not in ``keys``."""
    return sorted(set(names) - set(keys))


def preset_of(columns: Sequence[str]) -> str:
    """Return the preset that matches the columns of a file; "" if none does."""
    plain = {without_unit(column)[0] for column in columns} | set(columns)
    for preset, names in PRESETS.items():
        own = plain_names({key: options for key, options in names.items() if key not in options})
        if len(own & plain) >= _FEWEST_KNOWN:
            return preset
    return ""
