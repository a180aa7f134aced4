"""Headings of tracks against the course over ground, and their unit."""

from __future__ import annotations

from tracks import NAMES, bare_angles, curve, read, write


def test_a_crab_angle_and_a_hover_are_no_contradiction(tmp_path):
    """40° of drift pass, as does any heading below 5 m/s."""
    for name, rows in (
        ("crab", curve(lambda course: course + 40.0)),
        ("hover", curve(lambda course: course - 180.0, 4.0)),
    ):
        file = write(tmp_path / f"{name}.csv", rows, NAMES + ",heading_deg")
        assert read(file).duration_s == 59.0


def test_bare_angles_are_degrees_by_their_names_or_values(tmp_path):
    """Yaw beyond 2π, pitch and roll beyond π, or all zero."""
    names = ",yaw,pitch,roll"
    rows = bare_angles()
    degrees_named = NAMES + ",yaw_deg,pitch_deg,roll_deg"
    assert read(write(tmp_path / "deg.csv", rows, degrees_named)).duration_s == 59.0
    rows[:, 6] = 4.0
    assert read(write(tmp_path / "large.csv", rows, NAMES + names)).duration_s == 59.0
    rows[:, 4:] = 0.0
    assert read(write(tmp_path / "zero.csv", rows, NAMES + names)).duration_s == 59.0
