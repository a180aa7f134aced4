"""Error of an unaided INS along a flight, by the covariance of the linear error model."""

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
"""Mean radius, which is enough for a size."""
_STEPS = 200
"""Times after the start at which the covariance is given."""


@dataclass(frozen=True)
class InsError:
    """Standard deviations of the position of an INS without aiding.

    Attributes
    ----------
    samples : (K,) of the trajectory, the first and the last included.
    times : (K,) of these samples [s].
    deviations : (K, 3) ENU [m].
    """

    samples: np.ndarray
    times: np.ndarray
    deviations: np.ndarray

    @property
    def horizontal(self) -> np.ndarray:
        """Root sum square of east and north (K,) [m]."""
        return np.asarray(np.hypot(self.deviations[:, 0], self.deviations[:, 1]))

    def linear_until(self, allowed: float) -> float:
        """Return when second-order position errors exceed a length [m]: a time [s]; ∞ if never.

        They are d² / 2R for an INS error d on a sphere of radius R. With a receiver of 3 m, the
        open-loop EKF becomes worse than the closed loop at one to three times this moment. The
        distance d is the growth of the error, because feedback does not reduce the initial error.
        """
        grown = self.horizontal**2 - self.horizontal[0] ** 2
        beyond = grown > 2.0 * EARTH_RADIUS_M * allowed
        return float(self.times[beyond.argmax()]) if beyond.any() else math.inf


def inertial_alone(suite: SensorSuite) -> SensorSuite:
    """Return a suite without aiding: its inertial sensors, prior and altimeter."""
    return replace(
        suite, gradiometer=None, aiding=(), disturbance=None, compensates=False, map_error=()
    )


def ins_error(suite: SensorSuite, trajectory: Trajectory) -> InsError:
    """Return the error of an unaided INS with the inertial sensors, prior and altimeter of a suite.

    It follows from P = Φ P Φᵀ + Q along the truth. Errors without a state, such as scale factors,
    are omitted.
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
