"""Covariance analysis of an unaided INS along a flight."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from ..ins import strapdown
from ..ins.error_model import POSITION
from ..sensors.aiding import Motion
from ..trajectory.truth import Trajectory
from .sensor_suite import SensorSuite

EARTH_RADIUS_M = 6.371e6
"""Mean radius of the Earth [m]."""
_STEPS = 200
"""Largest number of times after the start at which the covariance is computed."""


@dataclass(frozen=True)
class InsError:
    """Standard deviations of the position error of an INS without aiding.

    Attributes
    ----------
    samples : (K,) indices of samples of the trajectory, including the first and the last.
    times : (K,) times of these samples [s].
    deviations : (K, 3) standard deviations ENU [m].
    """

    samples: np.ndarray
    times: np.ndarray
    deviations: np.ndarray

    @property
    def horizontal(self) -> np.ndarray:
        """Root sum square (K,) of the east and north standard deviations [m]."""
        return np.asarray(np.hypot(self.deviations[:, 0], self.deviations[:, 1]))

    def linear_until(self, allowed: float) -> float:
        """Return the time [s] at which second-order errors exceed ``allowed`` [m]; ∞ if never.

        The second-order error is d² / 2R on a sphere of radius R. Here d is the growth of the
        horizontal position error since the start. The initial error is excluded, because feedback
        does not reduce it. With a GNSS receiver of 3 m noise, the open-loop EKF becomes worse than
        the closed-loop EKF at one to three times the returned time.
        """
        grown = self.horizontal**2 - self.horizontal[0] ** 2
        beyond = grown > 2.0 * EARTH_RADIUS_M * allowed
        return float(self.times[beyond.argmax()]) if beyond.any() else math.inf


def inertial_alone(suite: SensorSuite) -> SensorSuite:
    """Return a suite with only the inertial sensors, prior and altimeter."""
    return replace(
        suite, gradiometer=None, aiding=(), disturbance=None, compensates=False, map_error=()
    )


def ins_error(suite: SensorSuite, trajectory: Trajectory) -> InsError:
    """Return the position error of an INS with the sensors of a suite, but without aiding.

    Inertial sensors, prior and altimeter are those of the suite. The covariance is propagated along
    the truth, P = Φ P Φᵀ + Q. Errors without a state, such as scale factors, are omitted.
    """
    count, alone = len(trajectory.times) - 1, inertial_alone(suite)
    samples = np.unique(np.linspace(0, count, _STEPS + 1).astype(int))
    _, delta_velocities = strapdown.error_free_increments(
        trajectory.positions,
        trajectory.velocities,
        trajectory.attitudes,
        np.zeros((count, 3)),
        trajectory.dt,
    )
    system = alone.system(Motion.of(trajectory), delta_velocities, samples[1:], trajectory.dt)
    cov = alone.prior_cov
    variances = [np.diag(cov)[POSITION]]
    for transition, process_cov in zip(*system, strict=True):
        cov = transition @ cov @ transition.T + process_cov
        variances.append(np.diag(cov)[POSITION])
    return InsError(samples, trajectory.times[samples], np.sqrt(variances))
