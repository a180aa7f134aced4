"""Rank correlations of indices and errors, with intervals over cells.

Columns of values (n, p) are indices, rows tracks, larger is taken for better. Tracks through one
cell share its map, so that a sample of the bootstrap draws cells, within each region, and takes all
of their tracks. Regions are never pooled: a statistic is that of each, and their mean.
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
"""Of some rows of a table, a number for each index (p,)."""

SAMPLES = 2000
SEED = 20120115
ENDS = (2.5, 97.5)


def correlation(x: Array, y: Array) -> Array:
    """Return Pearson's correlations (p,) of columns (n, p) with an outcome (n,); NaN of a constant.

    Pearson's of ranks is Spearman's.
    """
    x, y = x - x.mean(axis=0), y - y.mean()
    size = np.sqrt(np.sum(x**2, axis=0) * np.sum(y**2))
    # A constant less its mean is rounding.
    known = size > 1e-9 * np.sqrt(len(y)) * np.abs(y).max(initial=0.0)
    return np.divide(y @ x, size, out=np.full(x.shape[1], np.nan), where=known)


def spearman(x: Array, y: Array) -> Array:
    """Return Spearman's correlations (p,) of columns (n, p) with an outcome (n,)."""
    return correlation(rankdata(x, axis=0), rankdata(y))


class Groups(NamedTuple):
    """Which rows (n,) of a table are of which region and cell."""

    regions: NDArray[np.str_]
    cells: NDArray[np.intp]

    @property
    def names(self) -> list[str]:
        """The regions, in the order of the table."""
        return list(dict.fromkeys(self.regions.tolist()))

    def rows(self, region: str) -> Rows:
        """Return the rows of a region."""
        return np.flatnonzero(self.regions == region)

    def of_cells(self, region: str) -> list[Rows]:
        """Return the rows of each cell of a region."""
        rows = self.rows(region)
        return [rows[self.cells[rows] == cell] for cell in np.unique(self.cells[rows])]


class Spread(NamedTuple):
    """Statistics of indices, with intervals over the choice of cells.

    Attributes
    ----------
    value : (p,) mean over the regions. low, high : (p,) ends of the 95 % percentile intervals.
    regions : of each its own value (p,), low (p,) and high (p,).
    samples : (B, p) of the bootstrap, of the mean.
    """

    value: Array
    low: Array
    high: Array
    regions: dict[str, tuple[Array, Array, Array]]
    samples: Array

    def part(self, which: slice) -> Spread:
        """Return the same of some of the indices."""
        regions = {
            name: (value[which], low[which], high[which])
            for name, (value, low, high) in self.regions.items()
        }
        return Spread(
            self.value[which], self.low[which], self.high[which], regions, self.samples[:, which]
        )


def over_cells(statistic: Statistic, groups: Groups, samples: int = SAMPLES) -> Spread:
    """Return a statistic of each region and their mean, with intervals over cells.

    All indices, and all statistics of one table, are resampled alike: differences are paired. A
    region in which a statistic is not defined is left out of the mean.
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
    """Return the mean of what is a number; NaN where nothing is."""
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
    """Return the two-sided p-value of the bootstrap (B,) that what it samples is zero.

    Twice the share of samples on the other side, none counted as one; 1 of no numbers.
    """
    known = samples[~np.isnan(samples)]
    if known.size == 0:
        return 1.0
    other = min(np.count_nonzero(known <= 0.0), np.count_nonzero(known >= 0.0))
    return float(min(1.0, 2.0 * (1 + other) / (1 + known.size)))


def ceiling(first: Array, second: Array) -> float:
    """Return the correlation of ranks that a perfect index would have with an outcome.

    The outcome has the noise of its runs in it. Of its halves (n,) the correlation r gives the
    reliability of the whole, 2r/(1 + r) (Spearman & Brown 1910); its root is the ceiling.
    """
    r = float(spearman(first[:, np.newaxis], second)[0])
    return float(np.sqrt(2.0 * r / (1.0 + r))) if r > 0.0 else 0.0


def thirds(values: Array) -> NDArray[np.intp]:
    """Return to which third each of some values (n,) belongs: 0, the lowest, to 2."""
    limits = np.quantile(values, [1.0 / 3.0, 2.0 / 3.0])
    return np.searchsorted(limits, values, side="right")
