"""Central differences of a shipped region's field, in axes that do not turn."""

from __future__ import annotations

import math

import numpy as np
from shipped_fields import disturbing_field

from ggbench.gravity import ellipsoid

SYMMETRIC = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])  # (i, j) -> place in the six components


def metres(latitude: float, height: float) -> tuple[float, float]:
    """Return the metres per radian of longitude and of latitude."""
    meridian, prime_vertical = ellipsoid.radii_of_curvature(latitude)
    return (prime_vertical + height) * math.cos(latitude), meridian + height


def ecef_axes(latitude: float, longitude: float) -> np.ndarray:
    """Return C_en: columns are east, north and up in the Earth-fixed frame."""
    sl, cl, so, co = (
        math.sin(latitude),
        math.cos(latitude),
        math.sin(longitude),
        math.cos(longitude),
    )
    return np.array([[-so, -sl * co, cl * co], [co, -sl * so, cl * so], [0.0, cl, sl]])


def derivatives_at(source, latitude, longitude, height, step_m):
    """Return central differences of a source's field along east, north and up.

    The tensor (3, 3), and the derivatives of gravity (3, 3) and of the tensor (3, 3, 3); the last
    axis is the direction, the others are the axes of the central point.
    """
    per_lon, per_lat = metres(latitude, height)
    centre = np.array([latitude, longitude, height])
    lats, lons, heights = (
        x + step * np.array([-1.0, 0.0, 1.0])
        for x, step in zip(centre, (step_m / per_lat, step_m / per_lon, step_m), strict=True)
    )
    tensor, vector = disturbing_field(source, lats, lons, heights)
    home = ecef_axes(latitude, longitude)

    def in_home_axes(i, j, k):
        turn = home.T @ ecef_axes(lats[i], lons[j])
        return turn @ vector[i, j, k], turn @ tensor[i, j, k][SYMMETRIC] @ turn.T

    east_north_up = [((1, 2, 1), (1, 0, 1)), ((2, 1, 1), (0, 1, 1)), ((1, 1, 2), (1, 1, 0))]
    pairs = [(in_home_axes(*ahead), in_home_axes(*behind)) for ahead, behind in east_north_up]
    d_vector, d_tensor = (
        np.stack([(ahead[n] - behind[n]) / (2.0 * step_m) for ahead, behind in pairs], axis=-1)
        for n in (0, 1)
    )
    return in_home_axes(1, 1, 1)[1], d_vector, d_tensor
