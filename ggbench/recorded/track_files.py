"""Corrected tracks as GPX and KML text, for map displays and route planners."""

from __future__ import annotations

from collections.abc import Mapping
from xml.etree import ElementTree

import numpy as np

from ..maps.geoid import geoid_heights

_KML = "http://www.opengis.net/kml/2.2"


def gpx_text(columns: Mapping[str, np.ndarray], name: str) -> str:
    """Return a corrected track as GPX 1.1 text.

    Parameters
    ----------
    columns : columns (K,) from :func:`.corrected.corrected`. Heights are converted to heights above
        sea level (EGM2008). Times are omitted, because the INS clock is not UTC.
    name : name of the track.
    """
    from gpxpy import gpx  # not at the top: few commands write tracks

    segment = gpx.GPXTrackSegment()
    for latitude, longitude, height in _places(columns):
        segment.points.append(gpx.GPXTrackPoint(latitude, longitude, elevation=height))
    track = gpx.GPXTrack(name=name)
    track.segments.append(segment)
    document = gpx.GPX()
    document.creator = "ggbench"
    document.tracks.append(track)
    return str(document.to_xml(version="1.1"))


def kml_text(columns: Mapping[str, np.ndarray], name: str) -> str:
    """Return a corrected track as a line in KML 2.2 text.

    ``columns`` (K,) and ``name`` are as for :func:`gpx_text`.
    """
    ElementTree.register_namespace("", _KML)
    root = ElementTree.Element(f"{{{_KML}}}kml")
    mark = ElementTree.SubElement(root, f"{{{_KML}}}Placemark")
    ElementTree.SubElement(mark, f"{{{_KML}}}name").text = name
    line = ElementTree.SubElement(mark, f"{{{_KML}}}LineString")
    ElementTree.SubElement(line, f"{{{_KML}}}altitudeMode").text = "absolute"
    places = (f"{lon!r},{lat!r},{height!r}" for lat, lon, height in _places(columns))
    ElementTree.SubElement(line, f"{{{_KML}}}coordinates").text = " ".join(places)
    return ElementTree.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def _places(columns: Mapping[str, np.ndarray]) -> list[tuple[float, float, float]]:
    """Return latitudes and longitudes [deg], and heights above sea level [m]."""
    latitude, longitude = columns["latitude_deg"], columns["longitude_deg"]
    height = columns["height_m"] - geoid_heights(latitude, longitude)
    turned = (longitude + 180.0) % 360.0 - 180.0
    rounded = latitude.round(9), turned.round(9), height.round(3)
    return list(zip(*(values.tolist() for values in rounded), strict=True))
