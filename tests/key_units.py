"""Units that keys of scenario files name, read by astropy."""

from __future__ import annotations

from typing import Any

import astropy.units as u
from astropy.constants import g0

EOTVOS = 1e-9 / u.s**2
SUFFIXES = {
    "kg_m3": u.kg / u.m**3,
    "deg_per_sqrt_h": u.deg / u.hour**0.5,
    "deg_per_h": u.deg / u.hour,
    "deg_per_s": u.deg / u.s,
    "ug_per_sqrt_hz": 1e-6 * g0 / u.Hz**0.5,
    "ng_per_sqrt_hz": 1e-9 * g0 / u.Hz**0.5,
    "eotvos_per_sqrt_hz": EOTVOS / u.Hz**0.5,
    "eotvos_per_sqrt_h": EOTVOS / u.hour**0.5,
    "m_per_sqrt_hz": u.m / u.Hz**0.5,
    "ppm_per_sqrt_h": 1e-6 / u.hour**0.5,
    "arcmin": u.arcmin,
    "mgal": 1e-5 * u.m / u.s**2,
    "eotvos": EOTVOS,
    "ppm": 1e-6 * u.one,
    "mps2": u.m / u.s**2,
    "mps": u.m / u.s,
    "deg": u.deg,
    "hz": u.Hz,
    "ug": 1e-6 * g0,
    "km": u.km,
    "m": u.m,
    "s": u.s,
}
"""Endings of keys, the longer ones first."""


def unit_of(key: str) -> Any:
    """The unit that a key names, None if it names none."""
    return next((unit for end, unit in SUFFIXES.items() if key.endswith(f"_{end}")), None)


def si(key: str, value: Any) -> Any:
    """A value of a key, or a list of values, in SI units, by astropy."""
    return (value * unit_of(key)).si.value


E = 1e-9
"""What the package's numbers of gradients are in SI: they alone are kept in another unit."""
