"""The section of a report on what a source says of its estimators without a number."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import pandas as pd

from ..figures.numbers import short
from ..judging.ranking import pair_of, rows_of
from ..judging.statistics import BETTER, UNDECIDED
from ..spec.claims import ComparisonSpec
from ..spec.scenario import Scenario

HOLDS, FAILS, OPEN = "holds", "**does not hold**", "not distinguishable"
NEARLY = 1.05
"""Ratio up to which two errors, or two times, are called equal."""


def claims_section(scenario: Scenario, summary: pd.DataFrame, pairs: pd.DataFrame) -> list[str]:
    """Return the section as markdown; nothing where nothing of that kind is claimed.

    Parameters
    ----------
    scenario : with its comparisons.
    summary : rows of :func:`.summary.summarize`.
    pairs : rows of :func:`ggbench.judging.summary.paired_table`.
    """
    parts = [_table(scenario, claim, summary, pairs) for claim in scenario.comparisons]
    found = [part for part in parts if part]
    if not found:
        return []
    return [
        "## What is claimed",
        "Claims without a number, judged in the settled window at each value that the source "
        "leaves open. Of errors: the mean difference of squared position error, first less second, "
        "over the same runs with its 95 % bootstrap-t interval. *Larger* and *smaller* hold where "
        "that interval lies on their side of zero, do not hold where it lies on the other, and are "
        "else not distinguishable. *Equal* holds where the ratio of MRSE is within "
        f"{100 * (NEARLY - 1):.0f} % of one, does not hold where it is beyond and the interval "
        "without zero. Times are medians of one run, here and of these programs, without an "
        f"interval: within {100 * (NEARLY - 1):.0f} % of each other they are not distinguishable. "
        "Nothing is adjusted for the number of claims: of twenty that two equals differ, one is "
        "wrong.",
        *found,
    ]


def _table(
    scenario: Scenario, claim: ComparisonSpec, summary: pd.DataFrame, pairs: pd.DataFrame
) -> str:
    """Return a claim with a row for each value; nothing where its case was not run."""
    case = next((case for case in scenario.cases if case.name == claim.case), None)
    rows = {} if case is None else rows_of(summary, case, "settled")
    judge = _of_errors if claim.quantity == "error" else _of_times
    lines = []
    for value in claim.values:
        first, second = claim.labels(value)
        if first in rows and second in rows:
            pair = pair_of(pairs, claim.case, first, second)
            lines.append(f"| {value} | {judge(claim, rows[first], rows[second], pair)} |")
    if not lines:
        return ""
    unit = "m" if claim.quantity == "error" else "ms"
    difference = " difference of squares, m² |" if claim.quantity == "error" else ""
    head = f"| value | first, {unit} | second, {unit} | ratio |{difference} verdict |"
    columns = head.count("|") - 1
    of = "Position MRSE" if claim.quantity == "error" else "Time a run"
    relation = "equal to" if claim.relation == "equal" else f"{claim.relation} than"
    return (
        f"### {claim.title}\n\n{of} of `{claim.first}` {relation} that of "
        f"`{claim.second}`.\n\n{head}\n|{' --- |' * columns}\n" + "\n".join(lines)
    )


def _of_errors(
    claim: ComparisonSpec,
    first: Mapping[str, Any],
    second: Mapping[str, Any],
    pair: Mapping[str, Any] | None,
) -> str:
    """Return the figures and the verdict of a claim on errors."""
    one, two = first["position_mrse_m"], second["position_mrse_m"]
    ratio = one / two if two > 0.0 else math.nan
    seen, difference = UNDECIDED, "–"
    if pair:
        seen = pair["position_verdict"]
        difference = f"{pair['position_difference_m2']:+.3g}"
        if not math.isnan(pair["position_lo"]):
            difference += f" [{pair['position_lo']:+.3g}, {pair['position_hi']:+.3g}]"
    if claim.relation == "equal":
        verdict = HOLDS if 1.0 / NEARLY <= ratio <= NEARLY else OPEN
        if verdict == OPEN and seen != UNDECIDED:
            verdict = FAILS
    elif seen == UNDECIDED:
        verdict = OPEN
    else:
        verdict = HOLDS if (seen == BETTER) == (claim.relation == "smaller") else FAILS
    return f"{short(one)} | {short(two)} | {ratio:.3g} | {difference} | {verdict}"


def _of_times(
    claim: ComparisonSpec,
    first: Mapping[str, Any],
    second: Mapping[str, Any],
    pair: Mapping[str, Any] | None,
) -> str:
    """Return the figures and the verdict of a claim on times."""
    one, two = 1e3 * first["seconds_per_run"], 1e3 * second["seconds_per_run"]
    ratio = one / two if two > 0.0 else math.nan
    equal = 1.0 / NEARLY <= ratio <= NEARLY
    if claim.relation == "equal":
        verdict = HOLDS if equal else FAILS
    elif equal or math.isnan(ratio):
        verdict = OPEN
    else:
        verdict = HOLDS if (ratio < 1.0) == (claim.relation == "smaller") else FAILS
    return f"{one:.3g} | {two:.3g} | {ratio:.3g} | {verdict}"
