"""An INS without errors, which follows the truth but for rounding."""

from __future__ import annotations

import numpy as np

from ggbench.gravity import ellipsoid
from ggbench.ins import strapdown
from ggbench.trajectory.truth import Trajectory


def closure(truth: Trajectory) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """ENU position error [m], velocity error [m/s], attitude error [rad] of an error-free INS."""
    increments = strapdown.error_free_increments(
        truth.positions,
        truth.velocities,
        truth.attitudes,
        np.zeros((len(truth.times) - 1, 3)),
        truth.dt,
    )
    positions, velocities, attitudes = strapdown.navigate(
        truth.positions[0], truth.velocities[0], truth.attitudes[0], *increments, truth.dt
    )
    north, east = ellipsoid.radii_of_curvature(np.radians(33.5))
    difference = (positions - truth.positions)[:, [1, 0, 2]] * [east, north, 1.0]
    turn = attitudes @ truth.attitudes.transpose(0, 2, 1)
    return difference, velocities - truth.velocities, np.abs(turn - np.eye(3)).max(axis=(1, 2))
