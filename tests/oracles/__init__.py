"""Independent estimators, of the frameworks and in NumPy, to which the compiled ones are held."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from ggbench import estimation
from ggbench.block import ProblemBlock
from ggbench.campaign.registry import choose
from ggbench.estimators.ekf import ExtendedKalmanFilter
from ggbench.estimators.factor_graph import FactorGraph
from ggbench.estimators.filterpy_ekf import FilterpyExtended
from ggbench.problem import Estimate, Estimator, Problem

from . import ekf, gauss_newton, gaussian_sum, ukf, windows

_OWN = {
    "ekf": ekf.estimate,
    "ukf": ukf.estimate,
    "gauss-newton": gauss_newton.estimate,
    "gaussian-sum": gaussian_sum.estimate,
}


class Oracle:
    """The reference of a compiled estimator: a framework's own, or one in NumPy."""

    def __init__(self, estimator: Estimator) -> None:
        self.estimator = estimator
        self._framework = _framework_of(estimator)

    def estimate(self, problem: Problem, rng: np.random.Generator | None = None) -> Estimate:
        """Estimate one run, with the noise that the compiled estimator assumes."""
        if self._framework is not None:
            return estimation.estimate(self._framework, problem, np.random.default_rng(0))
        assumed = estimation.with_scaled_noise(problem, self.estimator.noise_scale)
        return _OWN[self.estimator.name](self.estimator, assumed)


def reference(label: str, **changes: Any) -> Oracle:
    """The oracle of the compiled estimator that a label names, with some parameters changed."""
    return Oracle(dataclasses.replace(choose(label).estimator, **changes))


def assert_as_the_oracle(label: str, block: ProblemBlock) -> None:
    """Of each run of a block, mean and covariance to 1e-6 of the prior's deviations."""
    found = choose(label).estimator.estimate_block(block)
    sigma = np.sqrt(np.diag(block.prior_cov))
    scale = np.outer(sigma, sigma)
    for run in range(block.runs):
        expected = reference(label).estimate(block.problem(run))
        np.testing.assert_allclose(found.mean[run] / sigma, expected.mean / sigma, atol=1e-6)
        np.testing.assert_allclose(found.cov[run] / scale, expected.cov / scale, atol=1e-6)


def solver(label: str) -> Estimator | Oracle:
    """What a label names; of compiled estimators that need kernels, the oracle.

    For problems whose model has none, as tests make them.
    """
    estimator = choose(label).estimator
    if estimator.name in windows.MATCHERS:
        return windows.MATCHERS[estimator.name](**vars(estimator))
    return Oracle(estimator) if estimator.name in {"factor-graph", *_OWN} else estimator


def _framework_of(estimator: Estimator) -> Estimator | None:
    if isinstance(estimator, FactorGraph):
        from ggbench.estimators.gtsam_smoothers import GtsamSmoother

        return GtsamSmoother(**vars(estimator))
    if estimator == ExtendedKalmanFilter(noise_scale=estimator.noise_scale):
        return FilterpyExtended(noise_scale=estimator.noise_scale)
    return None
