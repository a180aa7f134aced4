"""What several tests ask estimators for: labels, runs, problems beyond those of the contract."""

from __future__ import annotations

import dataclasses
import functools
import os
import typing
from typing import Any

import numpy as np
import pytest
from paper_flights import flight

from ggbench.block import ProblemBlock
from ggbench.campaign import registry
from ggbench.contract.references import CONSTANT as CONSTANT
from ggbench.contract.references import UNITS as UNITS
from ggbench.contract.references import LinearModel as LinearModel
from ggbench.contract.references import deviation as deviation
from ggbench.contract.references import exact as exact
from ggbench.contract.references import graded as graded
from ggbench.contract.references import kalman as kalman
from ggbench.contract.references import linear_problem as linear_problem
from ggbench.contract.references import noisy_problem as noisy_problem
from ggbench.contract.references import propagated as propagated
from ggbench.contract.references import smoothed as smoothed
from ggbench.parameters import parameters_of
from ggbench.problem import Estimate, Estimator, Problem
from ggbench.simulation import error_free_flight
from ggbench.simulation.runs import Truth, simulate, simulate_block
from ggbench.spec import scenario

CASES = (
    "0.01E-1Hz",
    "0.001E-1Hz",
    "0.01E-0.2Hz",
    "0.01E-1Hz-unfiltered",
    "0.001E-1Hz-unfiltered",
)
SEED = 2013
changed = dataclasses.replace
"""The problem with other values of some attributes."""
PLUGIN_VARIABLE = "GGBENCH_TEST_ESTIMATOR"
"""Environment variable with estimators of one's own, ``my.py;my.py[size=3]``, to be tested too."""


COMPILED_APART = ("gaussian-sum", "gauss-newton", "factor-graph")
"""Names whose kernels take longer to compile than all of ``make test`` takes to run."""
SLOW = (
    "closed-loop[filter=ukf]",
    "correlation[association=nearest]",
    "correlation[association=reciprocal]",
    "correlation[candidates=nodes]",
    "correlation[fusion=none]",
    "ekf[loss=cauchy]",
    "ekf[loss=huber]",
    "gtsam[loss=cauchy]",
    "gaussian-particle[proposal=ekf]",
    "gaussian-particle[proposal=ukf]",
    "iccp[fusion=none]",
    "iccp[transform=similarity]",
    "reduced[states=position]",
    "tercom[criterion=cor]",
    "tercom[criterion=mad]",
    "tercom[criterion=ml]",
    "tercom[criterion=ncc]",
    "tercom[criterion=nccdm]",
    "tercom[fusion=none]",
    "tercom[loss=cauchy]",
    "tercom[loss=huber]",
    "ukf[loss=cauchy]",
    "ukf[loss=huber]",
    "unscented-particle[weights=exact]",
    "unscented-particle[weights=likelihood]",
    "viterbi",
    "viterbi[decode=forward]",
    "viterbi[decode=marginal]",
)
"""Modes for whose family another one is tested every time; ``viterbi``, whose grids are large, has
tests of its own."""


def is_slow(label: str) -> bool:
    """Whether a label's tests are left to the long ones."""
    return label in SLOW or label.startswith(COMPILED_APART)


def each_label() -> list[Any]:
    """The same as parameters of a test, the slow ones marked as long."""
    long = pytest.mark.long
    return [pytest.param(text, marks=long) if is_slow(text) else text for text in labels()]


def labels() -> list[str]:
    """Every registered estimator in every mode, and those that the environment names."""
    found = []
    for name, cls in registry.registered().items():
        modes = [
            f"{name}[{key}={choice}]"
            for key, (annotation, default) in parameters_of(cls).items()
            if key != "resampling"  # a part with tests of its own, not a way to estimate
            if typing.get_origin(annotation) is typing.Literal
            for choice in typing.get_args(annotation)
            if choice != default
        ]
        found += [name, *modes]
    return found + [text for text in os.environ.get(PLUGIN_VARIABLE, "").split(";") if text]


@functools.cache
def estimator(label: str) -> Estimator:
    return registry.choose(label).estimator


def final_nees(block: ProblemBlock, truth: Truth, states: list[int]) -> np.ndarray:
    """NEES of some states at the end of each run (R,), by the EKF."""
    estimate = estimator("ekf").estimate_block(block)
    off = (estimate.mean - truth.error_state[..., : block.dimension])[:, -1][:, states]
    cov = estimate.cov[:, -1][:, states][:, :, states]
    return np.einsum("ri,ri->r", off, np.linalg.solve(cov, off[..., np.newaxis])[..., 0])


def refusal(label: str, problem: Problem) -> str:
    """Why an estimator is refused: its parameters when it is made, else the problem."""
    try:
        return estimator(label).skip(problem) or ""
    except registry.EstimatorError as error:
        return str(error)


def rng() -> np.random.Generator:
    """The generator given to estimators: the same each time."""
    return np.random.default_rng(7)


@functools.cache
def simulated(case: str, run: int = 0) -> tuple[Problem, Truth]:
    """A run of a case of the paper."""
    return simulate(flight(case), SEED, run)


@functools.cache
def block_of_runs(name: str, case: str, first: int, last: int) -> ProblemBlock:
    """Runs of a case of a shipped scenario, as a block."""
    loaded = scenario.load(name)
    prepared = error_free_flight.prepare(loaded.case(case))
    return simulate_block(prepared, loaded.campaign.seed, range(first, last))[0]


@functools.cache
def estimated(case: str, label: str) -> Estimate:
    """An estimator's answer to run 0 of a case of the paper."""
    return estimator(label).estimate(simulated(case)[0], rng())


def entangled(problem: ProblemBlock) -> ProblemBlock:
    """The problem with a prior that has a mean, and states and noises that correlate."""
    rng = np.random.default_rng(5)

    def correlated(cov: np.ndarray) -> np.ndarray:
        n = len(cov)
        root = np.eye(n) + np.tril(rng.normal(size=(n, n)), -1) / np.sqrt(n)
        sigma = np.sqrt(np.diag(cov) / np.sum(root**2, axis=1))[:, np.newaxis]
        return sigma * root @ (sigma * root).T

    mean = np.sqrt(np.diag(problem.prior_cov)) * rng.normal(size=problem.dimension)
    return dataclasses.replace(
        problem,
        prior_mean=mean,
        prior_cov=correlated(problem.prior_cov),
        noise_cov=correlated(problem.noise_cov),
    )


def evidence(problem: Problem) -> float:
    """Log p(z) of a linear problem, from the Kalman filter's innovations."""
    _, _, predicted, covs = kalman(problem)
    total = 0.0
    for k in range(problem.epochs):
        h = problem.model.jacobian(k, predicted[k])
        s = h @ covs[k] @ h.T + problem.noise_of(k)
        y = problem.measurements[k] - problem.model.predict(k, predicted[k])
        total -= 0.5 * (y @ np.linalg.solve(s, y) + np.linalg.slogdet(2.0 * np.pi * s)[1])
    return total


def conditioned(problem: Problem, ahead: int) -> tuple[np.ndarray, np.ndarray]:
    """The same as :func:`smoothed` by definition: the joint Gaussian of all epochs, conditioned."""
    n, epochs = problem.dimension, problem.epochs
    mean, marginal = propagated(problem)
    joint = np.zeros((epochs, n, epochs, n))
    for k in range(epochs):
        across = marginal[k]
        joint[k, :, k, :] = across
        for j in range(k + 1, epochs):
            across = problem.transition[j] @ across
            joint[j, :, k, :], joint[k, :, j, :] = across, across.T
    means, covs = np.empty((epochs, n)), np.empty((epochs, n, n))
    for k in range(epochs):
        count = min(k + ahead, epochs - 1) + 1
        rows = [problem.model.jacobian(j, mean[j]) for j in range(count)]
        cross = np.concatenate([joint[k, :, j, :] @ rows[j].T for j in range(count)], axis=1)
        innovation_cov = np.block(
            [
                [
                    rows[i] @ joint[i, :, j, :] @ rows[j].T + (i == j) * problem.noise_of(i)
                    for j in range(count)
                ]
                for i in range(count)
            ]
        )
        gain = np.linalg.solve(innovation_cov, cross.T).T
        residual = [problem.measurements[j] - rows[j] @ mean[j] for j in range(count)]
        means[k] = mean[k] + gain @ np.concatenate(residual)
        covs[k] = marginal[k] - gain @ cross.T
    return means, covs


SMALL = """
title = "A short flight over the normal field"
description = "For tests of everything that is not physics."

[trajectory]
latitude_deg = 33.5
longitude_deg = 108.0
height_m = 10000.0
speed_mps = 250.0
heading_deg = 90.0

[[trajectory.segment]]
duration_s = 20.0

[imu]
period_s = 0.1
gyro_bias_deg_per_h = 0.015
gyro_noise_deg_per_sqrt_h = 0.005
accelerometer_bias_ug = 500.0
accelerometer_noise_ug_per_sqrt_hz = 100.0

[initial_error]
position_m = 5.0
velocity_mps = 0.1
attitude_arcmin = 1.0

[gradiometer]
period_s = 1.0
noise_eotvos = 0.01

[field]
source = "normal"

[windows]
settled_from_s = 10.0
last_s = 5.0

[campaign]
estimators = ["ins", "ekf"]

[[case]]
name = "base"
title = "as it is"
reference.position_mrse_m = { value = 6.0, provenance = "paper: none" }
reference.velocity_mrse_mps = { value = 0.3, provenance = "paper: none" }

[[case]]
name = "noisy"
title = "with ten times the noise"
gradiometer.noise_eotvos = 0.1
"""
"""A valid scenario that flies in milliseconds."""
