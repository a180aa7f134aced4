"""Errors of the inertial sensors: biases that wander, scale factors, axes that lean."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest
from frame_oracles import metres
from oracles import dense_model
from scipy.linalg import block_diag, expm
from scipy.stats import chi2
from small_cases import QUIET, TINY, small_flight

from ggbench.ins.imu import Imu, SensorErrors
from ggbench.numerics.lanes import out_of_lanes, unfilled
from ggbench.sensors.aiding import Motion
from ggbench.simulation.random_streams import RandomStreams
from ggbench.simulation.runs import simulate
from ggbench.simulation.suites import suite_of_case
from ggbench.spec.sensors import FEWEST_STEPS

GYRO, ACCELEROMETER = 5e-6, 1e-3
GYRO_NOISE, ACCELEROMETER_NOISE = 1e-6, 1e-3
WANDERING = Imu(GYRO, ACCELEROMETER, 0.0, 0.0, gyro_bias_time=20.0, accelerometer_bias_time=50.0)


@pytest.mark.parametrize("dt", [0.005, 0.05, 0.5])
def test_the_allan_deviation_of_white_noise_is_its_root_psd(dt):
    """σ_A(τ) = N/√τ, whatever the sampling interval and over whatever averaging time.

    Differences of means over neighbouring τ, each mean used once: independent, of variance 2N²/τ.
    Three axes of each triad, τ of 1, 8 and 64 samples; chi-square, false-alarm probability 1e-4
    each, 18 in all.
    """
    count = 8192
    imu = Imu(0.0, 0.0, GYRO_NOISE, ACCELEROMETER_NOISE)
    out = unfilled(count, 6)
    noise = np.random.default_rng(6).standard_normal((1, 2, count, 3))
    imu.measure(np.zeros((1, count, 6)), np.zeros((1, 1, 6)), noise, dt, out)
    increments = out_of_lanes(out, 1)[0]
    for samples in (1, 8, 64):
        means = increments.reshape(-1, samples, 6).sum(axis=1) / (samples * dt)
        differences = means[1::2] - means[::2]
        low, high = chi2.ppf([5e-5, 1.0 - 5e-5], 3 * len(differences))
        for triad, root in ((slice(0, 3), GYRO_NOISE), (slice(3, 6), ACCELEROMETER_NOISE)):
            variance = 2.0 * root**2 / (samples * dt)
            assert low < (differences[:, triad] ** 2).sum() / variance < high, (samples, root)


def test_a_wandering_bias_is_stationary_and_forgets_as_stated():
    """Gauss–Markov: always of variance σ², and b(t + Δ) = e^(−Δ/T) b(t) + what is new.

    600 runs of two triads over 100 s. The variance at the start, in the middle and at the end, and
    what is new after 3, 20 and 100 s: chi-square; its correlation with what was: 3.9 deviations.
    False-alarm probability 1e-4 each.
    """
    runs, dt, count = 600, 0.5, 200
    low, high = chi2.ppf([5e-5, 1.0 - 5e-5], 3 * runs)
    histories = np.empty((runs, 2, count + 1, 3))
    for run in range(runs):
        rng = np.random.default_rng([1, run])
        start = WANDERING.draw_biases(rng)
        histories[run] = WANDERING.bias_histories(start, count, dt, rng)
        np.testing.assert_array_equal(histories[run, :, 0], start)
    for sensor, (sigma, time) in enumerate(((GYRO, 20.0), (ACCELEROMETER, 50.0))):
        unit = histories[:, sensor] / sigma
        for n in (0, 100, 200):
            assert low < (unit[:, n] ** 2).sum() < high
        for start, lag in ((0, 6), (50, 40), (0, 200)):
            kept = math.exp(-lag * dt / time)
            new = (unit[:, start + lag] - kept * unit[:, start]) / math.sqrt(1.0 - kept**2)
            assert low < (new**2).sum() < high
            together = (new * unit[:, start]).sum() / math.sqrt(3 * runs)
            assert abs(together) < 3.9


def test_a_bias_without_a_time_is_constant():
    """It needs no random numbers, and a wandering neighbour does not move it."""
    imu = dataclasses.replace(WANDERING, gyro_bias_time=math.inf)
    start = imu.draw_biases(np.random.default_rng(1))
    gyro, accelerometer = imu.bias_histories(start, 50, 0.1, np.random.default_rng(2))
    np.testing.assert_array_equal(gyro, np.tile(start[0], (51, 1)))
    assert (np.diff(accelerometer, axis=0) != 0.0).all()


@pytest.mark.parametrize("times", [(20.0, 50.0), (1.0, math.inf), (math.inf, 2.0)])
def test_transitions_of_wandering_biases_are_van_loans(times):
    """Φ and Q between epochs are products of the matrix exponentials of b' = −b/T + w.

    Built from the continuous law alone: PSD of w is 2σ²/T.
    """
    flight = small_flight({"trajectory.roll_deg": 20.0})
    truth, dt = flight.trajectory, flight.trajectory.dt
    plain = dense_model.system_matrices(
        truth.positions, truth.velocities, truth.attitudes, flight.delta_velocities, dt
    )
    imu = Imu(GYRO, ACCELEROMETER, 1e-5, 1e-3, False, *times)
    suite = dataclasses.replace(suite_of_case(flight.case, "model"), imu=imu)
    epochs = np.array([10, 11, 40])
    motion = Motion(truth.positions, truth.velocities, truth.attitudes)
    transition, process_cov = suite.system(motion, flight.delta_velocities, epochs, dt)
    decay = np.repeat([1.0 / times[0], 1.0 / times[1]], 3)
    power = np.repeat([GYRO**2 / times[0], ACCELEROMETER**2 / times[1]], 3) * 2.0
    noise = np.diag(np.r_[np.zeros(3), np.full(3, 1e-6), np.full(3, 1e-10), power])
    start = 0
    for k, end in enumerate(epochs):
        phi, q = np.eye(15), np.zeros((15, 15))
        for n in range(start, end):
            f = plain[n] - np.diag(np.r_[np.zeros(9), decay])
            change = block_diag(metres(truth.positions[n]), np.eye(12))
            f = change @ f @ np.linalg.inv(change)
            block = expm(np.block([[-f, noise], [np.zeros((15, 15)), f.T]]) * dt)
            step = block[15:, 15:].T
            phi, q = step @ phi, step @ q @ step.T + step @ block[:15, 15:]
        scale = np.sqrt(np.maximum(np.diag(q), 1e-30))
        np.testing.assert_allclose(
            process_cov[k] / np.outer(scale, scale), q / np.outer(scale, scale), atol=1e-4
        )
        np.testing.assert_allclose(transition[k], phi, rtol=1e-4, atol=2e-5)
        np.testing.assert_allclose(
            np.diag(transition[k])[9:], np.exp(-decay * (end - start) * dt), rtol=1e-7
        )
        start = end


def test_a_bias_of_the_shortest_time_is_exact_over_an_interval():
    """A bias that decays within ten intervals: e^(−dt/T) and σ² (1 − e^(−2 dt/T)), to 3e-9.

    Far below what any reading shows, and what is left of the series of one interval.
    """
    dt = 0.1
    time = FEWEST_STEPS * dt
    imu = Imu(
        gyro_bias=GYRO,
        accelerometer_bias=ACCELEROMETER,
        gyro_root_psd=0.0,
        accelerometer_root_psd=0.0,
        fixed_biases=False,
        gyro_bias_time=time,
        accelerometer_bias_time=time,
    )
    matrices, noise = dense_model.completed(np.zeros((1, 15, 15)), imu)
    here = np.array([[0.6, 0.1, 1e3]] * 2)
    transition, process_cov = dense_model.transitions(matrices, here, np.array([1]), dt, noise)
    np.testing.assert_allclose(np.diag(transition[0])[9:], math.exp(-dt / time), rtol=3e-9)
    variances = -math.expm1(-2.0 * dt / time) * np.repeat([GYRO, ACCELEROMETER], 3) ** 2
    np.testing.assert_allclose(np.diag(process_cov[0])[9:], variances, rtol=3e-9)


def test_a_wandering_bias_acts_when_the_truth_has_it():
    """Of an INS with no other error the velocity is off by what the accelerometer's bias adds up.

    A reading at every IMU sample, so that each interval is seen by itself: δv_k − δv_{k−1} = b_k dt
    in a straight level flight to the north, with b_k the bias that the truth has at its end, which
    is that of the process at that sample.
    """
    flight = small_flight(
        QUIET
        | {
            "trajectory.heading_deg": 0.0,
            "imu.accelerometer_bias_ug": 5000.0,
            "imu.accelerometer_bias_time_s": 1.0,
            "gradiometer.period_s": 0.1,
        }
    )
    _, truth = simulate(flight, 16, 2)
    biases = truth.error_state[:, 12:]
    steps = np.diff(truth.error_state[:, 3:6], axis=0) / 0.1
    changes = np.abs(np.diff(biases, axis=0)).mean(axis=0)
    assert (changes > 5e-3).all()
    # Body axes are east, north, up here; the rest is gravity's and Coriolis' answer to the error.
    np.testing.assert_allclose(steps, biases[1:], rtol=0.0, atol=1e-3)
    streams, imu = RandomStreams(16, 2), flight.true.imu
    start = imu.draw_biases(streams["imu/biases"])
    history = imu.bias_histories(start, len(biases), 0.1, streams["imu/bias_walks"])[1]
    np.testing.assert_array_equal(biases, history[1:])


def deviations(flight, runs: int) -> np.ndarray:
    """Errors at the last epoch (runs, 15) in directions in which the prior and Q say 1."""
    errors, covariance = np.empty((runs, 15)), None
    for run in range(runs):
        problem, truth = simulate(flight, 14, run)
        errors[run] = truth.error_state[-1]
        if covariance is None:
            covariance = problem.prior_cov
            for phi, q in zip(problem.transition, problem.process_cov, strict=True):
                covariance = phi @ covariance @ phi.T + q
    scale = np.sqrt(np.diag(covariance))
    root = np.linalg.cholesky(covariance / np.outer(scale, scale))
    return np.linalg.solve(root, (errors / scale).T).T


@pytest.mark.long
def test_errors_of_an_ins_with_wandering_biases_are_those_claimed():
    """All 15 states of 200 runs with biases that wander within seconds, against prior, Φ and Q.

    Chi-square, false-alarm probability 1e-3. With constant biases claimed for the same runs the
    sum is wrong by far.
    """
    biases = {"imu.gyro_bias_deg_per_h": 20.0, "imu.accelerometer_bias_ug": 2000.0}
    times = {"gyro_bias_time_s": 4.0, "accelerometer_bias_time_s": 8.0}
    base = TINY | biases
    runs = 200
    low, high = chi2.ppf([5e-4, 1.0 - 5e-4], 15 * runs)
    right = small_flight(base | {f"imu.{key}": value for key, value in times.items()})
    assert low < (deviations(right, runs) ** 2).sum() < high
    wrong = small_flight(base | {f"truth.imu.{key}": value for key, value in times.items()})
    assert (deviations(wrong, 30) ** 2).sum() > 3.0 * 15 * 30


# Scale factors and misalignments.


def test_scale_factors_stand_on_the_diagonal_and_misalignments_beside_it():
    """400 triads: nine draws of the stated sizes; chi-square, false-alarm probability 1e-3 each."""
    triads = np.array(
        [SensorErrors(1e-3, 2e-4).draw(np.random.default_rng([3, n])) for n in range(400)]
    )
    errors = triads - np.eye(3)
    diagonal = np.eye(3, dtype=bool)
    for sigma, part in ((1e-3, errors[:, diagonal]), (2e-4, errors[:, ~diagonal])):
        low, high = chi2.ppf([5e-4, 1.0 - 5e-4], part.size)
        assert low < (part**2).sum() / sigma**2 < high
    np.testing.assert_array_equal(SensorErrors().draw(np.random.default_rng(1)), np.eye(3))


def test_a_triad_is_distorted_as_a_whole():
    """What it measures is one matrix times what it should, at every instant of a run."""
    imu = dataclasses.replace(
        WANDERING,
        gyro_errors=SensorErrors(1e-3, 1e-4),
        accelerometer_errors=SensorErrors(1e-2, 1e-3),
    )
    rng = np.random.default_rng(4)
    angles, velocities = rng.normal(size=(2, 50, 3))
    found = imu.distort(angles, velocities, np.random.default_rng(5))
    for exact, measured, size in zip((angles, velocities), found, (1e-3, 1e-2), strict=True):
        matrix, residual, *_ = np.linalg.lstsq(exact, measured, rcond=None)
        assert residual.max() < 1e-20
        assert 0.0 < np.abs(matrix - np.eye(3)).max() < 4.0 * size
    # Row i of what is drawn is axis i, with its lean towards the others beside its scale.
    drawn = imu.gyro_errors.draw(np.random.default_rng(5))
    np.testing.assert_allclose(
        imu.distort(np.eye(3), np.eye(3), np.random.default_rng(5))[0],
        np.transpose(drawn),
        rtol=0.0,
        atol=1e-15,
    )


ERRORS: dict[str, tuple[dict[str, Any], int]] = {
    "accelerometer scale": ({"accelerometer_scale_factor_ppm": 1000.0}, 5),
    "accelerometer lean": ({"accelerometer_misalignment_arcmin": 10.0}, 3),
    "gyro scale": ({"gyro_scale_factor_ppm": 1000.0}, 8),
    "gyro lean": ({"gyro_misalignment_arcmin": 10.0}, 6),
}


@pytest.mark.parametrize("name", ERRORS)
def test_an_error_of_the_axes_shows_where_it_must(name):
    """In level flight gravity is measured too large, or partly ahead; a turn is not what it was.

    30 runs. The error of the state concerned at the end, in units of what σ makes of g t or of the
    angle turned: chi-square, false-alarm probability 1e-3. Heading of a turn by 57°: φ_U = s ψ;
    tilt: the turn's angle, on a gyro that leans, over what turns with it.
    """
    errors, state = ERRORS[name]
    turning = name.startswith("gyro")
    segment = {"duration_s": 20.0, "turn_rate_deg_per_s": math.degrees(0.05) if turning else 0.0}
    flight = small_flight(
        QUIET
        | {"trajectory.segment": [segment]}
        | {f"truth.imu.{key}": value for key, value in errors.items()}
    )
    sigma = 1e-3 if "scale" in name else math.radians(10.0 / 60.0)
    expected = sigma * (1.0 if turning else 9.79 * 20.0)
    if name == "gyro lean":
        # ∫ C_nb dt along the turn: horizontal axes turn by 1 rad, (sin 1, 1 − cos 1).
        expected = sigma * math.hypot(math.sin(1.0), 1.0 - math.cos(1.0))
    values = np.array([simulate(flight, 15, run)[1].error_state[-1, state] for run in range(30)])
    low, high = chi2.ppf([5e-4, 1.0 - 5e-4], 30)
    assert low < (values**2).sum() / expected**2 < high
