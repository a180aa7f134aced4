"""A scale of the noise: the readings of the map are believed less, or more, and nothing else."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from problems import changed, estimator, graded, linear_problem, rng
from small_cases import GRAVIMETER, ON_BOARD, rough_map, small_flight

from ggbench import estimation
from ggbench.block import ProblemBlock
from ggbench.engines.innovations import innovations_squared
from ggbench.judging.run_errors import evaluate
from ggbench.problem import Channel, Problem
from ggbench.simulation.error_free_flight import Flight
from ggbench.simulation.runs import simulate, simulate_block

LABELS = (
    "ekf",
    "ekf[iterations=3,loss=huber]",
    "ekf[noise_memory=9]",
    "ukf",
    "filterpy-ekf",
    "factor-graph",
    "factor-graph[mode=fixed-lag,lag=3]",
    "factor-graph[mode=batch]",
    "gaussian-sum",
    "gauss-newton[starts=4,refine=1,window=0]",
    "rao-blackwellised[particles=100,start=1]",
    "closed-loop[interval_s=5]",
)
QUICK = ("ekf", "ukf", "filterpy-ekf", "factor-graph[mode=batch]")
"""Of kernels that other tests compile anyway."""
EACH = [name if name in QUICK else pytest.param(name, marks=pytest.mark.long) for name in LABELS]
COMPILED = [
    label
    for name, label in zip(LABELS, EACH, strict=True)
    if not name.startswith(("rao", "closed", "filterpy"))
]
SCALE = 3.0
MATCHED = ("gradiometer", "gravimeter", "keel")
"""Sensors on board that read what a map tells; the names are the case's."""


@pytest.fixture(scope="module")
def everything(tmp_path_factory) -> Flight:
    """A flight with two gravimeters, one of them of another name, and sensors without a map."""
    path = rough_map(tmp_path_factory.mktemp("map") / "rough.nc")
    more = {
        "field": {"source": path, "gravity_disturbance": True},
        "sensor.keel.kind": "gravimeter",
        "sensor.keel.period_s": 2.0,
        "sensor.keel.noise_mgal": 2.0,
        "trajectory.segment": [{"duration_s": 8.0}],
        "windows.settled_from_s": 4.0,
        "windows.last_s": 2.0,
    }
    return small_flight(ON_BOARD | GRAVIMETER | more)


def by_hand(noise_cov: np.ndarray, channels: tuple[Channel, ...]) -> np.ndarray:
    """R with the rows and columns of the matched sensors multiplied, one after the other."""
    scaled = noise_cov.copy()
    for i, channel in enumerate(channels):
        if channel.sensor in MATCHED:
            scaled[..., i, :] *= SCALE
            scaled[..., :, i] *= SCALE
    return scaled


def with_scale(solver):
    return dataclasses.replace(solver, noise_scale=SCALE)


def scaled(problem: Problem | ProblemBlock):
    return dataclasses.replace(problem, noise_cov=by_hand(problem.noise_cov, problem.channels))


@pytest.mark.parametrize("label", EACH)
def test_it_is_the_same_estimator_of_a_problem_whose_noise_is_scaled(label, everything):
    """To the last bit; the NIS that is judged is that of the noise it was told."""
    problem, truth = simulate(everything, 1, 0)
    assert {channel.sensor for channel in problem.channels} > set(MATCHED)
    told = estimation.estimate(with_scale(estimator(label)), problem, rng())
    other = estimator(label).estimate(scaled(problem), rng())
    np.testing.assert_array_equal(told.mean, other.mean)
    np.testing.assert_array_equal(told.cov, other.cov)
    judged, expected = evaluate(problem, told, truth), evaluate(scaled(problem), other, truth)
    np.testing.assert_allclose(judged.nis, expected.nis, rtol=1e-9)
    given = estimator(label).estimate(problem, rng())
    assert not np.array_equal(given.mean, told.mean)


@pytest.mark.parametrize("label", COMPILED)
def test_so_it_is_in_the_compiled_engines(label, everything):
    """The same of a block of two runs."""
    block, _ = simulate_block(everything, 1, range(2))
    told = estimation.estimate_block(with_scale(estimator(label)), block)
    other = estimator(label).estimate_block(scaled(block))
    np.testing.assert_array_equal(told.mean, other.mean)
    np.testing.assert_array_equal(told.cov, other.cov)
    assert not np.array_equal(estimator(label).estimate_block(block).mean, told.mean)
    if told.causality != "filter":
        assert told.nis is None
        return
    for run in range(2):
        problem = scaled(block).problem(run)
        expected = innovations_squared(problem, told.mean[run], told.cov[run])
        np.testing.assert_allclose(told.nis[run], expected, rtol=1e-6)


def test_of_one_the_problem_is_left_as_it_is(everything):
    """The object itself, and no NIS beside that which judging finds."""
    problem, _ = simulate(everything, 1, 0)
    assert estimation.with_scaled_noise(problem, 1.0) is problem
    assert estimation.estimate(estimator("filterpy-ekf"), problem, rng()).nis is None


def test_where_nobody_says_what_the_channels_are_all_are_scaled():
    """Of each epoch, if noise is told for each."""
    problem = graded(linear_problem(0))
    found = estimation.with_scaled_noise(problem, SCALE).noise_cov
    np.testing.assert_allclose(found, SCALE**2 * problem.noise_cov, rtol=1e-12)


def test_of_each_epoch_the_matched_channels_alone_are_scaled():
    """And what correlates a matched channel with another one by as much as the one."""
    channels = (Channel("gradient zz", "E", "gradiometer"), Channel("height", "m", "barometer"))
    problem = changed(graded(linear_problem(0)), channels=channels)
    found = estimation.with_scaled_noise(problem, SCALE).noise_cov
    np.testing.assert_allclose(found, by_hand(problem.noise_cov, channels), rtol=1e-12)
    np.testing.assert_array_equal(found[:, 1, 1], problem.noise_cov[:, 1, 1])


def test_what_it_asks_of_the_map_for_its_nis_is_not_counted(everything):
    """Evaluations are those of the estimator: as many with a scale as without."""
    counts = []
    for solver in (estimator("filterpy-ekf"), with_scale(estimator("filterpy-ekf"))):
        problem, _ = simulate(everything, 1, 0)
        estimation.estimate(solver, problem, rng())
        counts.append(problem.model.evaluations)
    assert counts[0] == counts[1] > 0


@pytest.mark.parametrize("scale", [0.0, -1.0, np.inf, np.nan])
@pytest.mark.parametrize("label", ["ekf", "ins", "particle"])
def test_a_scale_that_means_nothing_is_refused(label, scale):
    """With a sentence, by every estimator."""
    with pytest.raises(ValueError, match=f"{label}: parameter 'noise_scale' is '{scale}'"):
        dataclasses.replace(estimator(label), noise_scale=scale)
