"""Flights of manoeuvres: they reach what they are asked to, smoothly, and say when they cannot."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from error_free import closure
from pydantic import ValidationError

from ggbench.gravity.ellipsoid import metres_per_radian
from ggbench.ins import strapdown
from ggbench.simulation.error_free_flight import trajectory_of
from ggbench.spec.trajectory import TrajectorySpec
from ggbench.trajectory import terrain_following
from ggbench.trajectory.manoeuvres import TrajectoryError
from ggbench.trajectory.truth import Segment, Trajectory, fly

START = {
    "latitude_deg": 33.5,
    "longitude_deg": 108.0,
    "height_m": 3000.0,
    "speed_mps": 200.0,
    "heading_deg": 90.0,
}


def spec(*segments: dict[str, Any], **changes: Any) -> TrajectorySpec:
    return TrajectorySpec.model_validate(START | {"segment": list(segments)} | changes)


def speed_of(flight: Trajectory) -> np.ndarray:
    return np.linalg.norm(flight.velocities, axis=1)


def headings(flight: Trajectory) -> np.ndarray:
    return np.degrees(np.unwrap(np.arctan2(flight.velocities[:, 0], flight.velocities[:, 1])))


def banks(flight: Trajectory) -> np.ndarray:
    return np.degrees(np.arctan2(-flight.attitudes[:, 2, 0], flight.attitudes[:, 2, 2]))


def vertical_acceleration(flight: Trajectory) -> np.ndarray:
    return np.diff(flight.velocities[:, 2]) / flight.dt


CLIMBS = [
    {"to_height_m": 5000.0, "climb_angle_deg": 5.0},
    {"to_height_m": 500.0, "vertical_speed_mps": 12.0},
    {"by_height_m": 30.0, "climb_angle_deg": 10.0},  # too small to reach the angle
    {"by_height_m": -0.5, "vertical_speed_mps": 50.0},
    {"to_height_m": 9000.0, "climb_angle_deg": 50.0, "max_vertical_acceleration_mps2": 20.0},
]


@pytest.mark.parametrize("dt", [0.05, 0.07])
@pytest.mark.parametrize("climb", CLIMBS)
def test_a_climb_ends_level_at_its_height(climb, dt):
    """To a centimetre, at the speed it had, never steeper than asked, within its acceleration."""
    asked = spec({"kind": "climb"} | climb)
    flight = trajectory_of(asked, dt)
    target = climb.get("to_height_m", 3000.0 + climb.get("by_height_m", 0.0))
    assert flight.positions[-1, 2] == pytest.approx(target, abs=0.01)
    assert flight.velocities[-1, 2] == pytest.approx(0.0, abs=1e-9)
    np.testing.assert_allclose(speed_of(flight), 200.0, rtol=1e-12)
    steepest = np.abs(flight.velocities[:, 2]).max()
    limit = climb.get("vertical_speed_mps") or 200.0 * math.sin(
        math.radians(climb["climb_angle_deg"])
    )
    assert steepest < 1.01 * limit
    if abs(target - 3000.0) > 100.0:
        assert steepest > 0.98 * limit
    allowed = climb.get("max_vertical_acceleration_mps2", 2.0)
    assert np.abs(vertical_acceleration(flight)).max() < 1.02 * allowed
    assert asked.duration_s == pytest.approx(flight.times[-1], abs=0.5 * dt + 1e-9)


TURNS = [
    ({"to_heading_deg": 0.0, "bank_deg": 30.0}, -90.0, 30.0),
    ({"to_heading_deg": 0.0, "direction": "right", "bank_deg": 30.0}, 270.0, 30.0),
    ({"to_heading_deg": -190.0, "radius_m": 8000.0}, 80.0, None),
    ({"by_heading_deg": 720.0, "turn_rate_deg_per_s": 2.0}, 720.0, None),
    ({"by_heading_deg": -2.0, "bank_deg": 30.0}, -2.0, None),
]


@pytest.mark.parametrize(("turn", "angle", "bank"), TURNS)
def test_a_turn_ends_at_its_heading_level_and_coordinated(turn, angle, bank):
    """To 0.01°; the specific force in the body has no part sideways while it turns."""
    asked = spec({"kind": "turn"} | turn)
    flight = trajectory_of(asked, 0.05)
    assert headings(flight)[-1] - headings(flight)[0] == pytest.approx(angle, abs=0.01)
    assert flight.positions[-1, 2] == pytest.approx(3000.0, abs=1e-6)
    leaning = banks(flight)
    assert leaning[[0, -1]] == pytest.approx([0.0, 0.0], abs=1e-9)
    assert np.sign(leaning[np.abs(leaning).argmax()]) == np.sign(angle)
    if bank:
        assert np.abs(leaning).max() == pytest.approx(bank, abs=0.1)
    _, increments = strapdown.error_free_increments(
        flight.positions, flight.velocities, flight.attitudes,
        np.zeros((len(flight.times) - 1, 3)), flight.dt,
    )  # fmt: skip
    # But for the Coriolis acceleration, and the difference between 9.81 and gravity.
    assert np.abs(increments[:, 0] / flight.dt).max() < 0.06


def test_the_radius_of_a_turn():
    """A circle of 6 km passes 12 km from where it began."""
    flight = trajectory_of(
        spec({"kind": "turn", "by_heading_deg": 2000.0, "radius_m": 6000.0}), 0.05
    )
    metres = (flight.positions - flight.positions[0]) * [6.36e6, 5.32e6, 1.0]
    settled = metres[len(metres) // 4 : -len(metres) // 4, :2]
    assert np.ptp(settled, axis=0) == pytest.approx([12e3, 12e3], rel=0.005)


def test_speed_and_distance():
    """A change of speed reaches it within its acceleration; a cruise is as long as it says."""
    flight = trajectory_of(
        spec({"kind": "speed", "to_speed_mps": 150.0, "acceleration_mps2": 0.8}), 0.05
    )
    assert speed_of(flight)[-1] == pytest.approx(150.0, abs=1e-9)
    assert np.abs(np.diff(speed_of(flight)) / 0.05).max() == pytest.approx(0.8, rel=0.01)
    cruise = spec({"kind": "cruise", "distance_km": 12.0})
    assert cruise.duration_s == pytest.approx(60.0)
    assert spec({"kind": "cruise", "duration_s": 5.0}).duration_s == pytest.approx(5.0)
    flight = trajectory_of(cruise, 0.05)
    east = (
        (flight.positions[-1, 1] - flight.positions[0, 1]) * 6.3847e6 * math.cos(math.radians(33.5))
    )
    assert east == pytest.approx(12000.0, rel=1e-3)


LAP = (
    {"kind": "cruise", "distance_km": 41.0},
    {"kind": "turn", "by_heading_deg": 180.0, "bank_deg": 25.0},
    {"kind": "climb", "by_height_m": 300.0, "climb_angle_deg": 3.0},
    {"kind": "speed", "to_speed_mps": 170.0, "acceleration_mps2": 0.7},
    {"kind": "speed", "to_speed_mps": 200.0, "acceleration_mps2": 0.7},
    {"kind": "cruise", "distance_km": 41.0},
    {"kind": "turn", "by_heading_deg": 180.0, "radius_m": 9000.0},
    {"kind": "climb", "by_height_m": -300.0, "vertical_speed_mps": 7.0},
)


def test_a_racetrack_of_four_hours_closes():
    """Repetition adds up, durations are rounded once, and the INS returns the truth to 1 m."""
    asked = spec(*LAP, repeat=18)
    flight = trajectory_of(asked, 0.1)
    assert asked.duration_s == pytest.approx(18.0 * spec(*LAP).duration_s, rel=1e-6)
    assert flight.times[-1] > 4.0 * 3600.0
    assert flight.times[-1] == pytest.approx(asked.duration_s, abs=0.06)
    assert flight.positions[-1, 2] == pytest.approx(3000.0, abs=0.01)
    assert headings(flight)[-1] == pytest.approx(90.0 + 18 * 360.0, abs=0.01)
    position, velocity, attitude = closure(flight)
    print("4 h:", np.abs(position).max(axis=0), np.abs(velocity).max(), attitude.max())
    assert np.abs(position).max() < 1.0
    assert np.abs(velocity).max() < 1e-2
    assert attitude.max() < 1e-6


def test_positions_follow_by_the_mechanizations_rule():
    """Bit by bit, whatever the loop that does it has been compiled to."""
    flight = trajectory_of(spec(*LAP), 0.1)
    following = np.empty(3)
    for n in range(0, len(flight.times) - 1, 7):
        strapdown.advance_position(
            flight.positions[n], flight.velocities[n], flight.velocities[n + 1], 0.1, following
        )
        np.testing.assert_array_equal(flight.positions[n + 1], following)


def test_rounding_of_short_segments_does_not_add_up():
    """A flight lasts round(total duration / dt) intervals, however many its segments are."""
    flight = fly(np.array([0.5, 1.0, 0.0]), 10.0, 0.0, 0.0, 0.0, [Segment(0.37)] * 100, 0.1)
    assert flight.times[-1] == pytest.approx(37.0)


def test_a_ship_stays_level():
    """It turns without leaning."""
    turn = {"kind": "turn", "by_heading_deg": 180.0, "radius_m": 900.0}
    flight = trajectory_of(
        spec(turn, vehicle="ship", height_m=0.0, speed_mps=6.0, roll_deg=1.0), 0.1
    )
    np.testing.assert_allclose(banks(flight), 1.0, atol=1e-12)
    assert headings(flight)[-1] == pytest.approx(270.0, abs=0.01)


# Over terrain.


def ridges(name: str, latitude: np.ndarray, longitude: np.ndarray) -> np.ndarray:
    """Mountains of 5 to 20 km from crest to crest, in metres."""
    east = (np.degrees(longitude) - 108.0) * 92.8e3
    return 900.0 + 500.0 * np.sin(east / 3000.0) + 150.0 * np.cos(east / 800.0)


@pytest.fixture
def over_ridges(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> dict[str, Any]:
    """A segment that follows them."""
    monkeypatch.setattr(terrain_following, "heights", ridges)
    file = tmp_path / "ridges.npz"
    file.touch()
    return {
        "kind": "terrain-following",
        "terrain": str(file),
        "clearance_m": 150.0,
        "distance_km": 60.0,
    }


@pytest.mark.parametrize(
    ("angle", "acceleration", "lowest"), [(10.0, 2.0, None), (25.0, 6.0, None), (25.0, 6.0, 1400.0)]
)
def test_terrain_is_followed_within_the_limits(over_ridges, angle, acceleration, lowest):
    """Clear of the ground, near it on the crests, within angle and acceleration, smooth, level."""
    segment = over_ridges | {
        "max_climb_angle_deg": angle,
        "max_vertical_acceleration_mps2": acceleration,
    }
    if lowest:
        segment["lowest_m"] = lowest
    asked = spec(segment, {"kind": "cruise", "duration_s": 10.0})
    assert asked.duration_s == pytest.approx(310.0)
    flight = trajectory_of(asked, 0.05)
    height = flight.positions[:, 2]
    clearance = (height - ridges("", *flight.positions[:, :2].T))[: 300 * 20]
    assert clearance.min() > 149.5
    over_ground = np.hypot(flight.velocities[:, 0], flight.velocities[:, 1])
    climb = np.degrees(np.arctan(flight.velocities[:, 2] / over_ground))
    assert np.abs(climb).max() < angle + 0.01
    assert np.abs(climb).max() > min(angle, 20.0) - 10.0
    felt = vertical_acceleration(flight)
    assert np.abs(felt).max() < 1.01 * acceleration
    assert np.abs(np.diff(felt)).max() / 0.05 < 2.0 * acceleration
    np.testing.assert_allclose(over_ground, 200.0, rtol=1e-9)
    assert abs(flight.velocities[-1, 2]) < 1e-9
    np.testing.assert_allclose(height[-200:], height[-1], atol=1e-6)
    if lowest:
        assert lowest - 0.01 < height.min() < lowest + 30.0
    else:
        assert clearance.min() < 180.0
    position, _, _ = closure(flight)
    assert np.abs(position).max() < 1e-3


def test_flat_terrain_is_followed_at_its_clearance(over_ridges, monkeypatch):
    """Down to the clearance and not below; a metre or two is for the rounding of corners."""
    monkeypatch.setattr(
        terrain_following, "heights", lambda name, lat, lon: np.full(len(lat), 50.0)
    )
    flight = trajectory_of(spec(over_ridges | {"distance_km": 80.0}), 0.1)
    assert 200.0 <= flight.positions[:, 2].min() < 202.0


@pytest.mark.parametrize("place", [15000.0, 15005.0, 15010.0, 15015.0])
def test_a_wall_between_two_steps_of_the_plan_is_cleared(over_ridges, monkeypatch, place):
    """Steps are 20 m; a wall 6 m thick may stand anywhere between them."""

    def wall(name: str, latitude: np.ndarray, longitude: np.ndarray) -> np.ndarray:
        _, east = metres_per_radian(np.array([math.radians(33.5), 0.0, 3000.0]))
        along = (longitude - math.radians(108.0)) * east
        return np.where(np.abs(along - place) < 3.0, 1500.0, 50.0)

    monkeypatch.setattr(terrain_following, "heights", wall)
    flight = trajectory_of(spec(over_ridges | {"distance_km": 24.0}), 0.05)
    at = np.abs(200.0 * flight.times - place).argmin()
    assert 1650.0 <= flight.positions[at, 2] < 1680.0


def test_a_start_too_low_is_told_how_high_it_must_be(over_ridges):
    """... and the height that the message gives is enough."""
    with pytest.raises(TrajectoryError, match=r"segment\[0\]: begins at 700.0 m") as caught:
        trajectory_of(spec(over_ridges, height_m=700.0), 0.1)
    needed = float(str(caught.value).split("asks for ")[1].split(" m")[0])
    trajectory_of(spec(over_ridges, height_m=needed), 0.1)
    with pytest.raises(TrajectoryError, match="too low"):
        trajectory_of(spec(over_ridges, height_m=needed - 5.0), 0.1)


def test_a_gap_in_the_terrain_under_the_flight_is_told(monkeypatch):
    """A void of a terrain model is no height, and a bilinear mean with one is none."""
    grid = np.zeros((3, 4))
    grid[1, 2] = np.nan
    monkeypatch.setattr(terrain_following, "_terrain", lambda *_: (10.0, -2.0, 0.5, 0.25, grid))
    monkeypatch.setattr(terrain_following, "_version", lambda _: (0, 0))
    places = np.radians([[10.2, 10.4], [-1.9, -1.6]])
    with pytest.raises(
        TrajectoryError, match=r"no height at 10\.4\d*° N, -1\.6\d*° E, .* gaps first"
    ):
        terrain_following.heights("x", *places)


def test_a_heading_that_is_reached_but_for_rounding_is_reached():
    """Three turns of 30° from 90° end at 180° to the last bits; a turn to 180° is then none."""
    turn = {"kind": "turn", "by_heading_deg": 30.0, "bank_deg": 20.0}
    again = {"kind": "turn", "to_heading_deg": 180.0, "bank_deg": 20.0}
    with pytest.raises(TrajectoryError, match=r"segment\[3\]: already flies at heading 180°"):
        trajectory_of(spec(turn, turn, turn, again), 0.05)


@pytest.mark.parametrize("dt", [0.1, 0.07, 0.3])
def test_rates_integrate_to_what_is_asked_whatever_the_sampling(dt):
    """A segment that is no whole number of samples still turns and climbs by rate times time."""
    asked = Segment(10.04, turn_rate=0.02, acceleration=0.5, climb_rate=0.001)
    flight = fly(
        position=np.array([0.6, 1.9, 3000.0]), speed=200.0, heading=0.3, pitch=0.0, roll=0.0,
        segments=[asked, Segment(5.0)], dt=dt,
    )  # fmt: skip
    assert headings(flight)[-1] == pytest.approx(math.degrees(0.3 + 0.02 * 10.04), abs=1e-9)
    assert speed_of(flight)[-1] == pytest.approx(200.0 + 0.5 * 10.04, abs=1e-9)


def test_a_steep_climb_has_the_vertical_speed_that_is_asked():
    """Half of the speed along the path: 30°, of which the sine is a half."""
    climb = {"kind": "climb", "by_height_m": 4000.0, "vertical_speed_mps": 100.0}
    flight = trajectory_of(spec(climb | {"max_vertical_acceleration_mps2": 20.0}), 0.05)
    assert flight.velocities[:, 2].max() == pytest.approx(100.0, rel=2e-3)


def test_a_flight_may_last_eleven_days():
    """Longer than any that is; where it becomes longer it is refused."""
    day = {"kind": "cruise", "duration_s": 3e5}
    with pytest.raises(TrajectoryError, match=r"segment\[3\]: ends after 1.2e\+06 s; a flight may"):
        trajectory_of(spec(day, day, day, day), 100.0)


def test_terrain_heights_are_those_of_the_grid(monkeypatch):
    """Bilinear between the points, in either notation of longitudes, and nothing beyond them."""
    grid = np.arange(12.0).reshape(3, 4) ** 2
    monkeypatch.setattr(terrain_following, "_terrain", lambda *_: (10.0, -2.0, 0.5, 0.25, grid))
    monkeypatch.setattr(terrain_following, "_version", lambda _: (0, 0))

    def at(latitude: float, longitude: float) -> float:
        place = np.radians([latitude]), np.radians([longitude])
        return float(terrain_following.heights("x", *place)[0])

    assert at(10.0, -2.0) == pytest.approx(0.0, abs=1e-5)
    assert at(10.5, 358.25) == pytest.approx(25.0, abs=1e-4)
    assert at(11.0, -1.25) == pytest.approx(121.0, abs=1e-4)
    assert at(10.25, -1.875) == pytest.approx((0.0 + 1.0 + 16.0 + 25.0) / 4.0, abs=1e-4)
    for outside in ((9.9, -2.0), (11.1, -2.0), (10.5, -1.0), (10.5, -2.1), (10.5, 178.0)):
        with pytest.raises(TrajectoryError, match=r"leaves the terrain x at .* it covers 10.000°"):
            at(*outside)


# What cannot be flown, and what cannot be said.

BAD: dict[str, tuple[list[dict[str, Any]], dict[str, Any], str]] = {
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
        "direction belongs to to_heading_deg",
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
    "standing": ([{"kind": "cruise", "distance_km": 5.0}], {"speed_mps": 0.0}, "needs a speed"),
    "endless": (
        [{"kind": "cruise", "distance_km": 4e4}], {"speed_mps": 1.0}, "may last 1e.06 s at most",
    ),
    "no segments": ([], {}, "needs a flight"),
    "no start": ([{"duration_s": 1.0}], {"height_m": None}, "'height_m' is missing"),
    "banking ship": (
        [{"kind": "turn", "by_heading_deg": 9.0, "bank_deg": 5.0}], {"vehicle": "ship"},
        "a ship does not bank",
    ),
    "no terrain": (
        [{"kind": "terrain-following", "terrain": "gone.npz", "clearance_m": 5.0,
          "duration_s": 9.0}], {}, "cannot read gone.npz: No such file",
    ),
    "track's key": ([{"duration_s": 1.0}], {"smoothing_s": 5.0}, "'smoothing_s' belongs to"),
    "both": ([{"duration_s": 1.0}], {"file": "a.csv"}, "cannot stand beside 'file'"),
}  # fmt: skip


@pytest.mark.parametrize("kind", BAD)
def test_a_flight_that_cannot_be_has_its_sentence(kind):
    """Before anything flies: when a scenario is read, its duration is asked for."""
    segments, changes, expected = BAD[kind]
    with pytest.raises((ValidationError, TrajectoryError), match=expected):
        assert spec(*segments, **changes).duration_s


def test_a_dump_says_the_same():
    """A flight goes to other processes as JSON, with all keys that it does not use."""
    asked = spec(*LAP, repeat=2)
    again = TrajectorySpec.model_validate_json(asked.model_dump_json())
    assert again == asked
    assert again.duration_s == asked.duration_s


def test_files_are_known_by_content(over_ridges, tmp_path):
    """Two places of one terrain are one flight; another content is another."""
    other = tmp_path / "other.npz"
    other.touch()
    one, two = spec(over_ridges), spec(over_ridges | {"terrain": str(other)})
    assert one.placeless() == two.placeless()
    assert one.file_hashes() == two.file_hashes()
    other.write_bytes(b"1")
    assert one.file_hashes() != two.file_hashes()
