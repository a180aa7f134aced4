"""Tracks in the formats of receivers and planners: GPX, KML, NMEA 0183, RTKLIB; or CSV.

The content says which format a file has. KML is read as plain XML, for all that is needed of it is
``gx:Track`` and points with a time.
"""

from __future__ import annotations

import datetime
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple
from xml.etree import ElementTree

import numpy as np

from ..errors import text_of
from .csv_text import iso_seconds
from .manoeuvres import Array, TrajectoryError
from .track_file import FEWEST_ROWS, parse

Place = Callable[[int], str]
"""Where a row is in its file, in words: ``line 5``."""
_SEA_LEVEL = (
    "its heights are above sea level: the geoid of EGM2008 to degree 120, {}, was added (within a "
    "few metres)"
)
_DAY = 86_400.0
_FORMATS = {
    "gpx": re.compile(rb"<(\w+:)?gpx[\s>]"),
    "kml": re.compile(rb"<(\w+:)?kml[\s>]"),
    "nmea": re.compile(rb"\s*[$!][A-Z]{2,5},?"),
    "pos": re.compile(rb"%"),
}
"""How the head of a file of each format looks."""
_HEAD = 4096


@dataclass(frozen=True)
class Rows:
    """Columns of a track (N,) by name, where its rows are, and what was made of its heights."""

    columns: dict[str, Array]
    place: Place
    remark: str = ""


class Fix(NamedTuple):
    """A position: seconds, degrees, metres above the ellipsoid or above sea level, and its line."""

    time: float
    latitude: float
    longitude: float
    height: float
    geoid: float | None
    place: str


def rows_of(content: bytes) -> Rows:
    """Return the rows of a track.

    Raises TrajectoryError with a sentence that names the place, what was found and what is allowed.
    """
    readers = {"gpx": _gpx, "kml": _kml, "nmea": _nmea, "pos": _pos}
    name, text = recognised(content)
    if name in readers:
        return _checked(readers[name](text))
    columns, first = parse(content)
    return Rows(columns, lambda n: f"line {first + n}")


def recognised(content: bytes) -> tuple[str, str]:
    """Return which format a file has, and its text; "csv" and no text if none of the others.

    Raises TrajectoryError if it is an archive, or no text although it begins like one.
    """
    head = content[:_HEAD].removeprefix(b"\xef\xbb\xbf")
    for name, looks in _FORMATS.items():
        xml = name in ("gpx", "kml")
        if looks.search(head) if xml and head.lstrip()[:1] == b"<" else looks.match(head):
            try:
                return name, content.decode("utf-8-sig")
            except UnicodeDecodeError:
                raise TrajectoryError("is not UTF-8 text") from None
    if content[:2] == b"PK":
        raise TrajectoryError("is a zip archive; unpack it (a .kmz holds a .kml)")
    return "csv", ""


def gpx_document(text: str) -> Any:
    """Return what a GPX file holds; raises TrajectoryError if it cannot be read."""
    import gpxpy  # slow to load

    try:
        return gpxpy.parse(text)
    except Exception as error:  # whatever a damaged file makes of itself
        raise TrajectoryError(f"is no GPX file that can be read: {text_of(error)}") from None


def kml_root(text: str) -> ElementTree.Element:
    """Return the elements of a KML file, their names without a namespace.

    Raises TrajectoryError if it cannot be read.
    """
    try:
        root = ElementTree.fromstring(text.encode())
    except (ElementTree.ParseError, ValueError, RecursionError) as error:
        raise TrajectoryError(f"is no KML file that can be read: {text_of(error)}") from None
    for element in root.iter():
        element.tag = str(element.tag).rpartition("}")[2]
    return root


def _checked(fixes: Sequence[Fix]) -> Rows:
    """Return the rows of positions, with heights above the ellipsoid."""
    if len(fixes) < FEWEST_ROWS:
        raise TrajectoryError(f"has {len(fixes)} positions; a track needs at least {FEWEST_ROWS}")
    numbers = np.array([fix[:4] for fix in fixes], dtype=float)
    bad = ~np.isfinite(numbers).all(axis=1)
    if bad.any():
        raise TrajectoryError(
            f"{fixes[int(bad.argmax())].place}: its time, its place or its height is no number"
        )
    times, latitude, longitude, height = numbers.T
    remark = ""
    if all(fix.geoid is not None for fix in fixes):
        height = height + np.array([fix.geoid for fix in fixes], dtype=float)
    elif (np.abs(latitude) <= 90.0).all():  # else it is refused for that
        from ..maps.geoid import geoid_heights  # loads a model, which few tracks need

        geoid = geoid_heights(latitude, longitude)
        remark = _SEA_LEVEL.format(f"{geoid.mean():.0f} m on average")
        height = height + geoid
    columns = {
        "time_s": times - times[0],
        "latitude_deg": latitude,
        "longitude_deg": longitude,
        "height_m": height,
    }
    return Rows(columns, lambda n: fixes[n].place, remark)


def _gpx(text: str) -> list[Fix]:
    """Return the points of the tracks of a GPX file, in their order."""
    document = gpx_document(text)
    points = [p for track in document.tracks for part in track.segments for p in part.points]
    if not points and (document.waypoints or document.routes):
        raise TrajectoryError(
            "has waypoints or routes and no track; a track has points with times, and "
            "'ggbench new scenario NAME --map MAP --waypoints FILE' makes a flight through others"
        )
    fixes = []
    for number, point in enumerate(points, 1):
        place = f"track point {number}"
        if point.time is None:
            raise TrajectoryError(f"{place} has no time; every point needs <time>")
        if point.elevation is None:
            raise TrajectoryError(f"{place} has no height; every point needs <ele>")
        time = point.time if point.time.tzinfo else point.time.replace(tzinfo=datetime.UTC)
        fixes.append(
            Fix(
                time.timestamp(),
                point.latitude,
                point.longitude,
                point.elevation,
                point.geoid_height,
                place,
            )
        )
    return fixes


def _kml(text: str) -> list[Fix]:
    """Return the places of a KML file: of its gx:Tracks, or else of its points with a time."""
    root = kml_root(text)
    whens: list[str] = []
    places: list[str] = []
    for track in root.iter("Track"):
        _require_absolute(track)
        times, coordinates = _texts(track, "when"), _texts(track, "coord")
        if len(times) != len(coordinates):
            raise TrajectoryError(
                f"a gx:Track has {len(times)} times and {len(coordinates)} places; it must have a "
                "<when> for each <gx:coord>"
            )
        whens += times
        places += [",".join(each.split()) for each in coordinates]
    for mark in root.iter("Placemark") if not whens else ():
        point, time = mark.find("Point"), mark.find("TimeStamp/when")
        if point is not None and time is not None:
            _require_absolute(point)
            whens.append(time.text or "")
            places += _texts(point, "coordinates")[:1] or [""]
    if not whens:
        raise TrajectoryError(
            "has no times; a track is a gx:Track with <when> and <gx:coord>, or points with a "
            "TimeStamp each"
        )
    return [
        Fix(time, *_degrees(place, number), None, f"place {number}")
        for number, (time, place) in enumerate(zip(iso_seconds(whens), places, strict=True), 1)
    ]


def _texts(element: ElementTree.Element, name: str) -> list[str]:
    return [(each.text or "").strip() for each in element.iter(name)]


def _require_absolute(element: ElementTree.Element) -> None:
    mode = (_texts(element, "altitudeMode") or ["clampToGround"])[0]
    if mode != "absolute":
        raise TrajectoryError(
            f"its altitudeMode is {mode[:40]!r}; heights above sea level are needed, 'absolute'"
        )


def _degrees(place: str, number: int) -> tuple[float, float, float]:
    """Return latitude, longitude and height of KML's ``longitude,latitude,height``."""
    try:
        longitude, latitude, height = map(float, place.split(","))
    except ValueError:
        raise TrajectoryError(
            f"place {number} is {place[:40]!r} and must be longitude, latitude and height"
        ) from None
    return latitude, longitude, height


def _nmea(text: str) -> list[Fix]:
    """Return the fixes of GGA sentences; days are counted where the time of day falls."""
    import pynmea2  # slow to load

    fixes: list[Fix] = []
    lines = text.splitlines()
    for number, line in enumerate(lines, 1):
        if not line.startswith("$") or line[3:6] != "GGA":
            continue
        try:
            found = pynmea2.parse(line, check=True)
            fixed = found.gps_qual is not None and int(found.gps_qual) > 0
            if fixed:
                fixes.append(_gga(found, f"line {number}", fixes))
        except Exception as error:  # whatever a damaged sentence makes of itself
            if number == len(lines):  # the log ends in it
                continue
            raise TrajectoryError(
                f"line {number} is a GGA sentence that cannot be read ({text_of(error)}); remove "
                "it if it is damaged"
            ) from None
    if not fixes:
        raise TrajectoryError("has no GGA sentence with a fix, which give time, place and height")
    return fixes


def _gga(found: Any, place: str, before: Sequence[Fix]) -> Fix:
    if not (found.lat and found.lon):
        raise ValueError("it has no place")
    clock = found.timestamp
    time = 3600.0 * clock.hour + 60.0 * clock.minute + clock.second + 1e-6 * clock.microsecond
    if before:
        days, of_day = divmod(before[-1].time, _DAY)
        time += _DAY * (days + (time < of_day - 0.5 * _DAY))
    if found.altitude_units != "M":
        raise ValueError("its height is not in metres")
    separation = float(found.geo_sep) if found.geo_sep else None
    return Fix(time, found.latitude, found.longitude, float(found.altitude), separation, place)


def _pos(text: str) -> list[Fix]:
    """Return the positions of a solution of RTKLIB."""
    lines = text.splitlines()
    heads = [line for line in lines if line.startswith("%")]
    head = next((line for line in reversed(heads) if re.match(r"%\s+(GPST|UTC|JST)", line)), "")
    if not all(name in head for name in ("latitude(deg)", "longitude(deg)", "height(m)")):
        raise TrajectoryError(
            "has no header with latitude(deg), longitude(deg), height(m); RTKLIB writes it with "
            "out-solformat = llh, out-degform = deg and out-outhead = on"
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
                f"line {number} is {line[:60]!r} and must have a time, latitude, longitude, height"
            ) from None
        geoid = None if above_sea else 0.0
        fixes.append(Fix(time, latitude, longitude, height, geoid, f"line {number}"))
    return fixes


def _pos_time(first: str, second: str) -> float:
    """Return the seconds of ``2024/05/01 10:00:00.000`` or of ``week seconds``."""
    if "/" not in first:
        return 7.0 * _DAY * int(first) + float(second)
    return float(iso_seconds([f"{first.replace('/', '-')}T{second}"])[0])
