"""Translation and rotation of tracks."""

from __future__ import annotations

import math

import numpy as np
from scipy.interpolate import CubicSpline, PchipInterpolator

from ..gravity.ellipsoid import metres_per_radian
from .manoeuvres import Array, TrajectoryError
from .track import Track

_HIGHEST_LATITUDE = math.radians(89.0)


def moved_track(track: Track, east: float, north: float, turn: float) -> Track:
    """Return a track that is moved to another start and rotated about the new start.

    Heights and times are unchanged. The motion is a rigid rotation on a sphere, so angles within
    the track are unchanged. Lengths change because of the Earth's flattening. The change is at most
    0.7 %, for a move between pole and equator.

    Parameters
    ----------
    track : the track.
    east, north : displacement of the start [m].
    turn : clockwise rotation at the start [rad].

    Raises
    ------
    TrajectoryError
        If the moved track comes closer than 1° to a pole.
    """
    times = track.times
    latitude, longitude, height = (np.asarray(spline(times)) for spline in track.position)
    start = np.array([latitude[0], longitude[0], height[0]])
    place = start[:2] + np.array([north, east]) / metres_per_radian(start)
    if abs(place[0]) > _HIGHEST_LATITUDE:
        raise TrajectoryError("the moved track starts closer than 1° to a pole")
    old, new = _frames(latitude[:1], longitude[:1])[0], _frames(*place[:, np.newaxis])[0]
    cos, sin = math.cos(turn), math.sin(turn)
    clockwise = np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])
    rotation = new @ clockwise @ old.T
    frames = rotation @ _frames(latitude, longitude)
    up = frames[:, :, 2]
    latitudes = np.arcsin(np.clip(up[:, 2], -1.0, 1.0))
    if np.abs(latitudes).max() > _HIGHEST_LATITUDE:
        raise TrajectoryError("the moved track comes closer than 1° to a pole")
    longitudes = np.unwrap(np.arctan2(up[:, 1], up[:, 0]))
    longitudes += math.tau * round((place[1] - longitudes[0]) / math.tau)
    # The old north of each row in the new axes: by its azimuth all headings of the row grow.
    north_east = np.swapaxes(_frames(latitudes, longitudes), 1, 2) @ frames[:, :, 1:2]
    growth = np.unwrap(np.arctan2(north_east[:, 0, 0], north_east[:, 1, 0]))
    heading, *others = track.angles
    if heading is not None:
        heading = PchipInterpolator(times, np.asarray(heading(times)) + growth)
    position = tuple(CubicSpline(times, values) for values in (latitudes, longitudes, height))
    return Track(times, position, (heading, *others), track.remark)


def _frames(latitude: Array, longitude: Array) -> Array:
    """Return the axes east, north and up as columns (N, 3, 3), at points (N,) of a sphere [rad]."""
    zero = np.zeros_like(latitude)
    east = np.stack([-np.sin(longitude), np.cos(longitude), zero], axis=-1)
    up = np.stack(
        [
            np.cos(latitude) * np.cos(longitude),
            np.cos(latitude) * np.sin(longitude),
            np.sin(latitude),
        ],
        axis=-1,
    )
    return np.stack([east, np.cross(up, east), up], axis=-1)
