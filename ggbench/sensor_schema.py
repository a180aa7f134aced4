"""What the tables of sensors and of the field in a scenario file may say."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from .sections import Finite, Latitude, Longitude, Noise, NonNegative, Positive, Section


class ImuSpec(Section):
    """``[imu]``: the inertial sensors."""

    period_s: Positive
    gyro_bias_deg_per_h: NonNegative
    gyro_noise_deg_per_sqrt_h: NonNegative
    accelerometer_bias_ug: NonNegative
    accelerometer_noise_ug_per_sqrt_hz: NonNegative
    biases: Literal["drawn", "fixed"] = "drawn"


class InitialErrorSpec(Section):
    """``[initial_error]``: standard deviation of the INS error per axis at the start."""

    position_m: Annotated[float, Field(gt=0.0, le=1e6)]
    velocity_mps: Annotated[float, Field(gt=0.0, le=1000.0)]
    attitude_arcmin: Annotated[float, Field(gt=0.0, le=600.0)]


class GradiometerSpec(Section):
    """``[gradiometer]``: noise (as RMS or as density), filter, and the treatment of the filter."""

    period_s: Positive
    noise_eotvos: Noise | None = None
    noise_density_eotvos_per_sqrt_hz: Noise | None = None
    components: Annotated[
        list[Literal["xx", "xy", "xz", "yy", "yz", "zz"]], Field(min_length=1)
    ] = ["xx", "xy", "xz", "yy", "yz", "zz"]
    filter: Literal["butterworth", "none"] = "none"
    filter_order: Annotated[int, Field(ge=1, le=12)] = 7
    filter_cutoff_hz: Positive = 0.2
    filter_treatment: Literal["whitened", "delayed"] = "whitened"
    whitening_regularization: Annotated[float, Field(ge=1e-7, le=0.1)] = 1e-6

    @model_validator(mode="after")
    def _check(self) -> GradiometerSpec:
        if (self.noise_eotvos is None) == (self.noise_density_eotvos_per_sqrt_hz is None):
            raise ValueError(
                "give exactly one of noise_eotvos (RMS) and noise_density_eotvos_per_sqrt_hz"
            )
        if len(set(self.components)) != len(self.components):
            raise ValueError("components names a component twice")
        nyquist = 0.5 / self.period_s
        if self.filter != "none" and self.filter_cutoff_hz >= nyquist:
            raise ValueError(
                f"filter_cutoff_hz is {self.filter_cutoff_hz:g} Hz and must lie below the Nyquist "
                f"frequency of the readings, {nyquist:g} Hz (period_s = {self.period_s:g}); "
                'use filter = "none" or read faster'
            )
        return self


class FieldSpec(Section):
    """``[field]``: the gradient map over the normal field, and what the accelerometers feel."""

    source: str
    south_deg: Latitude = 0.0
    north_deg: Latitude = 0.0
    west_deg: Longitude = 0.0
    east_deg: Longitude = 0.0
    lowest_m: Finite = 0.0
    highest_m: Finite = 0.0
    spacing_arcmin: Positive = 1.25
    height_spacing_m: Positive = 500.0
    land_correction: bool = True
    relief_smoothing_deg: Annotated[float, Field(ge=0.0, le=1.0, allow_inf_nan=False)] = 0.0
    gravity_disturbance: bool = False
