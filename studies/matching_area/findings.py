"""What the table of the study says, as numbers: of each index, of fixes, of instruments."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ggbench.judging.statistics import ALPHA, holm, wilson

from . import association as assoc
from .indices import BASE, NEAR, WEAK, Index, columns, groups, logs
from .words import TITLES

Array = NDArray[np.float64]

TRUSTED = 0.5
"""Correlation that an index must exceed, with all of its interval, to be trusted."""
LOCKS = 0.95
BINS = (0.0, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0)
"""Limits of the predicted share of false fixes between which it is compared with what happened."""
FACTOR = 3.0
"""Within which a prediction between 2 and 50 % should be."""


@dataclass(frozen=True)
class Ranking:
    """How indices order the tracks of the study by an outcome.

    Attributes
    ----------
    indices : which. order : Spearman's correlation with the outcome. partial : the same, roughness
        held. ahead : less that of roughness. ahead_p : p-values of that, by Holm; NaN of roughness.
    p : that the correlation is zero, by Holm.
    """

    indices: tuple[Index, ...]
    order: assoc.Spread
    partial: assoc.Spread
    ahead: assoc.Spread
    ahead_p: Array
    p: Array

    @property
    def trusted(self) -> list[int]:
        """Which are to be trusted, best first.

        Their correlation is not zero by Holm's test, exceeds one half with its interval, and is
        positive in each region with its interval.
        """
        fit = (self.p < ALPHA) & (self.order.low > TRUSTED)
        for _, low, _ in self.order.regions.values():
            fit &= low > 0.0
        return sorted(np.flatnonzero(fit).tolist(), key=lambda i: -self.order.value[i])

    def at(self, column: str) -> int:
        """Return the place of an index."""
        return [index.column for index in self.indices].index(column)

    def beyond(self, i: int) -> str:
        """Return whether an index is distinguishable from roughness: better, worse, or no."""
        if not self.ahead_p[i] < ALPHA:
            return "no"
        return "better" if self.ahead.value[i] > 0.0 else "worse"


def ranking(
    table: pd.DataFrame, indices: tuple[Index, ...], outcome: Array, samples: int = assoc.SAMPLES
) -> Ranking:
    """Return how indices order the tracks by an outcome (n,), larger being better."""
    x, base = columns(table, indices), indices.index(BASE)

    def statistic(rows: assoc.Rows) -> Array:
        order, partial = assoc.spearman_and_partial(x[rows], outcome[rows], base)
        return np.concatenate([order, partial, order - order[base]])

    found, p = assoc.over_cells(statistic, groups(table), samples), len(indices)
    order, partial, ahead = (found.part(slice(k * p, (k + 1) * p)) for k in range(3))
    others = [i for i in range(p) if i != base]
    ahead_p = np.full(p, np.nan)
    ahead_p[others] = holm([assoc.p_value(ahead.samples[:, i]) for i in others])
    order_p = holm([assoc.p_value(column) for column in order.samples.T])
    return Ranking(indices, order, partial, ahead, ahead_p, order_p)


def accuracy(table: pd.DataFrame, samples: int = assoc.SAMPLES) -> Ranking:
    """Return how indices order the tracks by the filter's error, the smallest first."""
    return ranking(table, NEAR, -table["error_m"].to_numpy(), samples)


def right_fixes(table: pd.DataFrame, samples: int = assoc.SAMPLES) -> Ranking:
    """Return how indices order the tracks by the share of right fixes of the weak flights."""
    return ranking(
        table, WEAK, 1.0 - (table["weak_wrong"] / table["weak_runs"]).to_numpy(), samples
    )


def over_headings(table: pd.DataFrame, samples: int = assoc.SAMPLES) -> assoc.Spread:
    """Return the correlations of log indices and log error among the headings of a cell."""
    x, y, of = logs(table, NEAR), -np.log(table["error_m"].to_numpy()), groups(table)
    # A cell that is drawn twice counts twice, with one mean: both are the same.
    return assoc.over_cells(
        lambda rows: assoc.within(x[rows], y[rows], of.cells[rows]), of, samples
    )


def locking(table: pd.DataFrame, samples: int = assoc.SAMPLES) -> assoc.Spread:
    """Return the areas under the ROC curves of the weak flights' indices for locking on."""
    x, good, of = columns(table, WEAK), locks(table), groups(table)
    return assoc.over_cells(lambda rows: assoc.auc(x[rows], good[rows]), of, samples)


def locks(table: pd.DataFrame) -> NDArray[np.bool_]:
    """Return on which tracks (n,) at least 95 % of the weak flights lock on."""
    return (table["weak_locked"] >= LOCKS * table["weak_runs"]).to_numpy()


def ceilings(table: pd.DataFrame) -> dict[str, float]:
    """Return the ceiling of each region that the noise of the runs sets."""
    return {
        str(region): assoc.ceiling(part["error_even_m"].to_numpy(), part["error_odd_m"].to_numpy())
        for region, part in table.groupby("region", sort=False)
    }


def crossed(table: pd.DataFrame, indices: tuple[Index, ...]) -> dict[str, float]:
    """Return Spearman's correlation in each region of a regression of log error on the others."""
    usable = tuple(i for i in indices if np.isfinite(logs(table, (i,))).all())
    x, y = logs(table, usable), -np.log(table["error_m"].to_numpy())
    of, found = groups(table), {}
    for region in of.names:
        tested = of.regions == region
        # Heights and levels differ between regions: how cells compare is what is to carry over.
        predict = assoc.ridge(
            *(_centred(part, of.regions[~tested]) for part in (x[~tested], y[~tested]))
        )
        found[region] = float(assoc.spearman(predict(x[tested])[:, np.newaxis], y[tested])[0])
    return found


def _centred(values: Array, regions: NDArray[np.str_]) -> Array:
    """Return values less the mean of their region."""
    out = values.copy()
    for region in np.unique(regions):
        out[regions == region] -= values[regions == region].mean(axis=0)
    return out


def thirds(
    table: pd.DataFrame, index: Index, samples: int = assoc.SAMPLES
) -> tuple[Array, Array, Array]:
    """Return the median error (3,) [m] of the thirds by an index, worst first, and intervals.

    Thirds of each region, put together; the interval is over cells.
    """
    values, error = columns(table, (index,))[:, 0], table["error_m"].to_numpy()
    of = groups(table)
    third = np.zeros(len(table), dtype=np.intp)
    for region in of.names:
        rows = of.rows(region)
        third[rows] = assoc.thirds(values[rows])

    def medians(rows: assoc.Rows) -> Array:
        parts = [error[rows][third[rows] == k] for k in range(3)]
        return np.array([np.median(part) if len(part) else np.nan for part in parts])

    # Of one stratum: the regions are put together.
    found = assoc.over_cells(
        medians, assoc.Groups(np.full(len(table), "all"), _numbered(of)), samples
    )
    return found.value, found.low, found.high


def heading_gain(
    table: pd.DataFrame, samples: int = assoc.SAMPLES
) -> dict[str, tuple[float, float, float]]:
    """Return what choosing the heading by each index makes of the error, with its interval.

    The error on the heading chosen over the geometric mean of the headings of its cell, geometric
    mean over the cells; also of the heading that is best in hindsight.
    """
    knowing = tuple(i for i in NEAR if i.column in ("track_m", "wide_ambiguity", "bound_m"))
    hindsight = Index("error_m", "the best in hindsight")
    named, of = (*knowing, hindsight), groups(table)
    x, error = columns(table, named), np.log(table["error_m"].to_numpy())
    gain = np.empty_like(x)
    for region in of.names:
        for rows in of.of_cells(region):
            gain[rows] = error[rows][np.argmax(x[rows], axis=0)] - error[rows].mean()
    found = assoc.over_cells(lambda rows: gain[rows].mean(axis=0), of, samples)
    ends = np.exp([found.value, found.low, found.high]).T
    return {i.title: tuple(own) for i, own in zip(named, ends.tolist(), strict=True)}


def _numbered(of: assoc.Groups) -> NDArray[np.intp]:
    """Return numbers of the cells (n,) that no two regions share."""
    return of.cells + 100_000 * np.searchsorted(np.unique(of.regions), of.regions)


@dataclass(frozen=True)
class Compared:
    """A predicted share of false fixes beside what happened, of some tracks.

    Attributes
    ----------
    title : which. tracks, fixes : how many. predicted : mean share. observed, low, high : the
        share that was, with its interval. judged : whether it is a bin between 2 and 50 %.
    """

    title: str
    tracks: int
    fixes: int
    predicted: float
    observed: float
    low: float
    high: float
    judged: bool = False

    @property
    def ratio(self) -> float:
        """Predicted over observed."""
        return self.predicted / self.observed if self.observed > 0.0 else np.inf


def false_fixes(table: pd.DataFrame) -> list[Compared]:
    """Return the comparison in each bin, and of tracks between 2 and 50 %."""
    predicted = table["weak_expected"].to_numpy()
    rows = []
    for low, high in itertools.pairwise(BINS):
        there = (predicted >= low) & (predicted < high if high < 1.0 else predicted <= high)
        judged = BINS[1] <= low < high <= BINS[-2]
        rows.append(_compared(table[there], f"{100 * low:g} to {100 * high:g} %", judged))
    middle = (predicted >= BINS[1]) & (predicted <= BINS[-2])
    basins = middle & (table["weak_union"] > table["weak_spill"]).to_numpy()
    rows.append(_compared(table[middle], "all of 2 to 50 %"))
    rows.append(_compared(table[basins], "of these, other basins more than spill"))
    rows.append(_compared(table[middle & ~basins], "of these, spill more than other basins"))
    for region in table["region"].unique():
        own = middle & (table["region"] == region).to_numpy()
        rows.append(_compared(table[own], f"of these, {TITLES[region]}"))
    return [row for row in rows if row.tracks]


def _compared(part: pd.DataFrame, title: str, judged: bool = False) -> Compared:
    fixes, wrong = int(part["weak_runs"].sum()), int(part["weak_wrong"].sum())
    predicted = float(part["weak_expected"].mean()) if len(part) else np.nan
    return Compared(title, len(part), fixes, predicted, *wilson(wrong, fixes), judged)


def instruments(table: pd.DataFrame) -> pd.DataFrame:
    """Return how alike instruments rank the cells of each region, a row for each pair.

    ``spearman`` of the cells' root mean square of the CRLB over headings; ``shared``, the share of
    the best third that both have; ``best``, the rank that the best cell of the first has by the
    other.
    """
    names = {"track_m": "six components", "track_uu_m": "Γ_UU", "track_gravity_m": "gravimeter"}
    rows = []
    for region, part in table.groupby("region", sort=False):
        cells = part.groupby("cell")[[*names]].agg(lambda of: float(np.sqrt(np.mean(of**2))))
        for first, second in (
            ("track_m", "track_uu_m"),
            ("track_m", "track_gravity_m"),
            ("track_uu_m", "track_gravity_m"),
        ):
            a, b = cells[first].to_numpy(), cells[second].to_numpy()
            good = assoc.thirds(-a) == 2
            rows.append(
                {
                    "region": region,
                    "first": names[first],
                    "second": names[second],
                    "spearman": float(assoc.spearman(a[:, np.newaxis], b)[0]),
                    "shared": float(np.mean((assoc.thirds(-b) == 2)[good])),
                    "best": int(np.sum(b < b[int(np.argmin(a))])) + 1,
                    "cells": len(cells),
                }
            )
    return pd.DataFrame(rows)
