"""Settings: what means nothing is refused, what is given is kept to, what it took is told."""

from __future__ import annotations

import pytest
from problems import estimator, linear_problem, rng, simulated
from rough_field import rough_flight


@pytest.mark.parametrize(
    ("label", "reason"),
    [
        ("ekf[iterations=0]", "iterations"),
        ("ekf[noise_memory=-1]", "noise_memory"),
        ("ekf[noise_memory=1]", "noise_memory"),
        ("ekf[threshold=2]", "needs a loss"),
        ("ekf[loss=huber,threshold=0]", "threshold must be positive"),
        ("ukf[loss=huber,threshold=-1]", "threshold must be positive"),
        ("ukf[points=cubature,kappa=1]", "no kappa"),
        ("factor-graph[loss=cauchy,threshold=nan]", "threshold must be positive"),
        ("gauss-newton[starts=0]", "starts"),
        ("gauss-newton[starts=1000000000]", "starts"),
        ("gauss-newton[refine=0]", "refine"),
        ("gauss-newton[max_iterations=0]", "max_iterations"),
        ("gauss-newton[threshold=1]", "needs a loss"),
        ("gaussian-sum[spacing_m=0]", "spacing_m"),
        ("gaussian-sum[spacing_m=nan]", "spacing_m"),
        ("gaussian-sum[most=0]", "most"),
        ("gaussian-sum[most=1000000000]", "most"),
        ("gaussian-sum[iterations=0]", "iterations"),
        ("gaussian-sum[iterations=1,loss=huber]", "at least 2 iterations"),
        ("ekf[engine=numba,iterations=2]", "plain filter"),
        ("ekf[engine=numba,noise_memory=9]", "plain filter"),
        ("ekf[engine=numba,loss=huber]", "plain filter"),
        ("ukf[engine=numba,loss=huber]", "no loss"),
        ("ukf[engine=numba,threshold=2]", "needs a loss"),
        ("factor-graph[engine=numba]", "mode=batch"),
        ("factor-graph[mode=batch,engine=numba,loss=huber]", "without a loss"),
        ("factor-graph[mode=batch,engine=numba,threshold=2]", "needs a loss"),
    ],
)
def test_settings_that_mean_nothing_are_refused_with_a_reason(label, reason):
    """A setting that cannot work is a reason to skip, not a failure or a wrong number."""
    assert reason in (estimator(label).skip(simulated("0.01E-0.2Hz")[0]) or "")


@pytest.mark.parametrize(
    ("setting", "reason"),
    [
        ("lag=0", "lag"),
        ("lag=-1", "lag"),
        ("lag=nan", "lag"),
        ("lag=inf", "lag"),
        ("lag=4.9", "at least the time between two readings, 5 s"),
        ("relinearize_threshold=0", "relinearize_threshold"),
        ("relinearize_threshold=nan", "relinearize_threshold"),
        ("max_iterations=0", "max_iterations"),
    ],
)
def test_graph_settings_that_mean_nothing_are_refused_with_a_reason(setting, reason):
    """A setting that leaves nothing to do is a reason to skip, not a failure in every run."""
    label = f"factor-graph[mode=fixed-lag,{setting}]"
    assert reason in (estimator(label).skip(simulated("0.01E-0.2Hz")[0]) or "")


@pytest.mark.parametrize(
    ("label", "searches"),
    [("factor-graph[mode=batch,max_iterations=2]", 1), ("gauss-newton[max_iterations=2]", 6)],
)
def test_a_search_ends_at_its_limit(label, searches):
    """Two steps of each search, and no more, where it would take many."""
    problem, _ = rough_flight(1, 1000.0, epochs=60)
    assert estimator(label).estimate(problem, rng()).info["iterations"] == 2 * searches


def test_a_gauss_newton_tells_whether_it_has_converged():
    """Not where it was stopped at its first step, but where it has gone to the end."""
    problem, _ = rough_flight(1, 50.0, epochs=30)
    for most, converged in ((1, False), (30, True)):
        found = estimator(f"gauss-newton[starts=1,max_iterations={most}]").estimate(problem, rng())
        assert found.info["converged"] == converged


def test_an_iterated_filter_stops_where_nothing_is_left_to_gain():
    """Of a linear h, a second linearisation shows that the first was enough: two per reading."""
    problem = linear_problem(0)
    for iterations, each in ((1, 1), (2, 2), (9, 2)):
        found = estimator(f"ekf[iterations={iterations}]").estimate(problem, rng())
        assert found.info["linearisations"] == each * problem.epochs


def test_an_incremental_graph_is_linearised_anew_as_its_threshold_says():
    """The further a node may move before, the fewer are."""
    problem, _ = rough_flight(1, 50.0, epochs=30)
    often, usual, seldom = (
        estimator(f"factor-graph[relinearize_threshold={threshold}]")
        .estimate(problem, rng())
        .info["relinearized"]
        for threshold in (0.1, 1.0, 10.0)
    )
    assert often > usual > seldom
