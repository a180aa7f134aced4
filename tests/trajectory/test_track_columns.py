"""Tracks of programs with other names and units of columns."""

from __future__ import annotations

import numpy as np
import pytest
from receiver_tracks import FILES, HEIGHTS, LATITUDES, LONGITUDES, csv_text, written
from small_cases import small_case

from ggbench.campaign.result_keys import problem_key
from ggbench.spec.trajectory import TrajectorySpec
from ggbench.trajectory.manoeuvres import TrajectoryError
from ggbench.trajectory.track_formats import rows_of


@pytest.mark.parametrize("name", FILES)
def test_a_track_of_another_program_is_read_by_its_names(name):
    """The same flight from all; without the names each is refused."""
    found = rows_of(written(name), FILES[name][-1]).columns
    np.testing.assert_allclose(np.diff(found["time_s"]), 1.0, atol=0.02)
    np.testing.assert_allclose(found["latitude_deg"], LATITUDES, atol=1e-7)
    np.testing.assert_allclose(found["longitude_deg"], LONGITUDES, atol=1e-7)
    np.testing.assert_allclose(found["height_m"], HEIGHTS, atol=1e-3)
    if name != "AirData":  # which has another height, in feet, by the usual name
        with pytest.raises(TrajectoryError):
            rows_of(written(name))


def test_names_of_columns_are_checked_before_a_track_is_read():
    with pytest.raises(ValueError, match="must be a table of names"):
        TrajectorySpec(file="a.csv", columns="px5")
    with pytest.raises(ValueError, match="height_m must be a name"):
        TrajectorySpec(file="a.csv", columns={"height_m": 3})


def test_other_names_are_another_flight(tmp_path):
    """To the keys of stored runs, as heights of two columns are."""
    path = tmp_path / "a.csv"
    path.write_bytes(written("AirData"))
    keys = set()
    for columns in ({"height_m": "altitude"}, {"height_m": "height_above_takeoff"}, None):
        spec = TrajectorySpec(file=str(path), columns=columns)
        keys.add(problem_key(small_case({}).model_copy(update={"trajectory": spec}), 1))
        assert hash(spec) == hash(spec.model_copy())
    assert len(keys) == 3


@pytest.mark.parametrize("name", ["alt_ft", "Altitude ft", "altitude_feet", "AltFt"])
def test_a_unit_at_the_end_of_a_name_counts(name):
    content = csv_text(f"time_s,latitude_deg,longitude_deg,{name}", 1.0 / 0.3048)
    found = rows_of(content, {"height_m": name}).columns
    np.testing.assert_allclose(found["height_m"], HEIGHTS, atol=1e-3)


@pytest.mark.parametrize(
    ("name", "columns"),
    [
        ("altitude (m AMSL)", None),
        ("height [m above mean sea level]", None),
        ("alt_msl", {"height_m": "alt_msl"}),
        ("orthometric_height", {"height_m": "orthometric_height"}),
    ],
)
def test_heights_above_sea_level_by_name_become_ellipsoidal(name, columns):
    """The geoid is 46.8 m at Munich."""
    found = rows_of(csv_text(f"time_s,latitude_deg,longitude_deg,{name}"), columns)
    np.testing.assert_allclose(found.columns["height_m"], HEIGHTS + 46.8, atol=1.5)
    assert "above sea level" in found.remark


def test_heights_above_the_ground_by_name_are_remarked_on():
    content = csv_text("time_s,latitude_deg,longitude_deg,height_agl")
    assert "above the ground" in rows_of(content, {"height_m": "height_agl"}).remark


@pytest.mark.parametrize("comment", ["% made by a program\n", "% one\n% two\n"])
def test_comments_of_matlab_are_passed_over(comment):
    content = comment.encode() + csv_text("time_s,latitude_deg,longitude_deg,height_m")
    np.testing.assert_allclose(rows_of(content).columns["height_m"], HEIGHTS, atol=1e-3)


def test_rows_may_end_in_a_separator():
    content = csv_text("time_s,latitude_deg,longitude_deg,height_m").replace(b"\n", b",\n") + b","
    content = content.replace(b"height_m,", b"height_m", 1)
    np.testing.assert_allclose(rows_of(content).columns["height_m"], HEIGHTS, atol=1e-3)
