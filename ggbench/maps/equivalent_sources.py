"""Equivalent sources: point masses fitted to survey lines by damped least squares.

The masses lie on a regular grid at one depth below the flights (Dampney 1969,
doi:10.1190/1.1439996). Their field is harmonic above the masses, so all components of a map are
consistent. Each line and component has an unknown constant, because processed gradients have zero
mean along a line. The constants are eliminated: measurements and modelled values are deviations
from their means over a line.

The area is assumed to be flat. The edges of an area that is 50 km wide deviate by 50 m from the
plane that touches the Earth in the middle. For an area of 20 km the deviation is 8 m.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import LinAlgError, cho_factor, cho_solve
from scipy.linalg.blas import dsyrk
from scipy.spatial import cKDTree

from ..gravity.ellipsoid import radii_of_curvature
from ..gravity.gradient_map import MapError
from ..gravity.point_masses import fields, responses
from .netcdf import Layer, Nodes
from .survey_lines import COMPONENTS, SurveyLines

Array = NDArray[np.float64]

WIDEST_M = 150e3
"""Largest extent of a survey for the plane approximation."""
MOST_SOURCES = 7000
"""Largest number of masses; the computing time grows with the third power of the number."""
_MGAL = 1e5  # in a metre per square second
_BLOCK = 0.3  # of the depth: the field hardly changes over it, and noise is averaged
_REACH = 2.0  # depths: masses farther from every sample are left out
_NEAREST = 16  # samples whose mean height is that of the flights above a mass


class Settings(NamedTuple):
    """Settings of a fit: depth and spacing of the point masses [m], relative damping.

    The depth is below the flights. The damping is relative to the mean of the diagonal of the
    normal equations.
    """

    depth_m: float
    spacing_m: float
    damping: float

    def __str__(self) -> str:
        return (
            f"point masses {self.spacing_m:.0f} m apart, {self.depth_m:.0f} m below the flights, "
            f"damping {self.damping:.2g}"
        )


@dataclass(frozen=True)
class Plane:
    """Plane that touches the ellipsoid at a point, with east and north coordinates [m]."""

    latitude_deg: float
    longitude_deg: float

    @classmethod
    def under(cls, lines: SurveyLines) -> Plane:
        """Return the plane at the middle of survey lines.

        Raises MapError if the lines extend too far for a plane.
        """
        middles = [0.5 * (v.min() + v.max()) for v in (lines.latitude_deg, lines.longitude_deg)]
        plane = cls(*map(float, middles))
        widest = max(float(np.ptp(axis)) for axis in plane.metres(lines)[:2])
        if widest > WIDEST_M:
            raise MapError(
                f"the survey is {widest / 1e3:.0f} km wide; the plane approximation allows "
                f"{WIDEST_M / 1e3:.0f} km: leave lines out, or build several maps."
            )
        return plane

    @property
    def metres_per_degree(self) -> tuple[float, float]:
        """Metres per degree of latitude and per degree of longitude."""
        meridian, prime_vertical = radii_of_curvature(math.radians(self.latitude_deg))
        cosine = math.cos(math.radians(self.latitude_deg))
        return math.radians(meridian), math.radians(prime_vertical * cosine)

    def place(
        self, latitude_deg: NDArray[np.floating], longitude_deg: NDArray[np.floating]
    ) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
        """Return east coordinates (...) and north coordinates (...) in the plane [m].

        East coordinates have the shape of the longitudes, north coordinates that of the latitudes.
        """
        north, east = self.metres_per_degree
        return (
            (longitude_deg - self.longitude_deg) * east,
            (latitude_deg - self.latitude_deg) * north,
        )

    def metres(self, lines: SurveyLines) -> Array:
        """Return east, north and height (3, N) [m] of the samples of survey lines."""
        return np.array([*self.place(lines.latitude_deg, lines.longitude_deg), lines.height_m])


@dataclass(frozen=True)
class EquivalentSources:
    """Map part: the field of m point masses.

    Attributes
    ----------
    plane : plane with the east and north coordinates.
    places : (3, m) east and north coordinates and heights of the masses [m].
    masses : (m,) masses [1e9 kg].
    """

    plane: Plane
    places: Array
    masses: Array

    def along(self, lines: SurveyLines, samples: NDArray[np.int64]) -> Array:
        """Return the field (n, c) of the masses at n samples, in the c components of ``lines``."""
        return self._fields(self.plane.metres(lines)[:, samples]) @ weights_of(lines).T

    def layers(self, nodes: Nodes) -> Iterator[Layer]:
        """Yield tensor (n_lat, n_lon, 6) and gravity disturbance (n_lat, n_lon, 3) per layer."""
        east, north = self.plane.place(nodes.latitude_deg, nodes.longitude_deg)
        for height in nodes.height_m:
            points = np.array([axis.ravel() for axis in np.meshgrid(east, north, height)])
            values = self._fields(points).reshape(north.size, east.size, 9)
            yield values[..., :6], values[..., 6:]

    def _fields(self, points: Array) -> Array:
        values = np.empty((points.shape[1], 9))
        fields(points, self.places, self.masses, values)
        return values


def weights_of(lines: SurveyLines) -> Array:
    """Return the weights (c, 9) that compute the c components of ``lines`` from nine inputs.

    The inputs are six gradients [E] and three components of gravity [m/s²].
    """
    weights = np.zeros((len(lines.components), 9))
    if lines.quantity == "disturbance":
        weights[0, 8] = -_MGAL
    else:
        weights[:, :6] = [COMPONENTS[name] for name in lines.components]
    return weights


class Equations:
    """Normal equations of survey lines, for J masses at one depth and spacing.

    Samples are averaged over blocks with a length of three tenths of the depth.

    Raises MapError if there are too many masses.
    """

    def __init__(self, lines: SurveyLines, depth_m: float, spacing_m: float) -> None:
        self.lines = lines
        self.plane = Plane.under(lines)
        points = self.plane.metres(lines)
        self.places = _grid(points, depth_m, spacing_m)
        self._points = points
        self._block_m = _BLOCK * depth_m

    def of(self, chosen: Sequence[int]) -> tuple[Array, Array]:
        """Return the summed normal equations of the lines with indices ``chosen``.

        The results are a matrix (J, J) and the right side (J,), where J is the number of masses.
        Only the upper triangle of the matrix is set.
        """
        count = self.places.shape[1]
        matrix, right = np.zeros((count, count), order="F"), np.zeros(count)
        weights = weights_of(self.lines)
        for index in chosen:
            samples = self.lines.samples(index)
            points, values = self._points[:, samples], self.lines.values[samples]
            step = np.median(np.hypot(*np.diff(points[:2], axis=1)))
            size = max(1, int(self._block_m / max(step, 1e-3)))
            points, values = _blocks(points.T, size).T, _blocks(values, size)
            design = np.empty((len(weights), points.shape[1], count))
            responses(points, self.places, weights, design)
            design -= design.mean(axis=1, keepdims=True)
            rows = design.reshape(-1, count)
            # The upper triangle alone, in place: half the work.
            matrix = dsyrk(1.0, rows.T, 1.0, matrix, overwrite_c=True)
            right += rows.T @ (values - values.mean(axis=0)).T.ravel()
        return matrix, right

    def solved(self, matrix: Array, right: Array, damping: float) -> EquivalentSources:
        """Return the J masses that solve damped normal equations.

        ``matrix`` (J, J) and ``right`` (J,) are the equations of :meth:`of`. ``damping`` is
        relative to the mean of the diagonal.

        Raises MapError if the damping is too small to determine the masses.
        """
        damped = matrix.copy(order="F")
        damped[np.diag_indices_from(damped)] += damping * np.trace(matrix) / len(matrix)
        try:
            factor = cho_factor(damped, overwrite_a=True, check_finite=False)
        except LinAlgError:
            raise MapError(
                f"with a damping of {damping:g}, the normal equations of the point masses are not "
                "positive definite: increase --damping."
            ) from None
        masses = cho_solve(factor, right, check_finite=False)
        return EquivalentSources(self.plane, self.places, masses)


def residuals(sources: EquivalentSources, lines: SurveyLines, index: int) -> Array:
    """Return the residuals (n, components) of line ``index``: measurement minus map.

    The mean residual of each component is subtracted. n is the number of samples of the line.
    """
    samples = lines.samples(index)
    differences: Array = lines.values[samples] - sources.along(lines, samples)
    return differences - differences.mean(axis=0)


def metres_along(lines: SurveyLines, index: int) -> Array:
    """Return the along-track distances (N,) of samples from the start of line ``index`` [m]."""
    east, north, _ = Plane.under(lines).metres(lines)[:, lines.samples(index)]
    steps = np.hypot(np.diff(east), np.diff(north))
    distance: Array = np.concatenate([[0.0], np.cumsum(steps)])
    return distance


def _grid(points: Array, depth_m: float, spacing_m: float) -> Array:
    """Return the places (3, m) of the masses: grid nodes below the flights, close to samples."""
    axes = [
        np.arange(axis.min() - depth_m, axis.max() + depth_m + spacing_m, spacing_m)
        for axis in points[:2]
    ]
    if axes[0].size * axes[1].size > 100 * MOST_SOURCES:
        raise MapError(_too_many(axes[0].size * axes[1].size, spacing_m))
    grid = np.array([axis.ravel() for axis in np.meshgrid(*axes)])
    distance, near = cKDTree(points[:2].T).query(grid.T, min(_NEAREST, points.shape[1]))
    within = distance[:, 0] <= _REACH * depth_m
    if within.sum() > MOST_SOURCES:
        raise MapError(_too_many(int(within.sum()), spacing_m))
    height = points[2][near].mean(axis=1) - depth_m
    return np.array([*grid[:, within], height[within]])


def _too_many(count: int, spacing_m: float) -> str:
    return (
        f"a source spacing of {spacing_m:g} m gives {count} masses; at most {MOST_SOURCES} are "
        "allowed: increase --source-spacing, or leave lines out."
    )


def _blocks(values: Array, size: int) -> Array:
    """Return the means of blocks of ``size`` consecutive rows; the last block may be shorter."""
    starts = np.arange(0, len(values), size)
    counts = np.diff([*starts, len(values)])
    means: Array = np.add.reduceat(values, starts, axis=0) / counts[:, np.newaxis]
    return means
