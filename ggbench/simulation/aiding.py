"""Aiding sensors from the tables of a case."""

from __future__ import annotations

import math
from typing import Any

from ..ins.strapdown import steady_force
from ..sensors.aiding import AidingSensor, Barometer, Gravimeter, VelocityLog
from ..sensors.gnss import FalsePositions, Gnss
from ..spec.aiding import (
    BarometerSpec,
    GnssSpec,
    GravimeterSpec,
    LogSpec,
    TrueGnss,
    unchanged,
)
from ..spec.sensors import Side, TruthSpec
from .instruments import interruptions


def sensors_of_side(side: Side, truth: TruthSpec | None) -> tuple[AidingSensor, ...]:
    """Return the true or assumed aiding sensors of a case, in the order of the channels.

    Parameters
    ----------
    side : Side
        Tables of the truth (for true sensors) or of the model (for assumed sensors).
    truth : TruthSpec or None
        Dropouts and outliers of the true sensors; None for the assumed sensors.
    """
    changes = {} if truth is None else truth.sensor
    return tuple(
        _sensor(spec, changes.get(name, unchanged(spec.kind)), "" if name == spec.kind else name)
        for name, spec in side.sensor.items()
    )


def _sensor(spec: Any, changes: Any, label: str) -> AidingSensor:
    """Return the sensor of a table, with the dropouts and outliers of ``[truth]``."""
    if isinstance(spec, GnssSpec):
        noise, outliers = _of_gnss(spec, changes)
        return Gnss(
            period=spec.period_s,
            noise=noise,
            bias=spec.position_bias_m,
            bias_time=spec.position_bias_time_s or math.inf,
            faults=interruptions(changes, outliers),
            position=spec.position_noise_m is not None,
            velocity=spec.velocity_noise_mps is not None,
            errors=_false_positions(changes),
            lever=spec.lever_arm_m,
            arm_sigma=spec.lever_arm_sigma_m,
            label=label,
        )
    bias_time = spec.bias_time_s or math.inf
    if isinstance(spec, LogSpec):
        return VelocityLog(
            period=spec.period_s,
            noise=(spec.noise_mps,) * len(spec.components),
            bias=spec.bias_mps,
            bias_time=bias_time,
            faults=interruptions(changes, (changes.outlier_mps,)),
            components=spec.components,
            body=spec.frame == "body",
            label=label,
        )
    if isinstance(spec, BarometerSpec):
        return Barometer(
            period=spec.period_s,
            noise=(spec.noise_m,),
            bias=spec.bias_m,
            bias_time=bias_time,
            faults=interruptions(changes, (changes.outlier_m,)),
            label=label,
        )
    assert isinstance(spec, GravimeterSpec)
    return Gravimeter(
        period=spec.period_s,
        noise=(spec.noise_mgal,) * len(spec.components),
        bias=spec.bias_mgal,
        bias_time=bias_time,
        faults=interruptions(changes, (changes.outlier_mgal,)),
        components=spec.components,
        steady_force=steady_force,
        label=label,
    )


def _of_gnss(spec: GnssSpec, changes: TrueGnss) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return the noise and the size of outliers of each channel."""
    noise: list[float] = []
    outliers: list[float] = []
    if spec.position_noise_m is not None:
        noise += [spec.position_noise_m] * 2 + [spec.height_noise_m or spec.position_noise_m]
        outliers += [changes.outlier_m] * 3
    if spec.velocity_noise_mps is not None:
        noise += [spec.velocity_noise_mps] * 3
        outliers += [changes.outlier_mps] * 3
    return tuple(noise), tuple(outliers)


def _false_positions(changes: TrueGnss) -> FalsePositions:
    within = changes.jump_from_s, changes.jump_until_s or math.inf
    return FalsePositions(changes.ramp_mps, changes.ramp_from_s, changes.jump_m, within)
