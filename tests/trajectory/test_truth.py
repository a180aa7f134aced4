"""Flights of manoeuvres that reach, smoothly, what they are asked to."""

from __future__ import annotations

import math

import numpy as np
import pytest
from error_free import closure
from manoeuvres import spec, vertical_acceleration

from ggbench.ins import strapdown
from ggbench.simulation.true_motion import trajectory_of
from ggbench.spec.trajectory import TrajectorySpec
from ggbench.trajectory.truth import Segment, Trajectory, fly


def speed_of(flight: Trajectory) -> np.ndarray:
    return np.linalg.norm(flight.velocities, axis=1)


def headings(flight: Trajectory) -> np.ndarray:
    return np.degrees(np.unwrap(np.arctan2(flight.velocities[:, 0], flight.velocities[:, 1])))


def banks(flight: Trajectory) -> np.ndarray:
    return np.degrees(np.arctan2(-flight.attitudes[:, 2, 0], flight.attitudes[:, 2, 2]))


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


def test_a_climb_too_small_for_its_angle_is_as_quick_as_its_acceleration_allows():
    """30 m are climbed at 2 m/s², pull-up and push-over at once, and not at the pace of 10°."""
    flight = trajectory_of(
        spec({"kind": "climb", "by_height_m": 30.0, "climb_angle_deg": 10.0}), 0.05
    )
    assert np.abs(vertical_acceleration(flight)).max() == pytest.approx(2.0, rel=0.02)


def test_a_climb_begins_below_the_ellipsoid_too():
    """A field on the shore of the Dead Sea lies 400 m below: to 100 m it is half a kilometre."""
    climb = {"kind": "climb", "to_height_m": 100.0, "climb_angle_deg": 5.0}
    flight = trajectory_of(spec(climb, height_m=-400.0), 0.1)
    assert flight.positions[-1, 2] == pytest.approx(100.0, abs=0.01)


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
        flight.positions,
        flight.velocities,
        flight.attitudes,
        np.zeros((len(flight.times) - 1, 3)),
        flight.dt,
    )
    # But for the Coriolis acceleration, and the difference between 9.81 and gravity.
    assert np.abs(increments[:, 0] / flight.dt).max() < 0.06


def test_a_small_turn_is_rolled_in_and_out():
    """Two degrees take the ten seconds of both, however steep a turn may be."""
    turn = {"kind": "turn", "by_heading_deg": 2.0, "bank_deg": 30.0}
    assert spec(turn).duration_s == pytest.approx(10.0)


def test_a_turn_that_accelerates_leans_ever_more():
    """tan(bank) = speed · turn rate / g with the speed at that moment."""
    asked = Segment(40.0, turn_rate=0.02, acceleration=5.0)
    flight = fly(
        position=np.array([0.5, 1.0, 0.0]),
        speed=100.0,
        heading=0.0,
        pitch=0.0,
        roll=0.0,
        segments=[asked],
        dt=0.1,
    )
    rate = np.gradient(np.radians(headings(flight)), 0.1)
    lean = np.tan(np.radians(banks(flight)))
    np.testing.assert_allclose(lean[60:-60], (speed_of(flight) * rate / 9.81)[60:-60], rtol=1e-6)


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
    pull_up = {"duration_s": 10.0, "climb_rate_deg_per_s": 3.0}
    climbing = spec(pull_up, {"kind": "cruise", "distance_km": 12.0})
    assert climbing.duration_s == pytest.approx(70.0)  # along the path
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


@pytest.mark.parametrize("laps", [6, pytest.param(18, marks=pytest.mark.long)])
def test_a_racetrack_of_hours_closes(laps):
    """Repetition adds up, durations are rounded once, and the INS returns the truth to 1 m."""
    asked = spec(*LAP, repeat=laps)
    flight = trajectory_of(asked, 0.1)
    assert asked.duration_s == pytest.approx(laps * spec(*LAP).duration_s, rel=1e-6)
    assert flight.times[-1] > laps / 4.5 * 3600.0
    assert flight.times[-1] == pytest.approx(asked.duration_s, abs=0.06)
    assert flight.positions[-1, 2] == pytest.approx(3000.0, abs=0.01)
    assert headings(flight)[-1] == pytest.approx(90.0 + laps * 360.0, abs=0.01)
    position, velocity, attitude = closure(flight)
    print(f"{laps} laps:", np.abs(position).max(axis=0), np.abs(velocity).max(), attitude.max())
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
    flight = fly(
        position=np.array([0.5, 1.0, 0.0]),
        speed=10.0,
        heading=0.0,
        pitch=0.0,
        roll=0.0,
        segments=[Segment(0.37)] * 100,
        dt=0.1,
    )
    assert flight.times[-1] == pytest.approx(37.0)


def test_a_segment_too_short_to_be_rolled_into_is_one_smooth_swing():
    """Within four seconds the rate rises and falls as a single cosine: to twice its mean."""
    rates = Segment(4.0, turn_rate=0.1).rates(None, 400, 0.01)[:, 0]
    assert rates.mean() == pytest.approx(0.1)
    assert rates.max() == pytest.approx(0.2, rel=1e-3)
    assert rates[[0, -1]].max() < 1e-4


def test_the_attitude_of_level_flight_is_no_climb():
    """Nose up by 0.1 rad and leaning by 0.2 rad, an aircraft flies on at its height."""
    flight = fly(
        position=np.array([0.5, 1.0, 3000.0]),
        speed=100.0,
        heading=0.0,
        pitch=0.1,
        roll=0.2,
        segments=[Segment(20.0)],
        dt=0.1,
    )
    assert np.abs(flight.positions[:, 2] - 3000.0).max() < 1e-9
    np.testing.assert_allclose(flight.attitudes[:, 2, 1], math.sin(0.1))
    np.testing.assert_allclose(banks(flight), math.degrees(0.2))


def test_a_ship_stays_level():
    """It turns without leaning, and is lifted without pitching."""
    turn = {"kind": "turn", "by_heading_deg": 180.0, "radius_m": 900.0}
    flight = trajectory_of(
        spec(turn, vehicle="ship", height_m=0.0, speed_mps=6.0, roll_deg=1.0), 0.1
    )
    np.testing.assert_allclose(banks(flight), 1.0, atol=1e-12)
    assert headings(flight)[-1] == pytest.approx(270.0, abs=0.01)
    rising = {"duration_s": 10.0, "climb_rate_deg_per_s": 0.5}
    lifted = trajectory_of(spec(rising, vehicle="ship", height_m=0.0, pitch_deg=2.0), 0.1)
    np.testing.assert_allclose(lifted.attitudes[:, 2, 1], math.sin(math.radians(2.0)))


@pytest.mark.parametrize("dt", [0.1, 0.07, 0.3])
def test_rates_integrate_to_what_is_asked_whatever_the_sampling(dt):
    """A segment that is no whole number of samples still turns and climbs by rate times time."""
    asked = Segment(10.04, turn_rate=0.02, acceleration=0.5, climb_rate=0.001)
    flight = fly(
        position=np.array([0.6, 1.9, 3000.0]),
        speed=200.0,
        heading=0.3,
        pitch=0.0,
        roll=0.0,
        segments=[asked, Segment(5.0)],
        dt=dt,
    )
    assert headings(flight)[-1] == pytest.approx(math.degrees(0.3 + 0.02 * 10.04), abs=1e-9)
    assert speed_of(flight)[-1] == pytest.approx(200.0 + 0.5 * 10.04, abs=1e-9)


def test_a_steep_climb_has_the_vertical_speed_that_is_asked():
    """Half of the speed along the path: 30°, of which the sine is a half."""
    climb = {"kind": "climb", "by_height_m": 4000.0, "vertical_speed_mps": 100.0}
    flight = trajectory_of(spec(climb | {"max_vertical_acceleration_mps2": 20.0}), 0.05)
    assert flight.velocities[:, 2].max() == pytest.approx(100.0, rel=2e-3)


def test_a_dump_says_the_same():
    """A flight goes to other processes as JSON, with all keys that it does not use."""
    asked = spec(*LAP, repeat=2)
    again = TrajectorySpec.model_validate_json(asked.model_dump_json())
    assert again == asked
    assert again.duration_s == asked.duration_s
