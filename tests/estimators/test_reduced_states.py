"""Problems of some of the states, and filters of them beside filters of the whole."""

from __future__ import annotations

import numpy as np
import pytest
from problems import (
    changed,
    deviation,
    estimator,
    kalman,
    linear_problem,
    propagated,
    refusal,
    rng,
    simulated,
)
from rough_field import rough_flight
from thinning import thinned

from ggbench.estimators.reduced_states import FILTERS
from ggbench.problem import Estimate, Fixes, Problem
from ggbench.reduced import drifting, horizontal, reduced, walking
from ggbench.sensors.model import SensorModel

KEPT = (0, 1, 2)


def decoupled(seed: int) -> Problem:
    """The linear problem, whose constant states neither move the others nor are measured."""
    problem = linear_problem(seed)
    transition = problem.transition.copy()
    transition[:, :3, 3:] = 0.0
    rows = problem.model.rows.copy()
    rows[:, :, 3:] = 0.0
    prior = problem.prior_cov.copy()
    prior[:3, 3:] = prior[3:, :3] = 0.0
    model = type(problem.model)(rows)
    return changed(problem, transition=transition, prior_cov=prior, model=model)


@pytest.mark.parametrize("seed", range(3))
def test_where_nothing_is_left_out_the_answer_is_that_of_the_whole(seed):
    """States that neither move nor are measured: reduced and embedded, Kalman's to 1e-9."""
    problem = decoupled(seed)
    reduction = reduced(problem, KEPT, np.zeros((problem.epochs, 3, 3)))
    found = reduction.embedded(estimator("ekf").estimate(reduction.problem, rng()))
    mean, cov, _, _ = kalman(problem)
    assert max(deviation(found.mean, found.cov, mean, cov)) < 1e-9
    # With noise that is declared beside the problem's own it is another answer.
    noise = np.tile(1e4 * np.eye(3), (problem.epochs, 1, 1))
    other = reduced(problem, KEPT, noise)
    found = other.embedded(estimator("ekf").estimate(other.problem, rng()))
    assert max(deviation(found.mean, found.cov, mean, cov)) > 0.1


def test_two_states_go_through_the_kernels_as_through_a_framework():
    """The kernels' tiles have three rows: with two states they once wrote outside their arrays."""
    problem, _ = simulated("0.01E-0.2Hz")
    of_two = reduced(
        problem, horizontal(problem, velocity=False), walking(problem.times, 1.0)
    ).problem
    assert of_two.dimension == 2 and isinstance(of_two.model, SensorModel)
    found, expected = (
        estimator(label).estimate(of_two, rng()) for label in ("ekf", "filterpy-ekf")
    )
    assert found.mean.shape == (problem.epochs, 2) and found.cov is not None
    assert max(deviation(found.mean, found.cov, expected.mean, expected.cov)) < 1e-6


def test_states_left_out_keep_their_prior():
    """Carried along without a reading, and without correlation with those that are estimated."""
    problem = linear_problem(1)
    reduction = reduced(problem, (0, 2), np.zeros((problem.epochs, 2, 2)))
    found = reduction.embedded(estimator("ekf").estimate(reduction.problem, rng()))
    mean, cov = propagated(problem)
    others = [1, 3, 4]
    np.testing.assert_allclose(found.mean[:, others], mean[:, others], rtol=1e-10)
    block = np.ix_(range(problem.epochs), others, others)
    np.testing.assert_allclose(found.cov[block], cov[block], rtol=1e-7)
    assert not found.cov[:, 0, 1].any()
    assert not found.cov[:, 3, 2].any()
    assert np.isnan(found.nis).all()  # of a filter whose innovations are not the whole problem's


@pytest.mark.parametrize("velocity", [False, True])
def test_the_model_of_an_ins_is_the_same_compiled_and_not(velocity):
    """Reduced states have the h and H of the whole state with the others zero (1e-9 E)."""
    problem, _ = simulated("0.01E-1Hz-unfiltered")
    states = horizontal(problem, velocity)
    assert states == ((0, 1, 3, 4) if velocity else (0, 1))
    count = len(states)
    made = reduced(problem, states, np.zeros((problem.epochs, count, count))).problem
    assert isinstance(made.model, SensorModel)
    generator = np.random.default_rng(1)
    x = generator.normal(size=(7, count)) * np.sqrt(np.diag(made.prior_cov))
    whole = np.zeros((7, problem.dimension))
    whole[:, states] = x
    for k in (0, 5):
        np.testing.assert_allclose(
            made.model.predict(k, x), problem.model.predict(k, whole), rtol=0.0, atol=1e-9
        )
        np.testing.assert_allclose(
            made.model.jacobian(k, x), problem.model.jacobian(k, whole)[..., states], atol=1e-15
        )
    # About a mean that is not zero there are no such kernels; the model is the same.
    moved = changed(problem, prior_mean=np.full(problem.dimension, 1e-3))
    other = reduced(moved, states, np.zeros((problem.epochs, count, count)))
    whole = other.mean[5] + np.zeros((7, problem.dimension))
    whole[:, states] += x
    np.testing.assert_allclose(
        other.problem.model.predict(5, x), problem.model.predict(5, whole), rtol=0.0, atol=1e-9
    )


def test_declared_noise_is_that_of_white_velocities_and_accelerations():
    """Steps of 10 and 30 s: composed of steps of half their length, it is the same."""
    times = np.array([10.0, 40.0])
    halves = np.array([5.0, 10.0, 25.0, 40.0])
    step = np.array([5.0, 5.0, 15.0, 15.0])
    for make, size in ((walking, 2), (drifting, 4)):
        whole, parts = make(times, 0.3), make(halves, 0.3)
        assert whole.shape == (2, size, size)
        for k in range(2):
            phi = np.eye(size)
            if size == 4:
                phi[:2, 2:] = step[2 * k + 1] * np.eye(2)
            composed = phi @ parts[2 * k] @ phi.T + parts[2 * k + 1]
            np.testing.assert_allclose(whole[k], composed, rtol=1e-12)


@thinned("name", FILTERS)
def test_every_filter_of_few_states_follows_a_flight(name):
    """Over the rough field its position ends within 300 m, where the prior's was off by 500 m.

    Constant accelerations are left out; a white one of 0.01 m²/s³ stands for them.
    """
    problem, truth = rough_flight(6, 500.0, epochs=40)
    states = "position" if name == "point-mass" else "motion"
    noise = 100.0 if name == "point-mass" else 0.01
    label = f"reduced[filter={name},states={states},noise={noise}]"
    solver = estimator(label)
    if name == "gaussian-sum":  # compiled alone, and the rough field has no kernels
        assert "needs the model of ggbench" in solver.skip(problem)
        return
    assert solver.skip(problem) is None
    found = solver.estimate(problem, rng())
    assert found.mean.shape == truth.shape
    assert found.info["map_evaluations"] > 0
    lost = np.linalg.norm(truth[-1, :2])
    assert np.linalg.norm((found.mean - truth)[-1, :2]) < min(300.0, 0.5 * lost)


def test_weights_are_those_of_the_filter():
    """Each way to weigh gives another answer, and ``mixture`` is what none named gives."""
    problem, _ = rough_flight(6, 500.0, epochs=10)
    plain, *others = (
        estimator(f"reduced[filter=unscented-particle,particles=50,noise=0.01{weights}]")
        .estimate(problem, rng())
        .mean.tobytes()
        for weights in ("", ",weights=mixture", ",weights=likelihood", ",weights=exact")
    )
    assert others[0] == plain
    assert len({plain, *others}) == 3


@pytest.mark.parametrize(
    ("setting", "reason"),
    [
        ("filter=bootstrap", "parameter 'filter' is"),
        ("noise=-1", "parameter 'noise' is"),
        ("noise=nan", "parameter 'noise' is"),
        ("noise=inf", "parameter 'noise' is"),
        ("particles=5", "ekf has no particles"),
        ("filter=unscented-particle,particles=0", "parameter 'particles' is"),
        ("filter=unscented-particle,beta=3", "has no beta"),
        ("filter=strong-tracking,beta=0.5", "parameter 'beta' is"),
        ("filter=particle,weights=exact", "particle has no weights"),
        ("filter=point-mass", "and the problem has 4"),
    ],
)
def test_settings_that_mean_nothing_are_refused(setting, reason):
    problem, _ = simulated("0.01E-1Hz-unfiltered")
    assert reason in refusal(f"reduced[{setting}]", problem)


def test_problems_without_such_states_are_refused():
    """No position in metres, or nothing beside it: a sentence, not a failure."""
    assert "no position and velocity" in (estimator("reduced").skip(linear_problem(0)) or "")


@pytest.mark.parametrize("states", [(), (0, 0), (5,), (-1,)])
def test_states_that_are_none_of_the_problem_are_an_exception(states):
    problem = linear_problem(0)
    count = len(states)
    with pytest.raises(ValueError, match="states must be different numbers from 0 to 4"):
        reduced(problem, states, np.zeros((problem.epochs, count, count)))
    with pytest.raises(ValueError, match="noise must be"):
        reduced(problem, (0, 1), np.zeros((problem.epochs, 3, 3)))


def test_fixes_of_a_reduced_problem_are_of_the_whole_one():
    """What is found as an addition to the prior's mean is a position error of the whole problem."""
    problem = linear_problem(2)
    reduction = reduced(problem, KEPT[:2], np.zeros((problem.epochs, 2, 2)))
    epochs, accepted = np.array([5, 9]), np.array([True, False])
    found = np.array([[1.0, 2.0], [-3.0, 0.5]])
    fixes = Fixes(epochs, found, np.tile(np.eye(2), (2, 1, 1)), accepted, np.array([12.0, 3.0]))
    mean = np.zeros((problem.epochs, 2))
    whole = reduction.embedded(Estimate(mean, None, "filter", fixes=fixes)).fixes
    carried, _ = propagated(problem)
    np.testing.assert_allclose(whole.mean, carried[epochs, :2] + found, rtol=1e-12)
    assert len(whole) == 2
    assert whole.accepted is accepted
