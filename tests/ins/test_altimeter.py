"""The altimeter that damps the vertical channel: its poles, its noise, and what they do in time."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from oracles import dense_model
from scipy.stats import chi2
from small_cases import QUIET, small_flight

from ggbench.ins import strapdown
from ggbench.simulation.runs import simulate

ALTIMETER = {"altimeter.noise_m_per_sqrt_hz": 1.0, "altimeter.time_constant_s": 10.0}
SLOW = {
    "trajectory.speed_mps": 20.0,
    "trajectory.segment": [{"duration_s": 3600.0}],
    "imu.period_s": 1.0,
    "gradiometer.period_s": 60.0,
}
"""An hour at the speed of a ship, with a coarse step."""


def damped(t: float, time_constant: float) -> np.ndarray:
    """(2, 2): what (δh, δv_U) become after t in a system with two poles at −1/T."""
    s = t / time_constant
    return math.exp(-s) * np.array([[1.0 - s, t], [-s / time_constant, 1.0 + s]])


@pytest.mark.parametrize("time_constant", [10.0, 30.0, 100.0])
def test_the_vertical_channel_has_two_poles_at_the_time_constant(time_constant):
    """Mechanization and Φ take height and velocity errors back as a critically damped system does.

    To 1e-3.
    """
    flight = small_flight(
        {"altimeter.noise_m_per_sqrt_hz": 1.0, "altimeter.time_constant_s": time_constant}
    )
    truth, dt = flight.trajectory, flight.trajectory.dt
    gains = strapdown.altimeter_gains(time_constant)
    duration = float(truth.times[-1])

    def end(height: float, velocity: float) -> np.ndarray:
        up = np.array([0.0, 0.0, 1.0])
        track = strapdown.navigate(
            position=truth.positions[0] + height * up,
            velocity=truth.velocities[0] + velocity * up,
            c_nb=truth.attitudes[0],
            delta_angles=flight.delta_angles,
            delta_velocities=flight.delta_velocities,
            dt=dt,
            heights=truth.mean_heights,
            gains=gains,
        )
        return np.array([track[0][-1, 2], track[1][-1, 2]])

    flown = np.stack(
        [(end(5.0, 0.0) - end(-5.0, 0.0)) / 10.0, (end(0.0, 0.5) - end(0.0, -0.5)) / 1.0], axis=-1
    )
    plain = dense_model.system_matrices(
        truth.positions, truth.velocities, truth.attitudes, flight.delta_velocities, dt
    )
    matrices, noise = dense_model.completed(plain, flight.model.imu, flight.model.altimeter)
    phi, _ = dense_model.transitions(
        matrices, truth.positions, np.array([len(truth.times) - 1]), dt, noise
    )
    expected = damped(duration, time_constant)
    # In units in which height and velocity weigh alike.
    units = np.array([[1.0, 1.0 / time_constant], [time_constant, 1.0]])
    np.testing.assert_allclose(
        phi[0][np.ix_([2, 5], [2, 5])] * units, expected * units, rtol=0.0, atol=1e-3
    )
    np.testing.assert_allclose(flown * units, expected * units, rtol=0.0, atol=1e-3)


def test_a_biased_accelerometer_leads_to_what_the_error_model_says_with_a_coarse_step():
    """δh = b / k₂ and δv_U = k₁ δh, as of F: to the square of a step's share in T, 0.01.

    Of b, the two differ by little else than noise, so that an error of the share itself would make
    their covariance a wrong one.
    """
    flight = small_flight(QUIET | SLOW | ALTIMETER)
    truth, bias = flight.trajectory, 1e-3
    gains = strapdown.altimeter_gains(ALTIMETER["altimeter.time_constant_s"])
    assert truth.dt == 0.1 * ALTIMETER["altimeter.time_constant_s"]

    def end(up: float) -> np.ndarray:
        felt = truth.attitudes[0].T @ [0.0, 0.0, up * truth.dt]
        track = strapdown.navigate(
            position=truth.positions[0],
            velocity=truth.velocities[0],
            c_nb=truth.attitudes[0],
            delta_angles=flight.delta_angles,
            delta_velocities=flight.delta_velocities + felt,
            dt=truth.dt,
            heights=truth.mean_heights,
            gains=gains,
        )
        return np.array([track[0][600, 2], track[1][600, 2]])

    height, velocity = end(bias) - end(0.0)
    assert height == pytest.approx(bias / (1.0 / 10.0**2), rel=0.01)
    assert velocity == pytest.approx(gains[0] * height, rel=0.01)


def test_without_an_altimeter_a_height_error_runs_away():
    """As cosh(t √(2g/R)), to 280 times itself in an hour; with one it is gone."""
    start = {"initial_error.height_m": 5.0, "truth.initial_error.velocity_mps": 1e-6}
    free, held = (
        simulate(small_flight(QUIET | SLOW | start | changes), seed=2, run=0)[1]
        for changes in ({}, ALTIMETER | {"altimeter.noise_m_per_sqrt_hz": 1e-6})
    )
    ratio = free.error_state[:, 2] / free.error_state[0, 2]
    growth = np.cosh(free.times * math.sqrt(2.0 * 9.80665 / 6378137.0))
    growth /= growth[0]
    assert growth[-1] > 200.0
    np.testing.assert_allclose(ratio, growth, rtol=0.05)
    assert np.abs(held.error_state[10:, 2]).max() < 1e-3
    assert np.abs(held.error_state[0, 2]) < np.abs(free.error_state[0, 2])


def test_an_hour_with_biased_accelerometers_stays_within_its_claim():
    """Height and vertical velocity after an hour, of 25 runs: their covariance as predicted.

    Chi-square of two states, false-alarm probability 1e-3; the deviations are metres, not
    kilometres.
    """
    errors = {"imu.accelerometer_bias_ug": 500.0, "imu.accelerometer_noise_ug_per_sqrt_hz": 100.0}
    flight = small_flight(QUIET | SLOW | ALTIMETER | errors)
    white, sigma = vertical(flight, 25)
    assert sigma[0] < 5.0
    low, high = chi2.ppf([5e-4, 1.0 - 5e-4], 50)
    assert low < (white**2).sum() < high


def vertical(flight: Any, runs: int) -> tuple[np.ndarray, np.ndarray]:
    """Height and vertical velocity errors (runs, 2) at the end, made white; their deviations."""
    errors, covariance = np.empty((runs, 2)), None
    for run in range(runs):
        problem, truth = simulate(flight, 16, run)
        errors[run] = truth.error_state[-1, [2, 5]]
        if covariance is None:
            covariance = problem.prior_cov
            for phi, q in zip(problem.transition, problem.process_cov, strict=True):
                covariance = phi @ covariance @ phi.T + q
            covariance = covariance[np.ix_([2, 5], [2, 5])]
    root = np.linalg.cholesky(covariance)
    return np.linalg.solve(root, errors.T).T, np.sqrt(np.diag(covariance))


@pytest.mark.long
def test_noise_of_the_altimeter_scatters_the_vertical_channel_as_q_says():
    """200 runs with no other error: covariance of height and vertical velocity at the end.

    Chi-square and likelihood ratio against Q, false-alarm probability 1e-3 each. In the long run a
    height driven by white noise of PSD S through these poles has the variance 5 S / (4 T).
    """
    flight = small_flight(QUIET | ALTIMETER | {"altimeter.time_constant_s": 3.0})
    runs = 200
    white, sigma = vertical(flight, runs)
    low, high = chi2.ppf([5e-4, 1.0 - 5e-4], 2 * runs)
    assert low < (white**2).sum() < high
    sample = white.T @ white / runs
    ratio = runs * (np.trace(sample) - np.linalg.slogdet(sample)[1] - 2)
    assert ratio < chi2.ppf(1.0 - 1e-3, 3)
    assert sigma[0] == pytest.approx(math.sqrt(5.0 / (4.0 * 3.0)), rel=0.02)
    # Power: a PSD counted once too often or too rarely would have been noticed.
    assert 2.0 * 2 * runs > high


def test_an_altimeter_leaves_the_horizontal_alone():
    """It changes height and vertical velocity, and what height does to the rest is centimetres."""
    with_one, without = (
        simulate(small_flight(changes), seed=3, run=0)[1].error_state for changes in (ALTIMETER, {})
    )
    change = np.abs(with_one - without)[-1]
    assert change[2] > 0.1
    assert change[[0, 1]].max() < 0.05
    assert change[9:].max() == 0.0
