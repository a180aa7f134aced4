"""Matching by differences: what its J is, what it finds, and what its covariance knows."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pytest
from oracles import solver
from problems import LinearModel, changed, estimator, refusal, rng
from scipy.stats import chi2
from thinning import thinned

from ggbench.estimators.correlation import Sequences
from ggbench.problem import Fixes, Problem, StateBlock

EPOCHS = 16


@dataclass(frozen=True)
class Hills:
    """A smooth field under a straight track: h = f(track_k − x), of two channels.

    With ``period`` it repeats itself to the east, but for a slope; and the farther east the INS is
    off, the better the second channel tells how far north.
    """

    period: float | None = None
    slope: float = 0.0

    def predict(self, k: int, x: np.ndarray) -> np.ndarray:
        east, north = self._place(k, x)
        if self.period is None:
            one = np.sin(east / 700.0) + np.cos((north + 0.5 * east) / 900.0) + 1e-3 * north
            two = np.sin((north - 0.3 * east) / 600.0) + np.cos(east / 1100.0)
        else:
            one = np.sin(2.0 * np.pi * east / self.period) + self.slope * east
            far, off = np.asarray(x)[..., 0], np.asarray(x)[..., 1]
            two = 1e-3 * (1.0 + 0.8 * np.tanh(far / 500.0)) * (off - 200.0)
        return np.stack([one, two], axis=-1)

    def jacobian(self, k: int, x: np.ndarray) -> np.ndarray:
        x = np.asarray(x, dtype=float)
        out = np.zeros((*x.shape[:-1], 2, x.shape[-1]))
        for i in (0, 1):
            step = np.zeros(x.shape[-1])
            step[i] = 0.05
            out[..., i] = (self.predict(k, x + step) - self.predict(k, x - step)) / 0.1
        return out

    @staticmethod
    def _place(k: int, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        x = np.asarray(x)
        return 150.0 * k - x[..., 0], 90.0 * k + 20.0 * (k % 3) - x[..., 1]


def at_rest(
    model: Hills, truth: np.ndarray, sigma: float, noise: float, errors: np.ndarray | None = None
) -> Problem:
    """An INS whose error is constant: a position, known to σ beforehand."""
    clean = np.array([model.predict(k, truth) for k in range(EPOCHS)])
    return Problem(
        times=60.0 * np.arange(1.0, EPOCHS + 1.0),
        measurements=clean if errors is None else clean + errors,
        noise_cov=noise**2 * np.eye(2),
        transition=np.tile(np.eye(2), (EPOCHS, 1, 1)),
        process_cov=np.zeros((EPOCHS, 2, 2)),
        prior_mean=np.zeros(2),
        prior_cov=sigma**2 * np.eye(2),
        model=model,
        layout=(StateBlock("position error", slice(0, 2), "m"),),
    )


def fixed(problem: Problem, label: str) -> Fixes:
    fixes = solver(label).estimate(problem, rng()).fixes
    assert fixes is not None
    return fixes


@thinned("association", ["nearest", "reciprocal", "likelihood"])
@pytest.mark.parametrize(
    ("differenced", "descending"),
    [
        ("true", "true"),
        pytest.param("true", "false", marks=pytest.mark.long),
        pytest.param("false", "true", marks=pytest.mark.long),
        ("false", "false"),
    ],
)
def test_without_noise_a_constant_offset_is_found(association, differenced, descending):
    """To 0.1 m (σ 1 km); J is zero there and the other candidates weigh nothing."""
    truth = np.array([731.0, -1204.0])
    problem = at_rest(Hills(), truth, 1000.0, 1e-4)
    settings = f"association={association},differenced={differenced},descending={descending}"
    label = f"correlation[window={EPOCHS},spacing_m=100,{settings}"
    nodes = fixed(problem, f"{label},candidates=nodes]")
    fixes = fixed(problem, f"{label}]")
    if association != "reciprocal":  # it always weighs all five
        np.testing.assert_allclose(fixes.mean, [truth], atol=0.1)
    assert np.abs(nodes.mean - truth).max() < 100.0
    assert np.abs(fixes.mean - truth).max() < 3000.0


@pytest.mark.parametrize("differenced", [True, False])
@pytest.mark.parametrize("descending", [True, False])
def test_j_is_the_weighted_sum_of_the_paper(differenced, descending):
    """Σ p_i [(z_{i+1} − z_i) − (h_{i+1} − h_i)]² of each channel's own consecutive readings."""
    model, errors = Hills(), np.random.default_rng(1).normal(size=(EPOCHS, 2))
    problem = at_rest(model, np.array([100.0, 50.0]), 500.0, 0.5, errors)
    present = np.ones((EPOCHS, 2), dtype=bool)
    present[[0, 4, 5], 0] = present[4, 1] = False

    @dataclass(frozen=True)
    class Gaps:
        def predict(self, k: int, x: np.ndarray) -> np.ndarray:
            return model.predict(k, x) * present[k]

        def jacobian(self, k: int, x: np.ndarray) -> np.ndarray:
            return model.jacobian(k, x) * present[k][:, None]

    problem = changed(
        problem, present=present, measurements=problem.measurements * present, model=Gaps()
    )
    search = Sequences(problem, 250.0, 1000, differenced, descending)
    search.take(EPOCHS)
    axes = np.linalg.eigh(problem.prior_cov)[1]
    values = search.values()
    for point, value in list(zip(search.points, values, strict=True))[::7]:
        total = weights = 0.0
        for c in range(2):
            read = [k for k in range(EPOCHS) if present[k, c]]
            off = [
                (problem.measurements[k] - model.predict(k, axes @ point))[c] / 0.5 for k in read
            ]
            terms = [b - a for a, b in pairwise(off)] if differenced else off
            for i, term in enumerate(terms):
                p = 1.0 - 0.5 * i / (len(terms) - 1) if descending else 1.0
                total, weights = total + p * term**2, weights + p
        assert value == pytest.approx(total / weights, rel=1e-9)


@pytest.mark.long
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_likelihood_weighs_two_basins_as_the_posterior_does(seed):
    """A field that repeats itself, but for a slope: mean, covariance and odds are the integral's.

    By quadrature of prior times likelihood. One hollow is several times as wide as the other.
    """
    drawn, noise, sigma = np.random.default_rng(seed), 0.3, 1000.0
    model = Hills(period=2000.0, slope=5e-5)
    truth = np.array([-900.0, 200.0])
    problem = at_rest(model, truth, sigma, noise, noise * drawn.normal(size=(EPOCHS, 2)))
    label = f"correlation[window={EPOCHS},spacing_m=50,association=likelihood,differenced=false]"
    fixes = fixed(problem, label)
    east, north = np.arange(-4000.0, 4000.0, 10.0), np.arange(-1500.0, 1900.0, 15.0)
    grid = np.stack(np.meshgrid(east, north, indexing="ij"), axis=-1).reshape(-1, 2)
    log = -0.5 * (grid**2).sum(axis=1) / sigma**2
    for k in range(EPOCHS):
        log += problem.log_likelihood(k, grid)
    share = np.exp(log - log.max())
    share /= share.sum()
    mean = share @ grid
    off = grid - mean
    cov = (off.T * share) @ off
    np.testing.assert_allclose(fixes.mean[0], mean, atol=0.01 * np.sqrt(cov[0, 0]))
    np.testing.assert_allclose(fixes.cov[0], cov, atol=0.01 * cov[0, 0])
    basins = [
        share[np.abs(grid[:, 0] - truth[0] - shift) < 1000.0].sum()
        for shift in (-2000.0, 0.0, 2000.0, 4000.0)
    ]
    most, next_best = sorted(basins)[::-1][:2]
    assert fixes.statistic[0] == pytest.approx(np.log(most / next_best), abs=0.03)
    assert next_best > 0.02  # there are two


def test_reciprocal_weights_lie_between_hills_and_the_covariance_says_so():
    """Where two places fit, 1/J puts the mean between them; nearest takes one of them."""
    model = Hills(period=2000.0, slope=2e-5)
    errors = 0.3 * np.random.default_rng(5).normal(size=(EPOCHS, 2))
    problem = at_rest(model, np.array([-900.0, 200.0]), 700.0, 0.3, errors)
    label = f"correlation[window={EPOCHS},spacing_m=50,keep=2,differenced=false,association="
    one, both = fixed(problem, f"{label}nearest]"), fixed(problem, f"{label}reciprocal]")
    nearest_hill = np.min(np.abs(both.mean[0, 0] - (-900.0 + 2000.0 * np.arange(-2, 4))))
    assert np.min(np.abs(one.mean[0, 0] - (-900.0 + 2000.0 * np.arange(-2, 4)))) < 150.0
    assert nearest_hill > 300.0
    assert both.cov[0, 0, 0] > 500.0**2 > 10.0 * one.cov[0, 0, 0]


def drifting(seed: int, sigma: float = 500.0) -> tuple[Problem, np.ndarray]:
    """A linear problem: a position that is lost, a velocity that is not known, a biased reading."""
    drawn = np.random.default_rng(seed)
    phi = np.eye(5)
    phi[0, 2] = phi[1, 3] = 60.0
    rows = np.zeros((EPOCHS, 1, 5))
    rows[:, 0, :2] = 2e-3 * drawn.normal(size=(EPOCHS, 2)).cumsum(axis=0)
    rows[:, 0, 2], rows[:, 0, 4] = 5.0, 1.0
    prior = np.diag([sigma**2, sigma**2, 0.1**2, 0.1**2, 3.0**2])
    process = np.diag([0.0, 0.0, 4e-3, 4e-3, 1e-2])
    x = np.linalg.cholesky(prior) @ drawn.normal(size=5)
    measurements = np.empty((EPOCHS, 1))
    for k in range(EPOCHS):
        x = phi @ x + np.sqrt(np.diag(process)) * drawn.normal(size=5)
        measurements[k] = rows[k] @ x + 0.5 * drawn.normal()
    problem = Problem(
        times=60.0 * np.arange(1.0, EPOCHS + 1.0),
        measurements=measurements,
        noise_cov=np.array([[0.25]]),
        transition=np.tile(phi, (EPOCHS, 1, 1)),
        process_cov=np.tile(process, (EPOCHS, 1, 1)),
        prior_mean=np.zeros(5),
        prior_cov=prior,
        model=LinearModel(rows),
        layout=(
            StateBlock("position error", slice(0, 2), "m"),
            StateBlock("velocity error", slice(2, 4), "m/s"),
            StateBlock("bias", slice(4, 5), "mGal"),
        ),
    )
    return problem, x


@pytest.mark.parametrize(
    "settings",
    [
        pytest.param("candidates=nodes,keep=1", marks=pytest.mark.long),
        "candidates=nodes,keep=1,differenced=false",
        pytest.param("candidates=basins", marks=pytest.mark.long),
    ],
)
def test_the_covariance_of_a_fix_knows_of_drift_and_bias(settings):
    """Mean NEES of 60 fixes, two states each, in its 99.9 % band: one false alarm in a thousand.

    Also of readings that are matched with their bias: J is then wrong, and known to be.
    """
    label = f"correlation[window={EPOCHS},spacing_m=50,misfit=1e9,odds=0,{settings}]"
    total, runs = 0.0, 60
    for seed in range(runs):
        problem, truth = drifting(seed)
        fixes = fixed(problem, label)
        off = fixes.mean[0] - truth[:2]
        total += off @ np.linalg.solve(fixes.cov[0], off)
    low, high = chi2.ppf([0.0005, 0.9995], 2 * runs) / runs
    assert low < total / runs < high


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ("window=2", "parameter 'window' is"),
        ("keep=0", "parameter 'keep' is"),
        ("spacing_m=0", "parameter 'spacing_m' is"),
        ("most=0", "parameter 'most' is"),
        ("misfit=0", "parameter 'misfit' is"),
        ("odds=-1", "parameter 'odds' is"),
    ],
)
def test_settings_without_a_meaning_are_refused(settings, words):
    problem = at_rest(Hills(), np.zeros(2), 100.0, 0.1)
    assert words in refusal(f"correlation[{settings}]", problem)


def test_a_problem_without_a_position_is_refused():
    problem = at_rest(Hills(), np.zeros(2), 100.0, 0.1)
    nowhere = changed(problem, layout=(StateBlock("bias", slice(0, 2), "mGal"),))
    assert "two states in metres are needed" in (estimator("correlation").skip(nowhere) or "")
