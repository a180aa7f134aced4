"""Flights by way of places, and the files of planners that name them."""

import math
import re

import numpy as np
import pytest
from receiver_tracks import CSV_PLACES, GPX_ROUTE, KML_LINE

from ggbench.trajectory.manoeuvres import State, TrajectoryError, end_of, plan
from ggbench.trajectory.waypoint_files import read_waypoints
from ggbench.trajectory.waypoints import Waypoint, leg

SPEED, BANK, DT = 100.0, math.radians(25.0), 0.05


def start(latitude: float = 33.4, longitude: float = 107.9, heading: float = 200.0) -> State:
    position = np.array([math.radians(latitude), math.radians(longitude), 3000.0])
    return State(position, math.radians(heading), SPEED, 0.0)


def to(latitude: float, longitude: float) -> Waypoint:
    return Waypoint(math.radians(latitude), math.radians(longitude), bank=BANK)


def flown(state: State, waypoint: Waypoint) -> tuple[np.ndarray, State]:
    rates = waypoint.rates(state, round(waypoint.length(state) / DT), DT)
    return rates, end_of(state, rates, DT)


def distance(state: State, waypoint: Waypoint) -> float:
    return leg(state.position, waypoint.latitude, waypoint.longitude)[1]


@pytest.mark.parametrize(
    ("state", "places"),
    [
        (start(), [(33.5, 108.0), (33.6, 108.2), (33.6, 108.5), (33.3, 108.4), (33.5, 108.0)]),
        (start(0.02, 179.95, 90.0), [(-0.1, -179.95), (-0.1, 179.9)]),
        (start(-75.0, 10.0, 0.0), [(-74.9, 10.5), (-75.2, 10.0)]),
    ],
)
def test_a_flight_passes_its_waypoints(state, places):
    """Within a tenth of a second of flight, across the equator and the date line, too."""
    for place in places:
        waypoint = to(*place)
        rates, state = flown(state, waypoint)
        assert distance(state, waypoint) < 0.1 * SPEED
        still = np.flatnonzero(rates.any(axis=1)).max() + 1
        assert still < len(rates)
        assert state.speed == SPEED and state.climb == 0.0


def test_the_turn_is_the_shorter_way_and_as_steep_as_asked():
    rates, state = flown(start(heading=80.0), to(33.4, 108.5))
    turned = math.degrees(state.heading) - 80.0
    assert 9.0 < turned < 11.0
    _, state = flown(start(heading=100.0), to(33.4, 108.5))
    assert -11.0 < math.degrees(state.heading) - 100.0 < -9.0
    rates, _ = flown(start(heading=270.0), to(33.6, 107.9))
    assert math.atan(rates[:, 0].max() * SPEED / 9.81) == pytest.approx(BANK, rel=0.02)


def test_a_place_straight_ahead_needs_no_turn():
    state = start()
    heading, _ = leg(state.position, *np.radians([33.3, 107.8]))
    ahead = State(state.position, heading, SPEED, 0.0)
    rates, _ = flown(ahead, to(33.3, 107.8))
    assert not rates.any()


def test_a_leg_has_the_length_that_is_flown_on_a_constant_heading():
    state = start(60.0, 5.0, 70.0)
    end = end_of(state, np.zeros((20_000, 3)), DT)
    heading, length = leg(state.position, end.position[0], end.position[1])
    assert math.degrees(heading) == pytest.approx(70.0, abs=1e-4)
    assert length == pytest.approx(SPEED * 1000.0, rel=1e-6)


@pytest.mark.parametrize("place", [(33.4, 107.92), (33.4, 107.901)])
def test_a_waypoint_within_the_turn_is_refused(place):
    with pytest.raises(TrajectoryError, match=r"segment\[0\]: the waypoint is .* too close"):
        plan(start(heading=180.0), [to(*place)], DT)


def test_a_waypoint_needs_level_flight():
    climbing = State(start().position, 0.0, SPEED, 0.1)
    with pytest.raises(TrajectoryError, match="must begin in level flight"):
        to(33.5, 108.0).length(climbing)


ROUTE = [[46.12, 8.15], [46.25, 8.2], [46.27, 8.35]]
POINTS = "".join(
    f"<Placemark><Point><coordinates>{lon},{lat},0</coordinates></Point></Placemark>"
    for lat, lon in ROUTE
)


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("route.gpx", GPX_ROUTE),
        ("points.gpx", re.sub("</?rte>", "", GPX_ROUTE.replace("rtept", "wpt"))),
        (
            "track.gpx",
            GPX_ROUTE.replace("rtept", "trkpt")
            .replace("<rte>", "<trk><trkseg>")
            .replace("</rte>", "</trkseg></trk>"),
        ),
        ("line.kml", KML_LINE),
        ("points.kml", f"<kml><Document>{POINTS}</Document></kml>"),
        ("places.csv", CSV_PLACES),
        ("names.csv", "name;lon;lat\na;8.15;46.12\nb;8.2;46.25\nc;8.35;46.27\n"),
        ("empty.csv", "lat [deg],lon,time\n46.12,8.15,\n46.25,8.2,\n46.27,8.35,x\n"),
        ("twice.csv", "lat,lon\n46.12,8.15\n46.12,8.15\n46.25,8.2\n46.27,8.35\n"),
    ],
)
def test_waypoints_are_read(name, content, tmp_path):
    (tmp_path / name).write_text(content)
    np.testing.assert_allclose(read_waypoints(tmp_path / name), ROUTE)


def test_longitudes_are_those_of_scenarios(tmp_path):
    (tmp_path / "places.csv").write_text("lat,lon\n-40,-190\n-40,-170\n-40,190\n")
    assert read_waypoints(tmp_path / "places.csv")[:, 1].tolist() == [170.0, -170.0, 190.0]


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("lat,lon\n46,8\n", "has fewer than two waypoints"),
        ("lat,height\n46,8\n", "line 1 names no column longitude_deg (found: lat, height)"),
        ("lat,lon\n0.8,0.1\n0.81,0.1\n", "all of lat and lon could be radians"),
        ("lat,latitude,lon\n46,46,8\n", "names latitude_deg twice"),
        ("lat,lon\n", "has 0 rows"),
        ("lat,lon\n46,8\n146,8\n", "waypoint 2 is at latitude 146°"),
        ("lat,lon\n" + "46,8\n47,8\n" * 501, "has 1002 waypoints"),
        ("<kml><Point><coordinates>8</coordinates></Point></kml>", "waypoint 1 is '8' and must be"),
        ("<kml></kml>", "has fewer than two waypoints"),
        ("<gpx></gpx>", "has fewer than two waypoints"),
        ("$GPGGA,,,", "is a receiver log"),
        ("PK\x03", "is a zip archive"),
    ],
)
def test_what_are_no_waypoints_is_said(content, said, tmp_path):
    path = tmp_path / "places"
    path.write_text(content)
    with pytest.raises(TrajectoryError) as caught:
        read_waypoints(path)
    assert str(caught.value).startswith(f"{path} ") and said in str(caught.value)
