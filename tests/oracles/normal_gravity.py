"""Normal gravity of WGS84 in closed form, apart from the package's series of zonal harmonics."""

from __future__ import annotations

import numpy as np


def closed_form_gravity(latitude: float, height: float) -> tuple[float, float]:
    """Normal gravity north and up [m/s²] in closed form, by ellipsoidal-harmonic coordinates u, β.

    Heiskanen & Moritz 1967, eqs. 2-66 to 2-68 (the gradient of the potential of eq. 2-62).
    """
    a, b, omega = 6378137.0, 6378137.0 * (1.0 - 1.0 / 298.257223563), 7.292115e-5
    e2, gm = a**2 - b**2, 3.986004418e14
    e = np.sqrt(e2)
    normal = a**2 / np.hypot(a * np.cos(latitude), b * np.sin(latitude))
    x = (normal + height) * np.cos(latitude)
    z = (normal * b**2 / a**2 + height) * np.sin(latitude)
    part = x * x + z * z - e2
    u = np.sqrt(0.5 * (part + np.sqrt(part**2 + 4.0 * e2 * z * z)))
    v = np.hypot(u, e)
    beta = np.arctan2(z * v, x * u)
    sine, cosine = np.sin(beta), np.cos(beta)

    def q(u: float) -> float:
        return 0.5 * ((1.0 + 3.0 * u * u / e2) * np.arctan(e / u) - 3.0 * u / e)

    slope = 3.0 * (1.0 + u * u / e2) * (1.0 - u / e * np.arctan(e / u)) - 1.0
    w = np.sqrt(u * u + e2 * sine * sine) / v
    spin, q0 = omega**2 * a**2, q(b)
    along_u = gm / v**2 + spin * e / v**2 * slope / q0 * (0.5 * sine**2 - 1.0 / 6.0)
    along_u = -(along_u - omega**2 * u * cosine**2) / w
    along_beta = (spin / v * q(u) / q0 - omega**2 * v) * sine * cosine / w
    of_x = (along_u * u / v * cosine - along_beta * sine) / w
    of_z = (along_u * sine + along_beta * u / v * cosine) / w
    north = -np.sin(latitude) * of_x + np.cos(latitude) * of_z
    return north, np.cos(latitude) * of_x + np.sin(latitude) * of_z
