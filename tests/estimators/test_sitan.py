"""SITAN: planes over what is in question, and a bank that believes nothing before it must."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from problems import changed, deviation, estimator, kalman, noisy_problem, propagated, refusal, rng
from rough_field import rough_flight
from test_multistart import Periodic
from thinning import thinned

from ggbench.estimators.sitan import SitanFilters
from ggbench.problem import Problem, StateBlock


@pytest.mark.parametrize("n", [1, 2, 3])
@pytest.mark.parametrize("m", [1, 3])
def test_the_plane_of_a_plane_is_itself(n, m):
    """Of a linear h of positions, one filter is Kalman's to 1e-9, whichever of them it fits."""
    problem = noisy_problem(3, n=n, m=m)
    found = estimator("sitan").estimate(problem, rng())
    mean, cov, predicted, before = kalman(problem)
    assert max(deviation(found.mean, found.cov, mean, cov)) < 1e-9
    for k in range(problem.epochs):
        h = problem.model.jacobian(k, predicted[k])
        off = problem.measurements[k] - problem.model.predict(k, predicted[k])
        square = off @ np.linalg.solve(h @ before[k] @ h.T + problem.noise_cov, off)
        assert found.nis[k] == pytest.approx(square, rel=1e-9)


@dataclass(frozen=True)
class Bowl:
    """h = ½ c (east² + north²), the same everywhere else."""

    curvature: float = 1.0

    def predict(self, k: int, x: np.ndarray) -> np.ndarray:
        return 0.5 * self.curvature * (np.asarray(x)[..., :2] ** 2).sum(axis=-1, keepdims=True)

    def jacobian(self, k: int, x: np.ndarray) -> np.ndarray:
        rows = np.zeros((*np.shape(x)[:-1], 1, np.shape(x)[-1]))
        rows[..., 0, :2] = self.curvature * np.asarray(x)[..., :2]
        return rows


def placed(epochs: int, sigma: float, model: object, measurements: np.ndarray) -> Problem:
    """A place at rest, known to σ east and north and to a metre in height."""
    return Problem(
        times=np.arange(1.0, epochs + 1.0),
        measurements=measurements,
        noise_cov=1e-4 * np.eye(measurements.shape[1]),
        transition=np.tile(np.eye(3), (epochs, 1, 1)),
        process_cov=np.zeros((epochs, 3, 3)),
        prior_mean=np.array([7.0, 0.0, 0.0]),
        prior_cov=np.diag([sigma**2, sigma**2, 1.0]),
        model=model,
        layout=(StateBlock("position error ENU", slice(0, 3), "m"),),
    )


def test_what_a_plane_leaves_of_a_bowl_is_noise():
    """The mean slope, the mean value and the mean square of the rest over nine weighed points.

    With weights 1 and e^−½ at 0 and ±σ, offsets have the variance v σ²; half their squares along
    two axes have the mean v σ² and the variance ½ (v − v²) σ⁴.
    """
    sigma = 3.0
    problem = placed(1, sigma, Bowl(), np.zeros((1, 1)))
    filters = SitanFilters(problem, np.inf, 1)
    rows, predicted, noise = filters.fitted_planes(0)
    v = 2.0 * np.exp(-0.5) / (1.0 + 2.0 * np.exp(-0.5))
    np.testing.assert_allclose(rows[0, 0] / filters.scale, [7.0, 0.0, 0.0], atol=1e-9)
    assert predicted[0, 0] == pytest.approx(0.5 * 7.0**2 + v * sigma**2)
    assert noise[0, 0, 0] == pytest.approx(1e-4 + 0.5 * (v - v**2) * sigma**4)


@thinned("seed", range(3))
def test_a_bank_finds_where_one_filter_is_lost(seed):
    """A prior of one and a half correlation lengths: found to 100 m, and tells when.

    Before, the answer is the INS's own; a single filter of the same flights is lost in one of them
    by more than that (the last assertion below has it).
    """
    problem, truth = rough_flight(seed, 3000.0, epochs=60)
    found = estimator("sitan[bank=auto,sigma_m=300]").estimate(problem, rng())
    mean, cov = propagated(problem)
    waiting = problem.times < found.info["accepted_at_s"]
    assert found.info["filters"] > 100
    assert found.info["accepted"] and waiting.sum() >= 19 and not waiting.all()
    np.testing.assert_allclose(found.mean[waiting], mean[waiting])
    np.testing.assert_allclose(found.cov[waiting], cov[waiting], rtol=1e-9)
    assert np.isnan(found.nis[waiting]).all()
    assert np.linalg.norm((found.mean - truth)[-1, :2]) < 100.0
    # What it would have said, had it said anything, at every reading from the first decision on.
    fixes, end = found.fixes, int(waiting.sum())
    assert fixes.epoch.tolist() == list(range(19, end + 1))
    assert fixes.accepted.tolist() == [False] * (end - 19) + [True]
    np.testing.assert_allclose(fixes.mean[-1], found.mean[end, :2])
    np.testing.assert_allclose(fixes.cov[-1], found.cov[end, :2, :2])
    assert (fixes.statistic > 1.3).tolist() == fixes.accepted.tolist()


def test_one_filter_from_the_middle_of_a_wide_prior_is_lost():
    """What the bank is for, on the same flights."""
    lost = []
    for seed in range(3):
        problem, truth = rough_flight(seed, 3000.0, epochs=60)
        found = estimator("sitan").estimate(problem, rng())
        lost.append(np.linalg.norm((found.mean - truth)[-1, :2]))
    assert max(lost) > 100.0


def test_where_two_places_look_alike_nothing_is_accepted():
    """Over a field that repeats itself the answer stays the INS's, however many readings fit."""
    readings = np.tile([0.6, 0.8], (60, 1))
    problem = placed(40, 1200.0, Periodic(), readings[:40])
    found = estimator("sitan[bank=auto,sigma_m=70]").estimate(problem, rng())
    assert found.info["filters"] > 100 and not found.info["accepted"]
    np.testing.assert_allclose(found.cov[-1], problem.prior_cov, rtol=1e-9)


@pytest.mark.long
def test_where_nothing_fits_nothing_is_accepted():
    """A noise that is told a tenth of its size: all residuals are too large, so no place is right.

    Told as it is, one of them is accepted.
    """
    problem, _ = rough_flight(1, 3000.0, epochs=40, noise=1.0)
    for told, accepted in ((0.01, False), (1.0, True)):
        other = changed(problem, noise_cov=told * problem.noise_cov)
        found = estimator("sitan[bank=auto,sigma_m=300]").estimate(other, rng())
        assert found.info["accepted"] == accepted


def test_readings_that_are_missing_are_not_counted():
    """Ten epochs without one: the decision comes ten epochs later, and not for want of evidence."""
    problem, _ = rough_flight(1, 3000.0, epochs=40)
    solver = estimator("sitan[bank=auto,sigma_m=300,readings=5]")
    first = solver.estimate(problem, rng()).info["accepted_at_s"]
    there = np.arange(40) >= 10
    rows = there[:, None]

    class Silent:
        def predict(self, k: int, x: np.ndarray) -> np.ndarray:
            return problem.model.predict(k, x) * there[k]

        def jacobian(self, k: int, x: np.ndarray) -> np.ndarray:
            return problem.model.jacobian(k, x) * there[k]

    silent = changed(
        problem,
        model=Silent(),
        measurements=problem.measurements * rows,
        present=np.broadcast_to(rows, problem.measurements.shape),
    )
    assert first == 5.0
    assert solver.estimate(silent, rng()).info["accepted_at_s"] >= 15.0


@pytest.mark.parametrize(
    ("setting", "reason"),
    [
        ("sigma_m=0", "parameter 'sigma_m' is"),
        ("sigma_m=nan", "parameter 'sigma_m' is"),
        ("most=0", "parameter 'most' is"),
        ("readings=0", "parameter 'readings' is"),
        ("largest=0", "parameter 'largest' is"),
        ("largest=nan", "parameter 'largest' is"),
        ("ratio=0.9", "parameter 'ratio' is"),
        ("ratio=inf", "parameter 'ratio' is"),
    ],
)
def test_settings_that_mean_nothing_are_refused(setting, reason):
    assert reason in refusal(f"sitan[{setting}]", noisy_problem(0))
