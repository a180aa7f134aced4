"""Grid of Gaussians: the share of priors that it leaves out."""

from __future__ import annotations

import math

import numpy as np
import pytest

from ggbench.engines import position_grid


def test_few_priors_lie_beyond_the_grid():
    """Less than 1e-4 of plane ones; up to there a point is near. 3.5 deviations omit 0.22 %."""
    sigma = np.array([900.0, 400.0])
    beyond = math.exp(-0.5 * position_grid.REACH**2)
    draws = np.random.default_rng(1).standard_normal((2, 400_000))
    share = np.mean(np.sum(draws**2, axis=0) > position_grid.REACH**2)
    assert beyond < 1e-4
    assert share == pytest.approx(beyond, abs=5.0 * math.sqrt(beyond / 400_000))
    assert np.mean(np.sum(draws**2, axis=0) > 3.5**2) > 2e-3
    points = position_grid.grid(sigma, 50.0) / sigma
    far = position_grid.REACH - 0.2
    for angle in np.linspace(0.0, 2.0 * np.pi, 40):
        off = (points - far * np.array([np.cos(angle), np.sin(angle)])) * sigma
        assert np.abs(off).max(axis=1).min() <= 25.0
