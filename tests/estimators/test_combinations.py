"""Whatever is on board: every estimator on several combinations of sensors, without new code."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from oracles import reference
from problems import (
    LinearModel,
    changed,
    deviation,
    each_label,
    estimator,
    exact,
    linear_problem,
    rng,
)
from small_cases import GRAVIMETER, ON_BOARD, SEVERAL, rough_map, small_flight
from thinning import thinned

from ggbench.problem import Problem
from ggbench.simulation.runs import Truth, simulate

OUTAGE = {"truth.gnss.dropouts_s": [[5.0, 12.0]], "gnss.period_s": 1.0}
COMBINATIONS: dict[str, dict[str, Any]] = {
    "barometer": {"barometer.period_s": 1.0, "barometer.noise_m": 3.0},
    "receiver with an outage, log, barometer": ON_BOARD | OUTAGE,
    "several receivers, logs and barometers": ON_BOARD
    | SEVERAL
    | {"truth.sensor.stern.dropouts_s": [[5.0, 12.0]]},
    "a scalar and a vector gravimeter, two logs": GRAVIMETER
    | {
        "sensor.vector.kind": "gravimeter",
        "sensor.vector.period_s": 1.0,
        "sensor.vector.noise_mgal": 2.0,
        "sensor.vector.bias_mgal": 0.3,
        "sensor.vector.components": ["east", "north"],
        "sensor.bottom_track.kind": "velocity_log",
        "sensor.bottom_track.period_s": 2.0,
        "sensor.bottom_track.noise_mps": 0.1,
        **{key: value for key, value in SEVERAL.items() if "water_track" in key},
    },
    "gradiometer, gravimeter, receiver with an outage": {
        "gradiometer.components": ["xx", "xy", "zz"],
        "gravimeter.period_s": 2.0,
        "gravimeter.noise_mgal": 1.0,
        "gnss.position_noise_m": 5.0,
        **OUTAGE,
    },
    "gravity as states, with a vector gravimeter": ON_BOARD
    | GRAVIMETER
    | {
        "gravimeter.components": ["scalar", "east"],
        "model.disturbance.horizontal_mgal": 30.0,
        "model.disturbance.distance_km": 3.0,
        "model.field.compensate": True,
    },
    "gradients that the INS integrates, with a gravimeter": GRAVIMETER
    | {
        "gradiometer.instrument": "local-level",
        "model.disturbance.horizontal_mgal": 30.0,
        "model.disturbance.integrate_gradients": True,
    },
    "all": ON_BOARD
    | GRAVIMETER
    | {"gradiometer.bias_eotvos": 0.5, "gradiometer.instrument": "strapdown"},
}
LINEAR = list(COMBINATIONS)[:3]


@functools.cache
def the_map(folder: Path) -> str:
    return rough_map(folder / "rough.nc")


@functools.cache
def of_combination(name: str, folder: Path) -> tuple[Problem, Truth]:
    changes = dict(COMBINATIONS[name])
    if name in LINEAR:
        changes["gradiometer"] = None
    else:
        felt = "model.disturbance.horizontal_mgal" in changes
        changes["field"] = {"source": the_map(folder), "gravity_disturbance": felt}
    return simulate(small_flight(changes), 1, 0)


@pytest.fixture(scope="session")
def folder(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("map")


def linearised(problem: Problem, truth: Truth) -> Problem:
    """The problem with h as a straight line about the truth."""
    epochs = range(problem.epochs)
    rows = np.stack([problem.model.jacobian(k, truth.error_state[k]) for k in epochs])
    at_truth = np.stack([problem.model.predict(k, truth.error_state[k]) for k in epochs])
    target = problem.measurements - at_truth + np.einsum("kmn,kn->km", rows, truth.error_state)
    return changed(problem, measurements=target, model=LinearModel(rows))


def each_label_and_combination() -> Iterator[Any]:
    """Every estimator with every combination: three are quick, one of a mode or a cloud."""
    for parameter in each_label():
        label, marks = (
            getattr(parameter, "values", (parameter,))[0],
            getattr(parameter, "marks", ()),
        )
        for name in COMBINATIONS:
            others = "[" not in label and name.startswith(("gravity as states", "all"))
            quick = "particle" not in label and (name.startswith("several receivers") or others)
            more = () if quick else (pytest.mark.long,)
            yield pytest.param(label, name, marks=(*marks, *more))


@pytest.mark.parametrize(("label", "combination"), list(each_label_and_combination()))
def test_every_estimator_takes_any_combination(label, combination, folder):
    """The answer is that of the linear problem: to 1e-6 of its deviations where h is linear.

    And to a third of them where a map bends it: readings of several sensors at several rates,
    channels that are not there, biases of several units. What is not exact on a linear problem
    gives a finite answer with a covariance here, and is asked for more where it is at home.
    """
    problem, truth = of_combination(combination, folder)
    solver = estimator(label)
    if vars(solver).get("loss", "none") != "none":
        solver = dataclasses.replace(solver, threshold=np.inf)
    if reason := solver.skip(problem):
        pytest.skip(reason)
    estimate = solver.estimate(problem, rng())
    if not solver.exact_if_linear_gaussian:
        assert np.isfinite(estimate.mean).all()
        sigma = np.sqrt(np.diagonal(estimate.cov, axis1=1, axis2=2))
        assert np.linalg.eigvalsh(estimate.cov / sigma[:, :, None] / sigma[:, None]).min() > 0.0
        return
    linear = combination in LINEAR and solver.name != "closed-loop"  # it bends the track
    tolerance = 1e-6 if linear else 0.33
    apart = deviation(estimate.mean, estimate.cov, *exact(linearised(problem, truth), estimate))
    assert max(apart) < tolerance


@thinned("combination", COMBINATIONS, every=4)
@pytest.mark.parametrize(
    "label",
    [
        "ekf",
        pytest.param("ekf[noise_memory=9]", marks=pytest.mark.long),
        "ukf",
        "ukf[points=merwe]",
        "ukf[points=cubature]",
        "factor-graph[mode=batch]",
    ],
)
def test_oracles_agree_on_any_combination(label, combination, folder):
    """The compiled engine has the framework's mean and covariance, to 1e-5 of σ, and repairs."""
    problem, _ = of_combination(combination, folder)
    expected = reference(label).estimate(problem)
    compiled = estimator(label).estimate(problem, rng())
    apart = deviation(compiled.mean, compiled.cov, expected.mean, expected.cov)
    assert max(apart) < 1e-5
    assert compiled.info.get("covariance_repairs") == expected.info.get("covariance_repairs")


@pytest.mark.parametrize("combination", COMBINATIONS)
def test_what_monte_carlo_estimators_need_is_there(combination, folder):
    """The noise's root makes Q; the likelihood is that of the channels that are there, of any x."""
    problem, truth = of_combination(combination, folder)
    for k in (0, problem.epochs // 2):
        root = problem.noise_root(k)
        sigma = np.sqrt(np.diag(problem.process_cov[k]))
        unit = np.outer(np.where(sigma > 0.0, sigma, 1.0), np.where(sigma > 0.0, sigma, 1.0))
        assert root.shape[0] == problem.dimension
        assert root.shape[1] <= np.count_nonzero(sigma)
        assert np.abs((root @ root.T - problem.process_cov[k]) / unit).max() < 1e-12
        x = truth.error_state[k] + np.sqrt(np.diag(problem.prior_cov)) * rng().standard_normal(
            (2, 3, problem.dimension)
        )
        found = problem.log_likelihood(k, x)
        there = problem.present[k]
        assert found.shape == (2, 3)
        residual = (problem.measurements[k] - problem.model.predict(k, x[1, 2]))[there]
        cov = problem.noise_of(k)[np.ix_(there, there)]
        by_hand = -0.5 * residual @ np.linalg.solve(cov, residual)
        by_hand -= 0.5 * np.linalg.slogdet(2.0 * np.pi * cov).logabsdet
        assert found[1, 2] == pytest.approx(by_hand, rel=1e-9)


@pytest.mark.parametrize(("apart", "rank"), [(1e-6, 2), (0.0, 1)])
def test_the_root_has_the_rank_of_the_noise(apart, rank):
    """Two states whose noise differs by a millionth have two numbers; the same noise has one."""
    problem = linear_problem(1)
    noise = np.zeros_like(problem.process_cov)
    noise[:, :2, :2] = np.array([[1.0, 2.0], [2.0, 4.0]]) + np.diag([0.0, 4.0 * apart])
    root = changed(problem, process_cov=noise).noise_root(0)
    assert root.shape == (problem.dimension, rank)
    np.testing.assert_allclose(root @ root.T, noise[0], atol=1e-12)


@pytest.mark.parametrize(
    "label",
    [
        "ekf",
        "ukf",
        "factor-graph[mode=batch]",
        pytest.param("gauss-newton", marks=pytest.mark.long),
    ],
)
def test_noise_may_differ_from_epoch_to_epoch(label, folder):
    """A problem whose R is told for each epoch: a reading of great noise is as good as none."""
    problem, _ = of_combination(LINEAR[1], folder)
    noise = np.tile(problem.noise_cov, (problem.epochs, 1, 1))
    noise[20:] *= 1e12
    found = estimator(label).estimate(changed(problem, noise_cov=noise), rng())
    there = problem.present & (np.arange(problem.epochs) < 20)[:, None]
    gone = changed(
        problem,
        measurements=np.where(there, problem.measurements, 0.0),
        present=there,
        model=Until(problem.model, 20),
    )
    expected = reference(label).estimate(gone)
    assert max(deviation(found.mean, found.cov, expected.mean, expected.cov)) < 1e-4
    if label != "gauss-newton":
        oracle = reference(label).estimate(changed(problem, noise_cov=noise))
        assert max(deviation(found.mean, found.cov, oracle.mean, oracle.cov)) < 1e-6


@dataclasses.dataclass(frozen=True)
class Until:
    """A model that knows no channel from some epoch on."""

    model: Any
    end: int

    def predict(self, k: int, x: np.ndarray) -> np.ndarray:
        return self.model.predict(k, x) * (k < self.end)

    def jacobian(self, k: int, x: np.ndarray) -> np.ndarray:
        return self.model.jacobian(k, x) * (k < self.end)
