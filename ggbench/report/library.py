"""Front page of a folder of reports: findings, league of the suite, scenarios."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import pandas as pd

from ..errors import GGBenchError
from ..files.writing import reason_of
from ..judging.standing import standing
from ..results import digest
from ..results.digest import Digest
from .findings import SUITE, findings
from .league import CAPTION, EXPLANATION
from .markdown_page import ANSWER
from .page_templates import markdown
from .render import ReportError, write_definitions
from .tables import MOST_ROWS, code

FILE = "README.md"
"""Name of the page."""
_STUDY = re.compile(r"^\*\*Answer\.\*\* (.+?[.])(?= [^a-z]|$)", re.MULTILINE)


def write(output: Path) -> tuple[Path, list[str]]:
    """Write the front page of a folder of reports.

    Parameters
    ----------
    output : folder with the reports of scenarios and their digests.

    Returns
    -------
    Path of the page, and a remark for each report that cannot be read.

    Raises
    ------
    ReportError
        If there is no report, or a file cannot be written.
    """
    digests, remarks = read(output)
    if not digests:
        raise ReportError("; ".join([f"{output} contains no report with data", *remarks]))
    path = output / FILE
    try:
        has_league = (output / SUITE / ANSWER).exists()
        page = text(digests, has_league, studies(output, digests))
        path.write_text(page, encoding="utf-8")
        write_definitions(output)
    except OSError as error:
        raise ReportError(f"cannot write to {output}: {reason_of(error)}") from None
    return path, remarks


def read(output: Path) -> tuple[list[Digest], list[str]]:
    """Return the digests of all reports in a folder, and a remark for each unreadable report."""
    digests, remarks = [], []
    for folder in sorted(output.glob(f"*/{digest.FOLDER}")):
        try:
            digests.append(digest.read(folder))
        except GGBenchError as error:
            remarks.append(str(error))
    return digests, remarks


def studies(output: Path, digests: Sequence[Digest]) -> dict[str, str]:
    """Return the first sentence of each study's answer, by name of the study's page.

    A study's page reports other results than the runs of a scenario, such as computing times.
    """
    scenarios = {each.manifest["scenario"] for each in digests}
    pages = {path.stem: path.read_text(encoding="utf-8") for path in sorted(output.glob("*.md"))}
    answers = {name: _STUDY.search(page) for name, page in pages.items() if name not in scenarios}
    return {name: answer[1] for name, answer in answers.items() if answer}


def text(
    digests: Sequence[Digest], has_league: bool = True, studies: Mapping[str, str] | None = None
) -> str:
    """Return the front page as markdown.

    Parameters
    ----------
    digests : digests of the scenarios.
    has_league : whether the league figure exists in the suite's folder of figures.
    studies : first sentence of each study's answer, by name of the study's page.
    """
    suite = [each for each in digests if each.manifest["scenario"] == SUITE]
    newest = max(each.manifest["results_version"] for each in digests)
    scenarios = [
        {
            "name": each.manifest["scenario"],
            "title": each.manifest["title"],
            "earlier": each.manifest["results_version"] < newest,
        }
        for each in digests
    ]
    return markdown(
        "library.md.j2",
        findings=findings(digests),
        ranking=ranking(suite[0]) if suite else pd.DataFrame(),
        league=f"{SUITE}/{ANSWER}" if has_league else "",
        caption=CAPTION,
        explanation=EXPLANATION,
        scenarios=scenarios,
        studies=studies or {},
        newest=newest,
    )


def ranking(suite: Digest) -> pd.DataFrame:
    """Return the first rows of the standing of causal estimators in the suite."""
    table = standing(suite.metrics, suite.cases).iloc[:MOST_ROWS]
    return table.assign(estimator=list(map(code, table["estimator"])))
