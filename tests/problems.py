"""Problems whose answer is known, and the textbook recursions that give it."""

from __future__ import annotations

import dataclasses
import functools
import os
import typing
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from conftest import flight

from ggbench.block import ProblemBlock
from ggbench.campaign import registry
from ggbench.problem import Estimate, Estimator, Problem, StateBlock
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
PLUGIN_VARIABLE = "GGBENCH_TEST_ESTIMATOR"
"""Environment variable with estimators of one's own, ``my.py;my.py[size=3]``, to be tested too."""


SLOW = (
    "closed-loop[filter=ukf]",
    "correlation[association=nearest]",
    "correlation[association=reciprocal]",
    "correlation[candidates=nodes]",
    "correlation[fusion=none]",
    "factor-graph[loss=cauchy]",
    "gauss-newton[loss=cauchy]",
    "gaussian-sum[loss=cauchy]",
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
    "unscented-particle[weights=exact]",
    "unscented-particle[weights=likelihood]",
    "viterbi",
    "viterbi[decode=forward]",
    "viterbi[decode=marginal]",
)
"""Modes for whose family another stands in the tests that run every time; for ``viterbi``, whose
grids are large, tests of its own."""


def each_label() -> list[Any]:
    """The same as parameters of a test, the slow ones marked as long."""
    long = pytest.mark.long
    return [pytest.param(text, marks=long) if text in SLOW else text for text in labels()]


def labels() -> list[str]:
    """Every registered estimator in every mode, and those that the environment names."""
    found = []
    for name, cls in registry.registered().items():
        modes = [
            f"{name}[{key}={choice}]"
            for key, (annotation, default) in registry.parameters_of(cls).items()
            if key != "resampling"  # a part with tests of its own, not a way to estimate
            if typing.get_origin(annotation) is typing.Literal
            for choice in typing.get_args(annotation)
            if choice != default
        ]
        # The compiled engine of the graph knows one of its modes.
        modes = [m.replace("factor-graph[engine", "factor-graph[mode=batch,engine") for m in modes]
        found += [name, *modes]
    return found + [text for text in os.environ.get(PLUGIN_VARIABLE, "").split(";") if text]


@functools.cache
def estimator(label: str) -> Estimator:
    return registry.choose(label).estimator


def compiled(label: str) -> Any:
    """The compiled engine of a built-in estimator."""
    name, _, rest = label.rstrip("]").partition("[")
    return estimator(f"{name}[{','.join(filter(None, [rest, 'engine=numba']))}]")


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


@dataclass(frozen=True)
class LinearModel:
    """h(k, x) = H_k x."""

    rows: np.ndarray

    def predict(self, k: int, x: np.ndarray) -> np.ndarray:
        return np.asarray(x) @ self.rows[k].T

    def jacobian(self, k: int, x: np.ndarray) -> np.ndarray:
        return np.tile(self.rows[k], (*np.shape(x)[:-1], 1, 1))


UNITS = np.array([1e3, 1e-2, 1e-6, 1e-8, 1e2])
"""Sizes of the states of :func:`linear_problem`: 1 km, 1 cm/s, 1 µrad, ..."""
CONSTANT = slice(3, 5)
"""Its states that never change."""


def linear_problem(seed: int, epochs: int = 40, m: int = 2, period: float = 1.0) -> Problem:
    """A random linear-Gaussian problem with a truth drawn from it; five states in mixed units.

    Three states move, driven by noise of rank two (exactly singular) and by two constant ones.
    """
    rng = np.random.default_rng(seed)
    n = len(UNITS)
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    transition = np.tile(np.eye(n), (epochs, 1, 1))
    process_cov = np.zeros((epochs, n, n))
    for k in range(epochs):
        transition[k, :3, :3] = 0.97 * turn + 0.02 * rng.normal(size=(3, 3))
        transition[k, :3, CONSTANT] = 0.1 * rng.normal(size=(3, 2))
        spread = 0.2 * rng.normal(size=(2, 2))
        process_cov[k, :2, :2] = spread @ spread.T
    root = np.eye(n) + 0.3 * np.tril(rng.normal(size=(n, n)), -1)
    rows = rng.normal(size=(epochs, m, n))
    noise_root = np.diag(np.geomspace(0.3, 1.0, m)) + 0.1 * np.tril(np.ones((m, m)), -1)
    mean = rng.normal(size=n)
    x = mean + root @ rng.standard_normal(n)
    measurements = np.empty((epochs, m))
    for k in range(epochs):
        x = transition[k] @ x
        x[:2] += np.linalg.cholesky(process_cov[k, :2, :2]) @ rng.standard_normal(2)
        measurements[k] = rows[k] @ x + noise_root @ rng.standard_normal(m)
    sizes = np.outer(UNITS, UNITS)
    return Problem(
        times=period * np.arange(1, epochs + 1),
        measurements=measurements,
        noise_cov=noise_root @ noise_root.T,
        transition=transition * UNITS[:, None] / UNITS,
        process_cov=process_cov * sizes,
        prior_mean=mean * UNITS,
        prior_cov=root @ root.T * sizes,
        model=LinearModel(rows / UNITS),
        layout=(StateBlock("moving", slice(0, 3), "mixed"), StateBlock("constant", CONSTANT, "1")),
    )


def noisy_problem(seed: int, epochs: int = 40, n: int = 3, m: int = 2) -> Problem:
    """A random linear-Gaussian problem whose process noise has full rank, as Monte Carlo likes it.

    States forget their past within a few epochs, and a reading is worth about as much as the
    prediction.
    """
    rng = np.random.default_rng(seed)
    transition, process_cov = np.empty((epochs, n, n)), np.empty((epochs, n, n))
    rows = rng.normal(size=(epochs, m, n))
    for k in range(epochs):
        turn, _ = np.linalg.qr(rng.normal(size=(n, n)))
        transition[k] = 0.9 * turn
        spread = 0.5 * np.eye(n) + 0.1 * rng.normal(size=(n, n))
        process_cov[k] = spread @ spread.T
    x, measurements = rng.normal(size=n), np.empty((epochs, m))
    for k in range(epochs):
        x = transition[k] @ x + np.linalg.cholesky(process_cov[k]) @ rng.normal(size=n)
        measurements[k] = rows[k] @ x + rng.normal(size=m)
    return Problem(
        times=np.arange(1.0, epochs + 1.0),
        measurements=measurements,
        noise_cov=np.eye(m),
        transition=transition,
        process_cov=process_cov,
        prior_mean=np.zeros(n),
        prior_cov=np.eye(n),
        model=LinearModel(rows),
        layout=(StateBlock("position", slice(0, n), "m"),),
    )


def changed(problem: Problem, **changes: object) -> Problem:
    """The problem with other values of some attributes."""
    return dataclasses.replace(problem, **changes)


def graded(problem: Problem) -> Problem:
    """The problem with noise that is told for each epoch, up to three times as large or small."""
    factors = 9.0 ** np.sin(np.arange(1.0, problem.epochs + 1.0))
    return changed(problem, noise_cov=problem.noise_cov * factors[:, None, None])


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


def propagated(problem: Problem) -> tuple[np.ndarray, np.ndarray]:
    """Mean and covariance of every epoch without any measurement, from the start in one product."""
    means, covs = [], []
    phi = np.eye(problem.dimension)
    noise = np.zeros_like(problem.prior_cov)
    for k in range(problem.epochs):
        phi = problem.transition[k] @ phi
        noise = problem.transition[k] @ noise @ problem.transition[k].T + problem.process_cov[k]
        means.append(phi @ problem.prior_mean)
        covs.append(phi @ problem.prior_cov @ phi.T + noise)
    return np.array(means), np.array(covs)


def kalman(problem: Problem) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Kalman filter with Joseph's update: filtered and predicted means and covariances."""
    x, p = problem.prior_mean, problem.prior_cov
    eye = np.eye(problem.dimension)
    out: tuple[list, ...] = ([], [], [], [])
    for k in range(problem.epochs):
        phi = problem.transition[k]
        x, p = phi @ x, phi @ p @ phi.T + problem.process_cov[k]
        out[2].append(x)
        out[3].append(p)
        h = problem.model.jacobian(k, x)
        s = h @ p @ h.T + problem.noise_of(k)
        gain = np.linalg.solve(s, h @ p).T
        x = x + gain @ (problem.measurements[k] - problem.model.predict(k, x))
        keep = eye - gain @ h
        p = keep @ p @ keep.T + gain @ problem.noise_of(k) @ gain.T
        out[0].append(x)
        out[1].append(p)
    return tuple(np.array(item) for item in out)


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


def smoothed(problem: Problem, ahead: int) -> tuple[np.ndarray, np.ndarray]:
    """Each epoch given the measurements up to ``ahead`` epochs later: Rauch, Tung & Striebel."""
    x_f, p_f, x_p, p_p = kalman(problem)
    # The inverse in units of the prior: kilometres beside microradians would spoil it.
    units = np.sqrt(np.diag(problem.prior_cov))
    right = problem.transition[1:] @ p_f[:-1] / units[:, None]
    gains = np.linalg.solve(p_p[1:] / np.outer(units, units), right) / units[:, None]
    means, covs = x_f.copy(), p_f.copy()
    end = problem.epochs - 1
    for last in range(min(ahead, end), end + 1):
        # Back from the end of a window to its start; from the last end, to all windows it ends.
        x, p = x_f[last], p_f[last]
        for j in range(last - 1, max(last - ahead, 0) - 1, -1):
            gain = gains[j].T
            x = x_f[j] + gain @ (x - x_p[j + 1])
            p = p_f[j] + gain @ (p - p_p[j + 1]) @ gain.T
            if last == end or j == last - ahead:
                means[j], covs[j] = x, p
    return means, covs


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


def exact(problem: Problem, estimate: Estimate) -> tuple[np.ndarray, np.ndarray]:
    """The mean and covariance of a linear-Gaussian problem that an estimate's causality asks."""
    if estimate.causality == "none":
        return propagated(problem)
    if estimate.causality == "fixed-lag":
        period = problem.times[-1] - problem.times[-2] if problem.epochs > 1 else 1.0
        return smoothed(problem, int(np.floor(estimate.lag / period + 1e-9)))
    return smoothed(problem, problem.epochs if estimate.causality == "batch" else 0)


def deviation(
    mean: np.ndarray, cov: np.ndarray, true_mean: np.ndarray, true_cov: np.ndarray
) -> tuple[float, float]:
    """Largest differences of mean and covariance in units of the posterior deviations."""
    sigma = np.sqrt(np.diagonal(true_cov, axis1=1, axis2=2))
    return (
        float(np.max(np.abs(mean - true_mean) / sigma)),
        float(np.max(np.abs(cov - true_cov) / (sigma[:, :, None] * sigma[:, None, :]))),
    )


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
