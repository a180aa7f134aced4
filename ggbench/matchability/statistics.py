"""Statistics of a map cell that the literature uses to choose matching areas.

A cell is an array g (m, n) of a scalar at m rows of nodes from south to north and n columns from
west to east. The statistics do not depend on the sensor noise or on the direction of a track.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..judging.field_scale import correlation_length

Array = NDArray[np.float64]

FEWEST_NODES = 8
"""Along each side of a cell: below, a correlation length or a slope's deviation says nothing."""
FRACTAL_NODES = 64
"""Along each side of the grid on which a fractal dimension is counted."""
_ROUNDING = 1e-13


class Statistics(NamedTuple):
    """Statistics of one cell; u is the unit of the scalar.

    Attributes
    ----------
    deviation, span : standard deviation and range [u], less the best plane.
    slope_deviation : standard deviation of the slope [u/m], with the plane.
    roughness : RMS difference of neighbours [u/m], with the plane.
    entropy : of the deviations, over its largest value: 0 to 1; small if few nodes deviate.
    correlation_m : distance at which the autocorrelation falls to 1/e [m], less the best plane.
    """

    deviation: float
    span: float
    slope_deviation: float
    roughness: float
    entropy: float
    correlation_m: float


def statistics(g: Array, east_m: float, north_m: float) -> Statistics:
    """Return the statistics of a cell (m, n) with given node distances [m].

    The best plane is removed from statistics that would otherwise measure the size of the cell, and
    kept in the others.
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
    """Return a cell (m, n) less its best plane; zeros if only rounding remains."""
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
    """Return S = √(g_x² + g_y²) (m − 2, n − 2) by the differences of 3 × 3 nodes (Horn 1981).

    The unit is that of g per metre. Unlike the slope of a terrain, S is no tangent of an angle.
    """
    over_rows = g[:-2] + 2.0 * g[1:-1] + g[2:]
    over_columns = g[:, :-2] + 2.0 * g[:, 1:-1] + g[:, 2:]
    to_east = (over_rows[:, 2:] - over_rows[:, :-2]) / (8.0 * east_m)
    to_north = (over_columns[2:] - over_columns[:-2]) / (8.0 * north_m)
    return np.hypot(to_east, to_north)


def roughness(g: Array, east_m: float, north_m: float) -> float:
    """Return the mean RMS difference of neighbours of g (m, n) by rows and columns, per metre.

    In the literature the difference is per node and depends on the spacing in two ways: by the
    length of a step, which is divided out here, and by the unresolved field, which remains.
    """
    along_rows = math.sqrt(float(np.mean(np.diff(g, axis=1) ** 2))) / east_m
    along_columns = math.sqrt(float(np.mean(np.diff(g, axis=0) ** 2))) / north_m
    return 0.5 * (along_rows + along_columns)


def difference_entropy(g: Array) -> float:
    """Return H / ln(mn), H = −Σ D ln D with D = |g − ḡ| / Σ|g − ḡ|, g (m, n); 1 of a constant.

    The literature uses |g − ḡ|/|ḡ| for a deviation. As a share of the sum, |ḡ| cancels. Without the
    sum it diverges for a mean near zero, as that of an anomaly.
    """
    deviations = np.abs(g - g.mean()).ravel()
    total = deviations.sum()
    if total == 0.0:
        return 1.0
    shares = deviations[deviations > 0.0] / total
    return float(-np.sum(shares * np.log(shares)) / math.log(g.size))


def fractal_dimension(g: Array) -> float:
    """Return the fractal dimension of the surface g (m, n), 2 to 3, by differential box counting.

    The method is that of Sarkar & Chaudhuri (1994), on the largest square of a grid. Boxes have s ×
    s nodes, from 2 to a quarter of the side, and heights in proportion to the range of g. Boxes are
    counted between the lowest and highest node inside and on the border, so that neighbours share
    their edges. The result is NaN for a constant.

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
