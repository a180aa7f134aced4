"""INS solution of a recorded flight: recorded, or mechanized from an IMU log."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..gravity.field import Field
from ..ins.known_gravity import KnownGravity
from ..ins.strapdown import TRACK, error_free_increments, navigate_lanes
from ..numerics.lanes import in_lanes, unfilled
from ..numerics.rotations import between
from ..simulation.field_source import beside
from ..simulation.replay import Recording
from ..simulation.sensor_suite import SensorSuite
from ..spec.case import MOST_SAMPLES
from ..spec.columns import called
from ..spec.flight import FlightError, FlightSpec, ImuRecord, InsRecord, StartSpec
from ..trajectory.truth import attitudes_of
from . import columns as files
from .columns import Columns
from .motion import (
    ATTITUDE,
    POSITION,
    attitudes_in,
    positions_of,
    require_consistent,
    velocities_of,
    velocity_columns,
)
from .time_base import TimeBase, clocked, time_base

DELTAS = (
    *(f"delta_angle_{axis}_rad" for axis in "xyz"),
    *(f"delta_velocity_{axis}_mps" for axis in "xyz"),
)
"""Columns of increments; a row contains the increments of the interval before its time."""
RATES = (
    *(f"angular_rate_{axis}_radps" for axis in "xyz"),
    *(f"specific_force_{axis}_mps2" for axis in "xyz"),
)
_TO_RIGHT_FORWARD_UP = {
    "right-forward-up": np.eye(3),
    "forward-right-down": np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]),
    "forward-left-up": np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]),
}
_GRAVITY = 9.80665
_FASTEST_SPIN, _LARGEST_FORCE = 100.0, 1000.0
"""Largest possible angular rate [rad/s] and specific force [m/s²] of a sample."""
_SPINS = 10.0
"""Largest plausible median of the angular rate [rad/s]."""


class Inertial(NamedTuple):
    """INS record of a flight, as input of compiled kernels.

    In shapes, N is the number of intervals between samples. TRACK = 15 is the number of elements of
    position, velocity and C_nb. LANES is the number of runs that a kernel processes together; only
    the first run is used.

    Attributes
    ----------
    path : path of the record.
    base : time base of the samples.
    increments : (N, 6, LANES) angle and velocity increments.
    longitude : longitude of the first sample [rad]; all longitudes continue from it without jumps.
    solution : (N + 1, TRACK, LANES) recorded INS solution; None with recorded IMU data.
    recording : data for the mechanization; None with a recorded INS solution.
    """

    path: Path
    base: TimeBase
    increments: np.ndarray
    longitude: float
    solution: np.ndarray | None = None
    recording: Recording | None = None

    def navigated(self, gravity: KnownGravity) -> np.ndarray:
        """Return the INS solution (N + 1, TRACK, LANES) at the samples.

        The symbols of the shape are explained in :class:`Inertial`. ``gravity`` is the gravity that
        the mechanization adds to normal gravity.

        Raises FlightError if numbers of the mechanization overflow.
        """
        if self.solution is not None:
            return self.solution
        assert self.recording is not None  # one or the other
        track = unfilled(self.base.count + 1, TRACK)
        navigate_lanes(
            initial=in_lanes(self.recording.initial[np.newaxis]),
            increments=self.increments,
            dt=self.base.dt,
            heights=self.recording.heights,
            gains=self.recording.gains,
            gravity=gravity,
            track=track,
        )
        if not np.isfinite(track).all():
            raise FlightError(f"{self.path}: the mechanization diverges: check the increments")
        return track


def inertial(spec: FlightSpec, folder: Path, model: SensorSuite, field: Field) -> Inertial:
    """Read the INS record of a recorded flight.

    ``folder`` is the folder of the flight file. ``model`` and ``field`` are the assumed sensors and
    map.

    Raises FlightError if a record is invalid.
    """
    if spec.ins is not None:
        return _of_solution(spec, spec.ins, folder, field)
    assert spec.imu_record is not None  # the specification checks it
    return _increments(spec, spec.imu_record, folder, model)


def _of_solution(spec: FlightSpec, record: InsRecord, folder: Path, field: Field) -> Inertial:
    """Return a recorded INS solution, and the increments that reproduce it.

    The inverse mechanization computes the increments from velocities and attitudes. Recorded
    positions are kept, because the integration rule of the INS is unknown.
    """
    columns = files.read(
        folder / record.file,
        (*POSITION, *velocity_columns(record.frame), *ATTITUDE),
        names=called(record.columns),
    )
    times = clocked(columns, record.clock_offset_s)
    positions, velocities = positions_of(columns), velocities_of(columns, record.frame)
    attitudes = attitudes_in(columns)
    base, exact = time_base(
        columns, times, spec.imu.period_s, record.max_gap_s, record.time_tolerance_s
    )
    _require_few(base, columns)
    require_consistent(columns, times, positions, velocities, record.frame)
    if not exact:
        at, since = base.times, times - base.start
        before = np.clip(np.searchsorted(since, at, side="right") - 1, 0, len(since) - 2)
        share = np.clip((at - since[before]) / (since[before + 1] - since[before]), 0.0, 1.0)
        positions, velocities = (_interpolated(at, since, v) for v in (positions, velocities))
        attitudes = between(attitudes[before], attitudes[before + 1], share)
    felt, start = np.zeros((base.count, 3)), float(positions[0, 1])
    if spec.field.compensate:
        felt = beside(field, start).gravity_disturbance(*(0.5 * (positions[1:] + positions[:-1])).T)
    deltas = error_free_increments(
        np.ascontiguousarray(positions), np.ascontiguousarray(velocities), attitudes, felt, base.dt
    )
    states = np.concatenate([positions, velocities, attitudes.reshape(-1, 9)], axis=1)
    increments = in_lanes(np.hstack(deltas)[np.newaxis])
    return Inertial(columns.path, base, increments, start, in_lanes(states[np.newaxis]))


def _increments(spec: FlightSpec, record: ImuRecord, folder: Path, model: SensorSuite) -> Inertial:
    """Return recorded increments, or integrated rates, and the initial state."""
    columns = files.read(folder / record.file, (), (*DELTAS, *RATES), names=called(record.columns))
    kinds = [names for names in (DELTAS, RATES) if all(name in columns for name in names)]
    if len(kinds) != 1:
        raise columns.error(
            f"must have either the columns {', '.join(DELTAS)} or {', '.join(RATES)}, and has "
            + ("both" if kinds else "neither, or not all of them")
        )
    times, values = clocked(columns, record.clock_offset_s), columns.stacked(kinds[0])
    before = 1 if kinds[0] is DELTAS else 0
    share = spec.imu.period_s if before else 1.0
    most = (_FASTEST_SPIN * share,) * 3 + (_LARGEST_FORCE * share,) * 3
    columns.require_within({n: (-m, m) for n, m in zip(kinds[0], most, strict=True)})
    base, exact = time_base(
        columns, times, spec.imu.period_s, record.max_gap_s, record.time_tolerance_s, before
    )
    _require_few(base, columns)
    if kinds[0] is DELTAS:
        if not exact and np.abs(
            times - base.start - base.dt * np.arange(1, len(times) + 1)
        ).max() > (base.tolerance):
            raise columns.error(
                "its increments must come at regular intervals of imu.period_s: add the missing "
                "rows, or give rates, whose times may be irregular"
            )
        deltas, base = values, TimeBase(base.start, base.dt, len(values), base.tolerance)
    else:
        # Summed up to each row, then taken at the samples: nothing that was felt is left out.
        since = times - base.start
        means = 0.5 * (values[1:] + values[:-1]) * np.diff(since)[:, np.newaxis]
        summed = np.concatenate([np.zeros((1, 6)), np.cumsum(means, axis=0)])
        deltas = np.diff(_interpolated(base.times, since, summed), axis=0)
    turn = _TO_RIGHT_FORWARD_UP[record.axes]
    deltas = np.hstack([deltas[:, :3] @ turn.T, deltas[:, 3:] @ turn.T])
    initial = _start(record.start)
    _require_felt(columns, deltas / base.dt, initial[6:].reshape(3, 3), record.axes, base.dt)
    heights, gains = unfilled(0, 1), (0.0, 0.0)
    if model.altimeter is not None:
        gains = model.altimeter[0]
        heights = in_lanes(_heights(spec, folder, base)[np.newaxis, :, np.newaxis])
    increments = in_lanes(deltas[np.newaxis])
    recording = Recording(initial[np.newaxis], increments, heights, gains)
    start = float(initial[1])
    return Inertial(columns.path, base, increments, start, recording=recording)


def _start(start: StartSpec) -> np.ndarray:
    """Return the initial state (15,) of the mechanization: position, velocity, C_nb."""
    if start.c_nb is not None:
        attitude = np.array(start.c_nb)
    else:
        angles = (start.heading_deg or 0.0, start.pitch_deg or 0.0, start.roll_deg or 0.0)
        attitude = attitudes_of(np.radians([angles])).ravel()
    return np.concatenate(
        [
            start.position,
            [start.velocity_east_mps, start.velocity_north_mps, start.velocity_up_mps],
            attitude,
        ]
    )


def _heights(spec: FlightSpec, folder: Path, base: TimeBase) -> np.ndarray:
    """Return altimeter heights (N,) at the middles of the INS intervals [m]."""
    altimeter = spec.altimeter
    assert altimeter is not None and altimeter.file is not None  # the specification checks it
    columns = files.read(folder / altimeter.file, ("height_m",), names=called(altimeter.columns))
    since = clocked(columns, altimeter.clock_offset_s) - base.start
    at = 0.5 * (base.times[1:] + base.times[:-1])
    first, last = since[0] - at[0], at[-1] - since[-1]
    if max(first, last) > base.tolerance:
        raise columns.error(
            f"its heights, from {since[0] + base.start:.16g} s to {since[-1] + base.start:.16g} "
            "s, do not cover the record of the INS"
        )
    return np.interp(at, since, columns["height_m"])


def _interpolated(at: np.ndarray, times: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return values at times ``at`` (K, m), interpolated linearly between the rows (N, m)."""
    return np.stack([np.interp(at, times, column) for column in values.T], axis=-1)


def _require_few(base: TimeBase, columns: Columns) -> None:
    if base.count > MOST_SAMPLES:
        raise columns.error(
            f"has {base.count} samples of imu.period_s; at most {MOST_SAMPLES} are allowed"
        )
    if base.count < 2:
        raise columns.error("is shorter than two samples of imu.period_s")


def force_hint(force: float, period: float, increments: bool) -> str:
    """Return possible units of a specific force that does not agree with gravity in m/s².

    Several other units are tested. The text is empty if the force agrees with gravity in none of
    them.

    Parameters
    ----------
    force : typical specific force in the file [m/s²].
    period : interval of the samples [s].
    increments : whether the columns are named as increments.
    """
    causes = [(1.0, "the unit may be g"), (1e3, "the unit may be thousandths of g")]
    causes += [(1e2 * _GRAVITY, "the unit may be cm/s²"), (1e6, "the unit may be µg")]
    other = RATES[3] if increments else DELTAS[3]
    scale, kind = (1.0 / period, "rates") if increments else (period, "increments")
    causes.append(
        (
            scale * _GRAVITY,
            f"the columns may be {kind} ({force:.3g} = {force / scale:.3g} "
            f"{('/' if increments else '×')} {period:.3g} s): rename them {other} and so on",
        )
    )
    hints = [hint for scale, hint in causes if 0.8 < force / scale < 1.25]
    return f"; {', or '.join(hints)}" if hints else ""


def _require_felt(
    columns: Columns, rates: np.ndarray, c_nb: np.ndarray, axes: str, period: float
) -> None:
    """Raise FlightError if angular rates or specific forces (N, 6), SI units, are implausible."""
    force = float(np.median(np.linalg.norm(rates[:, 3:], axis=1)))
    if not 0.4 * _GRAVITY < force < 2.5 * _GRAVITY:
        raise columns.error(
            f"the specific force is {force:.3g} m/s² (median), but gravity alone is "
            f"{_GRAVITY:.3g}{force_hint(force, period, DELTAS[0] in columns)}"
        )
    spin = float(np.median(np.linalg.norm(rates[:, :3], axis=1)))
    if spin > _SPINS:
        raise columns.error(
            f"the angular rate is {spin:.3g} rad/s (median), more than one turn per second: are "
            "the values in degrees?"
        )
    felt = c_nb @ rates[: max(len(rates) // 20, 2), 3:].mean(axis=0)
    if felt[2] < 0.5 * np.linalg.norm(felt):
        raise columns.error(
            f"the specific force at the start is ({felt[0]:.3g}, {felt[1]:.3g}, {felt[2]:.3g}) "
            f'm/s² east, north and up, but must point upwards: check axes = "{axes}", the signs, '
            "and the attitude of [imu_record.start]"
        )
