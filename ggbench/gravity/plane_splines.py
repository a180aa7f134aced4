"""Compiled cubic-spline interpolation from a terrain to a plane grid, and to positions.

Coefficients are B-spline coefficients (``scipy.ndimage.spline_filter``).
"""

from __future__ import annotations

import math

import numpy as np

from ..numerics.kernels import compiled, copied
from .stereographic import Plane, from_plane, to_plane


@copied
def _weights(t: float) -> tuple[float, float, float, float]:
    """Return the four cubic B-spline weights at a fraction 0 <= t <= 1 of a cell."""
    u = 1.0 - t
    return (
        u * u * u / 6.0,
        (4.0 - 6.0 * t * t + 3.0 * t * t * t) / 6.0,
        (4.0 - 6.0 * u * u + 3.0 * u * u * u) / 6.0,
        t * t * t / 6.0,
    )


@compiled
def _mirrored(index: int, count: int) -> int:
    """Return the index within 0 to ``count`` − 1 after reflection at both ends."""
    period = 2 * (count - 1)
    folded = index % period
    return folded if folded < count else period - folded


@compiled
def resample(
    ground: np.ndarray,
    coefficients: np.ndarray,
    south_west: np.ndarray,
    steps: np.ndarray,
    metres: np.ndarray,
    edge: float,
    border: float,
    plane: Plane,
    origin: np.ndarray,
    step: np.ndarray,
    surface: np.ndarray,
) -> None:
    """Fill ``surface`` (n_y, n_x) with the heights of a terrain on a plane grid [m].

    Between nodes the surface is a cubic spline. It is limited to the range of the heights of the 16
    surrounding nodes, so that it does not overshoot at cliffs. Beyond the edges it is the mirror
    image of the terrain, faded into the height ``edge`` [m] over the distance ``border`` [m].
    """
    rows, columns = ground.shape
    near_row, near_column = np.empty(4, np.int64), np.empty(4, np.int64)
    for j in range(surface.shape[0]):
        for i in range(surface.shape[1]):
            latitude, longitude = from_plane(
                origin[0] + i * step[0], origin[1] + j * step[1], plane
            )
            v = (latitude - south_west[0]) / steps[0]
            u = (longitude - south_west[1]) / steps[1]
            outside = math.hypot(
                max(0.0, -v, v - (rows - 1)) * metres[0],
                max(0.0, -u, u - (columns - 1)) * metres[1],
            )
            if outside >= border:
                surface[j, i] = edge
                continue
            row, column = math.floor(v), math.floor(u)
            w_row, w_column = _weights(v - row), _weights(u - column)
            for a in range(4):
                near_row[a] = _mirrored(row - 1 + a, rows)
                near_column[a] = _mirrored(column - 1 + a, columns)
            value, lowest, highest = 0.0, math.inf, -math.inf
            for a in range(4):
                r = near_row[a]
                for b in range(4):
                    c = near_column[b]
                    value += w_row[a] * w_column[b] * coefficients[r, c]
                    lowest = min(lowest, ground[r, c])
                    highest = max(highest, ground[r, c])
            value = min(max(value, lowest), highest)
            fade = math.cos(0.5 * math.pi * outside / border) ** 2
            surface[j, i] = edge + fade * (value - edge)


@copied
def _add_spline(u: float, v: float, coefficients: np.ndarray, value: np.ndarray) -> None:
    """Add the values of eight splines at column u and row v of the grid to ``value`` (8,).

    u and v are positions in units of the node spacing and need not be integers.
    """
    column, row = math.floor(u), math.floor(v)
    w_column, w_row = _weights(u - column), _weights(v - row)
    for part in range(8):
        total = 0.0
        for a in range(4):
            line = coefficients[part, row - 1 + a]
            total += w_row[a] * (
                w_column[0] * line[column - 1]
                + w_column[1] * line[column]
                + w_column[2] * line[column + 1]
                + w_column[3] * line[column + 2]
            )
        value[part] += total


@compiled
def evaluate(
    latitude: np.ndarray,
    longitude: np.ndarray,
    plane: Plane,
    origin: np.ndarray,
    step: np.ndarray,
    fine: np.ndarray,
    coarse_step: np.ndarray,
    coarse: np.ndarray,
    level_gravity: float,
    tensor: np.ndarray,
    vector: np.ndarray,
) -> None:
    """Fill tensor (n_lat, n_lon, 6) and vector (n_lat, n_lon, 3) at geodetic positions, ENU.

    The field is the sum of the splines on a fine and on a coarse grid of the plane. The constant
    ``level_gravity`` [m/s²] is added to the upward component of the vector.
    """
    value = np.empty(8)
    for i in range(latitude.size):
        for j in range(longitude.size):
            x, y, c, s = to_plane(latitude[i], longitude[j], plane)
            value[:] = 0.0
            dx, dy = x - origin[0], y - origin[1]
            _add_spline(dx / step[0], dy / step[1], fine, value)
            _add_spline(dx / coarse_step[0], dy / coarse_step[1], coarse, value)
            xx, xy, xz, yy, yz = value[0], value[1], value[2], value[3], value[4]
            tensor[i, j, 0] = c * c * xx + 2.0 * c * s * xy + s * s * yy
            tensor[i, j, 1] = c * s * (yy - xx) + (c * c - s * s) * xy
            tensor[i, j, 2] = c * xz + s * yz
            tensor[i, j, 3] = s * s * xx - 2.0 * c * s * xy + c * c * yy
            tensor[i, j, 4] = c * yz - s * xz
            tensor[i, j, 5] = -xx - yy
            vector[i, j, 0] = c * value[5] + s * value[6]
            vector[i, j, 1] = c * value[6] - s * value[5]
            vector[i, j, 2] = value[7] + level_gravity
