"""Matching by windows: places that fit are found, weighed for what they are, and used once."""

from __future__ import annotations

import numpy as np
import pytest
from oracles import solver
from problems import changed, deviation, kalman, noisy_problem, propagated, refusal, rng
from rough_field import RoughModel, constant_offset, rough_flight
from scipy.stats import chi2
from thinning import thinned

from ggbench.problem import Estimate, Problem

CRITERIA = ("msd", "mad", "ml", "cor", "ncc", "nccdm")


def settled(problem: Problem, label: str) -> Estimate:
    return solver(label).estimate(problem, rng())


def at_rest(seed: int, offset: tuple[float, float, float], sigma: float = 2000.0) -> Problem:
    """A track whose INS is off by a constant, and readings without any error."""
    return constant_offset(seed, offset, sigma)


@pytest.mark.parametrize(
    "criterion",
    [
        pytest.param(criterion, marks=() if criterion in ("msd", "nccdm") else pytest.mark.long)
        for criterion in CRITERIA
    ],
)
def test_a_constant_offset_is_found(criterion):
    """Without noise to 0.1 m, by every criterion that its grid leads to the right hollow."""
    problem = at_rest(3, (1234.0, -2345.0, 6.0))
    found = settled(problem, f"tercom-ekf[criterion={criterion}]")
    assert found.fixes.accepted.tolist() == [True]
    np.testing.assert_allclose(found.mean[-1, :2], [1234.0, -2345.0], atol=0.1)


@pytest.mark.parametrize("label", ["tercom", "tercom-ekf", "tercom[fusion=none]"])
def test_of_a_linear_problem_a_window_holds_what_its_measurements_do(label):
    """At the end of each window: Kalman's answer, to 1e-9; with ``none`` that of the window alone.

    From its first fix on ``tercom-ekf`` is the Kalman filter. So every measurement is used once.
    Before its first window's end an estimate is the prior, carried along.
    """
    problem = noisy_problem(3)
    name, _, given = label.rstrip("]").partition("[")
    found = settled(problem, f"{name}[window=8,longest=8{',' if given else ''}{given}]")
    ends = [7, 15, 23, 31, 39] if name == "tercom" else [7]
    assert found.fixes.epoch.tolist() == ends and found.fixes.accepted.all()
    held = ends if name == "tercom" else list(range(7, 40))
    for k in held:
        of = problem
        if given == "fusion=none":
            there = problem.present.copy()
            there[: k - 7] = False
            of = unread(problem, there)
        mean, cov, *_ = kalman(of)
        assert max(deviation(found.mean[[k]], found.cov[[k]], mean[[k]], cov[[k]])) < 1e-9
    mean, cov = propagated(problem)
    np.testing.assert_allclose(found.mean[:7], mean[:7], atol=1e-12)
    np.testing.assert_allclose(found.cov[:7], cov[:7], rtol=1e-9)


def unread(problem: Problem, there: np.ndarray) -> Problem:
    """The problem with readings and rows of zero where nothing is there."""
    rows = np.array([problem.model.jacobian(k, problem.prior_mean) for k in range(problem.epochs)])
    rows[~there] = 0.0
    model = type(problem.model)(rows)
    return changed(
        problem, model=model, measurements=np.where(there, problem.measurements, 0.0), present=there
    )


@pytest.mark.long
@pytest.mark.parametrize("claimed", [1.0, 0.4])
def test_fixes_are_as_sure_as_they_say(claimed):
    """NEES of 60 fixes within a prior of 1.5 lengths: mean 2, in the band of one in 10,000.

    Fixes of noise that is told as 0.4 of what it is are not (negative control).
    """
    squares = []
    for seed in range(60):
        problem, truth = rough_flight(seed, 3000.0, epochs=20, noise=1.0, claimed=claimed)
        fixes = settled(problem, "tercom[fusion=none,misfit=100]").fixes
        if fixes.accepted[-1]:
            off = fixes.mean[-1, :2] - truth[19, :2]
            squares.append(off @ np.linalg.solve(fixes.cov[-1][:2, :2], off))
    assert len(squares) > 50
    low, high = chi2.ppf([5e-5, 1.0 - 5e-5], 2 * len(squares)) / len(squares)
    assert (low < np.mean(squares) < high) == (claimed == 1.0)


class Twice(RoughModel):
    """A field that is the same again 6 km further north."""

    def predict(self, k: int, x: np.ndarray) -> np.ndarray:
        return super().predict(k, self._folded(x))

    def jacobian(self, k: int, x: np.ndarray) -> np.ndarray:
        return super().jacobian(k, self._folded(x))

    @staticmethod
    def _folded(x: np.ndarray) -> np.ndarray:
        x = np.array(x, dtype=float)
        x[..., 1] = np.mod(x[..., 1] + 3000.0, 6000.0) - 3000.0
        return x


@thinned("odds", [10, 0])
def test_a_place_that_is_there_twice_is_refused(odds):
    """Two places that fit alike are no fix, unless any odds will do; then it is one of both."""
    problem = at_rest(3, (500.0, 700.0, 0.0), sigma=3000.0)
    model = problem.model
    twice = Twice(model.track, model.waves, model.cosine, model.sine)
    found = settled(changed(problem, model=twice), f"tercom-ekf[odds={odds}]")
    assert found.fixes.accepted.tolist() == [odds == 0]
    assert 0.0 <= found.fixes.statistic[0] < 10.0
    east, north = found.fixes.mean[0, :2]
    assert (east, np.mod(north, 6000.0)) == pytest.approx((500.0, 700.0), abs=1.0)
    if odds:
        np.testing.assert_array_equal(found.mean, np.zeros_like(found.mean))


@pytest.mark.long
def test_readings_that_fit_nowhere_make_no_fix():
    """Of another field than the map's: refused, whatever the odds, and the window grows."""
    problem = at_rest(3, (0.0, 0.0, 0.0))
    wrong = changed(problem, measurements=problem.measurements[::-1] + 30.0)
    found = settled(wrong, "tercom-ekf[odds=0,window=10,longest=20]")
    assert found.fixes.epoch.tolist() == [9, 19]
    assert not found.fixes.accepted.any()
    assert (found.fixes.statistic == -np.inf).all()


def test_what_is_missing_is_no_match():
    """Half of the readings gone: the window is as many as there are, and finds the same place."""
    problem = at_rest(3, (1234.0, -2345.0, 6.0))
    there = problem.present.copy()
    there[::2] = False
    model = Gaps(problem.model, there)
    gone = changed(
        problem, model=model, measurements=np.where(there, problem.measurements, 0.0), present=there
    )
    found = settled(gone, "tercom-ekf[window=10]")
    assert found.fixes.epoch.tolist() == [19]
    np.testing.assert_allclose(found.mean[-1, :2], [1234.0, -2345.0], atol=0.1)


class Gaps:
    """A model of which nothing is read at some epochs."""

    def __init__(self, model: RoughModel, there: np.ndarray) -> None:
        self.model, self.there = model, there

    def predict(self, k: int, x: np.ndarray) -> np.ndarray:
        return np.where(self.there[k], self.model.predict(k, x), 0.0)

    def jacobian(self, k: int, x: np.ndarray) -> np.ndarray:
        return np.where(self.there[k][:, np.newaxis], self.model.jacobian(k, x), 0.0)


@pytest.mark.parametrize(
    ("label", "said"),
    [
        ("tercom[window=0]", "parameter 'window' is"),
        ("tercom[criterion=ncc,window=2]", "needs a window of at least 3"),
        ("tercom[longest=5]", "longest must be at least the window, 20"),
        ("tercom[spacing_m=0]", "parameter 'spacing_m' is"),
        ("tercom[most=0]", "parameter 'most' is"),
        ("tercom[refine=0]", "parameter 'refine' is"),
        ("tercom[misfit=0]", "parameter 'misfit' is"),
        ("tercom-ekf[odds=-1]", "parameter 'odds' is"),
    ],
)
def test_settings_without_a_meaning_are_refused(label, said):
    """A sentence that says what is allowed."""
    assert said in refusal(label, at_rest(3, (0.0, 0.0, 0.0)))
