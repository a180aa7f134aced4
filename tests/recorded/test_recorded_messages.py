"""Messages of the files of recorded flights."""

from __future__ import annotations

import shutil

import pytest
from recorded_flights import (
    edit,
    recorded,
)

import ggbench as gg
from ggbench.recorded.flight import read_flight
from ggbench.spec.flight import FlightError

LEVEL = {"file": "gnss.csv", "period_s": 1.0, "noise_eotvos": 1.0, "instrument": "local-level"}
INTEGRATED = {"horizontal_mgal": 20.0, "integrate_gradients": True}


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
    "a start outside the map": (
        "gradiometer",
        {
            "field.source": "../map.nc",
            "imu_record.start.latitude_rad": 0.75,
            "reference": None,
        },
        "begins outside the map",
    ),
}
"""Logs, changes of their keys, and parts of messages."""


@pytest.mark.parametrize("name", KEYS)
def test_a_wrong_key_is_refused_with_a_sentence(name, logs, tmp_path):
    """The file, the key, what was found and what is allowed."""
    log, changes, *said = KEYS[name]
    shutil.copytree(logs / log, tmp_path / "log")
    shutil.copy(logs / "map.nc", tmp_path / "map.nc")
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
"""Records that are none."""


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
