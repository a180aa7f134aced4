"""Zhou et al. 2015: the part of it that can be reproduced is, the other part is shown not to be."""

from __future__ import annotations

import numpy as np
import pytest
from thinning import thinned

from ggbench.campaign.registry import choose
from ggbench.sensors.aiding import Motion
from ggbench.simulation.error_free_flight import Flight, prepare
from ggbench.simulation.flight_bounds import flight_bound
from ggbench.simulation.runs import simulate_block
from ggbench.spec import scenario
from ggbench.spec.case import CaseSpec

LOADED = scenario.load("zhou2015")
MGAL = 1e5
TRUE = np.array([10.0, 20.0, 30.0])


def to_the_north(name: str) -> Flight:
    """The first two hours of a case."""
    case = LOADED.case(name)
    leg = case.trajectory.model_copy(update={"segment": case.trajectory.segment[:1]})
    windows = case.windows.model_copy(update={"settled_from_s": 3600.0})
    cut = CaseSpec.model_copy(case, update={"trajectory": leg, "windows": windows})
    return prepare(cut)


@pytest.fixture(scope="module")
def flight() -> Flight:
    return to_the_north("estimated")


def test_the_response_is_that_of_the_linear_theory(flight):
    """The INS, mechanised without any other error, errs as Φ says, to a percent of the largest.

    Of all nine errors over two hours: Schuler's oscillation and the Earth's.
    """
    truth = flight.trajectory
    motion = Motion(truth.positions, truth.velocities, truth.attitudes)
    transition, _ = flight.model.system(motion, flight.delta_velocities, flight.epochs, truth.dt)
    state = np.zeros(18)
    state[15:] = TRUE / MGAL
    errors = np.empty((len(flight.epochs), 9))
    for k, phi in enumerate(transition):
        state = phi @ state
        errors[k] = state[:9]
    errors[:, 6:] = np.einsum("kji,kj->ki", flight.motion_at_epochs.attitudes, errors[:, 6:])
    largest = np.abs(errors).max(axis=0)
    assert (np.abs(flight.gravity_response - errors).max(axis=0) < 0.01 * largest).all()


@pytest.mark.parametrize(
    ("column", "factor", "at_end", "largest"),
    [
        (3, 1.0, 0.059, 0.112),  # east velocity [m/s]
        (4, 1.0, 0.060, 0.156),  # north velocity
        (1, 1.0, 221.0, 250.0),  # latitude [m]
        (0, 1.0, 149.0, 149.0),  # longitude
        (6, np.degrees(60.0), 0.12, 0.135),  # pitch [′]
        (7, np.degrees(60.0), 0.08, 0.080),  # roll
        (8, np.degrees(60.0), 0.06, 0.061),  # heading
    ],
)
def test_what_the_disturbance_can_do_within_two_hours(flight, column, factor, at_end, largest):
    """The numbers of an independent linear calculation, to 5 %."""
    response = factor * np.abs(flight.gravity_response[:, column])
    assert response[-1] == pytest.approx(at_end, rel=0.05)
    assert response.max() == pytest.approx(largest, rel=0.05)


@thinned(
    ("name", "east", "north"),
    [
        ("estimated-1s", 4.7, 3.7),
        ("estimated-10s", 32.0, 6.5),
        ("navigation-grade", 34.0, 34.0),
    ],
)
def test_how_well_it_can_be_told_after_two_hours(name, east, north):
    """σ of the horizontal parts in mGal, of an independent calculation, to 5 %."""
    bound = flight_bound(to_the_north(name)).filtering[-1]
    sigma = MGAL * np.sqrt(np.diag(bound))[15:17]
    assert sigma == pytest.approx([east, north], rel=0.05)
    correlation = bound[15, 7] / np.sqrt(bound[15, 15] * bound[7, 7])
    assert abs(correlation) > 0.98


def test_the_estimate_is_consistent_where_heading_is_known():
    """Within 3σ of the truth in every one of 8 runs, if the accelerometers' bias is told, too."""
    flight = to_the_north("heading-known")
    imu = flight.case.model.imu.model_copy(update={"accelerometer_bias_ug": None})
    model = flight.case.model.model_copy(update={"imu": imu})
    told = prepare(flight.case.model_copy(update={"model": model}))
    block, truth = simulate_block(told, 4, range(8))
    found = choose("ekf").estimator.estimate_block(block)
    error = (truth.error_state - found.mean)[:, -1, 15:18]
    sigma = np.sqrt(np.diagonal(found.cov[:, -1], axis1=1, axis2=2))[:, 15:18]
    assert (np.abs(error) < 3.0 * sigma).all()
    assert np.abs(MGAL * (truth.error_state[0, -1, 15:18]) - TRUE).max() < 1e-9


@pytest.mark.long
def test_a_turn_does_not_tell_it_from_tilt():
    """Both are fixed to the Earth: after the second leg most of the east part's σ is left."""
    flight = prepare(LOADED.case("estimated-10s"))
    sigma = MGAL * np.sqrt(np.diagonal(flight_bound(flight).filtering, axis1=1, axis2=2))[:, 15]
    before = np.searchsorted(flight.times, 7200.0)
    assert sigma[before] > 30.0
    assert sigma[-1] > 20.0
