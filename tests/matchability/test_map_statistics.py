"""Statistics of cells on fields whose answers are known."""

from __future__ import annotations

import math

import numpy as np
import pytest

from ggbench.matchability import statistics as stats

EAST, NORTH = 900.0, 1100.0


def plane(a=3e-4, b=-2e-4, shape=(70, 80)):
    y, x = np.mgrid[: shape[0], : shape[1]]
    return 5.0 + a * EAST * x + b * NORTH * y


def smooth(seed=3, shape=(66, 71)):
    """A few waves: a field with slopes everywhere."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[: shape[0], : shape[1]] / 66.0
    waves = [
        np.sin(2 * np.pi * (u * x + v * y) + phase)
        for u, v, phase in rng.uniform(-3.0, 3.0, (6, 3))
    ]
    return np.sum(waves, axis=0)


def test_a_plane_has_its_slope_and_nothing_else():
    g = plane()
    assert stats.roughness(g, EAST, NORTH) == pytest.approx(0.5 * (3e-4 + 2e-4), rel=1e-12)
    np.testing.assert_allclose(stats.slope(g, EAST, NORTH), math.hypot(3e-4, 2e-4), rtol=1e-12)
    # Of a ramp of n steps s: s √(n (n + 1) / 12).
    ramp = np.tile(np.arange(80.0) * 2.0, (70, 1))
    count = ramp.size
    variance = 4.0 * (80.0**2 - 1.0) / 12.0 * count / (count - 1.0)
    assert stats.deviation(ramp) == pytest.approx(math.sqrt(variance), rel=1e-12)
    np.testing.assert_allclose(stats.without_plane(g), 0.0, atol=1e-12)
    assert stats.fractal_dimension(g) == pytest.approx(2.0, abs=1e-9)


def test_a_regional_slope_is_kept_in_slopes_and_taken_from_the_rest():
    fields = smooth(), smooth() + plane(shape=(66, 71))
    flat, tilted = (stats.statistics(g, EAST, NORTH)._asdict() for g in fields)
    for name in ("deviation", "span", "entropy", "correlation_m"):
        assert tilted[name] == pytest.approx(flat[name], rel=1e-9)
    for name in ("slope_deviation", "roughness"):
        assert abs(tilted[name] / flat[name] - 1.0) > 1e-2


def test_the_correlation_of_a_sine():
    """cos(2πd/λ) = 1/e at acos(1/e) λ/2π; over whole periods, and across it never."""
    wavelength, step = 40.0, 250.0
    x = np.arange(20 * int(wavelength))
    sine = np.tile(np.sin(2.0 * np.pi * x / wavelength), (12, 1))
    expected = math.acos(math.exp(-1.0)) * wavelength * step / (2.0 * np.pi)
    # The lags are not whole periods, and no node lies there: half a percent.
    assert stats.correlation_length(sine, step) == pytest.approx(expected, rel=0.01)
    assert stats.correlation_length(sine.T, step) == pytest.approx(11 * step)


def test_white_noise_is_correlated_over_less_than_a_step_and_fills_space():
    """Box counting finds 2.9 of 3: boxes of few nodes do not see the whole range."""
    g = np.random.default_rng(7).random((129, 129))
    assert stats.correlation_length(g - 0.5, 100.0) < 100.0
    assert 2.8 < stats.fractal_dimension(g) < 3.0


def test_the_entropy_of_two_values_and_of_one_that_stands_out():
    halves = np.tile([1.0, -1.0], (10, 10))
    assert stats.difference_entropy(halves) == pytest.approx(1.0, abs=1e-12)
    spike = np.zeros((10, 20))
    spike[4, 5] = 3.0
    # Half of all deviations is the spike's, the other half is shared by the others.
    expected = 0.5 * math.log(2.0) + 0.5 * math.log(2.0 * (spike.size - 1))
    assert stats.difference_entropy(spike) == pytest.approx(expected / math.log(spike.size))


@pytest.mark.parametrize(("a", "b"), [(2.5, 0.0), (-3.0, 0.0), (1.0, 1e3), (0.4, -17.0)])
def test_how_statistics_scale(a, b):
    """Under a g + b lengths and shapes stay, what has the unit of g goes with |a|.

    The mean has no part in any: the literature's entropy, over |mean|, would have.
    """
    g = smooth()
    one, other = (stats.statistics(x, EAST, NORTH)._asdict() for x in (g, a * g + b))
    for name in ("deviation", "span", "slope_deviation", "roughness"):
        assert other[name] == pytest.approx(abs(a) * one[name], rel=1e-9)
    for name in ("entropy", "correlation_m"):
        assert other[name] == pytest.approx(one[name], rel=1e-9)
    assert stats.fractal_dimension(a * g + b) == pytest.approx(stats.fractal_dimension(g), rel=1e-9)


def test_roughness_is_per_metre():
    """A smooth field sampled twice as densely is as rough: the literature's halves."""
    fine = smooth(shape=(131, 141))
    coarse = fine[::2, ::2]
    ratio = stats.roughness(fine, 0.5 * EAST, 0.5 * NORTH) / stats.roughness(coarse, EAST, NORTH)
    assert ratio == pytest.approx(1.0, abs=0.02)


def test_a_flat_cell_has_no_structure():
    found = stats.statistics(np.full((20, 20), 4.0), EAST, NORTH)
    assert found.deviation == found.span == found.roughness == 0.0
    assert found.entropy == 1.0
    assert math.isnan(found.correlation_m)
    assert math.isnan(stats.fractal_dimension(np.full((64, 64), 4.0)))
    with pytest.raises(ValueError, match="64 × 64"):
        stats.fractal_dimension(np.zeros((64, 63)))
