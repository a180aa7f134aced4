"""Index of matching suitability from principal components, as in the literature.

The index represents the variation of map statistics over the cells of a study. It is not fitted to
position errors and need not predict them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

ORIENTATION = {
    "deviation": 1.0,
    "slope_deviation": 1.0,
    "roughness": 1.0,
    "entropy": -1.0,
    "correlation_m": -1.0,
}
"""The five statistics of the index, with the sign 1 if a larger value is better, else −1."""
KEPT_VARIANCE = 0.85
"""Least share of the variance in the kept components; the literature gives no value."""
FEWEST_CELLS = 6
"""Least number of cells for an estimate of the correlations of five statistics."""
GRADES = ("lowest third", "middle third", "highest third")
"""Grades from the lowest to the highest index; the literature gives no thresholds."""


@dataclass(frozen=True)
class Components:
    """Principal components of p statistics of N cells.

    Attributes
    ----------
    explained : (p,) fraction of the total variance in each component, in decreasing order.
    vectors : (p, p) components in columns; the rows are in the order of :data:`ORIENTATION`.
    kept : number of leading components that contribute to the suitability index.
    index : (N,) suitability index of each cell, Σ_k (λ_k / Σ λ) v_kᵀ x. The variance of
        component k is λ_k, and its column of ``vectors`` is v_k. The vector x contains the inputs
        of :func:`principal_components` for the cell. The sum over k contains only the first
        ``kept`` components; Σ λ is the sum of all p variances. The index is NaN if
        :func:`principal_components` omits the cell.
    """

    explained: Array
    vectors: Array
    kept: int
    index: Array


def principal_components(statistics: Mapping[str, Array]) -> Components | None:
    """Return the principal components of the statistics (N,) named in :data:`ORIENTATION`.

    The inputs x are logarithms of the statistics, standardised. Their signs are chosen such that
    larger values mean better matching. The sign of a component is chosen such that it correlates
    positively with the standard deviation of the field. A cell is omitted if a statistic is not
    positive, for example in a flat map. The result is None if fewer than six cells remain, or if a
    statistic is equal in all cells.
    """
    columns = np.stack([np.asarray(statistics[name], float) for name in ORIENTATION], axis=1)
    usable = np.all(np.isfinite(columns) & (columns > 0.0), axis=1)
    if np.count_nonzero(usable) < FEWEST_CELLS:
        return None
    x = np.log(columns[usable]) * np.array([*ORIENTATION.values()])
    spread = x.std(axis=0, ddof=1)
    if not (spread > 1e-12).all():
        return None
    x = (x - x.mean(axis=0)) / spread
    values, vectors = np.linalg.eigh(x.T @ x / (len(x) - 1))
    explained = values[::-1] / values.sum()
    vectors = vectors[:, ::-1]
    scores = x @ vectors
    signs = np.where(scores.T @ x[:, 0] < 0.0, -1.0, 1.0)
    scores, vectors = scores * signs, vectors * signs
    count = int(np.searchsorted(np.cumsum(explained), KEPT_VARIANCE - 1e-12)) + 1
    index = np.full(len(columns), np.nan)
    index[usable] = scores[:, :count] @ explained[:count]
    return Components(explained, vectors, count, index)


def grades(index: Array) -> list[str]:
    """Return the grade of each cell: the lowest, middle or highest third of the index (N,).

    The index is the suitability index :attr:`Components.index`. A cell with the index NaN has the
    lowest grade.
    """
    finite = index[~np.isnan(index)]
    if finite.size == 0:
        return [GRADES[0]] * index.size
    limits = np.quantile(finite, [1.0 / 3.0, 2.0 / 3.0])
    return [GRADES[0 if np.isnan(f) else int(np.searchsorted(limits, f))] for f in index]
