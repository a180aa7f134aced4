"""Typical vehicles for ``ggbench new``, and the clearance of tracks above the ground."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

from .draped_flight import NewFileError, geoid_height_of


class Vehicle(NamedTuple):
    """Typical speed and sensors of a vehicle.

    Attributes
    ----------
    speed_mps : cruise speed [m/s].
    grade : grade of the inertial sensors.
    noise_eotvos : RMS noise of the gradiometer [E], at one measurement per second.
    """

    speed_mps: float
    grade: str
    noise_eotvos: float


VEHICLES: Mapping[str, Vehicle] = {
    "aircraft": Vehicle(60.0, "navigation", 1.0),
    "helicopter": Vehicle(50.0, "tactical", 1.0),
    "drone": Vehicle(20.0, "tactical", 5.0),
    "ship": Vehicle(8.0, "navigation", 1.0),
}
"""Vehicles by name.

The values are those of the shipped scenarios jacksboro_helicopter, jacksboro_drone and gnss_outage.
"""


def imu_table(vehicle: str) -> str:
    """Return the ``[imu]`` table for a vehicle."""
    return f'period_s = 0.05\ngrade = "{VEHICLES[vehicle].grade}"    # usual for a {vehicle}\n'


def clearance_of(
    track: Path, terrain: Path, attributes: Mapping[str, str], clearance: float | None
) -> str:
    """Return a sentence on the height of a track above the ground.

    Parameters
    ----------
    track, terrain : paths of the track and of the terrain; heights of the terrain are above sea
        level.
    attributes : attributes of the map. Without a geoid height in the attributes, the geoid height
        of EGM2008 at the start of the track is used.
    clearance : requested least height above the ground [m].

    Raises
    ------
    NewFileError
        If the track comes closer to the ground than requested.
    TrajectoryError
        If a file is invalid, or the track leaves the terrain.
    """
    import numpy as np  # not at the top: --help loads no numbers

    from ..maps.geoid import geoid_heights
    from ..trajectory.terrain_following import heights
    from ..trajectory.track import TrackLimits, read_track

    flown = read_track(str(track), TrackLimits())
    latitude, longitude, height = (np.asarray(spline(flown.times)) for spline in flown.position)
    stated = geoid_height_of(attributes)
    geoid = (
        float(geoid_heights(np.degrees(latitude[:1]), np.degrees(longitude[:1]))[0])
        if stated is None
        else stated
    )
    above = height - heights(str(terrain), latitude, longitude) - geoid
    least = int(np.argmin(above))
    place = f"least {flown.times[least]:.0f} s after the start"
    if clearance is not None and above[least] < clearance:
        raise NewFileError(
            f"{track} is {above[least]:.0f} m above the ground of {terrain}, {place}; "
            f"--clearance is {clearance:g} m: raise the track"
        )
    return (
        f"The track is {above.min():.0f} to {above.max():.0f} m above the ground of {terrain}, "
        f"{place}; geoid height {geoid:.0f} m"
    )
