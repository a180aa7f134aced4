"""Figures of a report page."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pandas as pd

from ..figures import answer, stored
from ..figures import league as league_figure
from ..figures.answer import Panel
from ..figures.style import Drawing
from ..results.folder import Results
from . import sweeps
from .findings import SUITE
from .league import CAPTION, EXPLANATION, league
from .reported import Reported
from .views import comparable, drawn_estimators

MOST_COLUMNS = 3
"""Largest number of cases in a figure over time."""


class Picture(NamedTuple):
    """A figure, its caption, and optionally a sentence that explains it."""

    figure: Drawing
    caption: str
    explanation: str = ""


def panel(
    metrics: pd.DataFrame,
    names: Sequence[str],
    labels: Sequence[str],
    title: str = "",
    places: np.ndarray | None = None,
) -> Panel:
    """Return a panel with the errors of estimators in the named cases, in the settled window.

    ``places`` (cases,) are the abscissae of the cases.
    """
    rows = comparable(metrics[metrics["case"].isin(names)])
    return answer.panel(rows, names, labels, title, places)


def of_answer(results: Reported) -> Picture:
    """Return the main figure of a scenario, with a caption."""
    metrics, cases = results.metrics(), sweeps.shown_cases(results)
    labels = drawn_estimators(metrics, cases, results.own)
    if results.scenario.sweep is not None:
        parts = sweeps.parts(results.scenario, results.cases())
        panels = [panel(metrics, p.cases, labels, p.title, p.places) for p in parts]
        log = sweeps.is_of_the_prior(results.scenario)
        log = log or results.scenario.sweep.axes[0].scale == "log"
        label = sweeps.label_of(results.scenario)
        figure = answer.over_axis(panels, label, log, results.families)
        return Picture(figure, f"RMS position error against {label}")
    names = cases["case"].tolist()
    if len(names) == 1:
        return over_time(results, names, labels)
    if results.scenario.name == SUITE:
        drawn = league_figure.league(league(metrics, results.cases()), results.families)
        return Picture(drawn, CAPTION, EXPLANATION)
    titles, errors = cases["title"].tolist(), panel(metrics, names, labels)
    figure = answer.over_cases(titles, errors, results.families)
    return Picture(figure, "RMS error by case")


def over_time(
    results: Results, cases: Sequence[str], labels: Sequence[str], most: int | None = None
) -> Picture:
    """Return the figure of RMS errors over time, with a column for each case.

    At most :data:`MOST_COLUMNS` cases are drawn. The INS is drawn in each case. A curve consists of
    at most ``most`` epochs, by default of all stored epochs.
    """
    chosen = [*dict.fromkeys(["ins", *labels])]
    figure = stored.error_over_time(results, dict.fromkeys(cases[:MOST_COLUMNS], chosen), most)
    return Picture(figure, "RMS error over time")
