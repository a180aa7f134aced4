"""The section of a report on what maps of one error have in common, and in what they differ."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from scipy import stats

from ..figures.numbers import short
from ..judging.ranking import consistent, rows_of
from ..spec.case import CaseSpec
from ..spec.scenario import Scenario
from .shares import percent
from .tables import markdown

_SEEDS = (("model", "field", "error", "seed"), ("truth", "field", "error", "seed"))
"""Where a case says which realisation of a map's error it is."""
_FLIGHTS = tuple(("trajectory", key) for key in ("latitude_deg", "longitude_deg", "heading_deg"))
"""Where it says over which part of a map it flies."""
MAPS, FLIGHTS = "maps", "flights"
"""What differs: maps of one error that is drawn, or flights over one in which nothing is."""
READING = (
    "Over realisations of the map's error the intervals hold what differs from map to map as well "
    "as from run to run: 95 %, Student's t over the realisations, of the mean logarithm of the "
    "median error over the bound. Few maps make them wide; what overlaps here is not told apart by "
    "maps like these, however many runs were flown over one of them. Where nothing in the error is "
    "drawn, it is the flights over other parts of the map that differ, chosen by hand and each "
    "with a bound of its own: no sample, and no interval. Behind the median of each the share of "
    "success, if it is not all."
)


def realisations_section(scenario: Scenario, summary: pd.DataFrame) -> list[str]:
    """Return the section as markdown; nothing where no error was drawn more than once."""
    rows = []
    for what, group in groups(scenario.cases):
        tables = [rows_of(summary, case, "settled") for case in group]
        for label in tables[0]:
            held = [table[label] for table in tables if label in table]
            if len(held) == len(tables):
                rows.append([f"{group[0].title} ({len(group)} {what})", *_cells(label, held, what)])
    if not rows:
        return []
    head = ["error of the map", "estimator", "error / bound", "of each", "honest on"]
    return ["## Over realisations of the map's error", READING, markdown(head, rows)]


def groups(cases: Sequence[CaseSpec]) -> list[tuple[str, list[CaseSpec]]]:
    """Return what is the same but for one thing, two or more cases of each, and the thing's name.

    That is the seed of a map's error: ``maps``; or, of maps in whose error nothing is drawn, where
    the flight begins and its heading: ``flights``.
    """
    found: dict[tuple[str, str], list[CaseSpec]] = {}
    for case in cases:
        tables = case.model_dump()
        what, places = (MAPS, _SEEDS) if _drawn(tables) else (FLIGHTS, _FLIGHTS)
        if case.side("truth").field == case.side("model").field:
            continue  # nothing is wrong with the map
        for *path, key in places:
            held: Any = tables
            for name in path:
                held = (held or {}).get(name)
            if held:
                held.pop(key, None)
        for name in ("name", "title", "reference"):
            tables.pop(name, None)
        found.setdefault((what, repr(tables)), []).append(case)
    return [(what, group) for (what, _), group in found.items() if len(group) > 1]


def _drawn(tables: Mapping[str, Any]) -> bool:
    """Return whether something in the error of a case's maps is drawn."""
    errors = [tables[side]["field"]["error"] or {} for side in ("truth", "model")]
    return any(e.get(f"{kind}_noise_eotvos") for e in errors for kind in ("white", "correlated"))


def _cells(label: str, rows: Sequence[Mapping[str, Any]], what: str) -> list[str]:
    ratios = [row["ratio_median"] for row in rows]
    together = "–"
    if what != FLIGHTS and all(math.isfinite(ratio) and ratio > 0.0 for ratio in ratios):
        logs = np.log(ratios)
        low, high = np.exp(_interval(logs))
        together = f"{short(math.exp(logs.mean()))} [{short(low)}, {short(high)}]"
    each = ", ".join(_of_map(row) for row in rows)
    return [f"`{label}`", together, each, f"{sum(map(consistent, rows))} of {len(rows)}"]


def _of_map(row: Mapping[str, Any]) -> str:
    text = short(row["ratio_median"]) if math.isfinite(row["ratio_median"]) else "–"
    share = row["success_share"]
    return text if share == 1.0 else f"{text} ({percent(share)})"


def _interval(values: np.ndarray) -> np.ndarray:
    """Return the 95 % interval of the mean of independent values, by Student's t."""
    half = stats.t.ppf(0.975, len(values) - 1) * values.std(ddof=1) / math.sqrt(len(values))
    return values.mean() + np.array([-half, half])
