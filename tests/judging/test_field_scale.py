"""The distance in which a field along a track forgets itself."""

from __future__ import annotations

import math

import numpy as np
import pytest

from ggbench.gravity.ellipsoid import metres_along
from ggbench.judging.field_scale import correlation_m, on_the_prior

STEP_M = 250.0


def track(count: int, heading: float, step_m: float = STEP_M) -> np.ndarray:
    """Positions (count, 3) along a straight line, a step apart where it begins."""
    start = np.array([[0.3, 1.9, 4000.0]])
    longitude, latitude = metres_along(start)[0]
    along = step_m * np.arange(count)
    return start + np.column_stack(
        [along * math.cos(heading) / latitude, along * math.sin(heading) / longitude, 0.0 * along]
    )


@pytest.mark.parametrize("heading", [0.0, 0.5 * math.pi, 4.0])
def test_a_wave_forgets_itself_where_its_cosine_falls_to_1_over_e(heading):
    """Over whole periods of λ: cos(2πℓ/λ) = 1/e at ℓ = 0.190 λ, whatever mean and heading are."""
    length, count = 40 * STEP_M, 40 * 60
    wave = 30.0 + 7.0 * np.sin(2.0 * math.pi * STEP_M * np.arange(count) / length)
    wanted = length * math.acos(math.exp(-1.0)) / (2.0 * math.pi)
    assert correlation_m(track(count, heading), wave) == pytest.approx(wanted, rel=0.02)


def test_an_exponential_forgets_itself_in_its_own_length():
    """A Gauss–Markov process of 3 km over 10,000 of them: within 5 %, four deviations and more."""
    generator = np.random.default_rng(5)
    count = 120_000
    decay = math.exp(-STEP_M / 3000.0)
    noise = math.sqrt(1.0 - decay**2) * generator.normal(size=count)
    values = np.empty(count)
    values[0] = generator.normal()
    for k in range(1, count):
        values[k] = decay * values[k - 1] + noise[k]
    positions = np.tile(track(2, 0.5 * math.pi), (count // 2, 1))  # to and fro: each step as long
    assert correlation_m(positions, values) == pytest.approx(3000.0, rel=0.05)


@pytest.mark.parametrize("value", [0.0, 0.1, -3.3e4])
def test_what_does_not_change_has_no_length(value):
    """Less its mean it is nothing, or what rounding leaves of it."""
    assert math.isnan(correlation_m(track(50, 1.0), np.full(50, value)))


def test_too_few_readings_and_standing_still_have_no_length():
    """Two readings have no autocorrelation, a track without steps no metres."""
    values = np.random.default_rng(6).normal(size=50)
    assert math.isnan(correlation_m(track(2, 1.0), values[:2]))
    assert math.isnan(correlation_m(track(50, 1.0, step_m=0.0), values))
    assert correlation_m(track(50, 1.0), values) > 0.0


@pytest.mark.parametrize(
    ("position", "words"), [(100.0, "EKF"), (650.0, "wrong position"), (1500.0, "bank")]
)
def test_the_width_of_the_prior_has_a_consequence(position, words):
    said = on_the_prior(position, 1000.0)
    assert words in said and f"{position / 1000.0:.2g} correlation lengths" in said
    assert "(1 km)" in said
