"""The pages of a card: markdown and HTML, of one table."""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from ..errors import line_of
from ..files import written_whole
from ..report import columns, tables
from ..report.page_templates import environment, markdown
from .card import VERDICTS, Card, Opponent, Question
from .stored_runs import ScoreError

HEAD = ("question", "bound [m]", "scored", "EKF", "against EKF", "recommended", "against it")
_LONGEST_TEXT = 1000
MOST_FAILURES = 10
"""Failed runs that a page lists."""


def headline(card: Card) -> str:
    """Return what a card says in two sentences: verdicts against the EKF and the recommended."""
    said = []
    for role, name in (("ekf", "the EKF"), ("", "the recommended estimators")):
        counts = card.verdicts(role)
        if sum(counts.values()):
            parts = [f"{word} in {counts[word]}" for word in VERDICTS if counts[word]]
            said.append(f"Against {name}: {', '.join(parts)} of {sum(counts.values())} questions.")
    wrong = [q for q in card.questions if q.consistency in columns.SYMBOLS]
    if wrong:
        said.append(f"Overconfident or unsafe in {len(wrong)}.")
    return " ".join(said)


def rows(card: Card) -> list[tuple[str, ...]]:
    """Return a row of texts for each question that was flown, with the columns of :data:`HEAD`."""
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


def write(card: Card, failures: pd.DataFrame, folder: Path) -> list[Path]:
    """Write ``card.md`` and ``card.html`` into a folder and return their paths.

    ``failures`` is the table of failed and diverged runs: case, run, reason, command. Raise
    ScoreError if the pages cannot be written.
    """
    values = {
        "card": card,
        "headline": headline(card),
        "head": HEAD,
        "rows": rows(card),
        "hidden": max(0, len(failures) - MOST_FAILURES),
        "failures": failures[["case", "run", "reason", "command"]]
        .iloc[:MOST_FAILURES]
        .map(lambda cell: line_of(cell, _LONGEST_TEXT) if isinstance(cell, str) else cell),
    }
    table = tables.markdown(HEAD, [[*map(tables.plain, row)] for row in values["rows"]])
    failed = [
        (row.case, str(row.run), tables.plain(row.reason or "diverged"), tables.code(row.command))
        for row in values["failures"].itertuples()
    ]
    failures_table = tables.markdown(("case", "run", "reason", "command"), failed)
    style = (columns.TEMPLATES / "page.css").read_text(encoding="utf-8")
    html = environment(html=True).get_template("card.html.j2")
    texts = {
        "card.md": markdown("card.md.j2", table=table, failures_table=failures_table, **values),
        "card.html": html.render(style=style, **values),
    }
    for name, text in texts.items():
        with written_whole(folder / name, ScoreError) as temporary:
            temporary.write_text(text, encoding="utf-8")
    return [folder / name for name in texts]
