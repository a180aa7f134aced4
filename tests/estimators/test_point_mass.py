"""The point-mass filter: the truth of problems with two states, which others are held to."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from oracles import solver
from problems import changed, estimator, evidence, kalman, noisy_problem, refusal, rng
from rough_field import rough_flight

from ggbench.estimators.point_mass import PointMass, peak_cells
from ggbench.problem import Estimate, Problem
from ggbench.reduced import horizontal, reduced, walking


def distance(estimate: Estimate, mean: np.ndarray, cov: np.ndarray) -> float:
    """Distance of means, rms in deviations of a covariance."""
    variance = np.diagonal(cov, axis1=1, axis2=2)
    return float(np.sqrt(np.mean((estimate.mean - mean) ** 2 / variance)))


@pytest.mark.parametrize(
    ("n", "noise"),
    [
        pytest.param(n, noise, marks=pytest.mark.long if n == 3 else ())
        for n in (1, 2, 3)
        for noise in ("full", "singular", "none")
    ],
)
def test_the_kalman_filter_of_a_linear_problem(n, noise):
    """Mean to 2e-3 deviations, covariance to 5e-3, evidence to 0.01, whatever the process noise.

    That of rank one and none at all, too: the grid is moved with the states, and smears nothing.
    """
    problem = noisy_problem(1, epochs=12, n=n)
    root = np.linalg.cholesky(problem.process_cov)[:, :, :1]
    if noise == "singular":
        problem = changed(problem, process_cov=root @ root.transpose(0, 2, 1))
    elif noise == "none":
        problem = changed(problem, process_cov=np.zeros_like(problem.process_cov))
    found = PointMass().estimate(problem, rng())
    mean, cov, _, _ = kalman(problem)
    assert distance(found, mean, cov) < 2e-3
    sigma = np.sqrt(np.diagonal(cov, axis1=1, axis2=2))
    off = np.abs(found.cov - cov) / (sigma[:, :, None] * sigma[:, None, :])
    assert off.max() < 5e-3
    assert found.info["log_evidence"] == pytest.approx(evidence(problem), abs=0.01)


@functools.cache
def two_states(noise: float) -> Problem:
    """A flight over a rough field that is lost by a quarter of its correlation length."""
    problem, _ = rough_flight(4, 500.0, epochs=30, noise=noise)
    reduction = reduced(problem, horizontal(problem, velocity=False), walking(problem.times, 1.0))
    return reduction.problem


@functools.cache
def truth(noise: float, resolution: float = 4.0) -> Estimate:
    return PointMass(step=20.0, resolution=resolution).estimate(two_states(noise), rng())


@pytest.mark.long
@pytest.mark.parametrize("noise", [1.0, 10.0])
def test_a_finer_grid_changes_nothing(noise):
    """Two cells to a deviation, and four: means within 0.05 deviations rms of each other."""
    coarse, fine = truth(noise, 2.0), truth(noise, 4.0)
    assert distance(coarse, fine.mean, fine.cov) < 0.05
    assert coarse.info["log_evidence"] == pytest.approx(fine.info["log_evidence"], abs=0.1)
    assert fine.info["mean_points"] > 2.0 * coarse.info["mean_points"]


@pytest.mark.long
@pytest.mark.parametrize(
    ("label", "limit"),
    [
        ("gaussian-sum", 0.1),
        ("unscented-particle[particles=5000]", 0.1),
        ("gaussian-particle", 0.15),
        ("particle[particles=100000]", 0.1),
    ],
)
def test_other_filters_are_held_to_it(label, limit):
    """Two states, a noise of the field's own size: means near the grid's, rms in its deviations.

    The particles scatter by some 0.05; a bank of Gaussians on a grid does not, but for what h bends
    over each of them.
    """
    grid = truth(10.0)
    found = solver(label).estimate(two_states(10.0), rng())
    assert distance(found, grid.mean, grid.cov) < limit


@pytest.mark.long
@pytest.mark.parametrize("count", [10_000, 100_000], ids=str)
def test_log_evidence_of_particles_is_the_grids(count):
    """To 0.3, so that models can be compared by it: 0.15 off with 10^4, 0.035 with 10^5 (measured).

    Told three times the noise the readings are less likely by far more than that.
    """
    grid, problem = truth(10.0).info["log_evidence"], two_states(10.0)
    filtering = estimator(f"particle[particles={count}]")
    found = filtering.estimate(problem, rng()).info["log_evidence"]
    assert found == pytest.approx(grid, abs=0.3)
    wrong = changed(problem, noise_cov=9.0 * problem.noise_cov)
    assert filtering.estimate(wrong, rng()).info["log_evidence"] < grid - 10.0


@pytest.mark.long
def test_a_filter_that_is_told_another_noise_is_seen():
    """The comparison above is not blind: three times the noise moves the mean beyond its limits."""
    grid, problem = truth(10.0), two_states(10.0)
    wrong = changed(problem, noise_cov=9.0 * problem.noise_cov)
    assert distance(solver("gaussian-sum").estimate(wrong, rng()), grid.mean, grid.cov) > 0.2


def test_two_hills_that_look_alike_stay_two():
    """What no Gaussian holds: readings of a square have two peaks, and their mean lies between."""

    class Square:
        def predict(self, k, x):
            return np.asarray(x) ** 2

        def jacobian(self, k, x):
            return 2.0 * np.asarray(x)[..., None]

    problem = changed(
        noisy_problem(0, epochs=3, n=1, m=1),
        model=Square(),
        prior_cov=np.array([[9.0]]),
        measurements=np.full((3, 1), 4.0),
        noise_cov=np.array([[0.1]]),
        transition=np.ones((3, 1, 1)),
        process_cov=np.zeros((3, 1, 1)),
    )
    found = PointMass(step=0.05).estimate(problem, rng())
    assert found.mean[-1, 0] == pytest.approx(0.0, abs=1e-6)
    assert found.cov[-1, 0, 0] == pytest.approx(4.0, rel=0.02)


def test_the_peak_is_measured_in_cells():
    """A Gaussian of three and five cells; at the margin of the grid nothing is known."""
    i, j = np.indices((41, 41))
    density = np.exp(-0.5 * (((i - 20) / 3.0) ** 2 + ((j - 40) / 5.0) ** 2))
    np.testing.assert_allclose(peak_cells(density), [3.0, np.inf])


@pytest.mark.parametrize(
    ("setting", "reason"),
    [
        ("step=0", "parameter 'step' is"),
        ("step=nan", "parameter 'step' is"),
        ("step=1e-9", "this prior needs more than"),
        ("resolution=0.5", "parameter 'resolution' is"),
        ("resolution=nan", "parameter 'resolution' is"),
    ],
)
def test_grids_that_do_not_exist_are_refused(setting, reason):
    problem = noisy_problem(0, n=2)
    assert reason in refusal(f"point-mass[{setting}]", problem)


def test_more_states_than_a_grid_can_have_are_refused():
    """And the sentence says how to have fewer."""
    problem, _ = rough_flight(0, 100.0, epochs=3)
    assert "reduced[filter=point-mass,states=position]" in (PointMass().skip(problem) or "")
    assert PointMass(step=1.0).skip(noisy_problem(0)) is None
