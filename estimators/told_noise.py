"""A noise other than the given one: what estimators are told of the readings of the map.

Readings that are matched with a map err by more than the instrument's noise: by the map's own error
and by what a filter's linearisation leaves. None of that is in R. The usual remedy is a larger R,
and how large is one of the first things to be tuned. The other sensors' noises are left as they
are.
"""

from __future__ import annotations

import copy
from dataclasses import replace
from typing import TypeVar

import numpy as np

from ..block import EstimateBlock, ProblemBlock
from ..engines.innovations import innovations_squared
from ..problem import Estimate, Problem

_OF_THE_MAP = ("E", "mGal")
"""Units of what a gradiometer or a gravimeter reads; sensors' names are whatever a case says."""

Told = TypeVar("Told", Problem, ProblemBlock)


def refusal(noise_scale: float) -> str | None:
    """Return why a scale of the noise means nothing, or None if it does."""
    if not 0.0 < noise_scale < np.inf:
        return f"noise_scale must be positive and finite, and is {noise_scale:g}"
    return None


def told(given: Told, noise_scale: float) -> Told:
    """Return the problem, or the block of them, with R → D R D; itself with a scale of one.

    D is diagonal: ``noise_scale`` for channels of gravity or its gradients (of all channels, if
    nobody says what they are), and one for all others.
    """
    if noise_scale == 1.0:
        return given
    of_the_map = [channel.unit in _OF_THE_MAP for channel in given.channels] or True
    scales = np.where(of_the_map, noise_scale, np.ones(given.noise_cov.shape[-1]))
    return replace(given, noise_cov=given.noise_cov * np.outer(scales, scales))


def with_own_nis(estimate: Estimate, told: Problem, noise_scale: float) -> Estimate:
    """Return a filter's estimate with the NIS of the noise that it was ``told``.

    With a scale of one as it is: judging knows that noise, and asks for the same.
    """
    if noise_scale == 1.0 or estimate.causality != "filter" or estimate.cov is None:
        return estimate
    # Of another copy of the model: it counts evaluations, and these are not the estimator's.
    asked = replace(told, model=copy.copy(told.model))
    return replace(estimate, nis=innovations_squared(asked, estimate.mean, estimate.cov))


def with_own_nis_of_runs(
    estimate: EstimateBlock, told: ProblemBlock, noise_scale: float
) -> EstimateBlock:
    """Return what :func:`with_own_nis` does of many runs at once."""
    if noise_scale == 1.0 or estimate.causality != "filter":
        return estimate
    nis = [
        innovations_squared(told.problem(run), estimate.mean[run], estimate.cov[run])
        for run in range(told.runs)
    ]
    return replace(estimate, nis=np.stack(nis))
