"""From a flight and a seed to an estimation problem and its truth.

A run adds random errors to a :class:`~ggbench.flight.Flight`. The random streams of a run are
spawned from (seed, run), one per error source, so that two cases that differ in one source share
all the others. What the truth has and what the estimators are told may differ: sensors, prior and
map each exist twice, see :mod:`ggbench.sensor_schema`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from . import strapdown
from .flight import Flight as Flight
from .flight import prepare as prepare
from .gradiometer import readings
from .gradiometer_errors import biases as gradiometer_biases
from .ins_error import (
    ACCELEROMETER_BIAS,
    ATTITUDE,
    GYRO_BIAS,
    POSITION,
    STATES,
    VELOCITY,
    delayed_rows,
    metres_per_radian,
    system_matrices,
)
from .lowpass import prefilter
from .measurement_model import GradiometerModel, model_arrays
from .problem import Problem, StateBlock
from .trajectory import Trajectory

LAYOUT = (
    StateBlock("position error ENU", POSITION, "m"),
    StateBlock("velocity error ENU", VELOCITY, "m/s"),
    StateBlock("attitude error ENU", ATTITUDE, "rad"),
    StateBlock("gyro bias", GYRO_BIAS, "rad/s"),
    StateBlock("accelerometer bias", ACCELEROMETER_BIAS, "m/s²"),
)


@dataclass(frozen=True)
class Truth:
    """What the runner knows and no estimator may see.

    Attributes
    ----------
    times : (K,) measurement epochs [s].
    error_state : (K, n) true INS error at the epochs, in the state's units.
    """

    times: np.ndarray
    error_state: np.ndarray


class RandomStreams(NamedTuple):
    """The generators of a run, one per source of error; new sources come last."""

    initial: np.random.Generator
    biases: np.random.Generator
    imu: np.random.Generator
    gradiometer: np.random.Generator
    bias_walks: np.random.Generator
    imu_errors: np.random.Generator
    altimeter: np.random.Generator
    gradiometer_biases: np.random.Generator
    gradiometer_errors: np.random.Generator
    outliers: np.random.Generator
    dropouts: np.random.Generator
    timing: np.random.Generator


def random_streams(seed: int, run: int) -> RandomStreams:
    """Return the generators of a run, spawned from the campaign's seed and the run's number."""
    children = np.random.SeedSequence([seed, run]).spawn(len(RandomStreams._fields))
    return RandomStreams(*(np.random.default_rng(child) for child in children))


def simulate(flight: Flight, seed: int, run: int) -> tuple[Problem, Truth]:
    """Return the estimation problem of one run, and the truth it hides.

    Parameters
    ----------
    flight : the case. seed, run : the campaign's seed and the run's number.
    """
    streams = random_streams(seed, run)
    truth, true, model = flight.trajectory, flight.true, flight.model
    dt, epochs, times = truth.dt, flight.epochs, flight.times

    initial = np.sqrt(np.diag(true.prior_cov)[:STATES]) * streams.initial.standard_normal(STATES)
    delta_angles, delta_velocities, biases = _inertial_readings(flight, streams)
    positions, velocities, attitudes = strapdown.navigate(
        *_perturbed(truth, initial), delta_angles, delta_velocities, dt,
        *_altimeter_readings(flight, streams),
    )  # fmt: skip
    output, instrument_biases = _gradiometer_output(flight, streams)
    missing = flight.faults.missing(times, streams.dropouts)

    matrices, noise = model.complete(
        system_matrices(positions, velocities, attitudes, delta_velocities, dt)
    )
    transition, process_cov = model.system(matrices, noise, positions, epochs, dt)
    spec = flight.case.gradiometer
    treatment = prefilter(
        model.gradiometer.lowpass,
        len(epochs),
        spec.filter_treatment,
        spec.whitening_regularization,
    )
    delays = treatment.delay_samples * spec.period_s
    delayed = np.stack(
        [np.interp(times - delays, truth.times, positions[:, axis]) for axis in range(3)], axis=-1
    )
    measurements = treatment.apply(output)
    measurements[missing] = 0.0  # as the model predicts it then, whatever the state
    layout: tuple[StateBlock, ...] = LAYOUT
    if model.gradiometer.biased:
        layout = (*LAYOUT, StateBlock("gradiometer bias", slice(STATES, model.dimension), "E"))
    problem = Problem(
        times=times,
        measurements=measurements,
        noise_cov=model.noise_cov,
        transition=transition,
        process_cov=process_cov,
        prior_mean=np.zeros(model.dimension),
        prior_cov=model.prior_cov,
        model=GradiometerModel(
            model_arrays(
                flight.model_field,
                model.gradiometer,
                times,
                positions[epochs],
                attitudes[epochs],
                delayed,
                _delayed_attitudes(flight, delays, attitudes),
                delays,
                delayed_rows(matrices, positions, epochs, delays, dt),
                treatment,
                missing,
            )
        ),
        layout=layout,
    )
    error_state = np.empty((len(epochs), model.dimension))
    for k, n in enumerate(epochs):
        error_state[k, :9] = _navigation_error(
            positions[n], velocities[n], attitudes[n],
            truth.positions[n], truth.velocities[n], truth.attitudes[n],
        )  # fmt: skip
    error_state[:, GYRO_BIAS], error_state[:, ACCELEROMETER_BIAS] = (b[epochs] for b in biases)
    if model.gradiometer.biased:
        error_state[:, STATES:] = instrument_biases
    return problem, Truth(times, error_state)


def _inertial_readings(
    flight: Flight, streams: RandomStreams
) -> tuple[np.ndarray, np.ndarray, tuple[np.ndarray, np.ndarray]]:
    """Return the increments (N, 3) that the IMU delivers, and the biases (N + 1, 3) in them."""
    imu, dt = flight.true.imu, flight.trajectory.dt
    start = imu.draw_biases(streams.biases)
    biases = imu.bias_histories(start, len(flight.delta_angles), dt, streams.bias_walks)
    exact = imu.distort(flight.delta_angles, flight.delta_velocities, streams.imu_errors)
    return (*imu.corrupt(*exact, (biases[0][1:], biases[1][1:]), dt, streams.imu), biases)


def _altimeter_readings(
    flight: Flight, streams: RandomStreams
) -> tuple[np.ndarray | None, tuple[float, float]]:
    """Return the heights (N,) that damp the mechanization, None without an altimeter, and gains."""
    truth = flight.trajectory
    if flight.true.altimeter is None:
        return None, (0.0, 0.0)
    gains, psd = flight.true.altimeter
    noise = math.sqrt(psd / truth.dt) * streams.altimeter.standard_normal(len(truth.times) - 1)
    return truth.positions[1:, 2] + noise, gains


def _gradiometer_output(flight: Flight, streams: RandomStreams) -> tuple[np.ndarray, np.ndarray]:
    """Return what the instrument delivers (K, m), before readings drop out, and its biases [E]."""
    instrument, faults, times = flight.true.gradiometer, flight.faults, flight.times
    tensors = flight.noise_free
    if faults.clock > 0.0 or faults.jitter > 0.0:
        tensors = _mistimed(flight, streams.timing)
    exact = faults.distort(tensors, instrument.channels, streams.gradiometer_errors)
    if flight.disks is not None:
        exact = exact + flight.disks.errors(
            instrument.components, tensors, *flight.motion, streams.gradiometer_errors
        )
    biases = gradiometer_biases(instrument, exact.shape[1], times, streams.gradiometer_biases)
    output = exact + biases + instrument.noise(len(times), streams.gradiometer)
    output += faults.outliers(output.shape, streams.outliers)
    if instrument.lowpass is not None:
        output = instrument.lowpass.apply(output)
    return output, biases


def _mistimed(flight: Flight, rng: np.random.Generator) -> np.ndarray:
    """Return the tensors (K, 6) of readings that are taken at other times than they claim."""
    truth, faults = flight.trajectory, flight.faults
    clock = faults.clock * rng.standard_normal()
    taken = flight.times + faults.jitter * rng.standard_normal(len(flight.times))
    taken = np.clip(taken, truth.times[0], truth.times[-1])
    positions = np.stack(
        [np.interp(taken, truth.times, truth.positions[:, axis]) for axis in range(3)], axis=-1
    )
    return readings(
        flight.field, positions, taken + clock, _attitudes_at(taken, truth.times, truth.attitudes),
        flight.case.gradiometer.instrument,
    )  # fmt: skip


def _delayed_attitudes(flight: Flight, delays: np.ndarray, attitudes: np.ndarray) -> np.ndarray:
    """Return the INS attitudes (K, 3, 3) that readings delayed by (K,) seconds are set beside."""
    if flight.model.gradiometer.instrument != "strapdown" or not delays.any():
        return attitudes[flight.epochs]
    return _attitudes_at(flight.times - delays, flight.trajectory.times, attitudes)


def _attitudes_at(times: np.ndarray, samples: np.ndarray, attitudes: np.ndarray) -> np.ndarray:
    """Return C_nb (K, 3, 3) at times between samples, by the shortest rotation."""
    from scipy.spatial.transform import Rotation, Slerp  # not at the top: rarely used, loads slowly

    turning = Slerp(samples, Rotation.from_matrix(attitudes))
    return np.asarray(turning(np.clip(times, samples[0], samples[-1])).as_matrix())


def _perturbed(truth: Trajectory, error: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the INS state at the start: truth plus a (15,) error state."""
    position = truth.positions[0].copy()
    north, east = metres_per_radian(position)
    position += np.array([error[1] / north, error[0] / east, error[2]])
    turn = np.empty((3, 3))
    strapdown.rotation_matrix(-error[ATTITUDE], turn)
    return position, truth.velocities[0] + error[VELOCITY], turn @ truth.attitudes[0]


def _navigation_error(
    position: np.ndarray,
    velocity: np.ndarray,
    c_nb: np.ndarray,
    true_position: np.ndarray,
    true_velocity: np.ndarray,
    true_c_nb: np.ndarray,
) -> np.ndarray:
    """Return the (9,) position [m], velocity [m/s] and attitude [rad] error of the INS."""
    error = np.empty(9)
    north, east = metres_per_radian(position)
    difference = position - true_position
    error[POSITION] = difference[1] * east, difference[0] * north, difference[2]
    error[VELOCITY] = velocity - true_velocity
    strapdown.rotation_vector(true_c_nb @ c_nb.T, error[ATTITUDE])
    return error
