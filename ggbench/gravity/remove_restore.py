"""Disturbing field of a gravity grid by the remove-compute-restore method.

The steps (Hofmann-Wellenhof and Moritz 2006, ch. 8):

1. a geoid is converted to the disturbing potential by Bruns' formula; gravity is not converted;
2. the synthesis of harmonic coefficients of low degree is removed;
3. the residual is continued upwards as a Fourier series in latitude and longitude. The wavelength
   of each term on the sphere defines its degree n. The potential of a term of degree n is
   T_n = δg_n r / (n + 1) for a gravity disturbance (Hotine), and Δg_n r / (n - 1) for a gravity
   anomaly (Stokes);
4. the coefficients of low degree are restored exactly at altitude.

Tensor components are ordered [EE, EN, EU, NN, NU, UU], x = east, y = north, z = up.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .ellipsoid import EOTVOS, normal_gravity, radii_of_curvature
from .harmonics import HarmonicCoefficients, gravity_and_gradient, potential

Array = NDArray[np.floating]

TAPER_DEG = 1.0  # the residual fades to zero over this width along the edges of its grid
MARGIN_DEG = 1.5  # the field is good from this distance on: the taper and five heights of 10 km
_BAND_DEG = 0.5  # one flat-Earth wavenumber grid per band of latitude
# The geoid of land lies inside the masses; the potential that continues the outer field down to the
# ellipsoid exceeds it by 2 pi G rho H². In height anomaly, for 2670 kg/m³: this times H² [1/m].
_GEOID_TO_HEIGHT_ANOMALY = 1.142e-7


@dataclass(frozen=True)
class GravityGrid:
    """A geoid, gravity anomalies or gravity disturbances on a grid regular in geodetic angles.

    Attributes
    ----------
    kind : ``geoid`` (undulation or height anomaly), ``anomaly`` (free air) or ``disturbance``.
    south_deg, west_deg : the first node [deg].
    latitude_step_deg, longitude_step_deg : distances between nodes, positive [deg].
    values : (n_lat, n_lon), from south to north, undulation [m] or gravity [m/s²].
    height_m : height of the values above the ellipsoid [m]; 0 for a geoid.
    is_height_anomaly : whether the file of a geoid states that it contains height anomalies.
    remarks : texts on assumptions and changes that the reader of the file made.
    """

    kind: str
    south_deg: float
    west_deg: float
    latitude_step_deg: float
    longitude_step_deg: float
    values: Array
    height_m: float = 0.0
    is_height_anomaly: bool = False
    remarks: tuple[str, ...] = ()

    @property
    def latitude_deg(self) -> Array:
        """Latitudes (n_lat,) of the rows [deg]."""
        return self.south_deg + self.latitude_step_deg * np.arange(self.values.shape[0])

    @property
    def longitude_deg(self) -> Array:
        """Longitudes (n_lon,) of the columns [deg]."""
        return self.west_deg + self.longitude_step_deg * np.arange(self.values.shape[1])


class Residual:
    """Disturbing field of a grid without the low degrees, as a Fourier series.

    The low degrees are those of the harmonic coefficients that are removed. ``taper_deg`` is the
    width of the taper along the edges of the grid [deg].
    """

    def __init__(
        self, grid: GravityGrid, coefficients: HarmonicCoefficients, taper_deg: float = TAPER_DEG
    ) -> None:
        # A real field of odd dimensions (a grid with both its ends) has no Nyquist term.
        n_lat, n_lon = (size - 1 + size % 2 for size in grid.values.shape)
        lat_deg, lon_deg = grid.latitude_deg[:n_lat], grid.longitude_deg[:n_lon]
        self._kind, self._height = grid.kind, float(grid.height_m)

        lat, lon = np.radians(lat_deg), np.radians(lon_deg)
        residual = _removed(grid, coefficients, lat, lon)
        # With the mean goes the zero-degree term of the geoid, and any offset of its datum.
        residual -= residual.mean()
        residual *= np.outer(_taper(lat_deg, taper_deg), _taper(lon_deg, taper_deg))

        step_lat, step_lon = map(math.radians, (grid.latitude_step_deg, grid.longitude_step_deg))
        self._series = np.fft.rfft2(residual) / residual.size
        self._series[:, 1:] *= 2.0
        self._wavenumber_lat = 2.0 * np.pi * np.fft.fftfreq(len(lat), step_lat)  # [1/rad]
        self._wavenumber_lon = 2.0 * np.pi * np.fft.rfftfreq(len(lon), step_lon)
        self._south, self._west = lat[0], lon[0]

    def add_to(
        self,
        tensor: Array,
        gravity_disturbance: Array,
        latitude: Array,
        longitude: Array,
        height: Array,
    ) -> None:
        """Add the residual field to the tensor and gravity disturbance of a map.

        Parameters
        ----------
        tensor : (n_lat, n_lon, n_h, 6) tensor of the map [E], changed in place.
        gravity_disturbance : (n_lat, n_lon, n_h, 3) disturbance of the map [m/s²], changed in
            place.
        latitude, longitude, height : (n_lat,), (n_lon,) [rad], (n_h,) [m].
        """
        band = math.radians(_BAND_DEG)
        first, last = math.floor(latitude.min() / band), math.floor(latitude.max() / band) + 1
        centres = band * np.arange(first, last + 1)
        for centre, weight in zip(centres, linear_weights(centres, latitude).T, strict=True):
            rows = np.flatnonzero(weight)
            if rows.size:
                vector, gradient = self.field(latitude[rows], longitude, height, centre)
                blend = weight[rows, np.newaxis, np.newaxis, np.newaxis]
                gravity_disturbance[rows] += blend * vector
                tensor[rows] += blend * gradient

    def field(
        self, latitude: Array, longitude: Array, height: Array, centre: float
    ) -> tuple[Array, Array]:
        """Return the gravity vector and the gradient tensor of the residual field on a grid, ENU.

        Parameters
        ----------
        latitude, longitude, height : (n_lat,), (n_lon,) [rad], (n_h,) [m].
        centre : latitude [rad] for the conversion of the wavelengths from radians to metres.

        Returns
        -------
        Vector (n_lat, n_lon, n_h, 3) [m/s²] and tensor (n_lat, n_lon, n_h, 6) [E].

        Notes
        -----
        The horizontal Laplacian multiplies a wave on the sphere of radius R by -n(n+1)/R². This
        defines its degree n, which need not be an integer. The degree gives the upward continuation
        (R/(R+h))^(n+1) and the vertical derivative -(n+1)/(R+h). For n -> infinity the continuation
        is exp(-kh) of the flat Earth. At degree 120 the continuation by exp(-kh) has an error of
        one to two per cent in the tensor. Second derivatives are covariant: the axes rotate with
        the position, so gravity itself contributes to the tensor (Hofmann-Wellenhof and Moritz
        2006).
        """
        meridian, prime_vertical = radii_of_curvature(centre)
        radius = math.sqrt(meridian * prime_vertical)
        eigenvalue = (self._wavenumber_lat[:, np.newaxis] / meridian) ** 2 + (
            self._wavenumber_lon / (prime_vertical * math.cos(centre))
        ) ** 2
        degree = np.sqrt(0.25 + radius**2 * eigenvalue) - 0.5
        radius += self._height
        of_potential = self._series / self._per_potential(degree, radius, centre)

        i_k = 1j * self._wavenumber_lat
        wave_lat = np.exp(np.outer(latitude - self._south, i_k))
        waves_lat = np.concatenate((wave_lat, wave_lat * i_k, wave_lat * i_k**2))
        i_k = 1j * self._wavenumber_lon
        wave_lon = np.exp(np.outer(longitude - self._west, i_k))
        waves_lon = np.concatenate((wave_lon, wave_lon * i_k, wave_lon * i_k**2)).T

        shape = (latitude.size, longitude.size, height.size)
        vector, tensor = np.empty((*shape, 3)), np.empty((*shape, 6))
        cosine, tangent = np.cos(latitude)[:, np.newaxis], np.tan(latitude)[:, np.newaxis]
        radii_north, radii_east = np.array([radii_of_curvature(a) for a in latitude]).T[..., None]
        for index, h in enumerate(height):
            r = radius + (h - self._height)
            continued = of_potential * (radius / r) ** (degree + 1.0)
            # d[i, j]: i-th derivative in latitude, j-th in longitude.
            d, d_up = (
                (waves_lat @ series @ waves_lon)
                .real.reshape(3, latitude.size, 3, longitude.size)
                .swapaxes(1, 2)
                for series in (continued, continued * (-(degree + 1.0) / r))
            )
            r_north, r_east = radii_north + h, radii_east + h
            per_lon = r_east * cosine  # metres per radian of longitude
            east, north, up = d[0, 1] / per_lon, d[1, 0] / r_north, d_up[0, 0]
            ee = d[0, 2] / per_lon**2 + (up - tangent * north) / r_east
            en = d[1, 1] / (per_lon * r_north) + tangent * east / r_east
            eu = d_up[0, 1] / per_lon - east / r_east
            nn = d[2, 0] / r_north**2 + up / r_north
            nu = d_up[1, 0] / r_north - north / r_north
            vector[:, :, index] = np.stack((east, north, up), axis=-1)
            tensor[:, :, index] = np.stack((ee, en, eu, nn, nu, -ee - nn), axis=-1) / EOTVOS
        return vector, tensor

    def _per_potential(self, degree: Array, radius: float, centre: float) -> Array | float:
        """Return the ratio of the grid's quantity to the potential for a wave of this degree.

        The ratio is 1 for a geoid, because its series is already that of the potential. It is in
        1/m for gravity.
        """
        if self._kind == "geoid":
            return 1.0  # the series is that of the potential already
        disturbance = (degree + 1.0) / radius
        if self._kind == "disturbance":
            return disturbance
        # The wave of degree 0, of which the mean has been removed, must not divide by zero.
        anomaly = disturbance + _relative_vertical_gradient(centre, self._height)
        return np.where(degree > 1.5, anomaly, np.inf)


def height_anomaly(geoid: Array, elevation: Array) -> Array:
    """Return the height anomaly (...) [m] of the external field, continued to the ellipsoid.

    The anomaly exceeds the geoid height by 2πGρH²/γ at the elevation H. The density ρ is 2670
    kg/m³.

    Parameters
    ----------
    geoid : (...) height of the geoid above the ellipsoid [m].
    elevation : (...) height of the land above sea level [m]; 0 at sea.
    """
    return geoid + _GEOID_TO_HEIGHT_ANOMALY * elevation**2


def linear_weights(nodes: Array, points: Array) -> Array:
    """Return the matrix (n_points, n_nodes) of linear interpolation between ascending nodes."""
    nodes = np.asarray(nodes, dtype=float)
    left = np.clip(np.searchsorted(nodes, points, side="right") - 1, 0, nodes.size - 2)
    fraction = (points - nodes[left]) / (nodes[left + 1] - nodes[left])
    weights = np.zeros((points.size, nodes.size))
    rows = np.arange(points.size)
    weights[rows, left] = 1.0 - fraction
    weights[rows, left + 1] = fraction
    return weights


def _removed(
    grid: GravityGrid, coefficients: HarmonicCoefficients, lat: Array, lon: Array
) -> Array:
    """Return the grid minus the synthesis of the coefficients.

    The result is a potential [m²/s²] for a geoid, and gravity [m/s²] for other kinds.
    """
    values = grid.values[: lat.size, : lon.size]
    height = np.array([float(grid.height_m)])
    if grid.kind == "geoid":
        gamma = np.array([normal_gravity(angle, 0.0)[0] for angle in lat])
        bruns = gamma[:, np.newaxis] * values
        bruns -= potential(coefficients, lat, lon, height)[:, :, 0]
        return bruns
    reference = -gravity_and_gradient(coefficients, lat, lon, height)[0][:, :, 0, 2]
    if grid.kind == "anomaly":
        per_potential = np.array([_relative_vertical_gradient(a, height[0]) for a in lat])
        reference += (
            per_potential[:, np.newaxis] * potential(coefficients, lat, lon, height)[..., 0]
        )
    removed: Array = values - reference
    return removed


def _relative_vertical_gradient(latitude: float, height: float) -> float:
    """Return (∂γ/∂h)/γ [1/m], about -2/r.

    Times the disturbing potential it is the gravity anomaly minus the gravity disturbance.
    """
    gamma, _, vertical = normal_gravity(latitude, height)
    return float(vertical / gamma)


def _taper(degrees: Array, width: float) -> Array:
    """Return a cosine taper (n,): zero at both ends of an axis, one from ``width`` inwards."""
    inwards = np.minimum(degrees - degrees[0], degrees[-1] - degrees)
    return np.sin(0.5 * np.pi * np.clip(inwards / width, 0.0, 1.0)) ** 2
