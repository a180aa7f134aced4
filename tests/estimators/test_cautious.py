"""The oracles of gated and underweighted updates: rejected measurements, and covariances."""

from __future__ import annotations

import numpy as np
import pytest
from oracles import reference
from problems import LinearModel, deviation, linear_problem, noisy_problem, rng

from ggbench.problem import Problem

LABELS = ("ekf", "ukf", "ukf[points=cubature]")


def underweighted(problem: Problem, beta: float) -> tuple[np.ndarray, np.ndarray]:
    """The Kalman filter with S = (1 + β) H P Hᵀ + R; P is the covariance of a linear estimate.

    By the errors' own propagation: e⁺ = (I − K H) e − K v, with independent e and v.
    """
    x, p = problem.prior_mean, problem.prior_cov
    means, covs = [], []
    for k in range(problem.epochs):
        phi = problem.transition[k]
        x, p = phi @ x, phi @ p @ phi.T + problem.process_cov[k]
        h, r = problem.model.rows[k], problem.noise_of(k)
        gain = np.linalg.solve((1.0 + beta) * h @ p @ h.T + r, h @ p).T
        x = x + gain @ (problem.measurements[k] - h @ x)
        roots = [np.linalg.cholesky(p), np.linalg.cholesky(r)]
        left = np.hstack([(np.eye(len(x)) - gain @ h) @ roots[0], -gain @ roots[1]])
        p = left @ left.T
        means.append(x)
        covs.append(p)
    return np.array(means), np.array(covs)


@pytest.mark.parametrize("beta", [1e-12, 0.2, 5.0])
@pytest.mark.parametrize("label", LABELS)
def test_an_underweighted_filter_claims_the_error_that_it_has(label, beta):
    """On a linear problem mean and covariance are those of its gain, to 1e-9 of the deviations.

    With β → 0 that is the Kalman filter.
    """
    problem = linear_problem(seed=3)
    found = reference(label, underweighting=beta).estimate(problem, rng())
    assert max(deviation(found.mean, found.cov, *underweighted(problem, beta))) < 1e-9
    plain = reference(label).estimate(problem, rng())
    same = max(deviation(found.mean, found.cov, plain.mean, plain.cov)) < 1e-9
    assert same == (beta < 1e-9)
    more = np.linalg.eigvalsh(found.cov[-1] - plain.cov[-1]) / np.trace(plain.cov[-1])
    assert more.min() > -1e-9  # no gain claims less than the optimal one


@pytest.mark.long
@pytest.mark.parametrize("label", LABELS[:2])
def test_a_gate_rejects_good_readings_as_often_as_it_says(label):
    """A tenth of 2000 good readings, two channels each.

    Binomial, 200 ± 13; the limits are 4 deviations, a false alarm in 16,000 seeds.
    """
    problem = noisy_problem(seed=1, epochs=2000)
    rejected = reference(label, gate=0.9).estimate(problem, rng()).info["rejected"]
    assert abs(rejected - 200.0) < 4.0 * 13.4


def place(reading: float) -> Problem:
    """One reading, of variance 1, of a state known to as much."""
    return Problem(
        times=np.ones(1),
        measurements=np.array([[reading]]),
        noise_cov=np.eye(1),
        transition=np.eye(1)[None],
        process_cov=np.zeros((1, 1, 1)),
        prior_mean=np.zeros(1),
        prior_cov=np.eye(1),
        model=LinearModel(np.ones((1, 1, 1))),
        layout=(),
    )


@pytest.mark.parametrize("label", LABELS)
def test_a_gate_is_as_wide_as_the_innovations_that_the_gain_expects(label):
    """At 95 % it is 1.96 of their deviations: √2, and √3 with β = 1.

    What passes leaves a variance of ½, or (2/3)² + (1/3)² with β = 1.
    """
    for beta, expected, left in ((0.0, np.sqrt(2.0), 1.0 / 2.0), (1.0, np.sqrt(3.0), 5.0 / 9.0)):
        for size, rejected in ((1.9, 0), (2.0, 1)):
            problem = place(-size * expected)
            solver = reference(label, gate=0.95, underweighting=beta)
            found = solver.estimate(problem, rng())
            assert found.info["rejected"] == rejected
            assert (abs(found.mean[0, 0]) < 1e-12) == bool(rejected)
            assert found.cov[0, 0, 0] == pytest.approx(1.0 if rejected else left)


def test_without_a_gate_nothing_is_said_of_rejected_readings():
    """It is an item of those that have one."""
    problem = linear_problem(0)
    assert "rejected" not in reference("ekf").estimate(problem, rng()).info
    assert "rejected" in reference("ekf", gate=0.99).estimate(problem, rng()).info
