"""The error of the INS alone: that of the transitions which estimators are given."""

from __future__ import annotations

import numpy as np
from problems import SEED
from small_cases import small_flight

from ggbench.simulation.ins_error import ins_error
from ggbench.simulation.runs import simulate


def test_it_is_what_an_estimator_without_measurements_would_claim():
    """Within 1%, as a run's transitions are along its INS: position errors at the last epoch.

    A gradiometer, a receiver or a state of gravity changes nothing of it.
    """
    flight = small_flight({"initial_error.position_m": 50.0})
    problem, _ = simulate(flight, SEED, 0)
    cov = problem.prior_cov
    for transition, process_cov in zip(problem.transition, problem.process_cov, strict=True):
        cov = transition @ cov @ transition.T + process_cov
    found = ins_error(flight.true, flight.trajectory)
    np.testing.assert_allclose(found.deviations[0], 50.0)
    np.testing.assert_allclose(found.deviations[-1], np.sqrt(np.diag(cov)[:3]), rtol=0.01)
    assert found.times[-1] == flight.times[-1]
    aided = small_flight({"initial_error.position_m": 50.0, "gnss.period_s": 1.0,
                          "gnss.position_noise_m": 3.0, "barometer.period_s": 1.0,
                          "barometer.noise_m": 3.0, "barometer.bias_m": 5.0})  # fmt: skip
    again = ins_error(aided.true, aided.trajectory)
    np.testing.assert_array_equal(again.deviations, found.deviations)
