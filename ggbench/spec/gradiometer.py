"""What a scenario file may say of the gradiometer.

``[gradiometer]`` holds for the simulated truth and for what the estimators are told;
``[truth.gradiometer]`` changes it for the truth alone, and knows errors that no estimator is told
of; ``[model.gradiometer]`` changes it for the estimators alone.
"""

from __future__ import annotations

from typing import Annotated, Literal, get_args

from pydantic import Field, model_validator

from ..sensors.gradiometer.rotating import RotatingGradiometer, RotatingGradiometerError
from .aiding import Interruptions
from .quantities import (
    Arcmin,
    Baseline,
    Burst,
    ClockError,
    DiskNoise,
    Freedom,
    Frequency,
    GradiometerBias,
    Jitter,
    Latency,
    Noise,
    NoiseBehindFilter,
    Outlier,
    Ppm,
    ReadingPeriod,
    Regularization,
    Spin,
    TimeConstant,
    Vibration,
)
from .tables import Listed, Section

Component = Literal["xx", "xy", "xz", "yy", "yz", "zz", "xx-yy", "yy-zz", "zz-xx"]
NOISES = ("noise_eotvos", "noise_density_eotvos_per_sqrt_hz")
"""The two ways to state the gradiometer's noise; one replaces the other."""


class RotatingSpec(Section):
    """``[gradiometer.rotating]``: disks of accelerometers spinning about axes of the mount."""

    baseline_m: Baseline
    rotation_hz: Spin
    spin_axes: Annotated[Listed[Literal["x", "y", "z"]], Field(min_length=1)] = ("x", "y", "z")
    accelerometer_noise_ng_per_sqrt_hz: DiskNoise | None = None
    """White noise of each accelerometer, from which that of the channels follows."""

    @model_validator(mode="after")
    def _check(self) -> RotatingSpec:
        if len(set(self.spin_axes)) != len(self.spin_axes):
            raise ValueError("spin_axes names an axis twice")
        return self


class GradiometerSpec(Section):
    """``[gradiometer]``: instrument, noise (as RMS or as density), filter and its treatment."""

    period_s: ReadingPeriod
    instrument: Literal["platform", "local-level", "strapdown"] = "platform"
    noise_eotvos: Noise | None = None
    noise_density_eotvos_per_sqrt_hz: Noise | None = None
    bias_eotvos: GradiometerBias = 0.0
    drift_eotvos_per_sqrt_h: GradiometerBias = 0.0
    components: Annotated[Listed[Component], Field(min_length=1)] = (
        "xx", "xy", "xz", "yy", "yz", "zz",
    )  # fmt: skip
    rotating: RotatingSpec | None = None
    filter: Literal["butterworth", "none"] = "none"
    filter_order: Annotated[int, Field(ge=1, le=12)] = 7
    filter_cutoff_hz: Frequency = 0.2
    filter_treatment: Literal["whitened", "delayed"] = "whitened"
    whitening_regularization: Regularization = 1e-2
    noise_behind_filter_eotvos: NoiseBehindFilter = 0.0
    latency_s: Latency = 0.0

    @model_validator(mode="after")
    def _check(self) -> GradiometerSpec:
        noises = [self.noise_eotvos, self.noise_density_eotvos_per_sqrt_hz]
        said = "noise_eotvos (RMS) and noise_density_eotvos_per_sqrt_hz"
        if self.rotating is not None:
            noises.append(self.rotating.accelerometer_noise_ng_per_sqrt_hz)
            said += " and rotating.accelerometer_noise_ng_per_sqrt_hz"
        if sum(noise is not None for noise in noises) != 1:
            raise ValueError(f"give exactly one of {said}")
        if self.rotating is not None:
            try:
                RotatingGradiometer(
                    self.rotating.baseline_m, self.rotating.rotation_hz, self.period_s
                )
            except RotatingGradiometerError as error:
                raise ValueError(str(error)) from None
        if len(set(self.components)) != len(self.components):
            raise ValueError("components names a component twice")
        if self.rotating is not None and self.components != get_args(Component)[:6]:
            raise ValueError(
                "components must not be given beside [gradiometer.rotating]: its spin_axes say "
                "what it measures"
            )
        nyquist = 0.5 / self.period_s
        if self.filter != "none" and self.filter_cutoff_hz >= nyquist:
            raise ValueError(
                f"filter_cutoff_hz is {self.filter_cutoff_hz:g} Hz and must lie below the Nyquist "
                f"frequency of the readings, {nyquist:g} Hz (period_s = {self.period_s:g}); "
                'use filter = "none" or read faster'
            )
        return self

    def require_tractable(self) -> None:
        """Raise ValueError if estimators that are told of it have no model of its readings."""
        if self.latency_s > 0.0 and self.filter != "none":
            raise ValueError(
                f"gradiometer.latency_s is {self.latency_s:g} s in what the estimators are told, "
                "and they have no model of readings that are both late and filtered: set "
                'filter = "none", or give the latency in [truth.gradiometer] alone'
            )


class GradiometerChange(Section):
    """``[model.gradiometer]``: what the estimators believe of the gradiometer."""

    noise_eotvos: Noise | None = None
    noise_density_eotvos_per_sqrt_hz: Noise | None = None
    bias_eotvos: GradiometerBias | None = None
    drift_eotvos_per_sqrt_h: GradiometerBias | None = None
    noise_behind_filter_eotvos: NoiseBehindFilter | None = None
    latency_s: Latency | None = None


class RotatingErrorsSpec(Section):
    """``[truth.gradiometer.rotating]``: σ of what is wrong with a spinning disk, per run."""

    scale_factor_ppm: Ppm = 0.0
    scale_factor_mismatch_ppm: Ppm = 0.0
    baseline_error_ppm: Ppm = 0.0
    misalignment_arcmin: Arcmin = 0.0
    demodulation_phase_arcmin: Arcmin = 0.0
    rotation_rate_error_ppm: Ppm = 0.0
    vibration_mps2: Vibration = 0.0


class TrueGradiometer(GradiometerChange, Interruptions):
    """``[truth.gradiometer]``: the gradiometer as it is.

    Scale factor, misalignment and clock error are drawn once per run, N(0, σ²); a scale factor may
    walk from there. A tilt of a level mount is a Gauss–Markov process about each horizontal axis.
    Outliers strike readings one by one or in bursts, dropouts and timing jitter one by one.
    """

    scale_factor_ppm: Ppm = 0.0
    scale_drift_ppm_per_sqrt_h: Ppm = 0.0
    misalignment_arcmin: Arcmin = 0.0
    tilt_arcmin: Arcmin = 0.0
    tilt_time_s: TimeConstant | None = None
    noise_freedom: Freedom | None = None
    outlier_eotvos: Outlier = 0.0
    outlier_burst_s: Burst = 0.0
    outlier_channels: Literal["each", "all"] = "each"
    clock_error_s: ClockError = 0.0
    timing_jitter_s: Jitter = 0.0
    rotating: RotatingErrorsSpec | None = None

    @model_validator(mode="after")
    def _check_errors(self) -> TrueGradiometer:
        if (self.tilt_arcmin > 0.0) != (self.tilt_time_s is not None):
            raise ValueError("tilt_arcmin and tilt_time_s go together")
        if self.outlier_share == 0.0 and (
            self.outlier_burst_s > 0.0 or self.outlier_channels != "each"
        ):
            raise ValueError(
                "outlier_burst_s and outlier_channels say how outliers come: give outlier_share"
            )
        return self

    def require_possible(self, spec: GradiometerSpec) -> None:
        """Raise ValueError if an instrument, as it is in truth, cannot have these errors."""
        if spec.filter != "none" and (self.dropouts_s or self.dropout_share > 0.0):
            raise ValueError(
                "truth.gradiometer: readings can only drop out of an instrument without a filter; "
                'set gradiometer.filter = "none"'
            )
        if self.clock_error_s > 0.0 and spec.instrument != "platform":
            raise ValueError(
                "truth.gradiometer.clock_error_s is an error of the time by which a platform knows "
                f'inertial axes; instrument = "{spec.instrument}" needs none'
            )
        if self.tilt_arcmin > 0.0 and spec.instrument != "local-level":
            raise ValueError(
                "truth.gradiometer.tilt_arcmin is a tilt of a mount that is held level; "
                f'instrument = "{spec.instrument}" is not'
            )
        if self.rotating is not None and spec.rotating is None:
            raise ValueError(
                "truth.gradiometer.rotating gives errors of an instrument that "
                "[gradiometer.rotating] does not describe"
            )
        if self.rotating is not None and spec.latency_s > 0.0:
            raise ValueError(
                "truth.gradiometer.rotating has errors of the motion during a reading, which is "
                "taken at the reading's own time: gradiometer.latency_s must be 0"
            )
