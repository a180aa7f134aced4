"""Gravity gradient and attraction of point masses, on a flat Earth."""

from __future__ import annotations

import math

import numpy as np

from ..numerics.kernels import compiled, inlined

_GM_EOTVOS = 1e9 * 6.6743e-11 * 1e9
_GM_SI = 6.6743e-11 * 1e9


@inlined
def _field(dx: float, dy: float, dz: float) -> tuple[float, ...]:
    """Return the nine components of a mass of 1e9 kg at an offset east, north, up [m]."""
    squared = dx * dx + dy * dy + dz * dz
    cubed = 1.0 / (squared * math.sqrt(squared))
    second, over = _GM_EOTVOS * cubed, 3.0 * _GM_EOTVOS * cubed / squared
    first = _GM_SI * cubed
    return (
        over * dx * dx - second, over * dx * dy, over * dx * dz, over * dy * dy - second,
        over * dy * dz, over * dz * dz - second, first * dx, first * dy, first * dz,
    )  # fmt: skip


@compiled
def fields(points: np.ndarray, places: np.ndarray, masses: np.ndarray, out: np.ndarray) -> None:
    """Fill ``out`` (n, 9) with the field of point masses at n points.

    Parameters
    ----------
    points : (3, n) east, north and up coordinates of the points [m].
    places : (3, m) east, north and up coordinates of the masses [m].
    masses : (m,) masses [1e9 kg].
    out : (n, 9) EE, EN, EU, NN, NU, UU [E] and attraction east, north, up [m/s²].
    """
    for p in range(points.shape[1]):
        for k in range(9):
            out[p, k] = 0.0
        for s in range(places.shape[1]):
            values = _field(
                places[0, s] - points[0, p], places[1, s] - points[1, p],
                places[2, s] - points[2, p],
            )  # fmt: skip
            for k in range(9):
                out[p, k] += masses[s] * values[k]


@compiled
def responses(points: np.ndarray, places: np.ndarray, weights: np.ndarray, out: np.ndarray) -> None:
    """Fill ``out`` (c, n, m) with c weighted sums of field components, per point and mass.

    There are n points and m masses of 1e9 kg. Each sum is over the nine components of the field
    that one mass causes at one point.

    Parameters
    ----------
    points, places : as in :func:`fields`.
    weights : (c, 9) weights of the nine field components in each sum.
    out : (c, n, m) sums; along the axes: sum, point, mass. Field units are as in :func:`fields`.
    """
    for p in range(points.shape[1]):
        for s in range(places.shape[1]):
            values = _field(
                places[0, s] - points[0, p], places[1, s] - points[1, p],
                places[2, s] - points[2, p],
            )  # fmt: skip
            for c in range(weights.shape[0]):
                total = 0.0
                for k in range(9):
                    total += weights[c, k] * values[k]
                out[c, p, s] = total
