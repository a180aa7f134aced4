"""What single estimators promise beyond the contract: UKF and factor graph."""

from __future__ import annotations

import functools
import gc
import os
import subprocess
import sys
import weakref
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from problems import (
    CONSTANT,
    SEED,
    SLOW,
    changed,
    deviation,
    estimated,
    estimator,
    is_slow,
    labels,
    linear_problem,
    rng,
    simulated,
    smoothed,
)

from ggbench.numerics.positive import MatrixSquareRoot
from ggbench.problem import Problem
from ggbench.simulation.error_free_flight import prepare
from ggbench.simulation.runs import simulate
from ggbench.spec import scenario
from ggbench.spec.case import CaseSpec

ON_GTSAM = [label for label in labels() if label.startswith("gtsam")]
GRAPHS = [label for label in labels() if label.startswith("factor-graph")] + ON_GTSAM


def test_square_root_of_a_covariance_is_exact_and_triangular():
    """Where Cholesky works, U with Uᵀ U = P is what filterpy expects, and nothing is repaired."""
    generator = np.random.default_rng(1)
    units = np.geomspace(1e-9, 1e3, 6)
    root = generator.normal(size=(6, 9)) * units[:, None]
    p = root @ root.T
    square_root = MatrixSquareRoot()
    u = square_root(p)
    assert np.array_equal(u, np.triu(u))
    assert np.abs((u.T @ u - p) / np.outer(units, units)).max() < 1e-12
    assert square_root.repairs == 0


def test_square_root_of_an_indefinite_matrix_is_usable_and_counted():
    """A P that lost definiteness gets the root of its nearest positive part, and is counted.

    The negative eigenvalue is taken away from the correlation and nothing else is changed, even
    with units twelve decades apart; a matrix with zero variances is no exception.
    """
    generator = np.random.default_rng(2)
    units = np.geomspace(1e-9, 1e3, 5)
    vectors, _ = np.linalg.qr(generator.normal(size=(5, 5)))
    values = np.array([2.0, 1.0, 1.0, 0.5, -0.1])
    correlation = vectors * values @ vectors.T
    diagonal = np.sqrt(np.diag(correlation))
    values, vectors = np.linalg.eigh(correlation / np.outer(diagonal, diagonal))
    assert values[0] < 0.0
    scale = units * diagonal
    nearest = vectors * np.maximum(values, 0.0) @ vectors.T
    indefinite = vectors * values @ vectors.T * np.outer(scale, scale)
    square_root = MatrixSquareRoot()
    u = square_root(indefinite)
    assert square_root.repairs == 1
    assert np.array_equal(u, np.triu(u))
    assert np.abs(u.T @ u / np.outer(scale, scale) - nearest).max() < 1e-12
    singular = square_root(np.diag([4.0, 0.0, 1e-20]))
    assert square_root.repairs == 2
    assert np.allclose(np.abs(np.diag(singular)), [2.0, 0.0, 1e-10], rtol=1e-6, atol=1e-7)


class Parabola:
    """h(x) = x₀² + x₁ / 10: so curved that a negative centre weight breaks P."""

    def predict(self, k: int, x: np.ndarray) -> np.ndarray:
        return x[..., :1] ** 2 + 0.1 * x[..., 1:2]

    def jacobian(self, k: int, x: np.ndarray) -> np.ndarray:
        return np.stack([2.0 * x[..., :1], np.full_like(x[..., :1], 0.1)], axis=-1)


def parabola(epochs: int = 10) -> Problem:
    return Problem(
        times=np.arange(1.0, epochs + 1.0),
        measurements=np.ones((epochs, 1)),
        noise_cov=np.array([[1e-4]]),
        transition=np.tile(np.eye(2), (epochs, 1, 1)),
        process_cov=np.tile(0.01 * np.eye(2), (epochs, 1, 1)),
        prior_mean=np.array([0.5, 0.0]),
        prior_cov=np.eye(2),
        model=Parabola(),
        layout=(),
    )


def test_ukf_survives_and_counts_the_loss_of_definiteness():
    """Where plain filterpy's P becomes indefinite, ours is repaired and the repairs counted."""
    settings = {-1.5: True, 1.0: False}
    for kappa, broken in settings.items():
        estimate = estimator(f"filterpy-ukf[kappa={kappa}]").estimate(parabola(), rng())
        assert np.isfinite(estimate.mean).all()
        assert (np.linalg.eigvalsh(estimate.cov)[:, 0] > 0.0).all()
        assert (estimate.info["covariance_repairs"] > 0) == broken


@pytest.mark.parametrize("kappa", ["-15", "-15.5", "-1e9"])
def test_sigma_points_that_do_not_exist_are_refused_with_a_reason(kappa):
    """With n + κ ≤ 0 there are no sigma points: the estimator says so instead of failing."""
    problem, _ = simulated("0.01E-0.2Hz")
    reason = estimator(f"ukf[kappa={kappa}]").skip(problem)
    assert reason is not None and "n + kappa must be positive" in reason
    assert estimator("ukf[kappa=-14.9]").skip(problem) is None
    assert estimator("ukf[points=julier]").skip(problem) is None


@pytest.mark.parametrize("lag", [0.1, 0.3, 0.35, 0.7, 1.0, 10.0])
def test_fixed_lag_sees_its_whole_window(lag):
    """At 10 Hz a lag of 0.3 s is three epochs, although 0.3 is no multiple of 0.1 in binary.

    Equal to Rauch-Tung-Striebel over windows of ⌊lag / period⌋ epochs, the window of the bound.
    """
    problem = linear_problem(seed=5, period=0.1)
    graph = estimator(f"gtsam[mode=fixed-lag,lag={lag}]")
    assert graph.skip(problem) is None
    estimate = graph.estimate(problem, rng())
    expected = smoothed(problem, int(np.floor(lag / 0.1 + 1e-9)))
    assert max(deviation(estimate.mean, estimate.cov, *expected)) < 1e-9


@dataclass
class Wrong:
    """A linear model with one thing wrong."""

    kind: str

    def predict(self, k: int, x: np.ndarray) -> np.ndarray:
        if self.kind == "raises":
            raise LookupError("no map here")
        h = linear_problem(0).model.predict(k, x)
        return {"h too long": np.zeros(3), "h too short": h[:1], "h nan": h * np.nan}.get(
            self.kind, h
        )

    def jacobian(self, k: int, x: np.ndarray) -> np.ndarray:
        h = linear_problem(0).model.jacobian(k, x)
        return {
            "one-dimensional": h[0],
            "one column": h[:, :1],
            "too narrow": h[:, :-1],
            "too wide": np.hstack([h, h]),
            "too tall": np.vstack([h, h]),
            "transposed": h.T,
            "three-dimensional": h[None],
            "none": None,
        }.get(self.kind, h)


WRONG = {
    "one-dimensional": "ValueError",
    "one column": "ValueError",
    "too narrow": "ValueError",
    "too wide": "ValueError",
    "too tall": "ValueError",
    "transposed": "ValueError",
    "three-dimensional": "ValueError",
    "none": "ValueError",
    "h too long": "ValueError",
    "h too short": "ValueError",
    "h nan": "Error",
    "raises": "LookupError: no map here",
}


def confess() -> None:
    """Run every graph on every wrong model; print what came of it, one line each."""
    problem = linear_problem(0)
    for kind in WRONG:
        for label in ON_GTSAM:
            try:
                estimator(label).estimate(changed(problem, model=Wrong(kind)), rng())
                outcome = "accepted"
            except Exception as error:
                outcome = f"{type(error).__name__}: {error}"
            print(f"{kind}|{label}|{' '.join(outcome.split())}", flush=True)


@functools.cache
def confessions() -> tuple[dict[tuple[str, str], str], int]:
    """Outcomes of :func:`confess` in a process of its own, and its exit code."""
    done = subprocess.run(
        [sys.executable, "-c", "import test_estimators; test_estimators.confess()"],
        cwd=Path(__file__).parent,
        env=os.environ | {"PYTHONPATH": str(Path(__file__).parents[1])},
        capture_output=True,
        text=True,
        timeout=100,
    )
    lines = [line.split("|", 2) for line in done.stdout.splitlines()]
    return {(kind, label): outcome for kind, label, outcome in lines}, done.returncode


@pytest.mark.parametrize("kind", WRONG)
def test_a_wrong_model_is_an_exception(kind):
    """What the graph is given is held to its shape before GTSAM has it.

    Of one mode, in this process, which a failure would kill; of all modes below.
    """
    name, _, sentence = WRONG[kind].partition(": ")
    with pytest.raises(Exception, match=sentence or None) as raised:
        estimator("gtsam").estimate(changed(linear_problem(0), model=Wrong(kind)), rng())
    assert name in type(raised.value).__name__


@pytest.mark.long
@pytest.mark.parametrize("kind", WRONG)
@pytest.mark.parametrize("label", ON_GTSAM)
def test_a_wrong_model_is_an_exception_in_python(label, kind):
    """GTSAM dies of a callback's wrong Jacobian or takes it silently: both are caught before.

    In a process of its own: the failure that is guarded against kills the interpreter. What the
    model itself raises comes through as it was raised.
    """
    outcomes, returncode = confessions()
    assert returncode == 0
    assert WRONG[kind] in outcomes[kind, label]


def map_cost(problem: Problem, mean: np.ndarray) -> float:
    """Half the squared residuals of prior, motion and measurements at a trajectory (K, n)."""
    units = np.sqrt(np.diag(problem.prior_cov))
    sizes = np.outer(units, units)
    phi, q = problem.transition, problem.process_cov
    first = phi[0] @ problem.prior_cov @ phi[0].T + q[0]
    residual = (mean[0] - phi[0] @ problem.prior_mean) / units
    cost = residual @ np.linalg.solve(first / sizes, residual)
    for k in range(problem.epochs):
        if k:
            # Directions without noise have no residual; the others are weighed by Q's inverse.
            residual = (mean[k] - phi[k] @ mean[k - 1]) / units
            noisy = np.diag(q[k]) > 0.0
            assert np.abs(residual[~noisy]).max() < 1e-9
            block = (q[k] / sizes)[np.ix_(noisy, noisy)]
            cost += residual[noisy] @ np.linalg.solve(block, residual[noisy])
        residual = problem.measurements[k] - problem.model.predict(k, mean[k])
        cost += residual @ np.linalg.solve(problem.noise_cov, residual)
    return 0.5 * cost


def test_batch_graph_finds_the_minimum_of_the_cost():
    """The batch answer is the maximum a posteriori: no step from it lowers the cost.

    The cost is written down here independently of GTSAM; it is below that of the start (the
    propagated prior), equals the one the optimizer reports, and rises in random directions that
    the motion allows (moved starts, propagated with Φ).
    """
    problem, _ = simulated("0.01E-0.2Hz")
    batch = estimated("0.01E-0.2Hz", "factor-graph[mode=batch]")
    start = estimated("0.01E-0.2Hz", "ins").mean
    lowest = map_cost(problem, batch.mean)
    assert lowest < 0.1 * map_cost(problem, start)
    assert lowest == pytest.approx(batch.info["error"], rel=1e-6)
    generator = np.random.default_rng(4)
    for _ in range(20):
        step = np.empty_like(batch.mean)
        step[0] = 0.1 * np.linalg.cholesky(batch.cov[0]) @ generator.standard_normal(15)
        for k in range(1, problem.epochs):
            step[k] = problem.transition[k] @ step[k - 1]
        # Both ways, so that the slope, which is zero there, does not count.
        both = map_cost(problem, batch.mean + step), map_cost(problem, batch.mean - step)
        assert min(both) > lowest


def test_an_incremental_graph_is_linearised_anew_at_every_reading():
    """Each of its first answers, where errors are largest, is that of a batch of the same readings.

    To a thousandth of a deviation; linearised anew every tenth time it is 20 times further off.
    """
    problem, _ = simulated("0.001E-1Hz-unfiltered")
    found = estimated("0.001E-1Hz-unfiltered", "factor-graph[mode=isam2]")
    for epochs in (2, 3, 5, 8):
        so_far = {
            name: getattr(problem, name)[:epochs]
            for name in ("times", "measurements", "transition", "process_cov")
        }
        batch = estimator("gtsam[mode=batch]").estimate(changed(problem, **so_far), rng())
        sigma = np.sqrt(np.diag(batch.cov[-1]))
        assert np.abs((found.mean[epochs - 1] - batch.mean[-1]) / sigma).max() < 1e-3


@pytest.mark.parametrize("real", [False, True], ids=["linear", "real"])
def test_states_without_noise_are_constant_in_the_batch_answer(real):
    """A singular Q stays singular: constant states are the same at every epoch, to rounding."""
    problem = simulated("0.01E-1Hz")[0] if real else linear_problem(3)
    constant = slice(9, 15) if real else CONSTANT
    assert not problem.process_cov[:, constant, constant].any()
    batch = estimator("gtsam[mode=batch]").estimate(problem, rng())
    sigma = np.sqrt(np.diag(problem.prior_cov))[constant]
    assert (np.ptp(batch.mean[:, constant], axis=0) / sigma).max() < 1e-12
    variances = np.diagonal(batch.cov, axis1=1, axis2=2)[:, constant]
    assert (np.ptp(variances, axis=0) / variances[0]).max() < 1e-9


@pytest.mark.parametrize(
    "label",
    [pytest.param(text, marks=pytest.mark.long) if "loss" in text else text for text in ON_GTSAM],
)
def test_graphs_are_released(label):
    """No solve keeps its callbacks: each of 10 models is gone when its answer is there."""
    alive = []
    for seed in range(10):
        problem = linear_problem(seed, epochs=10)
        alive.append(weakref.ref(problem.model))
        estimator(label).estimate(problem, rng())
        del problem
    gc.collect()
    assert sum(reference() is not None for reference in alive) == 0


SLOW_BEYOND = ("rao-blackwellised", "correlation", "tercom", "tercom-ekf")


@functools.cache
def beyond_the_map() -> Problem:
    """A flight with a prior of 300 km."""
    case = scenario.load("wang2013").case("0.01E-0.2Hz").model_dump()
    case["initial_error"]["position_m"] = 3e5
    return simulate(prepare(CaseSpec.model_validate(case)), SEED, 0)[0]


@pytest.mark.parametrize(
    "label",
    [
        # Of each family its default; and what has thousands of points beyond a map is slow there.
        pytest.param(text, marks=pytest.mark.long)
        if "[" in text
        or text in ("rao-blackwellised", "correlation", "tercom", "tercom-ekf")
        or is_slow(text)
        else text
        for text in labels()
        if text not in SLOW or text.endswith("[loss=cauchy]")
    ],
)
def test_a_prior_beyond_the_map_crashes_nothing(label):
    """With a prior of 300 km, trial points lie far outside the map: every run still ends.

    With an answer of finite numbers; how good it can be is not asked.
    """
    problem = beyond_the_map()
    far = np.zeros((4, 15))
    far[:, :3] = [[1e7, 0, 0], [0, 1e8, 0], [0, 0, 1e9], [1e12, 1e12, 1e12]]
    assert np.isfinite(problem.model.predict(0, far)).all()
    refused = estimator(label).skip(problem)
    if refused:  # a grid of 15 states, a density that does not exist
        pytest.skip(refused)
    estimate = estimator(label).estimate(problem, rng())
    assert np.isfinite(estimate.mean).all()
    assert np.isfinite(estimate.cov).all()
