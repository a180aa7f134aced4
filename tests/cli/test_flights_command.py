"""``ggbench record`` and ``ggbench estimate`` as commands: what they refuse, and what they keep."""

from __future__ import annotations

import re
import shlex

import gpxpy
import numpy as np
import pandas as pd
import pytest
from command import invoke
from problems import SMALL
from recorded_flights import GNSS_ONLY, as_solution, edit, edit_rows, recorded
from small_cases import small_flight

from ggbench.maps.geoid import geoid_heights

BROKEN = '''
from dataclasses import dataclass
import numpy as np
from ggbench.problem import Estimate, Estimator

@dataclass(frozen=True)
class Broken(Estimator):
    """Fails, or returns what is no estimate of this problem."""

    how: str = "raises"
    name = "broken"
    causality = "none"

    def estimate(self, problem, rng):
        if self.how == "raises":
            raise RuntimeError("nobody knows")
        return Estimate(np.zeros((problem.epochs, problem.dimension)), np.eye(3), "none")
'''


@pytest.fixture
def log(tmp_path):
    (tmp_path / "broken.py").write_text(BROKEN)
    return recorded(tmp_path / "log", GNSS_ONLY)


def test_what_is_there_is_not_written_over(tmp_path, log):
    """A folder that holds anything is refused, and stays as it is."""
    (tmp_path / "small.toml").write_text(SMALL)
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "mine.txt").write_text("mine")
    for arguments in (
        ["record", "small.toml", "-o", "full"],
        ["estimate", "log/flight.toml", "-o", "full"],
        ["estimate", "log/flight.toml", "-o", "small.toml"],
    ):
        done = invoke(arguments, tmp_path)
        assert done.returncode == 2
        assert "contains files" in done.stderr or "is not a folder" in done.stderr
    assert [path.name for path in (tmp_path / "full").iterdir()] == ["mine.txt"]


def test_a_wrong_record_is_exit_code_2_and_writes_nothing(tmp_path, log):
    (log.parent / "gnss.csv").write_text("time_s\n1\n2\n")
    done = invoke(["estimate", "log/flight.toml", "-o", "out"], tmp_path)
    assert done.returncode == 2
    assert "gnss.csv: line 1 names no column latitude_deg" in done.stderr
    assert "Traceback" not in done.stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.long
def test_named_sensors_are_recorded_and_reported_by_their_names(tmp_path):
    """A file, a table, columns of residuals and a row of the report for each of them."""
    (tmp_path / "small.toml").write_text(
        SMALL + '[sensor.water_track]\nkind = "velocity_log"\nperiod_s = 1.0\nnoise_mps = 0.1\n'
        '[sensor.stern]\nkind = "gnss"\nperiod_s = 2.0\nposition_noise_m = 2.0\n'
    )
    done = invoke(["record", "small.toml", "--case", "base", "-o", "log"], tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    written = {path.name for path in (tmp_path / "log").iterdir()}
    assert written == {
        "flight.toml",
        "imu.csv",
        "gradiometer.csv",
        "stern.csv",
        "water_track.csv",
        "reference.csv",
    }
    names = (tmp_path / "log" / "stern.csv").read_text().splitlines()[0]
    assert names == "time_s,latitude_deg,longitude_deg,height_m"
    done = invoke(["estimate", "log/flight.toml", "-e", "ekf", "-o", "out"], tmp_path)
    assert done.returncode == 0, done.stderr
    columns = (tmp_path / "out" / "ekf" / "residuals.csv").read_text().splitlines()[0].split(",")
    assert len(set(columns)) == len(columns)
    assert {"stern_position_E_m", "water_track_velocity_right_mps"} < set(columns)
    report = (tmp_path / "out" / "report.md").read_text(encoding="utf-8")
    assert "|stern|position E, position N, position U|10|" in report
    assert "|water track|" in report
    assert "water_track.csv" in report


@pytest.mark.long
def test_an_estimator_that_fails_does_not_take_the_others_along(tmp_path, log):
    """It is named, the others are written, and the exit code is 1."""
    done = invoke(
        [
            *shlex.split("estimate log/flight.toml -e ./broken.py -e ./broken.py[how=wrong]"),
            *shlex.split("-e ekf -o out"),
        ],
        tmp_path,
    )
    assert done.returncode == 1
    assert "broken.py failed: RuntimeError: nobody knows" in done.stderr
    assert "the estimate's cov has shape (3, 3)" in done.stderr
    assert (tmp_path / "out" / "ekf" / "corrected.csv").exists()
    alone = invoke(["estimate", "log/flight.toml", "-e", "./broken.py", "-o", "two"], tmp_path)
    assert alone.returncode == 2
    assert "no file is written" in alone.stderr


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["estimate", "gone.toml", "-o", "out"], "gone.toml: cannot be read"),
        (["estimate", "log/flight.toml", "-e", "ekff", "-o", "out"], "did you mean 'ekf'"),
        (["estimate", "log/flight.toml"], "Missing option '-o'"),
        (["record", "wang2012", "-o", "out"], "did you mean 'wang2013'"),
        (["record", "wang2013", "-c", "x", "-o", "out"], "no case 'x'"),
        (["record", "wang2013", "--run", "-1", "-o", "out"], "not in the range"),
    ],
)
def test_wrong_arguments_end_with_a_sentence(tmp_path, log, arguments, said):
    done = invoke(arguments, tmp_path)
    assert done.returncode == 2
    assert said in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.long
def test_interpolated_samples_are_printed_and_reported(tmp_path):
    """With a count and the longest gap."""
    flown = small_flight(GNSS_ONLY)
    log = as_solution(recorded(tmp_path / "log", flown), flown)
    edit_rows(log.parent / "ins.csv", lambda table: table.drop(index=[40, 70, 71]))
    edit(log, {"ins.max_gap_s": 0.5})
    done = invoke(["estimate", "log/flight.toml", "-e", "ins", "-o", "out"], tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    sentence = "ins.csv: 3 missing samples interpolated, longest gap 0.3 s."
    assert f"Note: {sentence}" in done.stdout.splitlines()
    assert sentence in (tmp_path / "out" / "report.md").read_text(encoding="utf-8")


@pytest.mark.long
def test_the_report_says_what_there_is(tmp_path, log):
    """Sensors, estimators and, without a reference, no errors."""
    text = log.read_text()
    log.write_text(text[: text.index("[reference]")] + text[text.index("[windows]") :])
    done = invoke(["estimate", "log/flight.toml", "-e", "ins", "-e", "ekf", "-o", "out"], tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    report = (tmp_path / "out" / "report.md").read_text(encoding="utf-8")
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "<table>" in page and page.count("data:image/png;base64,") == report.count("](figures/")
    assert "ekf: final position σ " in done.stdout
    assert "against the reference" not in done.stdout
    tracks = {
        name: pd.read_csv(tmp_path / "out" / "ekf" / f"{name}.csv")
        for name in ("corrected", "full_rate")
    }
    samples, epochs = tracks["full_rate"], tracks["corrected"]
    assert len(samples) > 5 * len(epochs)
    shared = samples.iloc[np.searchsorted(samples["time_s"], epochs["time_s"] - 1e-6)]
    for key in ("latitude_deg", "longitude_deg", "height_m", "velocity_east_mps", "roll_deg"):
        np.testing.assert_allclose(shared[key], epochs[key], rtol=1e-12, atol=1e-9)
    parsed = gpxpy.parse((tmp_path / "out" / "ekf" / "corrected.gpx").read_text())
    points = parsed.tracks[0].segments[0].points
    line = (tmp_path / "out" / "ekf" / "corrected.kml").read_text()
    places = re.search("<coordinates>(.*)</coordinates>", line)[1].split()
    assert len(points) == len(places) == len(epochs)
    geoid = geoid_heights(epochs["latitude_deg"].to_numpy(), epochs["longitude_deg"].to_numpy())
    for k in (0, len(epochs) - 1):
        row, point = epochs.iloc[k], points[k]
        longitude, latitude, height = map(float, places[k].split(","))
        assert [point.latitude, point.longitude] == [latitude, longitude]
        assert latitude == pytest.approx(row["latitude_deg"], abs=1e-8)
        assert longitude == pytest.approx(row["longitude_deg"], abs=1e-8)
        assert point.elevation == height == pytest.approx(row["height_m"] - geoid[k], abs=2e-3)
    assert "|gnss|" in report and "|`ekf`|filter|" in report
    assert "reference" not in report
    assert not (tmp_path / "out" / "figures" / "errors.png").exists()
