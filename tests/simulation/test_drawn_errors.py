"""What runs draw has the size that is stated: times of readings, heights, biases that wander."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from problems import propagated
from scipy.stats import chi2
from small_cases import QUIET, rough_map, small_flight

from ggbench.simulation.random_streams import RandomStreams
from ggbench.simulation.runs import simulate, simulate_block

JITTER = {"truth.gradiometer.timing_jitter_s": 0.02}
SCALED = {"truth.gradiometer.scale_factor_ppm": 1e4}


@pytest.fixture(scope="module")
def rough(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("maps")


def readings(rough: Path, changes: dict[str, Any]) -> np.ndarray:
    """Of a flight over a map of hundreds of E, level and nearly without noise."""
    base = {
        "field.source": rough_map(rough / "map.nc", rms=300.0),
        "gradiometer.instrument": "local-level",
        "gradiometer.noise_eotvos": 1e-6,
    }
    return simulate(small_flight(base | changes), 3, 1)[0].measurements


def test_each_reading_has_an_error_of_time_of_its_own(rough):
    """What it changes a reading by is its rate times its lateness, of the stated deviation.

    Of 20 readings: chi-square and the normal law, false-alarm probability 1e-4 each.
    """
    exact = readings(rough, {})
    rate = np.gradient(exact, axis=0)
    late = np.sum((readings(rough, JITTER) - exact) * rate, axis=1) / np.sum(rate**2, axis=1)
    low, high = chi2.ppf([5e-5, 1.0 - 5e-5], len(late))
    assert low < np.sum((late / 0.02) ** 2) < high
    assert abs(late.mean()) < 3.9 * 0.02 / np.sqrt(len(late))


def test_a_mistimed_reading_is_scaled_as_any_other(rough):
    """Together the two errors do what each does alone."""
    both = readings(rough, JITTER | SCALED) - readings(rough, SCALED)
    alone = readings(rough, JITTER) - readings(rough, {})
    assert np.abs(alone).max() > 0.5
    assert np.abs(both - alone).max() < 0.05 * np.abs(alone).max()


def test_a_scale_factor_leaves_the_noise_as_it_is(rough):
    """It adds a share of the exact reading of a channel, the same one all the time."""
    noisy = {"gradiometer.noise_eotvos": 10.0}
    added = readings(rough, noisy | SCALED) - readings(rough, noisy)
    share = (added / readings(rough, {}))[:, [0, 3, 5]]
    assert np.abs(share).max() > 1e-3
    assert np.ptp(share, axis=0).max() < 1e-9


def test_a_mistimed_reading_is_of_the_true_field(rough):
    """Whatever map the estimators have."""
    other = {"model.field.source": rough_map(rough / "other.nc", seed=2)}
    np.testing.assert_array_equal(readings(rough, JITTER | other), readings(rough, JITTER))


def test_an_altimeter_errs_as_it_is_said_to():
    """The height of an INS without other errors scatters by what Q adds up to.

    200 runs at the last epoch: chi-square, false-alarm probability 1e-4.
    """
    flight = small_flight(
        QUIET | {"altimeter.noise_m_per_sqrt_hz": 5.0, "altimeter.time_constant_s": 2.0}
    )
    block, truth = simulate_block(flight, 31, range(200))
    _, cov = propagated(block.problem(0))
    low, high = chi2.ppf([5e-5, 1.0 - 5e-5], 200)
    assert low < np.sum(truth.error_state[:, -1, 2] ** 2) / cov[-1, 2, 2] < high


def test_the_truth_of_a_bias_that_wanders_is_that_of_the_epoch():
    """Not of the sample before or after: the IMU's own history, at the times of the readings."""
    wandering = {"imu.gyro_bias_time_s": 5.0, "imu.accelerometer_bias_time_s": 8.0}
    flight = small_flight(wandering)
    imu, streams = flight.true.imu, RandomStreams(3, 1)
    start = imu.draw_biases(streams["imu/biases"])
    histories = imu.bias_histories(start, 200, 0.1, streams["imu/bias_walks"])
    _, truth = simulate(flight, 3, 1)
    np.testing.assert_array_equal(truth.error_state[:, 9:], np.hstack(histories)[10::10])


def test_a_bias_of_the_gradiometer_walks_from_the_start_on():
    """By its first reading it has walked for a period, by its last for all of the flight.

    100 runs of six channels: chi-square, false-alarm probability 1e-4 each.
    """
    flight = small_flight({"gradiometer.drift_eotvos_per_sqrt_h": 6.0})
    _, truth = simulate_block(flight, 32, range(100))
    low, high = chi2.ppf([5e-5, 1.0 - 5e-5], 600)
    for k in (0, -1):
        walked = 0.1 * np.sqrt(truth.times[k])
        assert low < np.sum((truth.error_state[:, k, 15:] / walked) ** 2) < high


def test_readings_drop_out_by_chance():
    """A fifth of 2000, other ones in each run: the normal law, false-alarm probability 1e-4."""
    block, _ = simulate_block(
        small_flight({"truth.gradiometer.dropout_share": 0.2}), 33, range(100)
    )
    missing = block.model.gain == 0.0
    assert abs(missing.sum() - 400) < 3.9 * np.sqrt(2000 * 0.2 * 0.8)
    assert (missing[0] != missing[1]).any()
    assert (block.measurements[missing] == 0.0).all()


def test_a_bias_of_the_gradiometer_goes_on_as_the_problem_says():
    """What Φ leaves of its steps, of 20 readings and six channels, is of the covariance Q."""
    changes = {"gradiometer.bias_eotvos": 10.0, "gradiometer.drift_eotvos_per_sqrt_h": 6.0}
    problem, truth = simulate(small_flight(changes), 34, 0)
    bias, phi = truth.error_state[:, 15:], problem.transition[1:, 15:, 15:]
    left = bias[1:] - np.einsum("kij,kj->ki", phi, bias[:-1])
    low, high = chi2.ppf([5e-5, 1.0 - 5e-5], left.size)
    variances = np.diagonal(problem.process_cov, axis1=1, axis2=2)[1:, 15:]
    assert low < np.sum(left**2 / variances) < high
