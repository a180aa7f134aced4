"""The mechanization: conventions, the inverse, closure, and the laws of motion it integrates."""

from __future__ import annotations

import boule
import numpy as np
import pytest
from error_free import closure
from frame_oracles import cross_matrix, difference, ecef, local_axes
from oracles import points
from oracles.normal_gravity import closed_form_gravity
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from ggbench.gravity import ellipsoid
from ggbench.ins import strapdown
from ggbench.numerics import rotations
from ggbench.trajectory.truth import Segment, Trajectory, fly

RIGHT, FORWARD, UP = np.eye(3)
EAST, NORTH = np.eye(3)[:2]
EARTH_RATE = np.array([0.0, 0.0, ellipsoid.ROTATION_RATE])


def fly_from(segments: list[Segment], dt: float, speed: float = 250.0) -> Trajectory:
    return fly(
        position=np.array([np.radians(33.5), np.radians(108.0), 10000.0]),
        speed=speed,
        heading=np.radians(90.0),
        pitch=0.0,
        roll=0.0,
        segments=segments,
        dt=dt,
    )


# Conventions.


@pytest.mark.parametrize(
    ("heading", "pitch", "roll", "body", "local"),
    [
        (0, 0, 0, RIGHT, EAST),
        (0, 0, 0, FORWARD, NORTH),
        (0, 0, 0, UP, UP),
        (90, 0, 0, FORWARD, EAST),  # clockwise from north
        (90, 0, 0, RIGHT, -NORTH),
        (0, 90, 0, FORWARD, UP),  # nose up
        (0, 90, 0, UP, -NORTH),
        (0, 0, 90, RIGHT, -UP),  # right wing down
        (0, 0, 90, UP, EAST),
        (90, 0, 90, RIGHT, -UP),
        (90, 90, 0, FORWARD, UP),
    ],
)
def test_attitude_conventions(heading, pitch, roll, body, local):
    """Heading clockwise from north, pitch nose up, roll right wing down; body right-forward-up."""
    c_nb = rotations.attitude_matrix(*np.radians([heading, pitch, roll]).astype(float))
    np.testing.assert_allclose(c_nb @ body, local, atol=1e-15)


def test_attitude_turns_in_the_order_roll_pitch_heading():
    """C_nb is a roll about forward, then a pitch about right, then a heading about down."""
    for heading, pitch, roll in np.random.default_rng(1).uniform(-3.0, 3.0, (20, 3)):
        oracle = (
            Rotation.from_rotvec(-heading * UP)
            * Rotation.from_rotvec(pitch * RIGHT)
            * Rotation.from_rotvec(roll * FORWARD)
        )
        np.testing.assert_allclose(
            rotations.attitude_matrix(heading, pitch, roll), oracle.as_matrix(), atol=1e-15
        )


@pytest.mark.parametrize(
    "angle", [0.0, 1e-12, 1e-6, 0.9e-5, 1.1e-5, 0.99e-4, 1.01e-4, 1e-2, 0.5, 1.5]
)
def test_rotation_vectors(angle):
    """exp([v×]) is scipy's rotation, and the logarithm brings v back, on both sides of seams."""
    matrix, vector = np.empty((3, 3)), np.empty(3)
    for direction in np.random.default_rng(2).normal(size=(20, 3)):
        given = angle * direction / np.linalg.norm(direction)
        rotations.rotation_matrix(given, matrix)
        np.testing.assert_allclose(matrix, Rotation.from_rotvec(given).as_matrix(), atol=1e-15)
        rotations.rotation_vector(matrix, vector)
        np.testing.assert_allclose(vector, given, rtol=0.0, atol=1e-15)


# Kinematics on the ellipsoid, from Cartesian coordinates.


def random_states(count: int, seed: int):
    rng = np.random.default_rng(seed)
    for _ in range(count):
        position = np.array(
            [np.radians(rng.uniform(-80, 80)), rng.uniform(-3, 3), rng.uniform(-100, 20e3)]
        )
        attitude = Rotation.from_quat(rng.normal(size=4)).as_matrix()
        yield position, rng.uniform(-300.0, 300.0, 3), attitude


def test_position_rate_is_the_velocity():
    """A position that changes at position_rate moves through Cartesian space at v^n."""
    rate = np.empty(3)
    for position, velocity, _ in random_states(50, seed=3):
        points.position_rate(position, velocity, rate)
        moved = difference(lambda t, p=position: ecef(p + t * rate), 20.0)
        np.testing.assert_allclose(
            local_axes(*position[:2]).T @ moved, velocity, rtol=0.0, atol=1e-9
        )


def test_frame_rates_turn_the_local_level():
    """ω_ie is the earth's axis seen from n; ω_en is the turn of n against the earth in flight."""
    rate, omega_ie, omega_en = np.empty((3, 3))
    for position, velocity, _ in random_states(50, seed=4):
        points.frame_rates(position[0], position[2], velocity, omega_ie, omega_en)
        axes = local_axes(*position[:2])
        np.testing.assert_allclose(axes @ omega_ie, EARTH_RATE, atol=1e-18)
        points.position_rate(position, velocity, rate)
        turning = axes.T @ difference(lambda t, p=position: local_axes(*(p + t * rate)[:2]), 10.0)
        np.testing.assert_allclose(turning, cross_matrix(omega_en), rtol=0.0, atol=1e-15)


# Rest.


def test_rest_reads_gravity_and_earth_rate():
    """Instruments that stand on the earth read 1 g upwards and the earth's rotation, no more."""
    for position, _, c_nb in random_states(10, seed=5):
        position[2] = abs(position[2])
        still = np.repeat(position[None], 3, axis=0)
        angles, velocities = strapdown.error_free_increments(
            still, np.zeros((3, 3)), np.repeat(c_nb[None], 3, axis=0), np.zeros((2, 3)), 0.05
        )
        axes = local_axes(*position[:2])
        np.testing.assert_allclose(angles / 0.05, [c_nb.T @ axes.T @ EARTH_RATE] * 2, atol=1e-14)
        gravity = np.array([0.0, *closed_form_gravity(position[0], position[2])])
        np.testing.assert_allclose(velocities / 0.05, [-c_nb.T @ gravity] * 2, atol=1e-10)


def test_ins_at_rest_stays():
    """An hour of such readings moves nothing: neither the position nor the attitude.

    But for rounding, which is worth 1e-10 m/s² at most, and 1 cm after an hour of the vertical
    channel's instability.
    """
    for position, _, c_nb in random_states(3, seed=6):
        gravity = np.array([0.0, *closed_form_gravity(position[0], position[2])])
        dt, count = 0.1, 36000
        angle = c_nb.T @ local_axes(*position[:2]).T @ EARTH_RATE * dt
        velocity = -c_nb.T @ gravity * dt
        positions, velocities, attitudes = strapdown.navigate(
            position,
            np.zeros(3),
            c_nb,
            np.tile(angle, (count, 1)),
            np.tile(velocity, (count, 1)),
            dt,
        )
        assert np.linalg.norm(ecef(positions[-1]) - ecef(position)) < 1e-2
        assert np.abs(velocities[-1]).max() < 1e-4
        assert np.abs(attitudes[-1] - c_nb).max() < 1e-11


def test_gravity_disturbance_is_felt_as_the_lack_of_support():
    """At rest in real gravity the accelerometers carry the real gravity, disturbance included."""
    position, _, c_nb = next(iter(random_states(1, seed=7)))
    still = np.repeat(position[None], 2, axis=0)
    disturbance = np.array([[3e-4, -2e-4, 5e-4]])
    without, with_it = (
        strapdown.error_free_increments(
            still, np.zeros((2, 3)), np.repeat(c_nb[None], 2, axis=0), d, 0.05
        )[1]
        for d in (np.zeros((1, 3)), disturbance)
    )
    np.testing.assert_allclose(
        (with_it - without) / 0.05, -disturbance @ c_nb, rtol=0.0, atol=1e-13
    )


# Closure.


def test_closure_of_the_papers_flight(wang):
    """Error-free instruments lead the INS along the truth: 200 s to 1 mm, 1e-6 m/s."""
    position, velocity, attitude = closure(wang.trajectory)
    print(f"{np.abs(position).max():.1e} m, {np.abs(velocity).max():.1e} m/s")
    assert np.abs(position).max() < 1e-3
    assert np.abs(velocity).max() < 1e-6
    assert attitude.max() < 1e-12
    # The instruments agree with the flight's, which the simulation navigates on.
    np.testing.assert_allclose(wang.delta_velocities[0] / 0.05, [0, 0, 9.77], atol=0.1)


@pytest.mark.long
def test_closure_of_a_four_hour_flight():
    """Four hours of turns both ways, climbs, descents and speed changes close to 1 m.

    In the horizontal, which a rounding error only sends into Schuler's oscillation, and in the
    vertical, whose instability multiplies it by cosh(t sqrt(2g/R)) = 4e10: increments that repeat
    one rounding error at every step end a kilometre off, at 20 Hz as at 10 Hz.
    """
    rate = np.radians(1.0)
    hour = [
        Segment(900.0),
        Segment(60.0, turn_rate=1.5 * rate),
        Segment(240.0, acceleration=0.1),
        Segment(30.0, climb_rate=0.1 * rate),
        Segment(300.0),
        Segment(60.0, climb_rate=-0.1 * rate),
        Segment(300.0),
        Segment(30.0, climb_rate=0.1 * rate),
        Segment(180.0, turn_rate=-2.0 * rate),
        Segment(240.0, acceleration=-0.1),
        Segment(60.0, turn_rate=3.0 * rate),
        Segment(1200.0),
    ]
    truth = fly_from(4 * hour, dt=0.1)
    assert truth.times[-1] == pytest.approx(4 * 3600.0)
    position, velocity, attitude = closure(truth)
    print("4 h: ENU", np.abs(position).max(axis=0), np.abs(velocity).max(axis=0), attitude.max())
    assert np.abs(position[:, :2]).max() < 1.0
    assert np.abs(position[:, 2]).max() < 1.0
    assert np.abs(velocity).max() < 1e-2
    assert attitude.max() < 1e-6


def test_the_vertical_channel_is_unstable():
    """A metre of error in height grows as cosh(t sqrt(2g/R)), as it does in a real INS."""
    truth = fly_from([Segment(1800.0)], dt=0.1)
    angles, velocities = strapdown.error_free_increments(
        truth.positions, truth.velocities, truth.attitudes, np.zeros((18000, 3)), truth.dt
    )
    high = truth.positions[0] + np.array([0.0, 0.0, 1.0])
    positions, _, _ = strapdown.navigate(
        high, truth.velocities[0], truth.attitudes[0], angles, velocities, truth.dt
    )
    growth = positions[-1, 2] - truth.positions[-1, 2]
    radius = 6378137.0
    expected = np.cosh(truth.times[-1] * np.sqrt(2.0 * 9.77 / radius))
    assert growth == pytest.approx(expected, rel=0.02)


# The continuous equations of motion, in Earth-fixed axes.


def specific_force(t: float) -> np.ndarray:
    """f^b of a lively flight [m/s²]."""
    return np.array(
        [2.0 * np.sin(0.5 * t), 3.0 * np.cos(0.31 * t), 9.8 + 2.0 * np.sin(0.4 * t + 1.0)]
    )


def free_fall(t: float) -> np.ndarray:
    """f^b of a body that nothing holds [m/s²]."""
    return np.zeros((3, *np.shape(t)))


def steady_force(t: float) -> np.ndarray:
    """f^b of a long climb [m/s²]."""
    return np.multiply.outer([0.05, 0.2, 9.75], np.ones_like(t))


def no_rate(t: float) -> np.ndarray:
    """ω_ib^b of a body that keeps its attitude against the stars [rad/s]."""
    return np.zeros((3, *np.shape(t)))


def angular_rate(t: float) -> np.ndarray:
    """ω_ib^b of a lively flight [rad/s]."""
    return np.array([0.2 * np.cos(0.7 * t), 0.3 * np.sin(0.6 * t), 0.15 * np.cos(0.23 * t + 2.0)])


def cartesian_motion(position, velocity, c_nb, signals, duration):
    """Integrate r'' = C f + g − 2Ω × r', C' = C [ω×] − [Ω×] C in Earth-fixed axes to 1e-12.

    Geodetic coordinates are boule's; gravity is the closed form of the normal field.
    """
    axes = local_axes(*position[:2])
    angular_rate, specific_force = signals

    def rates(t: float, state: np.ndarray) -> np.ndarray:
        place, speed, c_eb = state[:3], state[3:6], state[6:].reshape(3, 3)
        longitude, latitude, height = boule.WGS84.cartesian_to_geodetic(tuple(place))
        local = local_axes(np.radians(latitude), np.radians(longitude))
        gravity = local[:, 1:] @ closed_form_gravity(np.radians(latitude), float(height))
        force = c_eb @ specific_force(t) + gravity - 2.0 * np.cross(EARTH_RATE, speed)
        turn = c_eb @ cross_matrix(angular_rate(t)) - cross_matrix(EARTH_RATE) @ c_eb
        return np.concatenate([speed, force, turn.ravel()])

    start = np.concatenate([ecef(position), axes @ velocity, (axes @ c_nb).ravel()])
    solution = solve_ivp(rates, (0.0, duration), start, method="DOP853", rtol=1e-12, atol=1e-11).y[
        :, -1
    ]
    return solution[:3], solution[3:6], solution[6:].reshape(3, 3)


@pytest.mark.parametrize(
    ("signals", "steps", "limits"),
    [
        # Uncorrected coning and sculling of 0.3 rad/s at 20 Hz.
        ((angular_rate, specific_force), (0.2, 0.1, 0.05), (0.3, 0.02, 1e-4)),
        # Nothing but the earth and the flight around it.
        ((no_rate, steady_force), (4.0, 2.0, 1.0), (0.02, 1e-3, 1e-6)),
        ((no_rate, free_fall), (4.0, 2.0, 1.0), (0.02, 1e-3, 1e-6)),
    ],
    ids=["lively", "steady", "free fall"],
)
def test_second_order_convergence_to_the_equations_of_motion(signals, steps, limits):
    """The mechanization integrates Newton's and Euler's equations, with an error of order dt².

    The oracle knows no transport rate, no curvature and no local level. Limits: position [m],
    velocity [m/s], attitude [rad] after 40 s with the shortest step.
    """
    position = np.array([np.radians(-61.0), np.radians(170.0), 30000.0])
    velocity, c_nb = np.array([180.0, -120.0, 40.0]), rotations.attitude_matrix(2.0, 0.1, -0.3)
    duration = 40.0
    place, speed, attitude = cartesian_motion(position, velocity, c_nb, signals, duration)
    nodes, weights = np.polynomial.legendre.leggauss(6)
    errors = []
    for dt in steps:
        starts = dt * np.arange(round(duration / dt))
        inner = starts[:, None] + 0.5 * dt * (nodes + 1.0)
        increments = [
            0.5 * dt * np.einsum("cts,s->tc", signal(inner), weights) for signal in signals
        ]
        positions, velocities, attitudes = strapdown.navigate(
            position, velocity, c_nb, *increments, dt
        )
        axes = local_axes(*positions[-1, :2])
        errors.append(
            [
                np.linalg.norm(ecef(positions[-1]) - place),
                np.linalg.norm(axes @ velocities[-1] - speed),
                np.abs(axes @ attitudes[-1] - attitude).max(),
            ]
        )
    errors = np.array(errors)
    ratios = errors[:-1] / errors[1:]
    print(errors, ratios)
    assert (np.abs(ratios - 4.0) < 0.02).all()
    assert (errors[-1] < limits).all()
