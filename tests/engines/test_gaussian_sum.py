"""The compiled Gaussian sum beside NumPy's: the same hypotheses, weights and moments."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from oracles import reference
from problems import block_of_runs

from ggbench.block import block_of
from ggbench.campaign.registry import choose
from ggbench.spec import scenario

pytestmark = pytest.mark.long  # to compile it takes ten times as long as to run it

COMPILED = choose("gaussian-sum").estimator


@pytest.mark.parametrize(
    ("name", "case"),
    [
        ("wide_prior", "3km"),
        ("ship", "1E-lost"),
        ("parallel_valleys", "1E"),
        ("wide_prior", "10km"),
        ("gnss_outage", None),
    ],
)
@pytest.mark.parametrize(("iterations", "limit"), [(1, 1e-7), (3, 1e-4)])
def test_numpy_gives_the_same_answer(name, case, iterations, limit):
    """As many hypotheses at every epoch; means and covariances, in deviations of the prior.

    Iterated updates end within a thousandth of a deviation of the most probable state, where the
    last halving of a step is decided by rounding.
    """
    block = block_of_runs(name, case or scenario.load(name).cases[0].name, 0, 2)
    found = dataclasses.replace(COMPILED, iterations=iterations).estimate_block(block)
    oracle = reference("gaussian-sum", iterations=iterations)
    sigma = np.sqrt(np.diag(block.prior_cov))
    for run in range(block.runs):
        expected = oracle.estimate(block.problem(run))
        for key in ("hypotheses", "mean_hypotheses"):
            assert found.info[key][run] == pytest.approx(expected.info[key])
        assert np.abs((found.mean[run] - expected.mean) / sigma).max() < limit
        assert np.abs((found.cov[run] - expected.cov) / np.outer(sigma, sigma)).max() < limit


@pytest.mark.parametrize("loss", ["huber", "cauchy"])
def test_with_a_loss_numpy_gives_the_same_answer(loss):
    """Among outliers, where the answer without one is another."""
    block = block_of_runs("outliers", "outliers-5pc", 0, 2)
    found = dataclasses.replace(COMPILED, loss=loss).estimate_block(block)
    plain = COMPILED.estimate_block(block)
    sigma = np.sqrt(np.diag(block.prior_cov))
    for run in range(block.runs):
        expected = reference("gaussian-sum", loss=loss).estimate(block.problem(run))
        assert np.abs((found.mean[run] - expected.mean) / sigma).max() < 1e-4
        assert np.abs((found.cov[run] - expected.cov) / np.outer(sigma, sigma)).max() < 1e-4
        assert np.abs((plain.mean[run] - expected.mean) / sigma).max() > 1e-2


def test_a_run_does_not_depend_on_its_neighbours():
    """Alone and among others: the same bits."""
    block = block_of_runs("wide_prior", "3km", 0, 2)
    both = COMPILED.estimate_block(block)
    for run in range(2):
        alone = COMPILED.estimate_block(block_of(block.problem(run)))
        np.testing.assert_array_equal(alone.mean[0], both.mean[run])
        np.testing.assert_array_equal(alone.cov[0], both.cov[run])
        for key, values in alone.info.items():
            assert values[0] == both.info[key][run]


def test_a_run_of_which_no_hypothesis_is_left_has_no_answer_from_there_on():
    """A reading that is not a number; the other run has its own, bit by bit."""
    block = block_of_runs("wide_prior", "3km", 0, 2)
    measurements = block.measurements.copy()
    measurements[0, 5] = np.nan
    usual = COMPILED.estimate_block(block)
    found = COMPILED.estimate_block(dataclasses.replace(block, measurements=measurements))
    assert np.isfinite(found.mean[0, :5]).all() and np.isnan(found.mean[0, 5:]).all()
    np.testing.assert_array_equal(found.mean[1], usual.mean[1])
