"""The section of a report that tells of the fixes that matchers made."""

from __future__ import annotations

from pathlib import Path
from typing import Any
from urllib.parse import quote

import pandas as pd

from ..figures.matching import Operation, operating_curves
from ..figures.numbers import short
from ..figures.style import save
from ..judging import fix_metrics
from ..results.folder import Results
from .shares import median_time, share
from .tables import markdown

READING = (
    "A matcher tries a fix at the end of a window of readings and accepts or refuses it. A fix is "
    "*right* if its horizontal error at that moment is below the limit of a lock ({limits}), and "
    "*false* if it is accepted and is not. Shares are of the runs, by the *first* fix that each "
    "accepts, with their Wilson 95 % interval: later fixes of a run are no independent draws. "
    "*First right fix*: median time of the runs that have one, with its interval between order "
    "statistics. *CEP*: radius that holds 50 and 95 % of all accepted fixes. *NEES* of the two "
    "horizontal errors of accepted fixes, 2 if consistent; its 95 % band treats each run as a "
    "single draw."
)
CAPTION = (
    "Shares of the fixes tried that are accepted, right over false, as the threshold of acceptance "
    "falls; a mark where the matcher's own lies. A matcher that waits would have tried other fixes "
    "under another threshold: these are the fixes that it did try"
)
_HEAD = (
    "case", "estimator", "runs", "first fix right", "first fix false", "no fix",
    "first right fix [s]", "fixes tried", "accepted", "of these false", "CEP50 [m]", "CEP95 [m]",
    "NEES",
)  # fmt: skip


def matching_section(results: Results, pictures: Path) -> list[str]:
    """Return the section as markdown, and draw its figure; nothing where no fix is judged.

    Parameters
    ----------
    results : the folder.
    pictures : folder of the figure.
    """
    found = results.fix_figures()
    if found.empty:
        return []
    cases = [case for case in results.scenario.cases if case.name in set(found["case"])]
    limits = [f"{case.windows.lock_m:g} m" for case in cases]
    said = limits[0]
    if len(set(limits)) > 1:
        said = ", ".join(f"{m} in {case.name}" for m, case in zip(limits, cases, strict=True))
    return [
        "## Fixes of the matchers",
        READING.format(limits=said),
        markdown(_HEAD, [_cells(row) for row in found.to_dict("records")]),
        _figure(results, found, pictures),
    ]


def _cells(row: dict[str, Any]) -> list[str]:
    nees = f"{short(row['nees'])} [{row['nees_lo']:.2f}, {row['nees_hi']:.2f}]"
    some = row["accepted"] > 0
    return [
        row["case"], f"`{row['estimator']}`", str(row["runs"]),
        *(share(row, f"{k}_share", f"{k}_lo", f"{k}_hi") for k in ("right", "false", "none")),
        median_time(row, "right_time_median_s", "right_time_lo", "right_time_hi"),
        str(row["fixes"]), str(row["accepted"]), str(row["false"]),
        *(short(row[k]) if some else "–" for k in ("cep50_m", "cep95_m")),
        nees if some else "–",
    ]  # fmt: skip


def _figure(results: Results, found: pd.DataFrame, pictures: Path) -> str:
    panels = []
    for case in results.scenario.cases:
        limit = case.windows.lock_m
        held = {}
        for row in found[found["case"] == case.name].to_dict("records"):
            if limit is not None and row["fixes"]:
                tried = results.fixes[case.name, row["estimator"]]
                false, right = fix_metrics.operating_curve(tried, limit)
                at = (row["false"] / row["fixes"], (row["accepted"] - row["false"]) / row["fixes"])
                held[row["estimator"]] = Operation(false, right, at)
        if held:
            panels.append((case.title, held))
    if not panels:
        return ""
    save(operating_curves(panels, results.labels), pictures / "fixes.png")
    return f"![{CAPTION}]({quote(results.scenario.name)}/fixes.png)\n\n*{CAPTION}*"
