"""Tracks of a user's own, as tables of text."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from ggbench.spec.trajectory import TrajectorySpec

NAMES = "time_s,latitude_deg,longitude_deg,height_m"


def write(path: Path, rows: np.ndarray, names: str = NAMES, decimals: int = 10) -> str:
    """Write a track and return its path."""
    path.write_text(table(rows, names, decimals))
    return str(path)


def table(rows: np.ndarray, names: str = NAMES, decimals: int = 10) -> str:
    lines = (",".join(f"{value:.{decimals}f}" for value in row) for row in rows)
    return "\n".join([names, *lines, ""])


def read(path: str, **limits: float | str) -> TrajectorySpec:
    return TrajectorySpec.model_validate({"file": path} | limits)


ROWS = [f"{t},{33.0 + 1e-3 * t:.6f},{108.0 + 1e-3 * t:.6f},{3000.0 + 0.1 * t}" for t in range(20)]


def text(rows: list[str] = ROWS, names: str = NAMES) -> str:
    return "\n".join([names, *rows]) + "\n"


def with_row(row: str) -> str:
    """The track with another fourth row, on line 5."""
    return text([*ROWS[:3], row, *ROWS[4:]])


SLOW = [f"{t},{33.0 + 1e-5 * t:.6f},108.0,3000.0" for t in range(20)]
WHIRL = text([f"{row},{60 * n % 360}" for n, row in enumerate(SLOW)], NAMES + ",heading")
"""Turns of 60° from second to second."""
NEAR_ZERO = [f"{t},{1.6 + 1e-3 * t:.6f},{3.0 + 1e-3 * t:.6f},3000.0" for t in range(20)]
"""Degrees that are a little too large for radians."""


def curve(heading: Callable[[np.ndarray], np.ndarray], speed: float = 60.0) -> np.ndarray:
    """Rows of a minute, with courses of 60° to 119° and a column of what is made of them."""
    times = np.arange(60.0)
    course = 60.0 + times
    step = speed * np.array([np.cos(np.radians(course)), np.sin(np.radians(course))])
    north, east = np.degrees(np.cumsum(step, axis=1) / 6.38e6)
    return np.column_stack([times, north, east, 500.0 + 0.0 * times, heading(course)])


def bare_angles() -> np.ndarray:
    """Rows to the north with yaw, pitch and roll that could be radians."""
    rows = np.column_stack([curve(lambda course: 0.0 * course + 0.1), np.zeros((60, 2))])
    rows[:, 1:3] = np.column_stack([30.0 + 1e-3 * rows[:, 0], 0.0 * rows[:, 0]])
    rows[:, 5] = 0.02
    return rows
