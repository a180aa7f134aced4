"""Tables of inertial sensors, field and prior, and of their changes for truth and model.

``[imu]``, ``[field]`` and ``[initial_error]`` describe both the simulated truth and the assumed
model. ``[truth.imu]`` etc. change only the truth, and add errors that no estimator models.
``[model.imu]`` etc. change only the model.
"""

from __future__ import annotations

from functools import partial
from typing import Annotated, Literal, NamedTuple

from pydantic import Field, model_validator

from . import quantities as q
from .aiding import AidingChange, AidingSpec, TrueAiding
from .gradiometer import GradiometerChange, GradiometerSpec, TrueGradiometer
from .named_sensors import NO_SENSORS, NamedSensors, WithSensors
from .presets import Grade, expanded
from .tables import Section, Three, changes

FEWEST_STEPS = 10.0
"""Fewest IMU periods in a time constant: in fewer, discrete steps are no longer the process."""


class ImuSpec(Section):
    """``[imu]``: the inertial sensors. A bias with a time constant is a Gauss–Markov process."""

    grade: Grade | None = None
    """Preset of biases and noise. It sets each of the four keys that the table omits."""
    period_s: q.SamplePeriod
    """Time between samples; the period of every other sensor is a whole multiple of it."""
    gyro_bias_deg_per_h: q.GyroBias
    """Standard deviation of the bias of each gyro."""
    gyro_noise_deg_per_sqrt_h: q.GyroNoise
    """White noise of each gyro: square root of its power spectral density (angular random walk)."""
    accelerometer_bias_ug: q.AccelerometerBias
    """Standard deviation of the bias of each accelerometer."""
    accelerometer_noise_ug_per_sqrt_hz: q.AccelerometerNoise
    """White noise of each accelerometer: square root of its power spectral density."""
    biases: Literal["drawn", "fixed"] = "drawn"
    """`"drawn"`: normally distributed, drawn once per run; `"fixed"`: this size, random signs."""
    gyro_bias_time_s: q.TimeConstant | None = None
    """Correlation time of gyro biases (first-order Gauss–Markov). Without it: constant."""
    accelerometer_bias_time_s: q.TimeConstant | None = None
    """Correlation time of accelerometer biases (first-order Gauss–Markov). Without it: constant."""

    _expanded = model_validator(mode="before")(partial(expanded, "imu"))

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


@changes(ImuSpec, but=("period_s", "biases"))
class ImuChange(Section):
    """``[model.imu]``: the inertial sensors that the estimators assume."""

    _expanded = model_validator(mode="before")(partial(expanded, "imu"))


class TrueImu(ImuChange):
    """``[truth.imu]``: the true inertial sensors, with errors drawn once per run from N(0, σ²)."""

    gyro_scale_factor_ppm: q.Ppm = 0.0
    """Standard deviation, drawn once per run and axis."""
    accelerometer_scale_factor_ppm: q.Ppm = 0.0
    """Standard deviation, drawn once per run and axis."""
    gyro_misalignment_arcmin: q.Arcmin = 0.0
    """Standard deviation, drawn once per run and axis."""
    accelerometer_misalignment_arcmin: q.Arcmin = 0.0
    """Standard deviation, drawn once per run and axis."""


class AltimeterSpec(Section):
    """``[altimeter]``: heights that damp the vertical channel of the INS."""

    noise_m_per_sqrt_hz: q.AltimeterNoise
    """Square root D of the noise's power spectral density; a mean over a time T has the error D /
    √T.
    """
    time_constant_s: q.Damping = 100.0
    """Time constant of the damping."""

    def require_slower_than(self, period: float) -> None:
        """Raise ValueError if the damping is too fast for a sampling period [s]."""
        shortest = FEWEST_STEPS * period
        if self.time_constant_s < shortest:
            raise ValueError(
                f"altimeter.time_constant_s is {self.time_constant_s:g} s and must be at "
                f"least {FEWEST_STEPS:g} times imu.period_s, {shortest:g} s"
            )


class InitialErrorSpec(Section):
    """``[initial_error]``: standard deviations of the INS errors per axis at the start."""

    position_m: q.PositionError
    """Standard deviation per axis."""
    velocity_mps: q.VelocityError
    """Standard deviation per axis."""
    attitude_arcmin: q.AttitudeError
    """Standard deviation per axis."""
    height_m: q.HeightError | None = None
    """Standard deviation of the height. Without it: `position_m`."""
    heading_arcmin: q.AttitudeError | None = None
    """Standard deviation of the heading. Without it: `attitude_arcmin`."""

    @property
    def height_sigma_m(self) -> float:
        """Standard deviation of the height [m]: ``height_m`` or ``position_m``."""
        return self.position_m if self.height_m is None else self.height_m

    @property
    def heading_sigma_arcmin(self) -> float:
        """Standard deviation of the heading [′]: ``heading_arcmin`` or ``attitude_arcmin``."""
        return self.attitude_arcmin if self.heading_arcmin is None else self.heading_arcmin


@changes(InitialErrorSpec)
class InitialErrorChange(Section):
    """Standard deviations of the true initial errors (truth) or of the assumed prior (model)."""


class MapErrorSpec(Section):
    """``[field.error]``: errors of a map, shared by truth and model."""

    resolution_km: q.Wavelength | None = None
    """Standard deviation of a horizontal Gaussian that smooths the map."""
    density_factor: q.DensityFactor = 1.0
    """Factor of the whole disturbing field."""
    white_noise_eotvos: q.MapNoise = 0.0
    """RMS of noise that is independent at each node and in each component."""
    correlated_noise_eotvos: q.MapNoise = 0.0
    """Adds a random harmonic field to all components: RMS of its Γ_UU at the lowest nodes."""
    correlation_km: q.Wavelength = 10.0
    """Distance at which the correlation of this field is 1/e."""
    seed: Annotated[int, Field(ge=0, le=2**31)] = 1
    """Seed of the noise: the errors are the same in all runs."""


@changes(MapErrorSpec)
class MapErrorChange(Section):
    """Changes of `[field.error]` for the truth or for the model."""


class FieldSpec(Section):
    """``[field]``: gradient map, and gravity that the accelerometers measure."""

    source: str
    """`"normal"` (no map), a shipped name, or the path of a map (`*.nc`)."""
    south_deg: q.Latitude = 0.0
    """Southern limit of the map, with room for INS errors. Give all four limits, except for a map
    file.
    """
    north_deg: q.Latitude = 0.0
    """Limit of the map, see `south_deg`."""
    west_deg: q.Longitude = 0.0
    """Limit of the map, see `south_deg`."""
    east_deg: q.Longitude = 0.0
    """Limit of the map, see `south_deg`."""
    lowest_m: q.Height = 0.0
    """Lowest layer of nodes; must be given for a shipped source."""
    highest_m: q.Height = 0.0
    """Highest layer of nodes; must be given for a shipped source."""
    spacing_arcmin: q.MapSpacing = 1.25
    """Spacing of the nodes in latitude and longitude. The largest spacing depends on the height."""
    height_spacing_m: q.HeightSpacing = 500.0
    """Spacing of the layers of nodes."""
    land_correction: bool = True
    """Whether geoid heights on land are converted to height anomalies (EGM2008 sources)."""
    relief_smoothing_deg: q.ReliefSmoothing = 0.0
    """Standard deviation of a Gaussian that smooths the relief."""
    density_kg_m3: q.Density = 2670.0
    """Density of the ground (terrain sources)."""
    drape: bool = False
    """Whether layers follow the ground, `lowest_m` and `highest_m` above it (terrain sources)."""
    gravity_disturbance: bool = False
    """Whether the true accelerometers measure the gravity disturbance (unknown to the INS)."""
    error: MapErrorSpec | None = None


@changes(FieldSpec, but=("gravity_disturbance", "error"))
class FieldChange(Section):
    """``[truth.field]``, ``[model.field]``: field of the truth or of the model."""

    error: MapErrorChange | None = None


class TrueField(FieldChange):
    """``[truth.field]``: true field, and gravity disturbance that the accelerometers measure."""

    gravity_disturbance: bool | None = None
    """Whether the true accelerometers measure the gravity disturbance."""
    constant_disturbance_mgal: Three[q.Disturbance] = (0.0, 0.0, 0.0)
    """Added to the disturbance of the map (east, north, up); needs `gravity_disturbance = true`."""


class ModelField(FieldChange):
    """``[model.field]``: map of the estimators, and gravity compensation of the INS."""

    compensate: bool = False
    """Whether the mechanization adds the disturbance of this map at the indicated position.

    Needs a map and `gravity_disturbance = true`.
    """
    standard_error: bool = False
    """Whether the standard error of the map is added to the white noise of each channel.

    Most gradient maps made from survey lines state a standard error. Needs a `"local-level"`
    gradiometer.
    """


class DisturbanceSpec(Section):
    """``[model.disturbance]``: the gravity disturbance unknown to the INS, as three states.

    The ENU states are first-order Gauss–Markov processes along the track. The correlation falls to
    1/e at the correlation distance. Without a distance the states are constants.

    With ``integrate_gradients`` the INS adds the change of gravity that the gradiometer measures.
    The states are then the initial disturbance plus a random walk from the integrated noise.
    """

    horizontal_mgal: q.DisturbanceSize
    """Standard deviation of the east and the north component."""
    vertical_mgal: q.DisturbanceSize | None = None
    """Standard deviation of the up component. Without it: `horizontal_mgal`."""
    distance_km: q.DisturbanceDistance | None = None
    """Correlation distance along the track (first-order Gauss–Markov). Without it: a constant."""
    integrate_gradients: bool = False
    """Whether the INS integrates measured gradients. Excludes `distance_km` and `compensate`."""

    def require_integrable(self, gradiometer: GradiometerSpec | None, compensate: bool) -> None:
        """Raise ValueError if ``integrate_gradients`` is set but not possible.

        The gradiometer must be on a local-level mount. It must have no filter, delay, coloured
        noise, biases or mounting angles. ``distance_km`` must be None and ``compensate`` false.
        This method does not check that the channels determine the whole tensor.
        """
        why = self._why_not(gradiometer, compensate) if self.integrate_gradients else ""
        if why:
            raise ValueError(f"disturbance.integrate_gradients {why}")

    def _why_not(self, gradiometer: GradiometerSpec | None, compensate: bool) -> str:
        """Return the reason for which gradients cannot be integrated; "" if they can."""
        if self.distance_km is not None:
            return "turns the measurement noise into a random walk: distance_km must not be given"
        if compensate:
            return (
                "and field.compensate exclude each other: the INS would add the gravity "
                "disturbance twice"
            )
        if gradiometer is None:
            return "needs a gradiometer"
        if gradiometer.instrument != "local-level":
            return (
                'needs gradients east, north and up: gradiometer.instrument = "local-level"'
                f', found "{gradiometer.instrument}"'
            )
        if gradiometer.filter != "none" or gradiometer.latency_s > 0.0:
            return 'needs measurements without delay: gradiometer.filter = "none" and no latency_s'
        if gradiometer.coloured_noise is not None:
            return "needs white noise: gradiometer.coloured_noise must not be given"
        if gradiometer.bias_eotvos > 0.0 or gradiometer.drift_eotvos_per_sqrt_h > 0.0:
            return (
                "has no states for the integral of a gradiometer bias: bias_eotvos and "
                "drift_eotvos_per_sqrt_h must be 0 for the estimators"
            )
        if gradiometer.mounting_sigma_arcmin > 0.0:
            return (
                "integrates gradients without correction: mounting_sigma_arcmin must be 0 for "
                "the estimators"
            )
        return ""


class TruthSpec(WithSensors):
    """``[truth]``: changes of the simulated truth, unknown to estimators."""

    imu: TrueImu = TrueImu()
    gradiometer: TrueGradiometer = TrueGradiometer()
    field: TrueField = TrueField()
    initial_error: InitialErrorChange = InitialErrorChange()
    sensor: NamedSensors[TrueAiding] = NO_SENSORS


class ModelSpec(WithSensors):
    """``[model]``: changes of the model that estimators assume."""

    imu: ImuChange = ImuChange()
    gradiometer: GradiometerChange = GradiometerChange()
    field: ModelField = ModelField()
    initial_error: InitialErrorChange = InitialErrorChange()
    disturbance: DisturbanceSpec | None = None
    sensor: NamedSensors[AidingChange] = NO_SENSORS


class Side(NamedTuple):
    """Sensors, field and initial errors of the truth or of the model."""

    imu: ImuSpec
    gradiometer: GradiometerSpec | None
    field: FieldSpec
    initial_error: InitialErrorSpec
    sensor: NamedSensors[AidingSpec]
