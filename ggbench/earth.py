"""WGS84: the ellipsoid, its normal gravity and its normal gravity-gradient tensor.

One compiled kernel, :func:`normal_field`, sums the even zonal harmonics J2..J12 of the normal
potential. They reproduce the closed forms of normal gravity to 1e-13 and the normal gradient to
1e-10 E (J14 is below 2e-19), so gravity, its derivative in the mechanization and the gradient that
the gradiometer feels can never disagree.

Angles in rad, heights in m above the ellipsoid, gravity in m/s², gradients in E (1 E = 1e-9 s⁻²).
The gradient is the *gravitational* part only: a gradiometer that does not rotate in inertial space
does not feel the centrifugal potential; normal gravity includes it.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

SEMI_MAJOR_AXIS = 6378137.0
FLATTENING = 1.0 / 298.257223563
ECCENTRICITY_SQUARED = FLATTENING * (2.0 - FLATTENING)
ROTATION_RATE = 7.292115e-5
GM = 3.986004418e14
EOTVOS = 1e-9


def _dynamical_form_factors(count: int) -> np.ndarray:
    """Return J2, J4, ... of the level ellipsoid (Heiskanen & Moritz 1967, eqs. 2-90 to 2-92)."""
    semi_minor = SEMI_MAJOR_AXIS * (1.0 - FLATTENING)
    second_eccentricity = math.sqrt(ECCENTRICITY_SQUARED) / (1.0 - FLATTENING)
    # q0 by its series in e': the closed form loses six digits to cancellation.
    q0 = sum(
        2.0 * (-1.0) ** (k + 1) * k * second_eccentricity ** (2 * k + 1)
        / ((2 * k + 1) * (2 * k + 3))
        for k in range(1, 12)
    )  # fmt: skip
    m = ROTATION_RATE**2 * SEMI_MAJOR_AXIS**2 * semi_minor / GM
    j2 = ECCENTRICITY_SQUARED / 3.0 * (1.0 - 2.0 / 15.0 * m * second_eccentricity / q0)
    degree = np.arange(1, count + 1)
    return (
        (-1.0) ** (degree + 1)
        * 3.0
        * ECCENTRICITY_SQUARED**degree
        / ((2 * degree + 1) * (2 * degree + 3))
        * (1.0 - degree + 5.0 * degree * j2 / ECCENTRICITY_SQUARED)
    )


EVEN_ZONALS = _dynamical_form_factors(6)
"""Unnormalised J2, J4, ..., J12 of the WGS84 normal field."""


@njit(cache=True)
def radii_of_curvature(latitude: float) -> tuple[float, float]:
    """Return the meridian and the prime-vertical radius (R_M, R_N) [m] (Groves, eq. 2.105)."""
    w2 = 1.0 - ECCENTRICITY_SQUARED * math.sin(latitude) ** 2
    prime_vertical = SEMI_MAJOR_AXIS / math.sqrt(w2)
    return prime_vertical * (1.0 - ECCENTRICITY_SQUARED) / w2, prime_vertical


@njit(cache=True)
def radii_latitude_derivatives(latitude: float) -> tuple[float, float]:
    """Return dR_M/dL and dR_N/dL [m/rad]."""
    sine = math.sin(latitude)
    w2 = 1.0 - ECCENTRICITY_SQUARED * sine * sine
    meridian, prime_vertical = radii_of_curvature(latitude)
    ratio = ECCENTRICITY_SQUARED * sine * math.cos(latitude) / w2
    return 3.0 * meridian * ratio, prime_vertical * ratio


@njit(cache=True)
def _zonal_potential(radius: float, sine: float, out: np.ndarray) -> None:
    """Fill ``out[i, j]`` with ∂^(i+j) V / ∂r^i ∂s^j, s = sin(geocentric latitude), i + j <= 3."""
    out[:] = 0.0
    # Legendre polynomials P_n(s) and three derivatives by the derivatives of Bonnet's recursion.
    older = np.zeros(4)
    old = np.zeros(4)
    new = np.zeros(4)
    old[0] = 1.0
    out[0, 0] = GM / radius
    out[1, 0] = -GM / radius**2
    out[2, 0] = 2.0 * GM / radius**3
    out[3, 0] = -6.0 * GM / radius**4
    for n in range(1, 2 * EVEN_ZONALS.size + 1):
        for j in range(4):
            value = (2 * n - 1) * sine * old[j] - (n - 1) * older[j]
            if j > 0:
                value += (2 * n - 1) * j * old[j - 1]
            new[j] = value / n
        older[:] = old
        old[:] = new
        if n % 2 == 0:
            term = -EVEN_ZONALS[n // 2 - 1] * GM / radius * (SEMI_MAJOR_AXIS / radius) ** n
            for i in range(4):
                for j in range(4 - i):
                    out[i, j] += term * new[j]
                term *= -(n + 1 + i) / radius


@njit(cache=True)
def _geocentric(latitude: float, height: float) -> tuple[float, float, float, float, float]:
    """Return r [m], sin and cos of the geocentric latitude φ', sin and cos of ψ = L − φ'."""
    sine, cosine = math.sin(latitude), math.cos(latitude)
    _, prime_vertical = radii_of_curvature(latitude)
    equatorial = (prime_vertical + height) * cosine
    polar = (prime_vertical * (1.0 - ECCENTRICITY_SQUARED) + height) * sine
    radius = math.sqrt(equatorial * equatorial + polar * polar)
    sine_geocentric, cosine_geocentric = polar / radius, equatorial / radius
    return (
        radius,
        sine_geocentric,
        cosine_geocentric,
        sine * cosine_geocentric - cosine * sine_geocentric,
        cosine * cosine_geocentric + sine * sine_geocentric,
    )


@njit(cache=True)
def normal_gravity(latitude: float, height: float) -> tuple[float, float, float]:
    """Return normal gravity γ [m/s²], ∂γ/∂L [m/s²/rad] and ∂γ/∂h [s⁻²] at a geodetic position.

    γ is the magnitude of gravity (gravitation and centrifugal); the mechanization applies it along
    the ellipsoidal vertical. Since γ = |g|, dγ = g·dg/γ with dg from the gradient tensor.
    """
    v = np.empty((4, 4))
    r, s, c, sin_psi, cos_psi = _geocentric(latitude, height)
    _zonal_potential(r, s, v)
    # Gravity and its gradient in geocentric north and up.
    omega2 = ROTATION_RATE * ROTATION_RATE
    north = c * v[0, 1] / r - omega2 * r * c * s
    up = v[1, 0] + omega2 * r * c * c
    gamma = math.sqrt(north * north + up * up)
    north_north = (c * c * v[0, 2] - s * v[0, 1]) / (r * r) + v[1, 0] / r + omega2 * s * s
    north_up = c * (v[1, 1] / r - v[0, 1] / (r * r)) - omega2 * s * c
    up_up = v[2, 0] + omega2 * c * c
    along_north = (north * north_north + up * north_up) / gamma
    along_up = (north * north_up + up * up_up) / gamma
    # Geodetic north and up are geocentric north and up turned by ψ.
    meridian, _ = radii_of_curvature(latitude)
    d_latitude = (meridian + height) * (cos_psi * along_north - sin_psi * along_up)
    d_height = sin_psi * along_north + cos_psi * along_up
    return gamma, d_latitude, d_height


@njit(cache=True)
def normal_gradient(
    latitude: float, height: float, value: np.ndarray, derivative: np.ndarray
) -> None:
    """Fill the normal gravitational gradient tensor and its derivative.

    Parameters
    ----------
    latitude, height : geodetic position [rad, m].
    value : (6,) output, [EE, EN, EU, NN, NU, UU] in geodetic ENU axes [E].
    derivative : (6, 3) output, derivative of these six numbers for a displacement of one metre to
        the east, north and up [E/m]; the axes move with the point.

    Notes
    -----
    Spherical components of a zonal potential V(r, s) (e.g. Hofmann-Wellenhof & Moritz), turned by
    ψ = L − φ' about the east axis, and the chain rule through r(L, h), φ'(L, h), ψ(L, h).
    """
    v = np.empty((4, 4))
    r, s, c, sin_psi, cos_psi = _geocentric(latitude, height)
    _zonal_potential(r, s, v)
    r2, r3 = r * r, r * r * r
    ee = v[1, 0] / r - s * v[0, 1] / r2
    nn = v[1, 0] / r + (c * c * v[0, 2] - s * v[0, 1]) / r2
    uu = v[2, 0]
    nu = c * (v[1, 1] / r - v[0, 1] / r2)
    # Derivatives along r, and along the geocentric latitude (d/dφ' = c d/ds, ds = c dφ').
    ee_r = v[2, 0] / r - v[1, 0] / r2 - s * v[1, 1] / r2 + 2.0 * s * v[0, 1] / r3
    nn_r = (
        v[2, 0] / r
        - v[1, 0] / r2
        + (c * c * v[1, 2] - s * v[1, 1]) / r2
        - 2.0 * (c * c * v[0, 2] - s * v[0, 1]) / r3
    )
    uu_r = v[3, 0]
    nu_r = c * (v[2, 1] / r - 2.0 * v[1, 1] / r2 + 2.0 * v[0, 1] / r3)
    ee_phi = c * (v[1, 1] / r - v[0, 1] / r2 - s * v[0, 2] / r2)
    nn_phi = c * (v[1, 1] / r + (c * c * v[0, 3] - 3.0 * s * v[0, 2] - v[0, 1]) / r2)
    uu_phi = c * v[2, 1]
    nu_phi = -s * (v[1, 1] / r - v[0, 1] / r2) + c * c * (v[1, 2] / r - v[0, 2] / r2)

    # A metre to the geodetic north and up, as changes of r, φ' and ψ.
    meridian, _ = radii_of_curvature(latitude)
    sin2, cos2, cross = sin_psi * sin_psi, cos_psi * cos_psi, sin_psi * cos_psi
    value[0] = ee / EOTVOS
    value[1] = 0.0
    value[2] = 0.0
    value[3] = (cos2 * nn - 2.0 * cross * nu + sin2 * uu) / EOTVOS
    value[4] = (cross * (nn - uu) + (cos2 - sin2) * nu) / EOTVOS
    value[5] = (sin2 * nn + 2.0 * cross * nu + cos2 * uu) / EOTVOS
    derivative[:, :] = 0.0
    for axis in range(1, 3):
        if axis == 1:
            d_r, d_phi = -sin_psi, cos_psi / r
            d_psi = 1.0 / (meridian + height) - d_phi
        else:
            d_r, d_phi = cos_psi, sin_psi / r
            d_psi = -d_phi
        d_ee = ee_r * d_r + ee_phi * d_phi
        d_nn = nn_r * d_r + nn_phi * d_phi
        d_uu = uu_r * d_r + uu_phi * d_phi
        d_nu = nu_r * d_r + nu_phi * d_phi
        derivative[0, axis] = d_ee / EOTVOS
        # The rotation itself: d(NN)/dψ = −2 NU, d(NU)/dψ = NN − UU, d(UU)/dψ = 2 NU.
        derivative[3, axis] = (
            cos2 * d_nn - 2.0 * cross * d_nu + sin2 * d_uu
        ) / EOTVOS - 2.0 * value[4] * d_psi
        derivative[4, axis] = (cross * (d_nn - d_uu) + (cos2 - sin2) * d_nu) / EOTVOS + (
            value[3] - value[5]
        ) * d_psi
        derivative[5, axis] = (
            sin2 * d_nn + 2.0 * cross * d_nu + cos2 * d_uu
        ) / EOTVOS + 2.0 * value[4] * d_psi
