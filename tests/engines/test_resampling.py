"""Weights of particles and resampling: what unbiased means, counted.

Statistical tests have fixed seeds and state how often another seed would fail them.
"""

from __future__ import annotations

import numpy as np
import pytest

from ggbench.engines.resampling import (
    FLOOR,
    effective_size,
    moments,
    normalise,
    repaired,
    resample,
    strata,
    unique,
)

KINDS = ("systematic", "stratified", "residual")
each_kind = pytest.mark.parametrize("kind", KINDS)


def weights_of(count: int, seed: int = 0, power: float = 3.0) -> np.ndarray:
    """Uneven weights that add up to one, some of them zero."""
    weights = np.random.default_rng(seed).random(count) ** power
    weights[::7] = 0.0
    return weights / weights.sum()


def normalised(log_weights: np.ndarray) -> tuple[np.ndarray, float]:
    weights = np.empty(len(log_weights))
    return weights, normalise(log_weights, weights)


def test_weights_of_a_reading_that_tells_particles_sharply_apart_do_not_underflow():
    """Where e^−10000 is zero, ratios of weights are still those of the likelihoods."""
    weights, evidence = normalised(np.array([-10_000.0, -10_000.0 + np.log(3.0), -40_000.0]))
    np.testing.assert_allclose(weights, [0.25, 0.75, 0.0], rtol=1e-12)
    assert evidence == pytest.approx(-10_000.0 + np.log(4.0), abs=1e-9)


@pytest.mark.parametrize("nothing", [-np.inf, np.nan])
def test_a_reading_that_fits_no_particle_tells_nothing(nothing):
    """Then weights are equal instead of NaN; beside one that fits, what is no number weighs 0."""
    weights, evidence = normalised(np.full(4, nothing))
    np.testing.assert_array_equal(weights, 0.25)
    assert evidence == -np.inf
    weights, evidence = normalised(np.array([nothing, -5.0]))
    np.testing.assert_array_equal(weights, [0.0, 1.0])
    assert evidence == -5.0


def test_effective_size_counts_particles():
    """Of equal weights it is their number, of one that has all it is one."""
    assert effective_size(np.full(8, 0.125)) == 8.0
    assert effective_size(np.array([0.0, 1.0, 0.0])) == 1.0
    assert effective_size(np.array([0.5, 0.5, 0.0, 0.0])) == 2.0


@each_kind
def test_resampling_is_unbiased(kind):
    """Each particle is copied N W times in the mean of 4000 resamplings, to five deviations.

    A copy number's variance is below that of multinomial resampling, N W. With 40 particles the
    probability of a false alarm is 2e-5.
    """
    weights, rng, draws = weights_of(40), np.random.default_rng(1), 4000
    counts = np.zeros(40)
    for _ in range(draws):
        counts += np.bincount(resample(kind, weights, rng), minlength=40)
    expected = 40.0 * weights
    off = np.abs(counts / draws - expected)
    assert (off <= 5.0 * np.sqrt(expected / draws)).all()


@each_kind
def test_copies_are_as_near_to_what_is_expected_as_the_method_promises(kind):
    """Systematic: within one of N W. Stratified: within two. Residual: no fewer than ⌊N W⌋."""
    rng = np.random.default_rng(2)
    for seed in range(50):
        weights = weights_of(300, seed)
        ancestors = resample(kind, weights, rng)
        counts, expected = np.bincount(ancestors, minlength=300), 300.0 * weights
        assert counts.sum() == 300
        assert (np.diff(ancestors) >= 0).all()
        assert (counts[weights == 0.0] == 0).all()
        if kind == "residual":
            assert (counts >= np.floor(expected - 1e-9)).all()
        else:
            assert np.abs(counts - expected).max() < (1.0 if kind == "systematic" else 2.0) + 1e-9


@each_kind
def test_one_particle_that_has_all_the_weight_becomes_all_of_them(kind):
    """Wherever it stands, last place included, and whatever rounding makes of the sum."""
    rng = np.random.default_rng(3)
    for place in (0, 3, 9):
        weights = np.zeros(10)
        weights[place] = 1.0 - 1e-13
        ancestors = resample(kind, weights, rng)
        assert (ancestors == place).all()
        assert unique(ancestors) == 1


def test_systematic_resampling_of_equal_weights_keeps_every_particle():
    ancestors = np.empty(1000, dtype=np.int64)
    strata(np.full(1000, 1e-3), np.array([0.5]), ancestors)
    assert unique(ancestors) == 1000


def test_quantiles_beyond_the_sum_of_rounded_weights_choose_a_particle_that_weighs():
    """Weights that add up to a little less than one do not choose the last one of weight zero."""
    weights = np.array([0.5, 0.5 - 1e-9, 0.0, 0.0])
    ancestors = np.empty(4, dtype=np.int64)
    strata(weights, np.array([1.0 - 1e-12]), ancestors)
    np.testing.assert_array_equal(ancestors, [0, 0, 1, 1])


def test_moments_are_those_of_numpy():
    """Mean and covariance of weighted states, in the large sample's normalisation."""
    states, weights = np.random.default_rng(4).normal(size=(50, 3)) + 1e3, weights_of(50)
    mean, cov = moments(weights, states)
    np.testing.assert_allclose(mean, np.average(states, axis=0, weights=weights), rtol=1e-13)
    expected = np.cov(states.T, aweights=weights, ddof=0)
    np.testing.assert_allclose(cov, expected, rtol=1e-9, atol=1e-12)


def test_a_covariance_of_too_few_particles_is_repaired_and_a_good_one_is_not():
    """In units of the prior, kilometres beside microradians: positive definite, else untouched."""
    units = np.array([1e3, 1e-6, 1e2])
    prior = np.diag(units**2)
    rng = np.random.default_rng(5)
    good = np.cov((rng.normal(size=(100, 3)) * units * 1e-3).T)
    cov, was_repaired = repaired(good, prior)
    assert not was_repaired
    np.testing.assert_allclose(cov, good, rtol=1e-14)
    two = np.cov((rng.normal(size=(2, 3)) * units).T)
    for flat in (two, np.zeros((3, 3))):
        cov, was_repaired = repaired(flat, prior)
        assert was_repaired
        np.testing.assert_allclose(
            cov / np.outer(units, units), flat / np.outer(units, units), atol=20.0 * FLOOR
        )
        sigma = np.sqrt(np.diag(cov))
        assert np.linalg.eigvalsh(cov / np.outer(sigma, sigma)).min() > 0.0
