"""Simulated gradiometer errors, also those that no estimator models.

Errors are applied in this order: tilt of the mount, misalignment and scale factors, errors of
rotating disks, drift of the scale factors, bias and drift, white noise, outliers, low-pass filter,
white noise after the filter, dropouts. For errors of the measurement time,
:mod:`ggbench.simulation.gradients` evaluates the tensor at the wrong time.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ...numerics.rotations import rotation_matrix
from ..processes import bursts, gauss_markov, random_walk
from .instrument import Gradiometer, rotate_tensors

_TIMING = 1e-9
"""Tolerance for equal times [s]."""


@dataclass(frozen=True)
class Faults:
    """Errors of a gradiometer other than white noise and modelled biases; σ: standard deviation.

    Attributes
    ----------
    scale_factor : σ of the relative scale-factor error of each channel, drawn once per run.
    scale_drift : root PSD of the random walk of the scale factor of each channel [1/√s].
    misalignment : σ of the rotation of the mount about each mount axis, drawn once per run [rad].
    mount : right-handed rotation of the mount about each mount axis, equal in all runs [rad].
    tilt : σ of the tilt of a level mount about each horizontal axis, a Gauss–Markov process [rad].
    tilt_time : correlation time of the tilt [s].
    doubling : angular rate [rad/s] and acceleration [m/s²]. Each of them alone raises the RMS of
        the white noise to twice its value at rest.
    freedom : degrees of freedom ν of Student's t distribution of the white noise; ∞ for a normal
        distribution.
    outlier_share : probability that a measurement of a channel is an outlier.
    outlier : σ of outliers, one value for all channels or one for each [unit of the channel].
    burst : mean duration of a burst of outliers [s]; 0 for single outliers.
    together : whether an outlier affects all channels of a measurement.
    dropout_share : probability that a measurement, with all channels, is missing.
    dropouts : pairs (start, end) of times between which all measurements are missing [s].
    duty : durations (on, off) of a duty cycle that begins with "on" at the start of the flight [s];
        off = 0: always on.
    clock : σ of the clock error [s], drawn once per run. A clock error rotates the assumed inertial
        axes (Wang et al. 2013, eq. 12).
    jitter : σ of the error of each measurement time [s].
    """

    scale_factor: float = 0.0
    scale_drift: float = 0.0
    misalignment: float = 0.0
    mount: tuple[float, ...] = (0.0, 0.0, 0.0)
    tilt: float = 0.0
    tilt_time: float = math.inf
    doubling: tuple[float, float] = (math.inf, math.inf)
    freedom: float = math.inf
    outlier_share: float = 0.0
    outlier: float | tuple[float, ...] = 0.0
    burst: float = 0.0
    together: bool = False
    dropout_share: float = 0.0
    dropouts: tuple[tuple[float, float], ...] = ()
    duty: tuple[float, float] = (0.0, 0.0)
    clock: float = 0.0
    jitter: float = 0.0

    @property
    def distorts(self) -> bool:
        """Whether scale factors or mount differ from the assumed values."""
        return self.scale_factor > 0.0 or self.misalignment > 0.0 or any(self.mount)

    def mounting(self, rng: np.random.Generator) -> np.ndarray:
        """Return the rotation (3,) of the mount about the mount axes in a run [rad].

        It is the sum of the constant ``mount`` and a random misalignment.
        """
        return np.asarray(self.misalignment * rng.standard_normal(3) + np.array(self.mount))

    def distort(
        self,
        tensors: np.ndarray,
        channels: np.ndarray,
        angles: np.ndarray,
        rng: np.random.Generator,
    ) -> np.ndarray:
        """Return the channels (K, m) [E] of a rotated mount, with scale-factor errors.

        A mount that is rotated by R = exp[angles×] measures Rᵀ Γ R.

        Parameters
        ----------
        tensors : (K, 6) tensors Γ in the assumed mount axes [E].
        channels : (m, 6) rows that map a tensor to the channels.
        angles : (3,) rotation of the mount [rad].
        rng : random numbers of the scale factors.
        """
        turn = np.empty((3, 3))
        rotation_matrix(angles, turn)
        scale = 1.0 + self.scale_factor * rng.standard_normal(len(channels))
        return np.asarray(scale * (rotate_tensors(turn.T, tensors) @ channels.T))

    def tilted(
        self, tensors: np.ndarray, times: np.ndarray, rng: np.random.Generator
    ) -> np.ndarray:
        """Return tensors (K, 6) [E] in a level mount with random tilts about east and north.

        ``tensors`` (K, 6) are those of the mount without tilt, at ``times`` (K,) [s].
        """
        angles = np.zeros((len(times), 3))
        angles[:, :2] = self.tilt * gauss_markov(times, self.tilt_time, 2, rng)
        turns = np.empty((len(times), 3, 3))
        for angle, turn in zip(angles, turns, strict=True):
            rotation_matrix(angle, turn)
        return rotate_tensors(turns, tensors)

    def drifted(self, times: np.ndarray, width: int, rng: np.random.Generator) -> np.ndarray:
        """Return random scale factors (K, width) of ``width`` channels: 1 plus a random walk."""
        return np.asarray(1.0 + random_walk(times, self.scale_drift, width, rng))

    def growth(self, rates: np.ndarray, accelerations: np.ndarray) -> np.ndarray:
        """Return the factors (K,) by which motion increases the RMS noise.

        ``rates`` (K,) [rad/s] and ``accelerations`` (K,) [m/s²] are RMS values over the period of
        each measurement.
        """
        of_rate, of_acceleration = self.doubling
        return np.asarray(1.0 + rates / of_rate + accelerations / of_acceleration)

    def tails(self, shape: tuple[int, ...], rng: np.random.Generator) -> np.ndarray:
        """Return random factors (...) that convert normal noise to Student's t noise.

        The factors are √((ν − 2)/χ²_ν), with ν = ``freedom``. They do not change the variance: a
        normal number divided by √(χ²_ν/ν) has Student's t distribution, with the variance
        ν/(ν − 2).
        """
        return np.sqrt((self.freedom - 2.0) / rng.chisquare(self.freedom, shape))

    @property
    def information(self) -> float:
        """Ratio of the noise's Fisher information to that of normal noise with equal variance.

        The ratio is ν (ν + 1)/((ν − 2)(ν + 3)), with ν = ``freedom``. Student's t distribution of
        scale s has the information (ν + 1)/((ν + 3) s²) and the variance s² ν/(ν − 2).
        """
        nu = self.freedom
        return nu * (nu + 1.0) / ((nu - 2.0) * (nu + 3.0)) if math.isfinite(nu) else 1.0

    def outliers(self, times: np.ndarray, width: int, rng: np.random.Generator) -> np.ndarray:
        """Return random outliers (K, width) to add to measurements [unit of the channel]."""
        chains = 1 if self.together else width
        struck = bursts(times, self.outlier_share, self.burst, chains, rng)
        added = np.asarray(self.outlier) * rng.standard_normal((len(times), width))
        return np.where(struck, added, 0.0)

    def missing(self, times: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Return the mask (K,) of measurements that drop out in a run."""
        lost = rng.random(len(times)) < self.dropout_share
        return np.asarray(lost | self.in_dropouts(times))

    def in_dropouts(self, times: np.ndarray) -> np.ndarray:
        """Return the mask (K,) of times in a declared dropout, or with the duty cycle off."""
        on, off = self.duty
        lost = np.zeros(len(times), dtype=bool)
        if off > 0.0:
            lost |= (times - _TIMING) % (on + off) > on  # a reading at the end of "on" is there
        for start, end in self.dropouts:
            lost |= (times > start - _TIMING) & (times < end + _TIMING)
        return lost

    def expected_share(self, times: np.ndarray) -> np.ndarray:
        """Return the expected fraction (K,) of the runs in which each measurement is available."""
        return np.where(self.in_dropouts(times), 0.0, 1.0 - self.dropout_share)


def biases(
    gradiometer: Gradiometer, channels: int, times: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """Return the random biases (K, m) of a run at the epochs [E].

    Each bias is a random initial value plus a random walk.
    """
    start = gradiometer.bias_eotvos * rng.standard_normal(channels)
    return np.asarray(start + random_walk(times, gradiometer.drift, channels, rng))
