"""Messages of the records of a flight."""

from __future__ import annotations

import shutil

import numpy as np
import pandas as pd
import pytest
from recorded_flights import (
    edit_rows,
    with_cells,
    with_times,
    with_zeros,
    without_rows,
)
from thinning import thinned

import ggbench as gg
from ggbench.recorded.flight import read_flight
from ggbench.spec.flight import FlightError


def scaled(factor, *names):
    def change(table: pd.DataFrame) -> pd.DataFrame:
        for name in names:
            table[name] = factor * table[name]
        return table

    return change


def twice(times):
    times[7] = times[6]
    return times


def back(times):
    times[7] = times[5]
    return times


def swapped(one, other):
    return lambda table: table.rename(columns={one: other, other: one})


ROWS = {
    # the clock of the INS
    "duplicate": (
        "solution",
        "ins",
        with_times(twice),
        "ins.csv: line 9: time 0.6",
        "occurs twice",
    ),
    "backwards": (
        "solution",
        "ins",
        with_times(back),
        "line 9",
        "is less than the time of the row before",
    ),
    "gap": (
        "solution",
        "ins",
        without_rows(50, 60),
        "line 52",
        "a gap of 1.1 s",
        "0.15 s (max_gap_s) is",
    ),
    "milliseconds": ("solution", "ins", with_times(lambda t: 1e3 * t), "100 s apart", "in seconds"),
    "two rows": ("solution", "ins", without_rows(2, 201), "has 2 rows"),
    "gap of increments": ("increments", "imu", without_rows(50, 60), "a gap of 1.1 s"),
    "increments that shake": (
        "increments",
        "imu",
        with_times(lambda t: t + 0.03 * np.sin(7.0 * t)),
        "must come at regular intervals",
        "give rates",
    ),
    # readings on it
    "reading before": (
        "solution",
        "gnss",
        with_times(lambda t: t - 2.0),
        "line 2",
        "outside the",
        "clock_offset_s",
        'outside = "drop"',
    ),
    "reading behind": (
        "solution",
        "gnss",
        with_times(lambda t: t + 2.0),
        "line 20",
        "lies outside",
    ),
    "another day": (
        "solution",
        "gnss",
        with_times(lambda t: t + 86400.0),
        "20 of 20 measurements are outside",
    ),
    "between samples": (
        "solution",
        "gnss",
        with_times(lambda t: t - 0.04),
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
        scaled(np.pi / 180, "latitude_deg", "longitude_deg"),
        "they agree if latitude and longitude are radians",
    ),
    "east is north": (
        "solution",
        "ins",
        swapped("velocity_east_mps", "velocity_north_mps"),
        "they agree if the east and north velocities are exchanged",
    ),
    "backwards flight": (
        "solution",
        "ins",
        scaled(-1.0, "velocity_east_mps", "velocity_north_mps"),
        "both horizontal velocities have the opposite sign",
    ),
    "km/h": (
        "solution",
        "ins",
        scaled(3.6, "velocity_east_mps", "velocity_north_mps", "velocity_up_mps"),
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
        with_cells(range(80, 201), height_m=13000.0),
        "line 82",
        "the height jumps by 300",
    ),
    "position jumps": (
        "solution",
        "ins",
        with_cells(range(80, 201), latitude_deg=33.6),
        "line 82",
        "the position jumps by 1.1",
    ),
    "latitude": (
        "solution",
        "ins",
        with_cells(3, latitude_deg=133.5),
        "line 5",
        "latitude_deg is 133.5",
    ),
    "roll": ("solution", "ins", with_cells(3, roll_deg=200.0), "roll_deg is 200"),
    "centimetres": ("solution", "ins", scaled(100.0, "height_m"), "height_m is 999", "100000"),
    "speed": ("solution", "ins", with_cells(3, velocity_up_mps=9000.0), "line 5", "up_mps is 9000"),
    "empty in the INS": ("solution", "ins", with_cells(3, height_m=np.nan), "line 5", "is empty"),
    "receiver elsewhere": (
        "solution",
        "gnss",
        scaled(-1.0, "latitude_deg"),
        "the receiver is 7",
        "km away from the INS at its first measurement",
    ),
    "receiver in radians": (
        "solution",
        "gnss",
        scaled(np.pi / 180, "latitude_deg", "longitude_deg"),
        "latitude and longitude are radians",
    ),
    "second receiver elsewhere": (
        "sensor",
        "stern",
        scaled(-1.0, "latitude_deg"),
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
    "speed of a named sensor": ("sensor", "stern", with_cells(3, velocity_up_mps=9000.0), "line 5"),
    "reference elsewhere": (
        "solution",
        "reference",
        lambda t: t.assign(longitude_deg=t.longitude_deg + 20.0),
        "km away",
    ),
    "reference in feet": (
        "solution",
        "reference",
        scaled(1.0 / 0.3048, "height_m"),
        "one of the two heights is in feet",
    ),
    "gradients of a mark of missing values": (
        "gradiometer",
        "gradiometer",
        with_zeros([3], -9999.0),
        "are all -9999, a code for missing values (in 1 of",
    ),
    "reference of another day": (
        "solution",
        "reference",
        with_times(lambda t: t + 1e6),
        "lies outside the flight",
    ),
    # the inertial sensors
    "forces in g": (
        "increments",
        "imu",
        scaled(1 / 9.80665, *(f"delta_velocity_{a}_mps" for a in "xyz")),
        "the unit may be g",
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
        scaled(-1.0, "delta_velocity_z_mps"),
        "-9.",
        'axes = "right-forward-up"',
    ),
    "spike": (
        "increments",
        "imu",
        with_cells(50, delta_velocity_x_mps=500.0),
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
    "altimeter too short": ("altimeter", "altimeter", without_rows(100, 200), "do not cover"),
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
        scaled(1e9, "gradient_zz_eotvos"),
        "line 2",
        "must lie between -1e+07 and 1e+07",
    ),
    "part of a reading": (
        "gradiometer",
        "gradiometer",
        with_cells(4, gradient_xx_eotvos=np.nan),
        "line 6",
        "some channels of the gradiometer are empty",
    ),
    "zeros behind a filter": (
        "filtered",
        "gradiometer",
        with_zeros(8),
        "line 10: all channels are 0",
    ),
    "zeros alone": ("gradiometer", "gradiometer", with_zeros(slice(None)), "are all 0 or empty"),
    "gap behind a filter": (
        "filtered",
        "gradiometer",
        without_rows(8, 9),
        "gaps are allowed only without a filter",
    ),
}
"""Logs, their files, changes of their tables, and parts of messages."""


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
