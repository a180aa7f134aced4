"""A log that nobody here simulated: a minute of comma2k19, aided by GNSS velocities alone."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import ggbench as gg
from ggbench.recorded.corrected import against, residuals
from ggbench.recorded.flight import read_flight

LOG = Path(__file__).parents[2] / "scenarios" / "data" / "comma2k19" / "flight.toml"


@pytest.fixture(scope="module")
def log():
    return read_flight(LOG)


def test_the_problem_is_what_was_recorded(log):
    """A minute at 10 Hz; what the receiver does not measure, its vertical velocity, is missing."""
    problem = log.problem
    assert (problem.epochs, problem.dimension) == (577, 15)
    assert [channel.name for channel in problem.channels] == [f"velocity {a}" for a in "ENU"]
    np.testing.assert_array_equal(problem.present.all(axis=0), [True, True, False])
    assert not problem.present[:, 2].any()
    assert log.start == pytest.approx(46408.580034)


@pytest.mark.parametrize("label", ["ekf", "ekf", "factor-graph[mode=batch]"])
def test_positions_that_were_kept_back_are_met(log, label):
    """Velocities alone keep the horizontal position of a telephone's INS.

    The receiver's positions, which no estimator is given, are met within a metre and a half after a
    kilometre; unaided, the INS is more than a kilometre off.
    """
    estimate = gg.estimate(log.problem, label)
    errors = against(log.problem, estimate, log.reference, log.spec.windows)
    horizontal = np.linalg.norm(errors.components[:, :2], axis=1)
    ins = np.linalg.norm(log.reference.error_state[:, :2], axis=1)
    assert np.nanmax(horizontal) < 1.5
    assert np.nanmax(ins) > 1000.0
    # Nothing measures the height: it drifts, and the estimate says so.
    assert np.abs(errors.components[-1, 2]) > 100.0
    assert np.abs(errors.components[:, 2] / errors.sigmas[:, 2]).max() < 3.0


def test_innovations_are_white(log):
    """The noises told are about those that there are: innovations below one, without memory."""
    found = residuals(log.problem, gg.estimate(log.problem, "ekf"))
    white = found.whitened[:, :2]
    assert 0.5 < np.sqrt(np.mean(white**2)) < 1.1
    for axis in white.T:
        assert abs(np.corrcoef(axis[1:], axis[:-1])[0, 1]) < 0.15
