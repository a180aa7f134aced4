"""Index of matching suitability by principal components, as in the literature.

The index represents the variation over the cells of a study. It is not fitted to position errors,
so it need not predict them.
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
"""The five statistics of an index, and whether more of each is taken for better."""
KEPT_VARIANCE = 0.85
"""Share of the variance that the components kept explain at least; the literature gives none."""
FEWEST_CELLS = 6
"""With which the correlations of five statistics can be estimated at all."""
GRADES = ("lowest third", "middle third", "highest third")
"""The cells by the index, from below; the literature gives no thresholds."""


@dataclass(frozen=True)
class Components:
    """Principal components of statistics over cells.

    Attributes
    ----------
    explained : (p,) shares of the variance, falling.
    vectors : (p, p), a component in each column, in the order of :data:`ORIENTATION`.
    kept : number of components in the index.
    index : (N,) Σ λ_k/Σλ v_kᵀx of the cells; NaN for an omitted cell.
    """

    explained: Array
    vectors: Array
    kept: int
    index: Array


def principal_components(statistics: Mapping[str, Array]) -> Components | None:
    """Return the principal components of the statistics (N,) named in :data:`ORIENTATION`.

    The inputs are the logarithms of the statistics, with signs such that larger is better,
    standardised. The sign of a component is chosen such that it correlates positively with the
    standard deviation. A cell with a statistic that is not positive, for example in a flat map, is
    omitted. The result is None if fewer than six cells remain, or a statistic is equal in all.
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
    """Return the grade of each cell, by thirds of the index (N,); the lowest for NaN."""
    finite = index[~np.isnan(index)]
    if finite.size == 0:
        return [GRADES[0]] * index.size
    limits = np.quantile(finite, [1.0 / 3.0, 2.0 / 3.0])
    return [GRADES[0 if np.isnan(f) else int(np.searchsorted(limits, f))] for f in index]
