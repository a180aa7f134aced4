"""Viterbi over cells of the position: found from a wide prior, honest about what it leaves out."""

from __future__ import annotations

import numpy as np
import pytest
from problems import changed, estimator, linear_problem, noisy_problem, refusal, rng
from rough_field import rough_flight

from ggbench.reduced import displacing

LABELS = ("viterbi", "viterbi[decode=marginal]", "viterbi[decode=forward]")


@pytest.mark.parametrize("label", LABELS)
def test_a_wide_prior_does_no_harm(label):
    """From 1.5 correlation lengths away to within a cell, in the second half of a flight.

    The covariance is of that size: NEES of the horizontal position over it below 6, where 2 is
    expected and one that is sure of a wrong place has thousands.
    """
    problem, truth = rough_flight(1, 3000.0, epochs=40, noise=1.0)
    solver = estimator(f"{label[:-1]},most=34000]" if "[" in label else f"{label}[most=34000]")
    assert solver.skip(problem) is None
    found = solver.estimate(problem, rng())
    off = (found.mean - truth)[20:, :2]
    assert np.linalg.norm(truth[20, :2]) > 2000.0
    assert np.sqrt((off**2).sum(axis=1).mean()) < found.info["cell_m"]
    nees = [e @ np.linalg.solve(p, e) for e, p in zip(off, found.cov[20:, :2, :2], strict=True)]
    assert np.mean(nees) < 6.0
    assert found.info["mean_cells"] > 10


def test_a_path_is_of_centres_and_its_covariance_is_about_it():
    """Steps of the path are whole cells; the covariance has the distance to the mean in it."""
    problem, _ = rough_flight(1, 100.0, epochs=10, noise=1.0)
    path, mean = (
        estimator(f"viterbi[decode={d}]").estimate(problem, rng()) for d in ("path", "marginal")
    )
    steps = np.diff(path.mean[:, :2], axis=0) / path.info["cell_m"]
    np.testing.assert_allclose(steps, np.rint(steps), atol=1e-9)
    assert np.abs(np.diff(mean.mean[:, :2], axis=0) / path.info["cell_m"] % 1.0).max() > 0.01
    off = (path.mean - mean.mean)[:, :3]
    assert np.abs(off).max() > 1.0
    np.testing.assert_allclose(
        path.cov[:, :3, :3], mean.cov[:, :3, :3] + off[:, :, None] * off[:, None], atol=1e-6
    )


def test_steps_of_the_error_are_those_of_the_velocity():
    """A velocity of 0.3 m/s that nothing corrects moves a position by 0.3 m in the first second.

    And by more later, as unknown accelerations have made it larger by then.
    """
    problem, _ = rough_flight(0, 100.0, epochs=50)
    cov = displacing(problem, (0, 1, 2))
    acceleration = 0.25 * 0.003**2  # over half a second squared
    np.testing.assert_allclose(cov[0], (0.3**2 + acceleration) * np.eye(3), rtol=1e-9)
    assert (np.diff(cov[:, 0, 0]) > 0.0).all()
    none = changed(problem, transition=np.tile(np.eye(9), (50, 1, 1)))
    assert not displacing(none, (0, 1, 2)).any()


def test_what_a_reading_depends_on_beside_the_position_is_noise():
    """Biases of the channels that are states, left out: the position is known less well."""
    problem, _ = rough_flight(2, 100.0, epochs=8, m=1, noise=1.0)
    inner = problem.model

    class Biased:
        def predict(self, k: int, x: np.ndarray) -> np.ndarray:
            return inner.predict(k, x) + 1000.0 * np.asarray(x)[..., 6:7]

        def jacobian(self, k: int, x: np.ndarray) -> np.ndarray:
            rows = inner.jacobian(k, x)
            rows[..., 6] = 1000.0
            return rows

    solver = estimator("viterbi[decode=marginal]")
    plain = solver.estimate(problem, rng())
    biased = solver.estimate(changed(problem, model=Biased()), rng())
    wider = np.sqrt(biased.cov[:, 0, 0] / plain.cov[:, 0, 0])
    assert np.median(wider) > 1.1


@pytest.mark.parametrize("vertical", [0.01, pytest.param(200.0, marks=pytest.mark.long)])
def test_a_height_that_is_known_is_no_state(vertical):
    """The estimate of one that no reading can tell more of is the INS's, epoch by epoch."""
    problem, _ = rough_flight(3, 100.0, epochs=10, noise=1.0, vertical=vertical)
    found = estimator("viterbi").estimate(problem, rng())
    own = estimator("ins").estimate(problem, rng())
    known = bool(np.allclose(found.cov[:, 2, 2], own.cov[:, 2, 2]))
    assert known == (vertical < 1.0)


@pytest.mark.parametrize(
    ("setting", "reason"),
    [
        ("cell_m=0", "parameter 'cell_m' is"),
        ("cell_m=nan", "parameter 'cell_m' is"),
        ("most=10", "parameter 'most' is"),
        ("drift=0", "parameter 'drift' is"),
        ("drift=inf", "parameter 'drift' is"),
        ("cell_m=0.001", "too small for INS errors that change"),
    ],
)
def test_settings_that_mean_nothing_are_refused(setting, reason):
    problem, _ = rough_flight(0, 100.0, epochs=5)
    assert reason in refusal(f"viterbi[{setting}]", problem)


@pytest.mark.parametrize("problem", [linear_problem(0), noisy_problem(0)])
def test_problems_without_an_ins_are_refused(problem):
    assert "no errors of position and velocity" in (estimator("viterbi").skip(problem) or "")
