"""Random processes at the times of readings are those that are named.

Of each statement the probability of a false alarm is 1e-4.
"""

from __future__ import annotations

import numpy as np
import pytest
from laws import ALARM, likely
from scipy.stats import binom, chi2, expon, kstest, poisson

from ggbench.sensors.processes import bursts, gauss_markov, random_walk


def test_bursts_last_as_long_as_stated_and_fill_their_share():
    """Seen two hundred times in a mean duration: exponential, with a mean of 10 s.

    Of the durations: their number in the time that is struck is Poisson's, Kolmogorov-Smirnov for
    their law.
    """
    times = 0.05 * np.arange(1, 1_000_001)
    struck = bursts(times, 0.2, 10.0, 1, np.random.default_rng(1))[:, 0]
    change = np.diff(struck.astype(int), prepend=0, append=0)
    starts, ends = np.flatnonzero(change == 1), np.flatnonzero(change == -1)
    assert likely(len(ends), poisson(0.05 * struck.sum() / 10.0))
    assert kstest(0.05 * (ends - starts), expon(scale=10.0).cdf).pvalue > ALARM
    # The share's own correlation time is (1 - share) times the duration, 8 s: of 50000 s.
    deviation = np.sqrt(0.2 * 0.8 * 2.0 * 8.0 / 50e3)
    assert abs(struck.mean() - 0.2) < 3.9 * deviation


@pytest.mark.parametrize(
    ("duration", "spacing"), [(0.0, 5.0), (0.5, 0.25), (10.0, 5.0), (1000.0, 5.0)]
)
def test_the_share_is_that_of_every_time(duration, spacing):
    """Of 20000 chains at the first reading, at a later one and after a gap, whatever the duration.

    And two successive readings are both struck as the process in continuous time says.
    """
    times = np.array([3.0, 3.0 + spacing, 3.0 + 2.0 * spacing, 100.0])
    struck = bursts(times, 0.05, duration, 20_000, np.random.default_rng(2))
    for row in struck:
        assert likely(row.sum(), binom(20_000, 0.05))
    kept = np.exp(-spacing / (0.95 * duration)) if duration else 0.0
    for one, other in ((0, 1), (1, 2)):
        both = (struck[one] & struck[other]).sum()
        assert likely(both, binom(20_000, 0.05 * (0.05 + 0.95 * kept)))


def test_without_a_duration_a_number_is_drawn_for_each_reading():
    """The numbers of results that are stored: below the share a reading is struck."""
    times = np.arange(1.0, 101.0)
    found = bursts(times, 0.3, 0.0, 6, np.random.default_rng(3))
    np.testing.assert_array_equal(found, np.random.default_rng(3).random((100, 6)) < 0.3)


def test_a_gauss_markov_process_is_stationary_and_forgets():
    """Of 4000 at three times, unequally far apart: variance 1, and independent innovations."""
    times = np.array([2.0, 12.0, 17.0])
    x = gauss_markov(times, 10.0, 4000, np.random.default_rng(4))
    for row in x:
        assert likely((row**2).sum(), chi2(4000))
    for k in (1, 2):
        kept = np.exp(-(times[k] - times[k - 1]) / 10.0)
        new = (x[k] - kept * x[k - 1]) / np.sqrt(1.0 - kept**2)
        assert likely((new**2).sum(), chi2(4000))
        assert abs((new * x[k - 1]).sum()) < 3.9 * np.sqrt(4000)


def test_a_random_walk_begins_with_the_flight():
    """Of 4000 at two times: variance of the root PSD squared times the time, of a step likewise."""
    times = np.array([7.0, 20.0])
    x = random_walk(times, 0.3, 4000, np.random.default_rng(5))
    assert likely((x[0] ** 2).sum() / (0.09 * 7.0), chi2(4000))
    assert likely(((x[1] - x[0]) ** 2).sum() / (0.09 * 13.0), chi2(4000))
    assert abs((x[0] * (x[1] - x[0])).sum()) < 3.9 * 0.09 * np.sqrt(7.0 * 13.0 * 4000)
