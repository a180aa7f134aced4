"""Flight file of a recorded flight: assumed model, and paths of the records.

The tables have the same keys as scenario tables. In addition they state the paths of the records.
The file contains no truth. Estimators never receive the reference track, which the table
``[reference]`` describes.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from ..errors import GGBenchError
from . import quantities as q
from .aiding import RecordedAiding
from .case import WindowsSpec, require_sensors
from .columns import ColumnNames
from .gradiometer import GradiometerSpec
from .named_sensors import NO_SENSORS, NamedSensors, WithSensors
from .recordings import FileName, Frame, ReadingsRecording, Recording
from .sensors import (
    AltimeterSpec,
    DisturbanceSpec,
    FieldSpec,
    ImuSpec,
    InitialErrorSpec,
    Side,
)
from .tables import Listed, Section
from .toml_files import read_text, read_toml, strip_provenance
from .validation_messages import ScenarioError, validate

BodyAxes = Literal["right-forward-up", "forward-right-down", "forward-left-up"]


class FlightError(GGBenchError):
    """A flight file or one of the records is invalid."""


class InertialRecording(Recording):
    """Base class of records with one row per INS sample."""

    max_gap_s: q.RecordGap | None = None
    """Longest time between two rows. Without it: 1.5 periods."""
    time_tolerance_s: q.RecordTolerance | None = None
    """Largest time between a measurement and its sample. Without it: 0.1 periods; at most half."""


class InsRecord(InertialRecording):
    """``[ins]``: recorded solution of an INS without corrections."""

    frame: Frame
    """Frame of the recorded velocities."""


class StartSpec(Section):
    """``[imu_record.start]``: initial state for the mechanization of recorded IMU data.

    The keys in radians and the key ``c_nb`` reproduce a stored state exactly. The keys in degrees
    cause rounding errors.
    """

    latitude_deg: q.Latitude | None = None
    """Latitude at the start; or give `latitude_rad`."""
    longitude_deg: q.Longitude | None = None
    """Longitude at the start; or give `longitude_rad`."""
    latitude_rad: q.Radians | None = None
    """Latitude in radians, which repeats a stored flight exactly; in place of `latitude_deg`."""
    longitude_rad: q.Radians | None = None
    """Longitude in radians, in place of `longitude_deg`."""
    height_m: q.Height
    """Height above the ellipsoid."""
    velocity_east_mps: q.VelocityComponent
    """Velocity at the start."""
    velocity_north_mps: q.VelocityComponent
    """Velocity at the start."""
    velocity_up_mps: q.VelocityComponent
    """Velocity at the start."""
    roll_deg: q.Roll | None = None
    """Roll, positive right side down; needs `heading_deg` and `pitch_deg`. Or give `c_nb`."""
    pitch_deg: q.Pitch | None = None
    """Pitch, nose up."""
    heading_deg: q.Angle | None = None
    """Heading, clockwise from north."""
    c_nb: Annotated[Listed[q.Cosine], Field(min_length=9, max_length=9)] | None = None
    """Rotation matrix from right-forward-up to ENU, row by row, in place of the angles."""

    @model_validator(mode="after")
    def _check(self) -> StartSpec:
        for name in ("latitude", "longitude"):
            values = [getattr(self, f"{name}_{unit}") for unit in ("deg", "rad")]
            if (values[0] is None) == (values[1] is None):
                raise ValueError(f"give exactly one of {name}_deg and {name}_rad")
        angles = (self.heading_deg, self.pitch_deg, self.roll_deg)
        if (self.c_nb is None) == (None in angles) or (self.c_nb and any(angles)):
            raise ValueError("give heading_deg, pitch_deg and roll_deg, or c_nb in place of them")
        if self.c_nb is not None and not _is_rotation(self.c_nb):
            raise ValueError("c_nb is no rotation: its rows must be orthonormal, right-handed")
        return self

    @property
    def position(self) -> tuple[float, float, float]:
        """Latitude, longitude [rad] and height [m]."""
        latitude, longitude = (
            math.radians(degrees) if radians is None else radians
            for degrees, radians in (
                (self.latitude_deg or 0.0, self.latitude_rad),
                (self.longitude_deg or 0.0, self.longitude_rad),
            )
        )
        return latitude, longitude, self.height_m


def _is_rotation(numbers: tuple[float, ...]) -> bool:
    """Return whether nine numbers, row by row, are a rotation matrix."""
    matrix = np.reshape(numbers, (3, 3))
    return bool(np.abs(matrix @ matrix.T - np.eye(3)).max() < 1e-9 and np.linalg.det(matrix) > 0.0)


class ImuRecord(InertialRecording):
    """``[imu_record]``: recorded increments or rates of the inertial sensors.

    ggbench computes the INS solution from them.
    """

    axes: BodyAxes
    """Body axes of the record."""
    start: StartSpec


class RecordedGradiometer(GradiometerSpec, ReadingsRecording):
    """``[gradiometer]`` with a file of measurements."""

    readings: Literal["total", "disturbing"] = "total"  # type: ignore[assignment]
    """Whether the gradients are total, or disturbing (without the normal field), as in surveys.

    The normal field is added at the INS position. This causes an error of 0.0015 E per metre of the
    height error.
    """

    @model_validator(mode="after")
    def _check_readings(self) -> RecordedGradiometer:
        if self.readings == "disturbing":
            self._require_plain('readings = "disturbing"')
        return self


class RecordedAltimeter(AltimeterSpec):
    """``[altimeter]``: heights that damp the vertical channel of the INS.

    With ``[imu_record]`` this table requires a file of heights. With ``[ins]`` such a file is not
    allowed.
    """

    file: FileName | None = None
    """Path of the record of heights, relative to the flight file; needs `[imu_record]`."""
    clock_offset_s: q.TimeShift = 0.0
    """Offset added to the times of the file to convert them to the INS clock."""
    columns: ColumnNames | None = None
    """Column names of the file, `{ height_m = "alt [ft]" }`; or the name of a preset."""


class RecordedField(FieldSpec):
    """``[field]``: the map that the estimators assume."""

    compensate: bool = False
    """Whether the mechanization adds the disturbance of this map at the indicated position."""


class ReferenceTrack(Recording):
    """``[reference]``: reference positions, velocities and attitudes, hidden from estimators."""

    frame: Frame | None = None
    """Frame of the recorded velocities."""


class FlightSpec(WithSensors):
    """Content of the flight file of a recorded flight."""

    title: str = ""
    """Title in one line."""
    description: str = ""
    """Purpose of the file; it opens the report."""
    ins: InsRecord | None = None
    imu_record: ImuRecord | None = None
    imu: ImuSpec
    initial_error: InitialErrorSpec
    field: RecordedField
    altimeter: RecordedAltimeter | None = None
    disturbance: DisturbanceSpec | None = None
    gradiometer: RecordedGradiometer | None = None
    sensor: NamedSensors[RecordedAiding] = NO_SENSORS
    reference: ReferenceTrack | None = None
    windows: WindowsSpec | None = None

    @model_validator(mode="after")
    def _check(self) -> FlightSpec:
        if (self.ins is None) == (self.imu_record is None):
            raise ValueError(
                "give either [ins], the solution of an INS, or [imu_record], increments or rates "
                "for the mechanization of ggbench"
            )
        mapless = self.field.source == "normal"
        require_sensors(self, mapless)
        if self.field.gravity_disturbance:
            raise ValueError(
                "field.gravity_disturbance is for simulated truth only: remove it; "
                "field.compensate makes the mechanization add the disturbance of the map"
            )
        if self.gradiometer is not None:
            self.gradiometer.require_tractable()
        if self.disturbance is not None:
            self.disturbance.require_integrable(self.gradiometer, self.field.compensate)
            disturbing = self.gradiometer is not None and self.gradiometer.readings == "disturbing"
            if self.disturbance.integrate_gradients and disturbing:
                raise ValueError(
                    "disturbance.integrate_gradients needs whole gradients: "
                    'gradiometer.readings = "disturbing" lacks the normal field'
                )
            if self.disturbance.integrate_gradients and self.ins is not None:
                raise ValueError(
                    "disturbance.integrate_gradients needs [imu_record]: the solution of [ins] "
                    "does not use the gradients"
                )
        if self.field.compensate and mapless:
            raise ValueError(
                'field.compensate needs a map: source = "normal" has no gravity disturbance'
            )
        if self.altimeter is not None:
            if self.imu_record is not None and self.altimeter.file is None:
                raise ValueError(
                    "altimeter.file is missing: the mechanization of [imu_record] needs heights"
                )
            if self.ins is not None and self.altimeter.file is not None:
                raise ValueError(
                    "altimeter.file must not be given with [ins], whose solution already uses "
                    "heights"
                )
            self.altimeter.require_slower_than(self.imu.period_s)
        return self

    @property
    def side(self) -> Side:
        """Sensors, field and prior of the assumed model."""
        return Side(**{name: getattr(self, name) for name in Side._fields})

    @property
    def inertial(self) -> InsRecord | ImuRecord:
        """Table of the INS record, ``[ins]`` or ``[imu_record]``."""
        record = self.ins or self.imu_record
        assert record is not None  # checked above
        return record

    @property
    def damping_s(self) -> float:
        """Time constant of the altimeter damping [s]; ∞ without an altimeter."""
        return math.inf if self.altimeter is None else self.altimeter.time_constant_s


def load(path: Path | str) -> FlightSpec:
    """Read a flight file.

    Raises
    ------
    FlightError
        If the file is invalid; the message states the file, the key, the value and the allowed
        values.
    """
    path = Path(path)
    try:
        content = read_toml(read_text(path, str(path)), str(path))
        content = strip_provenance(content, "", {}, str(path))
        return validate(FlightSpec, content, str(path))
    except ScenarioError as error:
        raise FlightError(str(error)) from None
