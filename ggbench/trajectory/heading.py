"""Test of the headings of a track against the course over ground."""

from __future__ import annotations

import math

import numpy as np

from .manoeuvres import Array, TrajectoryError

FAST = 5.0
"""Smallest speed at which the course over ground is compared with the heading [m/s]."""
LARGEST = 45.0
"""Largest median angle between heading and course [deg]; wind and current cause a crab angle."""
_FEWEST = 5  # fast rows below which nothing is said
_CONVENTIONS = {
    "measured counter-clockwise from east (as in ROS and ENU): heading_deg is 90 - yaw": (
        90.0,
        -1.0,
    ),
    "measured counter-clockwise from north: change its sign": (0.0, -1.0),
    "measured clockwise from east: add 90": (90.0, 1.0),
    "of the stern, or measured from south: add 180": (180.0, 1.0),
    "in radians": (0.0, math.degrees(1.0)),
    "in radians, counter-clockwise from east: heading_deg is 90 - degrees(yaw)": (
        90.0,
        -math.degrees(1.0),
    ),
}
"""Likely conventions: (offset [deg], factor), with heading = offset + factor · column."""


def require_heading(heading: Array, velocity: Array) -> None:
    """Raise TrajectoryError if headings contradict the course over ground.

    They contradict it if the median angle between heading and course exceeds :data:`LARGEST`. Only
    rows with speeds above :data:`FAST` are used. Fewer than five such rows raise no error.

    ``heading`` (N,) [deg] is in the convention of the file; ``velocity`` (N, 3) is ENU [m/s]. The
    message names a convention that would agree, if there is one.
    """
    fast = np.hypot(velocity[:, 0], velocity[:, 1]) > FAST
    if np.count_nonzero(fast) < _FEWEST:
        return
    course = np.degrees(np.arctan2(velocity[fast, 0], velocity[fast, 1]))
    apart = _apart(heading[fast], course)
    if apart <= LARGEST:
        return
    fits = {
        name: round(_apart(add + factor * heading[fast], course))
        for name, (add, factor) in _CONVENTIONS.items()
    }
    likely = min(fits, key=lambda name: fits[name])
    advice = (
        f"it seems to be {likely}" if fits[likely] <= LARGEST else "is it from another vehicle?"
    )
    raise TrajectoryError(
        f"heading_deg differs by {apart:.0f}° (median) from the course over ground at speeds "
        f"above {FAST:g} m/s; at most {LARGEST:g}° are allowed; headings are degrees clockwise "
        f"from north: {advice}"
    )


def _apart(heading: Array, course: Array) -> float:
    """Return the median angle between headings and courses (N,) [deg]."""
    return float(np.median(np.abs((heading - course + 180.0) % 360.0 - 180.0)))
