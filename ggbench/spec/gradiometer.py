"""Tables of the gradiometer.

``[gradiometer]`` describes both the simulated truth and the assumed model. ``[truth.gradiometer]``
changes only the truth, and adds errors that no estimator models. ``[model.gradiometer]`` changes
only the model.
"""

from __future__ import annotations

from functools import partial
from typing import Annotated, Any, Literal, get_args

from pydantic import Field, model_validator

from ..sensors.gradiometer.rotating import RotatingGradiometer, RotatingGradiometerError
from . import quantities as q
from .aiding import Interruptions, PeriodicSpec
from .presets import NOISES, PublishedGradiometer, expanded
from .tables import Section, Several, Three, changes, distinct

Component = Literal["xx", "xy", "xz", "yy", "yz", "zz", "xx-yy", "yy-zz", "zz-xx"]


class RotatingSpec(Section):
    """``[gradiometer.rotating]``: disks of accelerometers that spin about axes of the mount."""

    baseline_m: q.Baseline
    """Distance between opposite accelerometers."""
    rotation_hz: q.Spin
    """Turns per second; a measurement lasts a whole number of half turns."""
    spin_axes: Annotated[Several[Literal["x", "y", "z"]], distinct("an axis")] = ("x", "y", "z")
    """Spin axes, one disk each. The disk about z measures (xx − yy)/2 and xy."""
    accelerometer_noise_ng_per_sqrt_hz: q.DiskNoise | None = None
    """White noise of each accelerometer; the noise of the channels follows from it."""


_ADDED = "bias_eotvos"
"""The only error that can be added to readings that were measured."""


class GradiometerSpec(PeriodicSpec):
    """``[gradiometer]``: instrument, noise (as RMS or as density), low-pass filter."""

    preset: PublishedGradiometer | None = None
    """Published instrument. It sets noise, channels and mount unless these keys are given."""
    instrument: Literal["platform", "local-level", "strapdown"] = "platform"
    """Mount, which fixes the measurement axes."""
    noise_eotvos: q.Noise | None = None
    """RMS noise of a channel. Give this, the density or the noise of rotating accelerometers."""
    noise_density_eotvos_per_sqrt_hz: q.Noise | None = None
    """Noise density D, given instead of the RMS. At a rate f the RMS is D √(f/2)."""
    coloured_noise: Annotated[str, Field(min_length=1)] | None = None
    """Vector autoregression (JSON), given instead of the RMS: shipped name or path of a file."""
    readings: Literal["simulated", "measured"] = "simulated"
    """Simulated measurements, or those of the survey lines that `[trajectory]` flies."""
    bias_eotvos: q.GradiometerBias = 0.0
    """Standard deviation of a bias of each channel; it is a state if estimators assume one."""
    drift_eotvos_per_sqrt_h: q.GradiometerBias = 0.0
    """Random walk of the biases."""
    mounting_sigma_arcmin: q.Arcmin = 0.0
    """Standard deviation of the mounting angle about each axis, drawn once per run.

    The rotation is right-handed. The three angles are states if estimators assume them.
    """
    components: Annotated[Several[Component], distinct("a component")] = (
        "xx",
        "xy",
        "xz",
        "yy",
        "yz",
        "zz",
    )
    """Channels; `"xx-yy"` is (xx − yy)/2, and so on."""
    rotating: RotatingSpec | None = None
    filter: Literal["butterworth", "none"] = "none"
    """Low-pass filter of the instrument."""
    filter_order: Annotated[int, Field(ge=1, le=12)] = 7
    """Order of the filter."""
    filter_cutoff_hz: q.Frequency = 0.2
    """Cut-off frequency of the filter, below the Nyquist frequency of the measurements."""
    filter_treatment: Literal["whitened", "delayed"] = "whitened"
    """Model of the filter in estimators: whitening, or a fixed delay."""
    whitening_regularization: q.Regularization = 1e-2
    """Smallest ratio of noise behind the filter to noise before it that whitening assumes."""
    noise_behind_filter_eotvos: q.NoiseBehindFilter | None = None
    """RMS of additional white noise of each channel, behind the filter if there is one.

    Without it: `whitening_regularization` times the noise if measurements are whitened, else 0.
    """
    latency_s: q.Latency = 0.0
    """Age of a measurement at its time stamp; no measurement is earlier than the start.

    With a filter, only the truth may have a latency.
    """

    _expanded = model_validator(mode="before")(partial(expanded, "gradiometer"))

    @model_validator(mode="after")
    def _check(self) -> GradiometerSpec:
        noises: list[Any] = [getattr(self, key) for key in NOISES]
        keys = "noise_eotvos (RMS), noise_density_eotvos_per_sqrt_hz and coloured_noise"
        if self.rotating is not None:
            noises.append(self.rotating.accelerometer_noise_ng_per_sqrt_hz)
            keys += " and rotating.accelerometer_noise_ng_per_sqrt_hz"
        if sum(noise is not None for noise in noises) != 1:
            raise ValueError(f"give exactly one of {keys}")
        if self.rotating is not None:
            try:
                RotatingGradiometer(
                    self.rotating.baseline_m, self.rotating.rotation_hz, self.period_s
                )
            except RotatingGradiometerError as error:
                raise ValueError(str(error)) from None
        if self.rotating is not None and self.components != get_args(Component)[:6]:
            raise ValueError(
                "components must not be given with [gradiometer.rotating]: its spin_axes define "
                "the channels"
            )
        if self.coloured_noise is not None:
            self._require_plain("coloured_noise")
            if self.drift_eotvos_per_sqrt_h > 0.0:
                raise ValueError(
                    "coloured_noise is whitened with constant biases only: "
                    "drift_eotvos_per_sqrt_h must be 0"
                )
            if self.mounting_sigma_arcmin > 0.0 and self.instrument != "local-level":
                raise ValueError(
                    "coloured_noise with mounting_sigma_arcmin needs a mount whose axes do not "
                    f'turn: instrument = "local-level", found "{self.instrument}"'
                )
        if self.readings == "measured":
            self._require_plain('readings = "measured"')
            if self.instrument != "local-level":
                raise ValueError(
                    'readings = "measured" requires instrument = "local-level" (east, north, '
                    f'up), found "{self.instrument}"'
                )
        nyquist = 0.5 / self.period_s
        if self.filter != "none" and self.filter_cutoff_hz >= nyquist:
            raise ValueError(
                f"filter_cutoff_hz is {self.filter_cutoff_hz:g} Hz and must lie below the Nyquist "
                f"frequency of the measurements, {nyquist:g} Hz (period_s = {self.period_s:g}); "
                'use filter = "none" or a smaller period_s'
            )
        return self

    def _require_plain(self, key: str) -> None:
        """Raise ValueError if the table has a setting that ``key`` excludes, such as a filter."""
        for other, wrong in (
            ("filter", self.filter != "none"),
            ("latency_s", self.latency_s > 0.0),
            ("noise_behind_filter_eotvos", self.noise_behind_filter_eotvos is not None),
            ('instrument = "strapdown"', self.instrument == "strapdown"),
        ):
            if wrong:
                raise ValueError(f"{key} and {other} exclude each other")

    def require_tractable(self) -> None:
        """Raise ValueError if estimators have no model for the instrument's measurements."""
        if self.latency_s > 0.0 and self.filter != "none":
            raise ValueError(
                f"gradiometer.latency_s is {self.latency_s:g} s, but estimators have no model of "
                'measurements that are both late and filtered: set filter = "none", or give the '
                "latency only in [truth.gradiometer]"
            )


@changes(
    GradiometerSpec,
    but=(
        "period_s",
        "preset",
        "instrument",
        "components",
        "readings",
        "rotating",
        "filter",
        "filter_order",
        "filter_cutoff_hz",
        "filter_treatment",
        "whitening_regularization",
    ),
)
class GradiometerChange(Section):
    """``[model.gradiometer]``: the gradiometer that the estimators assume."""


class RotatingErrorsSpec(Section):
    """``[truth.gradiometer.rotating]``: errors of the spinning disks, which no estimator models."""

    scale_factor_ppm: q.Ppm = 0.0
    """Standard deviation, drawn once per run: error common to all accelerometers of a disk."""
    scale_factor_mismatch_ppm: q.Ppm = 0.0
    """Standard deviation, drawn once per run: differences within and between the pairs of a
    disk.
    """
    baseline_error_ppm: q.Ppm = 0.0
    """Standard deviation, drawn once per run, relative to the baseline."""
    misalignment_arcmin: q.Arcmin = 0.0
    """Standard deviation, drawn once per run: tilt of the sensitive axes."""
    demodulation_phase_arcmin: q.Arcmin = 0.0
    """Standard deviation, drawn once per run: phase error of the demodulation."""
    rotation_rate_error_ppm: q.Ppm = 0.0
    """Standard deviation, drawn once per run, relative to the spin."""
    vibration_mps2: q.Vibration = 0.0
    """Amplitude of the specific force at one, two and three times the spin rate, per axis."""


class TrueGradiometer(GradiometerChange, Interruptions):
    """``[truth.gradiometer]``: the true gradiometer.

    Scale factor, misalignment and clock error are drawn once per run from N(0, σ²); a scale factor
    may also be a random walk. The tilt of a level mount about each horizontal axis is a
    Gauss–Markov process. Outliers affect single measurements or bursts. Dropouts and timing jitter
    are independent between measurements.
    """

    scale_factor_ppm: q.Ppm = 0.0
    """Standard deviation, drawn once per run and channel."""
    scale_drift_ppm_per_sqrt_h: q.Ppm = 0.0
    """Random walk of each channel's scale factor, starting at the drawn value."""
    misalignment_arcmin: q.Arcmin = 0.0
    """Standard deviation of the mount's rotation about each axis, drawn once per run."""
    mounting_error_arcmin: Three[q.MountingError] = (0.0, 0.0, 0.0)
    """Right-handed rotation of the mount about its axes x, y, z, unknown to estimators.

    `[0, 0, 60]` turns x towards y by one degree. The axes are east, north, up for a `"local-level"`
    mount; right, forward, up for a `"strapdown"` mount; inertial axes for a `"platform"`.
    """
    lever_arm_error_m: Three[q.LeverArm] = (0.0, 0.0, 0.0)
    """Vector (right, forward, up) from the assumed to the true position of the instrument.

    A known lever arm has no effect, because the map is evaluated at the instrument.
    """
    tilt_arcmin: q.Arcmin = 0.0
    """Standard deviation of the tilt of a `"local-level"` mount about east and about north."""
    tilt_time_s: q.TimeConstant | None = None
    """Correlation time of the tilt (first-order Gauss–Markov); with `tilt_arcmin`."""
    noise_freedom: q.Freedom | None = None
    """Degrees of freedom of Student's t noise with the same standard deviation. Without it: normal
    noise.
    """
    noise_doubles_at_deg_per_s: q.NoisyRate | None = None
    """Angular rate of the body at which the noise is twice the noise at rest.

    The noise is σ (1 + rate / this value + acceleration / `noise_doubles_at_mps2`), with the RMS
    rate and acceleration during each measurement. Estimators assume σ.
    """
    noise_doubles_at_mps2: q.NoisyAcceleration | None = None
    """Acceleration, including gusts and turns, at which the noise is twice the noise at rest."""
    outlier_eotvos: q.Outlier = 0.0
    """Standard deviation of outliers, drawn for each measurement."""
    outlier_burst_s: q.Burst = 0.0
    """Mean duration of bursts of outliers; 0: single outliers.

    Bursts come from a two-state Markov chain; the share of time in bursts is `outlier_share`.
    """
    outlier_channels: Literal["each", "all"] = "each"
    """Whether outliers occur in each channel independently, or in all channels at once."""
    clock_error_s: q.ClockError = 0.0
    """Platform only: standard deviation of the error of the clock that orients it, drawn once per
    run.
    """
    timing_jitter_s: q.Jitter = 0.0
    """Standard deviation of the time error of each measurement."""
    rotating: RotatingErrorsSpec | None = None

    @model_validator(mode="after")
    def _check_errors(self) -> TrueGradiometer:
        if (self.tilt_arcmin > 0.0) != (self.tilt_time_s is not None):
            raise ValueError("tilt_arcmin and tilt_time_s must be given together")
        if self.outlier_share == 0.0 and (
            self.outlier_burst_s > 0.0 or self.outlier_channels != "each"
        ):
            raise ValueError("outlier_burst_s and outlier_channels require outlier_share")
        return self

    def require_possible(self, spec: GradiometerSpec) -> None:
        """Raise ValueError if the instrument that ``spec`` describes cannot have these errors."""
        if spec.readings == "measured" and self.model_dump(exclude_defaults=True).keys() - {_ADDED}:
            raise ValueError(
                "truth.gradiometer: measured readings already contain their errors; remove all "
                f"keys except {_ADDED}, a constant bias that is added"
            )
        of_white_noise = ("noise_freedom", "noise_doubles_at_deg_per_s", "noise_doubles_at_mps2")
        if spec.coloured_noise is not None and (
            self.dropout_share > 0.0
            or any(getattr(self, key) is not None for key in of_white_noise)
        ):
            raise ValueError(
                f"truth.gradiometer: dropout_share and {', '.join(of_white_noise)} need white "
                "noise; gradiometer.coloured_noise is coloured"
            )
        missing = bool(self.dropouts_s) or self.dropout_share > 0.0 or self.duty_off_s > 0.0
        if spec.filter != "none" and missing:
            raise ValueError(
                "truth.gradiometer: measurements can be missing only without a filter; set "
                'gradiometer.filter = "none"'
            )
        if self.clock_error_s > 0.0 and spec.instrument != "platform":
            raise ValueError(
                'truth.gradiometer.clock_error_s requires instrument = "platform", whose axes '
                f'depend on the clock; found "{spec.instrument}"'
            )
        if self.tilt_arcmin > 0.0 and spec.instrument != "local-level":
            raise ValueError(
                "truth.gradiometer.tilt_arcmin requires a level mount, instrument = "
                f'"local-level"; found "{spec.instrument}"'
            )
        if self.rotating is not None and spec.rotating is None:
            raise ValueError(
                "truth.gradiometer.rotating requires a rotating gradiometer: give the table "
                "[gradiometer.rotating]"
            )
        if self.rotating is not None and spec.latency_s > 0.0:
            raise ValueError(
                "truth.gradiometer.rotating requires gradiometer.latency_s = 0: its errors follow "
                "from the motion at the time stamp of a measurement"
            )
