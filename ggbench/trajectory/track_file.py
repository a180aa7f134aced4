"""The text of a track: a CSV file whose first line names its columns."""

from __future__ import annotations

import csv
import io
import math
import re
import warnings

import numpy as np
import pandas as pd

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
_REQUIRED = ("time_s", "latitude_deg", "longitude_deg", "height_m")


def parse(content: bytes) -> tuple[dict[str, Array], int]:
    """Return the known columns of a CSV text, and the number of the line of their first row.

    Columns may be separated by commas, semicolons or tabs; those whose names are not known are
    passed over.

    Raises
    ------
    TrajectoryError
        With a sentence that names the line, what was found and what is allowed.
    """
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = "\0"
    if "\0" in text:
        raise TrajectoryError("is not UTF-8 text; it must be a CSV file")
    text = text.replace('"', "")  # around fields; none of those that count needs them
    lines = text.replace("\r\n", "\n").replace("\r", "\n").rstrip().split("\n")
    top = next((n for n, line in enumerate(lines) if line.strip() and line[0] != "#"), None)
    if top is None:
        raise TrajectoryError("is empty; its first line must name the columns, " + _wanted())
    separator = max(",;\t", key=lines[top].count)
    names = [name.strip().lower() for name in lines[top].split(separator)]
    known = _columns(names, top + 1)
    for n in range(top + 1, len(lines)):
        if lines[n].count(separator) != len(names) - 1:
            found = lines[n].count(separator) + 1 if lines[n].strip() else 0
            hint = (
                "; a decimal comma is not understood, write 33.5"
                if separator == "," and found >= 2 * len(names) - 1
                else ""
            )
            raise TrajectoryError(
                f"line {n + 1} has {found} fields and line {top + 1} names {len(names)} columns"
                f"{hint}"
            )
    if len(lines) - top - 1 < FEWEST_ROWS:
        raise TrajectoryError(
            f"has {len(lines) - top - 1} rows; a track needs at least {FEWEST_ROWS}"
        )
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            table = pd.read_csv(
                io.StringIO("\n".join(lines[top + 1 :])),
                sep=separator,
                header=None,
                usecols=list(known.values()),
                skip_blank_lines=False,
                skipinitialspace=True,
                keep_default_na=False,
                na_values=[""],
                float_precision="round_trip",
                low_memory=False,
                quoting=csv.QUOTE_NONE,
            )
    except ValueError as error:
        raise TrajectoryError(f"is no table of numbers: {str(error).splitlines()[0]}") from None
    first = top + 2
    columns = {key: _numbers(table[at], key, first) for key, at in known.items()}
    bare = {"latitude", "lat", "longitude", "lon", "lng", "long"}.intersection(names)
    if bare and all(
        np.abs(columns[key]).max() <= limit
        for key, limit in (("latitude_deg", 0.5 * math.pi), ("longitude_deg", math.pi))
    ):
        raise TrajectoryError(
            "all of latitude and longitude could be radians; if they are degrees, name the columns "
            f"latitude_deg and longitude_deg instead of '{min(bare)}'"
        )
    return columns, first


def _columns(names: list[str], line: int) -> dict[str, int]:
    """Return where the known columns are."""
    known: dict[str, int] = {}
    for key, aliases in _ALIASES.items():
        found = [n for n, name in enumerate(names) if name in aliases]
        if len(found) > 1:
            raise TrajectoryError(
                f"line {line} names {key} twice, '{names[found[0]]}' and '{names[found[1]]}'"
            )
        if found:
            known[key] = found[0]
    for key in _REQUIRED:
        if key not in known:
            shown = ", ".join(name[:20] for name in names[:12])
            raise TrajectoryError(
                f"line {line} names no column {key} (found: {shown}); a column may be called "
                f"{', '.join(_ALIASES[key])}, and other units than those of {key} are not read"
            )
    for name in names:
        # A heading in radians must not be passed over as if there were none.
        if re.match(r"(heading|yaw|pitch|roll)\W*_?(m?rad|gon|grad|mil)", name):
            raise TrajectoryError(
                f"line {line} names a column '{name}'; heading, pitch and roll are read in degrees "
                "(heading_deg, pitch_deg, roll_deg)"
            )
    return known


def _wanted() -> str:
    return f"{', '.join(_REQUIRED)}, and heading_deg, pitch_deg, roll_deg if they are known"


def _numbers(column: pd.Series, key: str, first: int) -> Array:
    """Return a column as finite numbers."""
    if column.dtype.kind in "iuf":
        values = column.to_numpy(dtype=float)
    else:
        # As texts, for which a truth is no number.
        values = pd.to_numeric(column.astype(str), errors="coerce").to_numpy(dtype=float)
    bad = ~np.isfinite(values)
    if bad.any():
        n = int(np.argmax(bad))
        cell = column.iloc[n]
        found = "empty" if cell is None or cell != cell else f"'{str(cell)[:40]}'"
        hint = ""
        if re.fullmatch(r"\s*[-+]?\d+,\d+\s*", str(cell)):
            hint = "; a decimal comma is not understood, write 33.5"
        elif key == "time_s" and re.match(r"\s*\d+[-:/]", str(cell)):
            hint = "; a date or a time of day is not understood, give seconds"
        raise TrajectoryError(f"line {first + n}: {key} is {found} and must be a number{hint}")
    return values
