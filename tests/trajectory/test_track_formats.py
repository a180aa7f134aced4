"""Tracks of receivers and planners: the same flight in every format."""

from __future__ import annotations

import numpy as np
import pytest
from click.testing import CliRunner
from problems import SMALL
from receiver_tracks import (
    COUNT,
    EXACT,
    GEOID,
    HEIGHTS,
    LATITUDES,
    LONGITUDES,
    gpx,
    kml,
    kml_points,
    pos,
    with_namespaces,
)
from thinning import thinned

from ggbench.cli.main import main
from ggbench.maps.geoid import geoid_heights
from ggbench.spec.trajectory import TrajectorySpec
from ggbench.trajectory.csv_text import iso_seconds
from ggbench.trajectory.manoeuvres import TrajectoryError
from ggbench.trajectory.track_formats import rows_of


@pytest.mark.parametrize("name", EXACT)
def test_a_flight_is_the_same_in_every_format(name):
    rows = rows_of(EXACT[name].encode())
    np.testing.assert_allclose(rows.columns["time_s"], np.arange(COUNT), atol=1e-6)
    np.testing.assert_allclose(rows.columns["latitude_deg"], LATITUDES, atol=1e-7)
    np.testing.assert_allclose(rows.columns["longitude_deg"], LONGITUDES, atol=1e-7)
    np.testing.assert_allclose(rows.columns["height_m"], HEIGHTS, atol=2e-3)
    assert not rows.remark


@pytest.mark.parametrize(
    "text", [gpx(geoid=False), kml(), kml_points(), pos().replace("ellipsoidal", "geodetic")]
)
def test_heights_above_sea_level_become_ellipsoidal(text):
    """They are raised by the geoid, 46.6 to 46.9 m at Munich, and the remark says so."""
    rows = rows_of(text.encode())
    raised = rows.columns["height_m"] - (HEIGHTS - (GEOID if "gpx" in text else 0.0))
    np.testing.assert_allclose(raised, 46.8, atol=1.5)
    assert "above sea level" in rows.remark and "47 m" in rows.remark
    np.testing.assert_allclose(rows.columns["time_s"], np.arange(COUNT), atol=1e-6)


@pytest.mark.parametrize(("text", "said"), [(gpx(), False), (gpx(geoid=False), True)])
def test_the_command_says_what_was_made_of_the_heights(text, said, tmp_path):
    """Once, whatever the number of cases; nothing if the file has the geoid."""
    track, path = tmp_path / "track.gpx", tmp_path / "small.toml"
    track.write_text(text)
    start, end = SMALL.index("[trajectory]"), SMALL.index("[imu]")
    path.write_text(f'{SMALL[:start]}[trajectory]\nfile = "{track}"\n\n{SMALL[end:]}')
    result = CliRunner().invoke(main, ["validate", str(path)])
    assert result.exit_code == 0, result.output
    assert result.output.count("Note on the track: its heights are above sea level") == said


def test_the_geoid_is_egm2008():
    """Published EGM2008 geoid heights, to what degree 120 leaves out."""
    latitude, longitude = np.array([38.6281550, -14.6212170]), np.array([269.7791550, 305.0211140])
    expected = [-31.628, -2.969]  # NGA's test values of the interpolation program
    np.testing.assert_allclose(geoid_heights(latitude, longitude), expected, atol=1.0)


def test_dates_are_those_of_iso_8601():
    """With a zone, without, with fractions of any length; what is none is no number."""
    texts = [
        "1970-01-01T00:00:10Z",
        "1970-01-01 01:00:10.25+01:00",
        "1970-01-01T00:00:10.1234567",
        "19700101T000010Z",
        "2100-01-01T00:00:00Z",
        "24-01-01T00:00:00",
        "today",
        "",
    ]
    expected = [10.0, 10.25, 10.123456, 10.0, 4102444800.0, np.nan, np.nan, np.nan]
    np.testing.assert_allclose(iso_seconds(texts), expected, atol=1e-9)


@thinned("name", [*EXACT, "KML"])
def test_damaged_files_have_a_sentence(name, tmp_path):
    """Of 100 mutations with a fixed seed, each is read or refused; none raises another error."""
    rng = np.random.default_rng(41)
    whole = (EXACT | {"KML": kml()})[name].encode()
    path = tmp_path / "track"
    refused = 0
    for _ in range(100):
        damaged = bytearray(whole)
        for at in rng.integers(0, len(whole), rng.integers(1, 6)):
            damaged[at] = rng.choice([rng.integers(0, 256), *b"0,.<-e "])
        if rng.random() < 0.3:
            del damaged[rng.integers(0, len(whole)) :]
        path.write_bytes(damaged)
        try:
            rows = rows_of(bytes(damaged))
            assert all(np.isfinite(values).all() for values in rows.columns.values())
            TrajectorySpec(file=str(path)).track()
        except TrajectoryError:
            refused += 1
    assert refused > 30


def test_a_gpx_file_may_declare_some_namespaces():
    assert len(rows_of(with_namespaces(50).encode()).columns["time_s"]) > 10
