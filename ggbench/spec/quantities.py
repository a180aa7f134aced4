"""Limits of numbers in scenario files, by physical quantity.

A value beyond the limits is refused. An unusual value, often a typing error or a wrong unit, is
accepted with a remark.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

from pydantic import GetCoreSchemaHandler, GetJsonSchemaHandler
from pydantic_core import PydanticCustomError, core_schema

from .limits import FASTEST_MPS, HIGHEST_M, LOWEST_M


@dataclass(frozen=True)
class Within:
    """Inclusive limits of a number; with ``or_zero`` the number may also be 0.

    ``usual`` is the usual range; 0 is never unusual. ``mistaken`` has a unit that users often
    confuse with the correct unit, and the conversion factor from this unit to the correct unit.
    """

    lowest: float
    highest: float
    or_zero: bool = False
    usual: tuple[float, float] | None = None
    mistaken: tuple[str, float] | None = None

    def __str__(self) -> str:
        zero = "be 0 or " if self.or_zero else ""
        return f"{zero}lie between {short(self.lowest)} and {short(self.highest)}"

    def __get_pydantic_core_schema__(
        self, source: Any, handler: GetCoreSchemaHandler
    ) -> core_schema.CoreSchema:
        return core_schema.no_info_after_validator_function(self.held, handler(source))

    def __get_pydantic_json_schema__(
        self, source: core_schema.CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        json = {**handler(source), "minimum": self.lowest, "maximum": self.highest}
        if self.usual is not None:
            json["x-usual"] = list(self.usual)
        if self.or_zero and not self.lowest <= 0.0 <= self.highest:
            return {"anyOf": [{"const": 0}, json]}
        return json

    def held(self, value: float) -> float:
        """Return the value; raise PydanticCustomError (a ValueError) if it is beyond the limits."""
        # NaN fails too.
        if self.lowest <= value <= self.highest or (self.or_zero and value == 0.0):
            return value
        raise PydanticCustomError("limits", "must {limits}", {"limits": str(self)})

    def usual_unless(self, value: float) -> str:
        """Return the usual range in words if a value is unusual, else ""."""
        if self.usual is None or value == 0.0 or self.usual[0] <= value <= self.usual[1]:
            return ""
        usual = f"{short(self.usual[0])} to {short(self.usual[1])} is usual"
        if self.mistaken is not None:
            unit, factor = self.mistaken
            if self.usual[0] <= factor * value <= self.usual[1]:
                usual += f"; is it in {unit}? then give {factor * value:g}"
        return usual


def short(number: float) -> str:
    """Format a limit with as few characters as possible, for example ``1e6``."""
    return f"{number:g}".replace("e+0", "e").replace("e+", "e").replace("e-0", "e-")


# Where and how fast.
Latitude = Annotated[float, Within(-89.0, 89.0)]
Longitude = Annotated[float, Within(-180.0, 360.0)]
Radians = Annotated[float, Within(-7.0, 7.0)]
Cosine = Annotated[float, Within(-1.001, 1.001)]
Height = Annotated[float, Within(LOWEST_M, HIGHEST_M, usual=(-500.0, 30e3))]
HeightDifference = Annotated[float, Within(LOWEST_M - HIGHEST_M, HIGHEST_M - LOWEST_M)]
Clearance = Annotated[float, Within(0.1, HIGHEST_M, or_zero=True)]
Speed = Annotated[float, Within(0.0, FASTEST_MPS, usual=(0.5, 1000.0))]
VerticalSpeed = Annotated[float, Within(1e-3, 1000.0, usual=(0.1, 100.0))]
Acceleration = Annotated[float, Within(-50.0, 50.0)]
LargestAcceleration = Annotated[float, Within(0.01, 50.0)]
TrackAcceleration = Annotated[float, Within(1e-3, 1e4, usual=(0.1, 100.0))]
Angle = Annotated[float, Within(-360.0, 360.0)]
Turns = Annotated[float, Within(-36e3, 36e3)]
Pitch = Annotated[float, Within(-90.0, 90.0, usual=(-30.0, 30.0))]
Roll = Annotated[float, Within(-180.0, 180.0, usual=(-45.0, 45.0))]
Bank = Annotated[float, Within(0.01, 75.0)]
Incline = Annotated[float, Within(0.01, 60.0)]
InclineLimit = Annotated[float, Within(0.01, 45.0)]
NoisyRate = Annotated[float, Within(1e-6, 1e4, usual=(0.01, 100.0))]
NoisyAcceleration = Annotated[float, Within(1e-6, 1e4, usual=(0.01, 100.0))]
AngularRate = Annotated[float, Within(-30.0, 30.0)]
Radius = Annotated[float, Within(1.0, 1e6)]
Kilometres = Annotated[float, Within(1e-3, 40_000.0)]  # once around the Earth

# Times and rates.
Duration = Annotated[float, Within(1e-3, 1e6)]
Duty = Annotated[float, Within(1e-3, 1e6, or_zero=True)]
Moment = Annotated[float, Within(1e-9, 1e6, or_zero=True)]
SamplePeriod = Annotated[float, Within(1e-4, 10.0, usual=(1e-3, 1.0))]
ReadingPeriod = Annotated[float, Within(1e-3, 3600.0, usual=(0.01, 300.0))]
TimeConstant = Annotated[float, Within(1e-3, 1e8, usual=(1.0, 1e6))]
Damping = Annotated[float, Within(1.0, 1000.0)]
Shift = Annotated[float, Within(-20000.0, 20000.0)]
Smoothing = Annotated[float, Within(1e-3, 3600.0, or_zero=True)]
ClockError = Annotated[float, Within(1e-12, 86400.0, or_zero=True)]
Latency = Annotated[float, Within(1e-6, 600.0, or_zero=True)]
Jitter = Annotated[float, Within(1e-12, 60.0, or_zero=True)]
Frequency = Annotated[float, Within(1e-6, 1e4)]
Spin = Annotated[float, Within(1e-4, 1000.0, usual=(0.01, 100.0))]
TimeLimit = Annotated[float, Within(1e-6, 1e9)]
TimeShift = Annotated[float, Within(-1e10, 1e10)]
RecordGap = Annotated[float, Within(1e-4, 3600.0)]
RecordTolerance = Annotated[float, Within(1e-9, 10.0, or_zero=True)]
VelocityComponent = Annotated[float, Within(-FASTEST_MPS, FASTEST_MPS)]

# Standard deviations of the start: at least what rounding leaves of a position on the Earth.
PositionError = Annotated[float, Within(1e-6, 1e6, usual=(1e-3, 1e5))]
HeightError = Annotated[float, Within(1e-6, 1e5, usual=(1e-3, 1e4))]
VelocityError = Annotated[float, Within(1e-9, 1000.0, usual=(1e-6, 50.0))]
AttitudeError = Annotated[float, Within(1e-6, 600.0, usual=(1e-4, 300.0))]

# Inertial sensors.
GyroBias = Annotated[float, Within(1e-9, 36e3, or_zero=True, usual=(1e-6, 1e3))]  # to 10°/s
GyroNoise = Annotated[float, Within(1e-9, 3600.0, or_zero=True, usual=(1e-6, 10.0))]
AccelerometerBias = Annotated[float, Within(1e-9, 1e7, or_zero=True, usual=(1e-4, 1e5))]  # to 10 g
AccelerometerNoise = Annotated[float, Within(1e-9, 1e7, or_zero=True, usual=(1e-4, 1e4))]
AltimeterNoise = Annotated[float, Within(1e-6, 1e4, usual=(1e-3, 100.0))]
Ppm = Annotated[float, Within(1e-6, 1e5, or_zero=True)]
Arcmin = Annotated[float, Within(1e-9, 600.0, or_zero=True)]
MountingError = Annotated[float, Within(-600.0, 600.0)]

# The other sensors.
PositionNoise = Annotated[float, Within(1e-4, 1e6, usual=(1e-3, 1e4))]
PositionBias = Annotated[float, Within(1e-4, 1e6, or_zero=True, usual=(1e-3, 1e4))]
LeverArm = Annotated[float, Within(-1000.0, 1000.0, usual=(-50.0, 50.0))]
LeverArmSigma = Annotated[float, Within(1e-4, 1000.0, or_zero=True, usual=(1e-3, 10.0))]
PositionJump = Annotated[float, Within(-1e6, 1e6)]
VelocityNoise = Annotated[float, Within(1e-6, 1e3, usual=(1e-4, 10.0))]
HeightNoise = Annotated[float, Within(1e-4, 1e5, usual=(1e-3, 1e3))]
HeightBias = Annotated[float, Within(1e-6, 1e5, or_zero=True, usual=(1e-3, 1e3))]
LogBias = Annotated[float, Within(1e-6, 1e3, or_zero=True, usual=(1e-4, 10.0))]
GravimeterNoise = Annotated[float, Within(1e-6, 1e6, usual=(1e-3, 1e3))]
GravimeterBias = Annotated[float, Within(1e-6, 1e6, or_zero=True, usual=(1e-3, 1e3))]
Disturbance = Annotated[float, Within(-1e4, 1e4, usual=(-500.0, 500.0))]
DisturbanceSize = Annotated[float, Within(1e-6, 1e4, usual=(1e-2, 500.0))]
DisturbanceDistance = Annotated[float, Within(0.1, 1e5, usual=(1.0, 1000.0))]

# The gradiometer and the field: the Earth's own gradient is 3086 E, steep ground has hundreds.
Noise = Annotated[float, Within(1e-9, 1e6, usual=(1e-6, 1e4))]
NoiseBehindFilter = Annotated[float, Within(1e-12, 1e6, or_zero=True)]
GradiometerBias = Annotated[float, Within(1e-9, 1e6, or_zero=True, usual=(1e-6, 1e4))]
Freedom = Annotated[float, Within(2.01, 1e6, usual=(2.5, 1e3))]  # of 2 and less: no variance
Burst = Annotated[float, Within(1e-6, 1e5, or_zero=True)]
Outlier = Annotated[float, Within(1e-9, 1e9, or_zero=True)]
MapNoise = Annotated[float, Within(1e-9, 1e4, or_zero=True, usual=(1e-6, 1e3))]
DiskNoise = Annotated[float, Within(1e-9, 1e9, usual=(1e-6, 1e6))]
Baseline = Annotated[float, Within(1e-3, 10.0)]
Vibration = Annotated[float, Within(1e-12, 100.0, or_zero=True)]
Share = Annotated[float, Within(1e-9, 0.999, or_zero=True)]
Regularization = Annotated[float, Within(1e-7, 0.1)]
MapSpacing = Annotated[float, Within(1e-4, 600.0)]
HeightSpacing = Annotated[float, Within(1e-2, 1e5)]
ReliefSmoothing = Annotated[float, Within(1e-6, 1.0, or_zero=True)]
DENSITY = Within(1.0, 1e4, usual=(500.0, 4000.0), mistaken=("g/cm³", 1000.0))  # in kg/m³
Density = Annotated[float, DENSITY]
DensityFactor = Annotated[float, Within(1e-3, 10.0)]
Wavelength = Annotated[float, Within(1e-3, 1000.0)]

# Targets and published numbers.
PositionTarget = Annotated[float, Within(1e-6, 1e7)]
Displacement = Annotated[float, Within(0.0, 1000.0)]
VelocityTarget = Annotated[float, Within(1e-9, 1e5)]
