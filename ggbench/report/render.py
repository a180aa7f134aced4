"""Pages from templates: the report of a scenario, and the page of definitions."""

from __future__ import annotations

import re
import shlex
from collections.abc import Set
from pathlib import Path
from typing import Any
from urllib.parse import quote

import jinja2
import pandas as pd

from ..errors import GGBenchError
from ..estimator_spec import shown_names
from ..figures.numbers import counted, span
from ..files import reason_of
from ..results import digest
from ..results.folder import Results, as_argument
from . import columns, libraries, links, pictures, published, sweeps, tables, views
from .answers import answer
from .columns import TEMPLATES
from .conditions import conditions
from .findings import SUITE

PAGE_VERSION = 2
"""Number in the first line of a page; pages of other numbers are of another layout."""
_ON_GRAVITY = (
    "Published improvements by a known gravity disturbance, and the largest error of an "
    "otherwise perfect INS that the disturbance causes"
)
_ON_ESTIMATORS = "Claims of the source on pairs of estimators"


class ReportError(GGBenchError):
    """A report cannot be written."""


def environment(html: bool = False, templates: Path = TEMPLATES) -> jinja2.Environment:
    """Return the environment of a folder of templates, with the formats of numbers as filters."""
    made = jinja2.Environment(
        loader=jinja2.FileSystemLoader(templates), autoescape=html,
        undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True,
    )  # fmt: skip
    made.filters |= {
        "metres": columns.metres, "ratio": columns.ratio, "share": columns.share,
        "table": tables.text,
    }  # fmt: skip
    made.globals |= {
        "names": tables.names, "counted": counted, "span": span, "page_version": PAGE_VERSION,
    }  # fmt: skip
    return made


def markdown(template: str, templates: Path = TEMPLATES, **values: Any) -> str:
    """Return a markdown page, without empty lines in a row."""
    text = environment(templates=templates).get_template(template).render(values)
    return re.sub(r"\n{3,}", "\n\n", text).strip() + "\n"


def write(folder: Path, output: Path, pages: Set[str] = frozenset()) -> list[Path]:
    """Write the report of a results folder: ``NAME.md``, its figures and data, ``NAME.html``.

    Parameters
    ----------
    folder : results of ``ggbench run``, finished or interrupted.
    output : folder to write to; made if it does not exist.
    pages : files in it to which a page may link, besides those that are there: they come later.

    Returns
    -------
    list of Path
        The markdown page, and the HTML page if the packages of the extra ``page`` are installed.

    Raises
    ------
    StoreError, ScenarioError, ReportError
        If the folder is not a results folder, is damaged or holds no finished run.
    """
    results = Results(folder)
    if results.metrics().empty:
        raise ReportError(f"{folder} holds no finished run to report")
    name = results.scenario.name
    path = output / f"{name}.md"
    notes = links.without_dead(results.scenario.notes.strip(), output, pages)
    with_cost = name != SUITE and (f"{SUITE}.md" in pages or (output / f"{SUITE}.md").exists())
    try:
        write_data(results, output / name / digest.FOLDER)
        path.write_text(page(results, output / name, notes, with_cost), encoding="utf-8")
        write_definitions(output)
        written = [path]
        if libraries.installed():
            from . import html_page

            written.append(html_page.write(results, output / f"{name}.html", notes))
    except OSError as error:
        raise ReportError(f"cannot write to {output}: {reason_of(error)}") from None
    results.store.close()
    return written


def write_data(results: Results, folder: Path) -> None:
    """Write the digest, and the other tables that are not empty, into a folder."""
    digest.write(results, folder)
    for name, table in further_tables(results).items():
        digest.write_csv(table, folder / f"{name}.csv")


def further_tables(results: Results) -> dict[str, pd.DataFrame]:
    """Return the tables besides metrics, cases and pairs that are not empty, by name."""
    found = {
        "studies": results.studies(),
        "claims": published.claimed(results),
        "gravity_claims": published.gravity_claims(results),
        "fixes": results.fix_metrics(),
        "counters": results.counters(),
        "remarks": _remarks(results),
        "failures": results.failures(),
    }
    return {name: table for name, table in found.items() if len(table)}


def _remarks(results: Results) -> pd.DataFrame:
    """Return the remarks on the runs of the cases, and the number of runs that each is on."""
    runs = results.runs()
    own = runs[(runs["assumption"] == "") & (runs["remark"] != "")]
    counted = own.groupby(["case", "estimator", "remark"], sort=False)["run"].count()
    return counted.rename("runs").reset_index()


def write_definitions(output: Path) -> None:
    """Write the page of definitions and the table of all columns into a folder of pages."""
    listed = [
        {"column": key, "heading": c.heading, "unit": c.unit, "definition": c.definition}
        for key, c in columns.COLUMNS.items()
    ]
    pd.DataFrame(listed).to_csv(output / "columns.csv", index=False)
    (output / "definitions.md").write_text(definitions(), encoding="utf-8")


def definitions() -> str:
    """Return the page of definitions."""
    return markdown("definitions.md.j2", columns=[columns.COLUMNS[key] for key in columns.DEFINED])


def page(results: Results, folder: Path, notes: str, with_cost: bool) -> str:
    """Return the page of a scenario as markdown, and draw its figures into a folder.

    ``with_cost`` says whether the page of the standard suite, which has the one column of costs, is
    next to it.
    """
    loaded, cases = results.scenario, results.cases()
    flown = cases[cases["case"].isin(results.metrics()["case"])]
    shown = views.few_cases(_of_parts(results, flown))
    claims, said = published.gravity_claims(results), _ON_GRAVITY
    if claims.empty:
        claims, said = published.claimed(results), _ON_ESTIMATORS
    found = answer(results)
    text = markdown(
        "scenario.md.j2",
        name=loaded.name,
        title=loaded.title,
        answer=found,
        targets=found["targets"].iloc[: tables.MOST_ROWS],
        caption=pictures.draw(results, shown, folder),
        picture=pictures.ANSWER,
        folder=quote(loaded.name),
        table=tables.text(views.answer_table(results.metrics(), results.pairs(), shown)),
        seeking=results.seeking,
        failed=int(results.metrics().groupby(["case", "estimator"])["failed"].first().sum()),
        left_out=views.left_out(results.metrics(), shown),
        below_bound=views.below_bound(results.metrics(), shown),
        claims_caption=said,
        claims=claims.iloc[: tables.MOST_ROWS],
        hidden_claims=max(0, len(claims) - tables.MOST_ROWS),
        conditions=conditions(loaded.cases, cases),
        titles={case.name: case.title for case in loaded.cases},
        notes=notes,
        command=command(results),
        manifest=results.manifest,
        with_cost=with_cost,
        **_published(results, found["allowed"], folder),
    )
    return _by_name(text, results.metrics())


def _by_name(text: str, metrics: pd.DataFrame) -> str:
    """Return a page with estimators of files by their own names, where these differ."""
    held = dict(zip(metrics["estimator"], metrics["name"], strict=True))
    for label, shown in shown_names(held).items():
        text = text.replace(f"`{label}`", f"`{shown}`")
    return text


def _of_parts(results: Results, cases: pd.DataFrame) -> pd.DataFrame:
    """Return the cases that a page may list: of a sweep, those of its figure."""
    if results.scenario.sweep is None:
        return cases
    names = [name for part in sweeps.parts(results.scenario, cases) for name in part.cases]
    return cases.set_index("case").loc[names].reset_index()


def _published(results: Results, allowed: pd.DataFrame, folder: Path) -> dict[str, Any]:
    """Return the values of ``published.j2``; nothing without published errors."""
    metrics = results.metrics()
    if allowed.empty:
        return {}
    references = published.referenced(metrics)
    titles = {case.name: case.title for case in results.scenario.cases}
    starts = published.from_starts(results, metrics, "ekf")
    cases = results.cases()
    if len(starts):
        labels = views.families(metrics, cases[cases["case"].isin(references)])
        pictures.over_time(results, references, labels, folder / pictures.EXPLANATION)
    values = {
        "allowed": allowed,
        "table": published.published_table(metrics, titles),
        "starts": starts,
        "filtered": cases[cases["case"].isin(references) & cases["unfiltered_bound_m"].notna()],
        "picture": pictures.EXPLANATION,
        "caption": "RMS error and bound over time",
    }
    return {"published": values}


def command(results: Results) -> str:
    """Return the command that runs a campaign again."""
    m = results.manifest
    left_out = m.get("left_out", {})
    flags = ""
    if tuple(m["estimators"]) != tuple(
        label for label in results.scenario.campaign.estimators if label not in left_out
    ):
        flags += "".join(f" -e {shlex.quote(label)}" for label in m["estimators"])
    if m["cases"] != [case.name for case in results.whole_scenario.cases]:
        flags += "".join(f" -c {shlex.quote(name)}" for name in m["cases"])
    flags += " --assumptions" if m["assumptions"] else ""
    return f"ggbench run {as_argument(m['argument'])} -n {m['runs']} --seed {m['seed']}{flags}"
