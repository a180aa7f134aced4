"""Errors of the inertial sensors, added to error-free increments."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class SensorErrors:
    """Errors of a sensor triad that no estimator is told of: σ of what is drawn once per run.

    Attributes
    ----------
    scale_factor : relative, per axis.
    misalignment : of each axis towards each of the other two [rad].
    """

    scale_factor: float = 0.0
    misalignment: float = 0.0

    def draw(self, rng: np.random.Generator) -> np.ndarray:
        """Return the matrix (3, 3) that takes what a triad should measure to what it does."""
        draws = rng.standard_normal((3, 3))
        diagonal = np.eye(3, dtype=bool)
        errors = np.where(diagonal, self.scale_factor * draws, self.misalignment * draws)
        return np.asarray(np.eye(3) + errors)


@dataclass(frozen=True)
class Imu:
    """Inertial measurement unit: biases drawn once per run, constant or wandering, white noise.

    Attributes
    ----------
    gyro_bias, accelerometer_bias : standard deviation per axis [rad/s], [m/s²].
    gyro_root_psd : white noise [rad/s/√Hz]. accelerometer_root_psd : [m/s²/√Hz].
    fixed_biases : the biases are the standard deviations themselves with a random sign per run
        and axis, instead of draws from N(0, σ²).
    gyro_bias_time, accelerometer_bias_time : correlation time of a bias that is a first-order
        Gauss–Markov process [s]; infinite for a constant one.
    gyro_errors, accelerometer_errors : scale factors and misalignments.
    """

    gyro_bias: float
    accelerometer_bias: float
    gyro_root_psd: float
    accelerometer_root_psd: float
    fixed_biases: bool = False
    gyro_bias_time: float = math.inf
    accelerometer_bias_time: float = math.inf
    gyro_errors: SensorErrors = SensorErrors()
    accelerometer_errors: SensorErrors = SensorErrors()

    def draw_biases(self, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """Return the gyro (3,) [rad/s] and accelerometer (3,) [m/s²] biases at the start of a run.

        They are draws from the stationary law of the biases.
        """
        draws = rng.standard_normal((2, 3))
        if self.fixed_biases:
            draws = np.sign(draws)
        return self.gyro_bias * draws[0], self.accelerometer_bias * draws[1]

    def bias_histories(
        self,
        biases: tuple[np.ndarray, np.ndarray],
        count: int,
        dt: float,
        rng: np.random.Generator,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the biases (count + 1, 3) at the IMU samples, from those at the start.

        b_{n+1} = e^(−dt/T) b_n + √(1 − e^(−2dt/T)) σ w_n, exact for a Gauss–Markov process.
        """
        histories = []
        laws = (
            (self.gyro_bias, self.gyro_bias_time),
            (self.accelerometer_bias, self.accelerometer_bias_time),
        )
        for start, (sigma, time) in zip(biases, laws, strict=True):
            if math.isinf(time):
                histories.append(np.broadcast_to(start, (count + 1, 3)))
                continue
            keep = math.exp(-dt / time)
            drive = math.sqrt(-math.expm1(-2.0 * dt / time)) * sigma
            driven = np.vstack([start, drive * rng.standard_normal((count, 3))])
            from scipy.signal import lfilter  # not at the top: it loads slowly, few biases drift

            histories.append(lfilter([1.0], [1.0, -keep], driven, axis=0))
        return histories[0], histories[1]

    def corrupt(
        self,
        delta_angles: np.ndarray,
        delta_velocities: np.ndarray,
        biases: tuple[np.ndarray, np.ndarray],
        dt: float,
        rng: np.random.Generator,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the increments (N, 3) that the sensors deliver: measured = true + error.

        ``biases`` are (3,) or (N, 3). White noise of root PSD σ over an interval dt adds σ √dt to
        each increment.
        """
        angle_noise = rng.standard_normal(delta_angles.shape)
        velocity_noise = rng.standard_normal(delta_velocities.shape)
        return (
            delta_angles + biases[0] * dt + self.gyro_root_psd * math.sqrt(dt) * angle_noise,
            delta_velocities
            + biases[1] * dt
            + self.accelerometer_root_psd * math.sqrt(dt) * velocity_noise,
        )

    def distort(
        self, delta_angles: np.ndarray, delta_velocities: np.ndarray, rng: np.random.Generator
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the increments (N, 3) with the scale factors and misalignments of a run."""
        gyro, accelerometer = self.gyro_errors.draw(rng), self.accelerometer_errors.draw(rng)
        return delta_angles @ gyro.T, delta_velocities @ accelerometer.T
