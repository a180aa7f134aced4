"""One estimate beside its truth: what is said of it, and what is refused."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from small_cases import small_case, small_flight

from ggbench.campaign.registry import choose
from ggbench.judging.judgement import JudgingError, judge
from ggbench.problem import Estimate, Problem
from ggbench.simulation.runs import Truth, simulate


@pytest.fixture(scope="module")
def run() -> tuple[Problem, Estimate, Truth]:
    problem, truth = simulate(small_flight(), seed=1, run=0)
    return problem, choose("ekf").estimator.estimate(problem, np.random.default_rng(0)), truth


def test_errors_are_estimate_minus_truth(run):
    """Errors, their roots over windows, and NEES against plain linear algebra."""
    problem, estimate, truth = run
    found = judge(*run, small_case().windows)
    error = truth.error_state - estimate.mean
    position = np.linalg.norm(error[:, :3], axis=1)
    assert np.allclose(found.components, error[:, :6])
    assert np.allclose(found.position_error, position)
    assert found.position_mrse_m == pytest.approx(np.sqrt(np.mean(position**2)))
    assert found.final_velocity_error_mps == pytest.approx(np.linalg.norm(error[-1, 3:6]))
    assert found.final_position_error_m == pytest.approx(position[-1])
    assert found.windows["whole"]["nis_mean"] == pytest.approx(found.nis.mean())
    assert found.windows["whole"]["nees_mean"] == pytest.approx(found.nees.mean())
    settled = position[problem.times >= 10.0]
    mrse = np.sqrt(np.mean(settled**2))
    assert found.windows["settled"]["position_mrse_m"] == pytest.approx(mrse)
    e, p = error[7, :6], estimate.cov[7, :6, :6]
    assert found.nees[7] == pytest.approx(e @ np.linalg.solve(p, e))
    assert list(judge(*run).windows) == ["whole"]
    with pytest.raises(ValueError, match="read-only"):
        found.nees[0] = 0.0


def test_without_covariances(run):
    """Errors can be judged without; consistency is not a number, and no part of what is shown."""
    problem, estimate, truth = run
    found = judge(problem, dataclasses.replace(estimate, cov=None), truth)
    assert np.isnan(found.nees).all() and np.isnan(found.sigmas).all()
    assert np.array_equal(found.position_error, judge(*run).position_error)
    assert "NEES" not in repr(found) and "NEES" in repr(judge(*run))


def test_what_cannot_be_judged(run):
    """Whatever is of the wrong kind, shape or problem ends with a sentence."""
    problem, estimate, truth = run
    windows = small_case().windows
    late = windows.model_copy(update={"settled_from_s": 21.0})
    shifted = dataclasses.replace(truth, times=truth.times + 0.5)
    shorter = Truth(truth.times[:-1], truth.error_state[:-1])
    negative = dataclasses.replace(estimate, cov=-estimate.cov)
    bare = estimate.mean
    cases = (
        ((problem, bare, truth), "estimate must be of type Estimate, not ndarray"),
        ((problem, truth, estimate), "estimate must be of type Estimate, not Truth"),
        (
            (problem, estimate, truth, {"last_s": 1.0}),
            "windows must be of type WindowsSpec, not dict",
        ),
        (
            (problem, dataclasses.replace(estimate, mean=bare[1:]), truth),
            r"mean has shape \(19, 15",
        ),
        ((problem, dataclasses.replace(estimate, mean=bare * np.nan), truth), "is not finite"),
        ((problem, dataclasses.replace(estimate, mean=None), truth), r"mean has shape \(\), not"),
        ((problem, negative, truth), "cov is not positive definite at epoch 0"),
        (
            (problem, estimate, shorter),
            r"truth belongs to another problem: its states have shape \(19",
        ),
        (
            (problem, estimate, shifted),
            r"truth belongs to another problem: its epochs differ \(1.5 to",
        ),
        ((problem, estimate, truth, late), "must not lie beyond the last epoch, at 20 s"),
    )
    for arguments, sentence in cases:
        with pytest.raises(JudgingError, match=sentence):
            judge(*arguments)
