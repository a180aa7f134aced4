"""From a flight and a seed to an estimation problem and its truth.

A run adds random errors to a :class:`~.error_free_flight.Flight`. The random streams of a run are
spawned from (seed, run), one per error source, so that two cases that differ in one source share
all the others. What the truth has and what the estimators assume may differ: sensors, prior and
map each exist twice, see :mod:`ggbench.spec.sensors`.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..block import ProblemBlock
from ..gravity.ellipsoid import metres_per_radian
from ..ins.error_model import (
    ATTITUDE,
    GYRO_BIAS,
    STATES,
    VELOCITY,
    navigation_errors,
)
from ..ins.known_gravity import KnownGravity
from ..ins.strapdown import TRACK, navigate_lanes
from ..numerics.lanes import groups, in_lanes, out_of_lanes, together, unfilled
from ..numerics.rotations import rotation_matrix
from ..problem import Problem
from ..sensors.aiding import Motion
from ..sensors.gradiometer.faults import biases as gradiometer_biases
from ..sensors.gradiometer.instrument import Gradiometer, readings
from ..trajectory.truth import Trajectory
from .aiding import aiding_readings
from .error_free_flight import Flight, gradiometer_places
from .formulation import InsSolution, Readings, build_problems, motion_of, propagate_errors
from .random_streams import RandomStreams, random_streams
from .replay import Recording, Replays


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

    def __repr__(self) -> str:
        epochs, states = self.error_state.shape
        return f"Truth({epochs} epochs of {states} states)"


@dataclass(frozen=True)
class TruthBlock:
    """The truth behind a block of runs.

    Attributes
    ----------
    times : (K,) measurement epochs [s].
    error_state : (R, K, n) true INS errors at the epochs, in the state's units.
    """

    times: np.ndarray
    error_state: np.ndarray


def simulate(flight: Flight, seed: int, run: int) -> tuple[Problem, Truth]:
    """Return the estimation problem of one run, and the truth it hides.

    Parameters
    ----------
    flight : the case.
    seed, run : the campaign's seed and the run's number.
    """
    block, truth = simulate_block(flight, seed, [run])
    return block.problem(0), Truth(truth.times, truth.error_state[0])


def simulate_block(
    flight: Flight, seed: int, runs: Sequence[int]
) -> tuple[ProblemBlock, TruthBlock]:
    """Return the estimation problems of several runs, and the truth that they hide.

    A run is the same, bit by bit, in whatever block.

    Parameters
    ----------
    flight : the case.
    seed, runs : the campaign's seed and the numbers of R runs, at least one.
    """
    streams = [random_streams(seed, run) for run in runs]
    model, times, when = flight.model, flight.times, flight.schedule
    ins = InsSolution.empty(len(streams), len(times), model.dimension)
    imu_biases = np.empty((len(streams), len(times), 6))
    seen = _gradients(flight, streams)
    recordings: list[Recording] = []
    scratch = _Scratch.of(flight)
    for some in groups(len(streams)):
        gravity = flight.added_gravity(flight.model_field, seen.of_runs(some))
        imu_biases[some], recorded = _navigate(flight, streams[some], gravity, scratch)
        propagate_errors(model, when, gravity, scratch.track, scratch.increments, ins.of_runs(some))
        if not model.remembers:
            recordings.append(recorded._replace(increments=recorded.increments.copy()))
    read, states = _readings(flight, streams, seen, ins.motion)
    problems = build_problems(model, flight.model_field, when, ins, read)
    if not model.remembers:
        gravity = flight.added_gravity(flight.model_field)
        replays = Replays(model, flight.model_field, when, gravity, recordings, len(streams))
        problems = dataclasses.replace(problems, replays=replays)
    truth, epochs = flight.trajectory, flight.epochs
    error_state = np.empty((len(streams), len(times), model.dimension))
    navigation_errors(
        ins.states, truth.positions[epochs], truth.velocities[epochs], truth.attitudes[epochs],
        error_state,
    )  # fmt: skip
    error_state[:, :, GYRO_BIAS.start : STATES] = imu_biases
    if model.disturbance is not None:
        error_state[:, :, STATES : model.disturbed] = flight.unknown_to_a_map - ins.integrated
    first = model.dimension - states.shape[2]
    if model.mounting >= 0:
        error_state[:, :, model.mounting : model.mounting + 3] = seen.mounting[:, np.newaxis]
    if model.gradient_bias >= 0:
        error_state[:, :, model.gradient_bias : first] = seen.biases
    error_state[:, :, first:] = states
    return problems, TruthBlock(times, error_state)


class Record(NamedTuple):
    """What the sensors of one run deliver, and where its INS starts.

    Attributes
    ----------
    initial : (15,) position, velocity and C_nb, row by row, at which the INS starts.
    increments : (N, 6) angles [rad] and velocities [m/s] of the IMU.
    heights : (N,) of the altimeter, means over the intervals [m]; (0,) without one.
    indicated : what the INS makes of it at the epochs (1, K, .).
    read : what the other sensors deliver, of one run.
    """

    initial: np.ndarray
    increments: np.ndarray
    heights: np.ndarray
    indicated: Motion
    read: Readings


def record(flight: Flight, seed: int, run: int) -> Record:
    """Return what is recorded in a run: the same numbers of which :func:`simulate` makes its own.

    Parameters
    ----------
    flight : the case.
    seed, run : the campaign's seed and the run's number.
    """
    streams = [random_streams(seed, run)]
    seen = _gradients(flight, streams)
    gravity = flight.added_gravity(flight.model_field, seen.of_runs(slice(1)))
    scratch = _Scratch.of(flight)
    _, recorded = _navigate(flight, streams, gravity, scratch)
    track = scratch.track
    motion = motion_of(out_of_lanes(track[flight.epochs], 1))
    read, _ = _readings(flight, streams, seen, motion)
    increments, heights = recorded.increments[:, :, 0], recorded.heights[:, 0, 0]
    return Record(track[0, :, 0], increments, heights, motion, read)


class _Gradients(NamedTuple):
    """What the gradiometers of R runs deliver, whatever the INS indicates.

    Attributes
    ----------
    output : (R, G, g) [E].
    missing : (R, G).
    biases : (R, K, g) at all epochs [E].
    mounting : (R, 3) angles by which the mount is turned about its axes [rad].
    """

    output: np.ndarray
    missing: np.ndarray
    biases: np.ndarray
    mounting: np.ndarray

    def of_runs(self, some: slice) -> tuple[np.ndarray, np.ndarray]:
        """Return output and what is missing of some of the runs."""
        return self.output[some], self.missing[some]


def _gradients(flight: Flight, streams: Sequence[RandomStreams]) -> _Gradients:
    """Return what the gradiometers of R runs deliver; of no readings without one."""
    runs, width = len(streams), flight.model.gradients
    unknown, unturned = np.zeros((runs, len(flight.times), width)), np.zeros((runs, 3))
    if flight.measured is not None:
        # What was measured is the same in all runs; nothing is known of biases and of the mount.
        output = np.tile(np.nan_to_num(flight.measured), (runs, 1, 1))
        return _Gradients(output, np.tile(flight.absent, (runs, 1)), unknown, unturned)
    if flight.true.gradiometer is not None:
        output, biases, turned = _gradiometer_output(flight, flight.true.gradiometer, streams)
        return _Gradients(output, _missing(flight, streams), biases, turned)
    none = np.zeros((runs, 0), dtype=bool)
    return _Gradients(np.zeros((runs, 0, width)), none, unknown, unturned)


def _readings(
    flight: Flight, streams: Sequence[RandomStreams], seen: _Gradients, ins: Motion
) -> tuple[Readings, np.ndarray]:
    """Return what the sensors of R runs deliver, and their true states at all epochs.

    Of the sensors other than the gradiometer those that the model knows.
    """
    others = aiding_readings(
        flight.true.aiding, flight.model.aiding, flight.field, flight.times, flight.aiding_epochs,
        flight.motion_at_epochs, ins, flight.turning, streams, flight.measured_errors,
    )  # fmt: skip
    return Readings(seen.output, seen.missing, others.measurements, others.present), others.states


class _Scratch(NamedTuple):
    """Arrays at the IMU's samples, which each group of runs overwrites.

    Attributes
    ----------
    track : (N + 1, TRACK, LANES) what the INSs indicate.
    increments : (N, 6, LANES) of the IMUs.
    noise : (LANES, 2, N, 3) standard normal numbers, of angles and of velocities.
    """

    track: np.ndarray
    increments: np.ndarray
    noise: np.ndarray

    @classmethod
    def of(cls, flight: Flight) -> _Scratch:
        """Return arrays to be filled."""
        count = len(flight.delta_angles)
        track, increments, noise = together((count + 1, TRACK), (count, 6), (count, 6))
        return cls(track, increments, noise.reshape(-1, 2, count, 3))


def _navigate(
    flight: Flight, streams: Sequence[RandomStreams], gravity: KnownGravity, scratch: _Scratch
) -> tuple[np.ndarray, Recording]:
    """Navigate a group of runs at once; fills increments and track of the scratch.

    Returns
    -------
    The true biases (R, K or 1, 6) of gyros and accelerometers in the increments, and all that the
    INSs were given as a recording.
    """
    truth, true = flight.trajectory, flight.true
    increments = scratch.increments
    biases = _inertial_readings(flight, streams, scratch.noise, increments)
    sigma = np.sqrt(np.diag(true.prior_cov)[:STATES])
    initial = [_perturbed(truth, sigma * s.initial.standard_normal(STATES)) for s in streams]
    heights, gains = _altimeter_readings(flight, streams)
    navigate_lanes(
        in_lanes(np.stack(initial)[:, np.newaxis]), increments, truth.dt, heights, gains, gravity,
        scratch.track,
    )  # fmt: skip
    return biases, Recording(np.stack(initial), increments, heights, gains)


def _inertial_readings(
    flight: Flight, streams: Sequence[RandomStreams], noise: np.ndarray, increments: np.ndarray
) -> np.ndarray:
    """Fill the increments (N, 6, LANES) that the IMUs deliver; return the biases (R, K or 1, 6).

    The biases at the epochs, once if they are constant; ``noise`` (LANES, 2, N, 3) is overwritten.
    """
    imu, dt, count = flight.true.imu, flight.trajectory.dt, len(flight.delta_angles)
    noise = noise[: len(streams)]
    exact, biases = [], []
    for run, of_run in enumerate(streams):
        of_run.imu.standard_normal(out=noise[run])
        start = imu.draw_biases(of_run.biases)
        if imu.wanders:
            biases.append(np.hstack(imu.bias_histories(start, count, dt, of_run.bias_walks)))
        else:
            biases.append(np.concatenate(start)[np.newaxis])
        if imu.distorts:
            exact.append(
                np.hstack(
                    imu.distort(flight.delta_angles, flight.delta_velocities, of_run.imu_errors)
                )
            )
    if not imu.distorts:
        exact.append(np.hstack([flight.delta_angles, flight.delta_velocities]))
    histories = np.stack(biases)
    imu.measure(
        np.stack(exact), histories[:, 1:] if imu.wanders else histories, noise, dt, increments
    )
    return histories[:, flight.epochs] if imu.wanders else histories


def _altimeter_readings(
    flight: Flight, streams: Sequence[RandomStreams]
) -> tuple[np.ndarray, tuple[float, float]]:
    """Return the heights (N, 1, LANES) that damp the mechanization, and gains; none without."""
    truth = flight.trajectory
    if flight.true.altimeter is None:
        return unfilled(0, 1), (0.0, 0.0)
    gains, psd = flight.true.altimeter
    exact, sigma = truth.mean_heights, math.sqrt(psd / truth.dt)
    heights = [exact + sigma * s.altimeter.standard_normal(len(exact)) for s in streams]
    return in_lanes(np.stack(heights)[:, :, np.newaxis]), gains


def _gradiometer_output(
    flight: Flight, instrument: Gradiometer, streams: Sequence[RandomStreams]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return what the instruments deliver, biases at all epochs [E], and mounting angles [rad].

    (R, G, g) for G readings, before they drop out, (R, K, g), and (R, 3).
    """
    faults, at = flight.faults, flight.gradient_epochs
    times = flight.times[at]
    channels = instrument.channels
    undistorted = flight.noise_free @ channels.T
    output = np.empty((len(streams), len(times), len(channels)))
    biases = np.zeros((len(streams), len(flight.times), len(channels)))
    turned = np.zeros((len(streams), 3))
    for run, of_run in enumerate(streams):
        tensors, exact = flight.noise_free, undistorted
        if faults.clock > 0.0 or faults.jitter > 0.0:
            tensors = _mistimed(flight, of_run.timing)
        if faults.tilt > 0.0:
            tensors = faults.tilted(tensors, times, of_run.gradiometer_tilt)
        if tensors is not flight.noise_free:
            exact = tensors @ channels.T
        if instrument.mounting_sigma > 0.0:
            turned[run] = instrument.mounting_sigma * of_run.gradiometer_mounting.standard_normal(3)
        if faults.distorts or flight.disks is not None or turned[run].any():
            turned[run] += faults.mounting(of_run.gradiometer_errors)
            exact = faults.distort(tensors, channels, turned[run], of_run.gradiometer_errors)
        if flight.disks is not None:
            exact = exact + flight.disks.errors(
                instrument.components, tensors, *flight.motion, of_run.gradiometer_errors
            )
        if faults.scale_drift > 0.0:
            exact = exact * faults.drifted(times, len(channels), of_run.gradiometer_scale)
        if instrument.biased:
            biases[run] = gradiometer_biases(
                instrument, len(channels), flight.times, of_run.gradiometer_biases
            )
        noise = instrument.noise(len(times), of_run.gradiometer)
        if math.isfinite(faults.freedom):
            noise *= faults.tails(noise.shape, of_run.gradiometer_tails)
        noise *= flight.noise_growth[:, np.newaxis]
        output[run] = exact + biases[run, at] + noise
        if faults.outlier_share > 0.0:
            output[run] += faults.outliers(times, len(channels), of_run.outliers)
    if instrument.lowpass is not None:
        output = instrument.lowpass.apply(output)
    if instrument.noise_behind_filter > 0.0:
        for run, of_run in enumerate(streams):
            output[run] += instrument.noise_behind(len(times), of_run.behind_filter)
    return output, biases, turned


def _missing(flight: Flight, streams: Sequence[RandomStreams]) -> np.ndarray:
    """Return which readings (R, G) of the gradiometer drop out."""
    faults, times = flight.faults, flight.times[flight.gradient_epochs]
    if faults.dropout_share > 0.0:
        return np.stack([faults.missing(times, of_run.dropouts) for of_run in streams])
    return np.tile(faults.in_dropouts(times), (len(streams), 1))


def _mistimed(flight: Flight, rng: np.random.Generator) -> np.ndarray:
    """Return the tensors (G, 6) of readings that are taken at other times than they claim."""
    truth, faults, times = flight.trajectory, flight.faults, flight.times[flight.gradient_epochs]
    clock = faults.clock * rng.standard_normal()
    taken = times - flight.latency + faults.jitter * rng.standard_normal(len(times))
    taken = np.clip(taken, truth.times[0], truth.times[-1])
    positions, attitudes = truth.at(taken)
    places = gradiometer_places(flight.case, positions, attitudes)
    return readings(flight.field, places, taken + clock, attitudes, flight.instrument)


def _perturbed(truth: Trajectory, error: np.ndarray) -> np.ndarray:
    """Return the INS state (15,) at the start: truth plus a (15,) error state."""
    position = truth.positions[0].copy()
    north, east = metres_per_radian(position)
    position += np.array([error[1] / north, error[0] / east, error[2]])
    turn = np.empty((3, 3))
    rotation_matrix(-error[ATTITUDE], turn)
    velocity = truth.velocities[0] + error[VELOCITY]
    return np.concatenate([position, velocity, np.ravel(turn @ truth.attitudes[0])])
