"""The HTML page of a scenario: all tables and figures in one file that needs no network.

The data are in the page as numbers. Its script formats, sorts and draws them, a case at a time.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from ..figures import stored
from ..files import written_whole
from ..results.folder import Results
from . import charts, columns, libraries, render, views
from .answers import answer
from .conditions import conditions
from .libraries import PageError

MOST_BYTES = 3_000_000
"""Size of a page at most."""
_MOST_POINTS = 40_000
"""Points of all figures over time together; of longer flights fewer epochs are drawn."""
_LEAST_EPOCHS = 40
"""Fewest epochs of a figure over time; with more cases than that allows, no figure is drawn."""
_WINDOWS = ("settled", "whole", "last20")
_SIZES = ((True, True), (False, True), (False, False))
"""Whether a page has pairs, and all windows: the fullest first."""
_DIGITS = 4
"""Digits of a number in the page."""
_DROPPED = ("name", "parameters")
"""Columns of the metrics that repeat the estimator's label."""


def write(results: Results, path: Path, notes: str) -> Path:
    """Write the page of a results folder, with notes in markdown, and return its path.

    A page that would be too large has no pairs; if need be, metrics of the settled window alone.

    Raises
    ------
    PageError
        If the page would have more than :data:`MOST_BYTES` even so, or cannot be written.
    """
    content = b""
    for most_tables in _SIZES:
        content = text(results, notes, *most_tables).encode()
        if len(content) <= MOST_BYTES:
            break
    else:
        raise PageError(
            f"{path} would have {len(content) / 1e6:.1f} MB, more than the {MOST_BYTES / 1e6:g} MB "
            "of a page; report fewer cases or estimators"
        )
    with written_whole(path, PageError, size=len(content)) as temporary:
        temporary.write_bytes(content)
    return path


def text(results: Results, notes: str, with_pairs: bool = True, all_windows: bool = True) -> str:
    """Return the page with notes in markdown; with fewer tables if asked for.

    Without pairs, or with the settled window alone.
    """
    loaded, cases, metrics = results.scenario, results.cases(), results.metrics()
    pairs = results.pairs()
    windows = _WINDOWS if all_windows else _WINDOWS[:1]
    ordered = pd.concat([metrics[metrics["window"] == window] for window in windows])
    tables = {
        "metrics": ordered.drop(columns=list(_DROPPED)),
        "pairs": pairs if with_pairs else pairs.iloc[:0],
        "cases": cases.drop(columns="title"),
    } | render.further_tables(results)  # fmt: skip
    data = {
        "cases": [{"case": row.case, "title": row.title} for row in cases.itertuples()],
        "tables": {name: _packed(table) for name, table in tables.items()},
        "columns": _meanings(tables.values()),
        "curves": _curves(results, cases),
        "charts": _charts(results, metrics, cases),
    }
    environment = render.environment(html=True)
    # Text as it is, whatever letters: the file is UTF-8 throughout.
    environment.policies["json.dumps_kwargs"] = {
        "ensure_ascii": False, "separators": (",", ":"), "allow_nan": False,
    }  # fmt: skip
    table_script, table_style = libraries.datatables()
    script = (columns.TEMPLATES / "page.js").read_text(encoding="utf-8")
    scripts = libraries.vega(), script
    allowed = " ".join(libraries.script_hash(part) for part in scripts)
    said = render.environment().get_template("answer.j2").render(answer=answer(results))
    parser = libraries.package("markdown_it").MarkdownIt("commonmark", {"html": False})
    return environment.get_template("scenario.html.j2").render(
        policy=f"default-src 'none'; img-src data:; style-src 'unsafe-inline'; "
        f"script-src {allowed} 'unsafe-eval' blob:",
        style=(columns.TEMPLATES / "page.css").read_text(encoding="utf-8"),
        table_style=table_style, table_script=table_script,
        chart_script=scripts[0], script=script,
        title=loaded.title,
        answer=parser.render(said),
        notes=parser.enable("table").render(notes),
        conditions=conditions(loaded.cases, cases).to_dict("records"),
        definitions=[columns.COLUMNS[key] for key in columns.DEFINED],
        command=render.command(results),
        manifest=results.manifest,
        data=data,
    )  # fmt: skip


def _packed(table: pd.DataFrame) -> dict[str, Any]:
    """Return a table as its column names and, column by column, its values.

    Texts that repeat are numbers of a list of texts.
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
    """Return a number with few digits, None for no number: JSON knows no NaN."""
    if isinstance(value, bool | np.bool_):
        return bool(value)
    if not math.isfinite(value):
        return None
    short = float(f"{value:.{_DIGITS}g}")
    return int(short) if short.is_integer() and abs(short) < 1e9 else short


def _meanings(tables: Any) -> dict[str, dict[str, str]]:
    found = {}
    for table in tables:
        for key in table:
            column = columns.column(key)
            found[key] = {"head": column.head, "form": column.form,
                          "definition": column.definition}  # fmt: skip
    return found


def _curves(results: Results, cases: pd.DataFrame) -> dict[str, Any]:
    """Return RMS position errors over time by case; nothing where there are too many cases."""
    names = cases["case"].tolist()
    lines = len(results.labels) + 2
    most = _MOST_POINTS // (lines * len(names))
    if most < _LEAST_EPOCHS:
        return {}
    found = {}
    for case in names:
        times, errors, bounds = stored.errors_over_time(results, case, results.labels)
        kept = np.unique(np.linspace(0, len(times) - 1, min(most, len(times))).astype(int))
        found[case] = {
            "times": [_number(time) for time in times[kept]],
            "lines": {
                label: [_number(value) for value in values[kept, 0]]
                for label, values in {**errors, **bounds}.items()
            },
        }
    return found


def _charts(results: Results, metrics: pd.DataFrame, cases: pd.DataFrame) -> dict[str, Any]:
    shown = views.few_cases(cases)
    on = ["ins", *views.families(metrics, shown)]
    labels: Sequence[str] = results.labels
    drawn = (stored.drawn_bounds(results.arrays(case)).values() for case in cases["case"])
    bounds = list(dict.fromkeys(itertools.chain.from_iterable(drawn)))
    return {
        "byCase": charts.by_case([*labels, *bounds[:1]], [*on, *bounds[:1]]),
        "bound": bounds[0] if bounds else "",
        "overTime": charts.over_time([*labels, *bounds], on),
        "shown": shown["case"].tolist(),
    }
