"""Records that contradict one another are warned of, and a clock that is off is found."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest
from command import invoke
from problems import SMALL
from recorded_flights import edit, edit_rows
from small_cases import prepare

from ggbench.recorded.flight import read_flight
from ggbench.recorded.recording import write_record
from ggbench.recorded.suspicion import clock_fit
from ggbench.spec import scenario

TURNS = (
    SMALL.replace("duration_s = 20.0", 'kind = "cruise"\nduration_s = 40.0')
    .replace(
        "[imu]",
        '[[trajectory.segment]]\nkind = "turn"\nby_heading_deg = 180.0\nbank_deg = 25.0\n\n'
        '[[trajectory.segment]]\nkind = "cruise"\nduration_s = 40.0\n\n[imu]',
        1,
    )
    .replace("[gradiometer]\nperiod_s = 1.0\nnoise_eotvos = 0.01\n", "")
    .replace("gradiometer.noise_eotvos = 0.1\n", "gnss.period_s = 1.0\n")
)
POSITIONS = "[gnss]\nperiod_s = 1.0\nposition_noise_m = 3.0\n"
BOTH = f"{POSITIONS}velocity_noise_mps = 0.05\n"


def log(folder, gnss: str = BOTH, text: str = TURNS):
    """The record of a flight with a turn by 180° and a receiver; its file."""
    (folder / "own.toml").write_text(text.replace("[windows]", f"{gnss}\n[windows]"))
    loaded = scenario.load(folder / "own.toml")
    return write_record(prepare(loaded.cases[0]), 3, 4, folder / "log")


def shifted(path, seconds: float):
    """The same with a receiver whose clock is ahead by so much."""
    edit_rows(path.parent / "gnss.csv", lambda t: t.assign(time_s=t["time_s"] + seconds))
    return edit(path, {"gnss.outside": "drop"})


def estimated(path) -> list[str]:
    """The warnings of ``ggbench estimate``."""
    done = invoke(["estimate", str(path), "-e", "ekf", "-o", "out"], path.parent.parent)
    assert done.returncode == 0, done.stderr
    return [line for line in done.stdout.splitlines() if line.startswith("Warning")]


@pytest.mark.long
def test_a_clock_that_is_ahead_by_leap_seconds_is_found(tmp_path):
    """By 18 s: the NIS is beyond belief, and the offset that mends it is named."""
    first, second = estimated(shifted(log(tmp_path), 18.0))
    assert float(re.search(r"mean NIS is ([\d.e+]+) times", first)[1]) > 10.0
    assert "18 s is GPS - UTC" in first and "units" in first and "axes" in first
    assert "gnss.clock_offset_s = -18 fits the INS best" in second


@pytest.mark.long
def test_what_is_right_is_not_warned_of(tmp_path):
    assert estimated(log(tmp_path)) == []


@pytest.mark.long
def test_an_offset_that_is_set_counts(tmp_path):
    """A file that is behind by 7 s, of which 2 s are set already."""
    path = edit(shifted(log(tmp_path), -7.0), {"gnss.clock_offset_s": 2.0})
    assert "gnss.clock_offset_s = 7 fits" in estimated(path)[-1]


@pytest.mark.parametrize("gnss", [BOTH, POSITIONS], ids=["velocities", "positions"])
@pytest.mark.parametrize("seconds", [-11.0, 0.0, 18.0])
def test_the_offset_that_fits_best(gnss, seconds, tmp_path):
    """Of velocities and of positions alone; none where the clock is right."""
    fit = clock_fit(read_flight(shifted(log(tmp_path, gnss), seconds)).problem, "gnss")
    assert (fit is None) if seconds == 0.0 else fit.offset == -seconds


@pytest.mark.long
def test_in_straight_flight_no_offset_is_named(tmp_path):
    """An offset is then an error of the position along the track."""
    straight = TURNS.replace("by_heading_deg = 180.0", "by_heading_deg = 0.1")
    path = shifted(log(tmp_path, text=straight), 5.0)
    assert clock_fit(read_flight(path).problem, "gnss") is None


@pytest.mark.long
def test_gyros_in_degrees_are_warned_of(tmp_path):
    """57.3 times too large: beyond belief, and no offset of a clock explains it."""
    path = log(tmp_path)

    def in_degrees(table):
        names = [name for name in table if name.endswith("_rad")]
        assert len(names) == 3
        table[names] *= math.degrees(1.0)

    edit_rows(path.parent / "imu.csv", in_degrees)
    warnings = estimated(path)
    assert "mean NIS" in warnings[0] and len(warnings) == 1


@pytest.mark.long
def test_a_reference_that_is_the_receiver_is_remarked(tmp_path):
    """In terminal and report; of another file nothing is said, whatever its name."""
    path = log(tmp_path)
    done = invoke(["estimate", str(path), "-e", "ekf", "-o", "right"], tmp_path)
    assert "consistency, not accuracy" not in done.stdout
    assert "consistency" not in (tmp_path / "right" / "report.md").read_text()
    (path.parent / "copy.csv").write_bytes((path.parent / "gnss.csv").read_bytes())
    edit(path, {"reference.file": "copy.csv"})
    assert read_flight(path).reference_is_of == "gnss"
    done = invoke(["estimate", str(path), "-e", "ekf", "-o", "same"], tmp_path)
    assert done.returncode == 0, done.stderr
    assert "Note: the reference is the record of [gnss]" in done.stdout
    assert "consistency, not accuracy" in (tmp_path / "same" / "report.md").read_text()
    assert np.isfinite(read_flight(path).reference.error_state[:, 0]).all()
