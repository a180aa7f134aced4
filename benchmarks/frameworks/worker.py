"""Measurement of one estimator in a separate process.

``python -m frameworks.worker LABEL REFERENCE`` prints a JSON object with

- the processor times of the first run and of later runs,
- the peak memory,
- the largest difference from the reference,
- the outcomes with a wide prior, an indefinite prior covariance and a NaN measurement.
"""

from __future__ import annotations

import json
import sys
import time
import warnings
from dataclasses import replace

import numpy as np

import ggbench as gg
from ggbench import estimation
from ggbench.campaign.records import peak_memory_mb
from ggbench.problem import Estimator, Problem

SCENARIO, CASE = "wang2013", "0.01E-1Hz-unfiltered"
RUNS = 5
WIDER = 1000.0
"""Factor on the standard deviations of the position prior."""


def problems() -> list[Problem]:
    """Return the problems of :data:`RUNS` runs."""
    loaded = gg.load(SCENARIO)
    case, seed = loaded.case(CASE), loaded.campaign.seed
    return [gg.simulate(case, seed, run)[0] for run in range(RUNS)]


def estimated(estimator: Estimator, problem: Problem) -> tuple[np.ndarray, np.ndarray]:
    """Return the estimated means (K, n) and covariances (K, n, n)."""
    found = estimation.estimate(estimator, problem, np.random.default_rng(0))
    assert found.cov is not None
    return found.mean, found.cov


def fate(estimator: Estimator, problem: Problem) -> str:
    """Return the outcome of an estimator on a difficult problem, in words."""
    try:
        mean, cov = estimated(estimator, problem)
    except Exception as error:
        return f"error ({type(error).__name__})"
    if not np.isfinite(mean).all() or not np.isfinite(cov).all():
        return "NaN, silent"
    variances = np.diagonal(cov, axis1=1, axis2=2)
    if (variances <= 0.0).any():
        return "negative variance, silent"
    return "finite"


def indefinite(problem: Problem) -> Problem:
    """Return the problem with an indefinite prior: a correlation is above one."""
    cov = np.array(problem.prior_cov)
    sigma = np.sqrt(np.diag(cov))
    cov[0, 1] = cov[1, 0] = 1.5 * sigma[0] * sigma[1]
    return replace(problem, prior_cov=cov)


def wide(problem: Problem) -> Problem:
    """Return the problem with a wide position prior."""
    scale = np.ones(problem.dimension)
    scale[:3] = WIDER
    return replace(problem, prior_cov=problem.prior_cov * np.outer(scale, scale))


def with_nan(problem: Problem) -> Problem:
    """Return the problem with one NaN measurement."""
    measurements = np.array(problem.measurements)
    measurements[problem.epochs // 2, 0] = np.nan
    return replace(problem, measurements=measurements)


def main(label: str, reference: str) -> None:
    """Measure an estimator and print the results."""
    warnings.simplefilter("ignore")
    held = problems()
    own, other = gg.estimator(label), gg.estimator(reference)
    estimated(other, held[0])
    before = peak_memory_mb()
    seconds, answers = [], []
    for problem in held:
        start = time.process_time()
        answers.append(estimated(own, problem))
        seconds.append(time.process_time() - start)
    peak = peak_memory_mb()
    worst = 0.0
    for problem, (mean, cov) in zip(held, answers, strict=True):
        expected, covariance = estimated(other, problem)
        sigma = np.sqrt(np.diag(problem.prior_cov))
        spread = [np.sqrt(np.diagonal(c, axis1=1, axis2=2)) for c in (cov, covariance)]
        worst = max(worst, float((np.abs(mean - expected) / sigma).max()))
        worst = max(worst, float((np.abs(spread[0] - spread[1]) / sigma).max()))
    first = held[0]
    print(
        json.dumps(
            {
                "first_ms": 1e3 * seconds[0],
                "ms": 1e3 * float(np.median(seconds[1:])),
                "memory_mb": peak - before,
                "difference": worst,
                "wide": fate(own, wide(first)),
                "indefinite": fate(own, indefinite(first)),
                "nan": fate(own, with_nan(first)),
            }
        )
    )


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2])
