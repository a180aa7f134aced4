"""The disturbing field of a source of real data, by remove, compute and restore.

The steps (Hofmann-Wellenhof and Moritz 2006, ch. 8):

1. the geoid of the source becomes the disturbing potential at the ellipsoid by Bruns' formula;
2. the synthesis of the harmonic coefficients of low degree is removed;
3. the residual is continued upwards as a Fourier series in latitude and longitude;
4. the coefficients of low degree are restored exactly at altitude.

The normal field is no part of the result: :mod:`ggbench.earth` has it exactly. Tensor components
are ordered [EE, EN, EU, NN, NU, UU], x = east, y = north, z = up.
"""

from __future__ import annotations

import importlib.resources
import io
import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import gaussian_filter

from .earth import EOTVOS, normal_gravity, radii_of_curvature
from .errors import GGBenchError
from .spherical_harmonics import (
    HarmonicCoefficients,
    gravity_and_gradient,
    potential,
    without_normal_field,
)

Array = NDArray[np.float64]

_TAPER_DEG = 1.0  # the residual fades to zero over this width along the edges of its grid
_MARGIN_DEG = 1.5  # the field is good from this distance on: the taper and five heights of 10 km
_BAND_DEG = 0.5  # one flat-Earth wavenumber grid per band of latitude
_WIDEST_SMOOTHING_DEG = 1.0
# The geoid of land lies inside the masses; the potential that continues the outer field down to the
# ellipsoid exceeds it by 2 pi G rho H². In height anomaly, for 2670 kg/m³: this times H² [1/m].
_GEOID_TO_HEIGHT_ANOMALY = 1.142e-7


class MapError(GGBenchError):
    """A field or a map cannot be made as asked, or its data cannot be read."""


@dataclass(frozen=True)
class Source:
    """Data files of a region, and the heights for which their resolution is adequate.

    Attributes
    ----------
    geoid, topography, coefficients : names of the data files.
    lowest_height_m, highest_height_m : above the ellipsoid [m].
    provenance : where the data come from, in words.
    """

    geoid: str
    topography: str
    coefficients: str
    lowest_height_m: float
    highest_height_m: float
    provenance: str


SOURCES = {
    "egm2008_qinling": Source(
        geoid="egm2008_geoid_2.5min_qinling.npz",
        topography="etopo1_6min_qinling.npz",
        coefficients="egm2008_degree120.npz",
        lowest_height_m=3000.0,
        highest_height_m=30000.0,
        provenance="EGM2008 geoid (NGA) at 2.5 arc minutes and coefficients to degree 120, "
        "ETOPO1 topography (NOAA)",
    )
}
"""The regions for which the package carries data, by the name that a recipe uses."""


def disturbing_field(
    source: str,
    latitude: ArrayLike,
    longitude: ArrayLike,
    height: ArrayLike,
    land_correction: bool = True,
    relief_smoothing_deg: float = 0.0,
) -> tuple[Array, Array]:
    """The disturbing field of a source, free of interpolation, on latitude x longitude x height.

    Parameters
    ----------
    source : a key of :data:`SOURCES`.
    latitude, longitude : any positions inside the source, shapes (n_lat,), (n_lon,) [rad].
    height : above the ellipsoid, shape (n_h,) [m].
    land_correction : whether to turn the geoid into the height anomaly with the topography.
    relief_smoothing_deg : standard deviation, in latitude and in longitude, of a Gaussian that
        smooths the topography before; 0 leaves it as it is, between its samples bilinear.

    Returns
    -------
    The tensor, (n_lat, n_lon, n_h, 6) [E], and the gravity disturbance, (n_lat, n_lon, n_h, 3)
    [m/s²], both in geodetic ENU axes.

    Raises MapError for an unknown source, a smoothing outside 0 to 1 deg, and a data file that is
    missing or damaged.
    """
    check_relief_smoothing(relief_smoothing_deg)
    files = find_source(source)
    lat, lon, h = (np.asarray(axis, dtype=float) for axis in (latitude, longitude, height))
    coefficients = _disturbing_coefficients(files)
    residual = _Residual(files, coefficients, land_correction, relief_smoothing_deg)

    gravity_disturbance, tensor = gravity_and_gradient(coefficients, lat, lon, h)
    band = math.radians(_BAND_DEG)
    first, last = math.floor(lat.min() / band), math.floor(lat.max() / band) + 1
    centres = band * np.arange(first, last + 1)
    for centre, weight in zip(centres, _linear_weights(centres, lat).T, strict=True):
        rows = np.flatnonzero(weight)
        if rows.size:
            vector, gradient = residual.field(lat[rows], lon, h, centre)
            blend = weight[rows, np.newaxis, np.newaxis, np.newaxis]
            gravity_disturbance[rows] += blend * vector
            tensor[rows] += blend * gradient
    return tensor, gravity_disturbance


def check_relief_smoothing(relief_smoothing_deg: float) -> None:
    """Raise MapError if this is no width by which the relief can be smoothed."""
    if not 0.0 <= relief_smoothing_deg <= _WIDEST_SMOOTHING_DEG:  # NaN fails too
        raise MapError(
            f"relief_smoothing_deg = {relief_smoothing_deg} must lie between 0, which is no "
            f"smoothing, and {_WIDEST_SMOOTHING_DEG:g}."
        )


def extent_deg(source: Source) -> tuple[tuple[float, float], tuple[float, float]]:
    """Latitudes and longitudes, each from and to [deg], between which a source gives a field.

    Raises MapError if its geoid is missing or damaged.
    """
    _, lat_deg, lon_deg, _ = _geoid(source)
    south, north = lat_deg[0] + _MARGIN_DEG, lat_deg[-1] - _MARGIN_DEG
    west, east = lon_deg[0] + _MARGIN_DEG, lon_deg[-1] - _MARGIN_DEG
    return (float(south), float(north)), (float(west), float(east))


class _Residual:
    """The disturbing potential at the ellipsoid beyond the coefficients, as a Fourier series."""

    def __init__(
        self,
        files: Source,
        coefficients: HarmonicCoefficients,
        land_correction: bool,
        relief_smoothing_deg: float,
    ) -> None:
        geoid, lat_deg, lon_deg, step_deg = _geoid(files)
        height_anomaly = geoid
        if land_correction:
            topography = _load(files.topography, ("lat", "lon", "z"))
            land = np.maximum(topography["z"], 0.0)
            if relief_smoothing_deg > 0.0:
                steps = [float(np.diff(topography[axis]).mean()) for axis in ("lat", "lon")]
                land = gaussian_filter(land, [relief_smoothing_deg / step for step in steps])
            at_rows = _linear_weights(topography["lat"], lat_deg)
            at_columns = _linear_weights(topography["lon"], lon_deg)
            elevation = at_rows @ land @ at_columns.T
            height_anomaly = geoid + _GEOID_TO_HEIGHT_ANOMALY * elevation**2

        lat, lon = np.radians(lat_deg), np.radians(lon_deg)
        gamma = np.array([normal_gravity(angle, 0.0)[0] for angle in lat])
        residual = gamma[:, np.newaxis] * height_anomaly  # Bruns
        residual -= potential(coefficients, lat, lon, np.zeros(1))[:, :, 0]
        # With the mean goes the zero-degree term of the geoid, and any offset of its datum.
        residual -= residual.mean()
        residual *= np.outer(_taper(lat_deg), _taper(lon_deg))

        step = math.radians(step_deg)
        # A real field of odd dimensions (a grid with both its ends) has no Nyquist term.
        self._series = np.fft.rfft2(residual) / residual.size
        self._series[:, 1:] *= 2.0
        self._wavenumber_lat = 2.0 * np.pi * np.fft.fftfreq(len(lat), step)  # [1/rad]
        self._wavenumber_lon = 2.0 * np.pi * np.fft.rfftfreq(len(lon), step)
        self._south, self._west = lat[0], lon[0]

    def field(
        self, latitude: Array, longitude: Array, height: Array, centre: float
    ) -> tuple[Array, Array]:
        """Gravity vector and gradient tensor, with the convergence of one latitude ``centre``.

        The horizontal Laplacian of a wave on the sphere of radius R is -n(n+1)/R²; that gives
        its degree n, not a whole number, and with it the continuation (R/(R+h))^(n+1), the
        vertical derivative -(n+1)/(R+h), and so all derivatives. For n -> infinity this is the
        flat Earth's exp(-kh), whose tensor is one or two per cent off at degree 120.
        Second derivatives are covariant: in axes that turn with the position, gravity itself
        enters the tensor (Hofmann-Wellenhof and Moritz 2006).
        """
        meridian, prime_vertical = radii_of_curvature(centre)
        radius = math.sqrt(meridian * prime_vertical)
        eigenvalue = (self._wavenumber_lat[:, np.newaxis] / meridian) ** 2 + (
            self._wavenumber_lon / (prime_vertical * math.cos(centre))
        ) ** 2
        degree = np.sqrt(0.25 + radius**2 * eigenvalue) - 0.5

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
            r = radius + h
            continued = self._series * (radius / r) ** (degree + 1.0)
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


def _geoid(files: Source) -> tuple[Array, Array, Array, float]:
    """Undulation (n_lat, n_lon) [m], latitudes (n_lat,), longitudes (n_lon,), step [deg]."""
    grid = _load(files.geoid, ("lat0", "lon0", "step", "N_1e4m"))
    undulation, step = 1e-4 * grid["N_1e4m"], float(grid["step"])
    n_lat, n_lon = undulation.shape
    lat = float(grid["lat0"]) + step * np.arange(n_lat)
    lon = float(grid["lon0"]) + step * np.arange(n_lon)
    return undulation, lat, lon, step


def _disturbing_coefficients(files: Source) -> HarmonicCoefficients:
    data = _load(files.coefficients, ("cs", "gm", "r"))
    size = math.isqrt(2 * len(data["cs"]))
    cosine, sine = np.zeros((2, size, size))
    cosine[np.tril_indices(size)], sine[np.tril_indices(size)] = data["cs"].T
    return without_normal_field(
        HarmonicCoefficients(float(data["gm"]), float(data["r"]), cosine, sine)
    )


def _linear_weights(nodes: Array, points: Array) -> Array:
    """Matrix (n_points, n_nodes) of linear interpolation between ascending nodes."""
    nodes = np.asarray(nodes, dtype=float)
    left = np.clip(np.searchsorted(nodes, points, side="right") - 1, 0, nodes.size - 2)
    fraction = (points - nodes[left]) / (nodes[left + 1] - nodes[left])
    weights = np.zeros((points.size, nodes.size))
    rows = np.arange(points.size)
    weights[rows, left] = 1.0 - fraction
    weights[rows, left + 1] = fraction
    return weights


def _taper(degrees: Array) -> Array:
    """Cosine taper: zero at both ends of an axis, one from _TAPER_DEG inwards."""
    inwards = np.minimum(degrees - degrees[0], degrees[-1] - degrees)
    return np.sin(0.5 * np.pi * np.clip(inwards / _TAPER_DEG, 0.0, 1.0)) ** 2


def find_source(name: str) -> Source:
    """The source of that name. Raises MapError if there is none."""
    if name not in SOURCES:
        raise MapError(f"Unknown map source {name!r}; allowed: {', '.join(sorted(SOURCES))}.")
    return SOURCES[name]


def data_bytes(name: str) -> bytes:
    """Content of a data file of the package. Raises MapError if it cannot be read."""
    try:
        return (importlib.resources.files("ggbench.scenarios") / "data" / name).read_bytes()
    except (OSError, ModuleNotFoundError) as error:
        raise MapError(
            f"Data file {name} cannot be read ({error}); it belongs into the folder data of "
            "ggbench.scenarios, where an installation puts it."
        ) from error


def read_arrays(content: bytes, keys: Iterable[str]) -> dict[str, Any]:
    """Arrays of a NumPy archive, given its bytes.

    Raises one of a dozen kinds of exceptions, of NumPy, zipfile and zlib, if it is damaged.
    """
    with np.load(io.BytesIO(content), allow_pickle=False) as data:
        return {key: data[key] for key in keys}


def _load(name: str, keys: tuple[str, ...]) -> dict[str, Any]:
    """Arrays of a data file of the package."""
    content = data_bytes(name)
    try:
        return read_arrays(content, keys)
    except Exception as error:
        raise MapError(
            f"Data file {name} of ggbench.scenarios is damaged ({error}); it must be a NumPy "
            f"archive with the arrays {', '.join(keys)}: install the package again."
        ) from error
