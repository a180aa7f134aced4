"""Geoid heights from the shipped part of EGM2008.

They convert heights above sea level to heights above the ellipsoid.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RectBivariateSpline

from ..gravity.ellipsoid import normal_gravity
from ..gravity.harmonics import HarmonicCoefficients, potential
from .shipped_parts import COEFFICIENTS, disturbing_coefficients

Array = NDArray[np.float64]

_ZERO_DEGREE = -0.41
"""Zero-degree term of the geoid height, from the GM and W0 of EGM2008 and of WGS84 [m]."""
_MOST_NODES = 50
"""Number of track points at which the series is summed; its shortest half wave is 160 km."""

_STEP_DEG, _MARGIN_DEG, _FEWEST_NODES = 0.5, 0.05, 4
"""Node spacing of a grid, which resolves degree 120; margin; smallest number of nodes."""


def geoid_heights(latitude: Array, longitude: Array) -> Array:
    """Return heights (N,) [m] of the geoid above the ellipsoid along a track.

    ``latitude`` (N,) and ``longitude`` (N,) are in degrees. The method is Bruns' formula with
    EGM2008 to degree 120. Higher degrees are omitted, so the error is up to 1 m over flat land, and
    a few metres in mountains.
    """
    rows = np.arange(len(latitude))
    nodes = np.unique(np.linspace(0, len(rows) - 1, min(len(rows), _MOST_NODES)).round())
    at = nodes.astype(int)
    # All pairs of latitude and longitude: the Legendre functions cost far more than the sums.
    heights = _grid_of_heights(*(np.asarray(axis)[at] for axis in (latitude, longitude))).diagonal()
    return np.asarray(np.interp(rows, nodes, heights))


def geoid_over(latitude: Array, longitude: Array) -> Array:
    """Return heights (N,) [m] of the geoid above the ellipsoid at positions.

    ``latitude`` (N,) and ``longitude`` (N,) are in degrees. The heights at the nodes of a grid that
    covers the positions are computed as in :func:`geoid_heights`. The results are interpolated
    between these nodes.
    """
    axes = [_axis(places) for places in (latitude, longitude)]
    heights = _grid_of_heights(*axes)
    return np.asarray(RectBivariateSpline(*axes, heights).ev(latitude, longitude))


def _axis(places: Array) -> Array:
    """Return nodes [deg] that cover ``places`` [deg] with a spacing that resolves degree 120."""
    first, last = float(places.min()) - _MARGIN_DEG, float(places.max()) + _MARGIN_DEG
    count = math.ceil((last - first) / _STEP_DEG) + 1
    return np.linspace(first, last, max(count, _FEWEST_NODES))


def _grid_of_heights(latitude: Array, longitude: Array) -> Array:
    """Return geoid heights (n, m) [m] at all pairs of latitudes (n,) and longitudes (m,) [deg]."""
    parallels, meridians = np.radians(latitude), np.radians(longitude)
    disturbing = potential(_disturbing(), parallels, meridians, [0.0])[:, :, 0]
    gravity = np.array([normal_gravity(parallel, 0.0)[0] for parallel in parallels.tolist()])
    return np.asarray(disturbing / gravity[:, np.newaxis] + _ZERO_DEGREE)


@lru_cache(maxsize=1)
def _disturbing() -> HarmonicCoefficients:
    return disturbing_coefficients(COEFFICIENTS)
