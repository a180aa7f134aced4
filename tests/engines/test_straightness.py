"""Where a cloud is a Gaussian, and a reading a straight line over it; and where they are not."""

from __future__ import annotations

import numpy as np
import pytest

from ggbench.engines.straightness import bending, is_gaussian

COUNT = 4000
EQUAL = np.full(COUNT, 1.0 / COUNT)


def normal(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal((COUNT, 3))


def test_draws_of_a_gaussian_are_one():
    """Of any covariance, weighted or not; a false alarm in fewer than one of a thousand seeds."""
    root = np.array([[3.0, 0.0, 0.0], [2.0, 1e-3, 0.0], [0.0, 1.0, 1e4]])
    weights = np.random.default_rng(1).random(COUNT)
    for seed in range(5):
        assert is_gaussian(EQUAL, normal(seed) @ root.T)
        assert is_gaussian(weights / weights.sum(), normal(seed))


THREE = np.sqrt(3.0) * np.resize([-1.0, 0.0, 1.0, 0.0, 0.0, 0.0], COUNT)
"""Three modes of a sixth, two thirds and a sixth, which have the kurtosis of a Gaussian."""


@pytest.mark.parametrize(
    "shape",
    [
        lambda x: x + 0.3 * x**2,
        lambda x: np.sign(x) * np.abs(x) ** 0.7,
        lambda x: x + 4.0 * np.sign(x),
        lambda x: 0.1 * x + THREE,
    ],
    ids=["skew", "flat", "two modes", "three modes"],
)
def test_other_shapes_are_none(shape):
    """Along one of three axes, with the standard deviation of a Gaussian or another."""
    cloud = normal(2)
    cloud[:, 1] = shape(cloud[:, 1])
    assert not is_gaussian(EQUAL, cloud)


def test_modes_apart_in_an_oblique_direction_are_seen():
    """No axis of the states shows them, a principal one does."""
    cloud = normal(4) + np.outer(THREE, [8.0, 8.0, 8.0])
    assert not is_gaussian(EQUAL, cloud)


def test_bending_is_what_no_line_explains():
    """Of a + b x + c (x² − 1), x standard normal, the variance 2 c², in the noisiest channel."""
    cloud = normal(3)
    x = cloud[:, :1]
    read = np.hstack([5.0 + 7.0 * x, 3.0 * x + 0.1 * (x**2 - 1.0)])
    assert bending(EQUAL, cloud, read) == pytest.approx(0.02, rel=0.15)
    assert bending(EQUAL, cloud, read[:, :1]) == pytest.approx(0.0, abs=1e-9)
