"""The gravity disturbance as states: Φ and Q are those of the error model with three more."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from frame_oracles import metres
from oracles import dense_model, points
from scipy.linalg import block_diag, expm
from small_cases import small_flight
from thinning import thinned

from ggbench.gravity.ellipsoid import EOTVOS
from ggbench.ins.known_gravity import NORMAL_GRAVITY, KnownGravity, of_readings
from ggbench.numerics.lanes import in_lanes
from ggbench.sensors.aiding import Motion
from ggbench.simulation.instruments import GravityState
from ggbench.simulation.suites import suite_of_case
from ggbench.trajectory.truth import Trajectory

SIZES = (2e-4, 3e-4, 1e-4)


def read_at(samples: np.ndarray, truth: Trajectory) -> tuple[KnownGravity, np.ndarray]:
    """Readings of enormous gradients, the middle one missing; T (N + 1, 3, 3) [s⁻²] at samples."""
    readings = 1e7 * np.random.default_rng(2).normal(size=(1, len(samples), 6))
    readings[:, 1] = np.nan
    tensors = np.zeros((len(truth.times), 3, 3))
    for reading, sample in zip(readings[0], samples, strict=True):
        normal, slope = np.empty(6), np.empty((6, 3))
        points.normal_gradient(
            truth.positions[sample, 0], truth.positions[sample, 2], normal, slope
        )
        if np.isfinite(reading).all():
            tensors[sample:] = EOTVOS * (reading - normal)[[[0, 1, 2], [1, 3, 4], [2, 4, 5]]]
    return of_readings(in_lanes(readings), samples, len(truth.times)), tensors


@thinned("wandering", [False, True], ids=["constant biases", "wandering biases"], every=2)
@pytest.mark.parametrize(
    ("distance", "walk"),
    [(2e3, None), (math.inf, None), (math.inf, 1e-7)],
    ids=["2 km", "constant", "integrated"],
)
def test_transitions_are_van_loans(distance, walk, wandering):
    """δv' = … − δg, δg' = −(|v|/D) δg + w of PSD 2σ²|v|/D: by matrix exponentials, step by step.

    Where gradients are integrated, δg' = −T δv − ω_en × δg + w of PSD (walk |v|)², T the latest.
    """
    flight = small_flight({"trajectory.roll_deg": 20.0})
    truth, dt = flight.trajectory, flight.trajectory.dt
    motion = Motion(truth.positions, truth.velocities, truth.attitudes)
    plain = dense_model.system_matrices(*motion, flight.delta_velocities, dt)
    times = (20.0, 50.0) if wandering else (math.inf, math.inf)
    base = suite_of_case(flight.case, "model")
    imu = dataclasses.replace(base.imu, gyro_bias_time=times[0], accelerometer_bias_time=times[1])
    suite = dataclasses.replace(base, imu=imu, disturbance=GravityState(SIZES, distance, walk))
    epochs = np.array([10, 11, 40])
    gravity, tensors = NORMAL_GRAVITY, np.zeros((len(truth.times), 3, 3))
    if walk is not None:
        gravity, tensors = read_at(np.array([5, 12, 20]), truth)
    transition, process_cov = suite.system(motion, flight.delta_velocities, epochs, dt, gravity)
    matrices, driving = dense_model.completed(plain, suite.imu, suite.altimeter)
    start = 0
    for k, end in enumerate(epochs):
        phi, q = np.eye(18), np.zeros((18, 18))
        for n in range(start, end):
            speed = np.linalg.norm(truth.velocities[n : n + 2].mean(axis=0))
            rate = speed / distance
            f = block_diag(matrices[n], -rate * np.eye(3))
            f[3:6, 15:] = -np.eye(3)
            f[15:, 3:6] = -tensors[n]
            psd = 2.0 * rate * np.square(SIZES)
            if walk is not None:
                middle, velocity = truth.positions[n : n + 2], truth.velocities[n : n + 2]
                middle, velocity = middle.mean(axis=0), velocity.mean(axis=0)
                turn, transport = np.empty((2, 3))
                points.frame_rates(middle[0], middle[2], velocity, turn, transport)
                f[15:, 15:] = -np.cross(transport, np.eye(3)).T
                psd = np.full(3, (walk * speed) ** 2)
            noise = block_diag(driving, np.diag(psd))
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
