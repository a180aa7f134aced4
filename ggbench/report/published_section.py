"""What came out beside numbers that were published, in a sentence; and whose times are whose."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pandas as pd

from ..figures.numbers import counted, short

_QUANTITIES = (("position", "m", "m"), ("velocity", "mps", "m/s"))
"""Name, unit in columns, and unit in words."""


def beside_published(summary: pd.DataFrame) -> str:
    """Return the first sentence of a report whose cases have published errors, in bold.

    Parameters
    ----------
    summary : rows of :func:`.summary.summarize`; those of cases without published errors tell of
        lost runs and of the bound alone.
    """
    settled = summary[summary["window"] == "settled"]
    causal = settled[settled["causality"] == "filter"]
    judged = causal.dropna(subset=["paper_position_m"])
    if judged.empty:
        return ""
    # Written so that an estimator without a figure (all runs failed) does not pass.
    reached = (judged["position_mrse_m"] <= judged["paper_position_m"]) & (
        judged["velocity_mrse_mps"] <= judged["paper_velocity_mps"]
    )
    names = list(dict.fromkeys(f"`{label}`" for label in causal["label"]))
    if reached.all():
        subject = f"every causal estimator ({', '.join(names)}) is"
    elif not reached.any():
        subject = "no causal estimator is"
    else:
        failing = [f"`{r.label}` in {r.case}" for r in judged[~reached].itertuples()]
        subject = f"not every causal estimator (not {', '.join(failing)}) is"
    lost = int(causal["failed"].sum() + causal["diverged"].sum())
    ratio = causal["ratio_median"].dropna()
    errors = (
        f"median position errors of the runs that succeed are {ratio.min():.2f} to "
        f"{ratio.max():.2f} times the Cramér–Rao bound"
        if len(ratio)
        else "no run succeeds"
    )
    numbers = 2 * judged["case"].nunique()
    return (
        f"**At {counted(int(judged['runs'].max()), 'run')} per case {subject} at or below the "
        f"paper's {numbers} numbers in the settled window{_whole_flight(summary)}; {errors}; "
        f"{counted(lost, 'run') if lost else 'no runs'} failed or diverged.**"
    )


def _whole_flight(summary: pd.DataFrame) -> str:
    """Return how many published numbers nobody reaches if the first updates count, too.

    Of the estimators with all runs: the least error of a few runs is of a sample that was kind.
    """
    whole = summary[(summary["window"] == "whole") & (summary["causality"] == "filter")]
    whole = whole.dropna(subset=["paper_position_m"])
    whole = whole[whole["runs"] == whole["runs"].max()]
    missed = [
        f"{short(least)} {unit} for {short(published)}"
        for _, rows in whole.groupby("case", sort=False)
        for quantity, column, unit in _QUANTITIES
        if not (least := float(rows[f"{quantity}_mrse_{column}"].min()))
        <= (published := float(rows[f"paper_{quantity}_{column}"].iloc[0]))
    ]
    if not missed:
        return "; over the whole flight the best of them reach all, too"
    told = ", ".join(missed)
    return f"; over the whole flight nobody reaches {len(missed)} of these ({told} at best)"


def frameworks(estimators: Mapping[str, Any]) -> str:
    """Return whose times are those of a framework, where others are compiled; else nothing.

    Parameters
    ----------
    estimators : name to what was run, as a manifest has it: its ``parameters`` are complete.
    """
    engines: dict[str, list[str]] = {}
    for label, content in estimators.items():
        if engine := content["parameters"].get("engine"):
            engines.setdefault(engine, []).append(f"`{label}`")
    compiled = engines.pop("numba", None)
    if not (compiled and engines):
        return ""
    told = "; ".join(f"{', '.join(labels)} with {name}" for name, labels in engines.items())
    return (
        f"Times are of different engines: {told}, called from Python run by run; "
        f"{', '.join(compiled)} compiled, many runs at once. Every engine of an estimator gives "
        "the same estimates."
    )
