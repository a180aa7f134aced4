"""Flights of manoeuvres as a scenario asks for them."""

from __future__ import annotations

from typing import Any

import numpy as np

from ggbench.spec.trajectory import TrajectorySpec
from ggbench.trajectory.truth import Trajectory

START = {
    "latitude_deg": 33.5,
    "longitude_deg": 108.0,
    "height_m": 3000.0,
    "speed_mps": 200.0,
    "heading_deg": 90.0,
}


def spec(*segments: dict[str, Any], **changes: Any) -> TrajectorySpec:
    return TrajectorySpec.model_validate(START | {"segment": list(segments)} | changes)


def vertical_acceleration(flight: Trajectory) -> np.ndarray:
    return np.diff(flight.velocities[:, 2]) / flight.dt
