"""What a scenario file may say of sensors and of the field, and what truth and model change in it.

``[imu]``, ``[gradiometer]``, ``[field]`` and ``[initial_error]`` hold for the simulated truth and
for what the estimators are told. ``[truth.imu]`` and the like change them for the truth alone, and
know errors that no estimator is told of; ``[model.imu]`` and the like for the estimators alone.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal, NamedTuple, TypeVar

from pydantic import Field, model_validator

from .aiding import (
    BarometerChange,
    BarometerSpec,
    GnssChange,
    GnssSpec,
    GravimeterChange,
    GravimeterSpec,
    LogChange,
    LogSpec,
    TrueBarometer,
    TrueGnss,
    TrueGravimeter,
    TrueLog,
)
from .further import Named
from .gradiometer import NOISES, GradiometerChange, GradiometerSpec, TrueGradiometer
from .quantities import (
    AccelerometerBias,
    AccelerometerNoise,
    AltimeterNoise,
    Arcmin,
    AttitudeError,
    Damping,
    Density,
    DensityFactor,
    Disturbance,
    DisturbanceDistance,
    DisturbanceSize,
    GyroBias,
    GyroNoise,
    Height,
    HeightError,
    HeightSpacing,
    Latitude,
    Longitude,
    MapNoise,
    MapSpacing,
    PositionError,
    Ppm,
    ReliefSmoothing,
    SamplePeriod,
    TimeConstant,
    VelocityError,
    Wavelength,
)
from .tables import Listed, Section

FEWEST_STEPS = 10.0
"""Fewest IMU periods in a time constant: in fewer, discrete steps are no longer the process."""


class ImuSpec(Section):
    """``[imu]``: the inertial sensors. A bias with a time constant is a Gauss–Markov process."""

    period_s: SamplePeriod
    gyro_bias_deg_per_h: GyroBias
    gyro_noise_deg_per_sqrt_h: GyroNoise
    accelerometer_bias_ug: AccelerometerBias
    accelerometer_noise_ug_per_sqrt_hz: AccelerometerNoise
    biases: Literal["drawn", "fixed"] = "drawn"
    gyro_bias_time_s: TimeConstant | None = None
    accelerometer_bias_time_s: TimeConstant | None = None

    @model_validator(mode="after")
    def _check(self) -> ImuSpec:
        for key in ("gyro_bias_time_s", "accelerometer_bias_time_s"):
            time = getattr(self, key)
            if time is None:
                continue
            if self.biases == "fixed":
                raise ValueError(
                    'biases = "fixed" and a time constant of a bias exclude each other'
                )
            if time < FEWEST_STEPS * self.period_s:
                raise ValueError(
                    f"{key} is {time:g} s and must be at least {FEWEST_STEPS:g} times "
                    f"imu.period_s, {FEWEST_STEPS * self.period_s:g} s"
                )
        return self


class ImuChange(Section):
    """``[model.imu]``: what the estimators believe of the inertial sensors."""

    gyro_bias_deg_per_h: GyroBias | None = None
    gyro_noise_deg_per_sqrt_h: GyroNoise | None = None
    accelerometer_bias_ug: AccelerometerBias | None = None
    accelerometer_noise_ug_per_sqrt_hz: AccelerometerNoise | None = None
    gyro_bias_time_s: TimeConstant | None = None
    accelerometer_bias_time_s: TimeConstant | None = None


class TrueImu(ImuChange):
    """``[truth.imu]``: the inertial sensors as they are; errors drawn once per run, N(0, σ²)."""

    gyro_scale_factor_ppm: Ppm = 0.0
    accelerometer_scale_factor_ppm: Ppm = 0.0
    gyro_misalignment_arcmin: Arcmin = 0.0
    accelerometer_misalignment_arcmin: Arcmin = 0.0


class AltimeterSpec(Section):
    """``[altimeter]``: heights that damp the vertical channel of the INS, white noise of a PSD."""

    noise_m_per_sqrt_hz: AltimeterNoise
    time_constant_s: Damping = 100.0

    def require_slower_than(self, period: float) -> None:
        """Raise ValueError if the damping is too quick for samples of a period [s]."""
        shortest = FEWEST_STEPS * period
        if self.time_constant_s < shortest:
            raise ValueError(
                f"altimeter.time_constant_s is {self.time_constant_s:g} s and must be at "
                f"least {FEWEST_STEPS:g} times imu.period_s, {shortest:g} s"
            )


class InitialErrorSpec(Section):
    """``[initial_error]``: standard deviation of the INS error per axis at the start."""

    position_m: PositionError
    velocity_mps: VelocityError
    attitude_arcmin: AttitudeError
    height_m: HeightError | None = None
    heading_arcmin: AttitudeError | None = None


class InitialErrorChange(Section):
    """``[truth.initial_error]``, ``[model.initial_error]``."""

    position_m: PositionError | None = None
    velocity_mps: VelocityError | None = None
    attitude_arcmin: AttitudeError | None = None
    height_m: HeightError | None = None
    heading_arcmin: AttitudeError | None = None


class MapErrorSpec(Section):
    """``[field.error]``: what is wrong with a map, see :mod:`ggbench.gravity.degraded_map`."""

    resolution_km: Wavelength | None = None
    density_factor: DensityFactor = 1.0
    white_noise_eotvos: MapNoise = 0.0
    correlated_noise_eotvos: MapNoise = 0.0
    correlation_km: Wavelength = 10.0
    seed: Annotated[int, Field(ge=0, le=2**31)] = 1


class FieldSpec(Section):
    """``[field]``: the gradient map over the normal field, and what the accelerometers feel."""

    source: str
    south_deg: Latitude = 0.0
    north_deg: Latitude = 0.0
    west_deg: Longitude = 0.0
    east_deg: Longitude = 0.0
    lowest_m: Height = 0.0
    highest_m: Height = 0.0
    spacing_arcmin: MapSpacing = 1.25
    height_spacing_m: HeightSpacing = 500.0
    land_correction: bool = True
    relief_smoothing_deg: ReliefSmoothing = 0.0
    density_kg_m3: Density = 2670.0
    gravity_disturbance: bool = False
    error: MapErrorSpec | None = None


class FieldChange(Section):
    """``[truth.field]``, ``[model.field]``: another field than ``[field]``, in part or whole."""

    source: str | None = None
    south_deg: Latitude | None = None
    north_deg: Latitude | None = None
    west_deg: Longitude | None = None
    east_deg: Longitude | None = None
    lowest_m: Height | None = None
    highest_m: Height | None = None
    spacing_arcmin: MapSpacing | None = None
    height_spacing_m: HeightSpacing | None = None
    land_correction: bool | None = None
    relief_smoothing_deg: ReliefSmoothing | None = None
    density_kg_m3: Density | None = None
    error: MapErrorSpec | None = None


class TrueField(FieldChange):
    """``[truth.field]``: also says what disturbing gravity the accelerometers feel."""

    gravity_disturbance: bool | None = None
    constant_disturbance_mgal: Annotated[Listed[Disturbance], Field(min_length=3, max_length=3)] = (
        0.0,
        0.0,
        0.0,
    )
    """East, north, up: felt beside the map's."""


class ModelField(FieldChange):
    """``[model.field]``: also says whether the INS takes its map's disturbance into account."""

    compensate: bool = False


class DisturbanceSpec(Section):
    """``[model.disturbance]``: the gravity that the INS does not know, as three states.

    A Gauss–Markov process along the track, ENU, of a standard deviation and a distance over which
    its correlation falls to 1/e; a constant without a distance. With ``integrate_gradients`` the
    INS adds what the gradiometer's readings say it has changed by, and the states are what is left:
    what it was at the start, and a random walk of the readings' noise.
    """

    horizontal_mgal: DisturbanceSize
    vertical_mgal: DisturbanceSize | None = None
    distance_km: DisturbanceDistance | None = None
    integrate_gradients: bool = False

    def require_integrable(self, gradiometer: GradiometerSpec | None, compensate: bool) -> None:
        """Raise ValueError if gradients are to be integrated that are not there to be."""
        if not self.integrate_gradients:
            return
        said = "disturbance.integrate_gradients"
        if self.distance_km is not None:
            raise ValueError(
                f"{said} leaves a walk of the readings' noise: distance_km must not be given"
            )
        if compensate:
            raise ValueError(
                f"{said} and field.compensate exclude each other: the INS would add the gravity "
                "disturbance twice"
            )
        if gradiometer is None:
            raise ValueError(f"{said} needs a gradiometer, and none is on board")
        if gradiometer.instrument != "local-level":
            raise ValueError(
                f'{said} needs gradients east, north and up: gradiometer.instrument = "local-level"'
                f', found "{gradiometer.instrument}"'
            )
        if gradiometer.filter != "none" or gradiometer.latency_s > 0.0:
            raise ValueError(
                f'{said} needs readings without delay: gradiometer.filter = "none" and no latency_s'
            )
        if gradiometer.bias_eotvos > 0.0 or gradiometer.drift_eotvos_per_sqrt_h > 0.0:
            raise ValueError(
                f"{said} has no states for what a bias of the gradiometer adds up to: "
                "bias_eotvos and drift_eotvos_per_sqrt_h must be 0 in what the estimators are told"
            )


FurtherSpecs = Named[GnssSpec | LogSpec | BarometerSpec | GravimeterSpec]
"""``[further.<name>]``: sensors beside those of the kinds' own tables."""


class TruthSpec(Section):
    """``[truth]``: what the simulation does, and no estimator is told."""

    imu: TrueImu = TrueImu()
    gradiometer: TrueGradiometer = TrueGradiometer()
    field: TrueField = TrueField()
    initial_error: InitialErrorChange = InitialErrorChange()
    gnss: TrueGnss = TrueGnss()
    velocity_log: TrueLog = TrueLog()
    barometer: TrueBarometer = TrueBarometer()
    gravimeter: TrueGravimeter = TrueGravimeter()
    further: Named[TrueGnss | TrueLog | TrueBarometer | TrueGravimeter] = Named()


class ModelSpec(Section):
    """``[model]``: what the estimators are told where it is not the truth."""

    imu: ImuChange = ImuChange()
    gradiometer: GradiometerChange = GradiometerChange()
    field: ModelField = ModelField()
    initial_error: InitialErrorChange = InitialErrorChange()
    disturbance: DisturbanceSpec | None = None
    gnss: GnssChange = GnssChange()
    velocity_log: LogChange = LogChange()
    barometer: BarometerChange = BarometerChange()
    gravimeter: GravimeterChange = GravimeterChange()
    further: Named[GnssChange | LogChange | BarometerChange | GravimeterChange] = Named()


class Side(NamedTuple):
    """Sensors, field and initial errors as one side has them: the truth or the model."""

    imu: ImuSpec
    gradiometer: GradiometerSpec | None
    field: FieldSpec
    initial_error: InitialErrorSpec
    gnss: GnssSpec | None
    velocity_log: LogSpec | None
    barometer: BarometerSpec | None
    gravimeter: GravimeterSpec | None
    further: FurtherSpecs


S = TypeVar("S", bound=Section)


def changed(spec: S, change: Section) -> S:
    """Return a table with what is given in ``change`` laid over it.

    Raises
    ------
    ValueError
        (pydantic's) if the result breaks a rule of the table.
    """
    known = type(spec).model_fields
    given: dict[str, Any] = {
        key: value
        for key, value in change.model_dump(exclude_defaults=True).items()
        if key in known and key != "rotating"
    }
    if not given:
        return spec
    content = spec.model_dump(exclude_unset=True)
    for new, old in (NOISES, NOISES[::-1]):
        if new in given and old not in given:
            content.pop(old, None)
    if content.get("rotating") and any(noise in given for noise in NOISES):
        # A stated noise of the channels replaces the one that follows from the accelerometers.
        content["rotating"].pop("accelerometer_noise_ng_per_sqrt_hz", None)
    return type(spec).model_validate(content | given)
