"""Simulated aiding sensors: their readings and their h."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np

from ..gravity.field import DisturbanceMap, Field
from ..ins.strapdown import steady_force
from ..sensors.aiding import AidingSensor, Barometer, Gravimeter, Motion, VelocityLog
from ..sensors.aiding_kernels import MOVED, Aiding
from ..sensors.false_positions import FalsePositions
from ..sensors.gnss import Gnss
from ..sensors.gradiometer.faults import Faults
from ..spec.aiding import (
    BarometerSpec,
    GnssSpec,
    GravimeterSpec,
    Interruptions,
    LogSpec,
    TrueGnss,
)
from ..spec.named_sensors import aiding_of
from ..spec.sensors import Side, TruthSpec
from .random_streams import RandomStreams


def on_board(side: Side, truth: TruthSpec | None) -> tuple[AidingSensor, ...]:
    """Return the sensors of one side of a case, in the order of their channels.

    Parameters
    ----------
    side : the tables.
    truth : dropouts and outliers of the true readings; None for the estimators' sensors.
    """
    changes = {} if truth is None else aiding_of(truth)
    return tuple(
        _sensor(spec, changes.get(name), "" if name == spec.kind else name)
        for name, spec in aiding_of(side).items()
    )


def _sensor(spec: Any, changes: Interruptions | None, label: str) -> AidingSensor:
    if isinstance(spec, GnssSpec):
        position, velocity = spec.position_noise_m is not None, spec.velocity_noise_mps is not None
        noise, outliers = _of_gnss(spec, changes)
        return Gnss(
            spec.period_s, noise, spec.position_bias_m, spec.position_bias_time_s or math.inf,
            _faults(changes, *outliers), position, velocity, _false_positions(changes),
            spec.lever_arm_m, arm_sigma=spec.lever_arm_sigma_m, label=label,
        )  # fmt: skip
    bias_time = spec.bias_time_s or math.inf
    if isinstance(spec, LogSpec):
        return VelocityLog(
            spec.period_s, (spec.noise_mps,) * len(spec.components), spec.bias_mps, bias_time,
            _faults(changes, getattr(changes, "outlier_mps", 0.0)),
            spec.components, spec.frame == "body", label=label,
        )  # fmt: skip
    if isinstance(spec, BarometerSpec):
        return Barometer(
            spec.period_s, (spec.noise_m,), spec.bias_m, bias_time,
            _faults(changes, getattr(changes, "outlier_m", 0.0)), label=label,
        )  # fmt: skip
    assert isinstance(spec, GravimeterSpec)
    return Gravimeter(
        spec.period_s, (spec.noise_mgal,) * len(spec.components), spec.bias_mgal, bias_time,
        _faults(changes, getattr(changes, "outlier_mgal", 0.0)),
        spec.components, steady_force=steady_force, label=label,
    )  # fmt: skip


def _of_gnss(
    spec: GnssSpec, changes: Interruptions | None
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return the noise and the size of outliers of each channel."""
    noise: list[float] = []
    outliers: list[float] = []
    if spec.position_noise_m is not None:
        noise += [spec.position_noise_m] * 2 + [spec.height_noise_m or spec.position_noise_m]
        outliers += [getattr(changes, "outlier_m", 0.0)] * 3
    if spec.velocity_noise_mps is not None:
        noise += [spec.velocity_noise_mps] * 3
        outliers += [getattr(changes, "outlier_mps", 0.0)] * 3
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


def _false_positions(changes: Interruptions | None) -> FalsePositions:
    if not isinstance(changes, TrueGnss):
        return FalsePositions()
    within = changes.jump_from_s, changes.jump_until_s or math.inf
    return FalsePositions(changes.ramp_mps, changes.ramp_from_s, changes.jump_m, within)


def _faults(changes: Interruptions | None, *outliers: float) -> Faults:
    if changes is None:
        return Faults()
    return Faults(
        outlier_share=changes.outlier_share,
        outlier=outliers,
        dropout_share=changes.dropout_share,
        dropouts=tuple((start, end) for start, end in changes.dropouts_s),
        duty=(changes.duty_on_s, changes.duty_off_s),
    )


class AidingReadings(NamedTuple):
    """What the other sensors deliver in R runs.

    Attributes
    ----------
    measurements : (R, K, e); whatever ``present`` denies is no reading.
    present : (R, K, e).
    states : (R, K, b) true biases and errors of lever arms, those that estimators have as states.
    """

    measurements: np.ndarray
    present: np.ndarray
    states: np.ndarray


def aiding_readings(
    true: Sequence[AidingSensor],
    model: Sequence[AidingSensor],
    field: Field,
    times: np.ndarray,
    read_at: Sequence[np.ndarray],
    truth: Motion,
    ins: Motion,
    turning: np.ndarray,
    streams: Sequence[RandomStreams],
    measured: Mapping[str, np.ndarray],
) -> AidingReadings:
    """Return the readings of the sensors in R runs.

    Parameters
    ----------
    true, model : the sensors as they are and as the estimators know them.
    field : the true one.
    times : (K,) epochs [s].
    read_at : indices of the epochs at which each sensor is read.
    truth : true motion at the epochs (K, .).
    ins : what the INS of each run indicates (R, K, .).
    turning : (K, 3) true angular rate about the body's axes [rad/s].
    streams : the generators of the runs.
    measured : errors (G,) of the sensors whose readings were measured; NaN where one is missing.
        Their biases are not known.
    """
    runs, epochs = ins.positions.shape[:2]
    channels = sum(len(sensor.channels) for sensor in true)
    z, first, states = np.zeros((runs, epochs, channels)), 0, []
    present = np.zeros(z.shape, dtype=bool)
    for sensor, known, at in zip(true, model, read_at, strict=True):
        width = len(sensor.channels)
        some = slice(first, first + width)
        first += width
        z[:, at, some] = sensor.exact(_at(truth, at), _at(ins, at), field)
        wrong, by_arm = np.zeros(3), sensor.by_arm(_at(truth, at), turning[at])
        if isinstance(sensor, Gnss) and isinstance(known, Gnss):
            wrong = np.array(sensor.lever) - np.array(known.lever)
            z[:, at, some] += _false(sensor, wrong, times[at], truth.attitudes[at], turning[at])
        present[:, at, some] = True
        if sensor.name in measured:
            errors = measured[sensor.name][:, np.newaxis]
            z[:, at, some] += np.nan_to_num(errors)
            present[:, at, some] = ~np.isnan(errors)
            states += [np.zeros((epochs, known.biased))] * runs
            continue
        for r, of_run in enumerate(streams):
            drawn, arm = _lasting(sensor, times, of_run)
            off = np.tile(wrong + arm, (epochs, 1))
            states.append(np.hstack([drawn[:, : known.biased], off[:, : known.armed]]))
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
    return AidingReadings(z, present, _stacked(states, runs, epochs))


class OnBoard(Protocol):
    """The part of :class:`.sensor_suite.SensorSuite` that is used here."""

    @property
    def aiding(self) -> tuple[AidingSensor, ...]:
        """The sensors."""

    @property
    def aiding_biases(self) -> np.ndarray:
        """Which state is the bias of each channel (e,); −1 for none."""

    @property
    def aiding_arms(self) -> np.ndarray:
        """The first state of the lever arm of each channel (e,); −1 for none."""

    @property
    def gravity_state(self) -> int:
        """The first state of the gravity disturbance; −1 for none."""


def aiding_about(
    model: OnBoard,
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
    sensors = model.aiding
    epochs = motion.positions.shape[:-1]
    total, first = len(model.aiding_biases), 0
    offset, present = np.zeros((2, *epochs, total))
    rows = np.zeros((*epochs, total, MOVED))
    by_arm = np.zeros((*epochs, total if (model.aiding_arms >= 0).any() else 0, 3))
    for sensor, at in zip(sensors, read_at, strict=True):
        now = _at(motion, at)
        some = slice(first, first + len(sensor.channels))
        offset[..., at, some], rows[..., at, some, :] = sensor.about(now)
        if sensor.armed:
            by_arm[..., at, some, :] = sensor.by_arm(now, turning[..., at, :])
        present[..., at, some] = 1.0
        first = some.stop
    weights = np.concatenate([np.zeros((0, 3)), *(sensor.weights for sensor in sensors)])
    aiding = Aiding(
        rows, model.aiding_biases, model.aiding_arms, by_arm, weights, model.gravity_state,
        motion.positions, present, weighed,
    )  # fmt: skip
    return aiding, offset


def _at(motion: Motion, epochs: np.ndarray) -> Motion:
    """Return a motion (..., K, .) at some of the epochs."""
    return Motion(
        motion.positions[..., epochs, :], motion.velocities[..., epochs, :],
        motion.attitudes[..., epochs, :, :],
    )  # fmt: skip


def _stacked(states: list[np.ndarray], runs: int, epochs: int) -> np.ndarray:
    """Return the states (R, K, b) of sensors that were drawn sensor by sensor, run by run."""
    sensors = [np.stack(states[i : i + runs]) for i in range(0, len(states), runs)]
    return np.concatenate([np.zeros((runs, epochs, 0)), *sensors], axis=-1)
