"""Sensor suite: true or assumed sensors and prior of a case in SI units."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from ..gravity.coloured_noise import Whitening
from ..gravity.field import DisturbanceMap, Field
from ..ins.delayed_rows import MOVED, delayed_rows_lanes
from ..ins.error_model import (
    ACCELEROMETER_BIAS,
    ATTITUDE,
    GYRO_BIAS,
    POSITION,
    VELOCITY,
    added_by,
)
from ..ins.imu import Imu
from ..ins.known_gravity import NO_MAP, NORMAL_GRAVITY, KnownGravity, receive_all
from ..ins.noise import Noise, noise_roots
from ..ins.system_matrix import DECAY, DISTANCE, STATES
from ..ins.transitions import transitions_lanes
from ..numerics.lanes import in_lanes
from ..problem import Channel, StateBlock
from ..sensors.aiding import AidingSensor, Motion
from ..sensors.gradiometer.instrument import Gradiometer
from ..sensors.gradiometer.lowpass import Prefilter, prefilter
from ..sensors.model import AidingChannels, aiding_channels
from ..sensors.states import PlacedStates, names_of, states_of
from ..spec.sensors import InitialErrorSpec
from .instruments import GravityState

_LAYOUT = (
    StateBlock("position error ENU", POSITION, "m"),
    StateBlock("velocity error ENU", VELOCITY, "m/s"),
    StateBlock("attitude error ENU", ATTITUDE, "rad"),
    StateBlock("gyro bias", GYRO_BIAS, "rad/s"),
    StateBlock("accelerometer bias", ACCELEROMETER_BIAS, "m/s²"),
)


class AidingStates(NamedTuple):
    """State indices of an aiding sensor's biases and lever-arm errors."""

    sensor: AidingSensor
    biases: slice
    arm: slice


@dataclass(frozen=True)
class SensorSuite:
    """True or assumed sensors and prior of a case.

    Attributes
    ----------
    imu : inertial sensors.
    gradiometer : gradiometer, or None.
    aiding : aiding sensors.
    initial_error : table with the standard deviations of the prior.
    altimeter : gains k₁ [1/s], k₂ [1/s²] and noise PSD [m²/Hz] of the altimeter, or None.
    disturbance : states of the unknown gravity disturbance, or None.
    compensates : whether the mechanization adds the gravity disturbance of its map.
    map_error : standard error of the map in each gradiometer channel [E]. Its square is added to
        the variance of the noise. If the tuple is empty, nothing is added.
    """

    imu: Imu
    gradiometer: Gradiometer | None
    aiding: tuple[AidingSensor, ...]
    initial_error: InitialErrorSpec
    altimeter: tuple[tuple[float, float], float] | None
    disturbance: GravityState | None = None
    compensates: bool = False
    map_error: tuple[float, ...] = ()

    def gravimeter_map(self, field: Field) -> DisturbanceMap:
        """Return the gravity map with which gravimeter measurements are predicted.

        If the gravity disturbance is a state and the INS does not compensate it by the map, the map
        is empty.
        """
        is_assumed = self.disturbance is None or self.compensates
        return field.disturbance_map if is_assumed else NO_MAP

    @property
    def integrates(self) -> bool:
        """Whether the mechanization integrates measured gradients."""
        return self.disturbance is not None and self.disturbance.walk is not None

    @property
    def has_memory(self) -> bool:
        """Whether measurements are filtered, late, whitened or integrated.

        They then depend on the earlier INS track, which feedback would change.
        """
        sensor = self.gradiometer
        return self.integrates or (
            sensor is not None
            and (sensor.lowpass is not None or sensor.colour is not None or sensor.latency > 0.0)
        )

    @property
    def gradients(self) -> int:
        """Number of the gradiometer's channels."""
        return 0 if self.gradiometer is None else len(self.gradiometer.components)

    @cached_property
    def channels(self) -> tuple[Channel, ...]:
        """Channels of the gradiometer, then those of the aiding sensors."""
        names = () if self.gradiometer is None else self.gradiometer.components
        gradients = (Channel(f"gradient {name}", "E", "gradiometer") for name in names)
        return (*gradients, *(channel for sensor in self.aiding for channel in sensor.channels))

    @cached_property
    def columns(self) -> list[slice]:
        """Channels of each aiding sensor, as slices that count from the first aiding channel."""
        ends = np.cumsum([0, *(len(sensor.channels) for sensor in self.aiding)]).tolist()
        return [slice(first, last) for first, last in itertools.pairwise(ends)]

    @cached_property
    def layout(self) -> tuple[StateBlock, ...]:
        """State blocks: INS errors, unknown gravity, mounting angles, biases and lever arms."""
        placed = (StateBlock(kind.name, place, kind.unit) for place, kind in self.states)
        return (*_LAYOUT, *placed)

    @cached_property
    def states(self) -> list[PlacedStates]:
        """Blocks of the sensor states, which follow the INS states."""
        sizes = () if self.disturbance is None else self.disturbance.sizes
        return states_of(self.gradiometer, self.aiding, sizes, STATES)

    def _place(self, name: str) -> slice:
        """Return the slice of the states in the block ``name``; empty if there is no such block."""
        return next((block.slice for block in self.layout if block.name == name), slice(0, 0))

    @cached_property
    def aiding_states(self) -> list[AidingStates]:
        """State indices of each aiding sensor; these states come last."""
        return [AidingStates(sensor, *map(self._place, names_of(sensor))) for sensor in self.aiding]

    @property
    def ins_state_count(self) -> int:
        """Number of INS states, including the gravity disturbance if it is a state."""
        return STATES if self.disturbance is None else STATES + 3

    @property
    def dimension(self) -> int:
        """Number n of states: 15 INS errors, gravity, mounting angles, biases and lever arms."""
        return int(self.layout[-1].slice.stop)

    @cached_property
    def noise_cov(self) -> np.ndarray:
        """Covariance (m, m) of the measurement noise in the problem.

        With a low-pass filter it is the covariance after :meth:`treatment`, and includes the noise
        behind the filter. With coloured noise it is the covariance after :meth:`whitening`.
        """
        variances: list[float] = []
        gradiometer = self.gradiometer
        if gradiometer is not None:
            variance = gradiometer.noise_eotvos**2
            if gradiometer.lowpass is None or gradiometer.treatment == "delayed":
                variance += gradiometer.noise_behind_filter**2
            errors = self.map_error or (0.0,) * self.gradients
            colour = gradiometer.colour
            own = [variance] * self.gradients if colour is None else [*colour.deviations**2]
            variances += [of + error**2 for of, error in zip(own, errors, strict=True)]
        variances += [sigma**2 for sensor in self.aiding for sigma in sensor.noise]
        return np.diag(variances)

    def treatment(self, count: int) -> Prefilter:
        """Return the treatment (whitening or delay) of ``count`` outputs of the low-pass filter.

        Raises
        ------
        GGBenchError
            If the low-pass filter cannot be computed.
        """
        sensor = self.gradiometer
        if sensor is None:
            return prefilter(None, count, "whitened", 0.0)
        behind = sensor.noise_behind_filter / sensor.noise_eotvos
        return prefilter(
            sensor.lowpass, count, sensor.treatment, max(behind, sensor.regularisation)
        )

    def whitening(self, times: np.ndarray, missing: np.ndarray) -> Whitening | None:
        """Return the whitening of coloured gradiometer noise, or None for white noise.

        Parameters
        ----------
        times : (G,) times of the measurements [s].
        missing : (G,) mask of missing measurements.
        """
        if self.gradiometer is None or self.gradiometer.colour is None:
            return None
        return self.gradiometer.colour.whitening(times, missing)

    @cached_property
    def prior_cov(self) -> np.ndarray:
        """Covariance (n, n) of all states at the start."""
        initial = self.initial_error
        sigma = np.empty(self.dimension)
        sigma[POSITION] = initial.position_m
        sigma[2] = initial.height_sigma_m
        sigma[VELOCITY] = initial.velocity_mps
        sigma[ATTITUDE] = math.radians(initial.attitude_arcmin / 60.0)
        sigma[ATTITUDE.stop - 1] = math.radians(initial.heading_sigma_arcmin / 60.0)
        # A sensor without bias leaves no freedom; a covariance must stay positive definite.
        sigma[GYRO_BIAS] = max(self.imu.gyro_bias, 1e-15)
        sigma[ACCELEROMETER_BIAS] = max(self.imu.accelerometer_bias, 1e-12)
        for place, kind in self.states:
            sigma[place] = kind.sigma
        return np.diag(sigma**2)

    def system(
        self,
        motion: Motion,
        delta_velocities: np.ndarray,
        epochs: np.ndarray,
        dt: float,
        gravity: KnownGravity = NORMAL_GRAVITY,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return transition matrices Φ and process-noise covariances Q along one track.

        Both arrays are (K, n, n), see :meth:`along`. They lead from one measurement epoch to the
        next.

        Parameters
        ----------
        motion : motion at the N + 1 IMU samples.
        delta_velocities : (N, 3) velocity increments [m/s].
        epochs : (K,) indices of the samples at the epochs.
        dt : interval of the samples [s].
        gravity : as in :meth:`along`.
        """
        systems = self.systems([motion], [delta_velocities], epochs, np.empty(0), dt, gravity)
        return systems[0][0], systems[1][0]

    def systems(
        self,
        motions: Sequence[Motion],
        delta_velocities: Sequence[np.ndarray],
        epochs: np.ndarray,
        delays: np.ndarray,
        dt: float,
        gravity: KnownGravity,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return ``transition``, ``process_cov`` and ``rows`` of :meth:`along` for a group of runs.

        Parameters
        ----------
        motions : motion at the N + 1 IMU samples, for each of R tracks.
        delta_velocities : velocity increments (N, 3) [m/s], for each of R tracks.
        epochs, delays, dt, gravity : as in :meth:`along`.
        """
        track = in_lanes(np.stack([motion.states for motion in motions]))
        if self.integrates:
            receive_all(gravity.readings, track)
        increments = in_lanes(
            np.stack([np.hstack([np.zeros_like(v), v]) for v in delta_velocities])
        )
        shape = len(motions), len(epochs)
        transition, process_cov = np.empty((2, *shape, self.dimension, self.dimension))
        rows = np.empty((*shape, 6, STATES))
        self.along(
            track=track,
            increments=increments,
            epochs=epochs,
            delays=delays,
            dt=dt,
            gravity=gravity,
            transition=transition,
            process_cov=process_cov,
            rows=rows,
        )
        return transition, process_cov, rows

    @cached_property
    def _constants(self) -> tuple[np.ndarray, Noise]:
        """Constant entries of the sensors in F, and process noise of the INS error model."""
        entries, noise = added_by(self.imu, self.altimeter)
        decaying = bool(entries[[DECAY, DECAY + 1]].any())
        if self.disturbance is None:
            return entries, noise_roots(noise, decaying)
        entries[DISTANCE] = -1.0 / self.disturbance.distance
        return entries, noise_roots(noise, decaying, self.disturbance.driven)

    def along(
        self,
        track: np.ndarray,
        increments: np.ndarray,
        epochs: np.ndarray,
        delays: np.ndarray,
        dt: float,
        gravity: KnownGravity,
        transition: np.ndarray,
        process_cov: np.ndarray,
        rows: np.ndarray,
    ) -> None:
        """Fill transition matrices Φ and process-noise covariances Q for a group of R runs.

        The runs occupy the first R lanes. A lane is an index of the last axis of ``track`` and
        ``increments``, of length LANES. ``rows`` is filled with matrices that propagate an error
        from an epoch back to the time of the delayed measurement.

        Parameters
        ----------
        track, increments : (N + 1, 15, LANES), (N, 6, LANES) INS solutions and IMU increments, from
            :func:`.strapdown.navigate_lanes`.
        epochs : (K,) indices of the samples at the epochs.
        delays : (K,) measurement delays [s]; (0,) if ``rows`` is not needed.
        dt : interval of the samples [s].
        gravity : gravity that the mechanization adds to normal gravity.
        transition, process_cov : (R, K, n, n) output, Φ and Q.
        rows : (R, K, 6, 15) output, see :func:`.delayed_rows.delayed_rows_lanes`.
        """
        constant, noise = self._constants
        transitions_lanes(
            track=track,
            increments=increments,
            epochs=epochs,
            dt=dt,
            constant=constant,
            gravity=gravity,
            noise=noise.over(dt),
            transition=transition,
            process_cov=process_cov,
        )
        if delays.any():
            delayed_rows_lanes(
                track=track,
                increments=increments,
                epochs=epochs,
                delays=delays,
                dt=dt,
                constant=constant,
                gravity=gravity,
                transition=transition,
                rows=rows,
            )
        else:
            rows[:] = np.eye(STATES)[list(MOVED)]
        self._add_sensor_states(epochs * dt, transition, process_cov)

    def _add_sensor_states(
        self, times: np.ndarray, transition: np.ndarray, process_cov: np.ndarray
    ) -> None:
        """Fill the rows and columns of sensor states in Φ and Q (R, K, n, n).

        ``times`` (K,) are the epochs [s].
        """
        first = self.ins_state_count
        transition[:, :, :first, first:] = transition[:, :, first:] = 0.0
        process_cov[:, :, :first, first:] = process_cov[:, :, first:] = 0.0
        for place, kind in self.states:
            if place.start >= first:
                own = np.arange(place.start, place.stop)
                transition[:, :, own, own] = kind.decay(times)[:, np.newaxis]
                process_cov[:, :, own, own] = kind.driven(times)[:, np.newaxis]

    def aiding_model(
        self, field: Field, read_at: Sequence[np.ndarray], motion: Motion, turning: np.ndarray
    ) -> AidingChannels:
        """Return the measurement equation of the aiding sensors (:func:`.aiding_channels`).

        Parameters
        ----------
        field : field with the map.
        read_at : indices (G,) of the epochs of each sensor.
        motion, turning : as in :func:`.aiding_channels`.
        """
        return aiding_channels(
            sensors=self.aiding,
            states=self.states,
            dimension=self.dimension,
            gravity=self.gravimeter_map(field),
            read_at=read_at,
            motion=motion,
            turning=turning,
        )
