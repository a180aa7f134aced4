"""Findings from the table of tracks: rankings of indices, false fixes, headings, instruments."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ggbench.judging.statistics import ALPHA, holm, wilson

from . import association as assoc
from .indices import BASE, NEAR, WEAK, Index, columns, groups

Array = NDArray[np.float64]

TRUSTED = 0.5
"""Lower limit of the correlation interval of a trusted index."""
BINS = (0.0, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0)
"""Limits of bins of the predicted share, for its comparison with the observed share."""
JUDGED = BINS[1], BINS[-2]
"""Limits of the predicted shares that are judged."""
FACTOR = 3.0
"""Largest factor between predicted and observed share for a correct prediction."""
HINDSIGHT = Index("error_m", "the best in hindsight")
INSTRUMENTS = {"track_m": "six components", "track_uu_m": "Γ_UU", "track_gravity_m": "gravimeter"}


@dataclass(frozen=True)
class Ranking:
    """Ranking of p indices by their correlation with an outcome.

    Attributes
    ----------
    indices : the indices.
    order : Spearman's correlation with the outcome.
    ahead : Spearman's correlation minus the correlation of roughness.
    ahead_p : (p,) p-values of ``ahead``, adjusted by Holm's method; NaN for roughness.
    p : (p,) p-values of ``order``, adjusted by Holm's method.
    """

    indices: tuple[Index, ...]
    order: assoc.Spread
    ahead: assoc.Spread
    ahead_p: Array
    p: Array

    @property
    def trusted(self) -> list[int]:
        """Places of the trusted indices in ``indices``, best first.

        The correlation of a trusted index differs from zero by Holm's test. Its interval is above
        one half. In each region its interval is above zero.
        """
        fit = (self.p < ALPHA) & (self.order.low > TRUSTED)
        for _, low, _ in self.order.regions.values():
            fit &= low > 0.0
        return sorted(np.flatnonzero(fit).tolist(), key=lambda i: -self.order.value[i])

    def at(self, column: str) -> int:
        """Return the place of the index with a given column."""
        return [index.column for index in self.indices].index(column)

    def beyond(self, i: int) -> str:
        """Return better, worse or undecided, compared with roughness; – for roughness itself."""
        if self.indices[i] == BASE:
            return "–"
        if not self.ahead_p[i] < ALPHA:
            return "undecided"
        return "better" if self.ahead.value[i] > 0.0 else "worse"

    def table(self, outcome: str) -> pd.DataFrame:
        """Return one row for each index and region; the region ``mean`` is their mean."""
        mean = (self.order.value, self.order.low, self.order.high)
        rows = [
            {
                "outcome": outcome,
                "index": index.title,
                "region": region,
                "spearman": value[i],
                "spearman_lo": low[i],
                "spearman_hi": high[i],
                "minus_roughness": self.ahead.value[i] if region == "mean" else np.nan,
                "versus_roughness": self.beyond(i) if region == "mean" else "–",
                "trusted": i in self.trusted,
            }
            for region, (value, low, high) in {"mean": mean, **self.order.regions}.items()
            for i, index in enumerate(self.indices)
        ]
        return pd.DataFrame(rows)


def ranking(
    table: pd.DataFrame, indices: tuple[Index, ...], outcome: Array, samples: int = assoc.SAMPLES
) -> Ranking:
    """Return the ranking of indices for an outcome (n,); larger outcomes are better."""
    x, base, p = columns(table, indices), indices.index(BASE), len(indices)

    def statistic(rows: assoc.Rows) -> Array:
        order = assoc.spearman(x[rows], outcome[rows])
        return np.concatenate([order, order - order[base]])

    found = assoc.over_cells(statistic, groups(table), samples)
    order, ahead = found.part(slice(0, p)), found.part(slice(p, 2 * p))
    others = [i for i in range(p) if i != base]
    ahead_p = np.full(p, np.nan)
    ahead_p[others] = holm([assoc.p_value(ahead.samples[:, i]) for i in others])
    order_p = holm([assoc.p_value(column) for column in order.samples.T])
    return Ranking(indices, order, ahead, ahead_p, order_p)


def accuracy(table: pd.DataFrame, samples: int = assoc.SAMPLES) -> Ranking:
    """Return the ranking of indices for the local accuracy; smaller filter errors are better."""
    return ranking(table, NEAR, -table["error_m"].to_numpy(), samples)


def right_fixes(table: pd.DataFrame, samples: int = assoc.SAMPLES) -> Ranking:
    """Return the ranking of indices for the share of right fixes in the weak flights."""
    right = 1.0 - (table["weak_wrong"] / table["weak_runs"]).to_numpy()
    return ranking(table, WEAK, right, samples)


def ceilings(table: pd.DataFrame) -> dict[str, float]:
    """Return the largest possible correlation in each region, given the noise of the runs."""
    return {
        str(region): assoc.ceiling(part["error_even_m"].to_numpy(), part["error_odd_m"].to_numpy())
        for region, part in table.groupby("region", sort=False)
    }


def thirds(table: pd.DataFrame, samples: int = assoc.SAMPLES) -> pd.DataFrame:
    """Return the median error on the worst, middle and best third by each index, with intervals.

    The thirds are formed in each region. The medians are over both regions together.
    """
    error, of, rows = table["error_m"].to_numpy(), groups(table), []
    # The regions form one stratum of the bootstrap.
    together = assoc.Groups(np.full(len(table), "all"), _numbered(of))
    for index, values in zip(NEAR, columns(table, NEAR).T, strict=True):
        third = np.zeros(len(table), dtype=np.intp)
        for region in of.names:
            third[of.rows(region)] = assoc.thirds(values[of.rows(region)])

        def medians(rows: assoc.Rows, third: NDArray[np.intp] = third) -> Array:
            parts = [error[rows][third[rows] == k] for k in range(3)]
            return np.array([np.median(part) if len(part) else np.nan for part in parts])

        found = assoc.over_cells(medians, together, samples)
        for k, name in enumerate(("worst", "middle", "best")):
            ends = {"lo_m": found.low[k], "hi_m": found.high[k]}
            rows.append(
                {"index": index.title, "third": name, "median_error_m": found.value[k]} | ends
            )
    return pd.DataFrame(rows)


def heading_gain(table: pd.DataFrame, samples: int = assoc.SAMPLES) -> pd.DataFrame:
    """Return the error on the heading that an index chooses, relative to the mean heading.

    In each cell the error is divided by the geometric mean of the errors over all headings. The
    result is the geometric mean of this ratio over cells, with its interval. One row is for the
    heading with the smallest error.
    """
    knowing = tuple(i for i in NEAR if i.column in ("track_m", "wide_ambiguity", "bound_m"))
    named, of = (*knowing, HINDSIGHT), groups(table)
    x, error = columns(table, named), np.log(table["error_m"].to_numpy())
    gain = np.empty_like(x)
    for region in of.names:
        for rows in of.of_cells(region):
            gain[rows] = error[rows][np.argmax(x[rows], axis=0)] - error[rows].mean()
    found = assoc.over_cells(lambda rows: gain[rows].mean(axis=0), of, samples)
    ends = np.exp([found.value, found.low, found.high])
    names = ("error_over_mean_heading", "lo", "hi")
    chosen = {"heading_by": [index.title for index in named]}
    return pd.DataFrame(chosen | dict(zip(names, ends, strict=True)))


def _numbered(of: assoc.Groups) -> NDArray[np.intp]:
    """Return cell numbers (n,) that are unique over all regions."""
    return of.cells + 100_000 * np.searchsorted(np.unique(of.regions), of.regions)


def false_fixes(table: pd.DataFrame) -> pd.DataFrame:
    """Return predicted and observed shares of false fixes, per bin and for all judged bins."""
    predicted = table["weak_expected"].to_numpy()
    rows = []
    for low, high in [*itertools.pairwise(BINS), JUDGED]:
        there = (predicted >= low) & (predicted < high if high < 1.0 else predicted <= high)
        if there.any():
            rows.append(_compared(table[there], low, high))
    return pd.DataFrame(rows)


def _compared(part: pd.DataFrame, low: float, high: float) -> dict[str, Any]:
    fixes, wrong = int(part["weak_runs"].sum()), int(part["weak_wrong"].sum())
    found, found_low, found_high = wilson(wrong, fixes)
    predicted = float(part["weak_expected"].mean())
    return {
        "from_share": low,
        "to_share": high,
        "tracks": len(part),
        "fixes": fixes,
        "predicted_share": predicted,
        "found_share": found,
        "found_share_lo": found_low,
        "found_share_hi": found_high,
        "predicted_over_found": predicted / found if found else np.inf,
        "judged": JUDGED[0] <= low and high <= JUDGED[1] and (low, high) != JUDGED,
    }


def instruments(table: pd.DataFrame) -> pd.DataFrame:
    """Return the agreement of instruments in the ranking of cells, one row per region and pair.

    Cells are ranked by the RMS of the CRLB over headings. ``best_third_in_common`` is the share of
    the best third by the first instrument that is also in the best third by the second instrument.
    """
    rows = []
    for region, part in table.groupby("region", sort=False):
        cells = part.groupby("cell")[[*INSTRUMENTS]].agg(lambda of: float(np.sqrt(np.mean(of**2))))
        for first, second in itertools.combinations(INSTRUMENTS, 2):
            a, b = cells[first].to_numpy(), cells[second].to_numpy()
            best = assoc.thirds(-a) == 2
            rows.append(
                {
                    "region": region,
                    "first": INSTRUMENTS[first],
                    "second": INSTRUMENTS[second],
                    "spearman": float(assoc.spearman(a[:, np.newaxis], b)[0]),
                    "best_third_in_common": float(np.mean((assoc.thirds(-b) == 2)[best])),
                }
            )
    return pd.DataFrame(rows)
