"""Independent estimators, of the frameworks and in NumPy, to which the compiled ones are held."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from ggbench import estimation
from ggbench.campaign.registry import choose
from ggbench.estimators.ekf import ExtendedKalmanFilter
from ggbench.estimators.factor_graph import FactorGraph
from ggbench.estimators.filterpy_ekf import FilterpyExtended
from ggbench.problem import Estimate, Estimator, Problem

from . import ekf, gauss_newton, gaussian_sum, ukf

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


def solver(label: str) -> Estimator | Oracle:
    """What a label names; of compiled estimators that need kernels, the oracle.

    For problems whose model has none, as tests make them.
    """
    estimator = choose(label).estimator
    return Oracle(estimator) if estimator.name in {"factor-graph", *_OWN} else estimator


def _framework_of(estimator: Estimator) -> Estimator | None:
    if isinstance(estimator, FactorGraph):
        from ggbench.estimators.gtsam_smoothers import GtsamSmoother

        return GtsamSmoother(**vars(estimator))
    if estimator == ExtendedKalmanFilter(noise_scale=estimator.noise_scale):
        return FilterpyExtended(noise_scale=estimator.noise_scale)
    return None
