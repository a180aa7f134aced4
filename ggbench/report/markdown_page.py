"""Markdown page of a scenario."""

from __future__ import annotations

from pathlib import Path
from typing import Any
from urllib.parse import quote

import pandas as pd

from ..figures.style import save
from . import pictures, published, sweeps, tables, views
from .answers import answer
from .conditions import conditions
from .page_templates import markdown
from .pictures import Picture
from .reported import Reported

ANSWER, EXPLANATION = "answer.png", "error_over_time.png"
"""Files of the figures."""
_ON_GRAVITY = (
    "Published: improvement by a known gravity disturbance. Largest response: largest error that "
    "the disturbance causes in an otherwise perfect INS"
)
_MOST_CLAIMS = 6
"""Largest number of claims on estimators in the table of a page; their labels are long."""


def text(results: Reported, picture: Picture, folder: Path, notes: str) -> str:
    """Return the page of a scenario as markdown, and write the figures into a folder.

    Parameters
    ----------
    results : results of the scenario.
    picture : main figure of the scenario.
    folder : folder of the figures.
    notes : notes of the scenario in markdown.
    """
    loaded, cases, metrics = results.scenario, results.cases(), results.metrics()
    page_cases = sweeps.shown_cases(results)
    save(picture.figure, folder / ANSWER)
    stated = answer(results)
    return markdown(
        "scenario.md.j2",
        name=loaded.name,
        title=loaded.title,
        answer=stated,
        targets=stated["targets"].iloc[: tables.MOST_ROWS],
        listed=any(cell.startswith(sweeps.LISTED) for cell in stated["targets"].to_numpy().flat),
        caption=picture.caption,
        explanation=picture.explanation,
        picture=ANSWER,
        folder=quote(loaded.name),
        table=tables.text(views.answer_table(metrics, results.pairs(), page_cases, results.own)),
        seeking=results.seeking,
        by_line=not results.by_line.empty,
        failed=int(metrics.groupby(["case", "estimator"])["failed"].first().sum()),
        hidden_cases=len(page_cases) < len(cases),
        left_out=views.left_out(metrics, page_cases),
        below_bound=views.below_bound(metrics, page_cases),
        conditions=conditions(loaded.cases, cases),
        titles={case.name: case.title for case in loaded.cases},
        notes=notes,
        command=results.rerun(),
        manifest=results.manifest,
        **_claims(results),
        **_published(results, stated["allowed"], folder),
    )


def _claims(results: Reported) -> dict[str, Any]:
    """Return the values of the table of claims: claims on gravity, or else on estimators."""
    claims, name, most = published.gravity_claims(results), "gravity_claims", tables.MOST_ROWS
    caption = _ON_GRAVITY
    if claims.empty:
        claims, name, most = published.claimed(results), "claims", _MOST_CLAIMS
        caption = published.claims_in_words(claims)
    return {
        "claims": claims.iloc[:most],
        "claims_caption": caption,
        "claims_file": f"{name}.csv",
        "hidden_claims": max(0, len(claims) - most),
    }


def _published(results: Reported, allowed: pd.DataFrame, folder: Path) -> dict[str, Any]:
    """Return the values of ``published.j2``; nothing without published errors."""
    metrics = results.metrics()
    references = published.referenced(metrics)
    if not references:
        return {}
    titles = {case.name: case.title for case in results.scenario.cases}
    starts = published.from_starts(results, metrics, ["ekf", *results.own])
    cases = results.cases()
    if len(starts):
        own_cases = cases[cases["case"].isin(references)]
        labels = views.drawn_estimators(metrics, own_cases, results.own)
        save(pictures.over_time(results, references, labels).figure, folder / EXPLANATION)
    values = {
        "allowed": allowed,
        "table": published.published_table(metrics, titles, results.own),
        "starts": starts,
        "filtered": cases[cases["case"].isin(references) & cases["unfiltered_bound_m"].notna()],
        "picture": EXPLANATION,
        "caption": "RMS error and bound over time",
    }
    return {"published": values}
