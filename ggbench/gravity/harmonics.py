"""Synthesis of a gravitational potential and its derivatives from spherical harmonics.

The Cartesian derivative of a solid spherical harmonic is again a sum of solid spherical harmonics,
one degree higher (Cunningham 1970; Petrovskaya and Vershkov 2010). Therefore each Cartesian
component of the gravity vector and gradient tensor is a series with the same Legendre functions and
other coefficients. The synthesis needs no derivatives of Legendre functions and no division by
cos(latitude), so poles are no special case. Legendre functions come from the standard forward
column recursion. Above about degree 1900 this recursion underflows near the poles in double
precision (Holmes and Featherstone 2002). Therefore small values have an additional exponent
(Fukushima 2012), and the synthesis is valid to any degree.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..numerics.kernels import compiled
from .ellipsoid import (
    ECCENTRICITY_SQUARED,
    EOTVOS,
    EVEN_ZONALS,
    GM,
    SEMI_MAJOR_AXIS,
    radii_of_curvature,
)

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

_BLOCK = 2**24  # numbers in the largest array of a synthesis: 128 MB; more circles go in turns
# Numbers below 2^-480 are kept as x * 2^(960 e), e < 0. Powers of two change no digit.
_TINY = 2.0**-480
_HUGE = 2.0**480
_RADIX = 2.0**960


@dataclass(frozen=True)
class HarmonicCoefficients:
    """Fully normalised (4 pi) spherical harmonic coefficients of a gravitational potential.

    V = gm/r * sum_n (radius/r)^n * sum_m (C_nm cos(m lon) + S_nm sin(m lon)) P_nm(sin lat'),
    with r and lat' geocentric.

    Attributes
    ----------
    gm, radius : gravitational parameter [m³/s²] and reference radius [m] of the coefficients.
    cosine, sine : C_nm and S_nm, shape (degree + 1, degree + 1), zero for m > n.
    """

    gm: float
    radius: float
    cosine: Array
    sine: Array

    @property
    def degree(self) -> int:
        """Highest degree of the coefficients."""
        return len(self.cosine) - 1

    def between(self, lowest: int, highest: int) -> HarmonicCoefficients:
        """Return the coefficients of the degrees ``lowest`` to ``highest``; the others are zero."""
        size = min(highest, self.degree) + 1
        cosine, sine = self.cosine[:size, :size].copy(), self.sine[:size, :size].copy()
        cosine[:lowest], sine[:lowest] = 0.0, 0.0
        return HarmonicCoefficients(self.gm, self.radius, cosine, sine)


def without_normal_field(coefficients: HarmonicCoefficients) -> HarmonicCoefficients:
    """Return the coefficients of the disturbing potential, without the normal field.

    The even zonal coefficients J2..J12 of WGS84 are subtracted. Degrees 0 and 1 become zero,
    because the normal field has the mass and the centre of mass of the Earth.
    """
    cosine, sine = coefficients.cosine.copy(), coefficients.sine.copy()
    scale = GM / coefficients.gm
    for n, zonal in zip(range(2, len(cosine), 2), EVEN_ZONALS, strict=False):
        fully_normalised = -zonal / np.sqrt(2 * n + 1)
        cosine[n, 0] -= scale * (SEMI_MAJOR_AXIS / coefficients.radius) ** n * fully_normalised
    cosine[:2], sine[:2] = 0.0, 0.0
    return HarmonicCoefficients(coefficients.gm, coefficients.radius, cosine, sine)


def potential(
    coefficients: HarmonicCoefficients, latitude: ArrayLike, longitude: ArrayLike, height: ArrayLike
) -> Array:
    """Return the potential (n_lat, n_lon, n_h) [m²/s²] on a grid of positions.

    Parameters
    ----------
    coefficients : coefficients of the potential.
    latitude, longitude : geodetic, shapes (n_lat,) and (n_lon,) [rad].
    height : above the WGS84 ellipsoid, shape (n_h,) [m].
    """
    series = _complex(coefficients).T[:, np.newaxis]
    values = _synthesis(series, coefficients.radius, latitude, longitude, height)
    return coefficients.gm / coefficients.radius * values[0]


def gravity_and_gradient(
    coefficients: HarmonicCoefficients, latitude: ArrayLike, longitude: ArrayLike, height: ArrayLike
) -> tuple[Array, Array]:
    """Return first and second derivatives of the potential on the grid of :func:`potential`.

    Returns
    -------
    Gravity vector (n_lat, n_lon, n_h, 3) [m/s²], components E, N, U, and gradient tensor (n_lat,
    n_lon, n_h, 6) [E], components EE, EN, EU, NN, NU, UU. The axes are those of the geodetic, not
    the geocentric, local level.
    """
    c = _complex(coefficients)
    size = len(c) + 2
    series = np.zeros((size, 9, size), dtype=np.complex128)
    pairs = {"x": "xyz", "y": "yz", "z": "z"}  # xx, xy, xz, yy, yz, zz
    place = 3
    for index, (axis, others) in enumerate(pairs.items()):
        first = _derivative(c, axis)
        series[:-1, index, :-1] = first.T
        for other in others:
            series[:, place] = _derivative(first, other).T
            place += 1
    values = _synthesis(series, coefficients.radius, latitude, longitude, height)

    C_ne = _ecef_to_enu(np.asarray(latitude, dtype=float), np.asarray(longitude, dtype=float))
    C_ne = C_ne[:, :, np.newaxis]
    gravity = np.moveaxis(values[:3], 0, -1) * (coefficients.gm / coefficients.radius**2)
    tensor = values[[3, 4, 5, 4, 6, 7, 5, 7, 8]] * (
        coefficients.gm / coefficients.radius**3 / EOTVOS
    )
    tensor = np.moveaxis(tensor, 0, -1).reshape(*gravity.shape, 3)
    tensor = C_ne @ tensor @ np.swapaxes(C_ne, -1, -2)
    east_north_up = (C_ne @ gravity[..., np.newaxis])[..., 0]
    return east_north_up, tensor[..., [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]]


def _complex(coefficients: HarmonicCoefficients) -> ComplexArray:
    """Return the complex coefficients C - iS.

    The potential is proportional to the real part of Σ (C - iS) (R/r)^(n+1) P_nm exp(i m lon).
    """
    return np.asarray(coefficients.cosine - 1j * coefficients.sine, dtype=np.complex128)


def _derivative(c: ComplexArray, axis: str) -> ComplexArray:
    """Return R times the coefficients of the derivative along an Earth-fixed axis.

    R is the reference radius. With V_nm = (R/r)^(n+1) P_nm exp(i m lon) and unnormalised P_nm the
    derivatives are (Cunningham 1970):
    (d/dx + i d/dy) V_nm = -V_{n+1,m+1} / R,
    (d/dx - i d/dy) V_nm = (n-m+1)(n-m+2) V_{n+1,m-1} / R,
    d/dz V_nm = -(n-m+1) V_{n+1,m} / R.
    The square roots in the code convert these relations to normalised functions.

    ``c`` has the shape (N + 1, N + 1), the result (N + 2, N + 2).
    """
    size = len(c)
    n = np.arange(size)[:, np.newaxis]
    m = np.arange(size)[np.newaxis, :]
    inside = m <= n
    derivative = np.zeros((size + 1, size + 1), dtype=np.complex128)
    if axis == "z":
        factor = np.sqrt((2 * n + 1) / (2 * n + 3) * np.where(inside, (n + m + 1) * (n - m + 1), 0))
        derivative[1:, :-1] = -factor * c
        return derivative
    raising = np.sqrt((2 * n + 1) / (2 * n + 3) * np.where(inside, (n + m + 1) * (n + m + 2), 0))
    lowering = np.sqrt((2 * n + 1) / (2 * n + 3) * np.where(inside, (n - m + 1) * (n - m + 2), 0))
    # V_{n,-1} is, but for its sign, the conjugate of V_{n,1}: order 0 raises with both its halves.
    raising[:, 0] *= np.sqrt(2.0)
    lowering[:, 1] *= np.sqrt(2.0)
    up, down = (-0.5, 0.5) if axis == "x" else (0.5j, 0.5j)
    derivative[1:, 1:] = up * raising * c
    derivative[1:, :-2] += down * (lowering * c)[:, 1:]
    derivative[:, 0] = derivative[:, 0].real
    return derivative


def _synthesis(
    series: ComplexArray,
    radius: float,
    latitude: ArrayLike,
    longitude: ArrayLike,
    height: ArrayLike,
) -> Array:
    """Return the real part of Σ c_nm (R/r)^(n+1) P_nm exp(i m lon) for several series.

    ``series`` has the shape (N + 1, n_series, N + 1): order m, series, degree n. The result has the
    shape (n_series, n_lat, n_lon, n_h).
    """
    lat = np.asarray(latitude, dtype=float)[:, np.newaxis]
    lon = np.asarray(longitude, dtype=float)
    h = np.asarray(height, dtype=float)
    prime_vertical = np.array([[radii_of_curvature(angle)[1]] for angle in lat[:, 0]])
    from_axis = ((prime_vertical + h) * np.cos(lat)).ravel()
    from_equator = ((prime_vertical * (1.0 - ECCENTRICITY_SQUARED) + h) * np.sin(lat)).ravel()
    r = np.hypot(from_axis, from_equator)

    size, n_series, _ = series.shape
    angle = np.arange(size)[:, np.newaxis] * lon
    harmonics = np.stack((np.cos(angle), np.sin(angle)), axis=1).reshape(2 * size, lon.size)
    values = np.empty((n_series, r.size, lon.size))
    circles = max(1, _BLOCK // (2 * n_series * size))
    for first in range(0, r.size, circles):
        block = slice(first, first + circles)
        sine, cosine = from_equator[block] / r[block], from_axis[block] / r[block]
        powers = (radius / r[block]) ** np.arange(1, size + 1)[:, np.newaxis]
        per_order = np.empty((size, 2, n_series, sine.size))
        for m, legendre in enumerate(_legendre_columns(size - 1, sine, cosine)):
            legendre *= powers[m:]
            per_order[m, 0] = series[m, :, m:].real @ legendre
            per_order[m, 1] = -series[m, :, m:].imag @ legendre
        summed = per_order.reshape(2 * size, -1).T @ harmonics
        values[:, block] = summed.reshape(n_series, sine.size, lon.size)
    return np.swapaxes(values.reshape(n_series, len(lat), h.size, lon.size), 2, 3)


def _legendre_columns(degree: int, sine: Array, cosine: Array) -> Iterator[Array]:
    """Yield the normalised P_nm of each order m, with shape (degree-m+1, n_points).

    The rows are the degrees m to ``degree``. ``sine`` and ``cosine`` (n_points,) are those of the
    geocentric latitude.
    """
    sectorial, exponent = np.ones_like(sine), np.zeros(sine.size, np.int64)
    for m in range(degree + 1):
        if m > 0:
            sectorial = sectorial * cosine * np.sqrt((2 * m + 1) / (2 * m) if m > 1 else 3.0)
            tiny = np.abs(sectorial) < _TINY
            sectorial[tiny] *= _RADIX
            exponent[tiny] -= 1
        n = np.arange(m + 2, degree + 1, dtype=float)
        a = np.sqrt((2 * n - 1) * (2 * n + 1) / ((n - m) * (n + m)))
        b = np.sqrt((2 * n + 1) * (n + m - 1) * (n - m - 1) / ((n - m) * (n + m) * (2 * n - 3)))
        column = np.empty((degree - m + 1, sine.size))
        _fill_column(
            sine=sine,
            sectorial=sectorial,
            exponent=exponent,
            first=np.sqrt(2.0 * m + 3.0),
            a=a,
            b=b,
            column=column,
        )
        yield column


@compiled
def _fill_column(
    sine: np.ndarray,
    sectorial: np.ndarray,
    exponent: np.ndarray,
    first: float,
    a: np.ndarray,
    b: np.ndarray,
    column: np.ndarray,
) -> None:
    """Fill ``column`` with P_nm of one order m for all degrees and points.

    The recursion starts at P_mm = ``sectorial * 2^(960 exponent)``. While the exponent of a point
    is negative, values are below 2^-480 and are stored as zero.
    """
    rows, points = column.shape
    old, new = np.empty(points), np.empty(points)
    power = exponent.copy()
    pending = 0
    for p in range(points):
        old[p] = sectorial[p]
        new[p] = first * sine[p] * sectorial[p]
        pending += power[p] < 0
        column[0, p] = old[p] if power[p] == 0 else 0.0
    for i in range(1, rows):
        if i > 1:
            for p in range(points):
                value = a[i - 2] * sine[p] * new[p] - b[i - 2] * old[p]
                old[p] = new[p]
                new[p] = value
        if pending == 0:
            for p in range(points):
                column[i, p] = new[p]
            continue
        for p in range(points):
            while power[p] < 0 and abs(new[p]) > _HUGE:
                old[p] /= _RADIX
                new[p] /= _RADIX
                power[p] += 1
                pending -= power[p] == 0
            column[i, p] = new[p] if power[p] == 0 else 0.0


def _ecef_to_enu(latitude: Array, longitude: Array) -> Array:
    """C_ne, from Earth-fixed to geodetic east-north-up axes, shape (n_lat, n_lon, 3, 3)."""
    sin_lat, cos_lat = np.sin(latitude)[:, np.newaxis], np.cos(latitude)[:, np.newaxis]
    sin_lon, cos_lon = np.sin(longitude), np.cos(longitude)
    C_ne = np.zeros((latitude.size, longitude.size, 3, 3))
    C_ne[..., 0, 0] = -sin_lon
    C_ne[..., 0, 1] = cos_lon
    C_ne[..., 1, 0] = -sin_lat * cos_lon
    C_ne[..., 1, 1] = -sin_lat * sin_lon
    C_ne[..., 1, 2] = cos_lat
    C_ne[..., 2, 0] = cos_lat * cos_lon
    C_ne[..., 2, 1] = cos_lat * sin_lon
    C_ne[..., 2, 2] = sin_lat
    return C_ne
