"""Indices of the study, as columns of the table of tracks."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ggbench.matchability.components import ORIENTATION, principal_components

from .association import Groups

Array = NDArray[np.float64]


class Index(NamedTuple):
    """Column of the table with an index.

    Attributes
    ----------
    column : name of the column.
    title : name of the index on the page.
    sign : 1 if larger values mean better matching, else −1.
    """

    column: str
    title: str
    sign: float = -1.0


BASE = Index("roughness", "roughness", 1.0)
"""Index with which all other indices are compared."""
COMPONENT = "index"
OF_MAPS = (
    Index("deviation", "standard deviation", 1.0),
    Index("slope_deviation", "deviation of the slope", 1.0),
    BASE,
    Index("entropy", "difference entropy"),
    Index("correlation_m", "correlation length"),
    Index("fractal_dimension", "fractal dimension", 1.0),
    Index(COMPONENT, "principal components", 1.0),
    Index("information_m", "information per km²"),
)
NEAR = (
    *OF_MAPS,
    Index("track_m", "CRLB along the track"),
    Index("wide_ambiguity", "least ambiguity", 1.0),
    Index("bound_m", "bound of the flight"),
)
"""Indices for the local accuracy."""
WEAK = (
    *OF_MAPS,
    Index("track_uu_m", "CRLB along the track"),
    Index("weak_ambiguity", "least ambiguity", 1.0),
    Index("weak_expected", "predicted false fixes"),
    Index("weak_bound_m", "bound of the flight"),
)
"""Indices for right fixes; predictions are for instrument and prior of the weak flights."""


def completed(table: pd.DataFrame) -> pd.DataFrame:
    """Return the table with two columns that are computed from other columns.

    ``index`` is the index from principal components over the cells of a region. ``weak_expected``
    is the predicted share of false fixes.
    """
    table = table.copy()
    table["weak_expected"] = np.minimum(table["weak_union"] + table["weak_spill"], 1.0)
    table[COMPONENT] = np.nan
    for _, part in table.groupby("region"):
        cells = part.groupby("cell").first()
        found = principal_components({name: cells[name].to_numpy() for name in ORIENTATION})
        if found is not None:
            table.loc[part.index, COMPONENT] = found.index[
                np.searchsorted(cells.index.to_numpy(), part["cell"].to_numpy())
            ]
    return table


def columns(table: pd.DataFrame, indices: tuple[Index, ...]) -> Array:
    """Return p indices (n, p) of n tracks; their signs make larger values better."""
    return np.stack([i.sign * table[i.column].to_numpy(float) for i in indices], axis=1)


def groups(table: pd.DataFrame) -> Groups:
    """Return the region and the cell of each track."""
    return Groups(table["region"].to_numpy(str), table["cell"].to_numpy(np.intp))
