"""Rotation rates of the local-level frame, and rate of change of a position."""

from __future__ import annotations

from ..gravity.ellipsoid import ROTATION_RATE, radii_of_sine
from ..numerics.kernels import inlined
from ..numerics.rotations import sine_cosine

Vector = tuple[float, float, float]
"""Three numbers in axes ENU or of the body, or three vectors of the numbers of a group of runs."""
Place = tuple[float, float, float, float]
"""sin L, cos L, R_M + h and R_N + h [m] of a position, from :func:`place_of`."""


@inlined
def place_of(latitude: float, height: float) -> Place:
    """Return sin L, cos L, R_M + h and R_N + h [m] of a position.

    L is the latitude [rad], and h is the height [m]. R_M and R_N are the radii of curvature in the
    meridian and in the prime vertical.
    """
    sine, cosine = sine_cosine(latitude)
    meridian, prime_vertical = radii_of_sine(sine)
    return sine, cosine, meridian + height, prime_vertical + height


@inlined
def frame_rates_of(
    place: Place, v_e: float, v_n: float
) -> tuple[float, float, float, float, float]:
    """Return the Earth rate ω_ie (north, up) and transport rate ω_en (east, north, up) [rad/s].

    The east component of ω_ie is zero. ``place`` is the result of :func:`place_of`. ``v_e`` and
    ``v_n`` are the velocities to the east and to the north [m/s].
    """
    sine, cosine, r_m, r_n = place
    en_n = v_e / r_n
    return ROTATION_RATE * cosine, ROTATION_RATE * sine, -v_n / r_m, en_n, en_n * sine / cosine


@inlined
def position_rate_of(place: Place, v_e: float, v_n: float) -> tuple[float, float]:
    """Return the rates L' and λ' of latitude and longitude [rad/s].

    The arguments are those of :func:`frame_rates_of`.
    """
    _, cosine, r_m, r_n = place
    return v_n / r_m, v_e / (r_n * cosine)
