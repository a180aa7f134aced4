"""Gravity-gradient map: gradient tensor and gravity of the disturbing field on a grid."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ..errors import GGBenchError

Array = NDArray[np.float64]


def unknown() -> Array:
    """Return nine NaN (9,): the error of each tensor and gravity component is unknown."""
    return np.full(9, np.nan)


class MapError(GGBenchError):
    """A field or map cannot be computed, or its data cannot be read."""


@dataclass(frozen=True)
class GradientMap:
    """The disturbing field on a grid regular in geodetic latitude, longitude and height.

    In a draped map, heights count from a base surface instead of the ellipsoid.

    Attributes
    ----------
    latitude0, longitude0, height0 : the first node [rad, rad, m]; height0 is above the base
        surface, or above the ellipsoid without a base.
    latitude_step, longitude_step, height_step : distances between nodes [rad, rad, m].
    tensor : gradient tensor without the normal field, (n_lat, n_lon, n_h, 6) [E], ENU.
    gravity_disturbance : gravity vector without the normal field, (n_lat, n_lon, n_h, 3) [m/s²],
        ENU; its gradient is the tensor.
    provenance : source of the map, in words.
    standard_error : (9,) standard errors of the tensor [E] and the gravity disturbance [m/s²]; NaN:
        unknown.
    error_distance : (9,) distance along a track at which the correlation of each component's error
        is 1/e [m]; NaN: unknown.
    base : heights of the base surface above the ellipsoid (n_lat, n_lon) [m]; None: level layers.
    """

    latitude0: float
    longitude0: float
    height0: float
    latitude_step: float
    longitude_step: float
    height_step: float
    tensor: Array
    gravity_disturbance: Array
    provenance: str
    standard_error: Array = field(default_factory=unknown)
    error_distance: Array = field(default_factory=unknown)
    base: Array | None = None
