"""Statistics of map cells that the literature uses to choose matching areas.

A cell is an array g (m, n) of a scalar field at nodes. It has m rows from south to north, and n
columns from west to east. The statistics do not depend on sensor noise or on the direction of a
track.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..judging.field_scale import correlation_length

Array = NDArray[np.float64]

FEWEST_NODES = 8
"""Least number of nodes along each side of a cell; fewer give no useful statistics."""
FRACTAL_NODES = 64
"""Number of nodes along each side of the grid for a fractal dimension."""
_ROUNDING = 1e-13


class Statistics(NamedTuple):
    """Statistics of one cell of a scalar field with the unit u.

    Attributes
    ----------
    deviation, span : standard deviation and range [u] after subtraction of the best-fitting plane.
    slope_deviation : standard deviation of the slope [u/m]; the plane is not subtracted.
    roughness : RMS difference of neighbouring nodes [u/m]; the plane is not subtracted.
    entropy : entropy of the absolute deviations from the best-fitting plane, divided by the largest
        possible entropy. It is from 0 to 1, and small if few nodes deviate.
    correlation_m : distance at which the autocorrelation is 1/e [m], after subtraction of the
        plane.
    """

    deviation: float
    span: float
    slope_deviation: float
    roughness: float
    entropy: float
    correlation_m: float


def statistics(g: Array, east_m: float, north_m: float) -> Statistics:
    """Return the statistics of a cell g (m, n).

    ``east_m`` and ``north_m`` are the distances between nodes [m].

    The best-fitting plane is subtracted for those statistics that would otherwise depend mainly on
    the size of the cell.
    """
    rest = without_plane(g)
    lengths = correlation_length(rest, east_m), correlation_length(rest.T, north_m)
    return Statistics(
        deviation(rest),
        float(np.ptp(rest)),
        deviation(slope(g, east_m, north_m)),
        roughness(g, east_m, north_m),
        difference_entropy(rest),
        0.5 * sum(lengths),
    )


def without_plane(g: Array) -> Array:
    """Return a cell (m, n) minus its best-fitting plane; zeros if only rounding errors remain."""
    m, n = g.shape
    rows = np.linspace(-1.0, 1.0, m)[:, np.newaxis] * np.ones(n)
    columns = np.ones((m, 1)) * np.linspace(-1.0, 1.0, n)
    # On a regular grid the three are orthogonal.
    along = [part * (np.sum(part * g) / np.sum(part**2)) for part in (rows, columns)]
    rest = g - g.mean() - along[0] - along[1]
    return np.where(np.ptp(rest) <= _ROUNDING * np.abs(g).max(), 0.0, rest)


def deviation(g: Array) -> float:
    """Return the standard deviation σ = √(Σ(g − ḡ)² / (mn − 1)) of g (m, n)."""
    return float(np.std(g, ddof=1))


def slope(g: Array, east_m: float, north_m: float) -> Array:
    """Return the slope S (m − 2, n − 2) of g (m, n) from 3 × 3 nodes (Horn 1981).

    S = √(g_x² + g_y²), where g_x and g_y are the derivatives of g to the east and to the north.
    ``east_m`` and ``north_m`` are the distances between nodes [m]; S has the unit of g per metre.
    """
    over_rows = g[:-2] + 2.0 * g[1:-1] + g[2:]
    over_columns = g[:, :-2] + 2.0 * g[:, 1:-1] + g[:, 2:]
    to_east = (over_rows[:, 2:] - over_rows[:, :-2]) / (8.0 * east_m)
    to_north = (over_columns[2:] - over_columns[:-2]) / (8.0 * north_m)
    return np.hypot(to_east, to_north)


def roughness(g: Array, east_m: float, north_m: float) -> float:
    """Return the RMS difference of neighbouring nodes of g (m, n) per metre.

    The result is the mean of the values along rows and along columns. In the literature the
    difference is not divided by the distance between nodes, and therefore depends on the node
    spacing. The result still depends on the spacing if the nodes do not resolve short wavelengths
    of the field.
    """
    along_rows = math.sqrt(float(np.mean(np.diff(g, axis=1) ** 2))) / east_m
    along_columns = math.sqrt(float(np.mean(np.diff(g, axis=0) ** 2))) / north_m
    return 0.5 * (along_rows + along_columns)


def difference_entropy(g: Array) -> float:
    """Return the entropy H / ln(mn) of a cell g (m, n); 1 for a constant.

    H = −Σ D ln D with D = |g − ḡ| / Σ|g − ḡ| and the mean ḡ. The literature defines the deviation
    as |g − ḡ|/|ḡ|. After division by the sum of the deviations, as in D, the factor 1/|ḡ| cancels.
    Without this division, the deviation diverges if the mean is near zero, as for anomalies.
    """
    deviations = np.abs(g - g.mean()).ravel()
    total = deviations.sum()
    if total == 0.0:
        return 1.0
    shares = deviations[deviations > 0.0] / total
    return float(-np.sum(shares * np.log(shares)) / math.log(g.size))


def fractal_dimension(g: Array) -> float:
    """Return the fractal dimension (2 to 3) of the surface g (m, n), by differential box counting.

    The method is that of Sarkar & Chaudhuri (1994), applied to the largest square of the grid, with
    a side of M node spacings. The square is divided into columns with sides of s node spacings. s
    doubles from 2 to at most M/4. A column is a stack of boxes whose height is s/M times the range
    of g over the square. The number of boxes in a column is the range of g over the column divided
    by this height. It is not rounded, but is at least 1. Nodes on a border belong to both columns.
    The result is NaN for a constant.

    Raises
    ------
    ValueError
        If the grid is smaller than 64 × 64.
    """
    side = min(g.shape) - 1
    if side + 1 < FRACTAL_NODES:
        raise ValueError(f"a fractal dimension needs 64 × 64 nodes, and has {g.shape}")
    square = g[: side + 1, : side + 1]
    span = float(np.ptp(square))
    if span == 0.0:
        return math.nan
    sizes, counts = [], []
    size = 2
    while size <= side // 4:
        boxes = side // size
        height = span * size / side
        edges = range(size + 1)
        nodes = [
            square[i : i + boxes * size : size, j : j + boxes * size : size][:boxes, :boxes]
            for i in edges
            for j in edges
        ]
        spans = np.max(nodes, axis=0) - np.min(nodes, axis=0)
        # Numbers rounded up, as the literature's, depend on where the lowest level lies.
        counts.append(float(np.mean(np.maximum(spans / height, 1.0))) * (side / size) ** 2)
        sizes.append(size)
        size *= 2
    return float(-np.polyfit(np.log(sizes), np.log(counts), 1)[0])
