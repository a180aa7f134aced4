"""An INS that integrates its gradiometer's readings: what it adds, and how that errs."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from small_cases import QUIET, small_flight

from ggbench.gravity.ellipsoid import normal_gradient_of, radii_of_curvature
from ggbench.ins.known_gravity import extrapolate, integrate, of_readings
from ggbench.ins.strapdown import navigate
from ggbench.numerics.lanes import lanes
from ggbench.simulation.error_free_flight import Flight
from ggbench.simulation.runs import simulate, simulate_block

INTEGRATED = QUIET | {
    "gradiometer.instrument": "local-level",
    "gradiometer.period_s": 0.5,
    "gradiometer.noise_eotvos": 1e-6,
    "model.disturbance.horizontal_mgal": 20.0,
    "model.disturbance.integrate_gradients": True,
}
MGAL = 1e-5


def flight(rough_gravity: dict[str, object], **changes: object) -> Flight:
    return small_flight(INTEGRATED | rough_gravity | changes)


def change(made: Flight) -> np.ndarray:
    """What the disturbance changes by from the start to each epoch (K, 3)."""
    felt = made.field.gravity_disturbance(*made.trajectory.positions.T)
    return felt[made.epochs] - felt[0]


def test_without_errors_the_integral_is_the_change_of_the_disturbance(rough_gravity):
    """To a hundredth of it, trapezia and the flatness of a random map taken together."""
    made = flight(rough_gravity)
    left = made.unknown_gravity - made.unknown_to_a_map + change(made)
    print(np.abs(left).max(), np.abs(change(made)).max())
    assert np.abs(change(made)).max() > 10.0 * MGAL
    assert np.abs(left).max() < 0.01 * np.abs(change(made)).max()


def test_readings_that_are_missing_are_bridged(rough_gravity):
    """By a trapezium over the gap, as if they lay on the line between their neighbours.

    What stands in the place of a missing reading does not matter. The vehicle hardly accelerates.
    """
    made = flight(rough_gravity)
    exact = made.noise_free[np.newaxis] @ made.model.gradiometer.channels.T
    missing = np.zeros((1, exact.shape[1]), dtype=bool)
    missing[0, [5, 11, 12]] = True
    wrong, between = exact.copy(), exact.copy()
    wrong[missing] = 1e6
    at, there = np.arange(exact.shape[1]), ~missing[0]
    for channel in between[0].T:
        channel[:] = np.interp(at, at[there], channel[there])
    whole = np.zeros_like(missing)
    bridged, same, line = (
        integral(made, *given) for given in ((exact, missing), (wrong, missing), (between, whole))
    )
    np.testing.assert_array_equal(bridged, same)
    np.testing.assert_allclose(bridged[-1], line[-1], rtol=1e-4, atol=1e-3 * MGAL)
    # Not so while nothing comes: the last reading is held.
    assert np.abs(bridged[12] - line[12]).max() > 0.02 * MGAL


def integral(made: Flight, gradients: np.ndarray, missing: np.ndarray) -> np.ndarray:
    """What an INS without other errors integrates, at the epochs (K, 3)."""
    gravity = made.added_gravity(made.model_field, (gradients, missing))
    truth = made.trajectory
    navigate(
        truth.positions[0],
        truth.velocities[0],
        truth.attitudes[0],
        made.delta_angles,
        made.delta_velocities,
        truth.dt,
        gravity=gravity,
    )
    return np.asarray(gravity.readings.total[made.epochs, :, 0])


def test_between_two_readings_the_last_one_is_held_to_the_middle_of_the_step():
    """δĝ there is what it was at the reading, and T times the way since: of the half step, too."""
    gravity = of_readings(lanes(1, 6), np.array([1]), 4)
    gravity.readings.held[1, :, 0] = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]
    track, moved, disturbance = lanes(4, 15), lanes(3, 3), lanes(1, 3)
    track[2, 3:6, 0] = [1.0, 2.0, 4.0]
    moved[0, :, 0], moved[1, :, 0] = [10.0, 20.0, 30.0], [100.0, 200.0, 300.0]
    extrapolate(gravity.readings, track, 2, 0.5, moved, disturbance)
    tensor = np.array([[1.0, 2.0, 3.0], [2.0, 4.0, 5.0], [3.0, 5.0, 6.0]])
    expected = [100.0, 200.0, 300.0] + tensor @ [10.25, 20.5, 31.0]
    np.testing.assert_allclose(disturbance[0, :, 0], expected, rtol=1e-14)


def test_the_integrated_disturbance_keeps_its_direction_on_the_earth():
    """An hour at 300 m/s without gradients: its local-level components turn by 13 degrees.

    The local level turns by the transport rate (Groves 2013, eq. 5.44).
    """
    latitude, east, north, seconds = np.radians(50.0), 240.0, -180.0, 3600
    gravity = of_readings(lanes(2, 6), np.array([1, 2]), seconds + 3)
    ee, nn, nu, uu = normal_gradient_of(math.sin(latitude), math.cos(latitude), 0.0)
    normal = np.array([ee, 0.0, 0.0, nn, nu, uu])
    gravity.readings.tensors[:, :, 0] = normal, normal
    gravity.readings.tensors[0, :, 0] += [20.0, 5.0, 10.0, 0.0, -15.0, -20.0]
    track, moved = lanes(seconds + 3, 15), lanes(3, 3)
    track[:, 0], track[:, 3, 0], track[:, 4, 0] = latitude, east, north
    for n in range(seconds + 2):
        integrate(gravity.readings, track, n, 1.0, moved)
    start, end = gravity.readings.total[2, :, 0], gravity.readings.total[-1, :, 0]
    meridian, prime_vertical = radii_of_curvature(latitude)
    transport = [-north / meridian, east / prime_vertical, east / prime_vertical * np.tan(latitude)]
    turn = -seconds * np.array(transport)
    assert np.degrees(np.linalg.norm(turn)) == pytest.approx(12.8, abs=1.0)
    expected = Rotation.from_rotvec(turn).apply(start)
    assert np.linalg.norm(end - start) > 0.05 * np.linalg.norm(start)
    assert np.linalg.norm(end - expected) < 1e-3 * np.linalg.norm(start)


def test_errors_of_the_velocity_are_integrated_as_f_says(rough_gravity):
    """Five metres per second off: what is left changes by −T δv dt, in Φ to a tenth of it."""
    made = flight(rough_gravity, **{"initial_error.velocity_mps": 5.0})
    problem, truth = simulate(made, 1, 0)
    moved = truth.error_state[-1, 15:18] - truth.error_state[0, 15:18]
    predicted = truth.error_state[0]
    without = truth.error_state[0].copy()
    for phi in problem.transition[1:]:
        predicted = phi @ predicted
        cut = phi.copy()
        cut[15:18, :15] = 0.0
        without = cut @ without
    # Less what the rule itself leaves, of the same flight without the error.
    rule = made.unknown_gravity[-1] - made.unknown_gravity[0]
    left = np.abs(moved - rule - (predicted - truth.error_state[0])[15:18]).max()
    print(moved, rule, predicted[15:18] - truth.error_state[0, 15:18])
    assert np.abs(moved - rule).max() > 1.0 * MGAL
    assert left < 0.1 * np.abs(moved - rule).max()
    turned = np.abs(without[15:18] - truth.error_state[0, 15:18]).max()
    assert turned < 0.1 * np.abs(moved - rule).max()


@pytest.mark.long
def test_noise_of_the_readings_adds_up_to_the_walk_that_q_has(rough_gravity):
    """Over 400 runs the variance of each component is Q's, which is the most of any direction.

    A component's own noise: of the five numbers that a tensor has, six channels tell each with two
    thirds to all of a channel's variance. False alarms of the upper side: 1e-4.
    """
    made = flight(rough_gravity, **{"gradiometer.noise_eotvos": 50.0})
    block, truth = simulate_block(made, 2, range(400))
    grown = truth.error_state[:, -1, 15:18] - truth.error_state[:, 0, 15:18]
    variance = grown.var(axis=0)
    expected = block.process_cov[0, 1:, 15:18, 15:18].sum(axis=0).diagonal()
    ratio = variance / expected
    print(ratio)
    assert (ratio < 1.0 + 4.0 * np.sqrt(2.0 / 400)).all()
    assert ratio.max() > 0.6
