"""Reader of the waypoints of flight plans: GPX, KML or CSV."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..files.writing import reason_of
from .manoeuvres import Array, TrajectoryError
from .track_file import parse
from .track_formats import gpx_document, kml_root, recognised

_COLUMNS = ("latitude_deg", "longitude_deg")
_MOST = 1000


def read_waypoints(path: Path) -> Array:
    """Return the waypoints (N, 2) of a file: latitude and longitude [deg].

    Longitudes are from −180° to 360°. Heights and times are ignored.

    In a GPX file the points of routes are read. If it has no routes, the waypoints are read. If it
    has neither, the points of tracks are read. In a KML file the points are read. If it has no
    points, the vertices of lines are read.

    Raises TrajectoryError if the file is invalid; the message states the place, the value and the
    allowed values.
    """
    try:
        content = path.read_bytes()
    except OSError as error:
        raise TrajectoryError(f"{path} cannot be read: {reason_of(error)}") from None
    try:
        return _checked(_places(content))
    except TrajectoryError as error:
        raise TrajectoryError(f"{path} {error}") from None


def _places(content: bytes) -> Array:
    kind, text = recognised(content)
    if kind == "gpx":
        document = gpx_document(text)
        routes = [point for route in document.routes for point in route.points]
        tracks = [p for track in document.tracks for part in track.segments for p in part.points]
        points = routes or document.waypoints or tracks
        places = [(point.latitude, point.longitude) for point in points]
        return np.array(places, dtype=float).reshape(-1, 2)
    if kind == "kml":
        return _kml(text)
    if kind != "csv":
        raise TrajectoryError("is a receiver log; waypoints are read from GPX, KML or CSV")
    columns, _, _ = parse(content, _COLUMNS, fewest=1)
    return np.stack([columns[key] for key in _COLUMNS], axis=1)


def _kml(text: str) -> Array:
    root = kml_root(text)
    for kind in ("Point", "LineString"):
        texts = [
            place
            for each in root.iter(kind)
            for place in (each.findtext("coordinates") or "").split()
        ]
        if texts:
            break
    places = np.empty((len(texts), 2))
    for number, place in enumerate(texts, 1):
        try:
            longitude, latitude = map(float, place.split(",")[:2])
        except ValueError:
            raise TrajectoryError(
                f"waypoint {number} is {place[:40]!r} and must be longitude and latitude"
            ) from None
        places[number - 1] = latitude, longitude
    return places


def _checked(places: Array) -> Array:
    """Return valid waypoints without consecutive duplicates.

    Raises TrajectoryError if a waypoint is invalid, or if there are too few or too many.
    """
    if len(places) > _MOST:
        raise TrajectoryError(f"has {len(places)} waypoints; at most {_MOST} are allowed")
    good = np.isfinite(places).all(axis=-1) & (np.abs(places) <= [89.0, 360.0]).all(axis=-1)
    if not good.all():
        n = int(np.argmin(good))
        raise TrajectoryError(
            f"waypoint {n + 1} is at latitude {places[n, 0]:g}°, longitude {places[n, 1]:g}°; "
            "allowed are ±89° and ±360°"
        )
    again = np.zeros(len(places), dtype=bool)
    again[1:] = (places[1:] == places[:-1]).all(axis=-1)
    if len(places) - again.sum() < 2:
        raise TrajectoryError("has fewer than two waypoints; a flight needs at least two")
    places = places[~again]
    places[places[:, 1] < -180.0, 1] += 360.0
    return places
