"""Contours of a measured value on a map, and the contour points nearest to a track."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ..numerics.kernels import compiled
from ..problem import InsSolution
from ..sensors.aiding import position_error


class Contour(NamedTuple):
    """Contour of a field: points (P, 2) [m], and ``slopes`` (P, 2), the field's gradient there."""

    points: np.ndarray
    slopes: np.ndarray


class Feet(NamedTuple):
    """Points (N, 2) [m] on tangents of contours, nearest to the N points of a track.

    :func:`feet` computes the points.

    ``found`` (N,) is a mask of the track points. It is False if the contour of a point is empty.
    """

    points: np.ndarray
    found: np.ndarray


def contour(values: np.ndarray, level: float, first: np.ndarray, cell: float) -> Contour:
    """Return the points at which the contour of a given level crosses the edges of grid cells.

    Parameters
    ----------
    values : (a, b) field at the nodes first + cell · (i, j).
    level : value of the field on the contour.
    first : (2,) first node [m].
    cell : distance between nodes [m].
    """
    slopes = np.stack(np.gradient(values, cell), axis=-1)
    off = values - level
    points, found = [], []
    for axis in (0, 1):
        before = [slice(None)] * 2
        behind = [slice(None)] * 2
        before[axis], behind[axis] = slice(None, -1), slice(1, None)
        low, high = off[tuple(before)], off[tuple(behind)]
        where = np.argwhere((low < 0.0) != (high < 0.0))
        here = tuple(where.T)
        share = low[here] / (low[here] - high[here])
        places = where.astype(float)
        places[:, axis] += share
        points.append(first + cell * places)
        ends = slopes[tuple(before)][here], slopes[tuple(behind)][here]
        found.append(ends[0] + share[:, np.newaxis] * (ends[1] - ends[0]))
    return Contour(np.concatenate(points), np.concatenate(found))


def feet(contours: Sequence[Contour], track: np.ndarray, cell: float) -> Feet:
    """Return for each track point an approximation of the nearest point of its own contour.

    Contour i belongs to point i of ``track`` (N, 2) [m]. The tangent of the contour is taken at the
    contour point nearest to the track point. The result is the foot of the perpendicular from the
    track point to this tangent. Its distance from the contour point is limited to ``cell`` [m].
    """
    ends = np.cumsum([0, *(len(each.points) for each in contours)])
    points = np.concatenate([each.points for each in contours])
    slopes = np.concatenate([each.slopes for each in contours])
    return Feet(*_feet(points, slopes, ends, track, cell))


@compiled
def _feet(
    points: np.ndarray, slopes: np.ndarray, ends: np.ndarray, track: np.ndarray, cell: float
) -> tuple[np.ndarray, np.ndarray]:
    count = track.shape[0]
    out, found = np.zeros((count, 2)), np.zeros(count, dtype=np.bool_)
    for k in range(count):
        best, nearest = -1, np.inf
        for p in range(ends[k], ends[k + 1]):
            east, north = track[k, 0] - points[p, 0], track[k, 1] - points[p, 1]
            square = east * east + north * north
            if square < nearest:
                best, nearest = p, square
        if best < 0:
            continue
        found[k] = True
        along_e, along_n = -slopes[best, 1], slopes[best, 0]
        length = math.sqrt(along_e * along_e + along_n * along_n)
        slide = 0.0
        if length > 0.0:
            along_e, along_n = along_e / length, along_n / length
            east, north = track[k, 0] - points[best, 0], track[k, 1] - points[best, 1]
            slide = min(max(east * along_e + north * along_n, -cell), cell)
        out[k, 0] = points[best, 0] + slide * along_e
        out[k, 1] = points[best, 1] + slide * along_n
    return out, found


def fitted_transform(
    x: np.ndarray, y: np.ndarray, similar: bool, most_turn: float, most_stretch: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return A (2, 2) and t (2,) of the best transform from points x (N, 2) to y (N, 2).

    y ≈ A x + t by least squares (Umeyama 1991). A is a rotation R by θ, times a scale s if
    ``similar``: for centred points θ = atan2(Σ x × y, Σ x · y) and s = Σ y · R x / Σ ‖x‖². θ is
    limited to ± ``most_turn`` [rad] and s to 1 ± ``most_stretch``.
    """
    middle, target = x.mean(axis=0), y.mean(axis=0)
    a, b = x - middle, y - target
    cross = float((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum())
    turn = float(np.clip(math.atan2(cross, float((a * b).sum())), -most_turn, most_turn))
    matrix = np.array([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]])
    extent = float((a**2).sum())
    if similar and extent > 0.0:
        scale = float((b * (a @ matrix.T)).sum()) / extent
        matrix = matrix * np.clip(scale, 1.0 - most_stretch, 1.0 + most_stretch)
    return matrix, target - matrix @ middle


def track_metres(track: InsSolution, last: int) -> np.ndarray:
    """Return the east and north coordinates (K, 2) [m] of the INS positions.

    The origin is the INS position at epoch ``last``.
    """
    here = np.broadcast_to(track.positions[last], track.positions.shape)
    return np.asarray(position_error(track.positions, here)[:, :2])
