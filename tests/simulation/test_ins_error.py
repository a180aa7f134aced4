"""The error of the INS alone: that of the transitions which estimators are given."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest
from command import invoke
from problems import SEED
from small_cases import prepare, small_flight

import ggbench as gg
from ggbench.simulation.ins_error import ins_error
from ggbench.simulation.runs import simulate
from ggbench.spec import scenario


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
    aided = small_flight(
        {
            "initial_error.position_m": 50.0,
            "gnss.period_s": 1.0,
            "gnss.position_noise_m": 3.0,
            "barometer.period_s": 1.0,
            "barometer.noise_m": 3.0,
            "barometer.bias_m": 5.0,
        }
    )
    again = ins_error(aided.true, aided.trajectory)
    np.testing.assert_array_equal(again.deviations, found.deviations)


CONSUMER = """
title = "A receiver and a cheap INS"
description = "For the linear range."

[trajectory]
latitude_deg = 46.0
longitude_deg = 8.0
height_m = 3000.0
speed_mps = 60.0
heading_deg = 90.0

[[trajectory.segment]]
kind = "cruise"
duration_s = 1800.0

[imu]
period_s = 0.1
gyro_bias_deg_per_h = 10.0
gyro_noise_deg_per_sqrt_h = 0.5
accelerometer_bias_ug = 5000.0
accelerometer_noise_ug_per_sqrt_hz = 100.0

[initial_error]
position_m = 5.0
velocity_mps = 0.1
attitude_arcmin = 30.0

[gnss]
period_s = 1.0
position_noise_m = 3.0

[field]
source = "normal"

[windows]
settled_from_s = 100.0
last_s = 20.0

[[case]]
name = "cheap"
title = "cheap"

[[case]]
name = "tactical"
title = "tactical"
imu.gyro_bias_deg_per_h = 0.01
imu.gyro_noise_deg_per_sqrt_h = 0.003
imu.accelerometer_bias_ug = 20.0
imu.accelerometer_noise_ug_per_sqrt_hz = 10.0
initial_error.attitude_arcmin = 0.5
"""


@pytest.mark.long
def test_beyond_the_linear_range_the_open_loop_fails_and_the_closed_loop_does_not(tmp_path):
    """Over half an hour of an INS that errs by 200 km: the EKF agrees until then, no longer."""
    (tmp_path / "own.toml").write_text(CONSUMER)
    cheap, tactical = scenario.load(tmp_path / "own.toml").cases
    flight = prepare(cheap)
    found = ins_error(flight.true, flight.trajectory)
    until = found.linear_until(3.0)
    assert 200.0 < until < 350.0 and found.horizontal[-1] > 150e3
    problem, truth = simulate(flight, SEED, 0)
    before, after = problem.times < 0.5 * until, problem.times > 1500.0
    errors = {
        label: np.linalg.norm((gg.estimate(problem, label).mean - truth.error_state)[:, :3], axis=1)
        for label in ("ekf", "closed-loop")
    }
    assert errors["ekf"][before].mean() < 1.3 * errors["closed-loop"][before].mean()
    assert errors["ekf"][after].mean() > 10.0 * errors["closed-loop"][after].mean()
    flight = prepare(tactical)
    assert math.isinf(ins_error(flight.true, flight.trajectory).linear_until(3.0))
    assert ins_error(flight.true, flight.trajectory).linear_until(0.1) < 1800.0
    lost = small_flight({"initial_error.position_m": 50e3})  # known to 50 km, and no worse later
    assert math.isinf(ins_error(lost.true, lost.trajectory).linear_until(3.0))


def test_validate_says_how_far_the_ins_errs_and_advises_the_closed_loop(tmp_path):
    (tmp_path / "own.toml").write_text(CONSUMER)
    done = invoke(["validate", "own.toml"], tmp_path)
    assert done.returncode == 0, done.stderr
    said = " ".join(done.stdout.split())
    errs = r"unaided INS error up to \d+ k?m horizontally and [\d.]+ k?m in height \(1 σ\)"
    advice = r"; after \d+ s the second-order part of the INS error exceeds 3 m.*: use closed-loop "
    found = re.search(f"INS in cheap: {errs}{advice}INS in tactical: {errs} Readings", said)
    assert found, said
