"""Matching by windows: how often it finds its place, how exactly, and that theory says so.

Every test has a fixed seed and says how often another one would fail it although nothing is wrong.
"""

from __future__ import annotations

import functools

import numpy as np
import pytest
from lost_runs import lost, wide
from oracles import solver
from problems import estimator, rng
from rough_field import LENGTH, constant_offset
from scipy.stats import chi2, norm

from ggbench.engines.window_search import Search
from ggbench.judging import convergence
from ggbench.judging.run_errors import window_mask
from ggbench.matchability import information as info
from ggbench.problem import Problem
from ggbench.simulation.error_free_flight import prepare
from ggbench.simulation.runs import simulate_block
from ggbench.spec import scenario


def efficient(runs: int) -> tuple[np.ndarray, np.ndarray]:
    """Errors (R, 2) of fixes of one constant offset in units of what the readings tell, and NEES.

    One field, one offset, a window of 20 readings of six channels; only the noise is drawn.
    """
    offset, draws = (321.0, -456.0, 0.0), np.random.default_rng(1)
    white, nees = [], []
    for _ in range(runs):
        problem = constant_offset(3, offset, 500.0, noise=1.0, vertical=1e-3, draws=draws)
        rows = [problem.model.jacobian(k, np.array(offset))[:, :2] for k in range(20)]
        known = info.information(np.array(rows))  # of a noise of one
        fixes = solver("tercom-ekf[refine=1]").estimate(problem, rng()).fixes
        assert fixes.accepted.tolist() == [True]
        off = fixes.mean[0, :2] - offset[:2]
        white.append(np.linalg.cholesky(known).T @ off)
        nees.append(off @ np.linalg.solve(fixes.cov[0, :2, :2], off))
    return np.array(white), np.array(nees)


@pytest.mark.long
def test_a_fix_of_a_constant_offset_is_efficient_and_says_so():
    """Variance (Σ HᵀR⁻¹H)⁻¹ and NEES 2 over 1000 runs, in their 95 % bands, and no bias.

    The bands are 9 and 6 % wide to each side; another seed would fail one of the three in one case
    of seven.
    """
    runs = 1000
    white, nees = efficient(runs)
    low, high = chi2.ppf([0.025, 0.975], runs) / runs
    for square in np.mean(white**2, axis=0):
        assert low < square < high
    low, high = chi2.ppf([0.025, 0.975], 2 * runs) / runs
    assert low < nees.mean() < high
    assert np.abs(white.mean(axis=0)).max() < norm.isf(5e-4) / np.sqrt(runs)


def false_fixes(window: int, noise: float, draws: int = 12) -> tuple[float, float]:
    """Shares of false fixes of a single channel: the union bound, and what a matcher has.

    Over ten fields and offsets drawn from the prior, each fix the best of all places however
    little it is better. False is what is further off than half of a correlation length.
    """
    sigma, right = 2500.0, 0.5 * LENGTH
    grid = info.offsets(4.0 * sigma, 250.0)
    away = np.concatenate([grid, np.zeros((*grid.shape[:2], 1))], axis=-1)
    matcher = (
        f"tercom-ekf[window={window},longest={window},odds=0,misfit=1e9,spacing_m=400,refine=4]"
    )
    bounds, false = [], []
    for field in range(10):
        generator = np.random.default_rng([field, window])
        for _ in range(draws):
            offset = np.append(sigma * generator.standard_normal(2), 0.0)
            problem = constant_offset(
                seed=field,
                offset=tuple(offset),
                sigma=sigma,
                epochs=window,
                m=1,
                noise=noise,
                vertical=1e-3,
                draws=generator,
            )
            ambiguity = np.zeros(grid.shape[:2])
            for k in range(window):
                apart = problem.model.predict(k, offset + away) - problem.model.predict(k, offset)
                ambiguity += 0.5 * np.sum((apart / noise) ** 2, axis=-1)
            bounds.append(info.false_fix_bound(ambiguity, grid, right, 4.0 * sigma, sigma))
            fix = solver(matcher).estimate(problem, rng()).fixes.mean[0, :2]
            false.append(np.hypot(*(fix - offset[:2])) > right)
    return float(np.mean(bounds)), float(np.mean(false))


@pytest.mark.long
@pytest.mark.parametrize(("window", "noise"), [(12, 1.0), (16, 2.0), (20, 2.0)])
def test_false_fixes_are_as_frequent_as_the_union_bound_says(window, noise):
    """Within a factor of three, where it lies between 2 and 50 %; over 120 fixes.

    Measured: 24 and 22 % are told in the first two, 23 and 19 % seen; the third is rarer.
    """
    bound, share = false_fixes(window, noise)
    assert 0.02 < share < 0.5
    assert bound / 3.0 < share < bound * 3.0


@functools.cache
def flown(case: str, label: str, runs: int = 40) -> dict[str, np.ndarray]:
    """Of runs of ``wide_prior``: convergence times [s], settled mean squares [m²], false fixes."""
    windows = wide(case).case.windows
    block, truth = lost(case, runs)
    settled = window_mask(block.times, windows, "settled")
    found = [estimator(label).estimate(block.problem(run), rng()) for run in range(runs)]
    off = truth.error_state[:, :, :3] - np.array([one.mean[:, :3] for one in found])
    error = np.linalg.norm(off, axis=2)
    sigmas = np.array([np.sqrt(np.diagonal(one.cov[-1])[:3]) for one in found])
    converged, _ = convergence.judge(error, sigmas, block.times, windows.required_m)
    false = np.zeros(runs, dtype=bool)
    for run, one in enumerate(found):
        if one.fixes is not None:
            true = truth.error_state[run, one.fixes.epoch, :2]
            missed = np.hypot(*(one.fixes.mean[:, :2] - true).T) >= windows.required_m
            false[run] = (missed & one.fixes.accepted).any()
    return {
        "converged": converged,
        "squares": np.mean(error[:, settled] ** 2, axis=1),
        "false": false,
    }


@pytest.mark.long
@pytest.mark.parametrize("case", ["3km", "10km"])
def test_the_oldest_method_is_as_good_as_the_best_filter_from_kilometres_away(case):
    """Of 40 runs of ``tercom-ekf`` 95 % converge, 2.5 % of fixes are false.

    The error is at most 1.1 times that of ``gaussian-sum``.
    """
    found, best = flown(case, "tercom-ekf"), flown(case, "gaussian-sum")
    assert np.isfinite(found["converged"]).mean() >= 0.95
    assert found["false"].mean() <= 0.025
    assert np.sqrt(found["squares"].mean()) < 1.1 * np.sqrt(best["squares"].mean())


WINDOWS = (10, 30, 60, 120)
"""Lengths [readings of a minute] over which an INS's error is taken for a constant."""


def matched(window: Problem) -> np.ndarray:
    """The constant error (2,) [m] under which a window fits best, by mean square, to 8 m."""
    search = Search(window, 800.0, 50_000)
    search.take(window.epochs)
    free = np.ptp(search.points, axis=0) > 0.0
    for step in (80.0, 8.0):
        around = np.zeros((21, 21, len(free)))
        around[..., free] = info.offsets(10.0 * step, step)
        points = search.points[search.best(1)[0]] + around.reshape(-1, len(free))
        search = Search(window, step, 50_000, points=points)
        search.take(window.epochs)
    start = search.multipliers(search.points[search.best(1)[0]]) / search.scale
    return (window.prior_cov @ start)[:2]


def expected(window: Problem, states: np.ndarray) -> np.ndarray:
    """Covariance (2, 2) [m²] of the error of :func:`matched`, to first order at the true states.

    Of noise J⁻¹, and of the drift of the INS's error e within the window: the fit is off from
    the mean error by Σ W_k e_k with W_k = J⁻¹ H_kᵀR⁻¹H_k − I / K, which no constant error enters.
    Its covariance under the prior and the dynamics goes backwards in time: a_k = W_kᵀ + Φᵀ a_{k+1}.
    """
    rows = np.array([window.model.jacobian(k, x)[:, :2] for k, x in enumerate(states)])
    white = np.linalg.solve(np.linalg.cholesky(window.noise_cov), rows)
    inverse = np.linalg.inv(info.information(white))
    total, back = inverse.copy(), np.zeros((window.dimension, 2))
    for k in reversed(range(window.epochs)):
        back[:2] += (inverse @ white[k].T @ white[k] - np.eye(2) / window.epochs).T
        total += back.T @ window.process_cov[k] @ back
        back = window.transition[k].T @ back
    return np.asarray(total + back.T @ window.prior_cov @ back)


@pytest.mark.long
def test_a_window_has_a_best_length_that_noise_and_drift_foretell():
    """A ship lost by 5 km: the error of a constant fit is least between 10 and 120 minutes.

    Short windows hear the noise, long ones take the drift for a place. Medians over forty runs,
    because a run that ends on a wrong hill says nothing of either; they scatter by a sixth, so that
    what is foretold may be off by half. Its best length is one of the best: at most 1.3 times the
    least error.
    """
    flight = prepare(scenario.load("ship").case("1E-lost"))
    block, truth = simulate_block(flight, 4, range(40))
    draws = np.random.default_rng(1).standard_normal((100, 2))
    seen, told = [], []
    for length in WINDOWS:
        errors, scatter, first = [], [], block.until(length)
        for run in range(40):
            window, states = first.problem(run), truth.error_state[run, :length]
            errors.append(np.linalg.norm(matched(window) - states[:, :2].mean(axis=0)))
            drawn = draws @ np.linalg.cholesky(expected(window, states)).T
            scatter.append(np.linalg.norm(drawn, axis=1))
        seen.append(np.median(errors))
        told.append(np.median(scatter))
    for errors in (seen, told):
        assert 0 < np.argmin(errors) < len(WINDOWS) - 1
    assert seen[np.argmin(told)] < 1.3 * min(seen)
    np.testing.assert_allclose(np.log(seen), np.log(told), atol=np.log(1.5))
