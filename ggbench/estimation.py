"""Estimation of one run or of a block of runs, with scaled measurement noise.

The errors of map-matched measurements are larger than the instrument noise: they include map errors
and nonlinearity. The usual remedy is a larger assumed noise covariance R. The parameter
``noise_scale`` of an estimator is a factor on the assumed standard deviations. This module scales R
before the estimation, so innovations are normalised with the scaled R.
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
    """Return the estimate of one run, with noise scaled by the estimator's ``noise_scale``."""
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
    """Return the estimates of a block of runs, with noise scaled by ``noise_scale``."""
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
    """Return a problem or a block with D R D in place of R; unchanged for a scale of 1.

    R is the noise covariance. D is diagonal. Its elements are ``noise_scale`` for channels of
    gravity or gravity gradients, and 1 for all other channels. If the channels are unnamed, all
    elements are ``noise_scale``.
    """
    if noise_scale == 1.0:
        return problem
    count = problem.noise_cov.shape[-1]
    scales = np.where(matched_with_map(problem.channels, count), noise_scale, 1.0)
    return replace(problem, noise_cov=problem.noise_cov * np.outer(scales, scales))
