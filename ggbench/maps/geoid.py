"""Heights above sea level as heights above the ellipsoid, by the shipped part of EGM2008."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ..gravity.ellipsoid import normal_gravity
from ..gravity.harmonics import HarmonicCoefficients, potential
from .shipped_parts import COEFFICIENTS, disturbing_coefficients

Array = NDArray[np.floating]

_ZERO_DEGREE = -0.41
"""Geoid height of degree 0, from EGM2008's mass and potential to those of WGS84 [m]."""
_MOST_NODES = 50
"""Places along a track at which the series is summed: it changes over 160 km and more."""


def geoid_heights(latitude: Array, longitude: Array) -> Array:
    """Return heights of the geoid above the ellipsoid (N,) [m] along a track (N,) [deg].

    Bruns' formula with EGM2008 to degree 120: within 1 m over flat land, and a few metres in
    mountains, where short waves are missing.
    """
    rows = np.arange(len(latitude))
    nodes = np.unique(np.linspace(0, len(rows) - 1, min(len(rows), _MOST_NODES)).round())
    found = [_geoid_height(latitude[int(n)], longitude[int(n)]) for n in nodes]
    return np.asarray(np.interp(rows, nodes, found))


def _geoid_height(latitude: float, longitude: float) -> float:
    place = np.radians([[latitude], [longitude]])
    disturbing = float(potential(_disturbing(), place[0], place[1], [0.0])[0, 0, 0])
    gravity = float(normal_gravity(float(place[0, 0]), 0.0)[0])
    return disturbing / gravity + _ZERO_DEGREE


@lru_cache(maxsize=1)
def _disturbing() -> HarmonicCoefficients:
    return disturbing_coefficients(COEFFICIENTS)
