"""Reader of tracks from receiver logs: NMEA 0183, RTKLIB, CSRS-PPP, NovAtel."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

from ..errors import text_of
from .csv_text import iso_seconds
from .manoeuvres import TrajectoryError

_DAY = 86_400.0
_WEEK = 7.0 * _DAY
FORMATS = {
    "nmea": re.compile(rb"(?:^|[\s,\\\\])[$!][A-Z]{2}[A-Z]{3},", re.MULTILINE),
    "pos": re.compile(
        rb"\A(?!%time\b)(?:%[^\n]*\n)*?"
        rb"%[^\n]*(?:program *:|RTKLIB|GPST|UTC|JST|lat/lon|x/y/z|e/n/u)"
    ),
    "csrs": re.compile(rb"\AHDR GRP|^DIR +FRAME +STN", re.MULTILINE),
    "novatel": re.compile(rb"^#[A-Z0-9]+A,[^;\r\n]*;", re.MULTILINE),
}
"""Pattern in the first bytes of a file, by format."""
_GGA = re.compile(r"\$[A-Z]{2}GGA,[^$*\r\n]*(?:\*[0-9A-Fa-f]{2})?")
_NO_FIX = {"0": "without a fix", "6": "estimated", "7": "manual", "8": "simulated"}
"""Quality indicators of GGA sentences without a measured position, with descriptions."""
_MOST_DAMAGED = 0.1
"""Largest allowed fraction of damaged sentences, which are omitted."""
_POS_DATUM = re.compile(r"lat/lon/height=(\w+)")
_CSRS_NAMES = (
    "YEAR-MM-DD",
    "HR:MN:SS.SS",
    "LATDD",
    "LATMN",
    "LATSS",
    "LONDD",
    "LONMN",
    "LONSS",
    "HGT(m)",
)
_NOVATEL = {"INSPVAA": 0, "INSPVAXA": 0, "INSPVASA": 0, "BESTPOSA": 1, "BESTGNSSPOSA": 1}
"""NovAtel logs with positions, the preferred first; 1 for heights above sea level, else 0."""


class Fix(NamedTuple):
    """Position in a receiver log: time [s], latitude and longitude [deg], height [m].

    The sum ``height`` + ``geoid`` [m] is the height above the ellipsoid. ``geoid`` is 0 if
    ``height`` is ellipsoidal. It is None if ``height`` is above sea level and the log states no
    geoid height. ``place`` describes the line of the log, for messages. ``states_geoid`` is True
    for formats whose geoid heights are compared with EGM2008 (NMEA 0183 and GPX).
    """

    time: float
    latitude: float
    longitude: float
    height: float
    geoid: float | None
    place: str
    states_geoid: bool = False


Found = tuple[list[Fix], str]
"""Positions of a file, and a remark on omitted lines."""


def _nmea(text: str) -> Found:
    """Return the fixes of GGA sentences; a day is added where the time of day decreases.

    Other text, such as TAG blocks or time stamps, may precede a sentence on its line. Checksums may
    be missing from all sentences. Damaged sentences and sentences without a fix are omitted and
    counted.
    """
    fixes: list[Fix] = []
    left_out: Counter[str] = Counter()
    damaged: list[tuple[int, str]] = []
    sentences = [
        (number, match[0])
        for number, line in enumerate(text.splitlines(), 1)
        for match in _GGA.finditer(line)
    ]
    summed = any("*" in sentence for _, sentence in sentences)
    for number, sentence in sentences:
        try:
            match = _parsed(sentence, summed)
            quality = str(match.gps_qual if match.gps_qual is not None else 0)
            if quality in _NO_FIX:
                left_out[_NO_FIX[quality]] += 1
            else:
                fixes.append(_gga(match, f"line {number}", fixes))
        except Exception as error:  # whatever a damaged sentence makes of itself
            damaged.append((number, _reason(error)))
    if damaged and damaged[-1][0] == sentences[-1][0]:
        damaged.pop()  # the log ends in it
    if damaged and len(damaged) > _MOST_DAMAGED * (len(fixes) + len(damaged)):
        number, reason = damaged[0]
        raise TrajectoryError(
            f"{len(damaged)} of {len(fixes) + len(damaged)} GGA sentences with a fix cannot be "
            f"read, the first on line {number} ({reason}); at most {_MOST_DAMAGED:.0%} may be "
            "damaged"
        )
    if not fixes:
        found_only = ", ".join(f"{count} {what}" for what, count in left_out.items())
        raise TrajectoryError(
            "has no GGA sentence with a fix (time, position and height)"
            + (f" (only {found_only})" if found_only else "")
        )
    del left_out[_NO_FIX["0"]]  # as before the first fix
    if damaged:
        number, reason = damaged[0]
        left_out[f"damaged (first: line {number}, {reason})"] = len(damaged)
    counts = ", ".join(f"{count} {what}" for what, count in left_out.items())
    return fixes, f"GGA sentences left out: {counts}" if counts else ""


def _parsed(sentence: str, summed: bool) -> Any:
    """Return a parsed sentence; ``summed`` states whether a checksum is required."""
    import pynmea2  # slow to load

    return pynmea2.parse(sentence, check=summed)


def _reason(error: Exception) -> str:
    """Return the reason of an error; pynmea2 raises pairs of a reason and the sentence."""
    first = error.args[0] if error.args else error
    return str(first[0]) if isinstance(first, tuple) and first else text_of(error)


def _gga(sentence: Any, place: str, before: Sequence[Fix]) -> Fix:
    if not (sentence.lat and sentence.lon):
        raise ValueError("it has no position")
    if sentence.lat_dir not in ("N", "S") or sentence.lon_dir not in ("E", "W"):
        raise ValueError("its position has no N or S, or no E or W")
    clock = sentence.timestamp
    time = 3600.0 * clock.hour + 60.0 * clock.minute + clock.second + 1e-6 * clock.microsecond
    if before:
        days, of_day = divmod(before[-1].time, _DAY)
        time += _DAY * (days + (time < of_day - 0.5 * _DAY))
    if sentence.altitude_units != "M":
        raise ValueError("its height is not in metres")
    if sentence.geo_sep and sentence.geo_sep_units not in ("M", "", None):
        raise ValueError("its geoid height is not in metres")
    separation = float(sentence.geo_sep) if sentence.geo_sep else None
    position = sentence.latitude, sentence.longitude, float(sentence.altitude)
    return Fix(time, *position, separation, place, states_geoid=True)


def _pos(text: str) -> Found:
    """Return the positions of an RTKLIB solution file (``.pos``)."""
    lines = text.splitlines()
    heads = [line for line in lines if line.startswith("%")]
    head = next((line for line in reversed(heads) if re.match(r"%\s+(GPST|UTC|JST)", line)), "")
    if not all(name in head for name in ("latitude(deg)", "longitude(deg)", "height(m)")):
        raise TrajectoryError(
            "has no header with latitude(deg), longitude(deg), height(m); RTKLIB writes it with "
            "out-solformat = llh, out-degform = deg and out-outhead = on"
        )
    datum = next((match[1] for line in heads if (match := _POS_DATUM.search(line))), "WGS84")
    if datum != "WGS84":
        raise TrajectoryError(
            f"is in the datum {datum}; only WGS84 is allowed: compute it with out-solformat = llh "
            "in WGS84"
        )
    above_sea = any("/geodetic" in line for line in heads)
    fixes = []
    for number, line in enumerate(lines, 1):
        if line.startswith("%") or not line.strip():
            continue
        cells = re.split(r"[\s,;]+", line.strip())
        try:
            place = [float(cell) for cell in cells[2:5]]
            time = _pos_time(cells[0], cells[1])
            latitude, longitude, height = place
        except (ValueError, IndexError):
            raise TrajectoryError(
                f"line {number} is {line[:60]!r} and must contain time, latitude, longitude and "
                "height"
            ) from None
        geoid = None if above_sea else 0.0
        fixes.append(Fix(time, latitude, longitude, height, geoid, f"line {number}"))
    return fixes, ""


def _pos_time(first: str, second: str) -> float:
    """Convert ``2024/05/01 10:00:00.000`` or GPS ``week seconds`` to seconds."""
    if "/" not in first:
        return _WEEK * int(first) + float(second)
    return float(iso_seconds([f"{first.replace('/', '-')}T{second}"])[0])


def _csrs(text: str) -> Found:
    """Return the positions of a CSRS-PPP solution, with ellipsoidal heights.

    The rows may be in reverse order of time.
    """
    lines = text.splitlines()
    head = next((line.split() for line in lines if line.split()[:2] == ["DIR", "FRAME"]), [])
    if not all(name in head for name in _CSRS_NAMES):
        raise TrajectoryError(
            "is a solution of CSRS-PPP without the line of column names, DIR FRAME STN to HGT(m)"
        )
    at = [head.index(name) for name in _CSRS_NAMES]
    fixes = []
    for number, line in enumerate(lines, 1):
        cells = line.split()
        if not cells or cells[0] in ("HDR", "DIR", "NOW"):
            continue
        try:
            date, clock, *angles, height = (cells[n] for n in at)
            time = float(iso_seconds([f"{date}T{clock}"])[0])
            latitude, longitude = _sexagesimal(angles[:3]), _sexagesimal(angles[3:])
            fixes.append(Fix(time, latitude, longitude, float(height), 0.0, f"line {number}"))
        except (ValueError, IndexError):
            raise TrajectoryError(
                f"line {number} is {line[:60]!r} and must contain date, clock, latitude, "
                "longitude and height of CSRS-PPP"
            ) from None
    if len(fixes) > 1 and fixes[0].time > fixes[-1].time:
        fixes.reverse()
    return fixes, ""


def _sexagesimal(cells: Sequence[str]) -> float:
    """Convert degrees, minutes and seconds to degrees; the sign of ``-0`` degrees is kept."""
    degrees, minutes, seconds = (float(cell) for cell in cells)
    size = abs(degrees) + minutes / 60.0 + seconds / 3600.0
    return -size if cells[0].startswith("-") else size


def _novatel(text: str) -> Found:
    """Return the positions of NovAtel ASCII logs; only the preferred kind of log is read."""
    rows: dict[str, list[tuple[int, list[str], list[str]]]] = {}
    others: Counter[str] = Counter()
    for number, line in enumerate(text.splitlines(), 1):
        header, _, log = line.strip().partition(";")
        if not header.startswith("#") or not log:
            continue
        cells = header[1:].split(",")
        others[cells[0]] += 1
        if cells[0] in _NOVATEL:
            rows.setdefault(cells[0], []).append((number, cells, log.partition("*")[0].split(",")))
    kind = next((name for name in _NOVATEL if name in rows), None)
    if kind is None:
        raise TrajectoryError(
            f"is a NovAtel log with {', '.join(others)}; positions are read from "
            f"{', '.join(_NOVATEL)}"
        )
    fixes = []
    for number, head, body in rows[kind]:
        try:
            fix = _of_novatel(head, body, above_sea=_NOVATEL[kind] == 1, place=f"line {number}")
        except (ValueError, IndexError):
            raise TrajectoryError(
                f"line {number} is a NovAtel log {kind} that cannot be read"
            ) from None
        if fix is not None:
            fixes.append(fix)
    without = len(rows[kind]) - len(fixes)
    return fixes, f"{without} of its logs {kind} have no solution" if without else ""


def _of_novatel(
    head: Sequence[str], body: Sequence[str], above_sea: bool, place: str
) -> Fix | None:
    """Return the position of a NovAtel log; None if it has no solution."""
    if not above_sea:  # week, seconds, latitude, longitude, ellipsoidal height, ..., status
        week, seconds, latitude, longitude, height = map(float, body[:5])
        if body[11] in ("INS_INACTIVE", "INS_ALIGNING", "WAITING_INITIALPOS"):
            return None
        return Fix(_WEEK * week + seconds, latitude, longitude, height, 0.0, place)
    if body[0] != "SOL_COMPUTED":
        return None
    week, seconds = float(head[5]), float(head[6])
    latitude, longitude, height, geoid = map(float, body[2:6])
    return Fix(_WEEK * week + seconds, latitude, longitude, height, geoid, place)


READERS: Mapping[str, Callable[[str], Found]] = {
    "nmea": _nmea,
    "pos": _pos,
    "csrs": _csrs,
    "novatel": _novatel,
}
"""Readers by format."""
