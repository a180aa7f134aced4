"""Error-free flight of a case, shared by all of its runs."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..gravity.field import Field
from ..ins import strapdown
from ..ins.error_model import navigation_errors
from ..ins.known_gravity import KnownGravity
from ..sensors.aiding import Motion, corrected_positions, metres_of
from ..sensors.gradiometer.faults import Faults
from ..sensors.gradiometer.instrument import inertial_from_local, readings
from ..sensors.gradiometer.spinning_disks import SpinningDisks
from ..spec.aiding import GravimeterSpec
from ..spec.case import CaseSpec
from ..spec.trajectory import file_versions
from ..trajectory.truth import Trajectory
from .field_source import beside, make_field
from .formulation import MeasurementTimes, added_gravity, rates, require_short_delays
from .instruments import faults, spinning_disks
from .measured import measured_errors, measured_readings
from .sensor_suite import SensorSuite
from .suites import suite_of_case
from .true_motion import error_free_motion, require_within


@dataclass(frozen=True)
class Flight:
    """Error-free quantities of a case, which all runs share.

    Attributes
    ----------
    case : specification of the case.
    trajectory : true trajectory at the INS rate.
    delta_angles, delta_velocities : (N, 3) error-free IMU increments [rad], [m/s].
    field : map and normal field in which the truth flies.
    model_field : map and normal field that the estimators assume.
    epochs : (K,) indices of the INS samples at the measurement epochs of all sensors.
    noise_free : (G, 6) true gradient tensors [E] in the axes of the mount at the G times of the
        gradiometer.
    measured : (G, g) measured gradients [E] of the g channels at these times, NaN if missing; None
        if measurements are simulated.
    measured_errors : errors of measured gravity [mGal] relative to the true field, by name of the
        gravimeter: an element for each of its measurements, NaN if missing.
    """

    case: CaseSpec
    trajectory: Trajectory
    delta_angles: np.ndarray
    delta_velocities: np.ndarray
    field: Field
    model_field: Field
    epochs: np.ndarray
    noise_free: np.ndarray
    measured: np.ndarray | None = None
    measured_errors: Mapping[str, np.ndarray] = dataclasses.field(default_factory=dict)

    @property
    def times(self) -> np.ndarray:
        """Times (K,) of the measurement epochs [s]."""
        return self.trajectory.times[self.epochs]

    @cached_property
    def gradient_epochs(self) -> np.ndarray:
        """Indices (G,) of the epochs with gradiometer measurements; empty without a gradiometer."""
        return self._read_at("gradiometer")

    @cached_property
    def aiding_epochs(self) -> list[np.ndarray]:
        """For each aiding sensor, the indices (G,) of the epochs with measurements."""
        return [self._read_at(sensor.name) for sensor in self.true.aiding]

    def _read_at(self, sensor: str) -> np.ndarray:
        stride = self.case.strides.get(sensor)
        if stride is None:
            return np.zeros(0, dtype=int)
        return np.flatnonzero(self.epochs % stride == 0)

    @property
    def schedule(self) -> MeasurementTimes:
        """Measurement times of all sensors."""
        return MeasurementTimes(
            self.times, self.epochs, self.trajectory.dt, self.gradient_epochs, self.aiding_epochs
        )

    @property
    def instrument(self) -> str:
        """Mount of the gradiometer: ``platform``, ``local-level`` or ``strapdown``."""
        spec = self.case.gradiometer
        return "local-level" if spec is None else spec.instrument

    @property
    def latency(self) -> float:
        """Age of the gradiometer measurements at their time stamps [s]."""
        return 0.0 if self.true.gradiometer is None else self.true.gradiometer.latency

    @property
    def motion_at_epochs(self) -> Motion:
        """True position, velocity and attitude at the epochs."""
        return Motion.of(self.trajectory).at(self.epochs)

    @cached_property
    def true(self) -> SensorSuite:
        """True sensors, and true distribution of the initial INS errors."""
        return suite_of_case(self.case, "truth")

    @cached_property
    def model(self) -> SensorSuite:
        """Sensors and prior that estimators assume."""
        return suite_of_case(self.case, "model")

    @cached_property
    def turning(self) -> np.ndarray:
        """Angular rate (K, 3) [rad/s] of the body: mean of the IMU steps around an epoch."""
        return rates(self.delta_angles, self.epochs, self.trajectory.dt)

    @cached_property
    def metres(self) -> np.ndarray:
        """Metres per unit of latitude, longitude, height (K, 3) at the epochs [m/rad, m/rad, 1]."""
        return metres_of(self.motion_at_epochs.positions)[:, [1, 0, 2]]

    def added_gravity(
        self, field: Field, gradients: tuple[np.ndarray, np.ndarray] | None = None
    ) -> KnownGravity:
        """Return the gravity that the mechanizations of R runs add to normal gravity.

        ``gradients`` is a pair of arrays. The first array has the gradients (R, G, g) [E] to
        integrate, measured at G epochs in g channels. The second is the mask (R, G) of missing
        measurements. The default is a single run (R = 1) with error-free gradients. ``field`` is
        the field whose disturbance the INS compensates.
        """
        samples, count = self.epochs[self.gradient_epochs], len(self.trajectory.times)
        return added_gravity(
            self.model, field, samples, count, *(gradients or self.exact_gradients)
        )

    @cached_property
    def exact_gradients(self) -> tuple[np.ndarray, np.ndarray]:
        """Error-free gradiometer measurements (1, G, g) [E], and a mask that is all false."""
        exact = self.noise_free[np.newaxis]
        if self.model.gradiometer is not None:
            exact = exact @ self.model.gradiometer.channels.T
        return exact, np.zeros(exact.shape[:2], dtype=bool)

    @cached_property
    def unknown_gravity(self) -> np.ndarray:
        """True gravity disturbance (K, 3), ENU [m/s²], minus the part that the INS compensates.

        If the INS integrates gradients, the values belong to an error-free flight with noise-free
        measurements.
        """
        if not self.model.integrates:
            return self.unknown_to_a_map
        return self.unknown_to_a_map - self._without_errors[1]

    @cached_property
    def unknown_to_a_map(self) -> np.ndarray:
        """True gravity disturbance (K, 3), ENU [m/s²], minus the part that a map compensates.

        The compensated part is zero unless the INS adds the gravity disturbance of its map.
        """
        places = self.motion_at_epochs.positions.T
        disturbance = np.zeros((len(self.epochs), 3))
        if self.case.side("truth").field.gravity_disturbance:
            disturbance += self.field.gravity_disturbance(*places)
        if self.model.compensates:
            disturbance -= self.model_field.gravity_disturbance(*places)
        return disturbance

    @property
    def gravity_response(self) -> np.ndarray:
        """Errors (K, 9) of an INS that are caused by the uncompensated gravity disturbance alone.

        The columns are position ENU [m], velocity ENU [m/s], and attitude about the body axes
        [rad]: pitch, roll and heading (positive to the left).
        """
        return self._without_errors[0]

    @cached_property
    def _without_errors(self) -> tuple[np.ndarray, np.ndarray]:
        """INS errors of :attr:`gravity_response`, and the integrated gravity disturbance.

        The integrated disturbance (K, 3), ENU [m/s²], is zero unless the INS integrates gradients.
        """
        truth, gravity = self.trajectory, self.added_gravity(self.model_field)
        heights, gains = None, (0.0, 0.0)
        if self.true.altimeter is not None:
            heights, gains = truth.mean_heights, self.true.altimeter[0]
        track = strapdown.navigate(
            position=truth.positions[0],
            velocity=truth.velocities[0],
            c_nb=truth.attitudes[0],
            delta_angles=self.delta_angles,
            delta_velocities=self.delta_velocities,
            dt=truth.dt,
            heights=heights,
            gains=gains,
            gravity=gravity,
        )
        at, states = self.motion_at_epochs, Motion(*track).at(self.epochs).states
        errors = np.empty((1, len(states), 9))
        navigation_errors(states[np.newaxis], *at, errors)
        errors[0, :, 6:] = np.einsum("kji,kj->ki", at.attitudes, errors[0, :, 6:])
        added = np.zeros((len(states), 3))
        if self.model.integrates:
            added = gravity.readings.total[self.epochs, :, 0]
        return errors[0], added

    @cached_property
    def faults(self) -> Faults:
        """Errors of the gradiometer other than noise and biases."""
        return faults(self.case.truth.gradiometer)

    @cached_property
    def disks(self) -> SpinningDisks | None:
        """Disks of a rotating gradiometer; None unless their imperfections are simulated."""
        return spinning_disks(self.case)

    @cached_property
    def motion(self) -> tuple[np.ndarray, np.ndarray]:
        """Mean specific force [m/s²] and angular rate [rad/s] during measurements, in mount axes.

        Both arrays are (G, 3). A platform does not rotate in inertial space. The rotation of a
        local-level mount (Earth rate and transport rate, 1e-4 rad/s) is neglected.
        """
        truth, samples = self.trajectory, self.epochs[self.gradient_epochs]
        count = samples[0]
        force, rate = (
            increments[: samples[-1]].reshape(len(samples), count, 3).sum(axis=1)
            / (count * truth.dt)
            for increments in (self.delta_velocities, self.delta_angles)
        )
        if self.instrument == "strapdown":
            return force, rate
        force = np.einsum("kij,kj->ki", truth.attitudes[samples], force)
        if self.instrument == "platform":
            c_in = inertial_from_local(truth.positions[samples], truth.times[samples])
            force = np.einsum("kij,kj->ki", c_in, force)
        return force, np.zeros_like(force)

    @cached_property
    def noise_growth(self) -> np.ndarray:
        """Factor (G,) by which the motion of the body increases the gradiometer noise."""
        samples, dt = self.epochs[self.gradient_epochs], self.trajectory.dt
        squares = [
            (steps**2).sum(axis=1)[: samples[-1]].reshape(len(samples), -1).mean(axis=1) / dt**2
            for steps in (self.delta_angles, np.diff(self.trajectory.velocities, axis=0))
        ]
        return self.faults.growth(*np.sqrt(squares))

    @property
    def absent(self) -> np.ndarray:
        """Mask (G,) of gradiometer measurements that are missing in all runs."""
        if self.measured is not None:
            return np.asarray(np.isnan(self.measured).any(axis=1))
        return self.faults.in_dropouts(self.times[self.gradient_epochs])

    @property
    def ticks(self) -> np.ndarray:
        """Times (K,) of the epochs in ticks, the common time unit of all sensors of the case."""
        return np.asarray(np.round(self.times / self.case.tick_s).astype(int))

    @cached_property
    def expected(self) -> np.ndarray:
        """Expected share (K, m) of the runs in which each measurement is available."""
        true, times = self.true, self.times
        measurements = np.zeros((len(times), len(true.channels)))
        gradients, others = np.split(measurements, [true.gradients], axis=1)
        at = self.gradient_epochs
        gradients[at] = self.faults.expected_share(times[at])[:, np.newaxis]
        gradients[at[self.absent]] = 0.0
        for sensor, some, at in zip(true.aiding, true.columns, self.aiding_epochs, strict=True):
            others[at, some] = sensor.faults.expected_share(times[at])[:, np.newaxis]
        return measurements


def prepare(case: CaseSpec) -> Flight:
    """Compute the error-free flight of a case.

    Raises
    ------
    MapError, OutsideMapError, TrajectoryError
        If a map cannot be built, the flight leaves a map, or the flight cannot be flown.
    GGBenchError
        If the low-pass filter cannot be computed, or a time constant is shorter than the delay
        of measurements.
    """
    if case.trajectory.files():
        case.check_duration()
    true, model = case.side("truth"), case.side("model")
    field = make_field(true.field, case.truth.field.constant_disturbance_mgal)
    model_field = make_field(model.field)
    trajectory, delta_angles, delta_velocities = error_free_motion(
        case.trajectory,
        case.imu.period_s,
        file_versions(case.trajectory),
        field if true.field.gravity_disturbance else None,
    )
    start = float(trajectory.positions[0, 1])
    field, model_field = beside(field, start), beside(model_field, start)
    read_at = {
        sensor: np.arange(stride, len(trajectory.times), stride)
        for sensor, stride in case.strides.items()
    }
    epochs = functools.reduce(np.union1d, read_at.values())
    at = read_at.get("gradiometer", np.zeros(0, dtype=int))
    reading_times, attitudes = trajectory.times[at], trajectory.attitudes[at]
    positions, needed = trajectory.positions[at], epochs
    if true.gradiometer is not None and true.gradiometer.latency_s > 0.0:
        reading_times = np.maximum(reading_times - true.gradiometer.latency_s, 0.0)
        positions, attitudes = trajectory.at(reading_times)
    measured, there = measured_readings(case, positions), np.ones(len(at), dtype=bool)
    if measured is not None:
        # Where nothing was measured, as in a turn, no map is needed.
        there = ~np.isnan(measured).any(axis=1)
        if not any(isinstance(spec, GravimeterSpec) for spec in case.sensor.values()):
            needed = np.setdiff1d(epochs, at[~there])
    require_within((field, model_field), trajectory.positions[needed], case.trajectory)
    noise_free = np.zeros((len(at), 6))
    if case.gradiometer is not None:
        places = gradiometer_places(case, positions, attitudes)
        noise_free[there] = readings(
            field,
            places[there],
            reading_times[there],
            attitudes[there],
            case.gradiometer.instrument,
        )
        altimeter = math.inf if case.altimeter is None else case.altimeter.time_constant_s
        require_short_delays(suite_of_case(case, "model"), altimeter, len(at))
    errors = measured_errors(
        case, field, {sensor: trajectory.positions[at] for sensor, at in read_at.items()}
    )
    return Flight(
        case=case,
        trajectory=trajectory,
        delta_angles=delta_angles,
        delta_velocities=delta_velocities,
        field=field,
        model_field=model_field,
        epochs=epochs,
        noise_free=noise_free,
        measured=measured,
        measured_errors=errors,
    )


def gradiometer_places(case: CaseSpec, positions: np.ndarray, attitudes: np.ndarray) -> np.ndarray:
    """Return the true positions (K, 3) of a gradiometer with a lever-arm error.

    ``positions`` (K, 3) are the assumed positions of the gradiometer. ``attitudes`` (K, 3, 3) are
    the true rotation matrices C_nb from body axes to local axes.
    """
    error = case.truth.gradiometer.lever_arm_error_m
    if not any(error):
        return positions
    return corrected_positions(positions, -(attitudes @ np.array(error)))
