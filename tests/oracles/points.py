"""The navigation equations and the normal gradient at one point, through the kernels' parts."""

from __future__ import annotations

import math

import numpy as np

from ggbench.gravity.ellipsoid import normal_gradient_of, normal_gradient_slopes_of
from ggbench.ins.local_level import frame_rates_of, place_of, position_rate_of
from ggbench.ins.strapdown import velocity_rate_of
from ggbench.numerics.kernels import compiled


@compiled
def frame_rates(
    latitude: float, height: float, velocity: np.ndarray, omega_ie: np.ndarray, omega_en: np.ndarray
) -> None:
    """Fill the earth rate ω_ie^n and the transport rate ω_en^n [rad/s]."""
    place = place_of(latitude, height)
    omega_ie[0] = 0.0
    omega_ie[1], omega_ie[2], omega_en[0], omega_en[1], omega_en[2] = frame_rates_of(
        place, velocity[0], velocity[1]
    )


@compiled
def position_rate(position: np.ndarray, velocity: np.ndarray, out: np.ndarray) -> None:
    """Fill (L', λ', h') of a position [rad, rad, m] and an ENU velocity [m/s]."""
    out[0], out[1] = position_rate_of(place_of(position[0], position[2]), velocity[0], velocity[1])
    out[2] = velocity[2]


@compiled
def velocity_rate(
    position: np.ndarray, velocity: np.ndarray, specific_force: np.ndarray, out: np.ndarray
) -> None:
    """Fill v' [m/s²] for a specific force in n axes."""
    v, f = (velocity[0], velocity[1], velocity[2]), specific_force
    place = place_of(position[0], position[2])
    out[0], out[1], out[2] = velocity_rate_of(place, position[2], v, (f[0], f[1], f[2]))


@compiled
def attitude_rate(
    position: np.ndarray,
    velocity: np.ndarray,
    c_nb: np.ndarray,
    angular_rate: np.ndarray,
    out: np.ndarray,
) -> None:
    """Fill ω_nb^n [rad/s]: the rate at which b turns against n, C_nb ω_ib − ω_ie − ω_en."""
    omega_ie = np.empty(3)
    omega_en = np.empty(3)
    frame_rates(position[0], position[2], velocity, omega_ie, omega_en)
    for i in range(3):
        body = (
            c_nb[i, 0] * angular_rate[0]
            + c_nb[i, 1] * angular_rate[1]
            + c_nb[i, 2] * angular_rate[2]
        )
        out[i] = body - omega_ie[i] - omega_en[i]


@compiled
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
    """
    sine, cosine = math.sin(latitude), math.cos(latitude)
    value[1] = value[2] = 0.0
    value[0], value[3], value[4], value[5] = normal_gradient_of(sine, cosine, height)
    slopes = normal_gradient_slopes_of(sine, cosine, height)
    derivative[:, :] = 0.0
    derivative[0, 1], derivative[0, 2] = slopes[0], slopes[4]
    derivative[3, 1], derivative[3, 2] = slopes[1], slopes[5]
    derivative[4, 1], derivative[4, 2] = slopes[2], slopes[6]
    derivative[5, 1], derivative[5, 2] = slopes[3], slopes[7]
