"""Inertial sensors: errors that are added to error-free increments."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..numerics.kernels import compiled
from ..numerics.lanes import group_members


@dataclass(frozen=True)
class SensorErrors:
    """Standard deviations of the constant errors of a sensor triad, drawn once per run.

    Estimators do not model these errors.

    Attributes
    ----------
    scale_factor : relative scale-factor error of each axis.
    misalignment : misalignment of each axis towards each of the other two axes [rad].
    """

    scale_factor: float = 0.0
    misalignment: float = 0.0

    def draw(self, rng: np.random.Generator) -> np.ndarray:
        """Return a random matrix (3, 3) that maps true to measured values of the triad."""
        draws = rng.standard_normal((3, 3))
        diagonal = np.eye(3, dtype=bool)
        errors = np.where(diagonal, self.scale_factor * draws, self.misalignment * draws)
        return np.asarray(np.eye(3) + errors)


@dataclass(frozen=True)
class Imu:
    """Inertial measurement unit with white noise and constant or Gauss–Markov biases.

    Attributes
    ----------
    gyro_bias, accelerometer_bias : standard deviation σ of the bias of each axis [rad/s], [m/s²].
    gyro_root_psd : root PSD of the gyros' white noise [rad/s/√Hz].
    accelerometer_root_psd : root PSD of the accelerometers' white noise [m/s²/√Hz].
    fixed_biases : whether a bias is +σ or −σ with a random sign for each run and axis, instead of a
        random number from N(0, σ²).
    gyro_bias_time, accelerometer_bias_time : correlation time T of a bias that is a first-order
        Gauss–Markov process [s]; infinite for a constant bias.
    gyro_errors, accelerometer_errors : scale-factor errors and misalignments of the two triads.
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

        The biases are random numbers from N(0, σ²), the stationary distribution of a Gauss–Markov
        bias. With ``fixed_biases`` they are +σ or −σ.
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
        """Return gyro and accelerometer biases (count + 1, 3) at the IMU samples of a run.

        The first sample has the given ``biases``. Then b_{n+1} = e^(−dt/T) b_n + √(1 − e^(−2dt/T))
        σ w_n with w_n ~ N(0, 1), which is exact for a Gauss–Markov process. ``dt`` is the IMU
        interval [s].
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
        """Whether any bias varies with time."""
        return math.isfinite(self.gyro_bias_time) or math.isfinite(self.accelerometer_bias_time)

    @property
    def distorts(self) -> bool:
        """Whether there are scale-factor errors or misalignments."""
        return (self.gyro_errors, self.accelerometer_errors) != (SensorErrors(), SensorErrors())

    def distort(
        self, delta_angles: np.ndarray, delta_velocities: np.ndarray, rng: np.random.Generator
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return increments (N, 3) with random scale-factor errors and misalignments."""
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
        """Fill ``out`` (N, 6, LANES) with the measured increments of a group of runs.

        White noise with root PSD σ adds a random number of standard deviation σ √dt to each
        increment over the interval dt.

        Parameters
        ----------
        exact : (R or 1, N, 6) error-free increments of angle and velocity; R = 1 if all runs have
            equal increments.
        biases : (R, B, 6) biases of gyros and accelerometers, constant (B = 1) or at each sample (B
            = N).
        noise : (R, 2, N, 3) standard normal numbers, for angles and for velocities.
        dt : IMU interval [s].
        out : (N, 6, LANES) output.
        """
        roots = np.repeat([self.gyro_root_psd, self.accelerometer_root_psd], 3) * math.sqrt(dt)
        _measure(exact, biases * dt, noise, roots, out)


@compiled
def _measure(
    exact: np.ndarray, biases: np.ndarray, noise: np.ndarray, roots: np.ndarray, out: np.ndarray
) -> None:
    """Run :meth:`Imu.measure` with biases and noise of increments.

    ``biases`` are multiplied by dt. ``roots`` (6,) are standard deviations of the noise of
    increments.
    """
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
