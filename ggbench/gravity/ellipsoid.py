"""WGS84 ellipsoid: radii of curvature, normal gravity, normal gravity-gradient tensor.

All derivatives of the normal potential come from one sum of the even zonal harmonics J2..J12.
Therefore normal gravity, the gravity gradient in the INS error model and the measured gradient are
consistent. The sum reproduces the closed forms of normal gravity to a relative error of 1e-13 and
the normal gradient to 1e-10 E (J14 is below 2e-19).

Latitudes are geodetic. Angles are in rad, heights in m above the ellipsoid, gravity in m/s²,
gradients in E (1 E = 1e-9 s⁻²). Normal gravity includes the centrifugal acceleration. The gradient
excludes the gradient of the centrifugal acceleration, because a gradiometer that does not rotate in
inertial space does not measure it.
"""

from __future__ import annotations

import math

import numpy as np

from ..numerics.kernels import compiled, copied, inlined
from ..numerics.vectors import like

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
        -2.0 * (-1.0) ** k * k * second_eccentricity ** (2 * k + 1) / ((2 * k + 1) * (2 * k + 3))
        for k in range(1, 12)
    )
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


@inlined
def radii_of_sine(sine: float) -> tuple[float, float]:
    """Return the radii (R_M, R_N) [m] of :func:`radii_of_curvature`, given sin L."""
    w2 = 1.0 - ECCENTRICITY_SQUARED * sine * sine
    prime_vertical = SEMI_MAJOR_AXIS / math.sqrt(w2)
    return prime_vertical * (1.0 - ECCENTRICITY_SQUARED) / w2, prime_vertical


@compiled
def radii_of_curvature(latitude: float) -> tuple[float, float]:
    """Return the meridian and the prime-vertical radius (R_M, R_N) [m] (Groves, eq. 2.105)."""
    return radii_of_sine(math.sin(latitude))


@inlined
def metres_per_radian_of(sine: float, cosine: float, height: float) -> tuple[float, float]:
    """Return metres per radian of latitude and of longitude, given sin L and cos L [m/rad].

    The values are R_M + h and (R_N + h) cos L, with the radii of curvature R_M and R_N.

    Parameters
    ----------
    sine, cosine : sin L and cos L of the latitude L.
    height : height h above the ellipsoid [m].
    """
    meridian, prime_vertical = radii_of_sine(sine)
    return meridian + height, (prime_vertical + height) * cosine


@compiled
def metres_per_radian(position: np.ndarray) -> tuple[float, float]:
    """Return metres per radian of latitude and of longitude, R_M + h and (R_N + h) cos L [m/rad].

    Parameters
    ----------
    position : (3,) latitude, longitude [rad], height [m].
    """
    return metres_per_radian_of(math.sin(position[0]), math.cos(position[0]), position[2])


@compiled
def metres_along(positions: np.ndarray) -> np.ndarray:
    """Return metres per radian of longitude and of latitude (N, 2) [m/rad] at N positions.

    Note the order: east, then north. ``positions`` (N, 3) are latitude, longitude [rad], height
    [m].
    """
    out = np.empty((positions.shape[0], 2))
    for k in range(positions.shape[0]):
        out[k, 1], out[k, 0] = metres_per_radian(positions[k])
    return out


@inlined
def radii_derivatives_of(sine: float, cosine: float) -> tuple[float, float]:
    """Return the derivatives dR_M/dL and dR_N/dL of the radii [m/rad], given sin L and cos L."""
    meridian, prime_vertical = radii_of_sine(sine)
    ratio = ECCENTRICITY_SQUARED * sine * cosine / (1.0 - ECCENTRICITY_SQUARED * sine * sine)
    return 3.0 * meridian * ratio, prime_vertical * ratio


def _legendre_coefficients(derivatives: int) -> np.ndarray:
    """Return coefficients c[d, i, k] of the d-th derivatives of Legendre polynomials P_n.

    The d-th derivative of P_n(s) is s^(d mod 2) Σ_k c[d, i, k] s^(2k), with n = 2i + 2.
    """
    degrees = 2 * np.arange(1, EVEN_ZONALS.size + 1)
    table = np.zeros((derivatives + 1, degrees.size, degrees[-1] // 2 + 1))
    for i, n in enumerate(degrees):
        powers = np.polynomial.Legendre.basis(int(n)).convert(kind=np.polynomial.Polynomial).coef
        for d in range(derivatives + 1):
            values = np.polynomial.polynomial.polyder(powers, d)[d % 2 :: 2]
            table[d, i, : values.size] = values
    return table


_LEGENDRE = _legendre_coefficients(3)
_DEGREES = EVEN_ZONALS.size


@inlined
def _zonal_derivatives(radius: float, sine: float) -> tuple[float, float, float, float, float]:
    """Return V_r, V_s, V_rr, V_rs, V_ss of the zonal potential, s = sin(geocentric latitude).

    The potential is V = GM/r (1 − Σ J_n (a/r)^n P_n(s)). It is evaluated by Horner's rule in s² and
    in (a/r)².
    """
    square, zero = sine * sine, like(sine, 0.0)
    ratio = SEMI_MAJOR_AXIS / radius
    ratio = ratio * ratio
    v_r = v_rr = v_s = v_rs = v_ss = zero
    for i in range(_DEGREES - 1, -1, -1):
        p0 = p1 = p2 = zero
        for k in range(i + 1, -1, -1):
            p0 = p0 * square + _LEGENDRE[0, i, k]
        for k in range(i, -1, -1):
            p1 = p1 * square + _LEGENDRE[1, i, k]
            p2 = p2 * square + _LEGENDRE[2, i, k]
        n = 2 * i + 2
        v_r = (v_r + EVEN_ZONALS[i] * (n + 1) * p0) * ratio
        v_rr = (v_rr + EVEN_ZONALS[i] * (n + 1) * (n + 2) * p0) * ratio
        v_s = (v_s + EVEN_ZONALS[i] * p1) * ratio
        v_rs = (v_rs + EVEN_ZONALS[i] * (n + 1) * p1) * ratio
        v_ss = (v_ss + EVEN_ZONALS[i] * p2) * ratio
    potential = GM / radius
    slope = potential / radius
    return (
        slope * (v_r - 1.0),
        -potential * sine * v_s,
        slope / radius * (2.0 - v_rr),
        slope * sine * v_rs,
        -potential * v_ss,
    )


@copied
def _zonal_third_derivatives(radius: float, sine: float) -> tuple[float, float, float, float]:
    """Return V_rrr, V_rrs, V_rss, V_sss, as :func:`_zonal_derivatives` does."""
    square, zero = sine * sine, like(sine, 0.0)
    ratio = SEMI_MAJOR_AXIS / radius
    ratio = ratio * ratio
    v_rrr = v_rrs = v_rss = v_sss = zero
    for i in range(_DEGREES - 1, -1, -1):
        p0 = p1 = p2 = p3 = zero
        for k in range(i + 1, -1, -1):
            p0 = p0 * square + _LEGENDRE[0, i, k]
        for k in range(i, -1, -1):
            p1 = p1 * square + _LEGENDRE[1, i, k]
            p2 = p2 * square + _LEGENDRE[2, i, k]
            p3 = p3 * square + _LEGENDRE[3, i, k]
        n = 2 * i + 2
        v_rrr = (v_rrr + EVEN_ZONALS[i] * (n + 1) * (n + 2) * (n + 3) * p0) * ratio
        v_rrs = (v_rrs + EVEN_ZONALS[i] * (n + 1) * (n + 2) * p1) * ratio
        v_rss = (v_rss + EVEN_ZONALS[i] * (n + 1) * p2) * ratio
        v_sss = (v_sss + EVEN_ZONALS[i] * p3) * ratio
    potential = GM / radius
    slope = potential / radius
    return (
        slope / (radius * radius) * (v_rrr - 6.0),
        -slope / radius * sine * v_rrs,
        slope * v_rss,
        -potential * sine * v_sss,
    )


@inlined
def _geocentric(
    sine: float, cosine: float, height: float
) -> tuple[float, float, float, float, float]:
    """Return r [m], sin and cos of the geocentric latitude φ', sin and cos of ψ = L − φ'.

    ``sine`` and ``cosine`` are sin L and cos L of the geodetic latitude L.
    """
    _, prime_vertical = radii_of_sine(sine)
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


@inlined
def _geocentric_gravity(r: float, s: float, c: float) -> tuple[float, float, float, float, float]:
    """Return gravity north and up [m/s²] and its gradient NN, NU, UU [s⁻²] in geocentric axes.

    Gravity is the sum of gravitation and centrifugal acceleration. ``r`` is the geocentric radius
    [m]; ``s`` and ``c`` are sine and cosine of the geocentric latitude.
    """
    v_r, v_s, v_rr, v_rs, v_ss = _zonal_derivatives(r, s)
    omega2 = ROTATION_RATE * ROTATION_RATE
    north = c * v_s / r - omega2 * r * c * s
    up = v_r + omega2 * r * c * c
    north_north = (c * c * v_ss - s * v_s) / (r * r) + v_r / r + omega2 * s * s
    north_up = c * (v_rs / r - v_s / (r * r)) - omega2 * s * c
    up_up = v_rr + omega2 * c * c
    return north, up, north_north, north_up, up_up


@inlined
def normal_gravity_of(sine: float, cosine: float, height: float) -> tuple[float, float, float]:
    """Return γ, ∂γ/∂L and ∂γ/∂h as :func:`normal_gravity` does, given sin L and cos L.

    The derivatives of γ = |g| are g·dg/γ. The derivative dg of the gravity vector g follows
    from the gradient tensor.
    """
    r, s, c, sin_psi, cos_psi = _geocentric(sine, cosine, height)
    north, up, north_north, north_up, up_up = _geocentric_gravity(r, s, c)
    gamma = math.sqrt(north * north + up * up)
    along_north = (north * north_north + up * north_up) / gamma
    along_up = (north * north_up + up * up_up) / gamma
    # Geodetic north and up are geocentric north and up turned by ψ.
    meridian, _ = radii_of_sine(sine)
    d_latitude = (meridian + height) * (cos_psi * along_north - sin_psi * along_up)
    d_height = sin_psi * along_north + cos_psi * along_up
    return gamma, d_latitude, d_height


@inlined
def normal_gravity_vector_of(sine: float, cosine: float, height: float) -> tuple[float, float]:
    """Return normal gravity (north, up) in geodetic axes [m/s²], given sin L and cos L.

    The east component is zero.

    Plumb lines of the normal field are curved. Therefore gravity above the ellipsoid has the north
    component −8.08e-9 h sin 2L m/s² (h in m; Heiskanen & Moritz 1967, sec. 5-6): 4 mGal to the
    south at 5 km and 45° north.
    """
    r, s, c, sin_psi, cos_psi = _geocentric(sine, cosine, height)
    north, up, _, _, _ = _geocentric_gravity(r, s, c)
    return cos_psi * north - sin_psi * up, sin_psi * north + cos_psi * up


@inlined
def normal_gravity_slopes_of(
    sine: float, cosine: float, height: float
) -> tuple[float, float, float, float]:
    """Return ∂g_N/∂L, ∂g_N/∂h, ∂g_U/∂L, ∂g_U/∂h of normal gravity (g_N, g_U).

    The vector is that of :func:`normal_gravity_vector_of`; derivatives are per rad and per m. The
    derivatives follow from the gradient tensor and from the rotation of the axes by dL over the
    distance (R_M + h) dL.
    """
    r, s, c, sin_psi, cos_psi = _geocentric(sine, cosine, height)
    north, up, north_north, north_up, up_up = _geocentric_gravity(r, s, c)
    sin2, cos2, cross = sin_psi * sin_psi, cos_psi * cos_psi, sin_psi * cos_psi
    nn = cos2 * north_north - 2.0 * cross * north_up + sin2 * up_up
    nu = cross * (north_north - up_up) + (cos2 - sin2) * north_up
    uu = sin2 * north_north + 2.0 * cross * north_up + cos2 * up_up
    meridian, _ = radii_of_sine(sine)
    radius = meridian + height
    along_north, along_up = cos_psi * north - sin_psi * up, sin_psi * north + cos_psi * up
    return radius * nn - along_up, nu, radius * nu + along_north, uu


@compiled
def normal_gravity(latitude: float, height: float) -> tuple[float, float, float]:
    """Return normal gravity γ [m/s²], ∂γ/∂L [m/s²/rad] and ∂γ/∂h [s⁻²] at a geodetic position.

    γ is the magnitude of normal gravity, the sum of gravitation and centrifugal acceleration.
    """
    return normal_gravity_of(math.sin(latitude), math.cos(latitude), height)


@compiled
def normal_gravity_along(positions: np.ndarray) -> np.ndarray:
    """Return normal gravity γ (N,) [m/s²] at positions (N, 3) [rad, rad, m]."""
    out = np.empty(positions.shape[0])
    for k in range(positions.shape[0]):
        out[k] = normal_gravity(positions[k, 0], positions[k, 2])[0]
    return out


@inlined
def normal_gradient_of(
    sine: float, cosine: float, height: float
) -> tuple[float, float, float, float]:
    """Return the components EE, NN, NU, UU of the normal gradient [E]; EN and EU are zero.

    ``sine`` and ``cosine`` are sin L and cos L of the geodetic latitude, ``height`` is in m. The
    gradient tensor of the zonal potential V(r, sin φ') is computed in spherical axes (e.g.
    Hofmann-Wellenhof & Moritz 2006). The axes are then rotated about the east axis by ψ = L − φ',
    with the geocentric latitude φ'.
    """
    r, s, c, sin_psi, cos_psi = _geocentric(sine, cosine, height)
    v_r, v_s, v_rr, v_rs, v_ss = _zonal_derivatives(r, s)
    ee = v_r / r - s * v_s / (r * r)
    nn = v_r / r + (c * c * v_ss - s * v_s) / (r * r)
    nu = c * (v_rs / r - v_s / (r * r))
    sin2, cos2, cross = sin_psi * sin_psi, cos_psi * cos_psi, sin_psi * cos_psi
    return (
        ee / EOTVOS,
        (cos2 * nn - 2.0 * cross * nu + sin2 * v_rr) / EOTVOS,
        (cross * (nn - v_rr) + (cos2 - sin2) * nu) / EOTVOS,
        (sin2 * nn + 2.0 * cross * nu + cos2 * v_rr) / EOTVOS,
    )


@inlined
def normal_gradient_slopes_of(
    sine: float, cosine: float, height: float
) -> tuple[float, float, float, float, float, float, float, float]:
    """Return the northward, then the upward derivatives of EE, NN, NU and UU [E/m].

    The components are those of :func:`normal_gradient_of`, in axes that move with the point. The
    chain rule uses the radius r(L, h), the geocentric latitude φ'(L, h) and ψ(L, h) = L − φ'.
    Eastward derivatives are zero.
    """
    r, s, c, sin_psi, cos_psi = _geocentric(sine, cosine, height)
    v_r, v_s, v_rr, v_rs, v_ss = _zonal_derivatives(r, s)
    v_rrr, v_rrs, v_rss, v_sss = _zonal_third_derivatives(r, s)
    r2, r3 = r * r, r * r * r
    # Derivatives along r, and along the geocentric latitude (d/dφ' = c d/ds, ds = c dφ').
    ee_r = v_rr / r - v_r / r2 - s * v_rs / r2 + 2.0 * s * v_s / r3
    nn_r = (
        v_rr / r - v_r / r2 + (c * c * v_rss - s * v_rs) / r2 - 2.0 * (c * c * v_ss - s * v_s) / r3
    )
    uu_r = v_rrr
    nu_r = c * (v_rrs / r - 2.0 * v_rs / r2 + 2.0 * v_s / r3)
    ee_phi = c * (v_rs / r - v_s / r2 - s * v_ss / r2)
    nn_phi = c * (v_rs / r + (c * c * v_sss - 3.0 * s * v_ss - v_s) / r2)
    uu_phi = c * v_rrs
    nu_phi = -s * (v_rs / r - v_s / r2) + c * c * (v_rss / r - v_ss / r2)

    # A metre to the geodetic north and up, as changes of r, φ' and ψ.
    meridian, _ = radii_of_sine(sine)
    _, nn, nu, uu = normal_gradient_of(sine, cosine, height)
    sin2, cos2, cross = sin_psi * sin_psi, cos_psi * cos_psi, sin_psi * cos_psi
    zero = like(sine, 0.0)
    slopes = (zero, zero, zero, zero)
    north = slopes
    for axis in range(2):
        if axis == 0:
            d_r, d_phi = -sin_psi, cos_psi / r
            d_psi = 1.0 / (meridian + height) - d_phi
        else:
            d_r, d_phi = cos_psi, sin_psi / r
            d_psi = -d_phi
        d_ee = ee_r * d_r + ee_phi * d_phi
        d_nn = nn_r * d_r + nn_phi * d_phi
        d_uu = uu_r * d_r + uu_phi * d_phi
        d_nu = nu_r * d_r + nu_phi * d_phi
        north = slopes
        # The rotation itself: d(NN)/dψ = −2 NU, d(NU)/dψ = NN − UU, d(UU)/dψ = 2 NU.
        slopes = (
            d_ee / EOTVOS,
            (cos2 * d_nn - 2.0 * cross * d_nu + sin2 * d_uu) / EOTVOS - 2.0 * nu * d_psi,
            (cross * (d_nn - d_uu) + (cos2 - sin2) * d_nu) / EOTVOS + (nn - uu) * d_psi,
            (sin2 * d_nn + 2.0 * cross * d_nu + cos2 * d_uu) / EOTVOS + 2.0 * nu * d_psi,
        )
    return (*north, *slopes)
