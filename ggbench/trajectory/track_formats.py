"""Detection and reading of track formats: GPX, KML, receiver logs, CSV.

The content of a file determines the format. KML is read as plain XML, because only ``gx:Track`` and
points with a time are needed.
"""

from __future__ import annotations

import datetime
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any
from xml.etree import ElementTree

import numpy as np

from ..errors import text_of
from . import receiver_logs
from .csv_text import iso_seconds
from .manoeuvres import Array, TrajectoryError
from .receiver_logs import Fix
from .track_file import FEWEST_ROWS, parse

Place = Callable[[int], str]
"""Function that returns the position of a row in its file, for messages: ``line 5``."""
_SEA_LEVEL = (
    "its heights are above sea level: the geoid height of EGM2008 to degree 120, {}, was added "
    "(accurate to a few metres)"
)
_FORMATS = {
    "gpx": re.compile(rb"<(\w+:)?gpx[\s>]"),
    "kml": re.compile(rb"<(\w+:)?kml[\s>]"),
    **receiver_logs.FORMATS,
}
"""Pattern in the first bytes of a file, by format."""
_GEOID_DIFFERENCE = 15.0
"""Difference from EGM2008 beyond which stated geoid heights are doubtful [m]; receivers have coarse
tables."""
_HEAD = 65_536


@dataclass(frozen=True)
class Rows:
    """Rows of a track file: columns (N,) by name, and a remark on heights.

    ``place`` is a function that returns the place of a row in the file, for messages.
    """

    columns: dict[str, Array]
    place: Place
    remark: str = ""


def rows_of(content: bytes, columns: str | Mapping[str, str] | None = None) -> Rows:
    """Return the rows of a track file.

    ``columns`` is for CSV files only. It is the name of a preset, or maps standard names to the
    column names of the file.

    Raises TrajectoryError if the file is invalid; the message states the place, the value and the
    allowed values.
    """
    readers = {"gpx": _gpx, "kml": _kml, **receiver_logs.READERS}
    name, text = recognised(content)
    if name in readers and columns is not None:
        raise TrajectoryError(
            f"is a {name.upper()} file, which has no column names: remove the key 'columns'"
        )
    if name in readers:
        return _checked(*readers[name](text))
    read, first, level = parse(content, columns=columns)
    remark = ""
    if level == "sea level":
        read["height_m"], remark = _above_ellipsoid(
            read["height_m"], read["latitude_deg"], read["longitude_deg"]
        )
    elif level:
        remark = (
            f"the heights are above {level} by their name, but were taken as heights above the "
            "ellipsoid"
        )
    return Rows(read, lambda n: f"line {first + n}", remark)


def recognised(content: bytes) -> tuple[str, str]:
    """Return the format and the text of a file; ("csv", "") if no other format is recognised.

    Raises TrajectoryError if the file is a zip archive. The error is also raised if a file of a
    recognised format, except NMEA 0183, is not UTF-8 text.
    """
    head = content[:_HEAD].removeprefix(b"\xef\xbb\xbf")
    for name, looks in _FORMATS.items():
        xml = name in ("gpx", "kml")
        if (not xml or head.lstrip()[:1] == b"<") and looks.search(head):
            try:
                # Receivers mix binary messages into NMEA; checksums find what they damage.
                wrong = "replace" if name == "nmea" else "strict"
                return name, content.decode("utf-8-sig", wrong)
            except UnicodeDecodeError:
                raise TrajectoryError("is not UTF-8 text") from None
    if content[:2] == b"PK":
        raise TrajectoryError("is a zip archive; unpack it (a .kmz holds a .kml)")
    return "csv", ""


_MOST_NAMESPACES = 100
"""Largest number of XML namespaces in a GPX file; usual files declare fewer than ten.

The computing time of gpxpy grows with the square of the number.
"""


def gpx_document(text: str) -> Any:
    """Return the parsed content of a GPX file.

    Raises TrajectoryError if the text is not valid GPX.
    """
    if (declared := text.count("xmlns")) > _MOST_NAMESPACES:
        raise TrajectoryError(
            f"declares {declared} XML namespaces; at most {_MOST_NAMESPACES} are allowed"
        )
    import gpxpy  # slow to load

    try:
        return gpxpy.parse(text)
    except Exception as error:  # whatever a damaged file makes of itself
        raise TrajectoryError(f"cannot be read as a GPX file: {text_of(error)}") from None


def kml_root(text: str) -> ElementTree.Element:
    """Return the root element of a KML file, with namespaces removed.

    Raises TrajectoryError if the text is not valid XML.
    """
    try:
        root = ElementTree.fromstring(text.encode())
    except (ElementTree.ParseError, ValueError, RecursionError) as error:
        raise TrajectoryError(f"cannot be read as a KML file: {text_of(error)}") from None
    for element in root.iter():
        element.tag = str(element.tag).rpartition("}")[2]
    return root


def _checked(fixes: Sequence[Fix], remark: str) -> Rows:
    """Return the rows of positions, with heights above the ellipsoid.

    ``remark`` describes omitted parts of the file.
    """
    if len(fixes) < FEWEST_ROWS:
        raise TrajectoryError(f"has {len(fixes)} positions; a track needs at least {FEWEST_ROWS}")
    numbers = np.array([fix[:4] for fix in fixes], dtype=float)
    bad = ~np.isfinite(numbers).all(axis=1)
    if bad.any():
        raise TrajectoryError(
            f"{fixes[int(bad.argmax())].place}: its time, position or height is not a number"
        )
    times, latitude, longitude, height = numbers.T
    if all(fix.geoid is not None for fix in fixes):
        height = height + np.array([fix.geoid for fix in fixes], dtype=float)
        remark = "; ".join(filter(None, (remark, _doubtful_geoid(fixes, latitude, longitude))))
    else:
        height, of_heights = _above_ellipsoid(height, latitude, longitude)
        remark = "; ".join(filter(None, (remark, of_heights)))
    columns = {
        "time_s": times - times[0],
        "latitude_deg": latitude,
        "longitude_deg": longitude,
        "height_m": height,
    }
    return Rows(columns, lambda n: fixes[n].place, remark)


def _above_ellipsoid(height: Array, latitude: Array, longitude: Array) -> tuple[Array, str]:
    """Convert heights above sea level (N,) [m] to ellipsoidal heights; also return a remark."""
    if not (np.abs(latitude) <= 90.0).all():
        return height, ""  # the track is refused for that
    from ..maps.geoid import geoid_heights  # loads a model, which few tracks need

    geoid = geoid_heights(latitude, longitude)
    return height + geoid, _SEA_LEVEL.format(f"{geoid.mean():.0f} m on average")


def _doubtful_geoid(fixes: Sequence[Fix], latitude: Array, longitude: Array) -> str:
    """Return a remark if the geoid heights of a file are far from those of EGM2008, else ""."""
    stated = np.array([fix.geoid for fix in fixes], dtype=float)
    if not fixes[0].states_geoid or not (np.abs(latitude) <= 90.0).all():
        return ""
    from ..maps.geoid import geoid_heights

    expected = float(geoid_heights(latitude, longitude).mean())
    if abs(float(stated.mean()) - expected) <= _GEOID_DIFFERENCE:
        return ""
    return (
        f"the geoid heights in the file are {stated.mean():.0f} m on average, those of EGM2008 "
        f"{expected:.0f} m. If the heights in the file are above sea level, the converted heights "
        "are wrong by the difference"
    )


def _gpx(text: str) -> tuple[list[Fix], str]:
    """Return the points of the tracks of a GPX file, in their order."""
    document = gpx_document(text)
    points = [p for track in document.tracks for part in track.segments for p in part.points]
    if not points and (document.waypoints or document.routes):
        raise TrajectoryError(
            "has waypoints or routes but no track (points with times); 'ggbench new scenario "
            "NAME --map MAP --waypoints FILE' plans a flight through waypoints"
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
                states_geoid=True,
            )
        )
    return fixes, ""


def _kml(text: str) -> tuple[list[Fix], str]:
    """Return the positions of the gx:Tracks of a KML file; without these, of points with times."""
    root = kml_root(text)
    above = {child: parent for parent in root.iter() for child in parent}
    stamped: list[tuple[str, str]] = []
    for track in root.iter("Track"):
        times, coordinates = _texts(track, "when"), _texts(track, "coord")
        if not times and not coordinates:
            continue  # which the standard allows
        _require_absolute(track, above)
        if len(times) != len(coordinates):
            raise TrajectoryError(
                f"a gx:Track has {len(times)} times and {len(coordinates)} positions; it must "
                "have a <when> for each <gx:coord>"
            )
        stamped += zip(times, (",".join(each.split()) for each in coordinates), strict=True)
    for mark in root.iter("Placemark") if not stamped else ():
        point, time = mark.find("Point"), mark.find("TimeStamp/when")
        if point is not None and time is not None:
            _require_absolute(point, above)
            place = (_texts(point, "coordinates") or [""])[0]
            stamped.append(((time.text or "").strip(), place))
    # An unknown place or time is an empty element: it holds the place of its partner.
    whole = [(when, place) for when, place in stamped if when and place]
    if not whole:
        raise TrajectoryError(
            "has no times; a track is a gx:Track with <when> and <gx:coord>, or points with a "
            "TimeStamp each"
        )
    seconds = iso_seconds(when for when, _ in whole)
    fixes = [
        Fix(time, *_degrees(place, number), None, f"position {number}")
        for number, (time, (_, place)) in enumerate(zip(seconds, whole, strict=True), 1)
    ]
    left_out = len(stamped) - len(whole)
    return fixes, f"{left_out} empty positions are left out" if left_out else ""


def _texts(element: ElementTree.Element, name: str) -> list[str]:
    return [(each.text or "").strip() for each in element.iter(name)]


def _require_absolute(
    element: ElementTree.Element, above: Mapping[ElementTree.Element, ElementTree.Element]
) -> None:
    """Raise TrajectoryError if heights of a track or a point are not above sea level.

    A gx:Track inherits the mode of its gx:MultiTrack.
    """
    modes = [element.findtext("altitudeMode")]
    parent = above.get(element)
    if parent is not None and parent.tag == "MultiTrack":
        modes.append(parent.findtext("altitudeMode"))
    mode = next((mode.strip() for mode in modes if mode and mode.strip()), "clampToGround")
    if mode != "absolute":
        raise TrajectoryError(
            f"its altitudeMode is {mode[:40]!r}; heights above sea level are needed, 'absolute'"
        )


def _degrees(place: str, number: int) -> tuple[float, float, float]:
    """Return latitude, longitude and height from KML text ``longitude,latitude,height``."""
    try:
        longitude, latitude, height = map(float, place.split(","))
    except ValueError:
        raise TrajectoryError(
            f"position {number} is {place[:40]!r} and must be longitude, latitude and height"
        ) from None
    return latitude, longitude, height
