"""Gravity that the INS does not know: what the truth has of it, and what estimators are told."""

from __future__ import annotations

import numpy as np
import pytest
from small_cases import CONSTANT, GRAVIMETER, INTEGRATED, ON_BOARD, QUIET, STATES, small_flight

from ggbench.simulation.flight_bounds import flight_bound
from ggbench.simulation.runs import simulate, simulate_block


def test_what_the_ins_does_not_know_is_its_error():
    """A constant disturbance pulls the INS the other way, by half its square of the time.

    Over 20 s, to a percent; and that is the response that a report shows.
    """
    flight = small_flight(QUIET | CONSTANT)
    started = ("position_m", "velocity_mps", "attitude_arcmin")
    quiet = {f"initial_error.{key}": 1e-6 for key in started}
    _, truth = simulate(small_flight(QUIET | CONSTANT | quiet), 1, 0)
    expected = -0.5 * np.array([1e-4, 2e-4, 3e-4]) * flight.times[-1] ** 2
    np.testing.assert_allclose(flight.gravity_response[-1, :3], expected, rtol=0.01)
    np.testing.assert_allclose(
        truth.error_state[-1, :3], flight.gravity_response[-1, :3], rtol=0.01
    )


def test_the_truth_of_the_states_is_what_is_felt_and_not_added(rough_gravity):
    """Of the map and a constant; less the estimators' map at the same place if that is added."""
    extra = {"truth.field.constant_disturbance_mgal": [10.0, 0.0, 0.0]}
    for compensate in (False, True):
        changes = rough_gravity | STATES | extra | {"model.field.compensate": compensate}
        flight = small_flight(changes)
        problem, truth = simulate(flight, 1, 0)
        block = next(b for b in problem.layout if b.name == "gravity disturbance ENU")
        assert (block.slice, block.unit) == (slice(15, 18), "m/s²")
        places = flight.motion_at_epochs.positions.T
        expected = flight.field.gravity_disturbance(*places)
        if compensate:
            expected = np.tile([1e-4, 0.0, 0.0], (len(flight.times), 1))
        np.testing.assert_allclose(truth.error_state[:, 15:18], expected, atol=1e-12)
        assert np.ptp(flight.field.gravity_disturbance(*places), axis=0).max() > 1e-5
    sigma = np.sqrt(np.diag(problem.prior_cov))
    np.testing.assert_allclose(sigma[15:18], [4e-4, 4e-4, 2e-4])


@pytest.mark.parametrize(
    "known",
    [{"gradiometer": None}, {"gradiometer": None, "model.field.compensate": True}, INTEGRATED],
    ids=["nothing", "map", "gradients"],
)
def test_a_gravimeter_reads_the_states(rough_gravity, known):
    """Its residual at the truth is its noise, within 4 deviations of the mean of 30 runs.

    What the INS adds of a map is read from it at the place, what it has integrated is known, and
    what it does not know is the state.
    """
    vector = {"gravimeter.components": ["east", "north", "scalar"], "gravimeter.bias_mgal": 0.0}
    changes = rough_gravity | STATES | GRAVIMETER | vector | {"initial_error.attitude_arcmin": 0.1}
    flight = small_flight(changes | known)
    block, truth = simulate_block(flight, 3, range(30))
    squares = []
    for run in range(30):
        problem = block.problem(run)
        for k in np.flatnonzero(problem.present[:, -1]):
            predicted = problem.model.predict(k, truth.error_state[run, k])
            squares.append((problem.measurements[k] - predicted)[-3:] ** 2)
    mean = np.mean(squares, axis=0)
    assert (np.abs(mean - 1.0) < 4.0 * np.sqrt(2.0 / len(squares))).all()
    first = int(problem.present[:, -1].argmax())
    jacobian = problem.model.jacobian(first, truth.error_state[run, first])[-3:]
    np.testing.assert_allclose(jacobian[:, 15:18], 1e5 * np.diag([1.0, 1.0, -1.0]))
    moves = np.abs(jacobian[:, :3] * 100.0).max()  # mGal for a hundred metres
    assert (moves > 0.01) == ("model.field.compensate" in known) or moves > 0.02


def test_the_bound_knows_the_states():
    """With them it is wider, as the disturbance is not known, whose σ falls from the prior's."""
    alone = {"gradiometer": None} | ON_BOARD
    plain, states = (flight_bound(small_flight(alone | CONSTANT | more)) for more in ({}, STATES))
    assert states.filtering.shape[1] == plain.filtering.shape[1] + 3
    sigma = np.sqrt(np.diagonal(states.filtering, axis1=1, axis2=2))
    assert (sigma[-1, 15:18] < [4e-4, 4e-4, 2e-4]).all()
    wider = sigma[-1, 3:6] / np.sqrt(np.diag(plain.filtering[-1]))[3:6]
    assert (wider > 1.0).all()
