"""Estimation of one run or of a block of runs with an assumed noise.

Measurements that are matched with a map err by more than the instrument's noise: by the map's own
error, and by what a linearisation leaves. The usual remedy is a larger assumed R
(``noise_scale``). It is applied here, and the innovations of a filter are normalised by it.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np

from .block import BlockEstimator, EstimateBlock, ProblemBlock
from .engines.innovations import innovations_squared
from .problem import Estimate, Estimator, Problem, matched_with_map

Given = TypeVar("Given", Problem, ProblemBlock)


def estimate(estimator: Estimator, problem: Problem, rng: np.random.Generator) -> Estimate:
    """Return an estimator's answer to one run, with the noise that it assumes."""
    assumed = with_scaled_noise(problem, estimator.noise_scale)
    estimated = estimator.estimate(assumed, rng)
    # What is returned may be anything: a campaign and the contract check it.
    if assumed is problem or not isinstance(estimated, Estimate) or estimated.causality != "filter":
        return estimated
    if estimated.nis is not None or estimated.cov is None:
        return estimated
    # Another copy of the model: it counts evaluations, and these are not the estimator's.
    separate = replace(assumed, model=copy.copy(assumed.model))
    return replace(estimated, nis=innovations_squared(separate, estimated.mean, estimated.cov))


def estimate_block(
    estimator: BlockEstimator, block: ProblemBlock, rngs: Sequence[np.random.Generator] = ()
) -> EstimateBlock:
    """Return an estimator's answer to many runs, with the noise that it assumes."""
    assumed = with_scaled_noise(block, estimator.noise_scale)
    estimated = estimator.estimate_block(assumed, rngs)
    if (
        assumed is block
        or not isinstance(estimated, EstimateBlock)
        or estimated.causality != "filter"
    ):
        return estimated
    if estimated.nis is not None:
        return estimated
    nis = [
        innovations_squared(assumed.problem(run), estimated.mean[run], estimated.cov[run])
        for run in range(assumed.runs)
    ]
    return replace(estimated, nis=np.stack(nis))


def with_scaled_noise(problem: Given, noise_scale: float) -> Given:
    """Return a problem, or a block of them, with R → D R D; itself with a scale of one.

    D is diagonal: ``noise_scale`` for channels of gravity or its gradients (of all channels, if
    the problem does not name them), and one for all others.
    """
    if noise_scale == 1.0:
        return problem
    count = problem.noise_cov.shape[-1]
    scales = np.where(matched_with_map(problem.channels, count), noise_scale, 1.0)
    return replace(problem, noise_cov=problem.noise_cov * np.outer(scales, scales))
