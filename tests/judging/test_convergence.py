"""Convergence: when a run has it, what is a false fix, and the statistics of many runs."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.stats import binom

from ggbench.judging.convergence import claimed_radius, judge, median_interval

TIMES = np.array([1.0, 2.0, 3.0, 4.0, 5.0])
SURE, UNSURE = np.full((5, 3), 1.0), np.full((5, 3), 100.0)


@pytest.mark.parametrize(
    ("errors", "sigmas", "time", "false"),
    [
        ([50, 9, 9, 9, 9], SURE, 2.0, False),
        ([9, 9, 9, 9, 9], SURE, 1.0, False),
        ([9, 9, 11, 9, 9], SURE, 4.0, False),  # outside in between: only the last time counts
        ([9, 9, 9, 9, 10], SURE, 1.0, False),  # the limit itself is within it
        ([9, 9, 9, 9, 11], UNSURE, None, False),
        ([50, 50, 50, 50, 9], UNSURE, 5.0, False),  # converged without claiming so
        ([50, 50, 50, 50, math.inf], SURE, None, True),
        ([50, 50, 50, 50, 50], np.full((5, 3), math.nan), None, False),  # no covariance, no claim
    ],
)
def test_convergence_lasts_to_the_end(errors, sigmas, time, false):
    """Converged runs stay within the limit to the end; a false fix claims it, and is not."""
    found = judge(np.array([errors], dtype=float), sigmas[-1:], TIMES, 10.0)
    assert found[0].tolist() == pytest.approx([math.nan if time is None else time], nan_ok=True)
    assert found[1].tolist() == [false]


@pytest.mark.parametrize("shape", [(1.0, 0.0, 0.0), (1.0, 1.0, 1.0), (5.0, 2.0, 0.1), (1, 1, 0)])
def test_the_claimed_radius_holds_95_percent_whatever_the_shape(shape):
    """At least 95 % of a Gaussian lie within its claimed radius; of one on a line, just 95 %.

    200 000 draws: five standard deviations are 0.25 %, a false alarm in 3e6 per shape.
    """
    sigmas = np.array([shape], dtype=float)
    draws = np.random.default_rng(4).standard_normal((200_000, 3)) * sigmas
    inside = np.mean(np.linalg.norm(draws, axis=1) <= claimed_radius(sigmas)[0])
    assert inside > 0.9475
    if shape == (1.0, 0.0, 0.0):
        assert inside < 0.9525


@pytest.mark.parametrize("count", [6, 9, 25, 100])
def test_the_median_is_covered_whatever_the_law(count):
    """Between the order statistics the median lies with 95 % or more, and not much more.

    The interval of 1..n names the ranks; a median lies between them unless too few or too many of
    the values are below it, which a fair coin decides.
    """
    value, low, high = median_interval(np.random.default_rng(1).permutation(count) + 1)
    assert value == (count + 1) / 2
    outside = binom.cdf(low - 1, count, 0.5) + binom.sf(high - 1, count, 0.5)
    assert outside <= 0.05
    narrower = binom.cdf(low, count, 0.5) + binom.sf(high - 2, count, 0.5)
    assert narrower > 0.05


def test_few_times_have_no_interval():
    """Five values cannot bound a median with 95 %; none have no median."""
    value, low, high = median_interval([3.0, 1.0, 2.0, 5.0, 4.0])
    assert value == 3.0
    assert math.isnan(low) and math.isnan(high)
    assert all(math.isnan(v) for v in median_interval([]))
