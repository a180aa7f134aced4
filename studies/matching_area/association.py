"""Rank correlations of indices with errors, and bootstrap intervals over cells.

Arrays (n, p) contain the values of p indices for n tracks. Larger values mean better matching.
Tracks through one cell share the map of the cell. A bootstrap sample therefore draws cells within
each region, and contains all their tracks. Regions are not pooled: statistics are computed for each
region, and then averaged over the regions.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import rankdata

Array = NDArray[np.float64]
Rows = NDArray[np.intp]
Statistic = Callable[[Rows], Array]
"""Function of row numbers of a table that returns a value for each index (p,)."""

SAMPLES = 2000
SEED = 20120115
ENDS = (2.5, 97.5)


def correlation(x: Array, y: Array) -> Array:
    """Return Pearson's correlations (p,) of the columns of x (n, p) with an outcome y (n,).

    The correlation is NaN if a column or the outcome is constant. For ranks it is Spearman's
    correlation.
    """
    x, y = x - x.mean(axis=0), y - y.mean()
    size = np.sqrt(np.sum(x**2, axis=0) * np.sum(y**2))
    # A constant minus its mean leaves only rounding errors.
    known = size > 1e-9 * np.sqrt(len(y)) * np.abs(y).max(initial=0.0)
    return np.divide(y @ x, size, out=np.full(x.shape[1], np.nan), where=known)


def spearman(x: Array, y: Array) -> Array:
    """Return Spearman's correlations (p,) of the columns of x (n, p) with an outcome y (n,)."""
    return correlation(rankdata(x, axis=0), rankdata(y))


class Groups(NamedTuple):
    """Region and cell of each row of a table.

    Attributes
    ----------
    regions : (n,) names of the regions.
    cells : (n,) numbers of the cells.
    """

    regions: NDArray[np.str_]
    cells: NDArray[np.intp]

    @property
    def names(self) -> list[str]:
        """Names of the regions, in the order of the table."""
        return list(dict.fromkeys(self.regions.tolist()))

    def rows(self, region: str) -> Rows:
        """Return the row numbers of a region."""
        return np.flatnonzero(self.regions == region)

    def of_cells(self, region: str) -> list[Rows]:
        """Return the row numbers of each cell of a region."""
        rows = self.rows(region)
        return [rows[self.cells[rows] == cell] for cell in np.unique(self.cells[rows])]


class Spread(NamedTuple):
    """Statistics of p indices, with bootstrap intervals over cells.

    Attributes
    ----------
    value : (p,) mean over the regions.
    low, high : (p,) ends of the 95 % percentile intervals of the mean.
    regions : value (p,), low (p,) and high (p,) of each region.
    samples : (B, p) bootstrap samples of the mean.
    """

    value: Array
    low: Array
    high: Array
    regions: dict[str, tuple[Array, Array, Array]]
    samples: Array

    def part(self, which: slice) -> Spread:
        """Return the statistics of a part of the indices."""
        regions = {
            name: (value[which], low[which], high[which])
            for name, (value, low, high) in self.regions.items()
        }
        return Spread(
            self.value[which], self.low[which], self.high[which], regions, self.samples[:, which]
        )


def over_cells(statistic: Statistic, groups: Groups, samples: int = SAMPLES) -> Spread:
    """Return a statistic for each region and its mean over regions, with intervals over cells.

    All indices and all statistics of a table have the same bootstrap samples. Differences are
    therefore paired. The mean omits regions in which the statistic is undefined.
    """
    rng = np.random.default_rng(SEED)
    drawn, found, each = [], [], {}
    for region in groups.names:
        cells = groups.of_cells(region)
        value = statistic(groups.rows(region))
        chosen = rng.integers(0, len(cells), (samples, len(cells)))
        values = np.stack(
            [statistic(np.concatenate([cells[cell] for cell in sample])) for sample in chosen]
        )
        each[region] = (value, *_ends(values))
        found.append(value)
        drawn.append(values)
    together = _mean(drawn)
    return Spread(_mean(found), *_ends(together), each, together)


def _mean(parts: Sequence[Array]) -> Array:
    """Return the mean of the parts without NaN; NaN if all parts are NaN."""
    stacked = np.stack(parts)
    count = np.sum(~np.isnan(stacked), axis=0)
    total = np.nansum(stacked, axis=0)
    return np.divide(total, count, out=np.full_like(total, np.nan), where=count > 0)


def _ends(samples: Array) -> tuple[Array, Array]:
    usable = ~np.isnan(samples).all(axis=0)
    low, high = np.full((2, samples.shape[1]), np.nan)
    low[usable], high[usable] = np.nanpercentile(samples[:, usable], ENDS, axis=0)
    return low, high


def p_value(samples: Array) -> float:
    """Return the two-sided bootstrap p-value of the hypothesis that a statistic is zero.

    ``samples`` (B,) are bootstrap samples of the statistic, and B excludes NaN. The p-value is
    2 (1 + k) / (1 + B), at most 1. k is the smaller number of samples on either side of zero. The
    p-value is 1 if all samples are NaN.
    """
    known = samples[~np.isnan(samples)]
    if known.size == 0:
        return 1.0
    other = min(np.count_nonzero(known <= 0.0), np.count_nonzero(known >= 0.0))
    return float(min(1.0, 2.0 * (1 + other) / (1 + known.size)))


def ceiling(first: Array, second: Array) -> float:
    """Return the rank correlation of a perfect index with an outcome that contains noise.

    ``first`` and ``second`` (n,) are the outcomes of two halves of the runs. Their rank correlation
    is r. The reliability of the outcome of all runs is 2r/(1 + r) (Spearman & Brown 1910). The
    result is the square root of the reliability, or 0 if r is not positive.
    """
    r = float(spearman(first[:, np.newaxis], second)[0])
    return float(np.sqrt(2.0 * r / (1.0 + r))) if r > 0.0 else 0.0


def thirds(values: Array) -> NDArray[np.intp]:
    """Return the third (n,) of each value (n,), from 0 (lowest values) to 2 (highest values)."""
    limits = np.quantile(values, [1.0 / 3.0, 2.0 / 3.0])
    return np.searchsorted(limits, values, side="right")
