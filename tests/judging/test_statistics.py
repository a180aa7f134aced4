"""Statistics over runs: what they promise about false alarms, measured on laws that are known.

Squared errors are drawn from χ² and heavier laws, skewed as real ones are.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.stats import binom, chi2, ttest_1samp, ttest_ind, ttest_rel
from thinning import thinned

from ggbench.judging import statistics

LAWS = {
    "chi-square": lambda generator, shape: generator.chisquare(3, shape),
    "log-normal": lambda generator, shape: generator.lognormal(0.0, 1.0, shape),
    "diverging": lambda generator, shape: (
        generator.chisquare(3, shape) * np.where(generator.random(shape) < 0.02, 100.0, 1.0)
    ),
}
each_law = pytest.mark.parametrize("law", LAWS.values(), ids=LAWS)


def test_a_pair_on_hand_numbers():
    """The geometric mean of the ratio of root mean squares, and the textbook t-test of its log."""
    first, second = np.array([4.0, 9.0, 16.0, 2.0]), np.array([1.0, 9.0, 4.0, 1.0])
    found = statistics.log_ratio(first, second, np.arange(4))
    logs = 0.5 * np.log(first / second)
    test = ttest_1samp(logs, 0.0)
    assert found.ratio == pytest.approx(math.exp(logs.mean()))
    assert found.p == pytest.approx(test.pvalue)
    assert (found.lo, found.hi) == pytest.approx(tuple(np.exp(test.confidence_interval())))
    turned = statistics.log_ratio(second, first, np.arange(4))
    assert (turned.ratio, turned.lo) == pytest.approx((1.0 / found.ratio, 1.0 / found.hi))
    assert turned.p == pytest.approx(found.p)


def test_clusters_count_once():
    """Ten copies of a run are no evidence: the test is that of the clusters' means."""
    generator = np.random.default_rng(2)
    first, second = generator.chisquare(3, (2, 20))
    once = statistics.log_ratio(first, second, np.arange(20))
    copies = [np.repeat(values, 10) for values in (first, second, np.arange(20))]
    assert statistics.log_ratio(*copies).p == pytest.approx(once.p)


def test_the_runs_that_decide_a_pair():
    """As many as the normal approximation says, of which four in five campaigns decide."""
    generator = np.random.default_rng(3)
    pilot = generator.lognormal(0.0, 1.0, 2000) * 1.2**2
    needed = statistics.runs_to_decide(pilot, np.ones(2000), np.arange(2000), 1)
    spread, mean = 0.5, math.log(1.2)
    assert needed == pytest.approx((2.80 * spread / mean) ** 2, rel=0.2)
    count, found = round(needed), 0
    for _ in range(300):
        first = generator.lognormal(0.0, 1.0, count) * 1.2**2
        found += statistics.log_ratio(first, np.ones(count), np.arange(count)).p < 0.05
    assert 0.7 < found / 300 < 0.9
    more = statistics.runs_to_decide(pilot, np.ones(2000), np.arange(2000), 500)
    assert more > 2.0 * needed
    shared = statistics.runs_to_decide(
        np.repeat(pilot, 5), np.ones(10_000), np.repeat(np.arange(2000), 5), 1
    )
    assert shared == pytest.approx(5.0 * needed)
    same = statistics.runs_to_decide(
        generator.lognormal(0.0, 0.1, 50), np.ones(50), np.arange(50), 1
    )
    assert 5 < same < 100  # equivalent
    assert math.isnan(statistics.runs_to_decide(pilot[:1], pilot[:1], np.arange(1), 1))


@pytest.mark.parametrize("runs", [0, 1])
def test_few_runs_decide_nothing(runs):
    squares = np.array([1.0])[:runs]
    found = statistics.log_ratio(squares, 100.0 * squares, np.arange(runs))
    assert (found.p, found.p_equivalent) == (1.0, 1.0)
    assert math.isnan(found.lo) and math.isnan(found.hi)


def test_what_is_the_same_is_equivalent():
    """Equal errors, and errors that differ by rounding; a constant difference is certain."""
    squares = np.random.default_rng(9).lognormal(0.0, 5.0, 50)
    for other in (squares.copy(), squares * (1.0 + 1e-12), np.nextafter(squares, np.inf)):
        found = statistics.log_ratio(other, squares, np.arange(50))
        assert (found.ratio, found.p, found.p_equivalent) == (1.0, 1.0, 0.0)
        assert statistics.excess_p_value(squares, other, 0.0, paired=True) == 1.0
    found = statistics.log_ratio(1.21 * squares[:9], squares[:9], np.arange(9))
    assert found.p < 1e-9 and found.p_equivalent > 0.99


@each_law
@thinned("runs", [5, 30, 300])
def test_false_alarms_of_a_pair(law, runs):
    """Two estimators of the same law are called different in 5 % of pairs at most.

    2000 pairs that share half of their errors' variation, as on the same flights; a rate of 5 %
    has a standard error of 0.5 %: three of them.
    """
    generator = np.random.default_rng(runs)
    common, first, second = (law(generator, (2000, runs)) for _ in range(3))
    alarms = [
        statistics.log_ratio(a, b, np.arange(runs)).p < 0.05
        for a, b in zip(common + first, common + second, strict=True)
    ]
    assert np.mean(alarms) < 0.065


def test_false_alarms_of_equivalence():
    """Estimators whose errors differ by just 5 % are called equivalent in 5 % of pairs at most.

    2000 pairs of 30 runs: a standard error of 0.5 %, three of them.
    """
    generator, limit = np.random.default_rng(31), statistics.EQUIVALENCE_RATIO**2
    alarms = 0
    for _ in range(2000):
        common = generator.chisquare(3, 30)
        first, second = common * generator.lognormal(0.0, 0.05, (2, 30))
        alarms += statistics.log_ratio(limit * first, second, np.arange(30)).p_equivalent < 0.05
    assert alarms / 2000 < 0.065


def test_power_of_a_pair():
    """One percent is found in 100 runs if the two err alike, as filters of one kind do."""
    generator = np.random.default_rng(6)
    found = 0
    for _ in range(50):
        common = generator.chisquare(3, 100)
        other = 1.01**2 * common * generator.lognormal(0.0, 0.03, 100)
        found += statistics.log_ratio(common, other, np.arange(100)).p < 0.05
    assert found >= 45


@pytest.mark.parametrize("hits", [0, 1, 7, 20])
def test_the_share_of_runs_has_wilsons_interval(hits):
    """Its ends are the shares of which the one found is 1.96 of *their* deviations away."""
    runs = 20
    share, low, high = statistics.wilson(hits, runs)
    assert share == hits / runs
    assert 0.0 <= low <= share <= high <= 1.0
    for end, outermost in ((low, 0.0), (high, 1.0)):
        if share != outermost:
            distance = (share - end) ** 2
            assert distance == pytest.approx(chi2.ppf(0.95, 1) * end * (1.0 - end) / runs)
        else:
            assert end == outermost
    assert all(math.isnan(value) for value in statistics.wilson(0, 0))


def test_the_share_is_covered_as_promised():
    """Wilson's intervals hold the true share in 95 % of campaigns, on average over the shares."""
    runs = 50
    intervals = [statistics.wilson(k, runs) for k in range(runs + 1)]
    covered = [
        sum(binom.pmf(k, runs, p) for k, (_, lo, hi) in enumerate(intervals) if lo <= p <= hi)
        for p in np.linspace(0.02, 0.98, 97)
    ]
    assert 0.945 < np.mean(covered) < 0.965
    assert min(covered) > 0.88


def test_the_share_of_clusters_is_wider():
    """Runs that succeed or fail with their cluster are worth as many runs as there are clusters."""
    cluster = np.repeat(np.arange(20), 10)
    whole = np.arange(20)[cluster] < 14
    found = statistics.share_interval(whole, cluster)
    assert found == pytest.approx(statistics.wilson(0.7 * 19, 19), rel=0.01)
    alone = statistics.share_interval(whole, np.arange(200))
    assert alone == statistics.wilson(140, 200)
    assert statistics.share_interval(np.ones(200, bool), cluster)[1] < 0.85


def test_a_share_of_no_runs_is_undefined_and_of_one_run_is_not():
    nobody = np.zeros(0, dtype=bool)
    assert all(math.isnan(value) for value in statistics.share_interval(nobody, nobody))
    assert statistics.share_interval(~np.zeros(1, bool), np.zeros(1)) == statistics.wilson(1, 1)


def test_equal_counts_have_a_p_value_of_one():
    assert statistics.exact_p(5, 5) == 1.0
    assert statistics.exact_p(0, 0) == 1.0
    assert statistics.exact_p(0, 5) == statistics.exact_p(5, 0) == pytest.approx(2.0 / 2.0**5)


def test_the_band_of_the_nees_is_that_of_chi_square():
    """The band of a mean of χ² variables: around the dimension, 95 % wide, shrinking as 1/√runs."""
    low, high = statistics.mean_band(1, 6)
    assert (low, high) == pytest.approx(tuple(chi2.ppf([0.025, 0.975], 6)))
    low, high = statistics.mean_band(400, 6)
    assert low < 6.0 < high
    assert high - low == pytest.approx(2 * 1.96 * math.sqrt(12 / 400), rel=0.01)
    assert all(math.isnan(end) for end in statistics.mean_band(0, 6))
    generator = np.random.default_rng(5)
    means = generator.chisquare(6, (2000, 50)).mean(axis=1)
    low, high = statistics.mean_band(50, 6)
    # 2000 draws: a standard error of 0.5 %, four of them.
    assert np.mean((means < low) | (means > high)) == pytest.approx(0.05, abs=0.02)


def test_the_band_of_the_nis_holds_white_innovations():
    """The window mean of white innovations leaves its band in 5 % of campaigns.

    2000 campaigns of 20 runs, 15 epochs, 5 components: a standard error of 0.5 %, four of them.
    """
    means = np.random.default_rng(8).chisquare(5, (2000, 300)).mean(axis=1)
    low, high = statistics.mean_band(20 * 15, 5)
    assert np.mean((means < low) | (means > high)) == pytest.approx(0.05, abs=0.02)


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
@pytest.mark.parametrize("campaigns", [250, pytest.param(2000, marks=pytest.mark.long)])
@thinned("paired", [True, False])
def test_false_alarms_of_an_excess(law, paired, campaigns):
    """An MRSE that grew by the threshold is called worse in 5 % of campaigns of 30 at most.

    Of 250 campaigns the rate has a standard error of 1.4 %, of 2000 one of 0.5 %; three of them.
    Half of the error is in common if paired.
    """
    generator = np.random.default_rng(21)
    alarms = 0
    for _ in range(campaigns):
        common = law(generator, 30) if paired else 0.0
        before, after = common + law(generator, 30), common + law(generator, 30)
        alarms += statistics.excess_p_value(before, 1.21 * after, 0.1, paired) < 0.05
    assert alarms / campaigns < 0.05 + 3.0 * math.sqrt(0.05 * 0.95 / campaigns)


def test_holm_on_hand_numbers():
    """Holm (1979): the smallest times m, the next times m − 1, never decreasing, never above 1."""
    assert statistics.holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert statistics.holm([0.9, 0.8]).tolist() == [1.0, 1.0]
    assert len(statistics.holm([])) == 0
