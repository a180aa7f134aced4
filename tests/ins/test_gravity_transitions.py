"""The gravity disturbance as states: Φ and Q are those of the error model with three more."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from conftest import metres
from scipy.linalg import block_diag, expm
from small_cases import small_flight

from ggbench.ins import error_model
from ggbench.sensors.aiding import Motion
from ggbench.simulation.equipment import equip

SIZES = (2e-4, 3e-4, 1e-4)


@pytest.mark.parametrize("wandering", [False, True], ids=["constant biases", "wandering biases"])
@pytest.mark.parametrize("distance", [2e3, math.inf], ids=["2 km", "constant"])
def test_transitions_are_van_loans(distance, wandering):
    """δv' = … − δg, δg' = −(|v|/D) δg + w of PSD 2σ²|v|/D: by matrix exponentials, step by step."""
    flight = small_flight({"trajectory.roll_deg": 20.0})
    truth, dt = flight.trajectory, flight.trajectory.dt
    motion = Motion(truth.positions, truth.velocities, truth.attitudes)
    plain = error_model.system_matrices(*motion, flight.delta_velocities, dt)
    times = (20.0, 50.0) if wandering else (math.inf, math.inf)
    base = equip(flight.case, "model")
    imu = dataclasses.replace(base.imu, gyro_bias_time=times[0], accelerometer_bias_time=times[1])
    equipment = dataclasses.replace(base, imu=imu, disturbance=(SIZES, distance))
    epochs = np.array([10, 11, 40])
    transition, process_cov = equipment.system(motion, flight.delta_velocities, epochs, dt)
    matrices, driving = equipment.complete(plain.copy())
    start = 0
    for k, end in enumerate(epochs):
        phi, q = np.eye(18), np.zeros((18, 18))
        for n in range(start, end):
            rate = np.linalg.norm(truth.velocities[n : n + 2].mean(axis=0)) / distance
            f = block_diag(matrices[n], -rate * np.eye(3))
            f[3:6, 15:] = -np.eye(3)
            noise = block_diag(driving, np.diag(2.0 * rate * np.square(SIZES)))
            change = block_diag(metres(truth.positions[n]), np.eye(15))
            f = change @ f @ np.linalg.inv(change)
            block = expm(np.block([[-f, noise], [np.zeros((18, 18)), f.T]]) * dt)
            step = block[18:, 18:].T
            phi, q = step @ phi, step @ q @ step.T + step @ block[:18, 18:]
        scale = np.sqrt(np.diag(base.prior_cov)[:15].tolist() + np.square(SIZES).tolist())
        np.testing.assert_allclose(
            transition[k] * scale / scale[:, None], phi * scale / scale[:, None], atol=2e-6
        )
        sigma = np.sqrt(np.maximum(np.diag(q), 1e-40))
        unit = np.outer(sigma, sigma)
        np.testing.assert_allclose(process_cov[k] / unit, q / unit, atol=2e-6)
        start = end
    assert (transition[0, 3:6, 15:].diagonal() < 0.0).all()
