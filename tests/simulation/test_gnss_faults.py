"""Receivers that err: ramp, jump, duty cycle and correlated errors are in the truth as declared."""

from __future__ import annotations

import numpy as np
import pytest
from laws import likely
from scipy.stats import chi2
from small_cases import GNSS, residuals_at_the_truth, small_flight

from ggbench.sensors.gradiometer.faults import Faults
from ggbench.simulation.runs import simulate_block

BIAS = {"position_bias_m": 5.0, "position_bias_time_s": 6.0}


def of(side: str, keys: dict[str, object]) -> dict[str, object]:
    return {f"{side}.{key}": value for key, value in keys.items()}


def flown(changes: dict[str, object], runs: int = 3):
    """Problems and truth of some runs with a receiver alone."""
    return simulate_block(small_flight(GNSS | changes), 5, range(runs))


def test_ramp_and_jump_are_added_to_positions_alone():
    """The same in each run, from the time that is given; noise and model stay what they were."""
    plain, _ = flown({})
    ramp = {"ramp_mps": [0.5, 0.0, -0.25], "ramp_from_s": 8.0}
    jump = {"jump_m": [0.0, 30.0, 0.0], "jump_from_s": 5.0, "jump_until_s": 12.0}
    wrong, _ = flown(of("truth.gnss", ramp | jump))
    times, added = plain.times, wrong.measurements - plain.measurements
    grown = np.maximum(times - 8.0, 0.0)
    expected = np.zeros((len(times), 6))
    expected[:, 0], expected[:, 2] = 0.5 * grown, -0.25 * grown
    expected[(times >= 5.0) & (times <= 12.0), 1] = 30.0
    np.testing.assert_allclose(added, np.broadcast_to(expected, added.shape), atol=1e-9)
    assert np.array_equal(plain.noise_cov, wrong.noise_cov)


def test_a_duty_cycle_starts_with_readings():
    """On for 3 s, off for 2 s: readings at 1, 2, 3, 6, 7, 8, 11 s and so on; dropouts are added."""
    duty = {"duty_on_s": 3.0, "duty_off_s": 2.0, "dropouts_s": [[7.0, 7.0 + 1e-3]]}
    block, _ = flown(of("truth.gnss", duty))
    there = [t for t in range(1, 21) if (t - 1) % 5 < 3 and t != 7]
    np.testing.assert_array_equal(block.times[block.present[0, :, 0]], there)
    share = Faults(duty=(3.0, 2.0)).expected_share(np.arange(1.0, 6.0))
    np.testing.assert_array_equal(share, [1.0, 1.0, 1.0, 0.0, 0.0])


def test_an_assumed_position_bias_is_a_state():
    """Of three states, with the truth in them: residuals at it are the white noise.

    Within 4 deviations in each of 6 channels of 40 runs: false alarms 4e-4.
    """
    block, truth = flown(of("gnss", BIAS), runs=40)
    assert block.layout[-1].name == "gnss bias"
    assert truth.error_state.shape[2] == 18
    squares, count = residuals_at_the_truth(block, truth)
    assert (np.abs(squares - count) < 4.0 * np.sqrt(2.0 * count)).all()


def test_a_position_bias_of_the_truth_alone_is_correlated():
    """Variance and correlation over a second are those declared; there is no state.

    At a probability of a false alarm of 1e-4 for the variance; velocities have none.
    """
    plain, _ = flown({}, runs=200)
    block, truth = flown(of("truth.gnss", BIAS), runs=200)
    added = (block.measurements - plain.measurements)[..., :3]
    assert truth.error_state.shape[2] == 15
    assert likely((added[:, 0] ** 2).sum() / 25.0, chi2(600))
    after = (added[:, 1:] * added[:, :-1]).mean() / (added**2).mean()
    assert after == pytest.approx(np.exp(-1.0 / 6.0), abs=0.02)
    np.testing.assert_array_equal(block.measurements[..., 3:], plain.measurements[..., 3:])
