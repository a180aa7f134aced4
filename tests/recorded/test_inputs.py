"""Odd inputs of recorded flights: readings outside, gaps, zeros, references in part."""

from __future__ import annotations

import shutil

import numpy as np
import pandas as pd
import pytest
from recorded_flights import (
    edit,
    edit_rows,
    table_of,
    with_cells,
    with_times,
    with_zeros,
    without_rows,
)

import ggbench as gg
from ggbench.recorded.flight import read_flight
from ggbench.recorded.inertial import DELTAS, RATES
from ggbench.spec.flight import FlightError


def test_readings_outside_are_dropped_where_the_table_says_so(logs, tmp_path):
    """What comes before the first sample of the INS, or behind the last, is left out."""
    shutil.copytree(logs / "solution", tmp_path / "log")
    path = tmp_path / "log" / "flight.toml"
    edit_rows(path.parent / "gnss.csv", with_times(lambda t: t - 2.0))
    problem, _ = gg.read_flight(edit(path, {"gnss.outside": "drop"}))
    np.testing.assert_array_equal(problem.times, np.arange(1.0, 19.0))
    edit_rows(path.parent / "gnss.csv", with_times(lambda t: t + 1e5))
    with pytest.raises(FlightError, match="no measurement lies within the record of the INS"):
        read_flight(path)


def test_a_reading_beside_a_sample_belongs_to_the_nearest(logs, tmp_path):
    """Within the tolerance that the user names."""
    shutil.copytree(logs / "solution", tmp_path / "log")
    path = edit(tmp_path / "log" / "flight.toml", {"ins.time_tolerance_s": 0.05})
    before, _ = gg.read_flight(path)
    edit_rows(path.parent / "gnss.csv", with_times(lambda t: t - 0.04))
    after, _ = gg.read_flight(path)
    np.testing.assert_array_equal(after.times, before.times)
    np.testing.assert_array_equal(after.measurements, before.measurements)


def test_a_gap_that_is_allowed_is_interpolated(logs, tmp_path):
    """Across it the INS goes on between its ends."""
    shutil.copytree(logs / "solution", tmp_path / "log")
    path = tmp_path / "log" / "flight.toml"
    before, _ = gg.read_flight(path)
    edit_rows(path.parent / "ins.csv", without_rows(50, 60))
    with pytest.warns(UserWarning, match="10 missing samples interpolated, longest gap 1.1 s"):
        after, _ = gg.read_flight(edit(path, {"ins.max_gap_s": 1.2}))
    off = (after.track.positions - before.track.positions) * [6.4e6, 5.3e6, 1.0]
    assert np.abs(off).max() < 0.5
    assert np.abs(after.track.attitudes - before.track.attitudes).max() < 1e-4


def test_interpolated_samples_are_counted(logs, tmp_path):
    """Of all gaps; as a control, nothing is missing of a whole record or of times that jitter."""
    shutil.copytree(logs / "solution", tmp_path / "log")
    path = edit(tmp_path / "log" / "flight.toml", {"ins.max_gap_s": 1.2})
    record = path.parent / "ins.csv"
    whole = record.read_text()
    assert read_flight(path).remarks == ()
    jitter = np.pad(np.random.default_rng(1).uniform(-0.04, 0.04, 199), 1)
    edit_rows(record, with_times(lambda t: t + jitter))
    assert np.diff(table_of(record).time_s).max() > 0.16
    assert read_flight(path).remarks == ()
    record.write_text(whole)
    edit_rows(record, lambda table: table.drop(index=[20, 50, 51, 90]))
    said = ("ins.csv: 4 missing samples interpolated, longest gap 0.3 s",)
    assert read_flight(path).remarks == said
    record.write_text(whole)
    edit_rows(record, lambda table: table.drop(index=20))
    said = ("ins.csv: 1 missing sample interpolated, longest gap 0.2 s",)
    assert read_flight(path).remarks == said


def test_interpolated_samples_of_rates_are_counted(logs, tmp_path):
    shutil.copytree(logs / "increments", tmp_path / "log")
    path = edit(tmp_path / "log" / "flight.toml", {"imu_record.max_gap_s": 1.2})

    def rates(table: pd.DataFrame) -> pd.DataFrame:
        table[list(DELTAS)] /= 0.1
        return table.rename(columns=dict(zip(DELTAS, RATES, strict=True))).drop(index=[30, 31])

    edit_rows(path.parent / "imu.csv", rates)
    said = ("imu.csv: 2 missing samples interpolated, longest gap 0.3 s",)
    assert read_flight(edit(path, {"gnss.outside": "drop"})).remarks == said


def test_rows_of_zeros_of_a_gradiometer_are_missing(logs, tmp_path):
    """As if they were empty; as a control, a 0 in a part of the channels is a measurement."""
    shutil.copytree(logs / "gradiometer", tmp_path / "log")
    path = tmp_path / "log" / "flight.toml"
    record = path.parent / "gradiometer.csv"
    whole = record.read_text()
    edit_rows(record, with_cells(4, gradient_xx_eotvos=0.0))
    assert read_flight(path).remarks == ()
    record.write_text(whole)
    names = [name for name in table_of(record) if name.startswith("gradient_")]
    edit_rows(record, with_cells(slice(4, 6), **dict.fromkeys(names, np.nan)))
    empty = read_flight(path)
    assert empty.remarks == ()
    record.write_text(whole)
    edit_rows(record, with_zeros(slice(4, 6)))
    zeros = read_flight(path)
    assert zeros.remarks == ("gradiometer.csv: 3 rows of zeros read as missing measurements",)
    np.testing.assert_array_equal(zeros.problem.present, empty.problem.present)
    np.testing.assert_array_equal(zeros.problem.measurements, empty.problem.measurements)
    assert (~zeros.problem.present.any(axis=1)).sum() == 3
    with pytest.warns(UserWarning, match="3 rows of zeros"):
        gg.read_flight(path)


def test_a_reference_of_positions_in_part_of_the_flight(logs, tmp_path):
    """It judges the epochs that it covers, and what it does not know is not a number."""
    shutil.copytree(logs / "solution", tmp_path / "log")
    path = tmp_path / "log" / "flight.toml"
    whole = read_flight(path).reference
    edit_rows(path.parent / "reference.csv", lambda t: t.iloc[4:12, :4])
    found = read_flight(edit(path, {"reference.frame": None})).reference
    np.testing.assert_array_equal(found.error_state[4:12, :3], whole.error_state[4:12, :3])
    assert np.isnan(found.error_state[:, 3:]).all()
    assert np.isnan(found.error_state[[0, 3, 12, 19]]).all()


def test_a_reference_between_epochs_is_interpolated(logs, tmp_path):
    """Straight on, its rows half a second off: the flight is straight, too."""
    shutil.copytree(logs / "solution", tmp_path / "log")
    path = tmp_path / "log" / "flight.toml"
    whole = read_flight(path).reference

    def between(table: pd.DataFrame) -> pd.DataFrame:
        return 0.5 * (table.iloc[1:].reset_index(drop=True) + table.iloc[:-1])

    edit_rows(path.parent / "reference.csv", between)
    found = read_flight(path).reference
    inner = slice(1, 19)
    np.testing.assert_allclose(
        found.error_state[inner, :6], whole.error_state[inner, :6], rtol=0.0, atol=1e-3
    )


def test_a_map_is_found_beside_the_flight(logs, tmp_path):
    """Paths in the file are relative to its folder."""
    shutil.copytree(logs / "gradiometer", tmp_path / "log")
    shutil.copy(logs / "map.nc", tmp_path / "log" / "map.nc")
    problem, _ = gg.read_flight(edit(tmp_path / "log" / "flight.toml", {"field.source": "map.nc"}))
    assert np.isfinite(problem.map.lower).all()


def test_missing_numbers_are_empty_or_nan(logs, tmp_path):
    """A channel that is empty is missing; the others of the reading are there."""
    shutil.copytree(logs / "solution", tmp_path / "log")
    path = tmp_path / "log" / "flight.toml"
    file = path.parent / "gnss.csv"
    edit_rows(file, with_cells(4, height_m=np.nan))
    lines = file.read_text().splitlines()
    cells = lines[7].split(",")
    lines[7] = ",".join([*cells[:4], "NaN", *cells[5:]])
    file.write_text("\n".join(lines) + "\n")
    problem, _ = gg.read_flight(path)
    wanted = np.ones((20, 6), dtype=bool)
    wanted[4, 2] = wanted[6, 3] = False
    np.testing.assert_array_equal(problem.present, wanted)
    assert (problem.measurements[~wanted] == 0.0).all()
    assert len(table_of(file)) == 20
