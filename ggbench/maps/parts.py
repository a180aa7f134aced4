"""Parts of a map, and the sum of parts without double counting.

Spherical harmonics represent the field up to a degree N. A terrain adds shorter wavelengths: the
field of the terrain minus the field of the same terrain smoothed to degree N. The harmonics already
contain the smoothed field (residual terrain modelling, Forsberg 1984). A Butterworth filter smooths
the masses of the terrain in the wavenumber domain. Water is a density deficit.

Every part yields, for each height of a map, the tensor (n_lat, n_lon, 6) [E] and the gravity
disturbance (n_lat, n_lon, 3) [m/s²].
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
import scipy.fft
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline

from ..gravity.ellipsoid import radii_of_curvature
from ..gravity.gradient_map import MapError
from ..gravity.harmonics import HarmonicCoefficients, gravity_and_gradient
from ..gravity.remove_restore import Residual, linear_weights
from .netcdf import Layer, Nodes

if TYPE_CHECKING:
    from ..gravity.parker import TerrainOptions
    from ..gravity.terrain import Terrain

Array = NDArray[np.floating]

FILTER_ORDER = 8
"""Order of the Butterworth filter that smooths a terrain; at its cut-off the gain is 1/2."""
_NODES_PER_HALF_WAVE = 6.0  # of the highest degree: harmonics are computed on no denser nodes
_SPLINE_DEGREE = 5
_SPLINE_MARGIN = 6  # nodes beyond the map, so that the spline ends outside
_MOST_AT_ONCE = 4_000_000  # nodes of a synthesis held in memory
_BAND_DEG = 1.0  # latitude over which a terrain is smoothed with one convergence of the meridians
_MOST_BANDS = 30
_WIDEST_DEG = 11.0  # of a terrain, in degrees of arc: its field is computed on a plane


class Part(Protocol):
    """Part of a map: a field that is added to other parts."""

    def layers(self, nodes: Nodes) -> Iterator[Layer]:
        """Yield tensor (n_lat, n_lon, 6) and gravity disturbance (n_lat, n_lon, 3) of each height.

        The units are E and m/s². Callers may change the arrays.
        """
        ...


def summed(parts: Sequence[Part], nodes: Nodes) -> Iterator[Layer]:
    """Yield the sum of all parts for each height of a map with level layers."""
    first, *others = (part.layers(nodes) for part in parts)
    for tensor, disturbance in first:
        for layers in others:  # one after the other, and in place: a layer may be large
            more_tensor, more_disturbance = next(layers)
            tensor += more_tensor
            disturbance += more_disturbance
        yield tensor, disturbance


@dataclasses.dataclass(frozen=True)
class HarmonicPart:
    """Map part: the field of spherical harmonics of the disturbing potential.

    Attributes
    ----------
    coefficients : coefficients of the disturbing potential.
    nodes_per_half_wave : limit on the node density, in nodes per half wavelength of the highest
        degree. In a denser map the series is summed only at nodes of this density. A spline of
        degree 5 interpolates between these nodes. Infinite: no interpolation.
    """

    coefficients: HarmonicCoefficients
    nodes_per_half_wave: float = _NODES_PER_HALF_WAVE

    def layers(self, nodes: Nodes) -> Iterator[Layer]:
        """Yield the field of the harmonics for each height."""
        finest = 180.0 / self.coefficients.degree / self.nodes_per_half_wave
        latitude, to_latitude = _coarser(nodes.latitude_deg, finest, 89.999)
        # Towards the poles waves get shorter in longitude; orders, which bound them, do not.
        longitude, to_longitude = _coarser(nodes.longitude_deg, finest, math.inf)
        heights = nodes.height_m
        at_once = max(1, _MOST_AT_ONCE // (latitude.size * longitude.size))
        for first in range(0, heights.size, at_once):
            vector, tensor = gravity_and_gradient(
                self.coefficients,
                np.radians(latitude),
                np.radians(longitude),
                heights[first : first + at_once],
            )
            for index in range(tensor.shape[2]):
                yield tuple(
                    _on_nodes(values[:, :, index], to_latitude, to_longitude)
                    for values in (tensor, vector)
                )  # type: ignore[misc]


@dataclasses.dataclass(frozen=True)
class ResidualPart:
    """Map part: the field of a gravity grid minus the field of the harmonics."""

    residual: Residual

    def layers(self, nodes: Nodes) -> Iterator[Layer]:
        """Yield the residual field, continued upwards from the grid to each height."""
        latitude, longitude = np.radians(nodes.latitude_deg), np.radians(nodes.longitude_deg)
        for height in nodes.height_m:
            tensor = np.zeros((latitude.size, longitude.size, 1, 6))
            vector = np.zeros((latitude.size, longitude.size, 1, 3))
            self.residual.add_to(tensor, vector, latitude, longitude, np.array([height]))
            yield tensor[:, :, 0], vector[:, :, 0]


@dataclasses.dataclass(frozen=True)
class TerrainPart:
    """Map part: the field of a terrain, or only its part above a spherical-harmonic degree.

    Attributes
    ----------
    terrain, options : see :mod:`ggbench.gravity.parker`.
    above_degree : subtract the field of the terrain smoothed to this degree; None: no subtraction.
    geoid_height_m : height of the terrain's zero level above the ellipsoid [m].
    dtype : type of the field's values; ``float32`` causes errors of about 1e-5 E.
    """

    terrain: Terrain
    options: TerrainOptions
    above_degree: int | None = None
    geoid_height_m: float = 0.0
    dtype: str = "float32"

    def layers(self, nodes: Nodes) -> Iterator[Layer]:
        """Yield the terrain's field for each height."""
        from ..gravity.parker import terrain_layers

        axes = (np.radians(nodes.latitude_deg), np.radians(nodes.longitude_deg), nodes.height_m)
        terrain = terrain_about(self.terrain, nodes)
        rest = (self.options, self.geoid_height_m, self.dtype)
        whole = terrain_layers(terrain, *axes, *rest)
        if self.above_degree is None:
            yield from whole
            return
        smooth_terrain = smoothed(terrain, self.above_degree, self.options)
        smooth = terrain_layers(
            smooth_terrain, *axes, self.options, self.geoid_height_m, self.dtype
        )
        for (tensor, vector), (smooth_tensor, smooth_vector) in zip(whole, smooth, strict=True):
            tensor -= smooth_tensor
            vector -= smooth_vector
            yield tensor, vector


def terrain_about(terrain: Terrain, nodes: Nodes) -> Terrain:
    """Return the terrain; if it is too wide for a plane, return the part around the map."""
    middle = 0.5 * (nodes.latitude_deg[0] + nodes.latitude_deg[-1])
    half = np.array([_WIDEST_DEG, _WIDEST_DEG / math.cos(math.radians(middle))]) / 2.0
    spans = np.ptp(terrain.latitudes_deg), np.ptp(terrain.longitudes_deg)
    if spans[0] <= 2.0 * half[0] and spans[1] <= 2.0 * half[1]:
        return terrain
    centre = middle, 0.5 * (nodes.longitude_deg[0] + nodes.longitude_deg[-1])
    return terrain.crop(
        centre[0] - half[0], centre[0] + half[0], centre[1] - half[1], centre[1] + half[1]
    )


def smoothed(terrain: Terrain, degree: int, options: TerrainOptions) -> Terrain:
    """Return the terrain, low-pass filtered to a spherical-harmonic degree.

    The filter is a Butterworth filter of order 8: it multiplies the amplitude of a wave of degree n
    by 1 / (1 + (n/degree)^16). Beyond its edges the terrain is continued by its mirror image.

    Raises MapError if the terrain is smaller than one wavelength of the degree, or if its ground is
    not denser than water.
    """
    heights = np.asarray(terrain.height_m, dtype=float)
    n_lat, n_lon = heights.shape
    latitude = terrain.latitudes_deg
    spans = (
        terrain.latitude_step_deg * (n_lat - 1),
        terrain.longitude_step_deg * (n_lon - 1) * math.cos(math.radians(latitude.mean())),
    )
    if min(spans) < 360.0 / degree:
        raise MapError(
            f"the terrain {terrain.name} is {min(spans):.3g}° wide, less than one wavelength of "
            f"degree {degree} ({360.0 / degree:.3g}°): provide a wider terrain or coefficients "
            "of higher degree."
        )
    if not options.water_density < options.density:
        raise MapError(
            f"to remove low degrees from the terrain {terrain.name}, --density "
            f"{options.density:g} must be above --water-density {options.water_density:g}."
        )
    # Masses: below the zero level water takes the place of rock.
    sea = 1.0 - options.water_density / options.density
    spectrum = scipy.fft.dctn(np.where(heights < 0.0, sea * heights, heights), type=2)
    count = min(_MOST_BANDS, max(2, math.ceil((latitude[-1] - latitude[0]) / _BAND_DEG) + 1))
    centres = np.linspace(latitude[0], latitude[-1], count)
    waves_lat = math.pi * np.arange(n_lat) / (n_lat * math.radians(terrain.latitude_step_deg))
    waves_lon = math.pi * np.arange(n_lon) / (n_lon * math.radians(terrain.longitude_step_deg))
    masses = np.zeros_like(heights)
    for centre, weight in zip(centres, linear_weights(centres, latitude).T, strict=True):
        meridian, prime_vertical = radii_of_curvature(math.radians(centre))
        squared = (waves_lat[:, np.newaxis] / meridian) ** 2 + (
            waves_lon / (prime_vertical * math.cos(math.radians(centre)))
        ) ** 2
        # n(n + 1) = (kR)², and (n/N)^16 from it without a root.
        ratio = meridian * prime_vertical * squared / (degree * (degree + 1.0))
        passed = scipy.fft.idctn(spectrum / (1.0 + ratio**FILTER_ORDER), type=2)
        masses += weight[:, np.newaxis] * passed
    filtered = np.where(masses < 0.0, masses / sea, masses)
    return dataclasses.replace(
        terrain, height_m=filtered, name=f"{terrain.name}, smoothed to degree {degree}"
    )


def _coarser(fine: Array, finest: float, limit: float) -> tuple[Array, Array | None]:
    """Return nodes ``finest`` [deg] or slightly less apart, and an interpolation matrix.

    The matrix maps values at these nodes to the nodes ``fine``. If there would not be fewer nodes,
    or if one would lie beyond ``limit`` [deg], the nodes are ``fine`` and the matrix is None.
    """
    if finest == 0.0:
        return fine, None
    step = (fine[-1] - fine[0]) / (fine.size - 1)
    low, high = fine[0] - _SPLINE_MARGIN * finest, fine[-1] + _SPLINE_MARGIN * finest
    count = math.ceil((high - low) / finest) + 1
    if step >= finest or count >= fine.size or max(-low, high) > limit:
        return fine, None
    nodes = np.linspace(low, high, count)
    return nodes, make_interp_spline(nodes, np.eye(count), k=_SPLINE_DEGREE)(fine)


def _on_nodes(values: Array, to_latitude: Array | None, to_longitude: Array | None) -> Array:
    """Interpolate (n_lat, n_lon, m) with the matrices of :func:`_coarser`."""
    planes: Any = np.moveaxis(values, -1, 0)
    if to_latitude is not None:
        planes = to_latitude @ planes
    if to_longitude is not None:
        planes = planes @ to_longitude.T
    result: Array = np.moveaxis(planes, 0, -1)
    return result
