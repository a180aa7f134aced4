"""The field of point masses: gradient and attraction, on a plane."""

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
    """Fill the field of point masses at points, (n, 9).

    Parameters
    ----------
    points, places : east, north, up of the points (3, n) and the masses (3, m) [m].
    masses : (m,) [1e9 kg].
    out : [EE, EN, EU, NN, NU, UU] [E] and the attraction east, north, up [m/s²].
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
    """Fill sums of the nine components of unit masses of 1e9 kg, (c, n, m).

    Parameters
    ----------
    points, places : as in :func:`fields`.
    weights : of the nine components in each sum, (c, 9).
    out : (c, n, m), in the units of :func:`fields`.
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
