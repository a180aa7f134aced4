"""What goes wrong with a gradiometer: outliers, dropouts, clocks, jitter, biases that walk."""

from __future__ import annotations

import numpy as np
import pytest
from laws import likely
from scipy.spatial.transform import Rotation
from scipy.stats import binom, chi2
from small_cases import rough_map, small_flight
from thinning import thinned

from ggbench.estimators.ekf import ExtendedKalmanFilter
from ggbench.estimators.factor_graph import FactorGraph
from ggbench.judging.run_errors import evaluate
from ggbench.sensors.gradiometer.faults import Faults, biases
from ggbench.sensors.gradiometer.instrument import COMPONENTS, Gradiometer, readings
from ggbench.simulation.runs import simulate

SECONDS = np.arange(1.0, 20001.0)


def test_outliers_have_the_stated_share_and_size():
    """Of each channel by itself; false-alarm probability 1e-3 for share, size and pairs each."""
    faults = Faults(outlier_share=0.05, outlier=30.0)
    found = faults.outliers(SECONDS, 6, np.random.default_rng(1))
    struck = found != 0.0
    assert likely(struck.sum(), binom(120000, 0.05), 1e-3)
    assert likely((found[struck] ** 2).sum() / 900.0, chi2(struck.sum()), 1e-3)
    assert likely((struck[:, 0] & struck[:, 5]).sum(), binom(20000, 0.0025), 1e-3)
    assert not Faults().outliers(SECONDS, 6, np.random.default_rng(1)).any()


def test_an_outlier_adds_to_the_reading_that_would_have_been():
    """A run with outliers is the same run without them, but for the readings that are struck."""
    outliers = {"truth.gradiometer.outlier_share": 0.1, "truth.gradiometer.outlier_eotvos": 5.0}
    clean, struck = (
        simulate(small_flight(changes), seed=8, run=0)[0].measurements for changes in ({}, outliers)
    )
    added = struck - clean
    assert 3 <= (added != 0.0).sum() <= 25  # of 120; false-alarm probability 1e-3
    assert (np.abs(added[added != 0.0]) > 0.01).mean() > 0.9


def test_dropouts_have_the_stated_share_and_intervals():
    """A reading is lost with all its channels: by chance, and in every interval, ends included."""
    times = np.arange(1.0, 20001.0)
    faults = Faults(dropout_share=0.1, dropouts=((100.0, 199.5), (150.0, 300.0), (500.2, 500.9)))
    inside = faults.in_dropouts(times)
    np.testing.assert_array_equal(np.flatnonzero(inside), np.arange(99, 300))
    lost = faults.missing(times, np.random.default_rng(2))
    assert lost[inside].all()
    assert likely(lost[~inside].sum(), binom((~inside).sum(), 0.1), 1e-3)
    expected = faults.expected_share(times)
    np.testing.assert_array_equal(expected[inside], 0.0)
    np.testing.assert_array_equal(expected[~inside], 0.9)
    # One by one: a reading is lost no more often after one that was lost.
    free = lost[300:]
    assert likely((free[1:] & free[:-1]).sum(), binom(len(free) - 1, 0.01), 1e-3)


def test_lost_readings_leave_the_others_alone():
    """What remains of a run with dropouts is the run without them."""
    clean, lossy = (
        simulate(small_flight({"truth.gradiometer.dropout_share": share}), seed=9, run=3)[0]
        for share in (0.0, 0.4)
    )
    lost = ~lossy.measurements.any(axis=1)
    assert 1 <= lost.sum() <= 17  # of 20; false-alarm probability below 1e-4
    np.testing.assert_array_equal(lossy.measurements[~lost], clean.measurements[~lost])


def test_a_lost_reading_has_no_innovation():
    """The NIS of readings that are there adds up to χ²; false-alarm probability 1e-3."""
    flight = small_flight({"truth.gradiometer.dropout_share": 0.5})
    found = []
    for run in range(10):
        problem, truth = simulate(flight, seed=9, run=run)
        estimate = ExtendedKalmanFilter().estimate(problem, np.random.default_rng(0))
        nis = evaluate(problem, estimate, truth).nis
        np.testing.assert_array_equal(np.isnan(nis), ~problem.measurements.any(axis=1))
        found.append(nis[np.isfinite(nis)])
    count = sum(map(len, found)) * problem.measurements.shape[1]
    assert likely(np.concatenate(found).sum(), chi2(count), 1e-3)


def test_a_bias_that_starts_from_nothing_can_be_solved_for():
    """A walk without a bias at the start: filter and factor graph agree to 0.1 deviations."""
    flight = small_flight({"gradiometer.drift_eotvos_per_sqrt_h": 0.1})
    problem, _ = simulate(flight, seed=9, run=0)
    one, other = (
        estimator.estimate(problem, np.random.default_rng(0))
        for estimator in (ExtendedKalmanFilter(), FactorGraph(mode="isam2"))
    )
    sigma = np.sqrt(np.diagonal(one.cov, axis1=1, axis2=2))
    assert np.abs((one.mean - other.mean) / sigma).max() < 0.1


def test_a_mount_that_is_turned_and_scaled_reads_that():
    """Misalignment turns the tensor as a rigid body, by one rotation of the stated size per run.

    Against the channels' own rotation: eigenvalues stay, and the rotation vectors of 400 runs,
    found from how the axes of the tensor turned, have the stated variance (false-alarm
    probability 1e-3).
    """
    sigma = 1e-4
    tensor = np.array([[-1500.0, 0.0, 0.0, -1600.0, 0.0, 3100.0]])
    vectors = []
    for seed in range(400):
        faults, own = Faults(misalignment=sigma), np.random.default_rng(seed)
        turned = faults.distort(tensor, np.eye(6), faults.mounting(own), own)[0]
        xx, xy, xz, yy, yz, zz = turned
        full = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        np.testing.assert_allclose(
            np.linalg.eigvalsh(full), np.sort(tensor[0, [0, 3, 5]]), rtol=0.0, atol=1e-9
        )
        # To first order (Rᵀ D R)_ij = φ_k (D_jj − D_ii) for a cyclic i, j, k.
        vectors.append([yz / (3100.0 + 1600.0), xz / (-1500.0 - 3100.0), xy / (-1600.0 + 1500.0)])
    assert likely((np.square(vectors) / sigma**2).sum(), chi2(1200), 1e-3)
    own = np.random.default_rng(1)
    scaled = Faults(scale_factor=1e-3).distort(np.ones((5, 6)), np.eye(6), np.zeros(3), own)
    np.testing.assert_array_equal(scaled, np.tile(scaled[0], (5, 1)))
    assert len(set(scaled[0])) == 6


def test_a_reading_at_a_wrong_time_is_that_of_another_place(tmp_path):
    """Jitter shifts a reading by velocity times derivative; here 0.2 s by 250 m/s.

    The delays that explain the readings of a level instrument in a rough map, component by
    component, agree, and scatter as stated (20 readings, false-alarm probability 1e-3).
    """
    rough = {
        "field.source": rough_map(tmp_path / "rough.nc"),
        "gradiometer.instrument": "local-level",
    }
    right = small_flight(rough)
    wrong = small_flight(rough | {"truth.gradiometer.timing_jitter_s": 0.2})
    clean, late = (simulate(f, 10, 0)[0].measurements for f in (right, wrong))
    truth, epochs = right.trajectory, right.epochs
    _, slope = right.field.tensor_and_derivative(*truth.positions[epochs].T)
    rate = np.einsum("kij,kj->ki", slope, truth.velocities[epochs])
    change = late - clean
    delays = (change * rate).sum(axis=1) / (rate**2).sum(axis=1)
    assert np.abs(change).max() > 0.1
    # The second order: 50 m in a field of 3 km.
    np.testing.assert_allclose(change, delays[:, None] * rate, atol=0.1 * np.abs(change).max())
    # The last reading cannot be taken after the end of the flight.
    assert delays[-1] <= 1e-9
    assert likely((delays[:-1] ** 2).sum() / 0.04, chi2(19), 1e-3)


def test_a_wrong_clock_turns_the_platform_against_the_sky():
    """A clock that is wrong by τ reads the tensor of a place ω_ie τ further to the east (eq. 12).

    In a zonal field that is all; one error serves the whole run.
    """
    right = small_flight()
    wrong = small_flight({"truth.gradiometer.clock_error_s": 2.0})
    clean, off = (simulate(f, 11, 0)[0].measurements for f in (right, wrong))
    positions = right.trajectory.positions[right.epochs]
    moved = positions + np.array([0.0, 7.292115e-5, 0.0])  # what a second does
    rate = readings(right.field, moved, right.times) - right.noise_free
    seconds = ((off - clean) * rate).sum() / (rate**2).sum()
    assert 0.0 < abs(seconds) < 4.0 * 2.0
    np.testing.assert_allclose(off - clean, seconds * rate, rtol=0.0, atol=1e-3 * abs(rate).max())


def test_a_strapdown_reading_at_a_wrong_time_has_the_attitude_of_then():
    """An aircraft that rolls while the reading is late is read in the attitude of that time."""
    turning = {
        "gradiometer.instrument": "strapdown",
        "trajectory.segment": [{"duration_s": 20.0, "turn_rate_deg_per_s": 3.0}],
    }
    right = small_flight(turning)
    wrong = small_flight(turning | {"truth.gradiometer.timing_jitter_s": 0.05})
    clean, late = (simulate(f, 10, 0)[0].measurements for f in (right, wrong))
    truth, n = right.trajectory, right.epochs[9]
    step = Rotation.from_matrix(truth.attitudes[n - 1].T @ truth.attitudes[n + 1]).as_rotvec()
    rate = readings(
        right.field,
        truth.positions[[n, n]],
        right.times[[9, 9]],
        np.stack([truth.attitudes[n - 1], truth.attitudes[n + 1]]),
        "strapdown",
    )
    rate = (rate[1] - rate[0]) / (2.0 * truth.dt)
    change = late[9] - clean[9]
    delay = (change @ rate) / (rate @ rate)
    assert np.linalg.norm(step) > 0.005
    assert 1e-4 < abs(delay) < 0.2
    np.testing.assert_allclose(change, delay * rate, rtol=0.0, atol=0.02 * np.abs(change).max())


@pytest.mark.parametrize("bias", [2.0, 0.02])  # much and little beside the walk to 60 s
def test_biases_start_and_walk_as_stated(bias):
    """400 runs of 3 channels: b(t) has the variance σ² + d² t, with independent steps between.

    Variances at three times and of the step from the first to the last: chi-square, false-alarm
    probability 1e-3 each.
    """
    times = np.array([60.0, 900.0, 3600.0])
    instrument = Gradiometer(1.0, None, COMPONENTS[:3], bias_eotvos=bias, drift=3.0 / 60.0)
    walks = np.array(
        [biases(instrument, 3, times, np.random.default_rng([12, run])) for run in range(400)]
    )
    for k, variance in enumerate(bias**2 + 9.0 * times / 3600.0):
        assert likely((walks[:, k] ** 2).sum() / variance, chi2(1200), 1e-3)
    step = walks[:, 2] - walks[:, 0]
    assert likely((step**2).sum() / (9.0 * 3540.0 / 3600.0), chi2(1200), 1e-3)
    assert abs(np.corrcoef(step.ravel(), walks[:, 0].ravel())[0, 1]) < 3.3 / np.sqrt(1200)


def test_the_walk_that_is_claimed_begins_with_the_flight():
    """What is claimed of a bias t after the start is σ² + d² t, of the first reading already."""
    flight = small_flight(
        {"gradiometer.bias_eotvos": 0.01, "gradiometer.drift_eotvos_per_sqrt_h": 3.0}
    )
    problem, _ = simulate(flight, 13, 0)
    claimed = problem.prior_cov + np.cumsum(problem.process_cov, axis=0)
    expected = 1e-4 + 9.0 * problem.times / 3600.0
    for channel in range(15, 21):
        np.testing.assert_allclose(claimed[:, channel, channel], expected, rtol=1e-9)


@thinned("drift", [0.0, 3.0])
def test_the_walk_that_is_claimed_is_the_walk_that_is_flown(drift):
    """Prior, Φ and Q of the bias states are those of the simulated biases.

    100 runs, six channels, all epochs' steps: chi-square, false-alarm probability 1e-3.
    """
    flight = small_flight(
        {"gradiometer.bias_eotvos": 1.0, "gradiometer.drift_eotvos_per_sqrt_h": drift}
    )
    starts, steps = 0.0, 0.0
    for run in range(100):
        problem, truth = simulate(flight, 13, run)
        walk = truth.error_state[:, 15:]
        np.testing.assert_array_equal(
            problem.transition[:, 15:, 15:], np.tile(np.eye(6), (20, 1, 1))
        )
        if drift == 0.0:
            np.testing.assert_array_equal(np.diff(walk, axis=0), 0.0)
            assert not problem.process_cov[:, 15:].any()
        else:
            variance = np.einsum("kii->ki", problem.process_cov)[1:, 15:]
            steps += (np.diff(walk, axis=0) ** 2 / variance).sum()
        starts += (walk[0] ** 2 / np.diag(problem.prior_cov)[15:]).sum()
    assert likely(starts, chi2(600), 1e-3)
    if drift > 0.0:
        assert likely(steps, chi2(600 * 19), 1e-3)
