"""Reader of recorded flights: estimation problem and reference from files."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import GGBenchError
from ..files.writing import sha256_of
from ..gravity.field import Field, OutsideMapError
from ..gravity.meridians import turns
from ..ins.error_model import navigation_errors
from ..problem import Problem
from ..sensors.aiding import Motion, corrected_positions, position_error
from ..sensors.gnss import Gnss
from ..simulation.field_source import beside, is_file, make_field, map_files
from ..simulation.formulation import (
    MeasurementTimes,
    MechanizedRuns,
    SensorReadings,
    added_gravity,
    build_problems,
    propagate_errors,
    require_short_delays,
)
from ..simulation.replay import Replays
from ..simulation.runs import Truth
from ..simulation.sensor_suite import SensorSuite
from ..simulation.suites import suite_of
from ..spec.aiding import RecordedGnss
from ..spec.columns import called
from ..spec.flight import (
    FlightError,
    FlightSpec,
    RecordedField,
    ReferenceTrack,
    load,
)
from ..spec.named_sensors import sensors_of
from . import columns as files
from .inertial import Inertial, inertial
from .motion import (
    ATTITUDE,
    POSITION,
    attitudes_in,
    positions_of,
    require_consistent,
    velocities_of,
    velocity_columns,
)
from .normal_field import normal_readings
from .readings import Series, gradients, others, read_series, require_near
from .time_base import TimeBase, clocked

_SIGMAS = 5.0
"""Largest distance of the first INS position outside the map, in prior standard deviations."""
_LONGEST_GAP = 3.0
"""Longest interval across which a reference is interpolated, in median intervals."""


@dataclass(frozen=True)
class RecordedFlight:
    """Problem and reference of a recorded flight.

    Attributes
    ----------
    path : path of the flight file.
    spec : content of the flight file.
    problem : input of estimators; times [s] count from the first INS sample.
    reference : INS errors against the reference track; None if there is no reference track. States
        that the reference does not contain, such as biases, are NaN. Estimators never receive the
        reference.
    start : time of the first INS sample on the INS clock [s].
    sample_times : (N + 1,) times of all INS samples since the first [s].
    indicated : INS solution at the samples.
    remarks : texts on interpolated samples of the INS and on measurements read as missing.
    """

    path: Path
    spec: FlightSpec
    problem: Problem
    reference: Truth | None
    start: float
    sample_times: np.ndarray
    indicated: Motion
    remarks: tuple[str, ...] = ()

    @property
    def reference_is_of(self) -> str:
        """Sensor whose record also serves as reference; "" if there is none."""
        return _sensor_of_reference(self.spec, self.path.parent)

    def inputs(self) -> list[dict[str, str]]:
        """Return role, name and SHA-256 of each input file.

        Raises FlightError or MapError if a file can no longer be read.
        """
        spec, folder = self.spec, self.path.parent
        tables: dict[str, Any] = {}
        for name in type(spec).model_fields:
            tables |= spec.sensor if name == "sensor" else {name: getattr(spec, name)}
        named = [("flight", self.path)] + [
            (role.replace("_", " "), folder / table.file)
            for role, table in tables.items()
            if getattr(table, "file", None)
        ]
        files = [(role, path.name, sha256_of(path, FlightError)) for role, path in named]
        files += map_files(_told(spec, folder))
        return [{"role": role, "name": name, "sha256": key} for role, name, key in files]


def read_flight(path: Path | str) -> RecordedFlight:
    """Read a recorded flight: the flight file and the records that it names.

    Parameters
    ----------
    path : path of the flight file. Paths in this file are relative to its folder.

    Raises
    ------
    FlightError
        If the file or a record is invalid; the message states the file, the place, the value and
        the allowed values.
    GGBenchError
        If the map cannot be built or read, or the low-pass filter cannot be computed.
    """
    path = Path(path)
    spec, folder = load(path), path.parent
    field = make_field(_told(spec, folder))
    model = _suite(spec, path)
    ins = inertial(spec, folder, model, field)
    field = beside(field, ins.longitude)
    series = read_series(spec, folder, model, ins.base)
    try:
        problem, indicated = _problem(spec, model, field, ins, series, path)
    except OutsideMapError as error:
        raise FlightError(f"{path}: field: the flight begins outside the map: {error}") from None
    if spec.windows is not None and spec.windows.settled_from_s > problem.times[-1]:
        raise FlightError(
            f"{path}: windows.settled_from_s is {spec.windows.settled_from_s:g} s and must not lie "
            f"beyond the last reading, {problem.times[-1]:g} s after the start"
        )
    reference = None
    if spec.reference is not None:
        same = sensors_of(spec).get(_sensor_of_reference(spec, folder))
        noise = max(same.position_noise_m or 0.0, same.height_noise_m or 0.0) if same else 0.0
        reference = _reference(spec.reference, folder, problem, ins.base, noise)
    return RecordedFlight(
        path=path,
        spec=spec,
        problem=problem,
        reference=reference,
        start=ins.base.start,
        sample_times=ins.base.times,
        indicated=indicated,
        remarks=tuple(_remarks(ins, series)),
    )


def _remarks(ins: Inertial, series: dict[str, Series]) -> Iterator[str]:
    """Yield a text on the interpolated samples of the INS, and on rows of zeros."""
    if lost := ins.base.lost:
        yield (
            f"{ins.path.name}: {lost} missing sample{'s' if lost > 1 else ''} interpolated, "
            f"longest gap {ins.base.longest_gap:.6g} s"
        )
    for of_sensor in series.values():
        if count := int(of_sensor.zeros.sum()):
            yield (
                f"{of_sensor.columns.path.name}: {count} row{'s' if count > 1 else ''} of zeros "
                "read as missing measurements"
            )


def _sensor_of_reference(spec: FlightSpec, folder: Path) -> str:
    """Return the GNSS sensor whose file has the same content as the reference; "" if none."""
    if spec.reference is None:
        return ""
    key = sha256_of(folder / spec.reference.file, FlightError)
    for sensor, table in spec.sensor.items():
        record = folder / table.file
        if isinstance(table, RecordedGnss) and sha256_of(record, FlightError) == key:
            return sensor
    return ""


def _suite(spec: FlightSpec, path: Path) -> SensorSuite:
    """Return the sensors and the prior, as the estimators assume them."""
    try:
        return suite_of(
            spec.side,
            spec.altimeter,
            disturbance=spec.disturbance,
            compensates=spec.field.compensate,
        )
    except GGBenchError as error:
        raise FlightError(f"{path}: {error}") from None


def _told(spec: FlightSpec, folder: Path) -> RecordedField:
    """Return the table of the assumed map, with the path of a map file resolved.

    The path in the table is relative to the folder of the flight file.
    """
    field = spec.field
    if is_file(field.source):
        field = field.model_copy(update={"source": str(folder / field.source)})
    return field


def _problem(
    spec: FlightSpec,
    model: SensorSuite,
    field: Field,
    ins: Inertial,
    series: dict[str, Series],
    path: Path,
) -> tuple[Problem, Motion]:
    """Return the estimation problem, and the INS solution at all INS samples."""
    epochs = functools.reduce(np.union1d, [of_sensor.samples for of_sensor in series.values()])
    at = {name: np.searchsorted(epochs, of_sensor.samples) for name, of_sensor in series.items()}
    read_at = [at[sensor.name] for sensor in model.aiding]
    gradient_at = at.get("gradiometer", np.zeros(0, dtype=np.int64))
    times = ins.base.times[epochs]
    when = MeasurementTimes(times, epochs, ins.base.dt, gradient_at, read_at)
    try:
        require_short_delays(model, spec.damping_s, len(gradient_at))
    except GGBenchError as error:
        raise FlightError(f"{path}: {error}") from None
    indicated = MechanizedRuns.empty(1, len(epochs), model.dimension)
    output, missing = np.zeros((1, 0, model.gradients)), np.zeros((1, 0), dtype=bool)
    if "gradiometer" in series:
        output, missing = gradients(spec, ins.base, series["gradiometer"])
    gravity = added_gravity(model, field, epochs[gradient_at], ins.base.count + 1, output, missing)
    navigated = ins.navigated(gravity)
    propagate_errors(model, when, gravity, navigated, ins.increments, indicated)
    motion = indicated.motion
    if spec.gradiometer is not None and spec.gradiometer.readings == "disturbing":
        assert model.gradiometer is not None  # there is a table of it
        at_ins, channels = [part[0, gradient_at] for part in motion], model.gradiometer.channels
        normal = normal_readings(
            spec.gradiometer.instrument, at_ins[0], times[gradient_at], at_ins[2]
        )
        output = np.where(missing[..., np.newaxis], 0.0, output + normal @ channels.T)
    _require_over_map(field, motion.positions[0, 0], np.sqrt(np.diag(model.prior_cov)[:3]))
    read, present = others(model, series, read_at, motion)
    _require_receivers_near(model, series, at, np.where(present, read, np.nan)[0])
    block = build_problems(
        model, field, when, indicated, SensorReadings(output, missing, read, present)
    )
    if ins.recording is not None and not model.has_memory:
        replays = Replays(model, field, when, gravity, [ins.recording], 1)
        block = dataclasses.replace(block, replays=replays)
    return block.problem(0), Motion.of_states(navigated[:, :, 0])


def _require_over_map(field: Field, position: np.ndarray, sigma: np.ndarray) -> None:
    """Raise OutsideMapError if a position (3,) is outside the map by more than five σ ENU [m]."""
    off = corrected_positions(position, -_SIGMAS * sigma) - position
    place = field.coordinates(position)
    inside = (field.lower - off <= place) & (place <= field.upper + off)
    if not inside.all():
        field.tensor(*position)


def _require_receivers_near(
    model: SensorSuite, series: dict[str, Series], at: dict[str, np.ndarray], read: np.ndarray
) -> None:
    """Raise FlightError if a receiver's first position is far from the INS position.

    ``at`` contains the epoch indices of each sensor. ``read`` (K, e) contains the measurements of
    all aiding sensors, NaN where missing.
    """
    prior, first = 10.0 * float(np.sqrt(np.diag(model.prior_cov)[:3].sum())), 0
    for sensor in model.aiding:
        if isinstance(sensor, Gnss) and sensor.position:
            of_sensor, away = series[sensor.name], read[at[sensor.name], first : first + 3]
            require_near(of_sensor.columns, of_sensor.rows, away, prior, "the receiver")
        first += len(sensor.channels)


def _reference(
    table: ReferenceTrack, folder: Path, problem: Problem, base: TimeBase, noise: float
) -> Truth:
    """Return the errors of the INS against a reference track; NaN where it has no values.

    ``noise`` is the RMS position noise of the reference if the reference is a receiver record [m].
    """
    speeds = (*velocity_columns("ENU"), *velocity_columns("NED"))
    optional = tuple(dict.fromkeys((*ATTITUDE, *speeds)))
    columns = files.read(
        folder / table.file, POSITION, optional, speeds, names=called(table.columns)
    )
    times = clocked(columns, table.clock_offset_s)
    velocities = attitudes = None
    if any(name.startswith("velocity_") for name in columns.values):
        if table.frame is None:
            raise FlightError(
                f'{columns.path}: has velocities: give their frame, reference.frame = "ENU" or '
                '"NED"'
            )
        lacking = [name for name in velocity_columns(table.frame) if name not in columns]
        if lacking:
            raise columns.error(
                f'has no column {lacking[0]}, which reference.frame = "{table.frame}" needs'
            )
        velocities = velocities_of(columns, table.frame)
    if all(name in columns for name in ATTITUDE):
        attitudes = attitudes_in(columns)
    assert problem.track is not None
    positions = positions_of(columns)
    there = np.isfinite(positions[:, 1])
    if there.any():
        first = positions[there][0, 1]
        positions[:, 1] += turns(first, problem.track.positions[0, 1], math.tau)
    if velocities is not None and table.frame is not None:
        require_consistent(columns, times, positions, velocities, table.frame, noise)
    at, since = problem.times, times - base.start
    row, share, there = _places(at, since, base.tolerance)
    if not there.any():
        raise columns.error(
            f"lies outside the flight, {base.start:.16g} s to "
            f"{base.start + base.dt * base.count:.16g} s; correct its times with clock_offset_s"
        )
    nothing = np.full((len(at), 3), np.nan)
    positions = _between(positions, row, share, there)
    true = Motion(
        positions,
        nothing if velocities is None else _between(velocities, row, share, there),
        np.full((len(at), 3, 3), np.nan),
    )
    if attitudes is not None:
        # Angles are not interpolated: those of a row that is an epoch's own.
        own = there & (share == 0.0)
        true.attitudes[own] = attitudes[row[own]]
    error_state = np.full((1, len(at), problem.dimension), np.nan)
    states = np.concatenate(
        [problem.track.positions, problem.track.velocities, problem.track.attitudes.reshape(-1, 9)],
        axis=1,
    )
    navigation_errors(states[np.newaxis], *true, error_state)
    prior = 10.0 * float(np.sqrt(np.diag(problem.prior_cov)[:3].sum()))
    away = position_error(problem.track.positions, positions)
    nearest = np.where(there)[0]
    require_near(columns, np.minimum(row, columns.rows - 1)[nearest], away[nearest], prior, "it")
    return Truth(problem.times, error_state[0])


def _places(
    at: np.ndarray, since: np.ndarray, tolerance: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return row before each epoch, fraction of the interval to the next row, and validity mask.

    A row is used alone, with the fraction 0, if its time differs from the epoch by at most 1e-3 of
    the tolerance.
    An epoch is invalid outside the rows or in a long gap between rows.
    """
    nearest = np.clip(np.searchsorted(since, at), 0, len(since) - 1)
    before = np.clip(nearest - 1, 0, len(since) - 1)
    closer = np.abs(since[before] - at) < np.abs(since[nearest] - at)
    nearest = np.where(closer, before, nearest)
    own = np.abs(since[nearest] - at) <= 1e-3 * tolerance
    row = np.where(own, nearest, np.searchsorted(since, at, side="right") - 1)
    row = np.clip(row, 0, len(since) - 1)
    after = np.minimum(row + 1, len(since) - 1)
    step = np.where(after > row, since[after] - since[row], 1.0)
    share = np.where(own, 0.0, (at - since[row]) / step)
    usual = float(np.median(np.diff(since))) if len(since) > 1 else 0.0
    within = (share >= 0.0) & (share <= 1.0) & (after > row) & (step <= _LONGEST_GAP * usual)
    return row, share, own | within


def _between(
    values: np.ndarray, row: np.ndarray, share: np.ndarray, there: np.ndarray
) -> np.ndarray:
    """Return values (K, 3), interpolated linearly between rows; NaN at invalid epochs."""
    after = np.minimum(row + 1, len(values) - 1)
    interpolated = values[row] + share[:, np.newaxis] * (values[after] - values[row])
    return np.where(there[:, np.newaxis], interpolated, np.nan)
