"""The section of a report that looks inside particle filters: whether their particles live."""

from __future__ import annotations

import math
from typing import Any

from ..figures.numbers import short
from ..results.folder import Results
from .families import PARTICLES
from .tables import markdown

_COUNTERS = {
    "least ESS": ("ess_min",),
    "median ESS": ("ess_median",),
    "fewest distinct": ("unique_min", "unique"),
    "resamplings": ("resamplings",),
    "stages": ("tempering_stages",),
    "repairs": ("covariance_repairs",),
    "median fading": ("fading_median",),
}
"""Columns of the table, and what an estimator may call them in its ``info``."""
READING = (
    "Medians over the runs. *ESS*, the effective sample size 1/ΣW² after a reading was weighed, is "
    "how many particles carry the weight: near 1, one of them decides alone. *Fewest distinct*: "
    "how many particles of the cloud the poorest resampling let live (of unscented particle "
    "filters: how many are left at the end). *Stages*: in which sharp readings were taken in "
    "beyond one blow each. *Repairs*: epochs whose covariance had lost a direction, because fewer "
    "particles were alive than there are states. An ESS that is large again says nothing of "
    "health: copies of one particle weigh the same."
)


def particles_section(results: Results) -> list[str]:
    """Return the section as markdown; nothing where no estimator counts its particles."""
    found = results.counters()
    if "ess_min" not in found:
        return []
    found = found[found["ess_min"].notna()]
    heads = [head for head, names in _COUNTERS.items() if any(name in found for name in names)]
    rows = []
    for row in found.to_dict("records"):
        content = results.estimators[row["estimator"]]
        count = content.get("parameters", {}).get(PARTICLES)
        cells = [_cell(row, *_COUNTERS[head]) for head in heads]
        rows.append([row["case"], f"`{row['estimator']}`", "–" if count is None else str(count),
                     *cells])  # fmt: skip
    table = markdown(["case", "estimator", "particles", *heads], rows)
    return ["## Inside the particle filters", READING, table]


def _cell(row: dict[str, Any], *names: str) -> str:
    values = [row[name] for name in names if not math.isnan(row.get(name, math.nan))]
    return short(float(values[0])) if values else "–"
