"""INS mechanization with feedback of an estimator's corrections.

The error model is linear about the INS solution. If an uncorrected INS has drifted far,
second-order errors exceed the sensor noise. If the INS is corrected every minute, they stay small.
The mechanization uses only measured IMU data, never the truth. In shapes, LANES is the number of
runs that a kernel processes together.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from ..gravity.field import Field
from ..ins.error_model import navigation_errors
from ..ins.known_gravity import KnownGravity
from ..ins.strapdown import TRACK, navigate_lanes
from ..numerics.lanes import in_lanes, lane_of, out_of_lanes, unfilled
from ..problem import Problem
from ..sensors.aiding import Motion, corrected_motion
from .formulation import (
    MeasurementTimes,
    MechanizedRuns,
    SensorReadings,
    build_problems,
    propagate_errors,
)
from .sensor_suite import SensorSuite

FED_BACK = 9
"""Number of states that reset the mechanization: position, velocity, attitude. Biases and gravity
are not fed back: they enter linearly and keep their error model.
"""


class Recording(NamedTuple):
    """IMU and altimeter data of a group of runs.

    Attributes
    ----------
    initial : (R, 15) initial INS states: position, velocity and C_nb.
    increments : (N, 6, LANES) angle [rad] and velocity increments [m/s].
    heights : (N, 1, LANES) altimeter heights, means over the intervals [m]; (0, 1, LANES) without
        an altimeter.
    gains : gains of the altimeter damping.
    """

    initial: np.ndarray
    increments: np.ndarray
    heights: np.ndarray
    gains: tuple[float, float]

    def of_run(self, run: int) -> Recording:
        """Return the data of one run, as a group with R = 1."""
        return Recording(
            self.initial[run : run + 1],
            in_lanes(out_of_lanes(self.increments, run + 1)[run:]),
            in_lanes(out_of_lanes(self.heights, run + 1)[run:]),
            self.gains,
        )


@dataclasses.dataclass(frozen=True, eq=False)
class Replay:
    """Inputs for running the INS mechanization of a run again from any epoch.

    Attributes
    ----------
    model, field, when, gravity : arguments of :func:`.formulation.propagate_errors` and
        :func:`.formulation.build_problems`.
    recording : data of the run, as a group with R = 1.
    """

    model: SensorSuite
    field: Field
    when: MeasurementTimes
    gravity: KnownGravity
    recording: Recording

    def start(self, problem: Problem) -> Loop:
        """Return the mechanization with feedback at the start of a problem, without corrections."""
        return Loop(self, problem)


@dataclasses.dataclass(frozen=True, eq=False)
class Replays(Sequence[Replay]):
    """Replays of the runs in a block, each created on demand.

    Attributes
    ----------
    model, field, when, gravity : attributes of every :class:`Replay`.
    recordings : data of each group of runs.
    runs : number of runs.
    """

    model: SensorSuite
    field: Field
    when: MeasurementTimes
    gravity: KnownGravity
    recordings: Sequence[Recording]
    runs: int

    def __len__(self) -> int:
        return self.runs

    def __getitem__(self, run: Any) -> Any:
        if not 0 <= run < self.runs:
            raise IndexError(f"there is no run {run} in a block of {self.runs}")
        group, lane = lane_of(run)
        recording = self.recordings[group].of_run(lane)
        return Replay(self.model, self.field, self.when, self.gravity, recording)


class Loop:
    """INS mechanization with feedback, in consecutive parts.

    Each part starts from the corrected INS state at the end of the part before.
    """

    def __init__(self, replay: Replay, problem: Problem) -> None:
        assert problem.track is not None
        track = problem.track
        self._replay, self._problem = replay, problem
        self._open = Motion.of(track)
        self._first, self._state = 0, replay.recording.initial[0]
        self._mean, self._cov = problem.prior_mean, problem.prior_cov
        self._part = problem

    def ahead(self, last: int) -> Problem:
        """Return the problem of the next part, which ends with the epoch ``last``.

        The part begins with the epoch after the last correction. The prior of the problem is the
        estimate at that correction.
        """
        replay, first = self._replay, self._first
        when, recording = replay.when, replay.recording
        start = 0 if first == 0 else int(when.samples[first - 1])
        ended = int(when.samples[last])
        increments = recording.increments[start:ended]
        track = unfilled(ended - start + 1, TRACK)
        navigate_lanes(
            initial=in_lanes(self._state.reshape(1, 1, TRACK)),
            increments=increments,
            dt=when.dt,
            heights=recording.heights[start:ended],
            gains=recording.gains,
            gravity=replay.gravity,
            track=track,
        )
        some = when.between(first, last)
        ins = MechanizedRuns.empty(1, last - first + 1, replay.model.dimension)
        propagate_errors(replay.model, some, replay.gravity, track, increments, ins)
        read = self._seen_from(ins.motion, some, slice(first, last + 1))
        block = build_problems(replay.model, replay.field, some, ins, read)
        noise = self._problem.noise_cov
        self._part = dataclasses.replace(
            block,
            prior_mean=self._mean,
            prior_cov=self._cov,
            noise_cov=noise if noise.ndim == 2 else noise[first : last + 1],
        ).problem(0)
        return self._part

    def _seen_from(self, ins: Motion, when: MeasurementTimes, epochs: slice) -> SensorReadings:
        """Return the measurements of a slice of epochs, relative to the INS track ``ins``.

        Measurements that do not depend on the INS solution are unchanged.
        """
        model, problem = self._replay.model, self._problem
        z, there = problem.measurements[np.newaxis, epochs], problem.present[np.newaxis, epochs]
        old = Motion(*(array[np.newaxis] for array in self._open.at(epochs)))
        others = z[..., model.gradients :].copy()
        for sensor, columns in zip(model.aiding, model.columns, strict=True):
            others[..., columns] = sensor.seen_from(others[..., columns], old, ins)
        gradients = z[:, when.gradients, : model.gradients]
        missing = np.logical_not(there[:, when.gradients, : model.gradients].all(axis=2))
        return SensorReadings(gradients, missing, others, there[..., model.gradients :])

    def correct(self, mean: np.ndarray, cov: np.ndarray) -> np.ndarray:
        """Reset the INS by the estimates of the latest part.

        Parameters
        ----------
        mean, cov : (K', n), (K', n, n) estimates at the K' epochs of the part.

        Returns
        -------
        The estimates (K', n) as errors of the INS without feedback, as in the original problem.
        """
        track = self._part.track
        assert track is not None
        corrected = corrected_motion(Motion.of(track), mean)
        epochs = slice(self._first, self._first + len(mean))
        states, errors = self._open.at(epochs).states, np.empty((1, len(mean), FED_BACK))
        navigation_errors(states[np.newaxis], *map(np.ascontiguousarray, corrected), errors)
        self._state = corrected.at(-1).states
        self._mean = mean[-1].copy()
        self._mean[:FED_BACK] = 0.0
        self._cov = cov[-1]
        self._first = epochs.stop
        return np.hstack([errors[0], mean[:, FED_BACK:]])
