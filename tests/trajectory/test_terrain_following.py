"""Flights over terrain: clear of it, near it, within their limits."""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from error_free import closure
from manoeuvres import FOLLOWING, quarter_of_voids, ridges, spec, vertical_acceleration

from ggbench.gravity.ellipsoid import metres_per_radian
from ggbench.simulation.true_motion import trajectory_of
from ggbench.trajectory import terrain_following
from ggbench.trajectory.manoeuvres import TrajectoryError


@pytest.fixture
def over_ridges(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> dict[str, Any]:
    """A segment that follows them."""
    monkeypatch.setattr(terrain_following, "heights", ridges)
    file = tmp_path / "ridges.npz"
    file.touch()
    return FOLLOWING | {"terrain": str(file)}


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


@pytest.mark.parametrize("ground", [50.0, -400.0])
def test_flat_terrain_is_followed_at_its_clearance(over_ridges, monkeypatch, ground):
    """Down to the clearance and not below; half a metre is for the rounding of corners."""
    monkeypatch.setattr(
        terrain_following, "heights", lambda name, lat, lon: np.full(len(lat), ground)
    )
    flight = trajectory_of(spec(over_ridges | {"distance_km": 80.0}), 0.1)
    assert 150.0 <= flight.positions[:, 2].min() - ground < 151.0


def test_behind_a_hill_the_flight_comes_down_again(over_ridges, monkeypatch):
    """It ends, level, at the clearance over the plain."""
    monkeypatch.setattr(
        terrain_following,
        "heights",
        lambda name, lat, lon: np.where(np.abs(lon - math.radians(108.2)) < 5e-4, 2000.0, 50.0),
    )
    flight = trajectory_of(spec(over_ridges), 0.1)
    assert flight.positions[:, 2].max() > 2150.0
    assert 200.0 <= flight.positions[-1, 2] < 201.0


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
    needed = float(str(caught.value).split("at least ")[1].split(" m")[0])
    trajectory_of(spec(over_ridges, height_m=needed), 0.1)
    with pytest.raises(TrajectoryError, match="too low"):
        trajectory_of(spec(over_ridges, height_m=needed - 5.0), 0.1)


def test_a_flight_without_a_height_starts_as_high_as_the_terrain_asks_for(over_ridges):
    """The least whole metre, and one more; in level flight at first, whatever comes after."""
    free = spec(over_ridges, {"kind": "cruise", "duration_s": 10.0}, height_m=None)
    flight = trajectory_of(free, 0.1)
    height = float(flight.positions[0, 2])
    assert height == round(height)
    assert free.duration_s == pytest.approx(310.0)
    with pytest.raises(TrajectoryError, match=f"at least {height - 1.0:.0f} m"):
        trajectory_of(spec(over_ridges, height_m=height - 3.0), 0.1)
    ground = float(ridges("", *flight.positions[:1, :2].T)[0])
    assert trajectory_of(spec(over_ridges, height_m=height), 0.1).positions[0, 2] == height
    assert height > ground + 150.0


def test_a_flight_without_a_height_begins_level(over_ridges):
    """It climbed at 0.5 m/s from the first sample on, which is an acceleration of a g."""
    for kilometres in (0.0, 2.0, 4.0, 6.0):
        longitude = 108.0 + kilometres / 92.8
        asked = spec(over_ridges, height_m=None, longitude_deg=longitude)
        flight = trajectory_of(asked, 0.05)
        upwards = np.diff(flight.velocities[:, 2]) / 0.05
        assert np.abs(upwards[:40]).max() < 2.0
        assert abs(flight.velocities[1, 2]) < 1e-3


def test_a_flight_that_ends_on_a_slope_starts_as_high_as_its_end_asks_for(over_ridges, monkeypatch):
    """It ends level above a steep slope; the height for that is stated, and is enough."""
    monkeypatch.setattr(
        terrain_following,
        "heights",
        lambda name, latitude, longitude: 400.0 * (np.degrees(longitude) - 108.0) * 92.8,
    )
    short = over_ridges | {"distance_km": 6.0}
    flight = trajectory_of(spec(short, height_m=None), 0.1)
    with pytest.raises(TrajectoryError, match="must be at least") as caught:
        trajectory_of(spec(short, height_m=150.0), 0.1)
    needed = float(str(caught.value).split("at least ")[1].split(" m")[0])
    assert flight.positions[0, 2] == needed + 1.0
    assert trajectory_of(spec(short, height_m=needed), 0.1).positions[0, 2] == needed


@pytest.mark.parametrize(("angle", "acceleration"), [(10.0, 2.0), (25.0, 6.0)])
def test_a_plateau_is_climbed_as_steeply_as_is_allowed(
    over_ridges, monkeypatch, angle, acceleration
):
    """The angle is that of the path, its sine over its cosine, not its sine alone."""
    monkeypatch.setattr(
        terrain_following,
        "heights",
        lambda name, lat, lon: np.where(lon > math.radians(108.3), 4500.0, 50.0),
    )
    limits = {"max_climb_angle_deg": angle, "max_vertical_acceleration_mps2": acceleration}
    flight = trajectory_of(spec(over_ridges | limits), 0.05)
    over_ground = np.hypot(flight.velocities[:, 0], flight.velocities[:, 1])
    climb = np.degrees(np.arctan(flight.velocities[:, 2] / over_ground))
    assert climb.max() == pytest.approx(angle, abs=0.1)


def test_a_terrain_written_anew_is_read_anew(tmp_path):
    """Though its name and its grid are the same."""
    place = np.radians([10.05]), np.radians([20.05])
    sides = {"lat": 10.0 + np.arange(20) / 100.0, "lon": 20.0 + np.arange(20) / 100.0}
    for height in (100.0, 250.0):
        file = tmp_path / "hills.npz"
        np.savez(file, z=np.full((20, 20), height), **sides)
        os.utime(file, (height, height))
        assert terrain_following.heights(str(file), *place) == pytest.approx(height)


def test_terrain_heights_are_those_of_the_grid(monkeypatch):
    """Bilinear between the points, in either notation of longitudes."""
    grid = np.arange(12.0).reshape(3, 4) ** 2
    monkeypatch.setattr(terrain_following, "terrain_of", lambda *_: (10.0, -2.0, 0.5, 0.25, grid))
    monkeypatch.setattr(terrain_following, "version_of", lambda _: (0, 0))

    def at(latitude: float, longitude: float) -> float:
        place = np.radians([latitude]), np.radians([longitude])
        return float(terrain_following.heights("x", *place)[0])

    assert at(10.0, -2.0) == pytest.approx(0.0, abs=1e-5)
    assert at(10.5, 358.25) == pytest.approx(25.0, abs=1e-4)
    assert at(11.0, -1.25) == pytest.approx(121.0, abs=1e-4)
    assert at(10.25, -1.875) == pytest.approx((0.0 + 1.0 + 16.0 + 25.0) / 4.0, abs=1e-4)


def test_files_are_known_by_content(over_ridges, tmp_path):
    """Two places of one terrain are one flight; another content is another."""
    other = tmp_path / "other.npz"
    other.touch()
    one, two = spec(over_ridges), spec(over_ridges | {"terrain": str(other)})
    assert one.placeless() == two.placeless()
    assert one.file_hashes() == two.file_hashes()
    other.write_bytes(b"1")
    assert one.file_hashes() != two.file_hashes()


def test_voids_far_from_a_flight_do_not_matter_to_it(tmp_path):
    """A quarter of the terrain is a void; over the rest it is followed."""
    path = quarter_of_voids(tmp_path / "voids.npz")
    latitude, longitude = np.radians([33.4, 33.41]), np.radians([108.2, 108.6])
    np.testing.assert_allclose(terrain_following.heights(str(path), latitude, longitude), 250.0)
