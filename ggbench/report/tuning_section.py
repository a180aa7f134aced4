"""The section of a report on tuning: what each estimator gains if its parameters are chosen."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from ..figures.numbers import short
from ..judging.ranking import best, honest, rows_of
from ..results.folder import Results
from .shares import percent
from .tables import DEFINITIONS, markdown


def tuning_section(results: Results) -> list[str]:
    """Return the section as markdown; nothing where the scenario asks for no tuning.

    Variants of one estimator of one causality are a grid. In each case the best of them
    (:func:`.ranking.best`) on the runs of even number is judged on those of odd number, beside the
    first one, which stands for the plain estimator.
    """
    if not results.scenario.campaign.tuning:
        return []
    summary, rows = results.summary(), list[list[str]]()
    for case in results.scenario.cases:
        held = rows_of(summary, case, "settled")
        for name, grid in _grids(results, held).items():
            # Who got fewer runs sets how many are looked at: all of a grid fly the same ones.
            common = min(int(held[label]["runs"]) for label in grid)
            tried, found = (rows_of(half, case, "settled") for half in results.halves(common))
            chosen = best(tried[label] for label in grid if label in tried)
            if chosen is None:
                continue
            label = str(chosen["label"])
            if grid[0] not in found or label not in found:  # no run of odd number is there
                continue
            rows.append(
                [case.title, name, str(common // 2), *_figures(found[grid[0]]), f"`{label}`",
                 *_figures(found[label])]
            )  # fmt: skip
    if not rows:
        return []
    head = ["case", "estimator", "runs judged", "plain: success", "error / bound",
            "tuned: which", "success", "error / bound"]  # fmt: skip
    reading = (
        "Every estimator with the best of its variants: chosen in each case on the runs of even "
        "number, judged, as the plain one beside it, on those of odd number. Median error over "
        "bound of the runs that succeed, with its 95 % interval. Of variants of which some got "
        f"fewer runs only these are looked at ([definitions]({DEFINITIONS}))."
    )
    return ["## Tuned and not", reading, markdown(head, rows)]


def _grids(results: Results, rows: Mapping[str, Any]) -> dict[str, list[str]]:
    """Return the variants of each estimator that has some."""
    found: dict[str, list[str]] = {}
    for label in results.labels:
        if label in rows:
            name = f"`{label.partition('[')[0]}`, {rows[label]['causality']}"
            found.setdefault(name, []).append(label)
    return {name: grid for name, grid in found.items() if len(grid) > 1}


def _figures(row: Mapping[str, Any]) -> list[str]:
    """Return success and error over bound of an estimator, marked if it is not honest."""
    mark = "" if honest(row) else " †"
    if not math.isfinite(row["ratio_median"]):
        return [percent(row["success_share"]), f"–{mark}"]
    text = short(row["ratio_median"])
    low, high = row["ratio_median_lo"], row["ratio_median_hi"]
    if not math.isnan(low):
        text += f" [{short(low)}, {short(high)}]"
    return [percent(row["success_share"]), f"{text}{mark}"]
