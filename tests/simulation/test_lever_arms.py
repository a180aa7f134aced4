"""Sensors that are not where the INS is: known arms are corrected for, wrong ones are not."""

from __future__ import annotations

import numpy as np
import pytest
from small_cases import ON_BOARD, residuals_at_the_truth, rough_map, small_case, small_flight

from ggbench.errors import GGBenchError
from ggbench.gravity.ellipsoid import metres_along
from ggbench.numerics.rotations import rotation_matrix
from ggbench.sensors.gradiometer.instrument import readings
from ggbench.simulation.runs import simulate, simulate_block

TURNING = {
    "trajectory.vehicle": "ship",  # which does not bank
    "trajectory.segment": [{"kind": "turn", "by_heading_deg": 60.0, "turn_rate_deg_per_s": 3.0}],
}
GNSS = TURNING | {
    "gradiometer": None,
    "gnss.period_s": 1.0,
    "gnss.position_noise_m": 0.01,
    "gnss.velocity_noise_mps": 0.001,
}
ARM = [3.0, -10.0, 2.0]
QUIET = {"gradiometer.noise_eotvos": 1e-9}


def test_residuals_at_the_truth_are_noise_if_the_arm_is_known():
    """Within 4 deviations in each of 6 channels of 40 runs: false alarms 4e-4.

    Negative control: an antenna that is 10 cm away from where it is believed to be.
    """
    small = {"initial_error.attitude_arcmin": 0.5}
    squares, count = residuals_at_the_truth(
        *simulate_block(small_flight(GNSS | small | {"gnss.lever_arm_m": ARM}), 7, range(40))
    )
    assert (np.abs(squares - count) < 4.0 * np.sqrt(2.0 * count)).all()
    moved = {"truth.gnss.lever_arm_m": [ARM[0] + 0.1, *ARM[1:]]}
    squares, count = residuals_at_the_truth(
        *simulate_block(
            small_flight(GNSS | small | {"gnss.lever_arm_m": ARM} | moved), 7, range(40)
        )
    )
    assert (squares > 10.0 * count)[:2].all()


def test_a_wrong_arm_moves_positions_and_velocities():
    """By C Δl, and by C (ω × Δl) in a turn of 3°/s: 0.5 m/s for 10 m."""
    right, _ = simulate(small_flight(GNSS), 1, 0)
    flight = small_flight(GNSS | {"truth.gnss.lever_arm_m": ARM})
    wrong, _ = simulate(flight, 1, 0)
    attitudes = flight.motion_at_epochs.attitudes
    added = wrong.measurements - right.measurements
    np.testing.assert_allclose(added[:, :3], attitudes @ np.array(ARM), atol=1e-9)
    assert np.linalg.norm(added[:, 3:], axis=1).max() == pytest.approx(0.54, abs=0.02)
    dt = flight.trajectory.dt
    n = flight.epochs[:-1]
    ahead, behind = (flight.trajectory.attitudes[n + s] @ np.array(ARM) for s in (1, -1))
    np.testing.assert_allclose(added[:-1, 3:], (ahead - behind) / (2.0 * dt), atol=2e-3)


def test_a_gradiometer_reads_the_field_where_it_is(tmp_path):
    """20 m to the right and 30 m below: as if the track were displaced so."""
    field = {"field": {"source": rough_map(tmp_path / "rough.nc")}}
    arm = [20.0, 0.0, -30.0]
    flight = small_flight(QUIET | field | TURNING | {"truth.gradiometer.lever_arm_error_m": arm})
    motion = flight.motion_at_epochs
    displaced = np.einsum("kij,j->ki", motion.attitudes, arm)
    metres = np.hstack([metres_along(motion.positions), np.ones((len(displaced), 1))])
    places = motion.positions + (displaced / metres)[:, [1, 0, 2]]
    expected = readings(flight.field, places, flight.times)
    np.testing.assert_allclose(flight.noise_free, expected, atol=1e-9)
    assert np.abs(flight.noise_free - small_flight(QUIET | field | TURNING).noise_free).max() > 0.01


def test_a_mounting_error_turns_the_tensor():
    """By the same angles in every run."""
    angles = [30.0, -20.0, 60.0]
    flight = small_flight(QUIET | {"truth.gradiometer.mounting_error_arcmin": angles})
    block, _ = simulate_block(flight, 1, range(3))
    turn = np.empty((3, 3))
    rotation_matrix(np.radians(angles) / 60.0, turn)
    full = flight.noise_free[:, [[0, 1, 2], [1, 3, 4], [2, 4, 5]]]
    turned = (turn @ full @ turn.T)[:, *np.triu_indices(3)]
    for run in range(3):
        np.testing.assert_allclose(block.measurements[run], turned, atol=1e-6)


def test_an_arm_has_three_parts_and_bounds():
    for arm in ([1.0, 2.0], [1.0, 2.0, 3000.0]):
        with pytest.raises(GGBenchError, match="lever_arm_m"):
            small_case(ON_BOARD | {"gnss.lever_arm_m": arm})
