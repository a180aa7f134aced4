"""What a report shows beside its answer: the figure it is seen in, and what it does not say."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
import pandas as pd

from ..figures.answer import over_cases
from ..figures.locking import Series
from ..figures.numbers import counted
from ..figures.style import save
from ..judging.ranking import best_causal, rows_of
from ..results.folder import Results
from ..spec.case import CaseSpec
from .families import kinds, leaders, of_the_best, plain_of
from .shares import SUCCESS
from .tables import DEFINITIONS

RATIO = ("ratio_median", "ratio_quartile_lo", "ratio_quartile_hi")
"""Columns of the summary: error over bound of the runs that succeed, median and quartiles."""
_MOST_CASES = 8
_MOST_LABELS = 14
Rows = Mapping[str, Mapping[str, Any]]
"""Summary rows of a case by estimator."""


def answer_figure(results: Results, summary: pd.DataFrame, pictures: Path) -> str:
    """Draw who succeeds and how near the bound, case by case; return the figure as markdown."""
    cases = telling_cases(results.scenario.cases, summary)
    shown = [case for case in results.scenario.cases if case in cases[:_MOST_CASES]]
    tables = [rows_of(summary, case, "settled") for case in shown]
    every = leaders(results.estimators, aided(tables))
    labels = fewer(every, tables)
    if not labels:
        return ""

    figure = over_cases(
        [case.name for case in shown],
        series(tables, labels, *SUCCESS),
        series(tables, labels, *RATIO),
    )
    save(figure, pictures / "answer.png")
    caption = (
        "Share of the runs that succeed (95 % intervals), and the error of those over the bound of "
        "its kind (median and quartiles)"
    )
    if len(shown) < len(cases):
        caption += ", in the cases in which causal estimators differ most"
    if len(every) > _MOST_LABELS:
        caption += "; of each estimator the plain one, and the best causal one of each case"
    else:
        caption += of_the_best(results.estimators)
    return f"![{caption}]({quote(pictures.name)}/answer.png)\n\n*{caption}*"


def aided(tables: Iterable[Rows]) -> list[str]:
    """Return the estimators of some cases, without the INS."""
    labels = (k for table in tables for k, row in table.items() if row["causality"] != "none")
    return list(dict.fromkeys(labels))


def series(tables: Sequence[Rows], labels: Iterable[str], *columns: str) -> dict[str, Series]:
    """Return estimator to a figure over the cases and its ends, from three columns of the summary.

    NaN where an estimator has no run.
    """
    return {
        label: Series(
            *(np.array([t.get(label, {}).get(key, math.nan) for t in tables]) for key in columns)
        )
        for label in labels
    }


def fewer(labels: Sequence[str], tables: Sequence[Rows]) -> list[str]:
    """Return so many labels that a figure can show them.

    Of many the plain one of each estimator, and the best causal one of each case.
    """
    if len(labels) <= _MOST_LABELS:
        return list(labels)
    every, rows = aided(tables), {k: row for table in tables for k, row in table.items()}
    found = (best_causal(table.values()) for table in tables)
    kept = {plain_of(group) for group in kinds(every, rows).values()}
    kept |= {row["label"] for row in found if row}
    return [label for label in every if label in kept]


def caveat(results: Results, summary: pd.DataFrame) -> str:
    """Return what the answer does not say, in a sentence or two."""
    parts = [
        "simulated flights: truth and estimators share all that the scenario does not set apart"
    ]
    if any("qinling" in case.field.source for case in results.scenario.cases):
        parts.append(
            "the map is rebuilt from the EGM2008 geoid and is EGM2008's own field to some tenths "
            "of an E at 10 km, to some E low above the ground, so that figures in metres are of a "
            "field like that of the place"
        )
    fewer = summary[summary["runs"] < results.run_count]
    if len(fewer):
        told = ", ".join(
            f"`{k}` {runs}" for k, runs in fewer.groupby("label")["runs"].max().items()
        )
        parts.append(
            f"of {counted(results.run_count, 'run')} only the first were given to some: {told}"
        )
    for label, why in results.manifest.get("left_out", {}).items():
        parts.append(f"`{label}` was not run: {why}")
    return f"*Caveat*: {'; '.join(parts)}. Words and figures: [definitions]({DEFINITIONS})."


def telling_cases(cases: Sequence[CaseSpec], summary: pd.DataFrame) -> list[CaseSpec]:
    """Return the cases that were run, those first in which causal estimators differ most."""
    tables = {case: rows_of(summary, case, "settled") for case in cases}
    return sorted((c for c in cases if tables[c]), key=lambda c: -_difference(tables[c]))


def _difference(rows: Mapping[str, Mapping[str, Any]]) -> float:
    """Return how much the causal estimators of a case differ: in success first, then in error."""
    causal = [row for row in rows.values() if row["causality"] == "filter"]
    if not causal:
        return -1.0
    shares = [row["success_share"] for row in causal]
    errors = [row["position_median_m"] for row in causal if row["position_median_m"] > 0.0]
    spread = math.log(max(errors) / min(errors)) if errors else 0.0
    return round(10.0 * (max(shares) - min(shares)) + spread, 2)
