"""Headings of tracks: against the course over ground, and in radians."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ggbench.simulation.true_motion import trajectory_of
from ggbench.spec.trajectory import TrajectorySpec
from ggbench.trajectory.manoeuvres import TrajectoryError

NAMES = "time_s,latitude_deg,longitude_deg,height_m"


def write(path: Path, rows: np.ndarray, names: str) -> str:
    """Write a track and return its path."""
    np.savetxt(path, rows, fmt="%.10f", delimiter=",", header=names, comments="")
    return str(path)


def read(path: str) -> TrajectorySpec:
    return TrajectorySpec.model_validate({"file": path})


def curve(heading, speed: float = 60.0) -> np.ndarray:
    """Rows of a minute, with courses of 60° to 119° and a column of what is made of them."""
    times = np.arange(60.0)
    course = 60.0 + times
    step = speed * np.array([np.cos(np.radians(course)), np.sin(np.radians(course))])
    north, east = np.degrees(np.cumsum(step, axis=1) / 6.38e6)
    return np.column_stack([times, north, east, 500.0 + 0.0 * times, heading(course)])


@pytest.mark.parametrize(
    ("heading", "said"),
    [
        (lambda course: 90.0 - course, "measured counter-clockwise from east"),
        (lambda course: -course, "measured counter-clockwise from north"),
        (lambda course: course - 90.0, "measured clockwise from east"),
        (lambda course: 180.0 + course, "of the stern"),
        (lambda course: np.radians(course), "in radians$"),
        (lambda course: np.radians(90.0 - course), "in radians, counter-clockwise from east"),
    ],
)
def test_a_heading_against_the_course_is_refused(heading, said, tmp_path):
    """And the likely convention is named."""
    file = write(tmp_path / "ros.csv", curve(heading), NAMES + ",heading_deg")
    with pytest.raises(TrajectoryError, match=f"heading_deg differs by .* it seems to be {said}"):
        trajectory_of(read(file), 0.1)


def test_a_crab_angle_and_a_hover_are_no_contradiction(tmp_path):
    """40° of drift pass, as does any heading below 5 m/s."""
    for name, rows in (
        ("crab", curve(lambda course: course + 40.0)),
        ("hover", curve(lambda course: course - 180.0, 4.0)),
    ):
        file = write(tmp_path / f"{name}.csv", rows, NAMES + ",heading_deg")
        assert read(file).duration_s == 59.0


def test_bare_angles_that_could_be_radians_are_refused(tmp_path):
    """Yaw within 2π, pitch and roll within π: unless their names say degrees, or all are zero."""
    names = ",yaw,pitch,roll"
    rows = np.column_stack([curve(lambda course: 0.0 * course + 0.1), np.zeros((60, 2))])
    rows[:, 1:3] = np.column_stack([30.0 + 1e-3 * rows[:, 0], 0.0 * rows[:, 0]])  # northwards
    rows[:, 5] = 0.02
    with pytest.raises(TrajectoryError, match="all of yaw, pitch and roll could be radians"):
        trajectory_of(read(write(tmp_path / "rad.csv", rows, NAMES + names)), 0.1)
    two = write(tmp_path / "two.csv", np.delete(rows, 4, axis=1), NAMES + ",pitch,roll")
    with pytest.raises(TrajectoryError, match="all of pitch and roll could be radians"):
        trajectory_of(read(two), 0.1)
    degrees_named = NAMES + ",yaw_deg,pitch_deg,roll_deg"
    assert read(write(tmp_path / "deg.csv", rows, degrees_named)).duration_s == 59.0
    rows[:, 6] = 4.0
    assert read(write(tmp_path / "large.csv", rows, NAMES + names)).duration_s == 59.0
    rows[:, 4:] = 0.0
    assert read(write(tmp_path / "zero.csv", rows, NAMES + names)).duration_s == 59.0
