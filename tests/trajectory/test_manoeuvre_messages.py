"""Messages of manoeuvres and of terrain that is followed."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from manoeuvres import FOLLOWING, quarter_of_voids, ridges, spec
from pydantic import ValidationError
from refusals import refused

from ggbench.trajectory import terrain_following
from ggbench.trajectory.manoeuvres import Climb, TrajectoryError
from ggbench.trajectory.truth import fly

FROM = {"position": np.array([0.5, 1.0, 3000.0]), "heading": 0.0, "pitch": 0.0, "roll": 0.0}
DAY = {"kind": "cruise", "duration_s": 3e5}
TURN = {"kind": "turn", "by_heading_deg": 30.0, "bank_deg": 20.0}
BAD: dict[str, tuple[Any, ...]] = {
    "no length": ([{}], {}, r'kind "rates" needs .duration_s., found none'),
    "two lengths": (
        [{"kind": "cruise", "duration_s": 1.0, "distance_km": 1.0}], {}, "exactly one of .*found",
    ),
    "key of another kind": (
        [{"kind": "cruise", "duration_s": 1.0, "bank_deg": 5.0}], {}, "has no key 'bank_deg'",
    ),
    "forgotten kind": ([{"duration_s": 1.0, "to_height_m": 5.0}], {}, 'other kinds have a line'),
    "turn without steepness": (
        [{"kind": "turn", "by_heading_deg": 9.0}], {}, "one of 'bank_deg', 'turn_rate_deg_per_s'",
    ),
    "direction of an angle": (
        [{"kind": "turn", "by_heading_deg": 9.0, "direction": "left", "bank_deg": 5.0}], {},
        "direction is allowed only with to_heading_deg",
    ),
    "negative rate": (
        [{"kind": "turn", "by_heading_deg": 9.0, "turn_rate_deg_per_s": -5.0}], {}, "be positive",
    ),
    "negative acceleration": (
        [{"kind": "speed", "to_speed_mps": 9.0, "acceleration_mps2": -5.0}], {}, "be positive",
    ),
    "unknown kind": ([{"kind": "loop"}], {}, "'rates', 'cruise', 'climb'"),
    "there already": (
        [{"kind": "climb", "to_height_m": 3000.0, "climb_angle_deg": 5.0}], {}, "already flies at",
    ),
    "heading already": (
        [{"kind": "turn", "to_heading_deg": -270.0, "bank_deg": 5.0}], {}, "by_heading_deg = 360",
    ),
    "speed already": (
        [{"kind": "speed", "to_speed_mps": 200.0, "acceleration_mps2": 5.0}], {}, "already flies",
    ),
    "second time around": (
        [{"kind": "climb", "to_height_m": 5000.0, "climb_angle_deg": 5.0}], {"repeat": 2},
        r"segment\[0\] \(repetition 2\): already flies at 5000 m",
    ),
    "faster up than forward": (
        [{"kind": "climb", "by_height_m": 500.0, "vertical_speed_mps": 190.0}], {}, "0.9 times",
    ),
    "not level": (
        [
            {"duration_s": 10.0, "climb_rate_deg_per_s": 0.5},
            {"kind": "climb", "to_height_m": 5000.0, "climb_angle_deg": 5.0},
        ], {}, r"segment\[1\]: must begin in level flight, .* 5°",
    ),
    "not level, but descending": (
        [
            {"duration_s": 10.0, "climb_rate_deg_per_s": -0.5},
            {"kind": "climb", "to_height_m": 5000.0, "climb_angle_deg": 5.0},
        ], {}, r"segment\[1\]: must begin in level flight, .* -5°",
    ),
    "standing": ([{"kind": "cruise", "distance_km": 5.0}], {"speed_mps": 0.0}, "needs a speed"),
    "endless": (
        [{"kind": "cruise", "distance_km": 4e4}], {"speed_mps": 1.0}, "may last 1e.06 s at most",
    ),
    "no segments": ([], {}, "path of a track"),
    "no start": ([{"duration_s": 1.0}], {"height_m": None}, "'height_m' is missing"),
    "banking ship": (
        [{"kind": "turn", "by_heading_deg": 9.0, "bank_deg": 5.0}], {"vehicle": "ship"},
        "a ship does not bank",
    ),
    "no terrain": (
        [{"kind": "terrain-following", "terrain": "gone.npz", "clearance_m": 5.0,
          "duration_s": 9.0}], {}, "cannot read gone.npz: No such file",
    ),
    "track's key": ([{"duration_s": 1.0}], {"smoothing_s": 5.0}, "'smoothing_s' applies to"),
    "both": ([{"duration_s": 1.0}], {"file": "a.csv"}, "excludes 'file'"),
    "twelve days": (
        [DAY] * 4, {}, r"segment\[3\]: ends after 1.2e\+06 s; a flight may", TrajectoryError,
    ),
    "heading already, but for rounding": (
        [TURN, TURN, TURN, {"kind": "turn", "to_heading_deg": 180.0, "bank_deg": 20.0}], {},
        r"segment\[3\]: already flies at heading 180°", TrajectoryError,
    ),
    "no height before terrain is followed": (
        [{"kind": "cruise", "duration_s": 10.0}, FOLLOWING], {"height_m": None},
        "'height_m' is missing", ValidationError,
    ),
    "terrain for 19 s": (
        [FOLLOWING | {"distance_km": 3.8}], {},
        r"segment\[0\]: lasts 19 s and must last 20 to 36000 s", TrajectoryError,
    ),
    "terrain from a climb": (
        [{"duration_s": 5.0, "climb_rate_deg_per_s": 1.0}, FOLLOWING], {},
        "must begin in level flight", TrajectoryError,
    ),
    "terrain from a descent": (
        [{"duration_s": 5.0, "climb_rate_deg_per_s": -1.0}, FOLLOWING], {},
        "must begin in level flight", TrajectoryError,
    ),
}  # fmt: skip
"""Segments, changes of the flight, messages and, where only one is meant, the error."""


@pytest.mark.parametrize("kind", BAD)
def test_a_flight_that_cannot_be_has_its_sentence(kind, tmp_path, monkeypatch):
    """Before anything flies: when a scenario is read, its duration is asked for."""
    segments, changes, expected, *error = BAD[kind]
    terrain = tmp_path / "ridges.npz"
    if FOLLOWING["clearance_m"] in [segment.get("clearance_m") for segment in segments]:
        terrain.touch()
        monkeypatch.setattr(terrain_following, "heights", ridges)
        segments = [
            segment | {"terrain": str(terrain)} if segment.keys() >= FOLLOWING.keys() else segment
            for segment in segments
        ]
    with pytest.raises(tuple(error) or (ValidationError, TrajectoryError), match=expected):
        assert spec(*segments, **changes).duration_s


STEEP = {"angle": 1.55, "vertical_acceleration": 1e3}
BAD_SAMPLING = {
    "up within one interval": ([Climb(by=1000.0, **STEEP)], 100.0, "cannot climb 1000 m in"),
    "down within one interval": ([Climb(by=-1000.0, **STEEP)], 100.0, "cannot climb -1000 m"),
    "half a metre within an interval": (
        [Climb(by=0.5, angle=0.1)],
        1.0,
        "climbs within 9.* s, which is too short for an IMU interval of 7 s",
    ),
}
"""Manoeuvres, a speed, and messages where samples are 7 s apart."""


@pytest.mark.parametrize("kind", BAD_SAMPLING)
def test_a_climb_that_its_sampling_spoils_has_its_sentence(kind):
    """Rounded to intervals of seven seconds there is no time for it."""
    segments, speed, message = BAD_SAMPLING[kind]
    with refused(TrajectoryError, rf"segment\[0\]: {message}"):
        fly(**FROM, speed=speed, segments=segments, dt=7.0)


def test_a_repetition_that_cannot_be_flown_is_told_as_one():
    """By the place of its segment in the file, also where no scenario was read before."""
    message = r"segment\[0\] \(repetition 2\): already flies at 5000"
    with refused(TrajectoryError, message):
        fly(**FROM, speed=200.0, segments=[Climb(to=5000.0, angle=0.1)] * 2, dt=0.1, size=1)


GRID = np.zeros((3, 4))
WITH_GAP = np.where(np.arange(12).reshape(3, 4) == 6, np.nan, 0.0)
LEAVES = r"leaves the terrain x at .*; it covers 10.000° to 11.000° N, -2.000° to -1.250° E"
BAD_PLACES = {
    "south of the terrain": (GRID, [9.9], [-2.0], LEAVES),
    "north of the terrain": (GRID, [11.1], [-2.0], LEAVES),
    "east of the terrain": (GRID, [10.5], [-1.0], LEAVES),
    "west of the terrain": (GRID, [10.5], [-2.1], LEAVES),
    "opposite to the terrain": (GRID, [10.5], [178.0], LEAVES),
    "a gap beside the flight": (
        WITH_GAP,
        [10.2, 10.4],
        [-1.9, -1.6],
        r"no height at 10\.4\d*° N, -1\.6\d*° E on .*; fill its gaps first",
    ),
}
"""Terrains, latitudes, longitudes and messages."""


@pytest.mark.parametrize("kind", BAD_PLACES)
def test_terrain_without_a_height_has_its_sentence(kind, monkeypatch):
    grid, latitude, longitude, message = BAD_PLACES[kind]
    monkeypatch.setattr(terrain_following, "terrain_of", lambda *_: (10.0, -2.0, 0.5, 0.25, grid))
    monkeypatch.setattr(terrain_following, "version_of", lambda _: (0, 0))
    with refused(TrajectoryError, message):
        terrain_following.heights("x", np.radians(latitude), np.radians(longitude))


def test_voids_under_a_flight_have_their_sentence(tmp_path):
    path = quarter_of_voids(tmp_path / "voids.npz")
    places = np.radians([33.1, 33.11]), np.radians([108.2, 108.6])
    with refused(TrajectoryError, r"voids among .* of the area needed"):
        terrain_following.heights(str(path), *places)
