"""Recorded measurements: columns of the files, and assignment to INS samples."""

from __future__ import annotations

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..gravity.meridians import turns
from ..maps.survey_lines import zero_rows
from ..sensors.aiding import Motion, position_error
from ..sensors.gnss import Gnss
from ..simulation.sensor_suite import SensorSuite
from ..spec.aiding import RecordedGnss
from ..spec.columns import called
from ..spec.flight import FlightSpec
from ..spec.limits import FASTEST_MPS, HIGHEST_M, LOWEST_M
from ..spec.named_sensors import sensors_of, table_of
from . import columns as files
from .columns import Columns
from .motion import (
    POSITION,
    positions_of,
    require_consistent,
    velocities_of,
    velocity_columns,
)
from .time_base import TimeBase, clocked, require_period

_AXES = {"E": "east", "N": "north", "U": "up"}
_ENDS = {"mGal": "mgal", "m/s": "mps", "m": "m"}
"""Suffixes of column names, by unit of the channel."""
_LIMITS = {
    "eotvos": (-1e7, 1e7),
    "mgal": (-1e7, 1e7),
    "mps": (-FASTEST_MPS, FASTEST_MPS),
    "m": (LOWEST_M, HIGHEST_M),
}
"""Limits of possible measurements, by suffix of the column name."""
_MARKS = (-9999.0, -999.0, -99999.0, -999999.0, 9999.0, 99999.0, -32768.0)
"""Common codes for missing values; a row with only one of these codes has no measurement."""
_FARTHEST = 20_000.0
"""Allowed initial distance between receiver and INS, in addition to that of the prior [m]."""
_FOOT = 0.3048
_FEET_FROM, _NEARLY = 100.0, 0.02
"""Height difference from which a unit of feet is tested [m], and relative tolerance."""


class Series(NamedTuple):
    """Recorded measurements of one sensor: G measurements in w columns of a file.

    Attributes
    ----------
    samples : (G,) index of the INS sample of each measurement.
    values : (G, w) measured values by column; NaN if missing.
    columns : columns of the file.
    rows : (G,) index of each measurement's row in the file.
    zeros : (G,) whether all channels of a gradiometer are exactly 0, and thus missing.
    """

    samples: np.ndarray
    values: np.ndarray
    columns: Columns
    rows: np.ndarray
    zeros: np.ndarray


def column_names(spec: FlightSpec, model: SensorSuite, sensor: str) -> tuple[str, ...]:
    """Return the column names of a sensor's file, in the order of the channels.

    Receivers and gradiometers have special column names; other sensors have the names of the
    channels.
    """
    table = sensors_of(spec)[sensor]
    if sensor == "gradiometer":
        assert model.gradiometer is not None
        return tuple(f"gradient_{name}_eotvos" for name in model.gradiometer.components)
    if isinstance(table, RecordedGnss):
        names: tuple[str, ...] = POSITION if table.position_noise_m is not None else ()
        if table.frame is not None and table.velocity_noise_mps is not None:
            names += velocity_columns(table.frame)
        return names
    return tuple(
        "_".join([*(_AXES.get(word, word) for word in c.name.split()), _ENDS[c.unit]])
        for c in model.channels
        if c.sensor == sensor
    )


def read_series(
    spec: FlightSpec, folder: Path, model: SensorSuite, base: TimeBase
) -> dict[str, Series]:
    """Read the measurements of every sensor; the gradiometer comes first.

    Raises FlightError if a file is invalid.
    """
    return {sensor: _read(spec, folder, model, base, sensor) for sensor in sensors_of(spec)}


def _read(
    spec: FlightSpec, folder: Path, model: SensorSuite, base: TimeBase, sensor: str
) -> Series:
    table = sensors_of(spec)[sensor]
    names = column_names(spec, model, sensor)
    columns = files.read(
        folder / table.file, names, may_be_empty=names, names=called(table.columns)
    )
    times = clocked(columns, table.clock_offset_s)
    if len(times) > 2:
        require_period(columns, times, table.period_s, "readings", table_of(sensor))
    samples, rows = base.samples_of(columns, times, table.outside)
    values = columns.stacked(names)
    zeros = zero_rows(values) & (sensor == "gradiometer")
    values[zeros] = np.nan
    marks = (values == values[:, :1]).all(axis=1) & np.isin(values[:, 0], _MARKS)
    if marks.any() and values.shape[1] > 1:
        row = int(marks.argmax())
        raise columns.error(
            f"{', '.join(names)} are all {values[row, 0]:g}, a code for missing values (in "
            f"{marks.sum()} of {len(values)} rows): leave the cells of missing measurements empty",
            row,
        )
    if not np.isfinite(values[rows]).any():
        what = "0 or empty" if zeros[rows].any() else "empty"
        raise columns.error(f"has no measurement: {', '.join(names)} are all {what}")
    if isinstance(table, RecordedGnss):
        values = _of_receiver(columns, times, table)
    else:
        columns.require_within(
            {name: _LIMITS[name.rpartition("_")[2]] for name in names}  # by their units
        )
    return Series(samples, values[rows], columns, rows, zeros[rows])


def _of_receiver(columns: Columns, times: np.ndarray, table: RecordedGnss) -> np.ndarray:
    """Return the measurements (N, 3 or 6) of a receiver: positions, velocities or both.

    Positions are in [rad, rad, m], velocities are ENU [m/s].
    """
    parts = []
    if table.position_noise_m is not None:
        parts.append(positions_of(columns))
    if table.velocity_noise_mps is not None and table.frame is not None:
        parts.append(velocities_of(columns, table.frame))
        if len(parts) == 2:
            noise = max(table.position_noise_m or 0.0, table.height_noise_m or 0.0)
            require_consistent(columns, times, parts[0], parts[1], table.frame, noise)
    return np.concatenate(parts, axis=1)


def gradients(spec: FlightSpec, base: TimeBase, series: Series) -> tuple[np.ndarray, np.ndarray]:
    """Return gradiometer measurements (1, G, g) [E], and a mask (1, G) of missing measurements.

    G is the number of measurements, and g the number of channels. The first axis is the single run.

    Raises FlightError if a measurement is incomplete, or if an instrument with a low-pass filter
    has a missing measurement.
    """
    values, table = series.values, spec.gradiometer
    assert table is not None
    there = np.isfinite(values)
    partly = there.any(axis=1) & ~there.all(axis=1)
    if partly.any():
        raise series.columns.error(
            "some channels of the gradiometer are empty, but each row must have all or none; "
            "list the channels in gradiometer.components",
            int(series.rows[partly.argmax()]),
        )
    missing = ~there.all(axis=1)
    if table.filter != "none":
        stride = round(table.period_s / base.dt)
        late = np.flatnonzero(np.diff(series.samples) != stride)
        if missing.any() or len(late):
            n = int(missing.argmax()) if missing.any() else int(late[0]) + 1
            zero = "all channels are 0: " if series.zeros[n] else ""
            raise series.columns.error(
                f"{zero}measurements are missing or do not follow gradiometer.period_s; gaps are "
                'allowed only without a filter (filter = "none")',
                int(series.rows[n]),
            )
    return np.where(there, values, 0.0)[np.newaxis], missing[np.newaxis]


def others(
    model: SensorSuite, series: dict[str, Series], at: list[np.ndarray], ins: Motion
) -> tuple[np.ndarray, np.ndarray]:
    """Return the measurements (1, K, e) of all sensors except the gradiometer, and a mask.

    The mask (1, K, e) marks available measurements. K is the number of epochs, and e the number of
    channels of these sensors. ``at`` contains, for each sensor, the epoch index of each of its
    measurements. ``ins`` is the INS solution at the epochs, with arrays (1, K, ...).
    """
    width = sum(len(sensor.channels) for sensor in model.aiding)
    read = np.full((*ins.positions.shape[:2], width), np.nan)
    first = 0
    for sensor, epochs in zip(model.aiding, at, strict=True):
        last = first + len(sensor.channels)
        values = series[sensor.name].values.copy()
        if isinstance(sensor, Gnss) and sensor.position:
            # As the model has it: relative to where the INS believes to be, in its turn.
            indicated = ins.positions[0, epochs]
            values[:, 1] += turns(values[:, 1], indicated[:, 1], math.tau)
            values[:, :3] = -position_error(indicated, values[:, :3])
        read[0, epochs, first:last] = values
        first = last
    present = np.isfinite(read)
    return np.where(present, read, 0.0), present


def require_near(
    columns: Columns, rows: np.ndarray, away: np.ndarray, allowed: float, what: str
) -> None:
    """Raise FlightError if a record's first position is far from that of the INS.

    The error is also raised if the height of the record or of the INS is likely to be in feet. The
    record is that of a receiver or of a reference track.

    ``rows`` (G,) are indices of rows of the record. For each of these rows, ``away`` (G, 3)
    contains the difference of recorded and INS position [m]; NaN if missing. ``allowed`` is the
    largest distance that the prior allows [m]. ``what`` is the name of the record in the message.
    """
    there = np.flatnonzero(np.isfinite(away[:, :2]).all(axis=1))
    if not len(there):
        return
    n = int(there[0])
    distance = float(np.linalg.norm(away[n, :2]))
    if distance > allowed + _FARTHEST:
        small = (np.abs(columns.stacked(POSITION[:2])[rows[n]]) < [0.5 * math.pi, math.pi]).all()
        hint = " are latitude and longitude radians?" if small else ""
        raise columns.error(
            f"{what} is {distance / 1e3:.4g} km away from the INS at its first "
            f"measurement:{hint} check the clocks (clock_offset_s), and the order and signs of "
            "latitude and longitude",
            int(rows[n]),
        )
    apart, height = abs(float(away[n, 2])), abs(float(columns[POSITION[2]][rows[n]]))
    if apart > _FEET_FROM and any(
        abs(apart - share * height) < _NEARLY * height for share in (1.0 - _FOOT, 1.0 / _FOOT - 1.0)
    ):
        raise columns.error(
            f"{what} is {apart:.4g} m above or below the INS at its first measurement, at a height "
            f"of {height:.4g}: one of the two heights is in feet; state the unit, as in columns = "
            '{ height_m = "height_m [ft]" }',
            int(rows[n]),
        )
