"""Outliers, wrong noise levels and missing readings: what the robust estimators promise."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from oracles import reference
from oracles.ekf import _AdaptiveNoise
from problems import LinearModel, changed, deviation, estimator, linear_problem, rng
from rough_field import rough_flight
from scipy.optimize import minimize
from thinning import thinned

from ggbench.engines.robust_weights import losses, reweighted_noise, weights
from ggbench.estimators.robust import THRESHOLDS
from ggbench.problem import Problem

WITH_LOSS = (
    "ekf",
    "ekf[iterations=5]",
    "ukf",
    "ukf[points=cubature]",
    "gaussian-sum",
    "gauss-newton[starts=1]",
    "factor-graph[mode=batch]",
    "factor-graph[mode=isam2]",
)
SLOW = (
    "ekf[iterations=5]",
    "ukf[points=cubature]",
    "gaussian-sum",
    "gauss-newton[starts=1]",
    "factor-graph[mode=isam2]",
    "factor-graph[mode=fixed-lag]",
    "factor-graph[mode=batch]",
)
RUNS = 6
TAIL = 40


def with_(label: str, **parameters: object):
    """The oracle of a compiled estimator: the field of these tests has no kernels."""
    return reference(label, **parameters)


@functools.cache
def flights(**options: float) -> list[tuple[Problem, np.ndarray]]:
    return [rough_flight(seed, 50.0, **options) for seed in range(RUNS)]


def position_rms(solver, problems: list[tuple[Problem, np.ndarray]]) -> float:
    squares = [
        np.sum((solver.estimate(p, rng()).mean - truth)[-TAIL:, :3] ** 2, axis=1)
        for p, truth in problems
    ]
    return float(np.sqrt(np.mean(squares)))


def position_nees(solver, problems: list[tuple[Problem, np.ndarray]]) -> float:
    found = []
    for problem, truth in problems:
        estimate = solver.estimate(problem, rng())
        error = (estimate.mean - truth)[-TAIL:, :3]
        cov = estimate.cov[-TAIL:, :3, :3]
        found.append(np.sum(error * np.linalg.solve(cov, error[..., None])[..., 0], axis=1))
    return float(np.mean(found))


def test_without_kernels_the_plain_filter_is_filterpys():
    """On a model without kernels ``ekf`` has filterpy's answer, to rounding."""
    problem, _ = flights()[0]
    framework = estimator("filterpy-ekf").estimate(problem, rng())
    ours = estimator("ekf").estimate(problem, rng())
    assert max(deviation(ours.mean, ours.cov, framework.mean, framework.cov)) < 1e-8


@pytest.mark.parametrize("label", ["ekf[iterations=5]", "ekf[loss=huber]", "ekf[gate=0.99]"])
def test_without_kernels_other_updates_are_refused(label):
    """In a sentence, and not by another filter than the one that was asked for."""
    problem, _ = rough_flight(1, 50.0, epochs=30)
    solver = estimator(label)
    assert "needs the model of ggbench" in solver.skip(problem)
    with pytest.raises(TypeError, match="needs the model of ggbench"):
        solver.estimate(problem, rng())
    assert estimator("ekf[noise_scale=2]").skip(problem) is None


@thinned("loss", ["huber", "cauchy"], every=2)
@pytest.mark.parametrize("label", WITH_LOSS)
def test_a_loss_that_never_acts_changes_nothing(label, loss):
    """With a threshold of ten million deviations a robust estimator is the one without a loss."""
    problem, _ = rough_flight(1, 50.0, epochs=30)
    plain = with_(label).estimate(problem, rng())
    far = with_(label, loss=loss, threshold=1e7).estimate(problem, rng())
    assert max(deviation(far.mean, far.cov, plain.mean, plain.cov)) < 1e-5


@pytest.mark.parametrize("loss", [pytest.param("huber", marks=pytest.mark.long), "cauchy"])
@pytest.mark.parametrize(
    "label",
    [
        pytest.param(label, marks=pytest.mark.long) if label in SLOW else label
        for label in (*WITH_LOSS, "factor-graph[mode=fixed-lag]")
    ],
)
def test_robust_beats_plain_under_outliers(label, loss):
    """5 % of the components off by 30 deviations: the error falls to less than half.

    Measured: to 0.20-0.25 of the plain one.
    """
    robust = position_rms(with_(label, loss=loss), flights(outliers=0.05))
    assert robust < 0.5 * plain_under_outliers(label)


@functools.cache
def plain_under_outliers(label):
    return position_rms(with_(label), flights(outliers=0.05))


@pytest.mark.parametrize(
    "label",
    [
        "ekf",
        "ukf",
        *(
            pytest.param(label, marks=pytest.mark.long)
            for label in ("gaussian-sum", "gauss-newton[starts=1]")
        ),
    ],
)
def test_robustness_costs_little_without_outliers(label):
    """With Gaussian noise the error grows by less than 15 % (asymptotically 2.5 %)."""
    good = flights()
    assert position_rms(with_(label, loss="huber"), good) < 1.15 * position_rms(with_(label), good)


@thinned("label", ["ekf", "ukf", "gaussian-sum"])
def test_an_outlier_has_a_bounded_influence(label):
    """However far off one component is, the answer after it moves by less than one deviation.

    Without a loss a component off by 10 000 deviations throws the filter off.
    """
    problem, _ = flights()[0]
    k = problem.epochs // 2
    clean = with_(label, loss="cauchy").estimate(problem, rng())
    sigma = np.sqrt(np.diagonal(clean.cov[k]))
    for size in (1e2, 1e4, 1e6):
        measurements = problem.measurements.copy()
        measurements[k, 2] += size * np.sqrt(problem.noise_cov[2, 2])
        bad = changed(problem, measurements=measurements)
        moved = with_(label, loss="cauchy").estimate(bad, rng()).mean[k] - clean.mean[k]
        assert np.abs(moved / sigma).max() < 1.0
        if size >= 1e4:
            moved = with_(label).estimate(bad, rng()).mean[k] - clean.mean[k]
            assert np.abs(moved / sigma).max() > 10.0


@pytest.mark.parametrize("label", ["ekf", "ekf[iterations=5]", "ukf", "gaussian-sum"])
@pytest.mark.parametrize("loss", ["huber", "cauchy"])
def test_what_the_prior_explains_is_no_outlier(label, loss):
    """A first reading 3000 deviations of its noise from the prediction is believed.

    Two states with a prior 1000 times wider than the noise, three readings of them that agree.
    """
    rows = np.array([[[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]]])
    problem = Problem(
        times=np.array([1.0]),
        measurements=np.array([[3000.0, -2000.0, 1000.5]]),
        noise_cov=np.eye(3),
        transition=np.eye(2)[None],
        process_cov=np.zeros((1, 2, 2)),
        prior_mean=np.zeros(2),
        prior_cov=1e6 * np.eye(2),
        model=LinearModel(rows),
        layout=(),
    )
    plain = with_("ekf").estimate(problem, rng())
    found = with_(label, loss=loss).estimate(problem, rng())
    assert max(deviation(found.mean, found.cov, plain.mean, plain.cov)) < 0.1


@pytest.mark.parametrize("label", ["ekf", "ekf[iterations=20]", "ukf"])
def test_an_outlier_near_the_prediction_does_not_win(label):
    """Of five readings of a place known to 1000 deviations, the four that agree are believed.

    The fifth has the smallest innovation, by chance: against the noise alone it looks like the only
    good one, against the innovation's own deviation they are all possible.
    """
    readings = np.array([3000.0, 3000.6, 2999.5, 1.0, 3000.2])
    problem = Problem(
        times=np.ones(1),
        measurements=readings[None],
        noise_cov=np.eye(5),
        transition=np.eye(1)[None],
        process_cov=np.zeros((1, 1, 1)),
        prior_mean=np.zeros(1),
        prior_cov=np.array([[1e6]]),
        model=LinearModel(np.ones((1, 5, 1))),
        layout=(),
    )
    found = with_(label, loss="cauchy").estimate(problem, rng())
    assert found.mean[0, 0] == pytest.approx(3000.0, abs=1.0)


def first_cost(problem: Problem, x: np.ndarray) -> float:
    """Huber's cost of a state after the first reading: of prior, motion and reading."""
    units = np.sqrt(np.diag(problem.prior_cov))
    phi = problem.transition[0]
    off = (x - phi @ problem.prior_mean) / units
    cov = phi @ problem.prior_cov @ phi.T + problem.process_cov[0]
    left = problem.measurements[0] - problem.model.predict(0, x)
    r = np.abs(np.linalg.solve(np.linalg.cholesky(problem.noise_of(0)), left))
    huber = np.where(r < 1.345, 0.5 * r**2, 1.345 * r - 0.5 * 1.345**2)
    return float(0.5 * off @ np.linalg.solve(cov / np.outer(units, units), off) + huber.sum())


@pytest.mark.parametrize("label", ["ekf", "ekf[iterations=20]", "gaussian-sum[iterations=40]"])
def test_update_minimises_the_huber_cost(label):
    """The updated state is the minimum that a general optimizer finds of the same convex cost."""
    problem = linear_problem(seed=4, epochs=1, m=2)
    problem = changed(problem, measurements=problem.measurements + np.array([0.0, 8.0]))
    units = np.sqrt(np.diag(problem.prior_cov))
    start = problem.transition[0] @ problem.prior_mean / units
    best = minimize(
        lambda u: first_cost(problem, units * u), start, method="BFGS", options={"gtol": 1e-9}
    )
    found = with_(label, loss="huber").estimate(problem, rng())
    assert first_cost(problem, found.mean[0]) < best.fun + 1e-5


@pytest.mark.parametrize("label", ["ekf[iterations=50]", "gaussian-sum[iterations=50]"])
def test_an_iterated_update_ends_in_a_minimum_of_the_huber_cost(label):
    """No step to any side lowers the cost, with outliers in a field that bends."""
    for seed in range(RUNS):
        problem, _ = rough_flight(seed, 200.0, epochs=1, outliers=0.3)
        found = with_(label, loss="huber").estimate(problem, rng())
        lowest = first_cost(problem, found.mean[0])
        for step in 0.1 * np.diag(np.sqrt(np.diag(found.cov[0]))):
            for side in (-step, step):
                assert first_cost(problem, found.mean[0] + side) > lowest - 1e-6


@pytest.mark.parametrize("label", ["ekf", "ekf[iterations=20]", "gaussian-sum[iterations=40]"])
def test_a_reading_informs_as_much_as_it_weighs(label):
    """P⁻¹ grows by each component's information times its weight: an outlier's by little."""
    problem = linear_problem(seed=4, epochs=1, m=2)
    problem = changed(problem, measurements=problem.measurements + np.array([0.0, 8.0]))
    found = with_(label, loss="huber").estimate(problem, rng())
    units = np.sqrt(np.diag(problem.prior_cov))
    phi = problem.transition[0]
    cov = phi @ problem.prior_cov @ phi.T + problem.process_cov[0]
    root = np.linalg.cholesky(problem.noise_cov)
    rows = np.linalg.solve(root, problem.model.jacobian(0, found.mean[0]) * units)
    left = problem.measurements[0] - problem.model.predict(0, found.mean[0])
    weight = weights(np.linalg.solve(root, left), "huber", 1.345)
    assert weight.min() < 0.5
    information = np.linalg.inv(cov / np.outer(units, units)) + (rows.T * weight) @ rows
    assert found.cov[0] / np.outer(units, units) == pytest.approx(
        np.linalg.inv(information), rel=1e-3, abs=1e-6
    )


@pytest.mark.parametrize(
    ("loss", "correlated"),
    [
        pytest.param("huber", True, marks=pytest.mark.long),
        pytest.param("huber", False, marks=pytest.mark.long),
        pytest.param("cauchy", True, marks=pytest.mark.long),
        ("cauchy", False),
    ],
)
def test_robust_gauss_newton_is_gtsams_robust_graph(loss, correlated):
    """Two ways to the same minimum: reweighted Kalman smoothing and GTSAM's m-estimators.

    Also where the noises of a reading's components correlate.
    """
    problem, _ = flights(outliers=0.05)[0]
    if correlated:
        root = np.sqrt(problem.noise_cov) @ (np.eye(6) + 0.3 * np.tril(np.ones((6, 6)), -1))
        problem = changed(problem, noise_cov=root @ root.T)
    graph = with_("factor-graph[mode=batch]", loss=loss).estimate(problem, rng())
    ours = with_("gauss-newton[starts=1]", loss=loss).estimate(problem, rng())
    assert ours.info["cost"] == pytest.approx(graph.info["error"], rel=1e-6)
    assert max(deviation(ours.mean, ours.cov, graph.mean, graph.cov)) < 5e-3


@pytest.mark.parametrize("factor", [1.0 / 3.0, 3.0])
def test_adaptive_noise_makes_a_wrong_noise_figure_harmless(factor):
    """With noise three times larger or smaller than told, the NEES is what it should be.

    That is 3 for three states. Measured in 40 runs: plain 17 and 0.8, adaptive 3.4 and 2.0; the
    epochs of a run are correlated, so that the limits are a factor of two. Noise smaller than told
    is also used: the error falls by a quarter. Noise larger than told leaves it as it was.
    """
    problems = flights(noise=0.1 * factor, claimed=0.1)
    adaptive = with_("ekf", noise_memory=50)
    assert 1.5 < position_nees(adaptive, problems) < 6.0
    assert not 1.5 < position_nees(with_("ekf"), problems) < 6.0
    gain = position_rms(adaptive, problems) / position_rms(with_("ekf"), problems)
    assert gain < (0.9 if factor < 1.0 else 1.15)


def test_adaptive_noise_does_not_count_missing_readings():
    """A flight with every second reading missing is the flight of half as many epochs."""
    problem, _ = flights(noise=0.3, claimed=0.1)[0]
    phi, q = problem.transition, problem.process_cov

    class Dropouts:
        def predict(self, k: int, x: np.ndarray) -> np.ndarray:
            return problem.model.predict(k, x) * (k % 2)

        def jacobian(self, k: int, x: np.ndarray) -> np.ndarray:
            return problem.model.jacobian(k, x) * (k % 2)

    class Kept:
        def predict(self, k: int, x: np.ndarray) -> np.ndarray:
            return problem.model.predict(2 * k + 1, x)

        def jacobian(self, k: int, x: np.ndarray) -> np.ndarray:
            return problem.model.jacobian(2 * k + 1, x)

    there = (np.arange(problem.epochs) % 2)[:, None]
    dropped = changed(
        problem,
        measurements=problem.measurements * there,
        model=Dropouts(),
        present=np.broadcast_to(there > 0, problem.measurements.shape),
    )
    kept = changed(
        problem,
        times=problem.times[1::2],
        measurements=problem.measurements[1::2],
        present=problem.present[1::2],
        transition=phi[1::2] @ phi[::2],
        process_cov=phi[1::2] @ q[::2] @ phi[1::2].transpose(0, 2, 1) + q[1::2],
        model=Kept(),
    )
    adaptive = with_("ekf[noise_memory=20,loss=huber]")
    all_epochs, half = adaptive.estimate(dropped, rng()), adaptive.estimate(kept, rng())
    assert max(deviation(all_epochs.mean[1::2], all_epochs.cov[1::2], half.mean, half.cov)) < 1e-8


def test_adaptive_noise_forgets():
    """Of noise that grows threefold only as many readings as the memory holds are believed.

    After 500 readings of variance 1, and 100 of variance 9 with a memory of 25, the estimate is 9
    within a factor of 2 (its deviation is 30 %); remembering all it would be below 2.5.
    """
    generator = np.random.default_rng(8)
    noise, told = _AdaptiveNoise(4, 25), np.eye(4)
    there, certain = np.ones(4, dtype=bool), np.zeros((4, 4))
    for k in range(600):
        left = (1.0 if k < 500 else 3.0) * generator.standard_normal(4)
        noise.learn(told, there, left, certain, noise.of(told))
    assert (np.diag(noise.of(told)) > 4.5).all() and (np.diag(noise.of(told)) < 18.0).all()


def test_adaptive_noise_learns_of_each_channel_what_came_of_it():
    """Where one of two channels is missing, nothing is learned of it, and the other's count is its.

    400 residuals of variance 9 in both; the second is there in 100 of them: 9 to 35 % (3σ).
    """
    generator = np.random.default_rng(10)
    noise, told = _AdaptiveNoise(2, 1000), np.eye(2)
    for k in range(400):
        there = np.array([True, k % 4 == 0])
        left = 3.0 * generator.standard_normal(2) * there
        noise.learn(told, there, left, np.zeros((2, 2)), noise.of(told))
    assert np.diag(noise.of(told)) == pytest.approx(9.0, rel=0.35)


def test_adaptive_noise_counts_what_the_update_has_explained():
    """What an update leaves is smaller than the noise by what it has learned: R − H P Hᵀ.

    1000 residuals of variance 0.4 after updates that leave 0.6 are noise of variance 1 (20 %).
    """
    generator = np.random.default_rng(9)
    root = np.array([[1.0, 0.0], [2.0, 1.0]])
    noise, told = _AdaptiveNoise(2, 1000), root @ root.T
    for _ in range(1000):
        left = root @ (np.sqrt(0.4) * generator.standard_normal(2))
        noise.learn(told, np.ones(2, dtype=bool), left, 0.6 * told, noise.of(told))
    assert noise.of(told) == pytest.approx(told, rel=0.2)


def test_adaptive_noise_does_not_learn_from_outliers():
    """A residual of 30 deviations that a loss has weighed down by 900 counts as one of one."""
    noise, told = _AdaptiveNoise(2, 50), np.eye(2)
    there, weighted = np.ones(2, dtype=bool), np.diag([900.0, 1.0])
    noise.learn(told, there, np.array([30.0, 1.0]), np.zeros((2, 2)), weighted)
    assert noise.of(told) == pytest.approx(told)


@pytest.mark.parametrize("loss", ["huber", "cauchy"])
def test_losses_and_weights_belong_together(loss):
    """w(r) r is the derivative of ρ(r), by central differences, on both sides of the threshold."""
    r = np.linspace(-9.0, 9.0, 50)
    slope = (losses(r + 1e-5, loss, 2.0) - losses(r - 1e-5, loss, 2.0)) / 2e-5
    assert np.abs(slope - r * weights(r, loss, 2.0)).max() < 1e-8


@pytest.mark.parametrize("loss", ["huber", "cauchy"])
def test_the_usual_threshold_costs_five_percent_of_variance(loss):
    """Of Gaussian residuals r with ψ = w r: (E r ψ)² / E ψ² is the efficiency, and is 95 %."""
    r = np.linspace(-9.0, 9.0, 20_001)
    density = np.exp(-0.5 * r**2) / np.exp(-0.5 * r**2).sum()
    psi = r * weights(r, loss, THRESHOLDS[loss])
    assert (density @ (r * psi)) ** 2 / (density @ psi**2) == pytest.approx(0.95, abs=5e-4)


@pytest.mark.parametrize("loss", ["huber", "cauchy"])
def test_a_set_of_sigma_points_may_claim_a_negative_spread(loss):
    """Its centre weight is negative. The weights stay numbers, and an outlier has less of one."""
    noise = np.diag([1e-4, 4e-4])
    spread = np.diag([-2e-4, 1e-4])
    found = reweighted_noise(np.array([0.5, 0.01]), spread, noise, loss, 2.0)
    assert np.isfinite(found).all()
    assert found[0, 0] > 10.0 * noise[0, 0]
    assert found[1, 1] < 2.0 * noise[1, 1]


def test_a_filter_that_learns_the_noise_it_was_told_claims_what_it_claimed():
    """What an update leaves is less than the noise by what the state took of it.

    To 10 % of the deviations over 400 epochs; without that share they would be half as large.
    """
    problem = linear_problem(0, epochs=800)
    learning = with_("ekf[noise_memory=200]").estimate(problem, rng())
    told = with_("ekf").estimate(problem, rng())
    ratio = np.sqrt(np.einsum("kii->ki", learning.cov) / np.einsum("kii->ki", told.cov))
    np.testing.assert_allclose(ratio[400:].mean(axis=0), 1.0, atol=0.1)
