"""The batch solution on eight runs at once beside GTSAM, and that runs do not depend on others."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from problems import block_of_runs, entangled, propagated

from ggbench.block import block_of
from ggbench.campaign.registry import choose
from ggbench.engines import batch_smoother
from ggbench.numerics.frozen import read_only

pytestmark = pytest.mark.long

REFERENCE = choose("gtsam[mode=batch]").estimator
MOST = REFERENCE.max_iterations


@pytest.mark.parametrize(
    ("name", "case", "runs"),
    [
        ("wang2013", "0.01E-1Hz", 3),
        ("jacksboro_helicopter", "strapdown", 1),
        ("jacksboro_helicopter", "rotating-biases", 1),
    ],
)
def test_the_minimum_is_gtsams(name, case, runs):
    """The same number of steps, means to 1e-7 and deviations to 1e-8 of the prior's deviations.

    Of a platform instrument, of one that turns with the vehicle, and of one with biases. Only a
    last step that changes the cost by less than rounding in h may be one's and not the other's.
    """
    block = block_of_runs(name, case, 0, runs)
    mean, cov, counters = batch_smoother.smoother(block, MOST)
    sigma = np.sqrt(np.diag(block.prior_cov))
    for run in range(runs):
        expected = REFERENCE.estimate(block.problem(run), np.random.default_rng(0))
        steps, expected_steps = counters["iterations"][run], expected.info["iterations"]
        if steps != expected_steps:
            assert abs(steps - expected_steps) == 1
            _, _, before = batch_smoother.smoother(block, min(steps, expected_steps))
            assert before["error"][run] == pytest.approx(expected.info["error"], abs=1e-6)
        assert counters["error"][run] == pytest.approx(expected.info["error"], rel=1e-9)
        assert np.abs((mean[run] - expected.mean) / sigma).max() < 1e-7
        deviations = [np.sqrt(np.diagonal(c, axis1=1, axis2=2)) for c in (cov[run], expected.cov)]
        assert np.abs((deviations[0] - deviations[1]) / sigma).max() < 1e-8


@pytest.mark.parametrize("loss", ["huber", "cauchy"])
def test_the_minimum_with_a_loss_is_gtsams(loss):
    """Among outliers, where the estimate without a loss is another one; in as many steps."""
    block = block_of_runs("outliers", "outliers-5pc", 0, 2)
    robust = choose(f"factor-graph[mode=batch,loss={loss}]").estimator
    found, plain = robust.estimate_block(block), batch_smoother.smoother(block, MOST)
    reference = choose(f"gtsam[mode=batch,loss={loss}]").estimator
    sigma = np.sqrt(np.diag(block.prior_cov))
    for run in range(block.runs):
        expected = reference.estimate(block.problem(run), np.random.default_rng(0))
        assert found.info["error"][run] == pytest.approx(expected.info["error"], rel=1e-9)
        assert found.info["iterations"][run] == expected.info["iterations"]
        apart = np.abs((found.mean[run] - expected.mean) / sigma).max()
        assert apart < 1e-6 and np.abs((plain[0][run] - expected.mean) / sigma).max() > 1e-3
        covs = np.abs((found.cov[run] - expected.cov) / np.outer(sigma, sigma)).max()
        assert covs < 1e-6


@pytest.mark.parametrize("most", [1, 2, MOST])
def test_of_any_prior_and_any_noise_the_minimum_is_gtsams(most):
    """A mean that is not zero, and states and channels that correlate.

    From the first step on; after the second, a last one that is too small to be judged is left.
    """
    block = entangled(block_of_runs("wang2013", "0.01E-0.2Hz", 0, 1))
    mean, cov, counters = batch_smoother.smoother(block, most)
    reference = choose(f"gtsam[mode=batch,max_iterations={most}]").estimator
    expected = reference.estimate(block.problem(0), np.random.default_rng(0))
    assert counters["error"][0] == pytest.approx(expected.info["error"], rel=1e-9)
    sigma = np.sqrt(np.diag(block.prior_cov))
    assert np.abs((mean[0] - expected.mean) / sigma).max() < 1e-7
    assert np.abs((cov[0] - expected.cov) / np.outer(sigma, sigma)).max() < 1e-8


def test_without_any_reading_the_search_ends_where_it_begins():
    """At the undisturbed motion from the prior's mean, after one look at the map."""
    block = entangled(block_of_runs("wang2013", "0.01E-0.2Hz", 0, 1))
    gain, offset = (read_only(np.zeros_like(a)) for a in (block.model.gain, block.model.offset))
    empty = dataclasses.replace(
        block,
        measurements=np.zeros_like(block.measurements),
        model=dataclasses.replace(block.model, gain=gain, offset=offset),
    )
    mean, cov, counters = batch_smoother.smoother(empty, MOST)
    expected, expected_cov = propagated(empty.problem(0))
    sigma = np.sqrt(np.diagonal(expected_cov, axis1=1, axis2=2))
    assert np.abs((mean[0] - expected) / sigma).max() < 1e-12
    both = sigma[:, :, np.newaxis] * sigma[:, np.newaxis]
    assert np.abs((cov[0] - expected_cov) / both).max() < 1e-9
    assert {name: float(values[0]) for name, values in counters.items()} == {
        "iterations": 0, "error": 0.0, "map_evaluations": block.epochs,
    }  # fmt: skip


def test_a_group_begins_without_what_another_left():
    """Neither its costs nor its damping: after eight runs of which one is cut short, as alone.

    A run whose search begins at its minimum would go on if it began with the cost of another.
    """
    block = block_of_runs("wang2013", "0.01E-0.2Hz", 0, 10)
    measurements = block.measurements.copy()
    measurements[0, 5] += 300.0
    still = block.problem(9)
    nothing = np.zeros(block.dimension)
    measurements[9] = [still.model.predict(k, nothing) for k in range(block.epochs)]
    odd = dataclasses.replace(block, measurements=measurements)
    mean, cov, counters = batch_smoother.smoother(odd, 3)
    assert counters["map_evaluations"][0] > (1 + 3) * block.epochs  # it was damped
    for run in (8, 9):
        alone = batch_smoother.smoother(block_of(odd.problem(run)), 3)
        np.testing.assert_array_equal(mean[run], alone[0][0])
        np.testing.assert_array_equal(cov[run], alone[1][0])
        for name, values in alone[2].items():
            assert counters[name][run] == values[0]


def test_a_run_does_not_depend_on_its_neighbours():
    """Alone, in three and in eleven (the last group not full), shifted by one: the same bits."""
    whole = batch_smoother.smoother(block_of_runs("wang2013", "0.01E-0.2Hz", 0, 11), MOST)
    for first, last in ((0, 1), (4, 7), (1, 11)):
        part = batch_smoother.smoother(block_of_runs("wang2013", "0.01E-0.2Hz", first, last), MOST)
        np.testing.assert_array_equal(part[0], whole[0][first:last])
        np.testing.assert_array_equal(part[1], whole[1][first:last])
        for name, values in part[2].items():
            np.testing.assert_array_equal(values, whole[2][name][first:last])


def test_steps_that_need_damping_are_gtsams():
    """Where undamped steps fail the search is GTSAM's: as many steps to the same cost."""
    block = block_of_runs("jacksboro_drone", "1E", 1, 2)
    mean, cov, counters = batch_smoother.smoother(block, MOST)
    reference = REFERENCE.estimate(block.problem(0), np.random.default_rng(0))
    expected = reference.info
    assert counters["map_evaluations"][0] > (1 + counters["iterations"][0]) * block.epochs
    assert counters["iterations"][0] == expected["iterations"]
    assert counters["error"][0] == pytest.approx(expected["error"], rel=1e-6)
    sigma = np.sqrt(np.diag(block.prior_cov))
    assert np.abs((mean[0] - reference.mean) / sigma).max() < 1e-2
    assert np.abs((cov[0] - reference.cov) / np.outer(sigma, sigma)).max() < 1e-6


@pytest.mark.parametrize("most", [3, 5])
def test_a_search_that_is_cut_short_while_it_is_damped_is_gtsams(most):
    """An outlier of 300 E: means, and covariances in which no damping is left."""
    block = block_of_runs("wang2013", "0.01E-0.2Hz", 0, 1)
    measurements = block.measurements.copy()
    measurements[0, 5] += 300.0
    odd = dataclasses.replace(block, measurements=measurements)
    mean, cov, counters = batch_smoother.smoother(odd, most)
    assert counters["map_evaluations"][0] > (1 + most) * block.epochs  # steps were refused
    reference = choose(f"gtsam[mode=batch,max_iterations={most}]").estimator
    expected = reference.estimate(odd.problem(0), np.random.default_rng(0))
    assert counters["iterations"][0] == expected.info["iterations"] == most
    sigma = np.sqrt(np.diag(block.prior_cov))
    assert np.abs((mean[0] - expected.mean) / sigma).max() < 1e-5
    assert np.abs((cov[0] - expected.cov) / np.outer(sigma, sigma)).max() < 1e-9


def test_a_search_that_gives_up_has_no_answer():
    """Where no step lowers the cost there is no estimate; the others have theirs, bit by bit."""
    block = block_of_runs("wang2013", "0.01E-0.2Hz", 0, 3)
    measurements = block.measurements.copy()
    measurements[1, 5] = 1e12
    odd = dataclasses.replace(block, measurements=measurements)
    mean, _, counters = batch_smoother.smoother(odd, MOST)
    usual, _, _ = batch_smoother.smoother(block, MOST)
    assert counters["iterations"].tolist()[1] == 0
    assert np.isnan(mean[1]).all()
    with pytest.raises(RuntimeError, match="gave up at its first step"):
        REFERENCE.estimate(odd.problem(1), np.random.default_rng(0))
    np.testing.assert_array_equal(mean[[0, 2]], usual[[0, 2]])


def test_damping_of_a_neighbour_changes_nothing():
    """A run that needs no damping is solved in company of one that does as alone: the same bits."""
    whole = batch_smoother.smoother(block_of_runs("jacksboro_drone", "1E", 0, 3), MOST)
    epochs = block_of_runs("jacksboro_drone", "1E", 0, 3).epochs
    damped = whole[2]["map_evaluations"] > (1 + whole[2]["iterations"]) * epochs
    assert damped[1]
    assert not damped.all()
    for run in range(3):
        alone = batch_smoother.smoother(block_of_runs("jacksboro_drone", "1E", run, run + 1), MOST)
        for one, all_of_them in zip(alone[:2], whole[:2], strict=True):
            np.testing.assert_array_equal(one[0], all_of_them[run])
