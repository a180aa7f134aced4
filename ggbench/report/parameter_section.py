"""The section of a report on numbers of which several were tried: parameters of estimators."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
import pandas as pd

from ..figures.line_styles import line_styles
from ..figures.parameters import Line, Panel, over_parameter
from ..figures.style import save
from ..judging.ranking import rows_of
from ..results.folder import Results
from ..spec.case import CaseSpec
from .families import LINE, Family, families, lines, parameters

_RATIO = ("ratio_median", "ratio_median_lo", "ratio_median_hi")
_MOST_PANELS = 4
Rows = Mapping[str, Mapping[str, Any]]


def parameter_section(results: Results, summary: pd.DataFrame, pictures: Path) -> list[str]:
    """Return the section, and draw its figures; nothing where no parameter has three values.

    A panel for each case with a line for each estimator; where there are more than
    :data:`_MOST_PANELS` cases, a panel for each estimator with a line for each case.

    Parameters
    ----------
    results : the folder.
    summary : its summary.
    pictures : folder of the figures.
    """
    estimators = results.estimators
    held = {
        case: {
            k: r for k, r in rows_of(summary, case, "settled").items() if r["success_share"] >= 0.5
        }
        for case in results.scenario.cases
    }
    shown = []
    for parameter in parameters(estimators):
        over = lines(estimators, parameter)
        if not over:
            continue
        if len(held) > _MOST_PANELS:
            panels = [panel for family in over if (panel := _of_family(family, held)).lines]
        else:
            members = {k for family in families(estimators, parameter) for k in family.labels}
            beside = [k for k in results.labels if "[" not in k and k not in members]
            panels = [p for case in held if (p := _of_case(case, held[case], over, beside)).lines]
        if panels:
            file = f"over_{parameter}.png"
            save(over_parameter(parameter, panels), pictures / file)
            caption = (
                f"Error over bound of the runs that succeed (median) over `{parameter}`, a "
                "parameter of the estimators, with its 95 % interval"
            )
            if any(panel.levels for panel in panels):
                caption += "; across: estimators without it"
            name = quote(results.scenario.name)
            shown.append(f"![{caption}]({name}/{file})\n\n*{caption}*")
    return ["## Over a parameter", *shown] if shown else []


def _of_case(case: CaseSpec, rows: Rows, found: Sequence[Family], beside: Sequence[str]) -> Panel:
    """Return the panel of a case; without lines where too few of its estimators were run."""
    drawn = [
        line
        for family in found
        if (
            line := _line(
                family.title, line_styles(family.labels)[family.labels[0]].color, family, rows
            )
        )
    ]
    levels = {
        label: rows[label][_RATIO[0]]
        for label in beside
        if label in rows and rows[label]["causality"] in ("filter", "none")
    }
    return Panel(case.title, drawn, levels)


def _of_family(family: Family, held: Mapping[CaseSpec, Rows]) -> Panel:
    """Return the panel of estimators that differ in the parameter alone."""
    drawn = [line for case, rows in held.items() if (line := _line(case.name, "", family, rows))]
    return Panel(family.title, drawn, {})


def _line(title: str, colour: str, family: Family, rows: Rows) -> Line | None:
    """Return the line of a family on a case, None where fewer than :data:`LINE` were run."""
    run = [(k, v) for k, v in zip(family.labels, family.values, strict=True) if k in rows]
    if len(run) < LINE:
        return None
    labels, values = zip(*run, strict=True)
    ratios, *ends = (np.array([rows[label][key] for label in labels]) for key in _RATIO)
    return Line(title, colour, values, ratios, np.array(ends))
