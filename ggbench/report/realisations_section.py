"""The section of a report on what maps of one error have in common, and in what they differ."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from scipy import stats

from ..figures.numbers import short
from ..judging.ranking import honest, rows_of
from ..spec.case import CaseSpec
from ..spec.scenario import Scenario
from .shares import percent
from .tables import markdown

_SEEDS = (("model", "field", "error", "seed"), ("truth", "field", "error", "seed"))
"""Where a case says which realisation of a map's error it is."""
READING = (
    "Over realisations of the map's error the intervals hold what differs from map to map as well "
    "as from run to run: 95 %, Student's t over the realisations, of the mean logarithm of the "
    "median error over the bound. Few maps make them wide; what overlaps here is not told apart by "
    "maps like these, however many runs were flown over one of them. Behind the median of a map "
    "the share of success, if it is not all."
)


def realisations_section(scenario: Scenario, summary: pd.DataFrame) -> list[str]:
    """Return the section as markdown; nothing where no error was drawn more than once."""
    rows = []
    for group in groups(scenario.cases):
        tables = [rows_of(summary, case, "settled") for case in group]
        for label in tables[0]:
            held = [table[label] for table in tables if label in table]
            if len(held) == len(tables):
                rows.append([f"{group[0].title} ({len(group)} maps)", *_cells(label, held)])
    if not rows:
        return []
    head = ["error of the map", "estimator", "error / bound", "of each map", "honest on"]
    return ["## Over realisations of the map's error", READING, markdown(head, rows)]


def groups(cases: Sequence[CaseSpec]) -> list[list[CaseSpec]]:
    """Return the cases that are the same but for the seed of a map's error, two or more of each."""
    found: dict[str, list[CaseSpec]] = {}
    for case in cases:
        tables = case.model_dump()
        seeded = False
        for *path, key in _SEEDS:
            held: Any = tables
            for name in path:
                held = (held or {}).get(name)
            if held and key in held:
                del held[key]
                seeded = True
        if seeded:
            for name in ("name", "title", "reference"):
                tables.pop(name, None)
            found.setdefault(repr(tables), []).append(case)
    return [group for group in found.values() if len(group) > 1]


def _cells(label: str, rows: Sequence[Mapping[str, Any]]) -> list[str]:
    ratios = [row["ratio_median"] for row in rows]
    together = "–"
    if all(math.isfinite(ratio) and ratio > 0.0 for ratio in ratios):
        logs = np.log(ratios)
        low, high = np.exp(_interval(logs))
        together = f"{short(math.exp(logs.mean()))} [{short(low)}, {short(high)}]"
    each = ", ".join(_of_map(row) for row in rows)
    return [f"`{label}`", together, each, f"{sum(map(honest, rows))} of {len(rows)}"]


def _of_map(row: Mapping[str, Any]) -> str:
    text = short(row["ratio_median"]) if math.isfinite(row["ratio_median"]) else "–"
    share = row["success_share"]
    return text if share == 1.0 else f"{text} ({percent(share)})"


def _interval(values: np.ndarray) -> np.ndarray:
    """Return the 95 % interval of the mean of independent values, by Student's t."""
    half = stats.t.ppf(0.975, len(values) - 1) * values.std(ddof=1) / math.sqrt(len(values))
    return values.mean() + np.array([-half, half])
