"""Simulated aiding sensors: their readings and their h."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ..gravity.field import DisturbanceMap
from ..ins.strapdown import steady_force
from ..sensors.aiding import AidingSensor, Barometer, Gravimeter, Motion, VelocityLog
from ..sensors.aiding_kernels import MOVED, Aiding
from ..sensors.gnss import FalsePositions, Gnss
from ..spec.aiding import (
    BarometerSpec,
    GnssSpec,
    GravimeterSpec,
    LogSpec,
    TrueGnss,
)
from ..spec.named_sensors import aiding_of
from ..spec.sensors import Side, TruthSpec
from .instruments import interruptions
from .random_streams import RandomStreams
from .sensor_suite import SensorSuite

if TYPE_CHECKING:
    from .error_free_flight import Flight


def on_board(side: Side, truth: TruthSpec | None) -> tuple[AidingSensor, ...]:
    """Return the sensors of one side of a case, in the order of their channels.

    Parameters
    ----------
    side : the tables.
    truth : dropouts and outliers of the true readings; None for the estimators' sensors.
    """
    nothing = TruthSpec()
    changes = aiding_of(truth or nothing)
    return tuple(
        _sensor(
            spec, changes.get(name, getattr(nothing, spec.kind)), "" if name == spec.kind else name
        )
        for name, spec in aiding_of(side).items()
    )


def _sensor(spec: Any, changes: Any, label: str) -> AidingSensor:
    if isinstance(spec, GnssSpec):
        position, velocity = spec.position_noise_m is not None, spec.velocity_noise_mps is not None
        noise, outliers = _of_gnss(spec, changes)
        return Gnss(
            spec.period_s, noise, spec.position_bias_m, spec.position_bias_time_s or math.inf,
            interruptions(changes, outliers), position, velocity, _false_positions(changes),
            spec.lever_arm_m, arm_sigma=spec.lever_arm_sigma_m, label=label,
        )  # fmt: skip
    bias_time = spec.bias_time_s or math.inf
    if isinstance(spec, LogSpec):
        return VelocityLog(
            spec.period_s, (spec.noise_mps,) * len(spec.components), spec.bias_mps, bias_time,
            interruptions(changes, (changes.outlier_mps,)),
            spec.components, spec.frame == "body", label=label,
        )  # fmt: skip
    if isinstance(spec, BarometerSpec):
        return Barometer(
            spec.period_s, (spec.noise_m,), spec.bias_m, bias_time,
            interruptions(changes, (changes.outlier_m,)), label=label,
        )  # fmt: skip
    assert isinstance(spec, GravimeterSpec)
    return Gravimeter(
        spec.period_s, (spec.noise_mgal,) * len(spec.components), spec.bias_mgal, bias_time,
        interruptions(changes, (changes.outlier_mgal,)),
        spec.components, steady_force=steady_force, label=label,
    )  # fmt: skip


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


def _false(
    true: Gnss, wrong: np.ndarray, times: np.ndarray, attitudes: np.ndarray, turning: np.ndarray
) -> np.ndarray:
    """Return errors (G, e) of a receiver that are the same in all runs.

    Velocities are corrected for the known lever arm by the gyros' rates, taken as exact. What one
    leaves that is ``wrong`` (3,) is C_nb (ω × Δl).
    """
    swept = np.einsum("kij,kj->ki", attitudes, np.cross(turning, wrong))
    parts = [true.errors.at(times)] * true.position + [swept] * true.velocity
    return np.concatenate(parts, axis=-1)


def _lasting(
    sensor: AidingSensor, times: np.ndarray, of_run: RandomStreams
) -> tuple[np.ndarray, np.ndarray]:
    """Return the errors of a run that last: of channels (K, e), and of the lever arm (3,) [m]."""
    drawn, arm = np.zeros((len(times), len(sensor.channels))), np.zeros(3)
    if sensor.biased:
        drawn[:, : sensor.biased] = sensor.biases(times, of_run.of_sensor(sensor.name, "biases"))
    if sensor.armed:
        arm = sensor.arm_sigma * of_run.of_sensor(sensor.name, "lever_arm").standard_normal(3)
    return drawn, arm


def _false_positions(changes: TrueGnss) -> FalsePositions:
    within = changes.jump_from_s, changes.jump_until_s or math.inf
    return FalsePositions(changes.ramp_mps, changes.ramp_from_s, changes.jump_m, within)


def aiding_readings(
    flight: Flight, streams: Sequence[RandomStreams], ins: Motion
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the readings of R runs, whose INSs indicate a motion (R, K, .) at the epochs.

    Returns
    -------
    measurements (R, K, e), of which some are no readings; which are (R, K, e); true states
    (R, K, n): biases and errors of lever arms that estimators have as states, and zeros.
    """
    true, times, truth = flight.true, flight.times, flight.motion_at_epochs
    runs, epochs = ins.positions.shape[:2]
    z = np.zeros((runs, epochs, len(true.aiding_biases)))
    present = np.zeros(z.shape, dtype=bool)
    states = np.zeros((runs, epochs, flight.model.dimension))
    for sensor, some, (known, biases, lever), at in zip(
        true.aiding, true.columns, flight.model.aiding_states, flight.aiding_epochs, strict=True
    ):
        now, turning, width = truth.at(at), flight.turning[at], len(sensor.channels)
        z[:, at, some] = sensor.exact(now, ins.at(at), flight.field)
        wrong, by_arm = np.zeros(3), sensor.by_arm(now, turning)
        if isinstance(sensor, Gnss) and isinstance(known, Gnss):
            wrong = np.array(sensor.lever) - np.array(known.lever)
            z[:, at, some] += _false(sensor, wrong, times[at], now.attitudes, turning)
        present[:, at, some] = True
        if sensor.name in flight.measured_errors:
            # Their biases are not known.
            errors = flight.measured_errors[sensor.name][:, np.newaxis]
            z[:, at, some] += np.nan_to_num(errors)
            present[:, at, some] = ~np.isnan(errors)
            continue
        for r, of_run in enumerate(streams):
            drawn, arm = _lasting(sensor, times, of_run)
            states[r, :, biases] = drawn[:, : known.biased]
            states[r, :, lever] = (wrong + arm)[: known.armed]
            noise = of_run.of_sensor(sensor.name).standard_normal((len(at), width))
            z[r, at, some] += drawn[at] + by_arm @ arm + np.array(sensor.noise) * noise
            if sensor.faults.outlier_share > 0.0:
                z[r, at, some] += sensor.faults.outliers(
                    times[at], width, of_run.of_sensor(sensor.name, "outliers")
                )
            lost = sensor.faults.in_dropouts(times[at])
            if sensor.faults.dropout_share > 0.0:
                lost = sensor.faults.missing(times[at], of_run.of_sensor(sensor.name, "dropouts"))
            present[r, at[lost], some] = False
    return z, present, states


def aiding_about(
    model: SensorSuite,
    weighed: DisturbanceMap,
    read_at: Sequence[np.ndarray],
    motion: Motion,
    turning: np.ndarray,
) -> tuple[Aiding, np.ndarray]:
    """Return h of the sensors about a motion (..., K, .), all readings there, and its offset.

    Parameters
    ----------
    model : sensors.
    weighed : the gravity of a map that they read.
    read_at : indices of the epochs at which each is read.
    motion : at the epochs.
    turning : (..., K, 3) angular rates about the body's axes there [rad/s].
    """
    epochs, total = motion.positions.shape[:-1], len(model.aiding_biases)
    offset, present = np.zeros((2, *epochs, total))
    rows = np.zeros((*epochs, total, MOVED))
    by_arm = np.zeros((*epochs, total if (model.aiding_arms >= 0).any() else 0, 3))
    for sensor, some, at in zip(model.aiding, model.columns, read_at, strict=True):
        now = motion.at(at)
        offset[..., at, some], rows[..., at, some, :] = sensor.about(now)
        if sensor.armed:
            by_arm[..., at, some, :] = sensor.by_arm(now, turning[..., at, :])
        present[..., at, some] = 1.0
    weights = np.concatenate([np.zeros((0, 3)), *(sensor.weights for sensor in model.aiding)])
    aiding = Aiding(
        rows, model.aiding_biases, model.aiding_arms, by_arm, weights, model.gravity_state,
        motion.positions, present, weighed,
    )  # fmt: skip
    return aiding, offset
