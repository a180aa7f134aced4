"""Tables of aiding sensors: GNSS, velocity log, barometer, gravimeter.

``[gnss]`` describes both the simulated truth and the assumed model. ``[truth.gnss]`` changes only
the truth, and adds errors that no estimator models. ``[model.gnss]`` changes only the model.
``[sensor.<name>]`` has the keys of the sensor's ``kind`` (:mod:`.named_sensors`).
"""

from __future__ import annotations

from typing import Annotated, Literal, get_args

from pydantic import Field, model_validator

from . import quantities as q
from .recordings import Frame, ReadingsRecording
from .tables import Listed, Section, Several, Three, changes, distinct

Interval = Annotated[Listed[q.Moment], Field(min_length=2, max_length=2)]

_HOW_OUTLIERS_COME = ("outlier_share", "outlier_burst_s", "outlier_channels")
"""Keys of outliers other than their size."""


class Interruptions(Section):
    """Base of ``[truth.<sensor>]`` tables, with keys for missing measurements and outliers."""

    outlier_share: q.Share = 0.0
    """Probability that a measurement of a channel is an outlier; needs the size of outliers."""
    dropout_share: q.Share = 0.0
    """Probability that a measurement (all channels) is missing. Not for a filtered gradiometer."""
    dropouts_s: Listed[Interval] = ()
    """Intervals `[from, to]` without measurements. Not for a filtered gradiometer."""
    duty_on_s: q.Duty = 0.0
    """Duty cycle: duration of measurements; the first starts with the flight. Needs
    `duty_off_s`.
    """
    duty_off_s: q.Duty = 0.0
    """Duty cycle: duration of the gap that follows. Not for a filtered gradiometer."""

    @model_validator(mode="after")
    def _check(self) -> Interruptions:
        keys = [key for key in type(self).model_fields if key.startswith("outlier_")]
        sizes = [key for key in keys if key not in _HOW_OUTLIERS_COME]
        if (self.outlier_share > 0.0) != any(getattr(self, key) > 0.0 for key in sizes):
            raise ValueError(f"outlier_share and {' or '.join(sizes)} must be given together")
        if (self.duty_on_s > 0.0) != (self.duty_off_s > 0.0):
            raise ValueError("duty_on_s and duty_off_s must be given together")
        for start, end in self.dropouts_s:
            if not start < end:
                raise ValueError(
                    f"dropouts_s must be [from, to] with from < to, found [{start:g}, {end:g}]"
                )
        return self


class PeriodicSpec(Section):
    """Base of tables of sensors with periodic measurements."""

    period_s: q.ReadingPeriod
    """Time between measurements; a whole multiple of `imu.period_s`."""

    @property
    def in_words(self) -> str:
        """Kind and noise of the sensor in words, for reports.

        Raise NotImplementedError in the base class.
        """
        raise NotImplementedError


class GnssSpec(PeriodicSpec):
    """``[gnss]``: position, velocity or both, each with white noise per axis."""

    kind: Literal["gnss"] = "gnss"
    position_noise_m: q.PositionNoise | None = None
    """White noise of each horizontal axis. Without it, the receiver measures no positions."""
    height_noise_m: q.PositionNoise | None = None
    """White noise of the height. Without it: `position_noise_m`."""
    velocity_noise_mps: q.VelocityNoise | None = None
    """White noise of each axis. Without it, the receiver measures no velocities."""
    position_bias_m: q.PositionBias = 0.0
    """Standard deviation of a correlated position error per axis, for example from multipath.

    It is a state if estimators assume one.
    """
    position_bias_time_s: q.TimeConstant | None = None
    """Correlation time of this error (first-order Gauss–Markov). Without it: a constant."""
    lever_arm_m: Three[q.LeverArm] = (0.0, 0.0, 0.0)
    """Vector from the INS to the antenna (right, forward, up). Estimators correct for it."""
    lever_arm_sigma_m: q.LeverArmSigma = 0.0
    """Standard deviation of the error of each component of `lever_arm_m`, drawn once per run.

    The three errors are states if estimators assume them.
    """

    @model_validator(mode="after")
    def _check(self) -> GnssSpec:
        if self.position_noise_m is None and self.position_bias_m > 0.0:
            raise ValueError("position_bias_m needs position_noise_m")
        if self.position_bias_m == 0.0 and self.position_bias_time_s is not None:
            raise ValueError("position_bias_time_s needs position_bias_m")
        if self.position_noise_m is None and self.velocity_noise_mps is None:
            raise ValueError("give position_noise_m, velocity_noise_mps, or both")
        if self.position_noise_m is None and self.height_noise_m is not None:
            raise ValueError("height_noise_m needs position_noise_m")
        return self

    @property
    def in_words(self) -> str:
        """Receiver and noise in words."""
        if self.position_noise_m is not None:
            return f"GNSS {self.position_noise_m:g} m"
        return f"GNSS {self.velocity_noise_mps:g} m/s"


@changes(GnssSpec, but=("period_s",))
class GnssChange(Section):
    """``[model.gnss]``: the GNSS receiver that the estimators assume."""


class TrueGnss(GnssChange, Interruptions):
    """``[truth.gnss]``: the true receiver; the key ``dropouts_s`` lists its outages."""

    outlier_m: q.Outlier = 0.0
    """Standard deviation of position outliers, per axis."""
    outlier_mps: q.Outlier = 0.0
    """Standard deviation of velocity outliers, per axis."""
    ramp_mps: Three[q.VelocityComponent] = (0.0, 0.0, 0.0)
    """Growth rate of a position error (east, north, up) from `ramp_from_s` on."""
    ramp_from_s: q.Moment = 0.0
    """Start of the ramp."""
    jump_m: Three[q.PositionJump] = (0.0, 0.0, 0.0)
    """Constant position error (east, north, up) from `jump_from_s` on."""
    jump_from_s: q.Moment = 0.0
    """Start of the constant position error."""
    jump_until_s: q.Moment | None = None
    """End of the constant position error. Without it: end of the flight."""

    @model_validator(mode="after")
    def _check_false_positions(self) -> TrueGnss:
        for key, is_present in (
            ("ramp", self.ramp_from_s > 0.0),
            ("jump", self.jump_from_s > 0.0 or self.jump_until_s is not None),
        ):
            unit = "mps" if key == "ramp" else "m"
            if is_present and not any(getattr(self, f"{key}_{unit}")):
                raise ValueError(f"{key}_from_s requires {key}_{unit}")
        if self.jump_until_s is not None and not self.jump_from_s < self.jump_until_s:
            raise ValueError("jump_until_s must be later than jump_from_s")
        return self


class RecordedGnss(GnssSpec, ReadingsRecording):
    """``[gnss]`` with a file of measurements."""

    frame: Frame | None = None
    """Frame of the recorded velocities."""

    @model_validator(mode="after")
    def _check_frame(self) -> RecordedGnss:
        if self.velocity_noise_mps is not None and self.frame is None:
            raise ValueError(
                'frame is missing: give "ENU" or "NED", the frame of the recorded velocities'
            )
        return self


class LogSpec(PeriodicSpec):
    """``[velocity_log]``: a Doppler or electromagnetic log; velocities in body or ENU axes."""

    kind: Literal["velocity_log"] = "velocity_log"
    noise_mps: q.VelocityNoise
    """White noise of each channel."""
    bias_mps: q.LogBias = 0.0
    """Standard deviation of a bias of each channel; it is a state if estimators assume one."""
    bias_time_s: q.TimeConstant | None = None
    """Correlation time of the bias (first-order Gauss–Markov). Without it: a constant."""
    frame: Literal["body", "local-level"] = "body"
    """`"body"`: right, forward, up; `"local-level"`: east, north, up."""
    components: Annotated[Several[Literal["x", "y", "z"]], distinct("an axis")] = ("x", "y")
    """Axes that are measured."""

    @property
    def in_words(self) -> str:
        """Log and noise in words."""
        return f"velocity log {self.noise_mps:g} m/s"


@changes(LogSpec, but=("period_s", "frame", "components"))
class LogChange(Section):
    """``[model.velocity_log]``: the log that the estimators assume."""


class TrueLog(LogChange, Interruptions):
    """``[truth.velocity_log]``: parameters of the velocity log in the simulated truth."""

    outlier_mps: q.Outlier = 0.0
    """Standard deviation of outliers, drawn for each measurement."""


class RecordedLog(LogSpec, ReadingsRecording):
    """``[velocity_log]`` with a file of measurements."""


class BarometerSpec(PeriodicSpec):
    """``[barometer]``: heights from air pressure or from a known sea level."""

    kind: Literal["barometer"] = "barometer"
    noise_m: q.HeightNoise
    """White noise of the height."""
    bias_m: q.HeightBias = 0.0
    """Standard deviation of a bias; it is a state if estimators assume one."""
    bias_time_s: q.TimeConstant | None = None
    """Correlation time of the bias (first-order Gauss–Markov). Without it: a constant."""

    @property
    def in_words(self) -> str:
        """Barometer and noise in words."""
        return f"barometer {self.noise_m:g} m"


@changes(BarometerSpec, but=("period_s",))
class BarometerChange(Section):
    """``[model.barometer]``: the barometer that the estimators assume."""


class TrueBarometer(BarometerChange, Interruptions):
    """``[truth.barometer]``: the true barometer."""

    outlier_m: q.Outlier = 0.0
    """Standard deviation of outliers, drawn for each measurement."""


class RecordedBarometer(BarometerSpec, ReadingsRecording):
    """``[barometer]`` with a file of measurements."""


class GravimeterSpec(PeriodicSpec):
    """``[gravimeter]``: downward (``scalar``) or horizontal components of the gravity disturbance.

    The measurements are reduced with the INS position and velocity, so they contain INS errors.
    """

    kind: Literal["gravimeter"] = "gravimeter"
    noise_mgal: q.GravimeterNoise
    """White noise of each channel."""
    bias_mgal: q.GravimeterBias = 0.0
    """Standard deviation of a bias of each channel; it is a state if estimators assume one."""
    bias_time_s: q.TimeConstant | None = None
    """Correlation time of the bias (first-order Gauss–Markov). Without it: a constant."""
    components: Annotated[Several[Literal["scalar", "east", "north"]], distinct("a component")] = (
        "scalar",
    )
    """`"scalar"`: excess of downward gravity; `"east"`, `"north"`: horizontal components."""
    readings: Literal["simulated", "measured"] = "simulated"
    """Simulated measurements, or those of the survey lines that `[trajectory]` flies."""

    @model_validator(mode="after")
    def _check(self) -> GravimeterSpec:
        if self.readings == "measured" and self.components != ("scalar",):
            raise ValueError('readings = "measured" requires components = ["scalar"]')
        return self

    @property
    def in_words(self) -> str:
        """Gravimeter in words, with the noise if the measurements are simulated."""
        if self.readings == "measured":
            return "measured gravity"
        return f"gravimeter {self.noise_mgal:g} mGal"


@changes(GravimeterSpec, but=("period_s", "components", "readings"))
class GravimeterChange(Section):
    """``[model.gravimeter]``: the gravimeter that the estimators assume."""


class TrueGravimeter(GravimeterChange, Interruptions):
    """``[truth.gravimeter]``: the true gravimeter."""

    outlier_mgal: q.Outlier = 0.0
    """Standard deviation of outliers, drawn for each measurement."""


class RecordedGravimeter(GravimeterSpec, ReadingsRecording):
    """``[gravimeter]`` with a file of measurements."""


AidingSpec = GnssSpec | LogSpec | BarometerSpec | GravimeterSpec
"""All kinds, in the order of the channels and biases of sensors that are called by their kind."""
AidingChange = GnssChange | LogChange | BarometerChange | GravimeterChange
TrueAiding = TrueGnss | TrueLog | TrueBarometer | TrueGravimeter
RecordedAiding = RecordedGnss | RecordedLog | RecordedBarometer | RecordedGravimeter
KINDS: tuple[str, ...] = tuple(spec.model_fields["kind"].default for spec in get_args(AidingSpec))
"""Names of the kinds."""


def unchanged(kind: str) -> TrueAiding:
    """Return an empty table ``[truth.<kind>]``, which changes nothing."""
    table: TrueAiding = get_args(TrueAiding)[KINDS.index(kind)]()
    return table
