"""Oblique stereographic projection of WGS84: a conformal plane for a few hundred kilometres.

The projection preserves angles. At the distance ρ from the centre, lengths on the plane exceed true
lengths by the fraction ρ²/(4R²). R is the Earth's radius; the fraction is 7.5e-5 at 110 km.
Therefore one Fourier series can cover a whole region, without a division into bands of latitude.
Equations: Snyder (1987), Map Projections, eqs. 3-1, 21-24, 21-25 and 21-27; plane axes x = east and
y = north at the centre.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..numerics.kernels import compiled
from .ellipsoid import ECCENTRICITY_SQUARED, radii_of_curvature

_ECCENTRICITY = math.sqrt(ECCENTRICITY_SQUARED)
_LARGEST_SINE = 1.0 - 1e-15  # the isometric latitude of a pole is infinite


class Plane(NamedTuple):
    """A stereographic plane, true to scale at its centre.

    Attributes
    ----------
    longitude : longitude of the centre [rad].
    sine, cosine : sine and cosine of the conformal latitude of the centre.
    diameter : diameter of the sphere that the plane touches [m].
    """

    longitude: float
    sine: float
    cosine: float
    diameter: float


def plane_at(latitude: float, longitude: float) -> Plane:
    """Return the stereographic plane that touches the ellipsoid at a position [rad]."""
    sine = _conformal_sine(latitude)
    cosine = math.sqrt(1.0 - sine * sine)
    _, prime_vertical = radii_of_curvature(latitude)
    return Plane(longitude, sine, cosine, 2.0 * prime_vertical * math.cos(latitude) / cosine)


@compiled
def _conformal_sine(latitude: float) -> float:
    sine = min(max(math.sin(latitude), -_LARGEST_SINE), _LARGEST_SINE)
    return math.tanh(math.atanh(sine) - _ECCENTRICITY * math.atanh(_ECCENTRICITY * sine))


@compiled
def to_plane(latitude: float, longitude: float, plane: Plane) -> tuple[float, float, float, float]:
    """Project a position [rad] to the plane: x, y [m] and the direction of east on the plane.

    The direction is the x and y component of the unit vector to the east.
    """
    sine = _conformal_sine(latitude)
    cosine = math.sqrt(1.0 - sine * sine)
    sin_l, cos_l = math.sin(longitude - plane.longitude), math.cos(longitude - plane.longitude)
    denominator = 1.0 + plane.sine * sine + plane.cosine * cosine * cos_l
    scale = plane.diameter / denominator
    x = scale * cosine * sin_l
    y = scale * (plane.cosine * sine - plane.sine * cosine * cos_l)
    # The derivative along the parallel; the map is conformal, so its direction is all there is.
    growth = plane.cosine * cosine * sin_l / denominator
    east_x = growth * x + scale * cosine * cos_l
    east_y = growth * y + scale * plane.sine * cosine * sin_l
    norm = math.hypot(east_x, east_y)
    return x, y, east_x / norm, east_y / norm


@compiled
def from_plane(x: float, y: float, plane: Plane) -> tuple[float, float]:
    """Return latitude and longitude [rad] of a point (x, y) [m] of the plane.

    The longitude is within π of the longitude of the centre.
    """
    rho = math.hypot(x, y)
    if rho == 0.0:
        sine, difference = plane.sine, 0.0
    else:
        c = 2.0 * math.atan(rho / plane.diameter)
        sin_c, cos_c = math.sin(c), math.cos(c)
        sine = cos_c * plane.sine + y * sin_c * plane.cosine / rho
        difference = math.atan2(x * sin_c, rho * plane.cosine * cos_c - y * plane.sine * sin_c)
    isometric = math.atanh(min(max(sine, -_LARGEST_SINE), _LARGEST_SINE))
    geodetic = sine
    for _ in range(5):  # each step gains two digits, e² being 0.0067
        geodetic = math.tanh(isometric + _ECCENTRICITY * math.atanh(_ECCENTRICITY * geodetic))
    return math.asin(geodetic), plane.longitude + difference


def scale_factor(latitude: float, longitude: float, plane: Plane) -> float:
    """Return the ratio of a length on the plane to the true length, at a position [rad]."""
    sine = _conformal_sine(latitude)
    cosine = math.sqrt(1.0 - sine * sine)
    denominator = (
        1.0 + plane.sine * sine + plane.cosine * cosine * math.cos(longitude - plane.longitude)
    )
    _, prime_vertical = radii_of_curvature(latitude)
    return float(plane.diameter * cosine / (denominator * prime_vertical * np.cos(latitude)))
