"""Simulation of runs: problems and truth from a flight and a seed.

A run adds random errors to a :class:`~.error_free_flight.Flight`. Each error source has a random
generator, spawned from seed and run index. Therefore two cases that differ in one source have the
same random numbers for all other sources. Sensors, prior and map exist twice, true and assumed, see
:mod:`ggbench.spec.sensors`.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..block import ProblemBlock, joined
from ..ins.error_model import GYRO_BIAS, STATES, navigation_errors
from ..ins.known_gravity import KnownGravity
from ..ins.strapdown import TRACK, navigate_lanes
from ..numerics.lanes import allocate, groups, in_lanes, out_of_lanes, unfilled
from ..problem import Problem
from ..sensors.aiding import Motion, corrected_motion
from .aiding_readings import aiding_readings
from .error_free_flight import Flight
from .flight_bounds import require_together
from .formulation import MechanizedRuns, SensorReadings, build_problems, propagate_errors
from .gradients import Gradients, gradients
from .random_streams import RandomStreams
from .replay import Recording, Replays


@dataclass(frozen=True)
class Truth:
    """Truth of a run or of a block of R runs, hidden from estimators.

    Attributes
    ----------
    times : (K,) measurement epochs [s].
    error_state : (K, n) or (R, K, n) true error states at the epochs, in the units of the states.
    """

    times: np.ndarray
    error_state: np.ndarray

    def __repr__(self) -> str:
        epochs, states = self.error_state.shape[-2:]
        return f"Truth({epochs} epochs of {states} states)"


def simulate(flight: Flight, seed: int, run: int) -> tuple[Problem, Truth]:
    """Simulate one run; return the estimation problem and the truth.

    Parameters
    ----------
    flight : error-free flight of the case.
    seed, run : seed of the campaign, and index of the run.
    """
    block, truth = simulate_block(flight, seed, [run])
    return block.problem(0), Truth(truth.times, truth.error_state[0])


def simulate_block(flight: Flight, seed: int, runs: Sequence[int]) -> tuple[ProblemBlock, Truth]:
    """Simulate several runs; return the estimation problems and the truth.

    The result of a run is equal, bit for bit, in every block.

    Parameters
    ----------
    flight : error-free flight of the case.
    seed, runs : seed of the campaign, and indices of R ≥ 1 runs.
    """
    return simulate_flights([flight] * len(runs), seed, runs)


def simulate_flights(
    flights: Sequence[Flight], seed: int, runs: Sequence[int]
) -> tuple[ProblemBlock, Truth]:
    """Simulate several runs as :func:`simulate_block` does, but with one flight for each run.

    All flights belong to one case.

    Raises
    ------
    ValueError
        If the flights differ in epochs or map.
    """
    first = flights[0]
    for flight in flights:
        require_together(first, flight)
    model, when = first.model, first.schedule
    streams = [
        RandomStreams(seed, run, flight.case.draw.name)
        for flight, run in zip(flights, runs, strict=True)
    ]
    parts = [slice(0, len(runs))]
    if any(flight is not first for flight in flights):
        parts = [slice(r, r + 1) for r in range(len(runs))]
    gradients_read = Gradients.joined(
        [gradients(flights[part.start], streams[part]) for part in parts]
    )
    ins = MechanizedRuns.empty(len(streams), len(when.times), model.dimension)
    imu_biases = np.empty((len(streams), len(when.times), 6))
    recordings: list[Recording] = []
    scratch = _Scratch.of(first)
    for some in groups(len(streams)):
        gravity = first.added_gravity(first.model_field, gradients_read.of_runs(some)[:2])
        imu_biases[some], recorded = _navigate(flights[some], streams[some], gravity, scratch)
        propagate_errors(model, when, gravity, scratch.track, scratch.increments, ins.of_runs(some))
        if not model.has_memory:
            recordings.append(recorded._replace(increments=recorded.increments.copy()))
    finished = []
    for part in parts:
        flight, of_part, of_sensors = (
            flights[part.start],
            ins.of_runs(part),
            gradients_read.of_runs(part),
        )
        read, states = _readings(flight, streams[part], of_sensors, of_part.motion)
        _add_states(flight, of_part, imu_biases[part], of_sensors, states)
        problems = build_problems(model, flight.model_field, when, of_part, read)
        finished.append((problems, states))
    blocks, truths = zip(*finished, strict=True)
    block = joined(blocks)
    if not model.has_memory:
        gravity = first.added_gravity(first.model_field)
        replays = Replays(model, first.model_field, when, gravity, recordings, len(runs))
        block = dataclasses.replace(block, replays=replays)
    return block, Truth(when.times, np.concatenate(truths))


def _add_states(
    flight: Flight,
    ins: MechanizedRuns,
    imu_biases: np.ndarray,
    gradients_read: Gradients,
    error_state: np.ndarray,
) -> None:
    """Fill the true states of INS, unknown gravity and gradiometer in ``error_state`` (R, K, n).

    The R runs share one flight. States of the aiding sensors are unchanged.
    """
    model = flight.model
    navigation_errors(ins.states, *flight.motion_at_epochs, error_state)
    error_state[:, :, GYRO_BIAS.start : STATES] = imu_biases
    if model.disturbance is not None:
        error_state[:, :, STATES : model.ins_state_count] = flight.unknown_to_a_map - ins.integrated
    for place, kind in model.states:
        if kind.name in gradients_read.states:
            error_state[:, :, place] = gradients_read.states[kind.name]


class Record(NamedTuple):
    """Sensor data of one run, and the initial INS state.

    Attributes
    ----------
    initial : (15,) initial INS position, velocity and the nine elements of C_nb, row by row.
    increments : (N, 6) IMU angle [rad] and velocity increments [m/s].
    heights : (N,) altimeter heights, means over the intervals [m]; (0,) without an altimeter.
    indicated : INS solution at the epochs, with arrays (1, K, ...).
    read : measurements of all other sensors.
    """

    initial: np.ndarray
    increments: np.ndarray
    heights: np.ndarray
    indicated: Motion
    read: SensorReadings


def record(flight: Flight, seed: int, run: int) -> Record:
    """Return the sensor data of a run, from which :func:`simulate` computes the run's problem.

    Parameters
    ----------
    flight : error-free flight of the case.
    seed, run : seed of the campaign, and index of the run.
    """
    streams = [RandomStreams(seed, run, flight.case.draw.name)]
    gradients_read = gradients(flight, streams)
    gravity = flight.added_gravity(flight.model_field, gradients_read[:2])
    scratch = _Scratch.of(flight)
    _, recorded = _navigate([flight], streams, gravity, scratch)
    track = scratch.track
    motion = Motion.of_states(out_of_lanes(track[flight.epochs], 1))
    read, _ = _readings(flight, streams, gradients_read, motion)
    increments, heights = recorded.increments[:, :, 0], recorded.heights[:, 0, 0]
    return Record(track[0, :, 0], increments, heights, motion, read)


def _readings(
    flight: Flight, streams: Sequence[RandomStreams], gradients_read: Gradients, ins: Motion
) -> tuple[SensorReadings, np.ndarray]:
    """Return the measurements of R runs, and the true states (R, K, n) of the aiding sensors."""
    measurements, present, states = aiding_readings(flight, streams, ins)
    return SensorReadings(
        gradients_read.output, gradients_read.missing, measurements, present
    ), states


class _Scratch(NamedTuple):
    """Arrays at the IMU samples, which each group of runs overwrites.

    Attributes
    ----------
    track : (N + 1, TRACK, LANES) INS solutions.
    increments : (N, 6, LANES) IMU increments with errors.
    noise : (LANES, 2, N, 3) standard normal numbers for angle and velocity increments.
    """

    track: np.ndarray
    increments: np.ndarray
    noise: np.ndarray

    @classmethod
    def of(cls, flight: Flight) -> _Scratch:
        """Return arrays without values for the samples of a flight."""
        count = len(flight.delta_angles)
        track, increments, noise = allocate((count + 1, TRACK), (count, 6), (count, 6))
        return cls(track, increments, noise.reshape(-1, 2, count, 3))


def _navigate(
    flights: Sequence[Flight],
    streams: Sequence[RandomStreams],
    gravity: KnownGravity,
    scratch: _Scratch,
) -> tuple[np.ndarray, Recording]:
    """Compute the INS solutions of a group of R runs; fill increments and track of ``scratch``.

    Returns
    -------
    True biases (R, K or 1, 6) of gyros and accelerometers, and the recorded input of the INSs.
    """
    true, increments = flights[0].true, scratch.increments
    biases = _inertial_readings(flights, streams, scratch.noise, increments)
    sigma = np.sqrt(np.diag(true.prior_cov)[:STATES])
    errors = [sigma * of_run["initial_error"].standard_normal((1, STATES)) for of_run in streams]
    starts = [Motion.of(flight.trajectory).at([0]) for flight in flights]
    initial = np.concatenate(
        [
            corrected_motion(start, -error).states
            for start, error in zip(starts, errors, strict=True)
        ]
    )
    heights, gains = _altimeter_readings(flights, streams)
    navigate_lanes(
        initial=in_lanes(initial[:, np.newaxis]),
        increments=increments,
        dt=flights[0].trajectory.dt,
        heights=heights,
        gains=gains,
        gravity=gravity,
        track=scratch.track,
    )
    return biases, Recording(initial, increments, heights, gains)


def _inertial_readings(
    flights: Sequence[Flight],
    streams: Sequence[RandomStreams],
    noise: np.ndarray,
    increments: np.ndarray,
) -> np.ndarray:
    """Fill the IMU increments (N, 6, LANES) with errors; return the biases (R, K or 1, 6).

    Biases are given at the K epochs, or once if they are constant. ``noise`` (LANES, 2, N, 3) is
    overwritten.
    """
    first = flights[0]
    imu, dt, count = first.true.imu, first.trajectory.dt, len(first.delta_angles)
    noise = noise[: len(streams)]
    exact, biases, same = [], [], all(flight is first for flight in flights)
    for run, (flight, of_run) in enumerate(zip(flights, streams, strict=True)):
        of_run["imu/"].standard_normal(out=noise[run])
        start = imu.draw_biases(of_run["imu/biases"])
        if imu.wanders:
            biases.append(np.hstack(imu.bias_histories(start, count, dt, of_run["imu/bias_walks"])))
        else:
            biases.append(np.concatenate(start)[np.newaxis])
        readings = flight.delta_angles, flight.delta_velocities
        if imu.distorts:
            exact.append(np.hstack(imu.distort(*readings, of_run["imu/errors"])))
        elif run == 0 or not same:
            exact.append(np.hstack(readings))
    histories = np.stack(biases)
    imu.measure(
        np.stack(exact), histories[:, 1:] if imu.wanders else histories, noise, dt, increments
    )
    return histories[:, first.epochs] if imu.wanders else histories


def _altimeter_readings(
    flights: Sequence[Flight], streams: Sequence[RandomStreams]
) -> tuple[np.ndarray, tuple[float, float]]:
    """Return the measured altimeter heights (N, 1, LANES) [m], and the gains of the damping.

    Without an altimeter there are no heights (0, 1, LANES), and the gains are zero.
    """
    if flights[0].true.altimeter is None:
        return unfilled(0, 1), (0.0, 0.0)
    gains, psd = flights[0].true.altimeter
    sigma = math.sqrt(psd / flights[0].trajectory.dt)
    heights = [
        flight.trajectory.mean_heights
        + sigma * of_run["altimeter/"].standard_normal(len(flight.delta_angles))
        for flight, of_run in zip(flights, streams, strict=True)
    ]
    return in_lanes(np.stack(heights)[:, :, np.newaxis]), gains
