"""The figures of a page as PNG files, drawn from the views of its tables."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from ..figures import answer, stored
from ..figures.answer import Curve, Panel
from ..figures.style import save
from ..results.folder import Results
from . import sweeps
from .views import comparable, families

ANSWER, EXPLANATION = "answer.png", "error_over_time.png"
"""Files of the figures."""


def panel(
    metrics: pd.DataFrame, names: Sequence[str], labels: Sequence[str], title: str = "",
    places: np.ndarray | None = None,
) -> Panel:  # fmt: skip
    """Return the errors of estimators in the cases of these names, in the settled window."""
    rows = comparable(metrics[metrics["case"].isin(names)])
    table = rows.set_index(["estimator", "case"])

    def values(label: str, key: str) -> np.ndarray:
        index = [(label, name) for name in names]
        return np.asarray(table[key].reindex(index), dtype=float)

    curves = {
        label: Curve(*(values(label, key) for key in ("rms_m", "rms_lo", "rms_hi", "success")))
        for label in labels
    }
    filtering = rows[rows["causality"] == "filter"].groupby("case")["bound_m"].first()
    bound = np.asarray(filtering.reindex(names), dtype=float)
    where = np.arange(len(names), dtype=float) if places is None else places
    return Panel(title, where, curves, bound, values("ins", "rms_m"))


def draw(results: Results, shown: pd.DataFrame, folder: Path) -> str:
    """Draw the figure that answers the scenario's question, and return its caption.

    Parameters
    ----------
    results : the folder.
    shown : cases of the page's table.
    folder : folder of the figure.
    """
    metrics = results.metrics()
    labels = families(metrics, shown)
    if results.scenario.sweep is not None:
        found = sweeps.parts(results.scenario, results.cases())
        panels = [panel(metrics, p.cases, labels, p.title, p.places) for p in found]
        log = sweeps.is_of_the_prior(results.scenario)
        log = log or results.scenario.sweep.axes[0].scale == "log"
        label = sweeps.label_of(results.scenario)
        save(answer.over_axis(panels, label, log), folder / ANSWER)
        return f"RMS position error against {label}"
    if len(shown) == 1:
        over_time(results, shown["case"].tolist(), labels, folder / ANSWER)
        return "RMS error over time"
    names = shown["case"].tolist()
    save(answer.over_cases(shown["title"].tolist(), panel(metrics, names, labels)), folder / ANSWER)
    return "RMS position error by case"


def over_time(results: Results, cases: Sequence[str], labels: Sequence[str], path: Path) -> None:
    """Draw the RMS errors of estimators over time, a column for each case, three at most."""
    chosen = ["ins", *labels]
    save(stored.error_over_time(results, dict.fromkeys(cases[:3], chosen)), path)
