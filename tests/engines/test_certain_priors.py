"""Batch estimators of a problem whose prior and dynamics are all but certain."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from problems import block_of_runs

from ggbench.campaign.registry import choose


@pytest.mark.parametrize("label", ["factor-graph[mode=batch]", "gauss-newton"])
def test_a_prior_of_a_micrometre_without_process_noise_has_the_filters_answer(label):
    """Finite, with a covariance; at the last epoch a smoother has seen what the filter has."""
    block = block_of_runs("suite", "air-narrow", 0, 1).until(40)
    prior = np.diag(block.prior_cov).copy()
    prior[:3] = 1e-12
    block = dataclasses.replace(
        block, process_cov=np.zeros_like(block.process_cov), prior_cov=np.diag(prior)
    )
    found, plain = (
        choose(name).estimator.estimate_block(block, [np.random.default_rng(1)])
        for name in (label, "ekf")
    )
    assert np.isfinite(found.mean).all() and np.isfinite(found.cov).all()
    sigma = np.sqrt(np.diagonal(plain.cov[0, -1]))
    assert np.abs((found.mean[0, -1] - plain.mean[0, -1]) / sigma).max() < 0.02
    ratio = np.sqrt(np.diagonal(found.cov[0, -1])) / sigma
    np.testing.assert_allclose(ratio, 1.0, atol=0.01)
