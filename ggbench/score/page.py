"""Markdown and HTML pages of a card."""

from __future__ import annotations

import base64
import math
from pathlib import Path
from typing import Any

import pandas as pd

from ..errors import brief, line_of
from ..estimator_spec import shown_names
from ..figures.card import scorecard
from ..figures.numbers import counted, some
from ..figures.style import Drawing, save
from ..files.writing import written_whole
from ..report import columns, tables
from ..report.page_templates import html, markdown
from .card import VERDICTS, Card, Opponent, Question
from .stored_runs import ScoreError

HEAD = (
    "question",
    "bound [m]",
    "scored",
    "EKF",
    "against EKF",
    "recommended",
    "against the recommended",
)
FAILURE_HEAD = ("failure", "runs", "command to repeat the first run")
PICTURE = "card.png"
_LONGEST_TEXT = 1000
MOST_FAILURES = 10
"""Kinds of failures that a page lists."""
_DIVERGED = "diverged: the final error exceeds ten bounds and the error of the INS"


def shown_name(card: Card) -> str:
    """Return the name of the estimator as it appears in tables of results.

    It consists of the name of the estimator's class and the parameters. If the label cannot be
    parsed, it is returned unchanged.
    """
    label = card.estimator.label
    try:
        return shown_names({label: card.estimator.name})[label]
    except ValueError:
        return label


def headline(card: Card) -> str:
    """Return sentences on the verdicts and on the overconfident or unsafe cases.

    There is a verdict against the EKF and a verdict against the recommended estimators.
    """
    sentences = []
    for role, name in (("ekf", "the EKF"), ("", "the recommended estimators")):
        counts = card.verdicts(role)
        if sum(counts.values()):
            parts = [f"{word} in {counts[word]}" for word in VERDICTS if counts[word]]
            sentences.append(
                f"Against {name}: {', '.join(parts)} of {sum(counts.values())} questions."
            )
    wrong = [q for q in card.questions if q.consistency in columns.SYMBOLS]
    if wrong:
        sentences.append(f"Overconfident or unsafe in {counted(len(wrong), 'question')}.")
    return " ".join(sentences)


def rows(card: Card) -> list[tuple[str, ...]]:
    """Return a row of texts for each case that was run, with the columns :data:`HEAD`."""
    return [_row(question) for question in card.questions if not question.skipped]


def _row(question: Question) -> tuple[str, ...]:
    by_role = {other.role: other for other in question.against}
    ekf = by_role["ekf"]
    rival = by_role.get("recommended") or by_role.get("best")
    return (
        question.title,
        columns.cell("bound_m", question.bound_m),
        tables.error_cell({**vars(question), "as_ins": False}),
        columns.cell("rms_m", ekf.rms_m),
        ekf.verdict,
        _named(rival),
        rival.verdict if rival else columns.NONE,
    )


def _named(rival: Opponent | None) -> str:
    if rival is None:
        return columns.NONE
    text = f"{rival.label} {columns.cell('rms_m', rival.rms_m)}"
    return text if rival.role == "recommended" else f"({text})"


def kinds_of_failures(failures: pd.DataFrame) -> list[tuple[str, str, str]]:
    """Group failures by reason; return a row for each group, the most frequent first.

    Reasons that differ only in numbers form one group.

    Parameters
    ----------
    failures : table of failed and diverged runs with case, run, reason and command.

    Returns
    -------
    Reason of the first failure, numbers of runs by case as text, and command that repeats the first
    failure.
    """
    if not len(failures):
        return []
    reasons = failures["reason"].fillna("").replace("", _DIVERGED)
    kind = reasons.str.replace(r"\d+(\.\d+)?(e[+-]?\d+)?", "#", regex=True)
    rows = []
    for _, group in failures.assign(reason=reasons).groupby(kind, sort=False):
        counts = group["case"].value_counts(sort=False)
        where = some([f"{count} of {case}" for case, count in counts.items()])
        command = line_of(str(group["command"].iloc[0]), _LONGEST_TEXT)
        row = brief(str(group["reason"].iloc[0])), line_of(where, _LONGEST_TEXT), command
        rows.append((len(group), row))
    return [row for _, row in sorted(rows, key=lambda each: -each[0])]


def _picture(card: Card) -> Drawing:
    """Draw the errors of the scored estimator and of the EKF in all cases that were run."""

    def number(value: float | None) -> float:
        return math.nan if value is None else value

    drawn: list[dict[str, float | str]] = []
    for question in card.questions:
        ekf = next((other.rms_m for other in question.against if other.role == "ekf"), None)
        if not question.skipped:
            values = {"scored": question.rms_m, "ekf": ekf, "bound": question.bound_m}
            numbers = {key: number(value) for key, value in values.items()}
            drawn.append({"title": question.title, **numbers})
    return scorecard(drawn, shown_name(card))


def write(card: Card, failures: pd.DataFrame, folder: Path) -> list[Path]:
    """Write ``card.md``, ``card.html`` and ``card.png`` to a folder; return the paths of the pages.

    ``failures`` is the table of failed and diverged runs with case, run, reason and command. Raise
    ScoreError if the pages cannot be written.
    """
    kinds, cells = kinds_of_failures(failures), rows(card)
    values: dict[str, Any] = {
        "card": card,
        "shown": shown_name(card),
        "headline": headline(card),
        "head": HEAD,
        "rows": cells,
        "failure_head": FAILURE_HEAD,
        "failures": kinds[:MOST_FAILURES],
        "hidden": max(0, len(kinds) - MOST_FAILURES),
    }
    table = tables.markdown(HEAD, [[*map(tables.plain, row)] for row in cells])
    failed = [
        (tables.plain(reason), tables.plain(where), tables.code(command))
        for reason, where, command in kinds[:MOST_FAILURES]
    ]
    failures_table = tables.markdown(FAILURE_HEAD, failed)
    save(_picture(card), folder / PICTURE)
    image = base64.b64encode((folder / PICTURE).read_bytes()).decode()
    texts = {
        "card.md": markdown("card.md.j2", table=table, failures_table=failures_table, **values),
        "card.html": html("card.html.j2", image=image, **values),
    }
    for name, text in texts.items():
        with written_whole(folder / name, ScoreError) as temporary:
            temporary.write_text(text, encoding="utf-8")
    return [folder / name for name in texts]
