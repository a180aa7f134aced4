"""Marks and the fit of noise: hand numbers, false-alarm rates, and planted runs."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import pytest
from problems import linear_problem
from scipy.linalg import block_diag
from scipy.stats import binom, chi2, t

import ggbench as gg
from ggbench.judging.consistency import (
    BEYOND,
    MARKS,
    UNFIT,
    consistency,
    false_share_p,
    noise_fit,
    trimmed,
)
from ggbench.judging.run_errors import evaluate_block, window_means
from ggbench.judging.statistics import mean_band, mean_interval, share_above, share_below
from ggbench.spec.case import WindowsSpec

INSIDE = chi2.ppf(0.95, 6)


def student(generator: np.random.Generator, shape: tuple[int, ...], freedom: float) -> np.ndarray:
    """NEES of Student's t errors with the right covariance: 6 on average."""
    return (
        generator.chisquare(6, shape)
        / (generator.chisquare(freedom, shape) / freedom)
        * ((freedom - 2.0) / freedom)
    )


LAWS = {
    "chi-square": lambda generator, shape: generator.chisquare(6, shape),
    "many epochs": lambda generator, shape: generator.chisquare(60, shape) / 10.0,
    "t of 10": lambda generator, shape: student(generator, shape, 10.0),
    "t of 5": lambda generator, shape: student(generator, shape, 5.0),
    "5 % of ten times": lambda generator, shape: (
        generator.chisquare(6, shape) * np.where(generator.random(shape) < 0.05, 10.0, 1.0) / 1.45
    ),
}
"""Laws of a run's NEES whose mean is 6."""
each_law = pytest.mark.parametrize("law", LAWS.values(), ids=LAWS)
each_number = pytest.mark.parametrize("runs", [5, 20, 60, 200])
campaigns = pytest.mark.parametrize("count", [200, pytest.param(2000, marks=pytest.mark.long)])


def verdict(nees, false_fix=None, cluster=None, coverage=None) -> str:
    """The verdict on runs worth one epoch each, whose coverage is that of their NEES."""
    nees = np.asarray(nees, dtype=float)
    cluster = np.arange(len(nees)) if cluster is None else cluster
    covered = (nees <= INSIDE).astype(float) if coverage is None else np.full(len(nees), coverage)
    fixes = np.zeros(len(nees), dtype=bool) if false_fix is None else false_fix
    return consistency(nees, covered, cluster, false_share_p(fixes, cluster))


def limit(rate: float, count: int) -> float:
    """The rate that is exceeded by chance with a probability below 0.2 % (three deviations)."""
    return rate + 3.0 * math.sqrt(rate * (1.0 - rate) / count)


@pytest.mark.parametrize(
    ("scale", "coverage", "false", "expected"),
    [
        (1.0, 0.95, 0, "consistent"),
        (0.5, 0.99, 0, "conservative"),
        (1.5, 0.95, 0, "overconfident"),
        (1.0, 0.80, 0, "overconfident"),
        (1.0, 0.89, 0, "consistent"),  # of 200 runs: not surely below 0.90
        (1.0, 0.40, 0, "overconfident"),  # no false fixes: not unsafe
        (1.0, 0.95, 16, "consistent"),  # 8 % of false fixes: p = 4 %
        (1.0, 0.95, 18, "unsafe"),
        (math.nan, math.nan, 0, ""),
    ],
)
def test_consistency_on_hand_numbers(scale, coverage, false, expected):
    """200 runs at the quantiles of χ²; unsafe is by false fixes alone."""
    nees = scale * chi2.ppf((np.arange(200) + 0.5) / 200, 6)
    assert verdict(nees, np.arange(200) < false, coverage=coverage) == expected


def test_a_nees_within_its_band_is_not_conservative():
    """200 runs of nearly equal NEES: significantly below 6, but within the band from 5.53 on."""
    nees = np.linspace(-0.01, 0.01, 200)
    assert verdict(5.6 + nees, coverage=0.95) == "consistent"
    assert verdict(5.4 + nees, coverage=0.95) == "conservative"


def test_shares_are_tested_exactly():
    """Binomial p-values; twenty runs over two maps count as two at most."""
    hits, alone = np.arange(40) < 6, np.arange(40)
    assert share_above(hits, alone, 0.05) == pytest.approx(binom.sf(5, 40, 0.05))
    assert share_below(hits, alone, 0.3) == pytest.approx(binom.cdf(6, 40, 0.3))
    assert share_above(~hits & hits, alone, 0.05) == 1.0
    assert share_above(np.arange(20) % 2 == 0, np.arange(20) % 2, 0.05) > 0.05
    mean, low, high = mean_interval(np.array([1.0, 2.0, 4.0]), np.arange(3))
    expected = t(2, 7.0 / 3.0, math.sqrt(7.0 / 9.0)).interval(0.95)
    assert (mean, low, high) == pytest.approx((7.0 / 3.0, *expected))


def test_one_run_of_two_hundred_decides_no_mark():
    """A run with a NEES of 1e4 leaves the verdict; ten such runs do not. The mean alone would."""
    nees = chi2.ppf((np.arange(200) + 0.5) / 200, 6)
    for count, expected in ((1, "consistent"), (20, "overconfident")):
        planted = nees.copy()
        planted[:: 200 // count][:] = 1e4
        assert planted.mean() > mean_band(200, 6)[1]
        assert verdict(planted) == expected
    assert trimmed(np.array([1e4]))[0] == pytest.approx(BEYOND) == pytest.approx(22.46, abs=0.01)
    assert verdict([1e4]) == "consistent"  # a single run is no evidence


@campaigns
@each_number
@each_law
def test_false_alarms_of_marks(law, runs, count):
    """Of consistent estimators at most 2.5 % get a mark, and at most 5 % are conservative."""
    generator = np.random.default_rng(runs)
    found = [verdict(law(generator, runs)) for _ in range(count)]
    assert np.mean([word in MARKS for word in found]) <= limit(0.025, count)
    if law is not LAWS["5 % of ten times"]:  # nine tenths of its runs are conservative
        assert np.mean([word == "conservative" for word in found]) <= limit(0.05, count)


@campaigns
@each_number
def test_false_alarms_of_unsafe(runs, count):
    """An estimator with 5 % of false fixes is called unsafe in at most 2.5 % of campaigns.

    Alone, and with runs that share their fate over maps, ten to a map.
    """
    generator = np.random.default_rng(runs)
    maps = np.arange(runs) // 10
    alarms = {"alone": 0, "shared": 0}
    for _ in range(count):
        nees = generator.chisquare(6, runs)
        alarms["alone"] += verdict(nees, generator.random(runs) < 0.05) == "unsafe"
        fate = generator.beta(0.5, 9.5, runs)[maps]
        alarms["shared"] += verdict(nees, generator.random(runs) < fate, maps) == "unsafe"
    assert alarms["alone"] / count <= limit(0.025, count)
    if runs >= 60:  # below, there are two maps at most
        assert alarms["shared"] / count <= limit(0.025, count)


@pytest.mark.parametrize(("runs", "scale"), [(20, 2.0), (60, 1.6), (200, 1.3)])
def test_power_of_a_mark(runs, scale):
    """Overconfident covariances are found in most campaigns: the control of the rates."""
    generator = np.random.default_rng(runs)
    found = [verdict(scale * generator.chisquare(6, runs)) for _ in range(100)]
    assert found.count("overconfident") >= 80
    halved = [verdict(0.4 * generator.chisquare(6, runs)) for _ in range(100)]
    assert halved.count("conservative") >= 80


class Unaided(NamedTuple):
    """Law of the errors of an unaided INS: K epochs, prior covariance, Φ and Q."""

    times: np.ndarray
    prior: np.ndarray
    transition: list[np.ndarray]
    process: list[np.ndarray]

    @classmethod
    def small(cls) -> Unaided:
        """Return that of two linear problems side by side, of ten states."""
        both = linear_problem(5), linear_problem(6)
        parts = [
            [block_diag(*pair) for pair in zip(*(getattr(p, key) for p in both), strict=True)]
            for key in ("transition", "process_cov")
        ]
        return cls(both[0].times, block_diag(*(p.prior_cov for p in both)), *parts)

    @classmethod
    def flown(cls, step: int) -> Unaided:
        """Return that of the flight of Wang et al. (2013), of every so many epochs."""
        problem, _ = gg.simulate(gg.load("wang2013").case("0.01E-1Hz-unfiltered"))
        transition, process, n = [], [], problem.dimension
        for start in range(0, problem.epochs - step + 1, step):
            phi, q = np.eye(n), np.zeros((n, n))
            for k in range(start, start + step):
                one = problem.transition[k]
                phi, q = one @ phi, one @ q @ one.T + problem.process_cov[k]
            transition.append(phi)
            process.append(q)
        times = problem.times[step - 1 :: step][: len(process)]
        return cls(times, problem.prior_cov, transition, process)


def unaided(law: Unaided, runs: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return NEES and coverage of the INS in runs of its own law, whose covariance it reports."""
    generator, n = np.random.default_rng(seed), len(law.prior)
    cov, epochs = law.prior, len(law.times)
    state = generator.multivariate_normal(np.zeros(n), cov, runs, method="eigh")
    errors, covs = np.empty((runs, epochs, 6)), np.empty((epochs, 6, 6))
    for k, (phi, q) in enumerate(zip(law.transition, law.process, strict=True)):
        noise = generator.multivariate_normal(np.zeros(n), q, runs, method="eigh")
        state, cov = state @ phi.T + noise, phi @ cov @ phi.T + q
        errors[:, k], covs[k] = state[:, :6], cov[:6, :6]
    windows = WindowsSpec(settled_from_s=float(law.times[epochs // 2]), last_s=1.0)
    claimed = np.ascontiguousarray(np.broadcast_to(covs, (runs, *covs.shape)))
    found, flaws = evaluate_block(errors, np.zeros_like(errors), claimed)
    assert not any(flaws)
    means = window_means(found, law.times, windows)[:, 1]
    return means[:, 2], means[:, 4]


def marked(nees: np.ndarray, coverage: np.ndarray, runs: int) -> float:
    """The share of campaigns of so many runs that get a mark."""
    alone, fixes = np.arange(runs), np.zeros(runs, dtype=bool)
    marks = [
        consistency(own, inside, alone, false_share_p(fixes, alone)) in MARKS
        for own, inside in zip(nees.reshape(-1, runs), coverage.reshape(-1, runs), strict=True)
    ]
    return float(np.mean(marks))


@pytest.mark.parametrize("runs", [5, 20])
def test_the_unaided_ins_with_the_right_model_gets_no_mark(runs):
    """In at most 2.5 % of 200 campaigns, of which three deviations are 3.3 %."""
    found = unaided(Unaided.small(), 200 * runs, runs)
    assert marked(*found, runs) <= limit(0.025, 200)
    assert marked(4.0 * found[0], found[1], runs) > 0.5


@pytest.mark.long
@pytest.mark.parametrize("runs", [5, 20, 200])
def test_the_ins_of_a_published_flight_gets_no_mark(runs):
    """In at most 2.5 % of 1,000 campaigns of the INS of Wang et al. (2013), every tenth epoch."""
    law = Unaided.flown(10)
    parts = [unaided(law, 50 * runs, seed) for seed in range(20)]
    nees, coverage = (np.concatenate(values) for values in zip(*parts, strict=True))
    assert abs(nees.mean() - 6.0) < 0.15
    assert marked(nees, coverage, runs) <= 0.025


@campaigns
@each_number
def test_false_alarms_of_the_noise(runs, count):
    """White innovations of the assumed noise fit in at least 97.5 % of campaigns, heavy ones too.

    Fifteen measurements of five channels in a run. Noise a third off is found in most of 60 runs.
    """
    generator, band, alone = np.random.default_rng(runs), mean_band(15 * runs, 5), np.arange(runs)
    alarms, found = {"light": 0, "heavy": 0}, 0
    for _ in range(count):
        light = generator.chisquare(5, (runs, 15))
        heavy = 0.6 * light / (generator.chisquare(5, (runs, 15)) / 5.0)
        for kind, nis in (("light", light), ("heavy", heavy)):
            alarms[kind] += noise_fit(nis.mean(axis=1), 5.0, band, alone) == UNFIT
        found += noise_fit(1.33 * light.mean(axis=1), 5.0, band, alone) == UNFIT
    assert max(alarms.values()) / count <= limit(0.025, count)
    assert found / count > 0.8 or runs < 60


def test_noise_within_ten_per_cent_of_its_band_fits():
    """Twice the measurement noise in R is out; a NIS just outside its band is not."""
    generator, alone, band = np.random.default_rng(2), np.arange(200), mean_band(200 * 50, 5)
    nis = generator.chisquare(5, (200, 50)).mean(axis=1)
    assert noise_fit(1.06 * nis, 5.0, band, alone) == ""
    assert 1.06 * nis.mean() > band[1]
    assert noise_fit(0.5 * nis, 5.0, band, alone) == noise_fit(2.0 * nis, 5.0, band, alone) == UNFIT
    assert noise_fit(nis[:0], 5.0, band, alone[:0]) == noise_fit(nis, 0.0, band, alone) == ""
