"""ICCP: a track onto the contours of one channel's readings, from where the INS says it is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from problems import changed, estimator, linear_problem, refusal, rng
from rough_field import RoughModel, rough_flight

from ggbench.problem import Channel, InsSolution, Problem
from ggbench.sensors.aiding import corrected_positions

SPEED = 250.0
NAMES = ("gradient yz", "gradient zz")


@dataclass(frozen=True)
class Less:
    """The rough field where the vehicle is: where the INS says, less its error."""

    inner: RoughModel

    def predict(self, k: int, x: np.ndarray) -> np.ndarray:
        return self.inner.predict(k, -np.asarray(x))

    def jacobian(self, k: int, x: np.ndarray) -> np.ndarray:
        return -self.inner.jacobian(k, -np.asarray(x))


def straight(
    seed: int, error: tuple[float, float], drift: tuple[float, float], sigma: float = 150.0
) -> tuple[Problem, np.ndarray]:
    """A straight flight whose error is constant but for a drift [m/s], read without noise.

    The INS believes in a deviation of σ and of 3 m/s; height and acceleration are known.
    """
    problem, _ = rough_flight(seed, sigma, epochs=40, m=2)
    model = Less(problem.model)
    truth = np.zeros((40, 9))
    truth[:, :2] = np.array(error) + problem.times[:, None] * drift
    truth[:, 3:5] = drift
    indicated = np.stack([SPEED * np.arange(40.0), np.zeros(40), np.zeros(40)], axis=1)
    first = np.array([0.6, -1.4, 1000.0])
    track = InsSolution(
        corrected_positions(np.tile(first, (40, 1)), -indicated),
        np.tile([SPEED, 0.0, 0.0], (40, 1)),
        np.tile(np.eye(3), (40, 1, 1)),
    )
    prior = np.diag([sigma**2, sigma**2, 1e-4, 9.0, 9.0, 1e-6, 1e-10, 1e-10, 1e-10])
    return changed(
        problem,
        model=model,
        prior_cov=prior,
        process_cov=np.zeros((40, 9, 9)),
        track=track,
        measurements=np.array([model.predict(k, x) for k, x in enumerate(truth)]),
        channels=tuple(Channel(name, "E", "gradiometer") for name in NAMES),
    ), truth


@pytest.mark.parametrize(
    ("drift", "transform"),
    [((0.0, 0.0), "rigid"), ((0.0, 2.0), "rigid"), ((2.0, 2.0), "similarity")],
)
def test_a_track_is_brought_where_it_was_flown(drift, transform):
    """From 180 m away to 2 m, in the end of a window of forty points over five hills.

    Turned, where the error drifts across the track; stretched, where it drifts along it.
    """
    problem, truth = straight(1, (150.0, -100.0), drift)
    found = estimator(f"iccp[window=40,transform={transform}]").estimate(problem, rng())
    assert found.info["channel"] == "gradient zz"
    assert found.fixes.epoch.tolist() == [39] and found.fixes.accepted.all()
    assert np.linalg.norm(found.fixes.mean[0] - truth[-1, :2]) < 1.0


def test_a_drift_that_is_known_is_taken_out_before():
    """Of a velocity error that the prior tells: no turn is left to be found, and none allowed."""
    problem, truth = straight(1, (150.0, -100.0), (0.0, 3.0))
    mean, prior = problem.prior_mean.copy(), problem.prior_cov.copy()
    mean[4], prior[4, 4] = 3.0, 1e-6
    known = changed(problem, prior_mean=mean, prior_cov=prior)
    found = estimator("iccp[window=40]").estimate(known, rng())
    assert np.linalg.norm(found.fixes.mean[0] - truth[-1, :2]) < 1.0
    # Told of none, and sure of it, the track keeps its wrong direction.
    sure = estimator("iccp[window=40]").estimate(changed(problem, prior_cov=prior), rng())
    assert np.linalg.norm(sure.fixes.mean[0] - truth[-1, :2]) > 20.0


def test_a_rigid_track_cannot_be_stretched():
    """The negative control: a drift along the track, which only a similarity takes out."""
    problem, truth = straight(1, (150.0, -100.0), (2.0, 2.0))
    found = estimator("iccp[window=40]").estimate(problem, rng())
    assert np.linalg.norm(found.fixes.mean[0] - truth[-1, :2]) > 10.0


@pytest.mark.long
def test_from_another_hill_it_does_not_come_back():
    """From two correlation lengths away the nearest contours are wrong ones, and it does not know.

    What its file says of the covariance: the error is more than five times as large.
    """
    problem, truth = straight(2, (3500.0, 2500.0), (0.0, 0.0), sigma=3000.0)
    found = estimator("iccp[window=40,misfit=1e9]").estimate(problem, rng())
    lost = np.linalg.norm(found.fixes.mean[0] - truth[-1, :2])
    assert lost > 500.0
    assert lost > 5.0 * np.sqrt(np.trace(found.fixes.cov[0]))


def test_readings_are_used_once_or_windows_slide():
    """Of 40 epochs, of which the fourth and fifth are silent: every tenth reading, or each."""
    problem, _ = straight(2, (60.0, 40.0), (0.0, 0.0))
    there = np.ones((40, 2), dtype=bool)
    there[3:5, 1] = False
    problem = changed(problem, present=there)
    once = estimator("iccp[window=10]").estimate(problem, rng())
    assert once.fixes.epoch.tolist() == [11, 21, 31]
    slid = estimator("iccp[window=10,fusion=none]").estimate(problem, rng())
    assert slid.fixes.epoch.tolist() == list(range(11, 40))
    # Before the first fix the answer is the prior, and a window that slides has no memory.
    for found in (once, slid):
        assert not found.mean[:11].any() and found.cov[10, 0, 0] > 150.0**2
    deviations = [np.sqrt(np.trace(found.cov[-1, :2, :2])) for found in (once, slid)]
    assert deviations[0] < deviations[1]


@pytest.mark.long
def test_a_height_that_is_not_known_is_in_the_covariance():
    """Twice the deviation of the height is more of the position's; the misfit is, too."""
    problem, _ = straight(3, (60.0, 40.0), (0.0, 0.0))
    widths = []
    for height, noise in ((0.01, 0.0), (100.0, 0.0), (0.01, 1.0)):
        prior = problem.prior_cov.copy()
        prior[2, 2], prior[3, 3] = height**2, 1e-4
        more = noise * np.random.default_rng(1).standard_normal((40, 2))
        made = changed(problem, prior_cov=prior, measurements=problem.measurements + more)
        found = estimator("iccp[window=40,misfit=1e9]").estimate(made, rng())
        widths.append(np.sqrt(np.trace(found.fixes.cov[0])))
    assert widths[1] > 2.0 * widths[0]
    assert widths[2] > 2.0 * widths[0]


def test_a_misfit_is_refused():
    """Readings of ten times their noise: the fix is told, and not believed."""
    problem, _ = straight(3, (60.0, 40.0), (0.0, 0.0))
    more = np.random.default_rng(1).standard_normal((40, 2))
    found = estimator("iccp[window=40]").estimate(
        changed(problem, measurements=problem.measurements + more), rng()
    )
    assert not found.fixes.accepted.any() and found.fixes.statistic[0] < -25.0
    assert not found.mean.any()


@pytest.mark.parametrize(
    ("setting", "reason"),
    [
        ("window=2", "parameter 'window' is"),
        ("cell_m=0", "parameter 'cell_m' is"),
        ("cell_m=nan", "parameter 'cell_m' is"),
        ("misfit=0", "parameter 'misfit' is"),
        ("channel=gradient xx", "no channel gradient xx: the problem has gradient yz, gradient zz"),
    ],
)
def test_settings_that_mean_nothing_are_refused(setting, reason):
    problem, _ = straight(0, (0.0, 0.0), (0.0, 0.0))
    assert reason in refusal(f"iccp[{setting}]", problem)


def test_problems_without_a_track_or_a_channel_are_refused():
    problem, _ = straight(0, (0.0, 0.0), (0.0, 0.0))
    solver = estimator("iccp")
    assert solver.skip(problem) is None
    assert "no INS track" in (solver.skip(linear_problem(0)) or "")
    assert "no channel gradient zz or" in (solver.skip(changed(problem, channels=())) or "")
    assert "position and velocity" in (solver.skip(changed(problem, layout=())) or "")
