"""Wide priors: the iterated filter, the Gaussian sum, and Gauss–Newton from many starts."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
import pytest
from oracles import solver
from oracles.gauss_newton import _Smoother
from oracles.gaussian_sum import _merged
from problems import (
    LinearModel,
    changed,
    deviation,
    estimated,
    exact,
    graded,
    kalman,
    linear_problem,
    rng,
    simulated,
    smoothed,
)
from rough_field import LENGTH, rough_flight
from scipy.stats import chi2
from thinning import thinned

from ggbench.engines.banks import split_prior
from ggbench.engines.gaussian_sum import WIDTH
from ggbench.engines.position_grid import REACH
from ggbench.problem import Estimate, Problem, StateBlock

RUNS = 10
LOST = 100.0
"""Final position error [m] of a run that has locked onto the wrong place; others have 5 m."""


@functools.cache
def wide(lengths: float) -> list[tuple[Problem, np.ndarray]]:
    """Flights with a prior of so many correlation lengths of the field."""
    return [rough_flight(seed, lengths * LENGTH, epochs=60) for seed in range(RUNS)]


each_search = pytest.mark.parametrize(
    "label", ["gaussian-sum", pytest.param("gauss-newton[starts=256]", marks=pytest.mark.long)]
)
each_width = pytest.mark.parametrize("lengths", [1.0, pytest.param(3.0, marks=pytest.mark.long)])


@functools.cache
def answers(label: str, lengths: float) -> list[Estimate]:
    return [solver(label).estimate(problem, rng()) for problem, _ in wide(lengths)]


def final_errors(label: str, lengths: float) -> np.ndarray:
    pairs = zip(answers(label, lengths), wide(lengths), strict=True)
    return np.array([np.linalg.norm((a.mean - truth)[-1, :3]) for a, (_, truth) in pairs])


@pytest.mark.parametrize("label", ["ekf[iterations=5]", "gaussian-sum[iterations=1]"])
def test_filters_of_a_linear_problem_are_kalmans(label):
    """Iterating or weighing hypotheses changes nothing where h is linear (1e-9)."""
    for seed in range(3):
        problem = linear_problem(seed)
        mean, cov, _, _ = kalman(problem)
        found = solver(label).estimate(problem, rng())
        assert max(deviation(found.mean, found.cov, mean, cov)) < 1e-9


@pytest.mark.parametrize("sharpness", [1e-3, 1e-6])
@pytest.mark.parametrize(
    "label", ["ekf", "ukf", "ukf[points=cubature]", "gaussian-sum", "gauss-newton"]
)
def test_sharp_readings_of_a_wide_prior_do_no_harm(label, sharpness):
    """With a prior a thousand or a million times wider than what a reading tells, still exact.

    To 1e-4 σ, which is what double precision leaves of covariances over twelve decades.
    """
    problem = linear_problem(0)
    problem = changed(problem, noise_cov=sharpness**2 * problem.noise_cov)
    found = solver(label).estimate(problem, rng())
    assert max(deviation(found.mean, found.cov, *exact(problem, found))) < 1e-4


def test_one_hypothesis_is_the_extended_kalman_filter():
    """A Gaussian sum of one is the EKF, plain or iterated (1e-6 σ)."""
    problem, _ = rough_flight(3, 200.0)
    for iterations in (1, 5):
        one = solver(f"gaussian-sum[iterations={iterations}]").estimate(problem, rng())
        ekf = solver(f"ekf[iterations={iterations}]").estimate(problem, rng())
        assert one.info["hypotheses"] == 1
        assert max(deviation(one.mean, one.cov, ekf.mean, ekf.cov)) < 1e-6


def test_cubature_points_are_the_scaled_set_without_scaling():
    """Arasaratnam & Haykin's 2n points are van der Merwe's with α = 1, β = 0, κ = 0 (1e-9 σ).

    And the paper's with κ = 0, which is told and not left out.
    """
    problem, _ = rough_flight(3, 500.0)
    cubature = solver("ukf[points=cubature]").estimate(problem, rng())
    scaled = solver("ukf[points=merwe,alpha=1,beta=0,kappa=0]").estimate(problem, rng())
    assert max(deviation(cubature.mean, cubature.cov, scaled.mean, scaled.cov)) < 1e-9
    papers = solver("ukf[kappa=0]").estimate(problem, rng())
    assert max(deviation(cubature.mean, cubature.cov, papers.mean, papers.cov)) < 1e-9


def update_cost(problem: Problem, x: np.ndarray) -> float:
    """Cost of the state after the first reading."""
    phi = problem.transition[0]
    off = x - phi @ problem.prior_mean
    cov = phi @ problem.prior_cov @ phi.T + problem.process_cov[0]
    residual = problem.measurements[0] - problem.model.predict(0, x)
    noise = np.linalg.solve(problem.noise_cov, residual)
    return float(0.5 * off @ np.linalg.solve(cov, off) + 0.5 * residual @ noise)


@pytest.mark.long
@thinned("lengths", [3.0, 0.5, 0.1])
def test_iterated_update_ends_in_a_minimum(lengths):
    """No step to any side lowers the cost of an iterated update, and it is never above the start.

    The plain EKF's step often is: that is why the iterated one controls its steps.
    """
    worse = 0
    for problem, _ in wide(lengths):
        x = solver("ekf[iterations=50]").estimate(problem, rng())
        lowest = update_cost(problem, x.mean[0])
        start = update_cost(problem, problem.transition[0] @ problem.prior_mean)
        assert lowest < start
        sigma = np.sqrt(np.diagonal(x.cov[0]))
        for axis in range(3):
            for side in (-0.1, 0.1):
                step = side * sigma[axis] * np.eye(problem.dimension)[axis]
                assert update_cost(problem, x.mean[0] + step) > lowest - 1e-6
        plain = solver("ekf").estimate(problem, rng()).mean[0]
        worse += update_cost(problem, plain) > start
    if lengths == 3.0:
        assert worse > 0


def test_gauss_newton_is_gtsams_batch_graph():
    """On the paper's flight both find the same trajectory and covariance (1e-4 σ)."""
    case = "0.01E-0.2Hz"
    graph = estimated(case, "factor-graph[mode=batch]")
    for label in ("gauss-newton", "gauss-newton[starts=1]"):
        ours = estimated(case, label)
        assert ours.info["cost"] == pytest.approx(graph.info["error"], rel=1e-6)
        assert max(deviation(ours.mean, ours.cov, graph.mean, graph.cov)) < 1e-4


def test_gauss_newton_keeps_constant_states_constant():
    """Process noise that is singular stays so: bias states are one number over the flight."""
    problem, _ = simulated("0.01E-0.2Hz")
    mean = estimated("0.01E-0.2Hz", "gauss-newton[starts=1]").mean[:, 9:15]
    sigma = np.sqrt(np.diag(problem.prior_cov))[9:15]
    assert (np.ptp(mean, axis=0) / sigma).max() < 1e-9


@pytest.mark.long
@each_width
@each_search
def test_many_hypotheses_find_the_place_where_one_locks(label, lengths):
    """With a prior of 1 and 3 correlation lengths the EKF loses runs; those that search do not."""
    assert (final_errors("ekf", lengths) > LOST).sum() >= (2 if lengths == 1.0 else 6)
    if lengths == 3.0:
        assert (final_errors("ekf[iterations=10]", lengths) > LOST).sum() >= 5
        assert (final_errors("gauss-newton[starts=1]", lengths) > LOST).sum() >= 5
    assert (final_errors(label, lengths) < LOST).all()


@pytest.mark.long
def test_many_starts_find_the_place_that_the_filter_has_lost():
    """Of the flights with a prior of 1 correlation length, the first in which the EKF is lost."""
    run = np.flatnonzero(final_errors("ekf", 1.0) > LOST)[0]
    problem, truth = wide(1.0)[run]
    found = solver("gauss-newton[starts=256]").estimate(problem, rng())
    assert np.linalg.norm((found.mean - truth)[-1, :3]) < LOST


def test_starts_are_spread_as_the_prior_wants_them():
    """About its mean with all correlations, and 1 + 2/d of its covariance in d dimensions.

    That is the density by which a few points leave the least mean square distance to the nearest
    (Zador 1982); for three coordinates 5/3, to 10 % with 1000 points.
    """
    problem = correlated_prior()
    smoother = _Smoother(problem, "none", np.inf)
    found = smoother.best_starts(1000, 1000)
    moved = np.array([smoother.prior_cov @ start.start for start in found])[:, :3]
    prior = smoother.prior_cov[:3, :3]
    assert np.abs(moved.mean(axis=0)).max() < 0.1
    assert np.cov(moved.T) == pytest.approx(5.0 / 3.0 * prior, abs=0.17)


def test_the_filters_track_is_the_smoothed_one():
    """The start that a filter gives is, of a linear problem, the answer already (1e-6 σ)."""
    problem = graded(linear_problem(3))
    mean, cov = smoothed(problem, problem.epochs)
    smoother = _Smoother(problem, "none", np.inf)
    found = smoother.from_filter().states * smoother.scale
    assert deviation(found, cov, mean, cov)[0] < 1e-6


def test_screening_weighs_readings_as_the_cost_does():
    """From some of many epochs, the cost that all of them have beside the prior's: to 30 %."""
    problem = linear_problem(5, epochs=600)
    smoother = _Smoother(problem, "none", np.inf)
    screened = smoother.screened_costs(np.zeros((1, problem.dimension)))[0]
    undisturbed = smoother.from_prior(np.zeros(problem.dimension))
    whole = smoother.cost(undisturbed, smoother.residuals(undisturbed.states))
    assert screened == pytest.approx(whole, rel=0.3)


@pytest.mark.parametrize("loss", ["none", "huber"])
def test_screening_by_all_readings_is_the_cost(loss):
    """Of few epochs none is left out: prior and readings count as they do in the search."""
    problem = graded(linear_problem(5, epochs=10))
    smoother = _Smoother(problem, loss, 1.345)
    starts = np.random.default_rng(6).normal(size=(4, problem.dimension))
    costs = []
    for start in starts:
        undisturbed = smoother.from_prior(start)
        costs.append(smoother.cost(undisturbed, smoother.residuals(undisturbed.states)))
    np.testing.assert_allclose(smoother.screened_costs(starts), costs, rtol=1e-9)


def test_where_readings_say_nothing_the_prior_ranks_the_starts():
    """Over a field of nothing the best start is the prior's mean, then the nearest to it."""
    problem = correlated_prior()
    m = problem.measurements.shape[1]
    rows = np.zeros((problem.epochs, m, problem.dimension))
    smoother = _Smoother(changed(problem, model=LinearModel(rows)), "none", np.inf)
    distances = [s.start @ smoother.prior_cov @ s.start for s in smoother.best_starts(200, 200)]
    assert distances[0] == 0.0
    assert (np.diff(distances) > -1e-9).all() and distances[-1] > 5.0


@pytest.mark.long
def test_more_starts_never_end_higher():
    """The lowest minimum from 256 starts is never above the one from the prior's mean."""
    many, single = answers("gauss-newton[starts=256]", 3.0), answers("gauss-newton[starts=1]", 3.0)
    for several, one in zip(many, single, strict=True):
        assert several.info["cost"] < one.info["cost"] + 1e-3


@pytest.mark.long
def test_the_answer_is_the_lowest_that_a_search_has_found():
    """From the prior's mean and from a filter's track, whichever of them ends lower."""
    lower = set()
    for problem, _ in wide(3.0)[-3:-1]:
        found = solver("gauss-newton[starts=1]").estimate(problem, rng())
        smoother = _Smoother(problem, "none", np.inf)
        starts = smoother.from_prior(np.zeros(problem.dimension)), smoother.from_filter()
        costs = [smoother.search(start, 30).cost for start in starts]
        lower.add(int(np.argmin(costs)))
        assert found.info["cost"] == pytest.approx(min(costs))
    assert lower == {0, 1}


@pytest.mark.long
@each_width
@each_search
def test_errors_at_wide_priors_are_those_that_the_covariance_tells(label, lengths):
    """The NEES of the final position over the runs lies within χ² limits (false alarms 1e-4)."""
    total = 0.0
    for answer, (_, truth) in zip(answers(label, lengths), wide(lengths), strict=True):
        error = (answer.mean - truth)[-1, :3]
        total += error @ np.linalg.solve(answer.cov[-1, :3, :3], error)
    low, high = chi2.ppf([5e-5, 1.0 - 5e-5], 3 * RUNS)
    assert low < total < high


def correlated_prior() -> Problem:
    problem, _ = rough_flight(0, 1500.0, epochs=2)
    root = np.diag(np.sqrt(np.diag(problem.prior_cov)))
    root = root @ (np.eye(9) + 0.3 * np.tril(np.ones((9, 9)), -1))
    return changed(problem, prior_cov=root @ root.T, prior_mean=np.arange(9.0))


def test_the_grid_of_gaussians_is_the_prior():
    """Mean, covariance with all correlations, and density of the sum are the prior's.

    The density to 1 % of its largest value, at random points.
    """
    problem = correlated_prior()
    scale = np.sqrt(np.diag(problem.prior_cov))
    weights, means, covs = split_prior(problem, 500.0, 10_000, WIDTH)
    assert len(weights) > 100
    away = means[:, :3] - (problem.prior_mean / scale)[:3]
    distance = np.linalg.solve(problem.prior_cov[:3, :3], (away * scale[:3]).T)
    assert ((away * scale[:3]).T * distance).sum(axis=0).max() < REACH**2 + 1e-9  # an ellipsoid
    share = np.exp(weights) / np.exp(weights).sum()
    mean = share @ means
    off = means - mean
    cov = np.einsum("j,jab->ab", share, covs) + (off.T * share) @ off
    assert np.abs(mean - problem.prior_mean / scale).max() < 1e-6
    assert np.abs(cov - problem.prior_cov / np.outer(scale, scale)).max() < 0.02
    assert np.linalg.eigvalsh(covs[0])[0] > 0.0

    def density(x: np.ndarray, at: np.ndarray, spread: np.ndarray) -> np.ndarray:
        distance = np.einsum("ji,ji->j", x - at, np.linalg.solve(spread, (x - at).T).T)
        return np.exp(-0.5 * distance) / np.sqrt(np.linalg.det(spread))

    prior = problem.prior_cov / np.outer(scale, scale)
    centre = problem.prior_mean / scale
    peak = density(centre[None], centre, prior)[0]
    for x in np.random.default_rng(1).multivariate_normal(centre, prior, size=50):
        total = share @ density(x, means, covs[0])
        assert abs(total - density(x[None], centre, prior)[0]) < 0.01 * peak


@pytest.mark.parametrize("spacing", [1e-300, 1e-3, 100.0])
@pytest.mark.parametrize("most", [1, 100, 2000])
def test_grid_is_made_coarser_to_fit(spacing, most):
    """Never more hypotheses than asked for, and not far fewer where the spacing asks for more."""
    problem = correlated_prior()
    count = len(split_prior(problem, spacing, most, WIDTH)[0])
    assert most / 4 <= count <= most


@dataclass(frozen=True)
class Periodic:
    """A field that repeats itself every 1000 m: no reading can tell one place from the next."""

    def predict(self, k: int, x: np.ndarray) -> np.ndarray:
        phase = 2.0 * np.pi * np.asarray(x)[..., :1] / 1000.0
        return np.concatenate([np.sin(phase), np.cos(phase)], axis=-1)

    def jacobian(self, k: int, x: np.ndarray) -> np.ndarray:
        phase = 2.0 * np.pi * x / 1000.0
        return 2.0 * np.pi / 1000.0 * np.stack([np.cos(phase), -np.sin(phase)], axis=-2)


def test_a_mixture_admits_that_it_does_not_know():
    """Where the field repeats itself, the covariance still holds all the places that fit.

    A prior of 2000 m over a period of 1000 m leaves about 2000 m; the EKF claims centimetres.
    """
    epochs = 20
    problem = Problem(
        times=np.arange(1.0, epochs + 1.0),
        measurements=np.tile([0.6, 0.8], (epochs, 1)),
        noise_cov=1e-4 * np.eye(2),
        transition=np.ones((epochs, 1, 1)),
        process_cov=np.zeros((epochs, 1, 1)),
        prior_mean=np.zeros(1),
        prior_cov=np.array([[4e6]]),
        model=Periodic(),
        layout=(StateBlock("position", slice(0, 1), "m"),),
    )
    mixture = solver("gaussian-sum[spacing_m=100]").estimate(problem, rng())
    assert np.sqrt(mixture.cov[-1, 0, 0]) == pytest.approx(2000.0, rel=0.05)
    assert np.sqrt(solver("ekf").estimate(problem, rng()).cov[-1, 0, 0]) < 1.0


@dataclass(frozen=True)
class Hill:
    """A field with one summit, steep before it and gentle behind: each reading fits two places."""

    def predict(self, k: int, x: np.ndarray) -> np.ndarray:
        x = np.asarray(x)
        return np.where(x < 0.0, np.exp(x / 300.0), np.exp(-x / 1200.0))

    def jacobian(self, k: int, x: np.ndarray) -> np.ndarray:
        length = np.where(x < 0.0, 300.0, -1200.0)
        return (self.predict(k, x) / length)[..., None]


@pytest.mark.parametrize("reading", [0.3, 0.5, 0.7])
def test_hypotheses_weigh_as_much_as_bayes_gives_them(reading):
    """After one reading, mean and deviation are those of the density, integrated numerically.

    Where the field is gentle, more places fit than where it is steep: of equally good hypotheses
    the one with the smaller gradient weighs more. To 2 % of the deviation.
    """
    sigma, noise = 1000.0, 0.01
    problem = Problem(
        times=np.ones(1),
        measurements=np.array([[reading]]),
        noise_cov=np.array([[noise**2]]),
        transition=np.eye(1)[None],
        process_cov=np.zeros((1, 1, 1)),
        prior_mean=np.zeros(1),
        prior_cov=np.array([[sigma**2]]),
        model=Hill(),
        layout=(StateBlock("position", slice(0, 1), "m"),),
    )
    x = np.linspace(-5.0 * sigma, 5.0 * sigma, 200_001)
    off = (reading - Hill().predict(0, x)) / noise
    density = np.exp(-0.5 * (x / sigma) ** 2 - 0.5 * off**2)
    density /= density.sum()
    mean = density @ x
    deviation = np.sqrt(density @ (x - mean) ** 2)
    found = solver("gaussian-sum[spacing_m=50,iterations=10]").estimate(problem, rng())
    assert found.mean[0, 0] == pytest.approx(mean, abs=0.02 * deviation)
    assert np.sqrt(found.cov[0, 0, 0]) == pytest.approx(deviation, rel=0.02)


@pytest.mark.parametrize("iterations", [1, 3])
def test_many_hypotheses_of_a_linear_problem_are_kalmans(iterations):
    """Weighing twenty narrow Gaussians by ten blunt readings is one Gaussian's filter (to 3 %)."""
    generator = np.random.default_rng(12)
    epochs = 10
    problem = Problem(
        times=np.arange(1.0, epochs + 1.0),
        measurements=3.0 + 4.0 * generator.standard_normal((epochs, 1)),
        noise_cov=np.array([[16.0]]),
        transition=np.ones((epochs, 1, 1)),
        process_cov=np.zeros((epochs, 1, 1)),
        prior_mean=np.zeros(1),
        prior_cov=np.array([[1e6]]),
        model=LinearModel(np.full((epochs, 1, 1), 0.004)),
        layout=(StateBlock("position", slice(0, 1), "m"),),
    )
    mean, cov, _, _ = kalman(problem)
    found = solver(f"gaussian-sum[spacing_m=300,iterations={iterations}]").estimate(problem, rng())
    assert found.info["hypotheses"] > 20
    assert max(deviation(found.mean, found.cov, mean, cov)) < 0.03


def test_merging_keeps_the_moments():
    """What a crowd of hypotheses says together, its mean and covariance, it says merged."""
    generator = np.random.default_rng(5)
    count, n = 60, 3
    weights = np.log(generator.uniform(0.1, 1.0, count))
    means = 0.8 * generator.standard_normal((count, n))
    roots = generator.standard_normal((count, n, n)) * 0.3 + np.eye(n)
    covs = roots @ roots.transpose(0, 2, 1)

    def moments(weights, means, covs) -> tuple[float, np.ndarray, np.ndarray]:
        share = np.exp(weights)
        total = share.sum()
        share = share / total
        mean = share @ means
        off = means - mean
        return total, mean, np.einsum("j,jab->ab", share, covs) + (off.T * share) @ off

    merged = _merged(weights, means, covs)
    assert 1 < len(merged[0]) < count / 2
    for before, after in zip(moments(weights, means, covs), moments(*merged), strict=True):
        assert after == pytest.approx(before, rel=1e-12, abs=1e-12)


@pytest.mark.parametrize(("light_sigma", "left"), [(10.0, 2), (1.0, 1), (0.1, 1)])
def test_the_heavier_of_two_hypotheses_says_whether_they_are_one(light_sigma, left):
    """It takes in what lies within its own deviations; a light wide one takes in no heavy one."""
    distance = 2.0 if light_sigma > 1.0 else 0.9
    means, covs = np.array([[0.0], [distance]]), np.array([1.0, light_sigma**2])[:, None, None]
    assert len(_merged(np.log([0.9, 0.1]), means, covs)[0]) == left


@pytest.mark.parametrize(
    "label",
    ["gaussian-sum", "gauss-newton", "gauss-newton[starts=1]", "factor-graph[mode=batch]"],
)
def test_a_field_without_numbers_is_an_exception(label):
    """Where h is nowhere a number there is no answer, and the estimator says so."""

    class Nowhere:
        def predict(self, k: int, x: np.ndarray) -> np.ndarray:
            return np.full((*x.shape[:-1], 2), np.nan)

        def jacobian(self, k: int, x: np.ndarray) -> np.ndarray:
            return np.full((*x.shape[:-1], 2, x.shape[-1]), np.nan)

    problem, _ = rough_flight(0, 1500.0, epochs=3, m=2)
    with pytest.raises(FloatingPointError):
        solver(label).estimate(changed(problem, model=Nowhere()), rng())
