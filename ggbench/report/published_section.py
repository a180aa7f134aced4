"""What came out beside numbers that were published, in a sentence; and whose times are whose."""

from __future__ import annotations

from collections.abc import Iterable

import pandas as pd

from ..estimator_spec import EstimatorSpec
from ..figures.numbers import counted, short

_QUANTITIES = (("position", "m", "m"), ("velocity", "mps", "m/s"))
"""Name, unit in columns, and unit in words."""


FRAMEWORKS = ("filterpy-ekf", "filterpy-ukf", "gtsam")
"""Estimators of other packages, as they are."""


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


def frameworks(labels: Iterable[str]) -> str:
    """Return whose times are those of a framework, where others are compiled; else nothing."""
    names = [f"`{label}`" for label in labels if EstimatorSpec.parse(label).name in FRAMEWORKS]
    if not names:
        return ""
    return (
        f"Times differ in kind: {', '.join(names)} call a framework from Python run by run; the "
        "other estimators are compiled and take many runs at once."
    )
