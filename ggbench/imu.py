"""Errors of the inertial sensors, added to error-free increments."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Imu:
    """Inertial measurement unit: constant biases drawn once per run, and white noise.

    Attributes
    ----------
    gyro_bias, accelerometer_bias : standard deviation per axis [rad/s], [m/s²].
    gyro_root_psd : white noise [rad/s/√Hz]. accelerometer_root_psd : [m/s²/√Hz].
    fixed_biases : the biases are the standard deviations themselves with a random sign per run
        and axis, instead of draws from N(0, σ²).
    """

    gyro_bias: float
    accelerometer_bias: float
    gyro_root_psd: float
    accelerometer_root_psd: float
    fixed_biases: bool = False

    def draw_biases(self, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """Return the gyro (3,) [rad/s] and accelerometer (3,) [m/s²] biases of a run."""
        draws = rng.standard_normal((2, 3))
        if self.fixed_biases:
            draws = np.sign(draws)
        return self.gyro_bias * draws[0], self.accelerometer_bias * draws[1]

    def corrupt(
        self,
        delta_angles: np.ndarray,
        delta_velocities: np.ndarray,
        biases: tuple[np.ndarray, np.ndarray],
        dt: float,
        rng: np.random.Generator,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the increments (N, 3) that the sensors deliver: measured = true + error.

        White noise of root PSD σ over an interval dt adds σ √dt to each increment.
        """
        angle_noise = rng.standard_normal(delta_angles.shape)
        velocity_noise = rng.standard_normal(delta_velocities.shape)
        return (
            delta_angles + biases[0] * dt + self.gyro_root_psd * math.sqrt(dt) * angle_noise,
            delta_velocities
            + biases[1] * dt
            + self.accelerometer_root_psd * math.sqrt(dt) * velocity_noise,
        )
