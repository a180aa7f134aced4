"""Changes of a problem that must leave an estimate as it is: order, units and number of channels.

The problems are a flight over hills, 40 readings of six channels; none of these relations needs an
exact answer. Tolerances are in standard deviations of the prior.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from problems import block_of_runs, changed, estimator, rng

from ggbench.problem import Problem
from ggbench.sensors.model import SensorModel

EXACT = [
    "ekf",
    "ukf",
    *(
        pytest.param(label, marks=pytest.mark.long)
        for label in (
            "ekf[iterations=3]",
            "ukf[points=cubature]",
            "factor-graph[mode=batch]",
            "factor-graph[mode=fixed-lag]",
            "gauss-newton",
            "gaussian-sum",
        )
    ),
]
SEARCHES = ("iterations", "factor-graph", "gauss-newton", "gaussian-sum")
"""Estimators that stop where a step lowers the cost by less than 1e-6: rounding decides on the last
step, which is worth up to a thousandth of a deviation of the posterior."""
SEARCHED = 1e-4
"""Their tolerance, in deviations of the prior, which are twice those of the posterior and more."""
ROBUST = pytest.param("ekf[loss=huber]", marks=pytest.mark.long)
"""A loss judges single components, so it does not take two halves of one for the whole."""
RELATION = settings(max_examples=4, derandomize=True, deadline=None, database=None)
CHANNELS = 6


def flown() -> Problem:
    return block_of_runs("wang2013", "0.01E-0.2Hz", 0, 1).problem(0)


def assert_same(label: str, one: Problem, other: Problem, tolerance: float = 1e-7) -> None:
    """Demand the same mean and covariance of two problems."""
    solver = estimator(label)
    first, second = (solver.estimate(problem, rng()) for problem in (one, other))
    sigma = np.sqrt(np.diag(one.prior_cov))
    if any(name in label for name in SEARCHES):
        tolerance = SEARCHED
    assert np.abs((first.mean - second.mean) / sigma).max() < tolerance
    assert np.abs((first.cov - second.cov) / np.outer(sigma, sigma)).max() < tolerance


def mixed(problem: Problem, mixing: np.ndarray, noise_cov: np.ndarray | None = None) -> Problem:
    """The problem whose channels are a linear combination (m', m) of the given ones."""
    arrays = problem.model.arrays
    assert arrays.first_linear == problem.measurements.shape[1]  # of the gradiometer alone
    if noise_cov is None:
        noise_cov = mixing @ problem.noise_cov @ mixing.T
    return changed(
        problem,
        measurements=problem.measurements @ mixing.T,
        noise_cov=noise_cov,
        present=problem.present @ (mixing.T != 0.0),
        channels=(),
        model=SensorModel(
            dataclasses.replace(
                arrays,
                channels=mixing @ arrays.channels,
                combined=mixing @ arrays.combined,
                offset=arrays.offset @ mixing.T,
                linear=mixing @ arrays.linear,
                first_linear=len(mixing),
                weights=mixing @ arrays.weights,
            )
        ),
    )


@pytest.mark.parametrize("label", [*EXACT, ROBUST])
@RELATION
@given(order=st.permutations(range(CHANNELS)))
def test_the_order_of_channels_does_not_matter(label, order):
    assert_same(label, flown(), mixed(flown(), np.eye(CHANNELS)[order]))


@pytest.mark.parametrize("label", [*EXACT, ROBUST])
@RELATION
@given(channel=st.integers(0, CHANNELS - 1), exponent=st.floats(-4.0, 4.0))
def test_the_unit_of_a_channel_does_not_matter(label, channel, exponent):
    units = np.eye(CHANNELS)
    units[channel, channel] = 10.0**exponent
    assert_same(label, flown(), mixed(flown(), units))


@pytest.mark.parametrize("label", EXACT)
@RELATION
@given(split=st.sets(st.integers(0, CHANNELS - 1), min_size=1))
def test_a_measurement_is_worth_two_of_twice_its_noise(label, split):
    """Both have the same value, so nothing but the sum of their informations can count."""
    twice = sorted(split)
    mixing = np.vstack([np.eye(CHANNELS), np.eye(CHANNELS)[twice]])
    noise = np.diag(mixing @ np.diag(flown().noise_cov))
    for copy, channel in enumerate(twice, start=CHANNELS):
        noise[channel, channel] *= 2.0
        noise[copy, copy] *= 2.0
    assert_same(label, flown(), mixed(flown(), mixing, noise))


@pytest.mark.parametrize("label", EXACT)
@RELATION
@given(value=st.floats(-100.0, 100.0), exponent=st.floats(16.0, 24.0))
def test_a_channel_of_enormous_noise_changes_nothing(label, value, exponent):
    mixing = np.vstack([np.eye(CHANNELS), np.ones(CHANNELS)])
    noise = np.diag([*np.diag(flown().noise_cov), 10.0**exponent])
    problem = mixed(flown(), mixing, noise)
    measurements = problem.measurements.copy()
    measurements[:, -1] += value
    assert_same(label, flown(), changed(problem, measurements=measurements))


@pytest.mark.parametrize("label", [*EXACT, ROBUST])
@pytest.mark.parametrize("turns", [-1, 1])
def test_a_turn_of_longitude_changes_nothing(label, turns):
    """Of the map and of the flight: 360 degrees more or less are the same meridian.

    To 1e-6: a longitude of 8 rad is rounded to 6 nm.
    """
    problem = flown()
    turn = np.array([0.0, 2.0 * math.pi * turns, 0.0])
    arrays = problem.model.arrays
    moved = dataclasses.replace(
        arrays,
        references=arrays.references + turn,
        origin=arrays.origin + turn,
        places=arrays.places + turn,
        gravity=dataclasses.replace(arrays.gravity, origin=arrays.gravity.origin + turn),
    )
    track, chart = problem.track, problem.map
    problem = changed(
        problem,
        model=SensorModel(moved),
        track=dataclasses.replace(track, positions=track.positions + turn),
        map=dataclasses.replace(chart, origin=chart.origin + turn),
    )
    assert_same(label, flown(), problem, 1e-6)


def test_the_relations_see_what_breaks_them():
    """Controls: another unit without its noise, a copy of ordinary noise, another order of z."""
    problem, eye = flown(), np.eye(CHANNELS)
    noise = np.diag(np.append(np.diag(problem.noise_cov), problem.noise_cov[0, 0]))
    with pytest.raises(AssertionError):
        assert_same("ekf", problem, mixed(problem, 1.001 * eye, problem.noise_cov))
    with pytest.raises(AssertionError):
        assert_same("ekf", problem, mixed(problem, np.vstack([eye, eye[:1]]), noise))
    part = changed(problem, measurements=problem.measurements[:, ::-1].copy())
    with pytest.raises(AssertionError):
        assert_same("ekf", problem, part)
