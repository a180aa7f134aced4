"""h and H of a whole trajectory in one call: what they are epoch by epoch, whatever the model."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from problems import LinearModel, block_of_runs, linear_problem

from ggbench.block import block_of
from ggbench.problem import AlongModel, Problem, jacobian_along, predict_along
from ggbench.sensors.model import SensorModel

AlongOf = Callable[..., np.ndarray]


def flown(name: str, case: str) -> Problem:
    """A run of a shipped scenario."""
    return block_of_runs(name, case, 3, 4).problem(0)


def states_of(problem: Problem, count: int, seed: int = 8) -> np.ndarray:
    """States (count, n) as far from zero as the prior lets expect."""
    sigma = np.sqrt(np.diag(problem.prior_cov))
    return np.random.default_rng(seed).normal(size=(count, problem.dimension)) * sigma


@pytest.mark.parametrize(
    ("name", "case"),
    [
        ("wang2013", "0.01E-0.2Hz"),
        ("gnss_outage", "gravimeter"),
        pytest.param("outliers", "dropouts", marks=pytest.mark.long),
    ],
)
def test_along_a_trajectory_is_epoch_by_epoch(name, case):
    """H in the same bits, h to its last digits, of epochs in any order; and so are the counts."""
    problem = flown(name, case)
    model = problem.model
    assert isinstance(model, SensorModel)
    at = np.random.default_rng(1).integers(0, problem.epochs, 60)
    states = states_of(problem, 60)
    for along, one, digits in (
        (model.predict_along, model.predict, 1e-14),
        (model.jacobian_along, model.jacobian, 0.0),
    ):
        before = model.evaluations
        found = along(at, states)
        assert model.evaluations == before + 60
        expected = [one(int(k), x) for k, x in zip(at, states, strict=True)]
        np.testing.assert_allclose(found, expected, rtol=digits, atol=0.0)


@pytest.mark.parametrize("count", [1, 7, 8, 9, 20])
@pytest.mark.parametrize(
    ("name", "case"), [("wang2013", "0.01E-0.2Hz"), ("gnss_outage", "gravimeter")]
)
def test_jacobians_of_many_states_are_those_of_each(name, case, count):
    """In full and in broken vectors of eight, bit for bit, with any leading axes."""
    problem = flown(name, case)
    states = states_of(problem, count)
    k = problem.epochs // 2
    found = problem.model.jacobian(k, states[np.newaxis])
    expected = [problem.model.jacobian(k, x) for x in states]
    np.testing.assert_array_equal(found, [expected])


@pytest.mark.parametrize("of", [predict_along, jacobian_along])
def test_a_model_that_takes_no_trajectories_is_asked_epoch_by_epoch(of):
    """Of one's own, which has h and H and nothing else."""
    problem = linear_problem(2)
    assert isinstance(problem.model, LinearModel)
    assert not isinstance(problem.model, AlongModel)
    states = states_of(problem, problem.epochs)
    one = problem.model.predict if of is predict_along else problem.model.jacobian
    expected = [one(k, x) for k, x in enumerate(states)]
    np.testing.assert_array_equal(of(problem.model, np.arange(problem.epochs), states), expected)


@pytest.mark.parametrize("of", [predict_along, jacobian_along])
def test_a_window_counts_its_epochs_from_its_first(of):
    """What a part of a flight takes is what the flight takes, so many epochs later."""
    problem = flown("wang2013", "0.01E-0.2Hz")
    part = block_of(problem).part(5, 15, problem.prior_mean, problem.prior_cov).problem(0)
    states = states_of(problem, 10)
    found = of(part.model, np.arange(10), states)
    np.testing.assert_array_equal(found, of(problem.model, np.arange(5, 15), states))


def test_what_is_no_trajectory_is_refused():
    """Epochs that there are not, too few states, states of another size."""
    problem = flown("wang2013", "0.01E-0.2Hz")
    model, n = problem.model, problem.dimension
    assert isinstance(model, SensorModel)
    before = model.evaluations
    for at, shape, error, text in (
        ([0, problem.epochs], (2, n), IndexError, f"no epoch {problem.epochs}"),
        ([-1, 0], (2, n), IndexError, "no epoch -1"),
        ([0, 1], (3, n), ValueError, "states must have the shape"),
        ([0, 1], (n,), ValueError, "states must have the shape"),
        ([0, 1], (2, n + 1), ValueError, "states must be"),
    ):
        for along in (model.predict_along, model.jacobian_along):
            with pytest.raises(error, match=text):
                along(np.array(at), np.zeros(shape))
    assert model.evaluations == before
    assert model.predict_along(np.zeros(0, dtype=int), np.zeros((0, n))).shape == (0, 6)
