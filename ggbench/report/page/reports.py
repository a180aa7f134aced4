"""The pages of a campaign and of the league: which figures they have."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Mapping
from pathlib import Path
from urllib.parse import quote

import numpy as np
import pandas as pd

from ...estimator_spec import EstimatorSpec
from ...figures import stored
from ...figures.locking import Series
from ...judging.ranking import rows_of
from ...results.folder import Results
from ...spec.sweep import planes
from .. import league_page, scenario_report
from ..answer_section import RATIO, aided, fewer, series
from ..families import leaders
from ..league import League
from ..league import read as read_league
from ..shares import SUCCESS
from . import libraries, writing
from .charts import Chart, Places, over_cases, over_time

_ANSWER = (
    "Share of the runs that succeed (95 % intervals), and the error of those over the bound of its "
    "kind (median and quartiles)"
)
_OVER_TIME = (
    "Median spherical error against time, with the Cramér–Rao bounds of filter, fixed-lag smoother "
    "and smoother, which are root mean squares; cases are chosen above the figure"
)
_LEAGUE = (
    "Share of success (mean), and error over bound (geometric mean of the medians), of every "
    "estimator over the cases of each scenario"
)


def write_report(
    folder: Path, output: Path, described: Mapping[str, str], written: Path | None = None
) -> Path:
    """Write ``NAME.html``, the report of a results folder as one page.

    Parameters
    ----------
    folder : results of ``ggbench run``.
    output : folder to write to; made if it does not exist.
    described : name of an estimator to what it is, in a sentence.
    written : the report as markdown with its figures, if it has been written already.

    Returns
    -------
    Path of the page.

    Raises
    ------
    StoreError, ScenarioError, ReportError
        If the folder is not a results folder, is damaged or holds no finished run.
    PageError
        If a package is missing, or the page cannot be written.
    """
    libraries.require()
    with tempfile.TemporaryDirectory() as temporary:
        report = written or scenario_report.write(folder, Path(temporary))
        results = Results(folder)
        name = results.scenario.name
        summary = results.summary()
        answer, errors = _answer(results, summary), _errors(results, summary)
        places = {f"{quote(name)}/answer.png": answer, f"{quote(name)}/error_over_time.png": errors}
        text = report.read_text(encoding="utf-8")
        found = {place: chart for place, chart in places.items() if chart and f"({place})" in text}
        more = [chart for place, chart in places.items() if chart and place not in found]
        said = writing.said_of(results.estimators, described)
        path = output / f"{name}.html"
        writing.write(path, text, report.parent, found, said, more)
        results.store.close()
    return path


def write_league(output: Path, described: Mapping[str, str]) -> Path:
    """Write ``league.html`` from the ``README.md`` and the digests of a folder of reports.

    Parameters
    ----------
    output : folder of the reports.
    described : as for :func:`write_report`.

    Raises
    ------
    PageError
        If a package is missing, or the page cannot be written.
    """
    libraries.require()
    league, _ = read_league(output)
    text = (output / league_page.FILE).read_text(encoding="utf-8")
    labels = [s.label for s in (*league.standings, *league.others)]
    said = {label: described.get(EstimatorSpec.parse(label).name, "") for label in labels}
    charts = {league_page.FIGURE: chart} if (chart := _of_league(league)) else {}
    return writing.write(output / "league.html", text, output, charts, said)


def _answer(results: Results, summary: pd.DataFrame) -> Chart | None:
    """Return the figure of success and error over bound over the cases, or over a sweep's grid."""
    loaded = results.scenario
    cases = [case for case in loaded.cases if rows_of(summary, case, "settled")]
    tables = [rows_of(summary, case, "settled") for case in cases]
    labels = aided(tables)
    if not labels:
        return None
    on = fewer(leaders(results.estimators, labels), tables)
    if loaded.sweep is None:
        places = Places([case.name for case in cases])
    else:
        places = _of_sweep(results, summary, [case.name for case in cases])
    shares, ratios = (series(tables, labels, *columns) for columns in (SUCCESS, RATIO))
    return over_cases("answer", places, shares, ratios, on, _ANSWER)


def _of_sweep(results: Results, summary: pd.DataFrame, names: list[str]) -> Places:
    """Return where the cases of a sweep stand: along its first axis, the others to be chosen."""
    sweep = results.scenario.sweep
    assert sweep is not None
    axis, *further = sweep.axes
    values, groups = {}, {}
    for plane in planes(sweep, summary):
        for (across, up), name in np.ndenumerate(plane.cases):
            parts = [plane.title] if plane.title else []
            if further:
                parts.append(f"{further[0].name} {further[0].at(up)}")
            values[name], groups[name] = axis.values[across], ", ".join(parts)
    chosen = [groups[name] for name in names]
    return Places(
        names, [values[name] for name in names], chosen if any(chosen) else (), axis.title,
        axis.scale,
    )  # fmt: skip


def _errors(results: Results, summary: pd.DataFrame) -> Chart | None:
    """Return the figure of errors against time, of all cases."""
    cases = results.scenario.cases
    titles = [case.title for case in cases]
    distinct = len(set(titles)) == len(titles)
    curves, on = {}, set()
    for case in cases:
        rows = rows_of(summary, case, "settled")
        if rows:
            times, errors, bounds = stored.errors_over_time(results, case.name, rows)
            medians = {label: median for label, (_, median, _) in errors.items()}
            curves[case.title if distinct else case.name] = times, medians, bounds
            on |= set(leaders(results.estimators, rows))
    return over_time(curves, on, _OVER_TIME)


def _of_league(league: League) -> Chart | None:
    """Return the figure of the league: who succeeds, and how near the bound, in each scenario."""
    names = [entry.name for entry in league.entries]
    shares: dict[str, Series] = {}
    ratios: dict[str, Series] = {}
    for standing in league.over_all:
        for held, found in ((shares, standing.success), (ratios, standing.ratio)):
            values = np.array([found.get(name, math.nan) for name in names])
            held[standing.label] = Series(values, values, values)
    if not shares:
        return None
    return over_cases("league", Places(names), shares, ratios, shares, _LEAGUE, spread=False)
