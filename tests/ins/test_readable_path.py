"""The compiled, batched simulation beside one that a textbook's reader recognises, line by line."""

from __future__ import annotations

import math

import numpy as np
from oracles.normal_gravity import closed_form_gravity
from scipy.spatial.transform import Rotation

from ggbench.gravity import ellipsoid
from ggbench.simulation.random_streams import RandomStreams
from ggbench.simulation.runs import simulate_block

SEED, RUN = 11, 3


def turn(vector: np.ndarray) -> np.ndarray:
    return Rotation.from_rotvec(vector).as_matrix()


def frame_rates(position: np.ndarray, velocity: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """ω_ie and ω_en in local axes (Groves, eqs. 2.123 and 5.44)."""
    latitude, _, height = position
    meridian, prime_vertical = ellipsoid.radii_of_curvature(latitude)
    earth_rate = ellipsoid.ROTATION_RATE * np.array([0.0, math.cos(latitude), math.sin(latitude)])
    east = velocity[0] / (prime_vertical + height)
    return earth_rate, np.array(
        [-velocity[1] / (meridian + height), east, east * math.tan(latitude)]
    )


def position_rate(position: np.ndarray, velocity: np.ndarray) -> np.ndarray:
    latitude, _, height = position
    meridian, prime_vertical = ellipsoid.radii_of_curvature(latitude)
    return np.array(
        [
            velocity[1] / (meridian + height),
            velocity[0] / ((prime_vertical + height) * math.cos(latitude)),
            velocity[2],
        ]
    )


def velocity_rate(position: np.ndarray, velocity: np.ndarray, force: np.ndarray) -> np.ndarray:
    earth_rate, transport = frame_rates(position, velocity)
    gravity = [0.0, *closed_form_gravity(position[0], position[2])]
    return force - np.cross(2.0 * earth_rate + transport, velocity) + gravity


def navigate(position, velocity, c_nb, angles, velocities, dt):
    """Positions (N + 1, 3) of the mechanization, all rates at the midpoint."""
    track = [position]
    for angle, delta in zip(angles, velocities, strict=True):
        rates = sum(frame_rates(position, velocity))
        force = turn(-0.5 * dt * rates) @ c_nb @ turn(0.5 * angle) @ delta / dt
        middle = position + 0.5 * dt * position_rate(position, velocity)
        middle_velocity = velocity + 0.5 * dt * velocity_rate(position, velocity, force)
        c_nb = turn(-dt * sum(frame_rates(middle, middle_velocity))) @ c_nb @ turn(angle)
        after = velocity + dt * velocity_rate(middle, middle_velocity, force)
        mean = 0.5 * (velocity + after)
        position = position + dt * position_rate(
            position + 0.5 * dt * position_rate(position, mean), mean
        )
        velocity = after
        track.append(position)
    return np.array(track)


def test_an_ins_track_is_that_of_the_readable_mechanization(wang):
    """200 s at 20 Hz with all sensor errors, in a block of eight runs: the same to 1e-9 m."""
    dt, truth, imu = wang.trajectory.dt, wang.trajectory, wang.true.imu
    streams = RandomStreams(SEED, RUN)
    error = np.sqrt(np.diag(wang.true.prior_cov)) * streams["initial_error"].standard_normal(15)
    biases = streams["imu/biases"].standard_normal((2, 3))
    noise = [streams["imu/"].standard_normal(wang.delta_angles.shape) for _ in range(2)]
    angles = (
        wang.delta_angles
        + imu.gyro_bias * biases[0] * dt
        + imu.gyro_root_psd * math.sqrt(dt) * noise[0]
    )
    velocities = (
        wang.delta_velocities
        + imu.accelerometer_bias * biases[1] * dt
        + imu.accelerometer_root_psd * math.sqrt(dt) * noise[1]
    )
    north, east = ellipsoid.metres_per_radian(truth.positions[0])
    start = truth.positions[0] + [error[1] / north, error[0] / east, error[2]]
    track = navigate(
        start,
        truth.velocities[0] + error[3:6],
        turn(-error[6:9]) @ truth.attitudes[0],
        angles,
        velocities,
        dt,
    )
    _, found = simulate_block(wang, SEED, range(RUN - 2, RUN + 6))
    expected = []
    for indicated, true in zip(track[wang.epochs], truth.positions[wang.epochs], strict=True):
        north, east = ellipsoid.metres_per_radian(indicated)
        d = indicated - true
        expected.append([d[1] * east, d[0] * north, d[2]])
    errors = np.abs(found.error_state[2, :, :3] - expected).max(axis=0)
    # A metre of longitude is 2e-7 rad of 1.9: its last digit is worth 1e-9 m.
    assert errors.max() < 5e-9
    # Closed form and series of gravity differ by 1e-13 m/s², 2e-9 m of height after 200 s.
    assert errors[2] < 3e-9
