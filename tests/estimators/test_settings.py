"""Settings: what means nothing is refused, what is given is kept to, what it took is told."""

from __future__ import annotations

import re

import numpy as np
import pytest
from oracles import reference
from problems import LinearModel, changed, estimator, linear_problem, rng
from refusals import refused
from rough_field import rough_flight
from small_cases import ON_BOARD, small_flight
from thinning import thinned

from ggbench.campaign.registry import EstimatorError
from ggbench.problem import Channel, Problem, StateBlock
from ggbench.simulation.runs import simulate

BAD = {
    "ekf[iterations=0]": "iterations",
    "ekf[noise_memory=-1]": "noise_memory",
    "ekf[noise_memory=1]": "noise_memory",
    "ekf[threshold=2]": "needs a loss",
    "ekf[loss=huber,threshold=0]": "'threshold' is",
    "ukf[loss=huber,threshold=-1]": "'threshold' is",
    "ukf[points=cubature,kappa=1]": "no kappa",
    "factor-graph[loss=cauchy,threshold=nan]": "'threshold' is",
    "ukf[points=merwe,alpha=0]": "'alpha' is",
    "ukf[points=merwe,alpha=inf]": "'alpha' is",
    "gauss-newton[starts=0]": "starts",
    "gauss-newton[starts=1000000000]": "starts",
    "gauss-newton[refine=0]": "refine",
    "gauss-newton[max_iterations=0]": "max_iterations",
    "gauss-newton[threshold=1]": "needs a loss",
    "gaussian-sum[spacing_m=0]": "spacing_m",
    "gaussian-sum[spacing_m=nan]": "spacing_m",
    "gaussian-sum[most=0]": "most",
    "gaussian-sum[most=1000000000]": "most",
    "gaussian-sum[iterations=0]": "iterations",
    "gaussian-sum[iterations=1,loss=huber]": "at least 2 iterations",
    "ekf[gate=1]": "'gate' is",
    "ekf[gate=-0.1]": "'gate' is",
    "ekf[gate=nan]": "'gate' is",
    "ukf[gate=2]": "'gate' is",
    "ekf[underweighting=-0.1]": "'underweighting' is",
    "ekf[underweighting=inf]": "'underweighting' is",
    "ukf[underweighting=nan]": "'underweighting' is",
    "ekf[gate=0.9,loss=huber]": "gate and loss cannot be combined",
    "ekf[gate=0.9,iterations=2]": "gate needs iterations = 1",
    "ekf[underweighting=0.1,iterations=2]": "underweighting needs iterations = 1",
    "ekf[underweighting=0.1,noise_memory=9]": "cannot be combined with noise_memory",
    "ukf[gate=0.9,loss=huber]": "gate and loss cannot be combined",
    "ukf[underweighting=0.1,loss=cauchy]": "underweighting and loss cannot be combined",
    "gaussian-sum[threshold=2]": "needs a loss",
    "ukf[threshold=2]": "needs a loss",
    "factor-graph[mode=batch,threshold=2]": "needs a loss",
    "factor-graph[mode=fixed-lag,lag=0]": "lag",
    "factor-graph[mode=fixed-lag,lag=-1]": "lag",
    "factor-graph[mode=fixed-lag,lag=nan]": "lag",
    "factor-graph[mode=fixed-lag,lag=inf]": "lag",
    "factor-graph[mode=fixed-lag,relinearize_threshold=0]": "relinearize_threshold",
    "factor-graph[mode=fixed-lag,relinearize_threshold=nan]": "relinearize_threshold",
    "factor-graph[mode=fixed-lag,relinearize_threshold=inf]": "relinearize_threshold",
    "factor-graph[mode=fixed-lag,max_iterations=0]": "max_iterations",
}
"""Labels of estimators with settings that mean nothing, and what their messages name."""


@pytest.mark.parametrize("label", BAD)
def test_settings_that_mean_nothing_are_refused_with_a_reason(label):
    """Before anything runs, and not as a failure in every run."""
    with refused(EstimatorError, re.escape(BAD[label])):
        estimator(label)


def test_a_lag_has_to_reach_over_the_longest_gap():
    """Readings a second apart but for once, when it is four: a window of three loses its past."""
    times = np.array([1.0, 2.0, 6.0, 7.0, 8.0])
    problem = changed(linear_problem(0, epochs=5), times=times)
    for lag, reason in ((3.0, "two measurements, 4 s"), (4.0, None)):
        found = estimator(f"gtsam[mode=fixed-lag,lag={lag}]").skip(problem)
        assert reason in found if reason else found is None


@thinned(
    ("label", "searches"),
    [
        ("gtsam[mode=batch,max_iterations=2]", 1),
        ("gauss-newton[max_iterations=2,window=0]", 6),
        ("gauss-newton[max_iterations=2,refine=2]", 4),
        ("gauss-newton[max_iterations=2,starts=1]", 2),
    ],
    every=2,
)
def test_a_search_ends_at_its_limit(label, searches):
    """Two steps of each search, and no more, where it would take many."""
    problem, _ = rough_flight(1, 1000.0, epochs=60)
    solver = estimator(label) if label.startswith("gtsam") else reference(label)
    info = solver.estimate(problem, rng()).info
    assert info["iterations"] == 2 * searches
    assert info.get("refined", 1) == searches


def test_a_gauss_newton_tells_whether_it_has_converged():
    """Not where it was stopped at its first step, but where it has gone to the end."""
    problem, _ = rough_flight(1, 50.0, epochs=30)
    for most, converged in ((1, False), (30, True)):
        found = reference("gauss-newton", starts=1, max_iterations=most).estimate(problem)
        assert found.info["converged"] == converged


def test_an_iterated_filter_stops_where_nothing_is_left_to_gain():
    """Of a linear h, a second linearisation shows that the first was enough: two per reading."""
    flight = small_flight(ON_BOARD | {"gradiometer": None})
    problem, _ = simulate(flight, 4, 0)
    for iterations, each in ((1, 1), (2, 2), (9, 2)):
        found = estimator(f"ekf[iterations={iterations}]").estimate(problem, rng())
        assert found.info["linearisations"] == each * problem.epochs


def test_an_incremental_graph_is_linearised_anew_as_its_threshold_says():
    """The further a node may move before, the fewer are; states that are not read move freely."""
    problem, _ = rough_flight(1, 50.0, epochs=30)
    often, usual, seldom = (
        estimator(f"gtsam[relinearize_threshold={threshold}]")
        .estimate(problem, rng())
        .info["relinearized"]
        for threshold in (0.01, 1.0, 100.0)
    )
    assert often > usual > seldom
    assert often > 10 * problem.epochs  # over the flight, nodes many times
    # What only other sensors notice asks for nothing: they are as good as linear.
    heights = tuple(Channel(f"{i}", "m", "any") for i in range(problem.measurements.shape[1]))
    free = estimator("gtsam[relinearize_threshold=0.01]")
    told = free.estimate(changed(problem, channels=heights), rng()).info["relinearized"]
    assert told <= seldom


def test_a_mixture_tells_how_many_hypotheses_it_started_with_and_had_on_average():
    """All of them while readings say nothing, and one after a reading that says where it is."""
    rows = np.array([0.0, 0.0, 0.0, 1.0])[:, None, None]
    problem = Problem(
        times=np.arange(1.0, 5.0),
        measurements=np.zeros((4, 1)),
        noise_cov=np.eye(1),
        transition=np.ones((4, 1, 1)),
        process_cov=np.zeros((4, 1, 1)),
        prior_mean=np.zeros(1),
        prior_cov=np.array([[1e6]]),
        model=LinearModel(rows),
        layout=(StateBlock("position", slice(0, 1), "m"),),
    )
    info = reference("gaussian-sum", spacing_m=300.0).estimate(problem).info
    assert info["hypotheses"] == 31  # at 0, ±300, ... ±4500 m, within 4.5 deviations
    assert info["mean_hypotheses"] == pytest.approx((3 * 31 + 1) / 4)
