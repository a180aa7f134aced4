"""Searches for the most probable trajectory on eight runs at once, beside GTSAM and NumPy."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from oracles import solver
from problems import block_of_runs, entangled, estimator, propagated
from scipy.optimize import least_squares
from small_cases import rough_map, small_flight

from ggbench.block import EstimateBlock, ProblemBlock, block_of
from ggbench.campaign.registry import choose
from ggbench.numerics.frozen import read_only
from ggbench.simulation.runs import simulate

pytestmark = pytest.mark.long

REFERENCE = choose("gtsam[mode=batch]").estimator
COMPILED = choose("factor-graph[mode=batch]").estimator


def searched(block: ProblemBlock, **settings) -> EstimateBlock:
    return dataclasses.replace(COMPILED, **settings).estimate_block(block)


def assert_same_runs(found: EstimateBlock, runs: slice, others: EstimateBlock) -> None:
    """To the last bit."""
    np.testing.assert_array_equal(found.mean, others.mean[runs])
    np.testing.assert_array_equal(found.cov, others.cov[runs])
    for name, values in found.info.items():
        np.testing.assert_array_equal(values, others.info[name][runs])


@pytest.mark.parametrize(
    ("name", "case", "runs"),
    [
        ("wang2013", "0.01E-1Hz", 3),
        ("jacksboro_helicopter", "strapdown", 1),
        ("jacksboro_helicopter", "rotating-biases", 1),
    ],
)
def test_the_minimum_is_gtsams(name, case, runs):
    """Means to 1e-4 and deviations to 1e-6 of the prior's deviations, costs to what ends GTSAM's.

    A search ends a thousandth of a posterior deviation off the minimum. Of a platform instrument,
    of one that turns with the vehicle, and of one with biases.
    """
    block = block_of_runs(name, case, 0, runs)
    found, sigma = searched(block), np.sqrt(np.diag(block.prior_cov))
    for run in range(runs):
        expected = REFERENCE.estimate(block.problem(run), np.random.default_rng(0))
        assert found.info["error"][run] == pytest.approx(expected.info["error"], abs=1e-5)
        assert np.abs((found.mean[run] - expected.mean) / sigma).max() < 1e-4
        deviations = [
            np.sqrt(np.diagonal(c, axis1=1, axis2=2)) for c in (found.cov[run], expected.cov)
        ]
        assert np.abs((deviations[0] - deviations[1]) / sigma).max() < 1e-6


@pytest.mark.parametrize("loss", ["huber", "cauchy"])
def test_the_minimum_with_a_loss_is_gtsams(loss):
    """Among outliers, where the estimate without a loss is another one."""
    block = block_of_runs("outliers", "outliers-5pc", 0, 2)
    found, plain = searched(block, loss=loss), searched(block)
    reference = choose(f"gtsam[mode=batch,loss={loss}]").estimator
    sigma = np.sqrt(np.diag(block.prior_cov))
    for run in range(block.runs):
        expected = reference.estimate(block.problem(run), np.random.default_rng(0))
        assert found.info["error"][run] == pytest.approx(expected.info["error"], abs=1e-4)
        assert np.abs((found.mean[run] - expected.mean) / sigma).max() < 1e-4
        assert np.abs((plain.mean[run] - expected.mean) / sigma).max() > 1e-3
        covs = np.abs((found.cov[run] - expected.cov) / np.outer(sigma, sigma)).max()
        assert covs < 1e-5


def test_of_any_prior_and_any_noise_the_minimum_is_gtsams():
    """A mean that is not zero, and states and channels that correlate."""
    block = entangled(block_of_runs("wang2013", "0.01E-0.2Hz", 0, 1))
    found, sigma = searched(block), np.sqrt(np.diag(block.prior_cov))
    expected = REFERENCE.estimate(block.problem(0), np.random.default_rng(0))
    assert found.info["error"][0] == pytest.approx(expected.info["error"], abs=1e-5)
    assert np.abs((found.mean[0] - expected.mean) / sigma).max() < 1e-4
    assert np.abs((found.cov[0] - expected.cov) / np.outer(sigma, sigma)).max() < 1e-6


def test_without_any_reading_the_search_ends_where_it_begins():
    """At the undisturbed motion from the prior's mean, at no cost."""
    block = entangled(block_of_runs("wang2013", "0.01E-0.2Hz", 0, 1))
    gain, offset = (read_only(np.zeros_like(a)) for a in (block.model.gain, block.model.offset))
    empty = dataclasses.replace(
        block,
        measurements=np.zeros_like(block.measurements),
        model=dataclasses.replace(block.model, gain=gain, offset=offset),
    )
    found = searched(empty)
    expected, expected_cov = propagated(empty.problem(0))
    sigma = np.sqrt(np.diagonal(expected_cov, axis1=1, axis2=2))
    assert np.abs((found.mean[0] - expected) / sigma).max() < 1e-12
    both = sigma[:, :, np.newaxis] * sigma[:, np.newaxis]
    assert np.abs((found.cov[0] - expected_cov) / both).max() < 1e-9
    assert found.info["error"][0] == 0.0


def test_a_group_begins_without_what_another_left():
    """After eight runs of which one is cut short while its steps are halved: as alone.

    A run whose search begins at its minimum would go on if it began with the cost of another.
    """
    block = block_of_runs("wang2013", "0.01E-0.2Hz", 0, 10)
    measurements = block.measurements.copy()
    measurements[0, 5] += 300.0
    still = block.problem(9)
    nothing = np.zeros(block.dimension)
    measurements[9] = [still.model.predict(k, nothing) for k in range(block.epochs)]
    odd = dataclasses.replace(block, measurements=measurements)
    found = searched(odd, max_iterations=3)
    assert found.info["map_evaluations"][0] > (1 + 2 * 3) * block.epochs  # steps were halved
    for run in (8, 9):
        alone = searched(block_of(odd.problem(run)), max_iterations=3)
        assert_same_runs(alone, slice(run, run + 1), found)


def test_a_run_does_not_depend_on_its_neighbours():
    """Alone, in three and in eleven (the last group not full), shifted by one: the same bits."""
    whole = searched(block_of_runs("wang2013", "0.01E-0.2Hz", 0, 11))
    for first, last in ((0, 1), (4, 7), (1, 11)):
        part = searched(block_of_runs("wang2013", "0.01E-0.2Hz", first, last))
        assert_same_runs(part, slice(first, last), whole)


def test_a_search_that_gives_up_has_no_answer():
    """Where no step lowers the cost there is no estimate; the others have theirs, bit by bit."""
    block = block_of_runs("wang2013", "0.01E-0.2Hz", 0, 3)
    measurements = block.measurements.copy()
    measurements[1, 5] = 1e12
    odd = dataclasses.replace(block, measurements=measurements)
    found, usual = searched(odd), searched(block)
    assert np.isnan(found.mean[1]).all()
    np.testing.assert_array_equal(found.mean[[0, 2]], usual.mean[[0, 2]])


@pytest.mark.parametrize(
    "label", ["tercom", "tercom-ekf", "correlation", "correlation[association=reciprocal]"]
)
def test_matchers_find_the_places_of_the_search_in_numpy(label):
    """Estimates to 1e-4 of the prior's deviations, and the same fixes."""
    block = block_of_runs("wide_prior", "1km", 0, 1).until(80)
    problem, sigma = block.problem(0), np.sqrt(np.diag(block.prior_cov))
    found = choose(label).estimator.estimate(problem, np.random.default_rng(0))
    expected = solver(label).estimate(problem)
    assert found.fixes.accepted.any()
    np.testing.assert_array_equal(found.fixes.accepted, expected.fixes.accepted)
    np.testing.assert_allclose(found.fixes.statistic, expected.fixes.statistic, rtol=1e-4)
    assert np.abs((found.mean - expected.mean) / sigma).max() < 1e-4
    assert np.abs((found.cov - expected.cov) / np.outer(sigma, sigma)).max() < 1e-4


@pytest.mark.parametrize("name", ["factor-graph[mode=batch]", "gauss-newton"])
@pytest.mark.parametrize("position_m", [1e-6, 10.0])
def test_a_motion_without_noise_and_a_tiny_prior_have_an_answer(name, position_m, tmp_path):
    """No IMU noise and 1 µm of position: the most probable start, by dense least squares.

    The motion has no freedom but its start, so that the cost is that of 15 numbers. To 1e-3 of a
    posterior σ; the prior mean is more than 0.3 off.
    """
    quiet = {
        f"imu.{key}": 0.0
        for key in ("gyro_noise_deg_per_sqrt_h", "accelerometer_noise_ug_per_sqrt_hz")
    }
    rough = {"field.source": rough_map(tmp_path / "map.nc", rms=300.0)}
    flight = small_flight(quiet | rough | {"initial_error.position_m": position_m})
    problem, _ = simulate(flight, 5, 0)
    assert not problem.process_cov.any()
    sigma = np.sqrt(np.diag(problem.prior_cov))
    moved = np.empty((problem.epochs, 15, 15))
    for k in range(problem.epochs):
        moved[k] = problem.transition[k] @ (moved[k - 1] if k else np.eye(15))
    noise = np.sqrt(np.diag(problem.noise_cov))

    def residuals(start: np.ndarray) -> np.ndarray:
        states = moved @ (sigma * start)
        read = problem.model.predict_along(np.arange(problem.epochs), states)
        return np.concatenate([start, ((problem.measurements - read) / noise).ravel()])

    def slopes(start: np.ndarray) -> np.ndarray:
        states = moved @ (sigma * start)
        rows = problem.model.jacobian_along(np.arange(problem.epochs), states) @ moved * sigma
        return np.concatenate([np.eye(15), -(rows / noise[:, np.newaxis]).reshape(-1, 15)])

    found = least_squares(residuals, np.zeros(15), slopes, xtol=1e-15, ftol=1e-15, gtol=1e-12)
    expected = moved @ (sigma * found.x)
    given = estimator(name).estimate(problem, np.random.default_rng(0))
    posterior = np.sqrt(np.diagonal(given.cov, axis1=1, axis2=2))
    assert np.isfinite(given.mean).all() and np.isfinite(given.cov).all()
    assert (np.abs(given.mean - expected) < 1e-3 * posterior).all()
    assert np.abs(expected / posterior).max() > 0.3
