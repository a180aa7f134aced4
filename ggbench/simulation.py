"""From a case and a seed to an estimation problem and its truth.

What does not depend on the run (truth, error-free IMU, map, noise-free readings, bound) is a
:class:`Flight`, made once per case and process; a run adds the random errors. The random streams
of a run are spawned from (seed, run) one per error source, so that two cases that differ in one
source share all the others.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from . import strapdown
from .bound import Bound, posterior_bound
from .field import Field
from .gradiometer import (
    Gradiometer,
    GradiometerModel,
    noise_rms,
    parse_components,
    readings,
)
from .imu import Imu
from .ins_error import (
    ACCELEROMETER_BIAS,
    ATTITUDE,
    GYRO_BIAS,
    POSITION,
    STATES,
    VELOCITY,
    delayed_position_rows,
    metres_per_radian,
    system_matrices,
    transitions,
)
from .lowpass import LowPass, prefilter
from .maps import MapRecipe, load_or_build, read
from .problem import Problem, StateBlock
from .schema import CaseSpec, FieldSpec, TrajectorySpec
from .trajectory import Segment, Trajectory, fly

STANDARD_GRAVITY = 9.80665
"""The g of accelerometer data sheets [m/s²]."""

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
    error_state : (K, 15) true INS error at the epochs, in the state's units.
    """

    times: np.ndarray
    error_state: np.ndarray


@dataclass(frozen=True)
class Flight:
    """All of a case that is the same in every run.

    Attributes
    ----------
    case : its specification.
    trajectory : truth at the INS rate.
    delta_angles, delta_velocities : (N, 3) error-free IMU increments.
    field : map and normal field.
    epochs : (K,) indices of the measurement epochs among the INS samples.
    noise_free : (K, 6) readings at the truth [E].
    """

    case: CaseSpec
    trajectory: Trajectory
    delta_angles: np.ndarray
    delta_velocities: np.ndarray
    field: Field
    epochs: np.ndarray
    noise_free: np.ndarray

    @property
    def times(self) -> np.ndarray:
        """Measurement epochs (K,) [s]."""
        return self.trajectory.times[self.epochs]

    @cached_property
    def imu(self) -> Imu:
        """The inertial sensors, in SI units."""
        spec = self.case.imu
        return Imu(
            gyro_bias=math.radians(spec.gyro_bias_deg_per_h) / 3600.0,
            accelerometer_bias=spec.accelerometer_bias_ug * 1e-6 * STANDARD_GRAVITY,
            gyro_root_psd=math.radians(spec.gyro_noise_deg_per_sqrt_h) / 60.0,
            accelerometer_root_psd=spec.accelerometer_noise_ug_per_sqrt_hz
            * 1e-6
            * STANDARD_GRAVITY,
            fixed_biases=spec.biases == "fixed",
        )

    @cached_property
    def gradiometer(self) -> Gradiometer:
        """The gradiometer."""
        spec = self.case.gradiometer
        rate = 1.0 / spec.period_s
        noise = spec.noise_eotvos
        if noise is None:
            assert spec.noise_density_eotvos_per_sqrt_hz is not None  # the scenario checks it
            noise = noise_rms(spec.noise_density_eotvos_per_sqrt_hz, rate)
        lowpass = None
        if spec.filter == "butterworth":
            lowpass = LowPass(spec.filter_order, spec.filter_cutoff_hz, rate)
        return Gradiometer(noise, lowpass, parse_components(spec.components))

    @cached_property
    def noise_cov(self) -> np.ndarray:
        """Covariance (m, m) of the measurement noise [E²]."""
        return self.gradiometer.noise_eotvos**2 * np.eye(len(self.gradiometer.components))

    @cached_property
    def prior_cov(self) -> np.ndarray:
        """Covariance (15, 15) of the INS error at the start, biases included."""
        initial = self.case.initial_error
        sigma = np.empty(STATES)
        sigma[POSITION] = initial.position_m
        sigma[VELOCITY] = initial.velocity_mps
        sigma[ATTITUDE] = math.radians(initial.attitude_arcmin / 60.0)
        # A sensor without bias leaves no freedom; a covariance must stay positive definite.
        sigma[GYRO_BIAS] = max(self.imu.gyro_bias, 1e-15)
        sigma[ACCELEROMETER_BIAS] = max(self.imu.accelerometer_bias, 1e-12)
        return np.diag(sigma**2)

    def transitions(
        self, matrices: np.ndarray, positions: np.ndarray, attitudes: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return Φ and Q (K, 15, 15) between the measurement epochs along an INS track."""
        return transitions(
            matrices, positions, attitudes, self.epochs, self.trajectory.dt,
            self.imu.accelerometer_root_psd**2, self.imu.gyro_root_psd**2,
        )  # fmt: skip

    @cached_property
    def bound(self) -> Bound:
        """Posterior Cramér–Rao bound of the unfiltered readings, H and Φ at the truth."""
        truth = self.trajectory
        matrices = system_matrices(
            truth.positions, truth.velocities, truth.attitudes, self.delta_velocities, truth.dt
        )
        transition, process_cov = self.transitions(matrices, truth.positions, truth.attitudes)
        rows = np.zeros((len(self.epochs), 3, STATES))
        rows[:, :, POSITION] = np.eye(3)
        at_epochs = truth.positions[self.epochs]
        model = GradiometerModel(
            self.field,
            Gradiometer(self.gradiometer.noise_eotvos, None, self.gradiometer.components),
            self.times,
            at_epochs,
            at_epochs,
            np.zeros(len(self.epochs)),
            rows,
            prefilter(None, len(self.epochs), "whitened", 0.0),
        )
        zero = np.zeros(STATES)
        jacobians = np.stack([model.jacobian(k, zero) for k in range(len(self.epochs))])
        return posterior_bound(transition, process_cov, self.prior_cov, jacobians, self.noise_cov)

    @cached_property
    def final_bound(self) -> float:
        """Bound [m] on the spherical position error at the last epoch, whatever the causality."""
        squared = float(np.trace(self.bound.filtering[-1, POSITION, POSITION]))
        vars(self).pop("bound")  # up to tens of MB, and a worker keeps the flights of all cases
        return math.sqrt(squared)


def make_field(spec: FieldSpec) -> Field:
    """Return the field of a scenario's ``[field]`` table.

    ``source`` is ``normal`` (no map), the path of a map's ``.npz`` file, or the name of a source
    from which the map is built, or taken from the cache.

    Raises
    ------
    MapError
        If the map cannot be made; the message says why and what is allowed.
    """
    if spec.source == "normal":
        return Field.normal()
    if spec.source.endswith(".npz"):
        return Field.from_map(read(Path(spec.source)))
    return Field.from_map(load_or_build(map_recipe(spec)))


def map_recipe(spec: FieldSpec) -> MapRecipe:
    """Return the recipe of the map that a ``[field]`` table with a named source describes."""
    return MapRecipe(
        source=spec.source,
        south_deg=spec.south_deg,
        north_deg=spec.north_deg,
        west_deg=spec.west_deg,
        east_deg=spec.east_deg,
        min_height_m=spec.lowest_m,
        max_height_m=spec.highest_m,
        spacing_arcmin=spec.spacing_arcmin,
        height_spacing_m=spec.height_spacing_m,
        land_correction=spec.land_correction,
        relief_smoothing_deg=spec.relief_smoothing_deg,
    )


def prepare(case: CaseSpec) -> Flight:
    """Fly the case without errors.

    Raises
    ------
    MapError, OutsideMapError
        If the map cannot be made, or the flight leaves it.
    """
    # A map of the user's own may be written anew while this process lives.
    own = Path(case.field.source)
    version = own.stat().st_mtime_ns if own.suffix == ".npz" and own.exists() else 0
    trajectory, delta_angles, delta_velocities, field = _error_free(
        case.trajectory.model_dump_json(), case.imu.period_s, case.field.model_dump_json(), version
    )
    stride = round(case.gradiometer.period_s / trajectory.dt)
    epochs = np.arange(stride, len(trajectory.times), stride)
    noise_free = readings(field, trajectory.positions[epochs], trajectory.times[epochs])
    return Flight(case, trajectory, delta_angles, delta_velocities, field, epochs, noise_free)


@lru_cache(maxsize=8)
def _error_free(
    trajectory_json: str, dt: float, field_json: str, version: int
) -> tuple[Trajectory, np.ndarray, np.ndarray, Field]:
    """Return what cases that differ in sensors and priors share: truth, IMU increments, field."""
    spec = TrajectorySpec.model_validate_json(trajectory_json)
    field_spec = FieldSpec.model_validate_json(field_json)
    trajectory = fly(
        position=np.array(
            [math.radians(spec.latitude_deg), math.radians(spec.longitude_deg), spec.height_m]
        ),
        speed=spec.speed_mps,
        heading=math.radians(spec.heading_deg),
        pitch=math.radians(spec.pitch_deg),
        roll=math.radians(spec.roll_deg),
        segments=[
            Segment(
                s.duration_s,
                math.radians(s.turn_rate_deg_per_s),
                s.acceleration_mps2,
                math.radians(s.climb_rate_deg_per_s),
            )
            for s in spec.segment
        ],
        dt=dt,
    )
    field = make_field(field_spec)
    disturbances = np.zeros((len(trajectory.times) - 1, 3))
    if field_spec.gravity_disturbance:
        middle = 0.5 * (trajectory.positions[1:] + trajectory.positions[:-1])
        disturbances = field.gravity_disturbance(*middle.T)
    delta_angles, delta_velocities = strapdown.error_free_increments(
        trajectory.positions,
        trajectory.velocities,
        trajectory.attitudes,
        disturbances,
        trajectory.dt,
    )
    return trajectory, delta_angles, delta_velocities, field


class RandomStreams(NamedTuple):
    """The generators of a run, one per source of error."""

    initial: np.random.Generator
    biases: np.random.Generator
    imu: np.random.Generator
    gradiometer: np.random.Generator


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
    truth, imu = flight.trajectory, flight.imu
    dt, epochs, times = truth.dt, flight.epochs, flight.times

    biases = imu.draw_biases(streams.biases)
    delta_angles, delta_velocities = imu.corrupt(
        flight.delta_angles, flight.delta_velocities, biases, dt, streams.imu
    )
    initial = np.sqrt(np.diag(flight.prior_cov)) * streams.initial.standard_normal(STATES)
    positions, velocities, attitudes = strapdown.navigate(
        *_perturbed(truth, initial), delta_angles, delta_velocities, dt
    )
    output = flight.gradiometer.output(flight.noise_free, streams.gradiometer)

    matrices = system_matrices(positions, velocities, attitudes, delta_velocities, dt)
    transition, process_cov = flight.transitions(matrices, positions, attitudes)
    spec = flight.case.gradiometer
    treatment = prefilter(
        flight.gradiometer.lowpass,
        len(epochs),
        spec.filter_treatment,
        spec.whitening_regularization,
    )
    delays = treatment.delay_samples * spec.period_s
    rows = delayed_position_rows(matrices, positions, epochs, delays, dt)
    delayed = np.stack(
        [np.interp(times - delays, truth.times, positions[:, axis]) for axis in range(3)], axis=-1
    )
    problem = Problem(
        times=times,
        measurements=treatment.apply(output),
        noise_cov=flight.noise_cov,
        transition=transition,
        process_cov=process_cov,
        prior_mean=np.zeros(STATES),
        prior_cov=flight.prior_cov,
        model=GradiometerModel(
            flight.field,
            flight.gradiometer,
            times,
            positions[epochs],
            delayed,
            delays,
            rows,
            treatment,
        ),
        layout=LAYOUT,
    )
    error_state = np.empty((len(epochs), STATES))
    for k, n in enumerate(epochs):
        error_state[k, :9] = _navigation_error(
            positions[n], velocities[n], attitudes[n],
            truth.positions[n], truth.velocities[n], truth.attitudes[n],
        )  # fmt: skip
    error_state[:, GYRO_BIAS], error_state[:, ACCELEROMETER_BIAS] = biases
    return problem, Truth(times, error_state)


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
