"""Sensors that are not where the INS is: known arms are corrected for, wrong ones are not."""

from __future__ import annotations

import numpy as np
import pytest
from oracles import assert_as_the_oracle
from problems import estimator, final_nees, rng
from small_cases import residuals_at_the_truth, rough_map, small_flight

from ggbench.block import ProblemBlock
from ggbench.gravity.ellipsoid import metres_along
from ggbench.numerics.rotations import rotation_matrix
from ggbench.sensors.gradiometer.instrument import readings
from ggbench.simulation.flight_bounds import flight_bound
from ggbench.simulation.runs import Truth, simulate, simulate_block

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
    """By the same angles in every run: Rᵀ Γ R, the axes of the mount being the columns of R."""
    angles = [30.0, -20.0, 60.0]
    flight = small_flight(QUIET | {"truth.gradiometer.mounting_error_arcmin": angles})
    block, _ = simulate_block(flight, 1, range(3))
    turn = np.empty((3, 3))
    rotation_matrix(np.radians(angles) / 60.0, turn)
    full = flight.noise_free[:, [[0, 1, 2], [1, 3, 4], [2, 4, 5]]]
    turned = (turn.T @ full @ turn)[:, *np.triu_indices(3)]
    for run in range(3):
        np.testing.assert_allclose(block.measurements[run], turned, atol=1e-6)


@pytest.mark.parametrize(
    ("axis", "turned_to", "component"), [(0, (1, 2), "yy"), (1, (2, 0), "zz"), (2, (0, 1), "xx")]
)
@pytest.mark.parametrize("known", [False, True], ids=["truth", "equation"])
def test_a_mounting_angle_turns_right_handed(tmp_path, axis, turned_to, component, known):
    """[0, 0, 60] turns x of a level mount from east towards north: xx is eᵀ Γ e of that axis.

    Also in the equation of measurement of an estimator that has the angles as states. A left-handed
    turn differs by more than 1 E.
    """
    angles, level = [0.0, 0.0, 0.0], {"gradiometer.instrument": "local-level"}
    level["field.source"] = rough_map(tmp_path / "map.nc", rms=300.0)
    angles[axis] = 60.0
    error = {"truth.gradiometer.mounting_error_arcmin": angles}
    if known:
        error["gradiometer.mounting_sigma_arcmin"] = 1e-6
    flight = small_flight(QUIET | level | error)
    block, truth = simulate_block(flight, 1, range(1))
    problem, read_as = block.problem(0), ("xx", "xy", "xz", "yy", "yz", "zz").index(component)
    found = problem.measurements
    if known:
        epochs = np.arange(problem.epochs)
        found = problem.model.predict_along(epochs, truth.error_state[0])
    full = flight.noise_free[:, [[0, 1, 2], [1, 3, 4], [2, 4, 5]]]
    before, after = np.eye(3)[list(turned_to)]
    right, left = (
        np.cos(np.pi / 180.0) * before + sign * np.sin(np.pi / 180.0) * after for sign in (1, -1)
    )
    expected, other = (np.einsum("kij,i,j->k", full, e, e) for e in (right, left))
    np.testing.assert_allclose(found[:, read_as], expected, rtol=0.0, atol=1e-3)
    assert np.abs(expected - other).max() > 1.0


UNKNOWN = {"gnss.lever_arm_m": ARM, "gnss.lever_arm_sigma_m": 2.0}
ARM_STATES = slice(15, 18)
WINDING = GNSS | {
    "trajectory.segment": [
        {"kind": "turn", "by_heading_deg": turn, "turn_rate_deg_per_s": 3.0}
        for turn in (90.0, -150.0)
    ],
    "gnss.position_noise_m": 1.0,
    "gnss.velocity_noise_mps": 0.05,
    "initial_error.attitude_arcmin": 3.0,
}
RUNS = 24


def test_the_drawn_arm_is_in_the_readings_and_in_the_true_states():
    """Constant in a run; σ of 180 numbers within 4 of its own deviations: false alarms 6e-5."""
    block, truth = simulate_block(small_flight(GNSS | UNKNOWN), 3, range(60))
    flight = small_flight(GNSS | {"gnss.lever_arm_m": ARM})
    known, _ = simulate_block(flight, 3, range(60))
    assert [(b.name, b.unit) for b in block.layout if b.slice == ARM_STATES] == [
        ("gnss lever arm error", "m")
    ]
    arms = truth.error_state[:, :, ARM_STATES]
    assert (arms == arms[:, :1]).all()
    assert 2.0 * (1 - 4 / np.sqrt(360)) < arms[:, 0].std() < 2.0 * (1 + 4 / np.sqrt(360))
    added = block.measurements - known.measurements
    attitudes = flight.motion_at_epochs.attitudes
    np.testing.assert_allclose(added[..., :3], np.einsum("kij,rkj->rki", attitudes, arms))
    swept = np.einsum("kij,rkj->rki", attitudes, np.cross(flight.turning, arms))
    np.testing.assert_allclose(added[..., 3:], swept, atol=1e-12)
    assert np.abs(swept).max() > 0.1


def test_the_state_is_what_estimators_do_not_know_of_the_arm():
    """A wrong arm and a drawn error add up; without an error of the truth it is the wrong part."""
    wrong = {"truth.gnss.lever_arm_m": [ARM[0] + 1.0, *ARM[1:]]}
    _, drawn = simulate(small_flight(GNSS | UNKNOWN), 1, 0)
    _, both = simulate(small_flight(GNSS | UNKNOWN | wrong), 1, 0)
    np.testing.assert_allclose(
        both.error_state[:, ARM_STATES] - drawn.error_state[:, ARM_STATES],
        np.broadcast_to([1.0, 0.0, 0.0], (len(both.times), 3)),
        atol=1e-12,
    )
    exact = wrong | {"truth.gnss.lever_arm_sigma_m": 0.0}
    _, alone = simulate(small_flight(GNSS | UNKNOWN | exact), 1, 0)
    assert (alone.error_state[:, ARM_STATES] == [1.0, 0.0, 0.0]).all()


def test_an_arm_that_is_exactly_known_is_no_state():
    """Neither by default nor of estimators that believe it: then it is an error of the truth."""
    plain, truth = simulate_block(small_flight(GNSS | {"gnss.lever_arm_m": ARM}), 1, range(2))
    assert plain.dimension == 15
    changes = {"gnss.lever_arm_m": ARM, "gnss.lever_arm_sigma_m": 0.0}
    same, same_truth = simulate_block(small_flight(GNSS | changes), 1, range(2))
    np.testing.assert_array_equal(same.measurements, plain.measurements)
    np.testing.assert_array_equal(same.transition, plain.transition)
    np.testing.assert_array_equal(same_truth.error_state, truth.error_state)
    believed = {"model.gnss.lever_arm_sigma_m": 0.0}
    fooled, _ = simulate_block(small_flight(GNSS | UNKNOWN | believed), 1, range(2))
    assert fooled.dimension == 15
    assert np.abs(fooled.measurements - plain.measurements)[..., :3].max() > 1.0


def test_residuals_at_the_truth_are_noise_if_the_arm_is_a_state():
    """Within 4 deviations in each of 6 channels of 40 runs: false alarms 4e-4.

    The product of attitude and arm errors is neglected: 0.3 mm for 0.5′ and 2 m, of 1 cm of noise.
    Negative control: states without the arm's error, seen in all but the vertical velocity.
    """
    small = {"initial_error.attitude_arcmin": 0.5}
    block, truth = simulate_block(small_flight(GNSS | UNKNOWN | small), 7, range(40))
    squares, count = residuals_at_the_truth(block, truth)
    assert (np.abs(squares - count) < 4.0 * np.sqrt(2.0 * count)).all()
    truth.error_state[:, :, ARM_STATES] = 0.0
    squares, count = residuals_at_the_truth(block, truth)
    assert (squares > 10.0 * count)[:5].all()


def flown(changes: dict[str, object]) -> tuple[ProblemBlock, Truth]:
    return simulate_block(small_flight(WINDING | changes), 5, range(RUNS))


def test_a_filter_with_the_states_is_consistent_and_finds_the_arm():
    """Position and arm after turns: NEES within 4 deviations of χ², false alarms 6e-5.

    The arm's error ends below half of its prior, as the bound does. Control: a filter that believes
    the arm.
    """
    states = [0, 1, 2, *range(15, 18)]
    block, truth = flown(UNKNOWN)
    mean = final_nees(block, truth, states).mean()
    assert abs(mean - 6.0) < 4.0 * np.sqrt(12.0 / RUNS)
    found = estimator("ekf").estimate_block(block)
    off = (found.mean - truth.error_state)[:, -1, ARM_STATES]
    sigma = np.sqrt(np.diagonal(found.cov, axis1=2, axis2=3))[:, -1, ARM_STATES]
    bound = flight_bound(small_flight(WINDING | UNKNOWN)).filtering[-1, ARM_STATES, ARM_STATES]
    # Horizontal parts: nothing tells the height of the antenna from that of a ship on the level.
    assert np.sqrt((off[:, :2] ** 2).mean()) < 1.0 and (sigma[:, :2] < 1.0).all()
    np.testing.assert_allclose(sigma, np.tile(np.sqrt(np.diag(bound)), (RUNS, 1)), rtol=0.02)
    fooled, truth = flown(UNKNOWN | {"model.gnss.lever_arm_sigma_m": 0.0})
    assert final_nees(fooled, truth, [0, 1, 2]).mean() > 3.0 + 4.0 * np.sqrt(6.0 / RUNS)


@pytest.mark.parametrize("label", ["ekf", "ukf"])
def test_engines_carry_the_states_as_the_frameworks_do(label):
    """Of both kinds of channels, to 1e-6 of the prior's deviations."""
    block, _ = simulate_block(small_flight(WINDING | UNKNOWN), 5, range(2))
    assert_as_the_oracle(label, block)


@pytest.mark.parametrize(
    "label",
    ["ins", "rao-blackwellised[particles=50]", "closed-loop", "factor-graph[mode=batch]"],
)
def test_other_estimators_take_the_states(label):
    """Their arm is no worse than the prior's."""
    block, truth = simulate_block(small_flight(WINDING | UNKNOWN), 5, range(1))
    found = estimator(label).estimate(block.problem(0), rng())
    assert found.mean.shape == (block.epochs, 18)
    off = found.mean[-1, ARM_STATES] - truth.error_state[0, -1, ARM_STATES]
    assert np.abs(off).max() < 6.0


def test_receivers_have_arms_of_their_own():
    """Each with its states, its draw and its column; biases before the arm."""
    stern = {
        "sensor.stern.kind": "gnss",
        "sensor.stern.period_s": 2.0,
        "sensor.stern.position_noise_m": 2.0,
        "sensor.stern.lever_arm_sigma_m": 1.0,
    }
    biased = {"gnss.position_bias_m": 3.0}
    block, truth = simulate_block(small_flight(GNSS | UNKNOWN | biased | stern), 1, range(2))
    names = {b.name: b.slice for b in block.layout}
    assert names["gnss bias"] == slice(15, 18)
    assert names["gnss lever arm error"] == slice(18, 21)
    assert names["stern lever arm error"] == slice(21, 24) and block.dimension == 24
    assert (np.diff(truth.error_state[0, 0, 18:]) != 0.0).all()
    k = int(np.flatnonzero(block.present[0].all(axis=1))[0])
    slope = block.problem(0).model.jacobian(k, np.zeros(24))
    c_nb = block.problem(0).track.attitudes[k]
    np.testing.assert_allclose(slope[:3, 18:21], c_nb)
    np.testing.assert_allclose(slope[6:, 21:], c_nb)
    assert not slope[:6, 21:].any() and not slope[6:, 15:21].any()
