"""What users get wrong in a recorded flight: each mistake ends with a sentence that names it."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from recorded_flights import GNSS_ONLY, as_solution, edit, edit_rows, recorded, table_of
from small_cases import blank_map, small_flight
from thinning import thinned

import ggbench as gg
from ggbench.maps.recipe import write
from ggbench.recorded.flight import read_flight
from ggbench.recorded.inertial import DELTAS, RATES
from ggbench.spec.flight import FlightError

LEVEL = {"file": "gnss.csv", "period_s": 1.0, "noise_eotvos": 1.0, "instrument": "local-level"}
INTEGRATED = {"horizontal_mgal": 20.0, "integrate_gradients": True}


@pytest.fixture(scope="module")
def logs(tmp_path_factory) -> Path:
    """Logs of one flight: of increments, of a solution, and with a gradiometer."""
    folder = tmp_path_factory.mktemp("logs")
    flown = small_flight(GNSS_ONLY)
    recorded(folder / "increments", flown)
    as_solution(recorded(folder / "solution", flown), flown)
    stern = {key.replace("gnss.", "sensor.stern."): value for key, value in GNSS_ONLY.items()}
    recorded(folder / "sensor", GNSS_ONLY | stern | {"sensor.stern.kind": "gnss"})
    recorded(folder / "gradiometer", {})
    recorded(folder / "filtered", {"gradiometer.filter": "butterworth"})
    recorded(folder / "altimeter", GNSS_ONLY | {"altimeter.noise_m_per_sqrt_hz": 1.0})
    write(folder / "map.nc", blank_map())
    return folder


def _times(change):
    return lambda table: table.assign(time_s=change(table.time_s.to_numpy().copy()))


def _set(row, **values):
    def change(table: pd.DataFrame) -> pd.DataFrame:
        for name, value in values.items():
            table.loc[row, name] = value
        return table

    return change


def _zeros(rows, value=0.0):
    def change(table: pd.DataFrame) -> pd.DataFrame:
        table.loc[rows, [name for name in table if name.startswith("gradient_")]] = value
        return table

    return change


def _scale(factor, *names):
    def change(table: pd.DataFrame) -> pd.DataFrame:
        for name in names:
            table[name] = factor * table[name]
        return table

    return change


def _twice(times):
    times[7] = times[6]
    return times


def _back(times):
    times[7] = times[5]
    return times


def _swap(one, other):
    return lambda table: table.rename(columns={one: other, other: one})


def _drop_rows(first, last):
    return lambda table: table.drop(index=range(first, last))


ROWS = {
    # the clock of the INS
    "duplicate": ("solution", "ins", _times(_twice), "ins.csv: line 9: time 0.6", "is there twice"),
    "backwards": ("solution", "ins", _times(_back), "line 9", "is behind that of the row before"),
    "gap": (
        "solution",
        "ins",
        _drop_rows(50, 60),
        "line 52",
        "a gap of 1.1 s",
        "0.15 s (max_gap_s) is",
    ),
    "milliseconds": ("solution", "ins", _times(lambda t: 1e3 * t), "100 s apart", "in seconds"),
    "two rows": ("solution", "ins", _drop_rows(2, 201), "has 2 rows"),
    "gap of increments": ("increments", "imu", _drop_rows(50, 60), "a gap of 1.1 s"),
    "increments that shake": (
        "increments",
        "imu",
        _times(lambda t: t + 0.03 * np.sin(7.0 * t)),
        "must come at regular intervals",
        "give rates",
    ),
    # readings on it
    "reading before": (
        "solution",
        "gnss",
        _times(lambda t: t - 2.0),
        "line 2",
        "outside the",
        "clock_offset_s",
        'outside = "drop"',
    ),
    "reading behind": ("solution", "gnss", _times(lambda t: t + 2.0), "line 20", "lies outside"),
    "another day": (
        "solution",
        "gnss",
        _times(lambda t: t + 86400.0),
        "as do 20 of 20 measurements",
    ),
    "between samples": (
        "solution",
        "gnss",
        _times(lambda t: t - 0.04),
        "0.04 s away from the nearest sample",
        "time_tolerance_s",
        "0.05 s",
    ),
    "two at a sample": (
        "solution",
        "gnss",
        lambda t: pd.concat([t, t.iloc[5:6].assign(time_s=6.005)]).sort_values("time_s"),
        "belong to the same sample",
    ),
    "period": ("solution", "gnss", lambda t: t.iloc[::2], "2 s apart", "gnss.period_s is 1 s"),
    "all empty": (
        "solution",
        "gnss",
        lambda t: t.assign(**dict.fromkeys(list(t)[1:], np.nan)),
        "has no measurement",
    ),
    # units and frames
    "radians": (
        "solution",
        "ins",
        _scale(np.pi / 180, "latitude_deg", "longitude_deg"),
        "they agree if latitude and longitude are radians",
    ),
    "east is north": (
        "solution",
        "ins",
        _swap("velocity_east_mps", "velocity_north_mps"),
        "they agree if the east and north velocities are exchanged",
    ),
    "backwards flight": (
        "solution",
        "ins",
        _scale(-1.0, "velocity_east_mps", "velocity_north_mps"),
        "both horizontal velocities have the opposite sign",
    ),
    "km/h": (
        "solution",
        "ins",
        _scale(3.6, "velocity_east_mps", "velocity_north_mps", "velocity_up_mps"),
        "km/h",
    ),
    "latitude is longitude": (
        "solution",
        "ins",
        lambda t: t.assign(latitude_deg=t.longitude_deg - 80.0, longitude_deg=t.latitude_deg),
        "they agree if latitude and longitude are exchanged",
    ),
    "height jumps": (
        "solution",
        "ins",
        _set(range(80, 201), height_m=13000.0),
        "line 82",
        "the height jumps by 300",
    ),
    "position jumps": (
        "solution",
        "ins",
        _set(range(80, 201), latitude_deg=33.6),
        "line 82",
        "the position jumps by 1.1",
    ),
    "latitude": ("solution", "ins", _set(3, latitude_deg=133.5), "line 5", "latitude_deg is 133.5"),
    "roll": ("solution", "ins", _set(3, roll_deg=200.0), "roll_deg is 200"),
    "centimetres": ("solution", "ins", _scale(100.0, "height_m"), "height_m is 999", "100000"),
    "speed": ("solution", "ins", _set(3, velocity_up_mps=9000.0), "line 5", "up_mps is 9000"),
    "empty in the INS": ("solution", "ins", _set(3, height_m=np.nan), "line 5", "is empty"),
    "receiver elsewhere": (
        "solution",
        "gnss",
        _scale(-1.0, "latitude_deg"),
        "the receiver is 7",
        "km away from the INS at its first measurement",
    ),
    "receiver in radians": (
        "solution",
        "gnss",
        _scale(np.pi / 180, "latitude_deg", "longitude_deg"),
        "latitude and longitude are radians",
    ),
    "second receiver elsewhere": (
        "sensor",
        "stern",
        _scale(-1.0, "latitude_deg"),
        "the receiver is 7",
        "km away from the INS",
    ),
    "period of a named sensor": (
        "sensor",
        "stern",
        lambda t: t.iloc[::2],
        "2 s apart",
        "sensor.stern.period_s is 1 s",
    ),
    "speed of a named sensor": ("sensor", "stern", _set(3, velocity_up_mps=9000.0), "line 5"),
    "reference elsewhere": (
        "solution",
        "reference",
        lambda t: t.assign(longitude_deg=t.longitude_deg + 20.0),
        "km away",
    ),
    "reference in feet": (
        "solution",
        "reference",
        _scale(1.0 / 0.3048, "height_m"),
        "one of the two heights is in feet",
    ),
    "gradients of a mark of missing values": (
        "gradiometer",
        "gradiometer",
        _zeros([3], -9999.0),
        "are all -9999, in 1 of",
    ),
    "reference of another day": (
        "solution",
        "reference",
        _times(lambda t: t + 1e6),
        "lies outside the flight",
    ),
    # the inertial sensors
    "forces in g": (
        "increments",
        "imu",
        _scale(1 / 9.80665, *(f"delta_velocity_{a}_mps" for a in "xyz")),
        "if it is in g",
    ),
    "gyros in degrees": (
        "increments",
        "imu",
        lambda t: t.assign(delta_angle_z_rad=t.delta_angle_z_rad + 2.0),
        "are the values in degrees?",
    ),
    "upside down": (
        "increments",
        "imu",
        _scale(-1.0, "delta_velocity_z_mps"),
        "-9.",
        'axes = "right-forward-up"',
    ),
    "spike": (
        "increments",
        "imu",
        _set(50, delta_velocity_x_mps=500.0),
        "line 52",
        "delta_velocity_x_mps is 500",
    ),
    "half of the columns": (
        "increments",
        "imu",
        lambda t: t.drop(columns="delta_angle_x_rad"),
        "either the columns delta_angle_x_rad",
        "neither, or not all",
    ),
    "altimeter too short": ("altimeter", "altimeter", _drop_rows(100, 200), "do not cover"),
    # columns
    "no column": (
        "solution",
        "ins",
        lambda t: t.drop(columns="pitch_deg"),
        "ins.csv: line 1 names no column pitch_deg (found: time_s, latitude_deg",
    ),
    "other frame's column": (
        "solution",
        "gnss",
        lambda t: t.rename(columns={"velocity_up_mps": "velocity_down_mps"}),
        "names no column velocity_up_mps",
    ),
    "gradients in s⁻²": (
        "gradiometer",
        "gradiometer",
        _scale(1e9, "gradient_zz_eotvos"),
        "line 2",
        "must lie between -1e+07 and 1e+07",
    ),
    "part of a reading": (
        "gradiometer",
        "gradiometer",
        _set(4, gradient_xx_eotvos=np.nan),
        "line 6",
        "some channels of the gradiometer are empty",
    ),
    "zeros behind a filter": (
        "filtered",
        "gradiometer",
        _zeros(8),
        "line 10: all channels are 0",
    ),
    "zeros alone": ("gradiometer", "gradiometer", _zeros(slice(None)), "are all 0 or empty"),
    "gap behind a filter": (
        "filtered",
        "gradiometer",
        _drop_rows(8, 9),
        "gaps are allowed only without a filter",
    ),
}


@thinned("name", ROWS, every=2)
def test_a_wrong_record_is_refused_with_a_sentence(name, logs, tmp_path):
    """The file, the line where there is one, what was found and what to do."""
    log, file, change, *said = ROWS[name]
    shutil.copytree(logs / log, tmp_path / "log")
    edit_rows(tmp_path / "log" / f"{file}.csv", change)
    with pytest.raises(gg.GGBenchError) as caught:
        read_flight(tmp_path / "log" / "flight.toml")
    message = str(caught.value)
    assert isinstance(caught.value, FlightError)
    assert f"{file}.csv" in message
    for part in said:
        assert part in message, message


KEYS = {
    "no frame": ("solution", {"ins.frame": None}, "'ins.frame' is missing"),
    "unknown frame": ("solution", {"ins.frame": "XYZ"}, "ins.frame is 'XYZ' and must be 'ENU' or"),
    "no frame of velocities": ("solution", {"gnss.frame": None}, "gnss: frame is missing", "NED"),
    "no frame of a reference": ("solution", {"reference.frame": None}, "give their frame"),
    "other frame of a reference": (
        "solution",
        {"reference.frame": "NED"},
        "no column velocity_down_mps",
    ),
    "no kind": ("sensor", {"sensor.stern.kind": None}, "sensor.stern: kind is missing; allowed"),
    "unknown kind": ("sensor", {"sensor.stern.kind": "gps"}, "sensor.stern: kind is 'gps'"),
    "no file of a named sensor": (
        "sensor",
        {"sensor.stern.file": None},
        "'sensor.stern.file' is missing",
    ),
    "no frame of a named sensor": (
        "sensor",
        {"sensor.stern.frame": None},
        "sensor.stern: frame is missing",
    ),
    "unknown key of a named sensor": (
        "sensor",
        {"sensor.stern.noise_m": 1.0},
        "unknown key 'sensor.stern.noise_m'",
    ),
    "name that is taken": (
        "sensor",
        {"sensor.reference": {"kind": "barometer"}},
        "sensor.reference: this name",
    ),
    "gravimeter without a map": (
        "sensor",
        {"sensor.g": {"kind": "gravimeter", "file": "g.csv", "period_s": 1.0, "noise_mgal": 1.0}},
        "sensor.g needs a map",
    ),
    "no INS": ("solution", {"ins": None}, "give either [ins]", "[imu_record]"),
    "both": ("increments", {"ins": {"file": "x.csv", "frame": "ENU"}}, "give either [ins]"),
    "no sensor": ("solution", {"gnss": None}, "no sensor is on board"),
    "no file": ("solution", {"gnss.file": None}, "'gnss.file' is missing"),
    "file that is not there": ("solution", {"gnss.file": "gone.csv"}, "gone.csv: cannot be read"),
    "folder for a file": ("solution", {"gnss.file": "."}, "cannot be read"),
    "unknown key": ("solution", {"gnss.perod_s": 1.0}, "unknown key 'gnss.perod_s'", "period_s"),
    "truth": ("solution", {"truth.gnss.outlier_m": 1.0}, "unknown key 'truth'"),
    "text for a number": ("solution", {"gnss.position_noise_m": "3 m"}, "must be a plain number"),
    "axes": ("increments", {"imu_record.axes": "forward"}, "imu_record.axes is 'forward'"),
    "no start": ("increments", {"imu_record.start": None}, "'imu_record.start' is missing"),
    "two latitudes": (
        "increments",
        {"imu_record.start.latitude_deg": 33.5},
        "imu_record.start: give exactly one of latitude_deg and latitude_rad",
    ),
    "two attitudes": (
        "increments",
        {"imu_record.start.roll_deg": 3.0},
        "give heading_deg, pitch_deg and roll_deg, or c_nb",
    ),
    "part of an attitude": (
        "increments",
        {"imu_record.start.roll_deg": 3.0, "imu_record.start.c_nb": None},
        "give heading_deg",
    ),
    "no rotation": (
        "increments",
        {"imu_record.start.c_nb": [1.0, 0.0, 0.0] * 3},
        "c_nb is no rotation",
    ),
    "felt": ("solution", {"field.gravity_disturbance": True}, "is for simulated truth only"),
    "compensate without a map": ("solution", {"field.compensate": True}, "needs a map"),
    "gradients of a solution": (
        "solution",
        {"gradiometer": LEVEL, "disturbance": INTEGRATED},
        "needs [imu_record]",
    ),
    "gradients of a part": (
        "increments",
        {"gradiometer": LEVEL | {"components": ["zz"]}, "disturbance": INTEGRATED},
        "needs channels that determine the whole tensor; zz do not",
    ),
    "no gradients": (
        "increments",
        {"disturbance": INTEGRATED},
        "needs a gradiometer",
    ),
    "map that is not there": ("solution", {"field.source": "gone.nc"}, "gone.nc"),
    "heights of a solution": (
        "solution",
        {"altimeter": {"noise_m_per_sqrt_hz": 1.0, "file": "x.csv"}},
        "must not be given with [ins]",
    ),
    "no heights": ("altimeter", {"altimeter.file": None}, "altimeter.file is missing"),
    "quick damping": (
        "solution",
        {"imu.period_s": 0.2, "altimeter": {"noise_m_per_sqrt_hz": 1.0, "time_constant_s": 1.0}},
        "must be at least 10 times imu.period_s",
    ),
    "period of the INS": ("solution", {"imu.period_s": 0.05}, "0.1 s apart", "is 0.05 s"),
    "window": ("solution", {"windows.settled_from_s": 1e4}, "windows.settled_from_s is 10000 s"),
    "tolerance": ("solution", {"ins.time_tolerance_s": -1.0}, "ins.time_tolerance_s is -1.0"),
}


@pytest.mark.parametrize("name", KEYS)
def test_a_wrong_key_is_refused_with_a_sentence(name, logs, tmp_path):
    """The file, the key, what was found and what is allowed."""
    log, changes, *said = KEYS[name]
    shutil.copytree(logs / log, tmp_path / "log")
    with pytest.raises(gg.GGBenchError) as caught:
        read_flight(edit(tmp_path / "log" / "flight.toml", changes))
    for part in said:
        assert part in str(caught.value), str(caught.value)


HOSTILE = {
    "empty": b"",
    "names alone": b"time_s,latitude_deg,longitude_deg,height_m\n",
    "binary": b"\x00\x01\xff\xfe" * 50,
    "infinite": b"time_s,height_m\n1,inf\n2,3\n",
    "words": b"time_s,height_m\n1,high\n2,low\n3,low\n",
    "dates": b"time_s,height_m\n2020-01-01,3\n2020-01-02,3\n2020-01-03,3\n",
    "decimal commas": b"time_s;height_m\n1,5;2,5\n2,5;2,5\n",
    "ragged": b"time_s,height_m\n1,2\n2,3,4\n",
    "names twice": b"time_s,height_m,height_m\n1,2,3\n2,3,4\n",
    "huge": b"time_s,height_m\n1,1e300\n2,1e300\n3,1e300\n",
    "times without end": b"time_s,height_m\n1,2\nnan,2\n3,2\n",
    "milliseconds since 1970": b"time_s,height_m\n1e12,2\n1000000001000,2\n1000000002000,2\n",
    "far times": b"time_s,height_m\n1,2\n2,2\n1e300,2\n",
}


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_files_end_with_a_sentence(name, tmp_path):
    """Whatever a file holds, nothing but a GGBenchError comes of it, which names the file."""
    changes = {"barometer.period_s": 1.0, "barometer.noise_m": 3.0, "gradiometer": None}
    path = recorded(tmp_path / "log", changes)
    (path.parent / "barometer.csv").write_bytes(HOSTILE[name])
    with pytest.raises(FlightError, match=r"barometer\.csv"):
        read_flight(path)
    (path.parent / "barometer.csv").rename(path.parent / "barometer.nc")
    with pytest.raises(FlightError, match=r"barometer\.nc"):
        read_flight(edit(path, {"barometer.file": "barometer.nc"}))


@pytest.mark.parametrize("content", [b"", b"\xff\xfe\x00", b"[ins\n", b"ins = 3\n", b"[[ins]]\n"])
def test_a_file_that_is_no_flight_ends_with_a_sentence(content, tmp_path):
    (tmp_path / "flight.toml").write_bytes(content)
    with pytest.raises(FlightError, match=r"flight\.toml"):
        read_flight(tmp_path / "flight.toml")


def test_readings_outside_are_dropped_where_the_table_says_so(logs, tmp_path):
    """What comes before the first sample of the INS, or behind the last, is left out."""
    shutil.copytree(logs / "solution", tmp_path / "log")
    path = tmp_path / "log" / "flight.toml"
    edit_rows(path.parent / "gnss.csv", _times(lambda t: t - 2.0))
    problem, _ = gg.read_flight(edit(path, {"gnss.outside": "drop"}))
    np.testing.assert_array_equal(problem.times, np.arange(1.0, 19.0))
    edit_rows(path.parent / "gnss.csv", _times(lambda t: t + 1e5))
    with pytest.raises(FlightError, match="no measurement lies within the record of the INS"):
        read_flight(path)


def test_a_reading_beside_a_sample_belongs_to_the_nearest(logs, tmp_path):
    """Within the tolerance that the user names."""
    shutil.copytree(logs / "solution", tmp_path / "log")
    path = edit(tmp_path / "log" / "flight.toml", {"ins.time_tolerance_s": 0.05})
    before, _ = gg.read_flight(path)
    edit_rows(path.parent / "gnss.csv", _times(lambda t: t - 0.04))
    after, _ = gg.read_flight(path)
    np.testing.assert_array_equal(after.times, before.times)
    np.testing.assert_array_equal(after.measurements, before.measurements)


def test_a_gap_that_is_allowed_is_interpolated(logs, tmp_path):
    """Across it the INS goes on between its ends."""
    shutil.copytree(logs / "solution", tmp_path / "log")
    path = tmp_path / "log" / "flight.toml"
    before, _ = gg.read_flight(path)
    edit_rows(path.parent / "ins.csv", _drop_rows(50, 60))
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
    edit_rows(record, _times(lambda t: t + jitter))
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
    edit_rows(record, _set(4, gradient_xx_eotvos=0.0))
    assert read_flight(path).remarks == ()
    record.write_text(whole)
    names = [name for name in table_of(record) if name.startswith("gradient_")]
    edit_rows(record, _set(slice(4, 6), **dict.fromkeys(names, np.nan)))
    empty = read_flight(path)
    assert empty.remarks == ()
    record.write_text(whole)
    edit_rows(record, _zeros(slice(4, 6)))
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


def test_a_flight_that_begins_outside_the_map_is_refused(logs, tmp_path):
    shutil.copytree(logs / "gradiometer", tmp_path / "log")
    path = edit(
        tmp_path / "log" / "flight.toml",
        {
            "field.source": str(logs / "map.nc"),
            "imu_record.start.latitude_rad": 0.75,
            "reference": None,
        },
    )
    with pytest.raises(FlightError, match="begins outside the map"):
        read_flight(path)


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
    edit_rows(file, _set(4, height_m=np.nan))
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
