"""Simulated measurements of the aiding sensors."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..sensors.aiding import AidingSensor, Motion
from ..sensors.gnss import Gnss
from .error_free_flight import Flight
from .random_streams import RandomStreams


def aiding_readings(
    flight: Flight, streams: Sequence[RandomStreams], ins: Motion
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the measurements of the aiding sensors in R runs.

    ``ins`` is the INS solution at the epochs, with arrays (R, K, ...). ``streams`` has the random
    generators of each run.

    Returns
    -------
    Measurements (R, K, e) in the e channels of these sensors; mask (R, K, e) of the available
    measurements; array (R, K, n) of the n states of the problem. In this array the biases and
    lever-arm errors that are states have their true values. All other states are zero. The biases
    of a gravimeter with measured data are unknown, so they are zero, too.
    """
    true, times, truth = flight.true, flight.times, flight.motion_at_epochs
    runs, epochs = ins.positions.shape[:2]
    z = np.zeros((runs, epochs, sum(len(sensor.channels) for sensor in true.aiding)))
    present = np.zeros(z.shape, dtype=bool)
    states = np.zeros((runs, epochs, flight.model.dimension))
    for sensor, some, (assumed, biases, lever), at in zip(
        true.aiding, true.columns, flight.model.aiding_states, flight.aiding_epochs, strict=True
    ):
        now, turning, width = truth.at(at), flight.turning[at], len(sensor.channels)
        z[:, at, some] = sensor.exact(now, ins.at(at), flight.field)
        wrong, by_arm = np.zeros(3), sensor.by_arm(now, turning)
        if isinstance(sensor, Gnss) and isinstance(assumed, Gnss):
            wrong = np.array(sensor.lever) - np.array(assumed.lever)
            z[:, at, some] += _false(sensor, wrong, times[at], now.attitudes, turning)
        present[:, at, some] = True
        if sensor.name in flight.measured_errors:
            # Their biases are not known.
            errors = flight.measured_errors[sensor.name][:, np.newaxis]
            z[:, at, some] += np.nan_to_num(errors)
            present[:, at, some] = ~np.isnan(errors)
            continue
        for r, of_run in enumerate(streams):
            drawn, arm = persistent_errors(sensor, times, of_run)
            states[r, :, biases] = drawn[:, : assumed.biased]
            states[r, :, lever] = (wrong + arm)[: assumed.armed]
            noise = of_run[f"{sensor.name}/"].standard_normal((len(at), width))
            z[r, at, some] += drawn[at] + by_arm @ arm + np.array(sensor.noise) * noise
            if sensor.faults.outlier_share > 0.0:
                z[r, at, some] += sensor.faults.outliers(
                    times[at], width, of_run[f"{sensor.name}/outliers"]
                )
            missing = sensor.faults.in_dropouts(times[at])
            if sensor.faults.dropout_share > 0.0:
                missing = sensor.faults.missing(times[at], of_run[f"{sensor.name}/dropouts"])
            present[r, at[missing], some] = False
    return z, present, states


def _false(
    true: Gnss, wrong: np.ndarray, times: np.ndarray, attitudes: np.ndarray, turning: np.ndarray
) -> np.ndarray:
    """Return the errors (G, e) of a GNSS receiver that are equal in all runs.

    These are false positions, and velocity errors by the error Δl = ``wrong`` (3,) [m] of the
    assumed lever arm. Velocities are corrected for the assumed lever arm with exact angular rates
    ω, ``turning``. The remaining velocity error is C_nb (ω × Δl).
    """
    swept = np.einsum("kij,kj->ki", attitudes, np.cross(turning, wrong))
    parts = [true.errors.at(times)] * true.position + [swept] * true.velocity
    return np.concatenate(parts, axis=-1)


def persistent_errors(
    sensor: AidingSensor, times: np.ndarray, of_run: RandomStreams
) -> tuple[np.ndarray, np.ndarray]:
    """Return the errors of a sensor that persist during a run.

    These are the biases (K, e) of the sensor's e channels at the K ``times``, and the lever-arm
    error (3,) [m].
    """
    drawn, arm = np.zeros((len(times), len(sensor.channels))), np.zeros(3)
    if sensor.biased:
        drawn[:, : sensor.biased] = sensor.biases(times, of_run[f"{sensor.name}/biases"])
    if sensor.armed:
        arm = sensor.arm_sigma * of_run[f"{sensor.name}/lever_arm"].standard_normal(3)
    return drawn, arm
