"""The section of a report on numbers of which several were tried: parameters of estimators."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from urllib.parse import quote

import numpy as np
import pandas as pd

from ..figures.parameters import Line, Panel, over_parameter
from ..figures.style import save
from ..judging.ranking import rows_of
from ..results.folder import Results
from ..spec.case import CaseSpec
from .families import LINE, Family, families, lines, parameters


def parameter_section(results: Results, summary: pd.DataFrame, pictures: Path) -> list[str]:
    """Return the section, and draw its figures; nothing where no parameter has three values.

    Parameters
    ----------
    results : the folder. summary : its summary. pictures : folder of the figures.
    """
    estimators = results.estimators
    shown = []
    for parameter in parameters(estimators):
        over = lines(estimators, parameter)
        if not over:
            continue
        members = {k for family in families(estimators, parameter) for k in family.labels}
        beside = [k for k in results.labels if "[" not in k and k not in members]
        panels = [
            panel
            for case in results.scenario.cases
            if (panel := _panel(case, summary, over, beside)) is not None
        ]
        if panels:
            file = f"over_{parameter}.png"
            save(over_parameter(parameter, panels), pictures / file)
            caption = (
                f"Position MRSE in the settled window over `{parameter}`, a parameter of the "
                "estimators, with 95 % bootstrap intervals; across: estimators without it"
            )
            name = quote(results.scenario.name)
            shown.append(f"![{caption}]({name}/{file})\n\n*{caption}*")
    return ["## Over a parameter", *shown] if shown else []


def _panel(
    case: CaseSpec, summary: pd.DataFrame, found: Sequence[Family], beside: Sequence[str]
) -> Panel | None:
    """Return a case as the figure has it; None where too few of its estimators were run."""
    rows = {
        label: row
        for label, row in rows_of(summary, case, "settled").items()
        if np.isfinite(row["position_mrse_m"])
    }
    drawn = []
    for family in found:
        run = [(k, v) for k, v in zip(family.labels, family.values, strict=True) if k in rows]
        if len(run) >= LINE:
            labels, values = zip(*run, strict=True)
            errors, *ends = (
                np.array([rows[label][f"position_mrse_{which}"] for label in labels])
                for which in ("m", "lo", "hi")
            )
            drawn.append(Line(family.title, labels, values, errors, np.array(ends)))
    if not drawn:
        return None
    levels = {
        label: rows[label]["position_mrse_m"]
        for label in beside
        if label in rows and rows[label]["causality"] in ("filter", "none")
    }
    bound = rows[drawn[0].labels[0]]["position_bound_m"]
    return Panel(case.title, drawn, levels, bound)
