"""Several sensors in a simulation: who is read when, what is missing, and what estimators know."""

from __future__ import annotations

import numpy as np
import pytest
from small_cases import GRAVIMETER, ON_BOARD, residuals_at_the_truth, rough_map, small_flight

from ggbench.simulation.runs import simulate, simulate_block

RUNS = 40


@pytest.fixture(scope="module")
def rough(tmp_path_factory) -> dict[str, object]:
    """A field with a rough map of gradients and gravity."""
    path = rough_map(tmp_path_factory.mktemp("map") / "rough.nc")
    return {"field": {"source": path}}


def places(problem, sensor: str) -> list[int]:
    return [i for i, channel in enumerate(problem.channels) if channel.sensor == sensor]


def test_every_sensor_is_read_at_its_own_rate(rough):
    """The epochs are those of all sensors; a channel is there at the multiples of its period."""
    flight = small_flight(ON_BOARD | GRAVIMETER | rough)
    problem, _ = simulate(flight, 1, 0)
    assert np.array_equal(problem.times, np.arange(1, 41) / 2.0)
    for sensor, period in flight.case.periods.items():
        there = problem.present[:, places(problem, sensor)]
        expected = np.abs(np.round(problem.times / period) * period - problem.times) < 1e-9
        assert np.array_equal(there, np.repeat(expected[:, None], there.shape[1], axis=1)), sensor
        assert expected.any()


def test_where_a_channel_is_not_there_measurement_h_and_jacobian_are_zero(rough):
    """So that an estimator need not ask which are; and nowhere else."""
    changes = {"truth.gnss.dropouts_s": [[5.0, 9.0]], "truth.barometer.dropout_share": 0.4}
    problem, truth = simulate(small_flight(ON_BOARD | GRAVIMETER | rough | changes), 1, 0)
    outage = (problem.times >= 5.0) & (problem.times <= 9.0)
    assert not problem.present[np.ix_(outage, places(problem, "gnss"))].any()
    for k, there in enumerate(problem.present):
        x = truth.error_state[k]
        jacobian, predicted = problem.model.jacobian(k, x), problem.model.predict(k, x)
        assert not problem.measurements[k, ~there].any()
        assert not predicted[~there].any()
        assert not jacobian[~there].any()
        assert jacobian[there].any(axis=1).all()


def test_residuals_at_the_truth_are_the_noise_that_is_told(rough):
    """White, of unit variance in every channel: within 4 deviations of the mean of 40 runs.

    False alarms: 16 channels times 6e-5.
    """
    block, truth = simulate_block(small_flight(ON_BOARD | GRAVIMETER | rough), 3, range(RUNS))
    squares, count = residuals_at_the_truth(block, truth)
    assert (np.abs(squares / count - 1.0) < 4.0 * np.sqrt(2.0 / count)).all()


def test_biases_are_states_that_move_as_the_model_says(rough):
    """The prior's σ, a decay over the correlation time between any epochs, and its noise."""
    flight = small_flight(ON_BOARD | GRAVIMETER | rough)
    problem, _ = simulate(flight, 1, 0)
    blocks = {block.name: block.slice for block in problem.layout}
    log, barometer = blocks["velocity log bias"], blocks["barometer bias"]
    assert [block.stop - block.start for block in (log, barometer)] == [2, 1]
    kept = np.exp(-0.5 / 30.0)
    np.testing.assert_allclose(problem.transition[3, log, log], kept * np.eye(2))
    np.testing.assert_allclose(
        problem.process_cov[3, log, log], 0.2**2 * (1.0 - kept**2) * np.eye(2)
    )
    assert problem.transition[3, barometer, barometer] == 1.0
    assert problem.process_cov[3, barometer, barometer] == 0.0
    np.testing.assert_allclose(np.sqrt(np.diag(problem.prior_cov)[15:]), [0.2, 0.2, 5.0, 0.5])


def test_states_lie_one_behind_the_other(rough):
    """Those of the INS, of gravity, and the biases of every sensor that has any."""
    more = {
        "gradiometer.bias_eotvos": 0.5,
        "model.disturbance.horizontal_mgal": 20.0,
        "field.gravity_disturbance": True,
        "field.source": rough["field"]["source"],
    }
    problem, _ = simulate(small_flight(ON_BOARD | GRAVIMETER | more), 1, 0)
    assert len(problem.layout) == 5 + 1 + 1 + 3
    ends = [0, *(block.slice.stop for block in problem.layout)]
    assert [block.slice.start for block in problem.layout] == ends[:-1]
    assert ends[-1] == problem.dimension == 15 + 3 + 6 + 2 + 1 + 1


def test_a_sensor_changes_no_random_number_of_the_others(rough):
    """The INS, the gradiometer and the receiver have the same errors with a log beside them."""
    fewer = {key: x for key, x in ON_BOARD.items() if not key.startswith("velocity_log")}
    one, _ = simulate(small_flight(fewer | rough), 1, 0)
    other, _ = simulate(small_flight(ON_BOARD | rough), 1, 0)
    assert np.array_equal(one.track.positions, other.track.positions)
    for sensor in ("gradiometer", "gnss"):
        for k in range(one.epochs):
            np.testing.assert_array_equal(
                one.measurements[k, places(one, sensor)],
                other.measurements[k, places(other, sensor)],
            )


def test_the_model_may_know_a_sensor_wrongly():
    """Noise and biases of each side are its own; the channels are the same."""
    changes = {
        "truth.gnss.position_noise_m": 50.0,
        "model.velocity_log.bias_mps": 0.0,
        "truth.barometer.bias_m": 20.0,
    }
    flight = small_flight(ON_BOARD | changes)
    problem, truth = simulate(flight, 1, 0)
    assert flight.model.dimension == problem.dimension == truth.error_state.shape[1] == 16
    assert flight.true.dimension == 18
    at = places(problem, "gnss")[0]
    assert problem.noise_cov[at, at] == 25.0
    there = problem.present[:, at]
    errors = problem.measurements[there, at] + truth.error_state[there, 0]
    assert 25.0 < errors.std() < 100.0
    # A bias that only the truth has is no state: those that there are stay what they are.
    assert np.ptp(truth.error_state[:, 9:15], axis=0).max() == 0.0
    height = places(problem, "barometer")[0]
    left = [
        problem.measurements[k, height] - problem.model.predict(k, truth.error_state[k])[height]
        for k in np.flatnonzero(problem.present[:, height])
    ]
    assert abs(np.mean(left)) < 4.0 * 3.0 / np.sqrt(len(left))  # 3 m of noise, no bias


def test_what_the_ins_indicates_and_the_map_are_told(rough):
    """The track is the truth plus the error state; the map answers, and says its bounds."""
    flight = small_flight(rough)
    problem, truth = simulate(flight, 1, 0)
    off = problem.track.positions - flight.motion_at_epochs.positions
    np.testing.assert_allclose(off[:, 2], truth.error_state[:, 2], atol=1e-6)
    place = problem.track.positions[0]
    assert (problem.map.lower < place).all()
    assert (place < problem.map.upper).all()
    assert problem.map.tensor(*place).shape == (6,)
    assert problem.map.gravity_disturbance(*place).shape == (3,)
