"""HTML page of a scenario: all tables and figures in one file that needs no network.

The page contains the tables as numbers; a script formats and sorts them. The figures are those of
the markdown page, as SVG; a script shows the values under the pointer.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence, Set
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from ..errors import brief
from ..figures import interactive
from ..files.writing import written_whole
from . import columns, libraries, page_templates, pictures, sweeps, views
from .answers import answer
from .columns import Column
from .conditions import conditions
from .libraries import PageError
from .pictures import Picture
from .reported import Reported
from .tables import SUCCESS_SHOWN

MOST_BYTES = 3_000_000
"""Largest size of a page [bytes]."""
_MOST_POINTS = 40_000
"""Largest number of points in all figures over time; long flights have fewer epochs."""
_MOST_DRAWN = 30
"""Largest number of cases with a figure over time; each figure takes a second and 50 kB."""
_WINDOWS = ("settled", "whole", "last20")
_SIZES = ((True, True), (False, True), (False, False))
"""Contents of a page, the largest first: whether it has the pairs, and all windows."""
_DIGITS = 4
"""Digits of a number in the page."""
_CELLS = f"RMS error (× oracle), {SUCCESS_SHOWN}; † overconfident, ‡ unsafe."
"""Definition of a column of the table of errors."""
_SCRIPTS = ("figure.js", "table.js", "page.js")
_DROPPED = ("name", "parameters")
"""Columns of the metrics that repeat the estimator's label."""


def write(results: Reported, picture: Picture, path: Path, notes: str) -> Path:
    """Write the HTML page of a results folder and return the path.

    ``picture`` is the main figure. ``notes`` are the scenario's notes in markdown.

    If the page is too large, the table of pairs is omitted. If it is still too large, all windows
    except the settled window are omitted.

    Raises
    ------
    PageError
        If the page still exceeds :data:`MOST_BYTES`, or cannot be written.
    """
    figures, content = _figures(results, picture), b""
    for most_tables in _SIZES:
        content = text(results, figures, notes, *most_tables).encode()
        if len(content) <= MOST_BYTES:
            break
    else:
        raise PageError(
            f"{path.name} would have {len(content) / 1e6:.1f} MB, more than the "
            f"{MOST_BYTES / 1e6:g} MB of a page; report fewer cases or estimators"
        )
    with written_whole(path, PageError, size=len(content)) as temporary:
        temporary.write_bytes(content)
    return path


def text(
    results: Reported,
    figures: Mapping[str, Any],
    notes: str,
    with_pairs: bool = True,
    all_windows: bool = True,
) -> str:
    """Return the HTML text of the page; ``notes`` are in markdown.

    If ``with_pairs`` is false, the table of pairs is omitted. If ``all_windows`` is false, the
    metrics have only the settled window.
    """
    loaded, cases, metrics = results.scenario, results.cases(), results.metrics()
    pairs = results.pairs()
    windows = _WINDOWS if all_windows else _WINDOWS[:1]
    ordered = pd.concat([metrics[metrics["window"] == window] for window in windows])
    tables = {
        "metrics": ordered.drop(columns=list(_DROPPED)),
        "pairs": pairs if with_pairs else pairs.iloc[:0],
        "cases": cases.drop(columns="title"),
    } | _brief(results.further_tables())
    errors = tables["errors"].drop(columns="case")
    tables["errors"] = errors.rename(columns=lambda key: _error_key(key, results.labels))
    data = {
        "cases": [{"case": row.case, "title": row.title} for row in cases.itertuples()],
        "figures": figures,
    } | packed(tables)
    stated, words = answer(results), page_templates.environment()
    first, remark = (
        words.get_template(name).render(answer=stated) for name in ("answer.j2", "remark.j2")
    )
    parser = libraries.package("markdown_it").MarkdownIt("commonmark", {"html": False})
    return rendered(
        "scenario.html.j2",
        _SCRIPTS,
        title=loaded.title,
        answer=parser.render(first),
        remark=parser.render(remark),
        notes=parser.enable("table").render(notes),
        conditions=conditions(loaded.cases, cases).to_dict("records"),
        definitions=[columns.COLUMNS[key] for key in columns.DEFINED],
        command=results.rerun(),
        manifest=results.manifest,
        data=data,
    )


def _brief(tables: Mapping[str, pd.DataFrame]) -> dict[str, pd.DataFrame]:
    """Return tables with short reasons of failures; the CSV files keep the whole texts."""
    return {
        name: table.assign(reason=table["reason"].map(brief)) if "reason" in table else table
        for name, table in tables.items()
    }


def rendered(template: str, scripts: Sequence[str], **values: Any) -> str:
    """Return an HTML page from a template, with DataTables and further scripts embedded."""
    environment = page_templates.environment(html=True)
    # Text as it is, whatever letters: the file is UTF-8 throughout.
    environment.policies["json.dumps_kwargs"] = {
        "ensure_ascii": False,
        "separators": (",", ":"),
        "allow_nan": False,
    }
    table_script, table_style = libraries.datatables()
    script = "\n".join((columns.TEMPLATES / name).read_text(encoding="utf-8") for name in scripts)
    return environment.get_template(template).render(
        policy=f"default-src 'none'; img-src data:; style-src 'unsafe-inline'; "
        f"script-src {libraries.script_hash(script)} blob:",
        style=page_templates.style(),
        table_style=table_style,
        table_script=table_script,
        script=script,
        **values,
    )


def packed(tables: Mapping[str, pd.DataFrame]) -> dict[str, Any]:
    """Return tables, and the definitions of their columns, as JSON values for the page's script."""
    return {
        "tables": {name: _packed(table) for name, table in tables.items()},
        "columns": _meanings(tables.values()),
    }


def _packed(table: pd.DataFrame) -> dict[str, Any]:
    """Return a table as its column names and, column by column, its values.

    A column of texts has a list of its different texts; its values are indices into this list.
    """
    packed = []
    for key in table:
        values = table[key]
        if pd.api.types.is_numeric_dtype(values) or pd.api.types.is_bool_dtype(values):
            packed.append({"values": [_number(value) for value in values]})
        else:
            codes, texts = pd.factorize(values.fillna("").astype(str))
            packed.append({"texts": texts.tolist(), "values": codes.tolist()})
    return {"columns": list(table), "packed": packed}


def _number(value: Any) -> float | bool | None:
    """Return a number with few digits, or None for NaN and infinity, which JSON excludes."""
    if isinstance(value, bool | np.bool_):
        return bool(value)
    if not math.isfinite(value):
        return None
    short = float(f"{value:.{_DIGITS}g}")
    return int(short) if short.is_integer() and abs(short) < 1e9 else short


_ERROR = "error of "
"""Prefix of the keys of columns with an estimator's errors, because its name is arbitrary."""


def _error_key(key: str, labels: Sequence[str]) -> str:
    """Return the key of a column in the table of errors; labels of estimators get a prefix."""
    return f"{_ERROR}{key}" if key in labels else key


def _meanings(tables: Any) -> dict[str, dict[str, str]]:
    meanings = {}
    for table in tables:
        for key in table:
            column = columns.column(key)
            whole = key not in columns.COLUMNS and pd.api.types.is_integer_dtype(table[key])
            form = "count" if whole else column.form
            if key.startswith(_ERROR):
                column = Column(key.removeprefix(_ERROR), "m", "error", _CELLS)
                form = column.form
            meanings[key] = {"head": column.head, "form": form, "definition": column.definition}
    return meanings


def _figures(results: Reported, answer: Picture) -> dict[str, Any]:
    """Return the errors over time by name of the case, and the main figure by "".

    In figures over time, estimators that are not in the main figure are hidden at first.
    """
    cases = views.few_cases(results.cases(), _MOST_DRAWN)
    page_cases = sweeps.shown_cases(results)
    labels = views.drawn_estimators(results.metrics(), page_cases, results.own)
    hidden = {label for label in results.labels if label not in (*labels, "ins")}
    most = max(1, _MOST_POINTS // ((len(results.labels) + 2) * len(cases)))
    drawn = {"": _figure(answer, set())}
    for case in cases["case"]:
        over_time = pictures.over_time(results, [case], results.labels, most)
        drawn[case] = _figure(over_time, hidden)
    return drawn


def _figure(picture: Picture, hidden: Set[str]) -> dict[str, Any]:
    caption = ". ".join(filter(None, [picture.caption, picture.explanation.rstrip(".")]))
    return {"picture": interactive.picture(picture.figure, hidden), "caption": caption}
