"""Instruments in SI units, from the tables of a case or a recorded flight."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from ..errors import GGBenchError
from ..files.writing import sha256_of
from ..gravity.coloured_noise import ColouredNoiseError, VectorAutoregression, read_noise
from ..gravity.ellipsoid import EOTVOS
from ..ins.imu import Imu, SensorErrors
from ..sensors.aiding import MGAL
from ..sensors.gradiometer.faults import Faults
from ..sensors.gradiometer.instrument import Gradiometer, noise_rms, parse_components
from ..sensors.gradiometer.lowpass import LowPass
from ..sensors.gradiometer.rotating import RotatingGradiometer, channel_noise_eotvos
from ..sensors.gradiometer.spinning_disks import DISK_CHANNELS, SpinningDisks
from ..spec.aiding import Interruptions
from ..spec.case import CaseSpec
from ..spec.gradiometer import GradiometerSpec, TrueGradiometer
from ..spec.sensors import (
    DisturbanceSpec,
    ImuSpec,
    TrueImu,
)
from ..trajectory.terrain_following import terrain_path as shipped_or_own

STANDARD_GRAVITY = 9.80665
"""The g of accelerometer data sheets [m/s²]."""
_MICRO_G = 1e-6 * STANDARD_GRAVITY


class GravityState(NamedTuple):
    """States of the gravity disturbance that the INS does not compensate.

    Attributes
    ----------
    sizes : standard deviations ENU [m/s²].
    distance : correlation distance D [m].
    walk : root PSD per unit of speed [s⁻¹˙⁵] of the random walk that remains after integration of
        gradients. It is the measurement noise [s⁻²] times the square root of the measurement
        interval. None if gradients are not integrated.
    """

    sizes: tuple[float, float, float]
    distance: float
    walk: float | None = None

    @property
    def driven(self) -> tuple[float, ...]:
        """Process noise of these states, see :class:`ggbench.ins.noise.Noise`."""
        if self.walk is not None:
            return (self.walk,) * 3
        return tuple(math.sqrt(2.0) * size for size in self.sizes)


def imu_of(spec: ImuSpec, errors: TrueImu) -> Imu:
    """Return the inertial sensors that a table describes.

    ``errors`` contains scale-factor errors and misalignments, which have no states.
    """

    def triad(scale_factor_ppm: float, misalignment_arcmin: float) -> SensorErrors:
        return SensorErrors(1e-6 * scale_factor_ppm, math.radians(misalignment_arcmin / 60.0))

    return Imu(
        gyro_bias=math.radians(spec.gyro_bias_deg_per_h) / 3600.0,
        accelerometer_bias=spec.accelerometer_bias_ug * _MICRO_G,
        gyro_root_psd=math.radians(spec.gyro_noise_deg_per_sqrt_h) / 60.0,
        accelerometer_root_psd=spec.accelerometer_noise_ug_per_sqrt_hz * _MICRO_G,
        fixed_biases=spec.biases == "fixed",
        gyro_bias_time=spec.gyro_bias_time_s or math.inf,
        accelerometer_bias_time=spec.accelerometer_bias_time_s or math.inf,
        gyro_errors=triad(errors.gyro_scale_factor_ppm, errors.gyro_misalignment_arcmin),
        accelerometer_errors=triad(
            errors.accelerometer_scale_factor_ppm, errors.accelerometer_misalignment_arcmin
        ),
    )


def gradiometer_of(spec: GradiometerSpec) -> Gradiometer:
    """Return the gradiometer of a table.

    Raises
    ------
    GGBenchError
        If the coloured-noise model cannot be read, or has other channels or another period than the
        table.
    """
    rate, colour = 1.0 / spec.period_s, _colour(spec)
    noise = spec.noise_eotvos
    if spec.noise_density_eotvos_per_sqrt_hz is not None:
        noise = noise_rms(spec.noise_density_eotvos_per_sqrt_hz, rate)
    elif colour is not None:
        noise = colour.rms
    elif noise is None:
        assert spec.rotating is not None  # the scenario checks it
        assert spec.rotating.accelerometer_noise_ng_per_sqrt_hz is not None
        root_psd = 1e-3 * _MICRO_G * spec.rotating.accelerometer_noise_ng_per_sqrt_hz
        noise = channel_noise_eotvos(_disk(spec), root_psd)
    lowpass = None
    if spec.filter == "butterworth":
        lowpass = LowPass(spec.filter_order, spec.filter_cutoff_hz, rate)
    behind = spec.noise_behind_filter_eotvos
    if behind is None:
        whitened = lowpass is not None and spec.filter_treatment == "whitened"
        behind = spec.whitening_regularization * noise if whitened else 0.0
    return Gradiometer(
        noise_eotvos=noise,
        lowpass=lowpass,
        components=channel_names(spec),
        instrument=spec.instrument,
        bias_eotvos=spec.bias_eotvos,
        drift=spec.drift_eotvos_per_sqrt_h / 60.0,
        noise_behind_filter=behind,
        latency=spec.latency_s,
        period=spec.period_s,
        treatment=spec.filter_treatment,
        regularisation=spec.whitening_regularization,
        colour=colour,
        mounting_sigma=math.radians(spec.mounting_sigma_arcmin / 60.0),
    )


def noise_files(case: CaseSpec) -> Iterator[tuple[Path, str]]:
    """Yield path and SHA-256 of each coloured-noise model of a case, without duplicates.

    Raises
    ------
    ColouredNoiseError
        If a file cannot be read.
    """
    for name in noise_names(case):
        path = shipped_or_own(name)
        yield path, sha256_of(path, ColouredNoiseError)


def noise_names(case: CaseSpec) -> list[str]:
    """Return the names of the coloured-noise models of a case, without duplicates."""
    specs = [case.side(name).gradiometer for name in ("truth", "model")]
    names = dict.fromkeys(spec.coloured_noise for spec in specs if spec is not None)
    return list(filter(None, names))


def _colour(spec: GradiometerSpec) -> VectorAutoregression | None:
    """Return the coloured-noise model of a table, or None for white noise.

    Raises GGBenchError if channels or interval of the model differ from those of the table.
    """
    if spec.coloured_noise is None:
        return None
    colour, components = read_noise(shipped_or_own(spec.coloured_noise)), channel_names(spec)
    subject = f"the noise model {spec.coloured_noise}"
    if colour.components != components:
        raise GGBenchError(
            f"{subject} has components {', '.join(colour.components)}, but the gradiometer has "
            f"{', '.join(components)}: they must be equal and in the same order"
        )
    if abs(colour.interval - spec.period_s) > 1e-6 * spec.period_s:
        raise GGBenchError(
            f"{subject} has interval_s {colour.interval:g}, but gradiometer.period_s is "
            f"{spec.period_s:g}: they must be equal"
        )
    return colour


def channel_names(spec: GradiometerSpec) -> tuple[str, ...]:
    """Return the channel names of a gradiometer, in the standard order."""
    if spec.rotating is None:
        return parse_components(spec.components)
    return parse_components([name for a in spec.rotating.spin_axes for name in DISK_CHANNELS[a]])


def _disk(spec: GradiometerSpec) -> RotatingGradiometer:
    assert spec.rotating is not None
    return RotatingGradiometer(spec.rotating.baseline_m, spec.rotating.rotation_hz, spec.period_s)


def spinning_disks(case: CaseSpec) -> SpinningDisks | None:
    """Return the disks of a rotating gradiometer; None unless imperfections are simulated."""
    spec, errors = case.gradiometer, case.truth.gradiometer.rotating
    if spec is None or spec.rotating is None or errors is None:
        return None
    return SpinningDisks(
        instrument=_disk(spec),
        spin_axes=spec.rotating.spin_axes,
        scale_factor=1e-6 * errors.scale_factor_ppm,
        scale_factor_mismatch=1e-6 * errors.scale_factor_mismatch_ppm,
        baseline=1e-6 * errors.baseline_error_ppm,
        misalignment=math.radians(errors.misalignment_arcmin / 60.0),
        demodulation_phase=math.radians(errors.demodulation_phase_arcmin / 60.0),
        rotation_rate=1e-6 * errors.rotation_rate_error_ppm,
        vibration=errors.vibration_mps2,
    )


def interruptions(spec: Interruptions, outlier: float | tuple[float, ...]) -> Faults:
    """Return the dropouts and outliers of a sensor.

    ``outlier`` is the standard deviation of the outliers [unit of the channel].
    """
    return Faults(
        outlier_share=spec.outlier_share,
        outlier=outlier,
        dropout_share=spec.dropout_share,
        dropouts=tuple((start, end) for start, end in spec.dropouts_s),
        duty=(spec.duty_on_s, spec.duty_off_s),
    )


def faults(spec: TrueGradiometer) -> Faults:
    """Return the errors of the true gradiometer other than noise and biases."""
    return replace(
        interruptions(spec, spec.outlier_eotvos),
        scale_factor=1e-6 * spec.scale_factor_ppm,
        scale_drift=1e-6 * spec.scale_drift_ppm_per_sqrt_h / 60.0,
        misalignment=math.radians(spec.misalignment_arcmin / 60.0),
        mount=tuple(math.radians(angle / 60.0) for angle in spec.mounting_error_arcmin),
        tilt=math.radians(spec.tilt_arcmin / 60.0),
        tilt_time=spec.tilt_time_s or math.inf,
        doubling=(
            math.radians(spec.noise_doubles_at_deg_per_s or math.inf),
            spec.noise_doubles_at_mps2 or math.inf,
        ),
        freedom=spec.noise_freedom or math.inf,
        burst=spec.outlier_burst_s,
        together=spec.outlier_channels == "all",
        clock=spec.clock_error_s,
        jitter=spec.timing_jitter_s,
    )


def gravity_state(
    spec: DisturbanceSpec | None, gradiometer: Gradiometer | None
) -> GravityState | None:
    """Return the states of the unknown gravity disturbance, or None without ``spec``.

    Raise GGBenchError if gradients are to be integrated, but the gradiometer does not measure the
    whole tensor.
    """
    if spec is None:
        return None
    horizontal = spec.horizontal_mgal / MGAL
    vertical = horizontal if spec.vertical_mgal is None else spec.vertical_mgal / MGAL
    walk = None
    if spec.integrate_gradients:
        assert gradiometer is not None  # the specification checks it
        if not gradiometer.whole:
            raise GGBenchError(
                "disturbance.integrate_gradients needs channels that determine the whole tensor; "
                f"{', '.join(gradiometer.components)} do not"
            )
        walk = EOTVOS * gradiometer.noise_eotvos * math.sqrt(gradiometer.period)
    sizes = horizontal, horizontal, vertical
    return GravityState(sizes, 1e3 * (spec.distance_km or math.inf), walk)
