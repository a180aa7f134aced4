"""Flights of manoeuvres as a scenario asks for them."""

from __future__ import annotations

from pathlib import Path
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


FOLLOWING = {"kind": "terrain-following", "clearance_m": 150.0, "distance_km": 60.0}
"""A segment that follows terrain, without its file."""


def ridges(name: str, latitude: np.ndarray, longitude: np.ndarray) -> np.ndarray:
    """Mountains of 5 to 20 km from crest to crest, in metres."""
    east = (np.degrees(longitude) - 108.0) * 92.8e3
    return 900.0 + 500.0 * np.sin(east / 3000.0) + 150.0 * np.cos(east / 800.0)


def quarter_of_voids(path: Path) -> Path:
    """Write a terrain whose south-western quarter is a void."""
    height = np.full((60, 100), 250.0)
    height[:30, :50] = np.nan
    axes = [first + 0.01 * np.arange(count) for first, count in ((33.0, 60), (108.0, 100))]
    np.savez(path, lat=axes[0], lon=axes[1], z=height)
    return path
