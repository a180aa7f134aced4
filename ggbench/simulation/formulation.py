"""Estimation problems from INS solutions and sensor measurements.

Measurements come from a simulation or a recording. This module does not access the truth. In
shapes, TRACK = 15 is the number of values of one INS solution: position (3), velocity (3) and
attitude matrix C_nb (9). LANES is the number of runs that a kernel processes together.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..block import ProblemBlock
from ..errors import GGBenchError
from ..gravity.coloured_noise import Whitening
from ..gravity.field import Field
from ..ins.error_model import STATES
from ..ins.known_gravity import NORMAL_GRAVITY, KnownGravity, of_map, of_readings
from ..ins.strapdown import TRACK
from ..numerics.lanes import in_lanes, out_of_lanes
from ..numerics.rotations import between
from ..sensors.aiding import Motion
from ..sensors.model import AidingChannels, DelayedInsSolution, model_arrays
from ..sensors.model_arrays import ModelArrays
from .sensor_suite import SensorSuite


@dataclass(frozen=True)
class MeasurementTimes:
    """Measurement epochs, and the epochs at which each sensor measures.

    Attributes
    ----------
    times : (K,) epochs at which any sensor measures, since the start [s].
    samples : (K,) indices of the INS samples at the epochs.
    dt : interval of the INS samples [s].
    gradients : (G,) indices of the epochs with gradiometer measurements.
    aiding : indices of the epochs with measurements, for each aiding sensor.
    """

    times: np.ndarray
    samples: np.ndarray
    dt: float
    gradients: np.ndarray
    aiding: Sequence[np.ndarray]

    def between(self, first: int, last: int) -> MeasurementTimes:
        """Return the schedule of the epochs ``first`` to ``last``, both included.

        In the result the epoch ``first`` has the index 0. The INS sample at the epoch before
        ``first`` has the index 0, too. If ``first`` is 0, samples are counted from the start of the
        flight. ``times`` are unchanged.
        """
        start = 0 if first == 0 else int(self.samples[first - 1])
        epochs = slice(first, last + 1)

        def among(read: np.ndarray) -> np.ndarray:
            return read[(read >= first) & (read <= last)] - first

        return MeasurementTimes(
            self.times[epochs],
            self.samples[epochs] - start,
            self.dt,
            among(self.gradients),
            [among(read) for read in self.aiding],
        )

    def delays(self, model: SensorSuite) -> np.ndarray:
        """Return the delays (K,) [s] of gradiometer measurements behind their epochs.

        A delay is the sum of two parts. The first part is the latency. The second part is the delay
        by the low-pass filter that remains after the treatment of the filter's outputs
        (:meth:`.SensorSuite.treatment`). The sum is limited so that no measurement is earlier than
        the start.
        """
        delays, at = np.zeros(len(self.times)), self.gradients
        if (sensor := model.gradiometer) is not None:
            lag = model.treatment(len(at)).delay_samples * sensor.period + sensor.latency
            delays[at] = np.minimum(lag, self.times[at])
        return delays


class MechanizedRuns(NamedTuple):
    """INS solutions of R runs at the epochs, and transition matrices of the error states.

    Attributes
    ----------
    states : (R, K, 15) position, velocity and the nine elements of C_nb, row by row.
    delayed_positions, delayed_attitudes : (R, K, 3), (R, K, 3, 3) INS solution at the delayed
        measurement times.
    transition, process_cov : (R, K, n, n) assumed transition matrices Φ and process-noise
        covariances Q of the n states.
    rows : (R, K, 6, 15) B_k, which maps INS errors at an epoch to errors of position [m] and
        attitude [rad] at the delayed time.
    integrated : (R, K, 3) gravity disturbance ENU [m/s²] from integrated gradients.
    turning : (R, K, 3) measured angular rate about the body axes [rad/s].
    """

    states: np.ndarray
    delayed_positions: np.ndarray
    delayed_attitudes: np.ndarray
    transition: np.ndarray
    process_cov: np.ndarray
    rows: np.ndarray
    integrated: np.ndarray
    turning: np.ndarray

    @classmethod
    def empty(cls, runs: int, epochs: int, n: int) -> MechanizedRuns:
        """Allocate arrays without values in one piece of memory, which allows large pages."""
        shapes = ((TRACK,), (3,), (3, 3), (n, n), (n, n), (6, STATES), (3,), (3,))
        ends = np.cumsum([runs * epochs * math.prod(shape) for shape in shapes])
        pieces = np.split(np.empty(ends[-1]), ends[:-1])
        return cls(*(p.reshape(runs, epochs, *s) for p, s in zip(pieces, shapes, strict=True)))

    def of_runs(self, some: slice) -> MechanizedRuns:
        """Return the arrays of a slice of the runs."""
        return MechanizedRuns(*(array[some] for array in self))

    @property
    def motion(self) -> Motion:
        """INS solution at the epochs, with arrays (R, K, ...)."""
        return Motion.of_states(self.states)

    def delayed(self, delays: np.ndarray) -> DelayedInsSolution:
        """Return the INS solution at the measurement times of the gradiometer.

        These times precede the epochs by ``delays`` (K,) [s].
        """
        return DelayedInsSolution(delays, self.delayed_positions, self.delayed_attitudes, self.rows)


class SensorReadings(NamedTuple):
    """Measurements of the sensors of R runs.

    Attributes
    ----------
    gradients : (R, G, g) gradiometer measurements [E] at G epochs in g channels, filtered if there
        is a low-pass filter.
    missing : (R, G) mask of missing gradiometer measurements.
    others : (R, K, e) measurements of the aiding sensors, in the order of their e channels.
    present : (R, K, e) mask of available values in ``others``. Unavailable values may be any finite
        number.
    """

    gradients: np.ndarray
    missing: np.ndarray
    others: np.ndarray
    present: np.ndarray


def rates(angles: np.ndarray, samples: np.ndarray, dt: float) -> np.ndarray:
    """Return the angular rates (K, ...) [rad/s] at INS samples.

    Each rate is the mean over the IMU steps before and after the sample.

    ``angles`` (N, ...) are gyro increments [rad] at an interval of ``dt`` [s]. ``samples`` (K,) are
    the indices of the INS samples.
    """
    around = np.clip([samples - 1, samples], 0, len(angles) - 1)
    return np.asarray(angles[around].mean(axis=0) / dt)


def propagate_errors(
    model: SensorSuite,
    when: MeasurementTimes,
    gravity: KnownGravity,
    track: np.ndarray,
    increments: np.ndarray,
    out: MechanizedRuns,
) -> None:
    """Fill ``out`` with INS solutions and error transitions along the tracks of R runs.

    Parameters
    ----------
    model : assumed sensors and prior.
    when : measurement epochs.
    gravity : gravity that the mechanization adds to normal gravity.
    track : (N + 1, TRACK, LANES) INS solutions at the samples.
    increments : (N, 6, LANES) IMU increments between the samples.
    out : output for R runs.
    """
    runs, samples, dt = len(out.states), when.samples, when.dt
    delays = when.delays(model)
    out.states[:] = out_of_lanes(track[samples], runs)
    earlier = np.maximum(samples - delays / dt, 0.0)
    first = earlier.astype(int)
    share = earlier - first
    before, after = track[first], track[np.minimum(first + 1, len(track) - 1)]
    moved = share[:, np.newaxis, np.newaxis] * (after - before)[:, :3]
    out.delayed_positions[:] = out_of_lanes(before[:, :3] + moved, runs)
    shape = out.delayed_attitudes.shape
    out.delayed_attitudes[:] = out.states[:, :, 6:].reshape(shape)
    out.turning[:] = out_of_lanes(rates(increments[:, :3], samples, dt), runs)
    turns = model.gradiometer is not None and model.gradiometer.instrument == "strapdown"
    if turns and delays.any():
        start, end = (out_of_lanes(c[:, 6:], runs) for c in (before, after))
        turned = between(start.reshape(-1, 3, 3), end.reshape(-1, 3, 3), np.tile(share, runs))
        out.delayed_attitudes[:] = turned.reshape(shape)
    model.along(
        track=track,
        increments=increments,
        epochs=samples,
        delays=delays,
        dt=dt,
        gravity=gravity,
        transition=out.transition,
        process_cov=out.process_cov,
        rows=out.rows,
    )
    out.integrated[:] = 0.0
    if model.integrates:
        out.integrated[:] = out_of_lanes(gravity.readings.total[samples], runs)


def added_gravity(
    model: SensorSuite,
    field: Field,
    samples: np.ndarray,
    count: int,
    gradients: np.ndarray,
    missing: np.ndarray,
) -> KnownGravity:
    """Return the gravity that the mechanizations of a group of R runs add to normal gravity.

    Parameters
    ----------
    model : assumed sensors.
    field : field with the map of the disturbance, used only if the INS compensates by a map.
    samples : (G,) indices of the INS samples at the times of the gradiometer measurements.
    count : number of INS samples.
    gradients, missing : (R, G, g), (R, G) measurements and mask as in :class:`SensorReadings`, used
        only if gradients are integrated.
    """
    if not model.integrates:
        return of_map(field.disturbance_map) if model.compensates else NORMAL_GRAVITY
    assert model.gradiometer is not None  # the specification checks it
    tensors = model.gradiometer.tensors(gradients)
    tensors[missing] = np.nan
    return of_readings(in_lanes(tensors), samples, count)


def build_problems(
    model: SensorSuite,
    field: Field,
    when: MeasurementTimes,
    ins: MechanizedRuns,
    read: SensorReadings,
) -> ProblemBlock:
    """Return the estimation problems of R runs.

    Parameters
    ----------
    model : sensors and prior that the estimators assume.
    field : map that the estimators assume.
    when : measurement epochs.
    ins : INS solutions at the epochs.
    read : measurements of all sensors.
    """
    treatment, at, times = model.treatment(len(when.gradients)), when.gradients, when.times
    motion = ins.motion
    gradients = np.zeros((*ins.states.shape[:2], model.gradients))
    there = np.zeros(gradients.shape, dtype=bool)
    there[:, at] = ~read.missing[:, :, np.newaxis]
    output, whitening = treatment.apply(read.gradients), _whitening(model, times[at], read.missing)
    if whitening is not None:
        output = whitening.apply(output)
    # Zero where a reading is missing, as the model predicts it then, whatever the state.
    gradients[:, at] = np.where(there[:, at], output, 0.0)
    aiding = model.aiding_model(field, when.aiding, motion, ins.turning)
    if model.integrates:
        aiding.offset[:] += np.einsum("...ei,...i->...e", aiding.weights, ins.integrated)
    return ProblemBlock(
        times=times,
        measurements=np.concatenate([gradients, read.others * read.present], axis=2),
        noise_cov=model.noise_cov,
        transition=ins.transition,
        process_cov=ins.process_cov,
        prior_mean=np.zeros(model.dimension),
        prior_cov=model.prior_cov,
        model=arrays_along(
            model=model,
            field=field,
            when=when,
            ins=motion,
            delayed=ins.delayed(when.delays(model)),
            missing=read.missing,
            others=aiding.without(~read.present),
            whitening=whitening,
        ),
        layout=model.layout,
        present=np.concatenate([there, read.present], axis=2),
        channels=model.channels,
        tracks=ins.states,
        map=field,
    )


def arrays_along(
    model: SensorSuite,
    field: Field,
    when: MeasurementTimes,
    ins: Motion,
    delayed: DelayedInsSolution,
    missing: np.ndarray,
    others: AidingChannels,
    whitening: Whitening | None,
) -> ModelArrays:
    """Return the arrays of the measurement function h of a sensor suite.

    ``missing`` (..., G) is the mask of missing gradiometer measurements. For the result see
    :func:`.sensors.model.model_arrays`.
    """
    treatment = model.treatment(len(when.gradients))
    return model_arrays(
        field=field,
        gradiometer=model.gradiometer,
        times=when.times,
        ins=ins,
        taken=delayed,
        treatment=treatment,
        missing=missing,
        at=when.gradients,
        others=others,
        states=model.states,
        whitening=whitening,
    )


def _whitening(model: SensorSuite, times: np.ndarray, missing: np.ndarray) -> Whitening | None:
    """Return the whitening of coloured gradiometer noise in R runs, or None for white noise.

    ``missing`` (R, G) is the mask of missing measurements.

    Raises
    ------
    GGBenchError
        If the noise is coloured and the runs miss different measurements.
    """
    whitening = model.whitening(times, missing[0])
    if whitening is not None and (missing != missing[0]).any():
        raise GGBenchError(
            "coloured noise can be whitened only if all runs miss the same measurements"
        )
    return whitening


def require_short_delays(model: SensorSuite, altimeter: float, count: int) -> None:
    """Raise GGBenchError if a time constant is shorter than the delay of the gradiometer.

    The time constants are those of the altimeter damping and of the IMU biases. The delay comes
    from a low-pass filter or a latency. The measurement model propagates the state back over the
    delay (:mod:`.ins.delayed_rows`). In this direction a decaying error would grow by
    e^(delay / time constant). The process noise within the delay is neglected.

    Parameters
    ----------
    model : assumed sensors.
    altimeter : time constant of the altimeter damping [s]; ∞ without an altimeter.
    count : number of gradiometer measurements.
    """
    if model.gradiometer is None:
        return
    delay = model.gradiometer.period * float(model.treatment(count).delay_samples.max())
    what = "delay of the filtered measurements"
    remedy = "use a higher filter_cutoff_hz or a smaller period_s"
    if model.gradiometer.latency > 0.0:
        delay, what = model.gradiometer.latency, "latency of the measurements"
        remedy = "give latency_s only in [truth.gradiometer]"
    for name, time in (
        ("altimeter.time_constant_s", altimeter),
        ("imu.gyro_bias_time_s", model.imu.gyro_bias_time),
        ("imu.accelerometer_bias_time_s", model.imu.accelerometer_bias_time),
    ):
        if time < delay:
            raise GGBenchError(
                f"{name} is {time:g} s and must be at least the {what}, {delay:.3g} s; {remedy}"
            )
