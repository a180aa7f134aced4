"""Numbers of tracks, segments, maps and windows, in the unit that their key names.

The values in use are SI, as :mod:`test_units` has it of sensors.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from key_units import E, si
from small_cases import (
    blank_map,
    small_case,
    small_flight,
)
from small_noise import survey

from ggbench.gravity import parker
from ggbench.gravity.ellipsoid import metres_per_radian
from ggbench.judging import convergence
from ggbench.judging.run_errors import window_mask
from ggbench.maps import recipe
from ggbench.simulation import field_source
from ggbench.spec.case import WindowsSpec
from ggbench.spec.segments import SegmentSpec
from ggbench.spec.trajectory import TrajectorySpec
from ggbench.trajectory import moved_track

TRAJECTORY: dict[str, tuple[float, Callable[[Any], float]]] = {
    "trajectory.latitude_deg": (34.0, lambda t: t.positions[0, 0]),
    "trajectory.longitude_deg": (-107.0, lambda t: t.positions[0, 1]),
    "trajectory.height_m": (9000.0, lambda t: t.positions[0, 2]),
    "trajectory.speed_mps": (120.0, lambda t: float(np.linalg.norm(t.velocities[0]))),
    "trajectory.heading_deg": (50.0, lambda t: math.atan2(*t.velocities[0, :2])),
    "trajectory.pitch_deg": (4.0, lambda t: math.asin(t.attitudes[0, 2, 1])),
    "trajectory.roll_deg": (
        -6.0,
        lambda t: math.atan2(-t.attitudes[0, 2, 0], t.attitudes[0, 2, 2]),
    ),
}
MOVES = ["trajectory.shift_east_km", "trajectory.shift_north_km", "trajectory.turn_deg"]
TRACK = {
    "trajectory.max_gap_s": "gap",
    "trajectory.max_acceleration_mps2": "acceleration",
    "trajectory.smoothing_s": "smoothing",
}
TURN = {"kind": "turn", "by_heading_deg": 90.0}
CLIMB = {"kind": "climb", "by_height_m": 100.0, "climb_angle_deg": 3.0}
TERRAIN = {"kind": "terrain-following", "terrain": "t", "clearance_m": 90.0, "duration_s": 60.0}
WAYPOINT = {"kind": "waypoint", "bank_deg": 10.0}
SEGMENT: dict[str, tuple[float, dict[str, Any], str]] = {
    "duration_s": (33.0, {"kind": "cruise"}, "duration"),
    "distance_km": (12.0, {"kind": "cruise"}, "distance"),
    "turn_rate_deg_per_s": (2.0, {"duration_s": 10.0}, "turn_rate"),
    "acceleration_mps2": (0.4, {"duration_s": 10.0}, "acceleration"),
    "climb_rate_deg_per_s": (0.3, {"duration_s": 10.0}, "climb_rate"),
    "to_height_m": (500.0, CLIMB | {"by_height_m": None}, "to"),
    "by_height_m": (-50.0, CLIMB, "by"),
    "climb_angle_deg": (4.0, CLIMB, "angle"),
    "vertical_speed_mps": (2.5, CLIMB | {"climb_angle_deg": None}, "vertical_speed"),
    "max_vertical_acceleration_mps2": (1.5, CLIMB, "vertical_acceleration"),
    "to_heading_deg": (200.0, {"kind": "turn", "bank_deg": 10.0}, "to"),
    "by_heading_deg": (-75.0, {"kind": "turn", "bank_deg": 10.0}, "by"),
    "bank_deg": (15.0, TURN, "bank"),
    "radius_m": (4000.0, TURN, "radius"),
    "latitude_deg": (48.0, {**WAYPOINT, "longitude_deg": 11.0}, "latitude"),
    "longitude_deg": (11.0, {**WAYPOINT, "latitude_deg": 48.0}, "longitude"),
    "to_speed_mps": (70.0, {"kind": "speed", "acceleration_mps2": 1.0}, "to"),
    "clearance_m": (80.0, TERRAIN, "clearance"),
    "lowest_m": (450.0, TERRAIN, "lowest"),
    "geoid_height_m": (-31.0, TERRAIN, "zero_level"),
    "max_climb_angle_deg": (8.0, TERRAIN, "climb_angle"),
}
"""Value, the other keys of a segment, and the attribute of the manoeuvre that is flown."""
SEGMENT_TWICE: dict[str, tuple[float, dict[str, Any], str]] = {
    "turn_rate_deg_per_s": (3.0, TURN, "rate"),
    "acceleration_mps2": (0.7, {"kind": "speed", "to_speed_mps": 70.0}, "acceleration"),
    "duration_s": (50.0, TERRAIN, "duration"),
    "distance_km": (9.0, TERRAIN | {"duration_s": None}, "distance"),
    "max_vertical_acceleration_mps2": (1.2, TERRAIN, "vertical_acceleration"),
}
"""Keys that another kind of segment has, too."""


@pytest.mark.parametrize("key", TRAJECTORY)
def test_start(key):
    value, read = TRAJECTORY[key]
    flight = small_flight({key: value})
    assert read(flight.trajectory) == pytest.approx(si(key, value), rel=1e-9)


@pytest.mark.parametrize("key", TRACK)
def test_tracks(key):
    limits = TrajectorySpec(file="track.csv", **{key.partition(".")[2]: 3.5}).track_limits()
    assert getattr(limits, TRACK[key]) == pytest.approx(si(key, 3.5))


@pytest.mark.parametrize("key", MOVES)
def test_moves_of_a_track(key, tmp_path, monkeypatch):
    """The move, in metres and radians, that a track is given."""
    times = range(0, 40, 2)
    rows = (f"{t},{46.0 + 1e-3 * t:.4f},8.0,1000" for t in times)
    path = tmp_path / "track.csv"
    path.write_text("\n".join(["time_s,latitude_deg,longitude_deg,height_m", *rows]))
    moves: list[tuple[float, ...]] = []
    monkeypatch.setattr(moved_track, "moved_track", lambda track, *move: moves.append(move))
    TrajectorySpec(file=str(path), **{key.partition(".")[2]: 3.5}).track()
    (move,) = moves
    assert move[MOVES.index(key)] == pytest.approx(si(key, 3.5))
    assert np.count_nonzero(move) == 1


def test_the_middle_of_survey_lines(tmp_path):
    path = survey(tmp_path / "lines.csv")
    spec = TrajectorySpec(file=path, lines=("30",), middle_s=7.0)
    assert spec.duration_s == pytest.approx(si("trajectory.middle_s", 7.0))


@pytest.mark.parametrize(
    ("key", "row"), [*SEGMENT.items(), *SEGMENT_TWICE.items()], ids=lambda x: str(x)[:30]
)
def test_segments(key, row):
    value, others, attribute = row
    given = {name: x for name, x in (others | {key: value}).items() if x is not None}
    manoeuvre = SegmentSpec(**given).manoeuvre()
    assert getattr(manoeuvre, attribute) == pytest.approx(si(key, value), rel=1e-12)


# Maps.

MAP = {
    "field.source": "jacksboro",
    "field.south_deg": 36.20,
    "field.north_deg": 36.30,
    "field.west_deg": -84.30,
    "field.east_deg": -84.20,
    "field.lowest_m": 1200.0,
    "field.highest_m": 1500.0,
    "field.spacing_arcmin": 0.05,
    "field.height_spacing_m": 50.0,
    "field.relief_smoothing_deg": 0.001,
    "field.density_kg_m3": 2500.0,
}
FIELD: dict[str, Callable[[Any], float]] = {
    "south_deg": lambda made: made.latitude[0],
    "north_deg": lambda made: made.latitude[-1],
    "west_deg": lambda made: made.longitude[0],
    "east_deg": lambda made: made.longitude[-1],
    "lowest_m": lambda made: made.height[0],
    "highest_m": lambda made: made.height[-1],
    "spacing_arcmin": lambda made: made.latitude[1] - made.latitude[0],
    "height_spacing_m": lambda made: made.height[1] - made.height[0],
    "relief_smoothing_deg": lambda made: made.smoothing,
    "density_kg_m3": lambda made: made.density,
}
ERROR: dict[str, tuple[float, str, float]] = {
    "resolution_km": (2.0, "resolution_m", 1.0),
    "white_noise_eotvos": (0.3, "white_noise_eotvos", E),
    "correlated_noise_eotvos": (0.4, "correlated_noise_eotvos", E),
    "correlation_km": (5.0, "correlation_m", 1.0),
}
"""Value, where it is in use, and what that is in SI units."""
SIDES = ("", "truth.", "model.")


@pytest.mark.parametrize("side", SIDES)
def test_maps(side, monkeypatch):
    """What the masses of a terrain are asked for: nodes, density, and the smoothing of its relief.

    A Gaussian of the terrain's own steps, whose length is that of its latitudes.
    """
    case = small_case({side + key if side else key: value for key, value in MAP.items()})
    made = SimpleNamespace()

    def record(terrain, latitude, longitude, height, options, *_):
        made.latitude, made.longitude, made.height = latitude, longitude, height
        made.density = options.density
        shape = (len(latitude), len(longitude))
        made.smoothing = made.sigma * math.radians(terrain.latitude_step_deg)
        for _ in height:
            yield np.zeros((*shape, 6)), np.zeros((*shape, 3))

    def smooth(heights, sigma, mode):
        made.sigma = sigma[0]
        return heights

    monkeypatch.setattr(parker, "terrain_layers", record)
    monkeypatch.setattr("scipy.ndimage.gaussian_filter", smooth)
    for name in ("truth", "model"):
        if side in ("", f"{name}."):
            recipe.build(field_source.map_recipe(case.side(name).field))
            for key, read in FIELD.items():
                expected = si(key, MAP[f"field.{key}"])
                assert read(made) == pytest.approx(expected, rel=1e-9), key


@pytest.mark.parametrize("side", SIDES)
def test_errors_of_maps(side, monkeypatch, tmp_path):
    """What a map is degraded by."""
    path = tmp_path / "map.nc"
    recipe.write(path, blank_map())
    error = {key: value for key, (value, *_) in ERROR.items()}
    case = small_case({"field.source": str(path), f"{side}field.error": error})
    seen = []
    monkeypatch.setattr(field_source, "degrade", lambda found, d: seen.append(d) or found)
    for name in ("truth", "model"):
        field_source._make.cache_clear()
        field_source.make_field(case.side(name).field)
    assert len(seen) == (1 if side else 2)
    for degradation in seen:
        for key, (value, attribute, unit) in ERROR.items():
            found = unit * getattr(degradation, attribute)
            assert found == pytest.approx(si(key, value), rel=1e-12), key


def test_draws():
    """The farthest of 1000 tracks from the declared start and heading is that of the limits."""
    drawn = {"start_km": 2.0, "heading_deg": 30.0}
    case = small_case(
        {f"draw.{key}": value for key, value in drawn.items()} | {"draw.tracks": 1000}
    )
    declared = case.trajectory.start()
    starts = [case.of_run(run).trajectory.start() for run in range(1000)]
    metres = metres_per_radian(declared.position)
    moved = [np.abs((s.position - declared.position)[:2] * metres).max() for s in starts]
    turned = [abs(s.heading - declared.heading) for s in starts]
    assert max(moved) == pytest.approx(si("start_km", 2.0), rel=0.01)
    assert max(turned) == pytest.approx(si("heading_deg", 30.0), rel=0.01)


# Judging.


def test_windows():
    """Which epochs count, and which errors have converged."""
    times = np.arange(1, 1001) * 0.1
    windows = WindowsSpec(settled_from_s=40.0, last_s=12.0, required_m=30.0)
    settled, last = (times[window_mask(times, windows, name)] for name in ("settled", "last20"))
    assert settled[0] == pytest.approx(si("settled_from_s", 40.0))
    assert last[0] == pytest.approx(times[-1] - si("last_s", 12.0) + 0.1)
    errors = si("required_m", 30.0) * np.array([[0.999], [1.001]]) * np.ones((1, 1000))
    found, _ = convergence.judge(errors, np.full((2, 3), np.nan), times, windows.required_m)
    assert np.isfinite(found).tolist() == [True, False]
