"""Errors of the inertial sensors, added to error-free increments."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..numerics.kernels import compiled
from ..numerics.lanes import group_members


@dataclass(frozen=True)
class SensorErrors:
    """Unmodelled errors of a sensor triad: σ of errors drawn once per run.

    Attributes
    ----------
    scale_factor : relative, per axis.
    misalignment : of each axis towards each of the other two [rad].
    """

    scale_factor: float = 0.0
    misalignment: float = 0.0

    def draw(self, rng: np.random.Generator) -> np.ndarray:
        """Return the matrix (3, 3) from true to measured quantities of a triad."""
        draws = rng.standard_normal((3, 3))
        diagonal = np.eye(3, dtype=bool)
        errors = np.where(diagonal, self.scale_factor * draws, self.misalignment * draws)
        return np.asarray(np.eye(3) + errors)


@dataclass(frozen=True)
class Imu:
    """Inertial measurement unit: biases drawn per run, constant or Gauss–Markov, and white noise.

    Attributes
    ----------
    gyro_bias, accelerometer_bias : standard deviation per axis [rad/s], [m/s²].
    gyro_root_psd : white noise [rad/s/√Hz].
    accelerometer_root_psd : [m/s²/√Hz].
    fixed_biases : whether biases are ±σ with a random sign per run and axis, instead of draws from
        N(0, σ²).
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

        They are draws from the stationary distribution.
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
        """Return the biases (count + 1, 3) at the IMU samples, from the initial ones.

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

    @property
    def wanders(self) -> bool:
        """Whether a bias varies."""
        return math.isfinite(self.gyro_bias_time) or math.isfinite(self.accelerometer_bias_time)

    @property
    def distorts(self) -> bool:
        """Whether there are scale factors or misalignments."""
        return (self.gyro_errors, self.accelerometer_errors) != (SensorErrors(), SensorErrors())

    def distort(
        self, delta_angles: np.ndarray, delta_velocities: np.ndarray, rng: np.random.Generator
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the increments (N, 3) with the scale factors and misalignments of a run."""
        gyro, accelerometer = self.gyro_errors.draw(rng), self.accelerometer_errors.draw(rng)
        return delta_angles @ gyro.T, delta_velocities @ accelerometer.T

    def measure(
        self,
        exact: np.ndarray,
        biases: np.ndarray,
        noise: np.ndarray,
        dt: float,
        out: np.ndarray,
    ) -> None:
        """Fill the measured increments (N, 6, LANES) of several runs.

        Measured = true + error. White noise of root PSD σ over an interval dt adds σ √dt to each
        increment.

        Parameters
        ----------
        exact : (R or 1, N, 6) error-free angles and velocities, common to all runs or not.
        biases : (R, B, 6) of gyros and accelerometers, constant (B = 1) or at each sample (B = N).
        noise : (R, 2, N, 3) standard normal numbers, of angles and of velocities.
        dt : [s].
        out : output, of a group of runs.
        """
        roots = np.repeat([self.gyro_root_psd, self.accelerometer_root_psd], 3) * math.sqrt(dt)
        _measure(exact, biases * dt, noise, roots, out)


@compiled
def _measure(
    exact: np.ndarray, biases: np.ndarray, noise: np.ndarray, roots: np.ndarray, out: np.ndarray
) -> None:
    """Run :meth:`Imu.measure`, with what biases and noise add to an increment."""
    group = group_members(0, noise.shape[0])
    for n in range(out.shape[0]):
        for i in range(6):
            root, triad, axis = roots[i], i // 3, i % 3
            for lane in range(out.shape[2]):
                r = group[lane]
                out[n, i, lane] = (
                    exact[r if exact.shape[0] > 1 else 0, n, i]
                    + biases[r, n if biases.shape[1] > 1 else 0, i]
                ) + root * noise[r, triad, n, axis]
