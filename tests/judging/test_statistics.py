"""Statistics over runs: what they promise about false alarms, measured on laws that are known.

Squared errors are drawn from χ² and heavier laws, skewed as real ones are.
"""

from __future__ import annotations

import math
import tracemalloc

import numpy as np
import pytest
from scipy.stats import binom, chi2, ttest_ind, ttest_rel

from ggbench.judging import statistics

LAWS = {
    "chi-square": lambda generator, shape: generator.chisquare(3, shape),
    "log-normal": lambda generator, shape: generator.lognormal(0.0, 1.0, shape),
    "diverging": lambda generator, shape: (
        generator.chisquare(3, shape) * np.where(generator.random(shape) < 0.02, 100.0, 1.0)
    ),
}
each_law = pytest.mark.parametrize("law", LAWS.values(), ids=LAWS)


def test_mrse_and_its_interval():
    """MRSE is the root of the mean square; its interval contains it, and one run has none."""
    value, low, high = statistics.root_mean_interval(np.array([9.0, 16.0, 25.0]))
    assert value == pytest.approx(math.sqrt(50.0 / 3.0))
    assert 3.0 <= low < value < high <= 5.0
    value, low, high = statistics.root_mean_interval(np.array([9.0]))
    assert value == 3.0
    assert math.isnan(low) and math.isnan(high)
    again = statistics.root_mean_interval(np.array([9.0, 16.0, 25.0]))
    assert again == statistics.root_mean_interval(np.array([9.0, 16.0, 25.0]))


def test_interval_covers_the_truth():
    """The 95 % interval holds the true MRSE in about 95 of 100 campaigns of 100 runs.

    300 campaigns with mean squares of three degrees of freedom, skewed as real ones are. The
    bootstrap is known to be a little short (94 %); between 91 and 98 % the false-alarm rate is
    below 2 %.
    """
    generator = np.random.default_rng(11)
    hits = 0
    for _ in range(300):
        _, low, high = statistics.root_mean_interval(generator.chisquare(3, 100))
        hits += low < math.sqrt(3.0) < high
    assert 0.91 <= hits / 300 <= 0.98


@pytest.mark.parametrize("runs", [2, 20, 100, 300, 1000, 2500])
def test_interval_is_the_plain_bootstrap(runs):
    """Draws in blocks are the draws at once: published intervals stay what they are."""
    squares = np.random.default_rng(runs).chisquare(3, runs)
    draws = np.random.default_rng(20130).integers(0, runs, (2000, runs))
    plain = np.percentile(np.sqrt(squares[draws].mean(axis=1)), [2.5, 97.5])
    assert statistics.root_mean_interval(squares)[1:] == pytest.approx(plain, rel=1e-12)


def test_memory_does_not_grow_with_the_runs():
    """All draws of 10,000 runs would be 160 MB; blocks of them are less than 80."""
    squares = np.random.default_rng(1).chisquare(3, 10_000)
    tracemalloc.start()
    statistics.root_mean_interval(squares)
    statistics.paired(squares, squares[::-1])
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 80e6


def test_a_pair_on_hand_numbers():
    """Differences are first − second, of squares; the relative one is of roots; a tie is half."""
    result = statistics.paired(np.array([1.0, 4.0, 9.0, 2.0]), np.array([4.0, 4.0, 49.0, 7.0]))
    assert (result.runs, result.difference) == (4, pytest.approx(-12.0))
    assert result.relative == pytest.approx(math.sqrt(16.0 / 64.0) - 1.0)
    assert result.win_rate == 3.5 / 4
    with pytest.raises(ValueError, match="one shape"):
        statistics.paired(np.ones(3), np.ones(1))


def test_a_pair_reads_the_same_from_both_sides():
    """Exchanging the two turns the difference, its interval, the win rate and the verdict round."""
    generator = np.random.default_rng(4)
    common = generator.chisquare(3, 60)
    first, second = common, 1.3 * common * generator.lognormal(0.0, 0.1, 60)
    one, two = statistics.paired(first, second), statistics.paired(second, first)
    assert (one.verdict, two.verdict) == ("better", "worse")
    assert one.lo < one.difference < one.hi < 0.0
    assert (one.lo, one.hi, one.difference) == pytest.approx((-two.hi, -two.lo, -two.difference))
    assert one.win_rate == pytest.approx(1.0 - two.win_rate)
    assert (1.0 + one.relative) * (1.0 + two.relative) == pytest.approx(1.0)


@pytest.mark.parametrize("runs", [0, 1, 2, 3])
def test_few_runs_decide_nothing(runs):
    """Two or three runs bound no difference, however large, and one or none has no interval."""
    squares = np.array([1.0, 2.0, 4.0])[:runs]
    result = statistics.paired(squares, 100.0 * squares)
    assert (result.runs, result.verdict) == (runs, "not distinguishable")
    assert math.isnan(result.lo) and math.isnan(result.hi)


def test_what_is_the_same_is_not_distinguishable():
    """Equal errors are ties, and so are errors that only rounding tells apart."""
    generator = np.random.default_rng(9)
    squares = generator.lognormal(0.0, 5.0, 50)
    for other in (squares.copy(), squares * (1.0 + 1e-12), np.nextafter(squares, np.inf)):
        result = statistics.paired(other, squares)
        assert (result.difference, result.lo, result.hi, result.win_rate) == (0.0, 0.0, 0.0, 0.5)
        assert result.verdict == "not distinguishable"
        assert statistics.excess_p_value(squares, other, 0.0, paired=True) == 1.0
    # One run of fifty is no evidence, however large its difference.
    other = squares.copy()
    other[7] *= 1e6
    assert statistics.paired(other, squares).verdict == "not distinguishable"
    zeros = np.zeros(5)
    assert statistics.paired(zeros, zeros).verdict == "not distinguishable"
    assert math.isnan(statistics.paired(squares[:5], zeros).relative)


def test_a_constant_difference_is_certain():
    """Without spread the interval is the difference itself."""
    result = statistics.paired(np.full(9, 2.0), np.full(9, 3.0))
    assert (result.lo, result.hi, result.verdict) == (-1.0, -1.0, "better")


@each_law
@pytest.mark.parametrize("runs", [5, 30, 300])
def test_false_alarms_of_a_pair(law, runs):
    """Two estimators of the same law are called different in 5 % of pairs at most.

    2000 pairs that share half of their errors' variation, as on the same flights; a rate of 5 %
    has a standard error of 0.5 %: three of them.
    """
    generator = np.random.default_rng(runs)
    common, first, second = (law(generator, (2000, runs)) for _ in range(3))
    results = statistics.paired_all(list(zip(common + first, common + second, strict=True)))
    assert np.mean([r.verdict != "not distinguishable" for r in results]) < 0.065


def test_power_of_a_pair():
    """One percent in MRSE is found in 100 runs if the two err alike, as filters of one kind do."""
    generator = np.random.default_rng(6)
    found = 0
    for _ in range(50):
        common = generator.chisquare(3, 100)
        other = 1.01**2 * common * generator.lognormal(0.0, 0.03, 100)
        found += statistics.paired(common, other).verdict == "better"
    assert found >= 45


def test_nees_band_is_that_of_chi_square():
    """The band of a mean of χ² variables: around the dimension, 95 % wide, shrinking as 1/√runs."""
    low, high = statistics.nees_band(1, 6)
    assert (low, high) == pytest.approx(tuple(chi2.ppf([0.025, 0.975], 6)))
    low, high = statistics.nees_band(400, 6)
    assert low < 6.0 < high
    assert high - low == pytest.approx(2 * 1.96 * math.sqrt(12 / 400), rel=0.01)
    assert all(math.isnan(end) for end in statistics.nees_band(0, 6))
    generator = np.random.default_rng(5)
    means = generator.chisquare(6, (2000, 50)).mean(axis=1)
    low, high = statistics.nees_band(50, 6)
    # 2000 draws: a standard error of 0.5 %, four of them.
    assert np.mean((means < low) | (means > high)) == pytest.approx(0.05, abs=0.02)


def test_nis_band_holds_white_innovations():
    """The window mean of white innovations leaves its band in 5 % of campaigns.

    2000 campaigns of 20 runs, 15 epochs, 5 components: a standard error of 0.5 %, four of them.
    """
    means = np.random.default_rng(8).chisquare(5, (2000, 300)).mean(axis=1)
    low, high = statistics.nis_band(20, 15, 5)
    assert np.mean((means < low) | (means > high)) == pytest.approx(0.05, abs=0.02)
    assert all(
        math.isnan(end) for end in (*statistics.nis_band(0, 9, 5), *statistics.nis_band(9, 0, 5))
    )


@pytest.mark.parametrize("correlated", [True, False])
def test_coverage_band_is_safe_for_correlated_epochs(correlated):
    """A consistent estimator leaves the band in at most 5 % of campaigns; 0.80 is outside it.

    2000 campaigns of 100 runs, of one epoch's worth of information or of 20: a standard error of
    0.5 %, three of them.
    """
    inside = np.random.default_rng(3).random((2000, 100, 1 if correlated else 20)) < 0.95
    coverage = inside.mean(axis=(1, 2))
    low, high = statistics.coverage_band(100)
    assert np.mean((coverage < low) | (coverage > high)) < 0.065
    assert 0.80 < low < 0.95 < high <= 1.0
    assert statistics.coverage_band(1) == (0.0, 1.0)
    assert all(math.isnan(end) for end in statistics.coverage_band(0))


@pytest.mark.parametrize("runs", [1, 20, 100, 1000])
def test_coverage_band_leaves_as_much_out_below_as_above(runs):
    """Its ends are quantiles of the binomial law: at most 2.5 % lie below, and 2.5 % above."""
    found = tuple(round(end * runs) for end in statistics.coverage_band(runs))
    assert found == tuple(binom.ppf([0.025, 0.975], runs, 0.95).astype(int))
    low, high = found
    assert binom.cdf(low - 1, runs, 0.95) <= 0.025 >= binom.sf(high, runs, 0.95)


def test_ratio_on_hand_numbers():
    """A ratio of roots; in pairs what is common cancels, in independent samples it does not."""
    before = np.random.default_rng(7).chisquare(3, 50)
    value, low, high = statistics.ratio_interval(before, 4.0 * before, paired=True)
    assert (value, low, high) == pytest.approx((2.0, 2.0, 2.0))
    value, low, high = statistics.ratio_interval(before, 4.0 * before, paired=False)
    assert low < 1.9 < value < 2.1 < high
    assert all(math.isnan(x) for x in statistics.ratio_interval(before[:0], before[:0], True))
    assert all(math.isnan(x) for x in statistics.ratio_interval(np.zeros(3), before[:3], True))
    value, low, high = statistics.ratio_interval(before[:1], 4.0 * before[:1], paired=True)
    assert value == pytest.approx(2.0)
    assert math.isnan(low) and math.isnan(high)


@pytest.mark.parametrize("paired", [True, False])
def test_ratio_interval_covers_the_truth(paired):
    """The interval holds the true ratio in about 95 of 100 campaigns of 100 runs.

    300 campaigns: between 91 and 98 % the false-alarm rate is below 2 %.
    """
    generator = np.random.default_rng(12)
    hits = 0
    for _ in range(300):
        common = 2.0 * generator.chisquare(3, 100) if paired else 6.0
        before, after = (common + generator.chisquare(3, 100) for _ in range(2))
        _, low, high = statistics.ratio_interval(before, 1.44 * after, paired)
        hits += low < 1.2 < high
    assert 0.91 <= hits / 300 <= 0.98


def test_excess_without_spread_or_runs():
    """A certain excess has p = 0, none at all p = 1; a single run is no evidence."""
    for paired in (True, False):
        ones, more = np.ones(5), np.full(5, 1.21)
        assert statistics.excess_p_value(ones, ones, 0.0, paired) == 1.0
        assert statistics.excess_p_value(ones, more, 0.05, paired) == 0.0
        assert statistics.excess_p_value(ones, more, 0.1, paired) == 1.0
        assert statistics.excess_p_value(ones[:1], more[:1], 0.0, paired) == 1.0


@pytest.mark.parametrize("runs", [2, 3, 10, 100])
def test_an_excess_is_students_and_welchs(runs):
    """p-values are those of textbook t-tests of the mean squares, the threshold in the roots."""
    generator = np.random.default_rng(runs)
    before, after = generator.chisquare(3, runs), 1.5 * generator.chisquare(5, runs)
    for threshold in (0.0, 0.1):
        allowed = (1.0 + threshold) ** 2 * before
        for paired, test in (
            (True, ttest_rel(after, allowed, alternative="greater")),
            (False, ttest_ind(after, allowed, equal_var=False, alternative="greater")),
        ):
            found = statistics.excess_p_value(before, after, threshold, paired)
            assert found == pytest.approx(test.pvalue, rel=1e-9)


@each_law
@pytest.mark.parametrize("paired", [True, False])
def test_false_alarms_of_an_excess(law, paired):
    """An MRSE that grew by the threshold is called worse in 5 % of campaigns of 30 at most.

    2000 campaigns: a standard error of 0.5 %, three of them; half of the error in common if paired.
    """
    generator = np.random.default_rng(21)
    alarms = 0
    for _ in range(2000):
        common = law(generator, 30) if paired else 0.0
        before, after = common + law(generator, 30), common + law(generator, 30)
        alarms += statistics.excess_p_value(before, 1.21 * after, 0.1, paired) < 0.05
    assert alarms / 2000 < 0.065


def test_holm_on_hand_numbers():
    """Holm (1979): the smallest times m, the next times m − 1, never decreasing, never above 1."""
    assert statistics.holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert statistics.holm([0.9, 0.8]).tolist() == [1.0, 1.0]
    assert len(statistics.holm([])) == 0
