"""Bound, oracle and required error: what the estimates of runs are compared with."""

from __future__ import annotations

import dataclasses
import functools
import math

import numpy as np
import pytest
from paper_flights import flight
from problems import (
    CASES,
    SEED,
    LinearModel,
    changed,
    estimator,
    kalman,
    linear_problem,
    smoothed,
)
from small_cases import small_case, small_flight
from thinning import thinned

from ggbench.block import ProblemBlock
from ggbench.campaign import flights
from ggbench.engines.whitened_measurements import residuals_along
from ggbench.judging.oracle import oracle_states
from ggbench.judging.references import CaseBound, metrics, oracle_means
from ggbench.judging.run_errors import WINDOWS, evaluate_block, window_mask
from ggbench.judging.statistics import mean_band
from ggbench.problem import Problem, jacobian_along, predict_along
from ggbench.simulation.bound import posterior_bound
from ggbench.simulation.error_free_flight import Flight
from ggbench.simulation.flight_bounds import flight_bound, unfiltered_bound
from ggbench.simulation.runs import simulate_block

RUNS = 60
KINDS = {"filter": 0, "fixed-lag-3": 3, "batch": 10**6}
"""Names of bounds, and how many epochs an estimate of each kind sees ahead."""


def solved(problem: Problem, ahead: int) -> np.ndarray:
    """States (K, n) of the Kalman filter or of the smoother."""
    return (smoothed(problem, ahead) if ahead else kalman(problem))[0]


def compared_with(
    name: str, made: Flight, bound: CaseBound, block: ProblemBlock, error_state: np.ndarray
) -> np.ndarray:
    """Metrics of bound and oracle (R, W, 4)."""
    oracle = oracle_means(
        name,
        made,
        bound,
        residuals=residuals_along(block, error_state),
        error_state=error_state,
        transition=block.transition,
    )
    return metrics(name, bound, oracle)


def test_residuals_of_a_block_are_those_of_its_problems():
    """Measurements less h of the framework's model, at any state; zero where none came."""
    made = small_flight({"truth.gradiometer.dropouts_s": [[12.0, 15.0]]})
    block, truth = simulate_block(made, SEED, range(11))
    residuals, at = residuals_along(block, truth.error_state), np.arange(block.epochs)
    for r in range(block.runs):
        problem = block.problem(r)
        wanted = problem.measurements - predict_along(problem.model, at, truth.error_state[r])
        assert residuals[r] == pytest.approx(wanted, rel=0.0, abs=1e-9)
    assert not residuals[~block.present].any() and residuals[block.present].all()


@pytest.mark.parametrize(("kind", "ahead"), KINDS.items())
def test_the_oracle_of_a_linear_problem_is_the_exact_estimate(kind, ahead):
    """To 1e-9 of the prior: filter, fixed lag and batch, whatever the true states are."""
    problem = changed(linear_problem(seed=8), prior_mean=np.zeros(5))
    bound = posterior_bound(
        problem.transition,
        problem.process_cov,
        problem.prior_cov,
        problem.model.rows,
        problem.noise_cov,
    )
    units = np.sqrt(np.diag(problem.prior_cov))
    truth = units * np.random.default_rng(2).normal(size=(2, problem.epochs, 5))
    h = np.einsum("kmn,rkn->rkm", problem.model.rows, truth)
    transition = np.tile(problem.transition, (2, 1, 1, 1))
    found = oracle_states(
        bound, problem.measurements - h, truth, transition, min(ahead, bound.whole)
    )
    for r in range(2):
        assert np.abs((found[r] - solved(problem, ahead)) / units).max() < 1e-9


@pytest.mark.parametrize(("kind", "ahead"), KINDS.items())
def test_the_oracle_of_a_flight_is_linearised_at_its_truth(kind, ahead):
    """The metrics of each window are those of the exact estimate of the tangent problem, to 1e-9.

    Gains are of the run's own Φ and Q here. Those of the flight differ by what the INS errs.
    """
    made = flight(CASES[3])
    block, truth = simulate_block(made, SEED, [0])
    problem, x, at = block.problem(0), truth.error_state[0], np.arange(block.epochs)
    rows = jacobian_along(problem.model, at, x)
    bound = CaseBound(made, flight_bound(made))
    bound.bound = posterior_bound(
        problem.transition,
        problem.process_cov,
        problem.prior_cov,
        rows,
        problem.noise_cov,
        made.ticks,
    )
    (found,) = compared_with(kind, made, bound, block, truth.error_state)
    noise = problem.measurements - predict_along(problem.model, at, x)
    read = noise + np.einsum("kmn,kn->km", rows, x)
    errors = x - solved(changed(problem, model=LinearModel(rows), measurements=read), ahead)
    for numbers, window in zip(found, WINDOWS, strict=True):
        mask = window_mask(made.times, made.case.windows, window)
        wanted = [np.sum(errors[mask, p : p + 3] ** 2, axis=1).mean() for p in (0, 3)]
        assert numbers[2:] == pytest.approx(wanted, rel=1e-9)
        squares = bound.squares(kind)[mask].mean(axis=0)
        assert numbers[:2] == pytest.approx(squares, rel=1e-12)


@functools.cache
def compared(case: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Squares of the EKF (R, W) [m²], metrics of bound and oracle (R, W, 4), NIS (R, K)."""
    made = flight(case)
    block, truth = simulate_block(made, SEED, range(RUNS))
    found = estimator("ekf").estimate_block(block)
    judged, flaws = evaluate_block(truth.error_state, found.mean, found.cov)
    assert not any(flaws)
    masks = [window_mask(made.times, made.case.windows, window) for window in WINDOWS]
    squares = np.stack([(judged.position_error[:, m] ** 2).mean(axis=1) for m in masks], axis=1)
    bound = CaseBound(made, flight_bound(made))
    return squares, compared_with("filter", made, bound, block, truth.error_state), found.nis


@thinned("case", [CASES[0], CASES[2], CASES[3]])
def test_an_ekf_with_a_narrow_prior_is_the_oracle(case):
    """The mean logarithm of EKF over oracle is below 1 %: the same runs hide nothing.

    Its scatter from run to run is below 2 %, so that 60 runs know it to 0.3 %: no false alarm.
    """
    squares, numbers, _ = compared(case)
    logs = 0.5 * np.log(squares / numbers[:, :, 2])
    settled = WINDOWS.index("settled")
    assert np.abs(logs.mean(axis=0)[settled]) < 0.01
    assert logs.std(axis=0)[settled] < 0.02


def test_a_filtered_instrument_has_the_bound_of_its_filtered_measurements():
    """3.137 m of the settled window; without the low-pass 2.931 m, which the twin case has."""
    made, twin = flight(CASES[0]), flight(CASES[3])
    settled = window_mask(made.times, made.case.windows, "settled")

    def rms(cov: np.ndarray) -> float:
        return math.sqrt(np.trace(cov[settled, :3, :3], axis1=1, axis2=2).mean())

    assert rms(flight_bound(made).filtering) == pytest.approx(3.137, abs=0.005)
    assert rms(unfiltered_bound(made).filtering) == pytest.approx(2.931, abs=0.005)
    assert rms(flight_bound(twin).filtering) == pytest.approx(rms(unfiltered_bound(made).filtering))
    _, numbers, _ = compared(CASES[0])
    assert math.sqrt(numbers[0, WINDOWS.index("settled"), 0]) == pytest.approx(3.137, abs=0.005)


@pytest.mark.parametrize("window", WINDOWS)
def test_innovations_of_a_whitened_filter_are_in_their_band(window):
    """Of 60 runs of the EKF behind the low-pass; a band is left by one seed in twenty."""
    made = flight(CASES[0])
    nis = compared(CASES[0])[2][:, window_mask(made.times, made.case.windows, window)]
    low, high = mean_band(RUNS * nis.shape[1], 6.0)
    assert low < nis.mean() < high


def test_a_wrong_model_has_no_oracle():
    """Bounds are there, and what could be reached is not said."""
    case = small_case({"truth.gradiometer.noise_eotvos": 0.02})
    flown = flights.simulated(case, SEED, [0])
    with flown.truth.looked_at() as error_state:
        oracle = flown.oracle_means("filter", error_state)
    ((_, _, bound),) = flown.flights(slice(0, 1))
    (found,) = metrics("filter", bound, oracle)
    assert np.isfinite(found[:, :2]).all() and np.isnan(found[:, 2:]).all()


def test_gaps_at_known_times_have_an_oracle():
    """A measurement that is missing has no weight, whatever stands in its place."""
    made = small_flight({"truth.gradiometer.dropouts_s": [[12.0, 15.0]]})
    block, truth = simulate_block(made, SEED, [0])
    spoilt = np.where(block.present, block.measurements, 1e6)
    bound, states = CaseBound(made, flight_bound(made)), truth.error_state
    other = dataclasses.replace(block, measurements=spoilt)
    assert np.array_equal(
        compared_with("filter", made, bound, block, states),
        compared_with("filter", made, bound, other, states),
    )
    assert np.isfinite(compared_with("batch", made, bound, block, states)).all()


@pytest.mark.parametrize("changes", [{}, {"gradiometer.noise_eotvos": 1.0}])
def test_the_required_error_is_three_bounds_of_the_last_window(changes):
    """RMS over the window; it grows with the noise of the instrument."""
    made = small_flight(changes)
    last = window_mask(made.times, made.case.windows, "last20")
    squares = np.trace(flight_bound(made).filtering[last, :3, :3], axis1=1, axis2=2)
    assert CaseBound(made, flight_bound(made)).required_m == pytest.approx(
        3.0 * math.sqrt(squares.mean()), rel=1e-12
    )


def test_a_required_error_that_is_stated_is_taken():
    """Whatever the bound is."""
    made = small_flight({"windows.required_m": 0.001})
    assert CaseBound(made, flight_bound(made)).required_m == 0.001
