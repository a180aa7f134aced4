"""What the file of a recorded flight may say: the estimators' side, and where the records are.

The tables are those of a scenario, with the files of what was recorded. There is no truth in them:
a reference, if there is one, is a file that estimators are not given.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from ..errors import GGBenchError
from .aiding import AIDING, BarometerSpec, GnssSpec, GravimeterSpec, LogSpec
from .case import WindowsSpec, require_no_gravimeter
from .further import Named, sensors_of
from .gradiometer import GradiometerSpec
from .quantities import (
    Angle,
    Cosine,
    Height,
    Latitude,
    Longitude,
    Pitch,
    Radians,
    RecordGap,
    RecordTolerance,
    Roll,
    TimeShift,
    VelocityComponent,
)
from .scenario import ScenarioError, read_toml, strip_provenance, validate
from .sensors import (
    AltimeterSpec,
    DisturbanceSpec,
    FieldSpec,
    ImuSpec,
    InitialErrorSpec,
    Side,
)
from .tables import Listed, Section

FileName = Annotated[str, Field(min_length=1)]
Frame = Literal["ENU", "NED"]
BodyAxes = Literal["right-forward-up", "forward-right-down", "forward-left-up"]


class FlightError(GGBenchError):
    """The file of a recorded flight, or one of its records, cannot be used."""


class Recording(Section):
    """What every table with a recorded file has."""

    file: FileName
    clock_offset_s: TimeShift = 0.0
    """Added to the file's times: it brings them to the clock of the INS."""


class ReadingsRecording(Recording):
    """A recorded file of readings."""

    outside: Literal["refuse", "drop"] = "refuse"
    """What becomes of readings from before the first sample of the INS or behind the last."""


class InsRecord(Recording):
    """``[ins]``: the solution of an INS, as it ran on its own."""

    frame: Frame
    max_gap_s: RecordGap | None = None
    time_tolerance_s: RecordTolerance | None = None


class StartSpec(Section):
    """``[imu_record.start]``: where the mechanization of recorded increments starts.

    Radians, and C_nb row by row in place of the angles, are for those who keep a state to its last
    bit, which degrees do not.
    """

    latitude_deg: Latitude | None = None
    longitude_deg: Longitude | None = None
    latitude_rad: Radians | None = None
    longitude_rad: Radians | None = None
    height_m: Height
    velocity_east_mps: VelocityComponent
    velocity_north_mps: VelocityComponent
    velocity_up_mps: VelocityComponent
    roll_deg: Roll | None = None
    pitch_deg: Pitch | None = None
    heading_deg: Angle | None = None
    c_nb: Annotated[Listed[Cosine], Field(min_length=9, max_length=9)] | None = None

    @model_validator(mode="after")
    def _check(self) -> StartSpec:
        for name in ("latitude", "longitude"):
            given = [getattr(self, f"{name}_{unit}") for unit in ("deg", "rad")]
            if (given[0] is None) == (given[1] is None):
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
    """Return whether nine numbers are those of a rotation, row by row."""
    matrix = np.reshape(numbers, (3, 3))
    return bool(np.abs(matrix @ matrix.T - np.eye(3)).max() < 1e-9 and np.linalg.det(matrix) > 0.0)


class ImuRecord(Recording):
    """``[imu_record]``: increments, or rates, of the inertial sensors, to be mechanised here."""

    axes: BodyAxes
    start: StartSpec
    max_gap_s: RecordGap | None = None
    time_tolerance_s: RecordTolerance | None = None


class RecordedGradiometer(GradiometerSpec, ReadingsRecording):
    """``[gradiometer]`` with its readings."""


class RecordedGnss(GnssSpec, ReadingsRecording):
    """``[gnss]`` with its readings."""

    frame: Frame | None = None

    @model_validator(mode="after")
    def _check_frame(self) -> RecordedGnss:
        if self.velocity_noise_mps is not None and self.frame is None:
            raise ValueError('frame is missing: say "ENU" or "NED", of the recorded velocities')
        return self


class RecordedLog(LogSpec, ReadingsRecording):
    """``[velocity_log]`` with its readings."""


class RecordedBarometer(BarometerSpec, ReadingsRecording):
    """``[barometer]`` with its readings."""


class RecordedGravimeter(GravimeterSpec, ReadingsRecording):
    """``[gravimeter]`` with its readings."""


class RecordedAltimeter(AltimeterSpec):
    """``[altimeter]``: with its heights if the mechanization runs here; a solution has had them."""

    file: FileName | None = None
    clock_offset_s: TimeShift = 0.0


class RecordedField(FieldSpec):
    """``[field]``: the map that the estimators are told."""

    compensate: bool = False
    """Whether the mechanization adds the map's disturbance to normal gravity."""


class ReferenceTrack(Recording):
    """``[reference]``: positions, and what else is known, that no estimator is given."""

    frame: Frame | None = None


class FlightSpec(Section):
    """The file of a recorded flight."""

    title: str = ""
    description: str = ""
    ins: InsRecord | None = None
    imu_record: ImuRecord | None = None
    imu: ImuSpec
    initial_error: InitialErrorSpec
    field: RecordedField
    altimeter: RecordedAltimeter | None = None
    disturbance: DisturbanceSpec | None = None
    """The gravity that the INS does not know, as states: ``[model.disturbance]`` of a scenario."""
    gradiometer: RecordedGradiometer | None = None
    gnss: RecordedGnss | None = None
    velocity_log: RecordedLog | None = None
    barometer: RecordedBarometer | None = None
    gravimeter: RecordedGravimeter | None = None
    further: Named[RecordedGnss | RecordedLog | RecordedBarometer | RecordedGravimeter] = Named()
    reference: ReferenceTrack | None = None
    windows: WindowsSpec | None = None

    @model_validator(mode="after")
    def _check(self) -> FlightSpec:
        if (self.ins is None) == (self.imu_record is None):
            raise ValueError(
                "give exactly one of [ins], the solution of an INS, and [imu_record], increments "
                "or rates to be mechanised here"
            )
        if not sensors_of(self):
            raise ValueError(
                "no sensor is on board: give at least one of gradiometer, "
                f"{', '.join(AIDING)}, further"
            )
        if self.field.gravity_disturbance:
            raise ValueError(
                "field.gravity_disturbance is of a simulated truth: recorded accelerometers felt "
                "what there was; field.compensate says whether the mechanization knows the map"
            )
        if self.gradiometer is not None:
            self.gradiometer.require_tractable()
        if self.disturbance is not None:
            self.disturbance.require_integrable(self.gradiometer, self.field.compensate)
            if self.disturbance.integrate_gradients and self.ins is not None:
                raise ValueError(
                    "disturbance.integrate_gradients needs [imu_record]: the solution of [ins] was "
                    "made without the gradients"
                )
        mapless = self.field.source == "normal"
        if self.field.compensate and mapless:
            raise ValueError(
                'field.compensate needs a map: source = "normal" has no disturbance to add'
            )
        if mapless:
            require_no_gravimeter(self)
        if self.altimeter is not None:
            if self.imu_record is not None and self.altimeter.file is None:
                raise ValueError("altimeter.file is missing: the mechanization runs here")
            if self.ins is not None and self.altimeter.file is not None:
                raise ValueError(
                    "altimeter.file is not read: the solution of [ins] has had its heights already"
                )
            self.altimeter.require_slower_than(self.imu.period_s)
        return self

    @property
    def side(self) -> Side:
        """Sensors, field and prior, as the estimators are told."""
        return Side(**{name: getattr(self, name) for name in Side._fields})

    @property
    def inertial(self) -> InsRecord | ImuRecord:
        """Where the INS's record is."""
        found = self.ins or self.imu_record
        assert found is not None  # checked above
        return found

    @property
    def damping_s(self) -> float:
        """Time constant of the altimeter [s]; ∞ without one."""
        return math.inf if self.altimeter is None else self.altimeter.time_constant_s


def load(path: Path | str) -> FlightSpec:
    """Read the file of a recorded flight.

    Raises
    ------
    FlightError
        With a sentence that names the file, the key, what was found and what is allowed.
    """
    path = Path(path)
    try:
        text = path.read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError:
        raise FlightError(f"{path}: is not UTF-8 text") from None
    except OSError as error:
        raise FlightError(f"{path}: cannot be read: {error.strerror}") from None
    try:
        content = strip_provenance(read_toml(text, str(path)), "", {}, str(path))
        return validate(FlightSpec, content, str(path))
    except ScenarioError as error:
        raise FlightError(str(error)) from None
