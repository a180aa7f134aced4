"""HTML page of checked cards, with sortable tables of estimators and cases."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from ..errors import line_of
from ..files.writing import written_whole
from ..report import html_page
from .card import VERDICTS, Card, Opponent, Question
from .checked import CheckedCard
from .stored_runs import ScoreError

NOT_SUCH = ("overconfident", "unsafe")
_JOINED = {"better": "than", "as good": "as", "worse": "than", "undecided": "against"}


def standings(checked: Sequence[CheckedCard]) -> pd.DataFrame:
    """Return a table with a row for each reproduced card: verdicts, efficiency, lost runs."""
    rows = []
    for one in checked:
        if one.card is None:
            continue
        card, flown = one.card, [q for q in one.card.questions if not q.skipped]
        ratios = [q.efficiency for q in flown if q.efficiency]
        of_ekf, of_best = card.verdicts("ekf"), card.verdicts("")
        rows.append(
            {
                "estimator": card.estimator.label,
                "questions": len(flown),
                "runs": card.runs,
                **{
                    f"{verdict} {_JOINED[verdict]} the EKF": of_ekf[verdict] for verdict in VERDICTS
                },
                "better than recommended": of_best["better"],
                "worse than recommended": of_best["worse"],
                "efficiency": float(np.exp(np.mean(np.log(ratios)))) if ratios else np.nan,
                "overconfident or unsafe": sum(q.consistency in NOT_SUCH for q in flown),
                "failed": sum(q.failed for q in flown),
                "lost": sum(q.lost for q in flown),
                "seed": f"{card.seed}{'' if card.public else ' (new)'}",
                "judged": card.judged,
                "source": card.estimator.source[:16],
            }
        )
    return pd.DataFrame(rows)


def questions(checked: Sequence[CheckedCard]) -> pd.DataFrame:
    """Return a table with a row for each case of each reproduced card."""
    rows = [
        _row(one.card, question)
        for one in checked
        if one.card is not None
        for question in one.card.questions
        if not question.skipped
    ]
    return pd.DataFrame(rows)


def _row(card: Card, question: Question) -> dict[str, object]:
    by_role: dict[str, Opponent] = {other.role: other for other in question.against}
    rival = by_role.get("recommended") or by_role.get("best")
    return {
        "case": question.case,
        "estimator": card.estimator.label,
        "bound_m": question.bound_m,
        "rms_m": question.rms_m,
        "efficiency": question.efficiency,
        "success": question.success,
        "nees": question.nees,
        "coverage": question.coverage,
        "consistency": question.consistency,
        "against the EKF": by_role["ekf"].verdict,
        "recommended": rival.label if rival else "",
        "against the recommended": rival.verdict if rival else "",
        "runs": question.runs,
    }


def write(checked: Sequence[CheckedCard], path: Path) -> None:
    """Write the page: tables of the reproduced cards, and a list of all other cards with reasons.

    Raise ScoreError if the page cannot be written, PageError if the extra ``page`` is missing.
    """
    tables = {"standings": standings(checked), "questions": questions(checked)}
    text = html_page.rendered(
        "cards.html.j2",
        ("table.js", "cards.js"),
        data=html_page.packed(tables),
        reproduced=len(tables["standings"]),
        refused=[
            {"path": line_of(str(one.path)), "reasons": [line_of(r) for r in one.reasons]}
            for one in checked
            if one.card is None
        ],
    )
    with written_whole(path, ScoreError) as temporary:
        temporary.write_text(text, encoding="utf-8")
