"""The report of the study: every number in it comes from the table of its tracks."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from ggbench.figures.style import save
from ggbench.judging.statistics import wilson

from . import association as assoc
from . import design, figures, findings, sections, words
from .findings import Ranking
from .indices import OF_MAPS, completed

FOLDER = "matching_area"
TABLE = "tracks.csv"


@dataclass(frozen=True)
class Found:
    """All that the report tells, found once."""

    table: pd.DataFrame
    near: Ranking
    weak: Ranking
    headings: assoc.Spread
    locking: assoc.Spread
    ceilings: dict[str, float]
    compared: list[findings.Compared]

    @classmethod
    def of(cls, table: pd.DataFrame, samples: int = assoc.SAMPLES) -> Found:
        """Return what a table of tracks says."""
        table = completed(table)
        return cls(
            table, findings.accuracy(table, samples), findings.right_fixes(table, samples),
            findings.over_headings(table, samples), findings.locking(table, samples),
            findings.ceilings(table), findings.false_fixes(table),
        )  # fmt: skip


def write(table: pd.DataFrame, output: Path) -> Path:
    """Write ``matching_area.md`` and its figures; return the report."""
    found = Found.of(table)
    folder = output / FOLDER
    save(figures.scatter(found.table, found.near), folder / "scatter.png")
    save(figures.forest(found.near, found.weak), folder / "forest.png")
    path = output / f"{FOLDER}.md"
    path.write_text(text(found), encoding="utf-8")
    return path


def text(found: Found) -> str:
    """Return the report."""
    table = found.table
    lines = [
        "# Where to match: which index to trust",
        f"**{verdict(found)}**",
        beside(found.near),
        locking_verdict(found),
        f"Made by `make matching` and never edited by hand. [{TABLE}]({FOLDER}/{TABLE}) has all "
        f"{len(table)} tracks; `PYTHONPATH=studies .venv/bin/python -m matching_area --report` "
        "makes this text and its figures anew from it.",
        "## What was flown",
        sections.flown(table),
        "## Local accuracy",
        sections.accuracy(found.near, found.headings),
        f"![Correlations of ranks with their intervals]({FOLDER}/forest.png)",
        f"![Errors over roughness and over two bounds]({FOLDER}/scatter.png)",
        "### What choosing by an index buys",
        sections.choices(table, len(found.near.order.samples)),
        "### Ceilings",
        sections.ceilings(table, found.ceilings),
        "## Locking on",
        sections.locking(table, found.weak, found.locking),
        "## False fixes: predicted and found",
        sections.false_fixes(found.compared),
        "## Gravimeter or gradiometer",
        sections.instruments(table),
        "## How it was reckoned, and what it does not say",
        sections.limits(),
    ]
    return "\n\n".join(lines) + "\n"


def verdict(found: Found) -> str:
    """Answer which index is to be trusted for the accuracy, and how much."""
    near, trusted = found.near, found.near.trusted
    if not trusted:
        best = int(np.nanargmax(near.order.value))
        return (
            "Trust none of these indices: of none does the correlation of ranks with the error "
            f"exceed {findings.TRUSTED:g} with its interval and hold in each region; the best is "
            f"the {near.indices[best].title}, {words.value(near.order, best)}."
        )
    best = trusted[0]
    perfect = float(np.mean([*found.ceilings.values()]))
    said = (
        f"Trust the {near.indices[best].title}: its correlation of ranks with the error that a "
        f"filter then makes is {words.value(near.order, best)}, where {perfect:.2f} would be "
        "perfect"
    )
    if near.indices[best].column == "bound_m":
        ratio = found.table["error_m"] / found.table["bound_m"]
        low, high = np.percentile(ratio, [5.0, 95.0])
        said += f", and the error is {low:.2f} to {high:.2f} times the bound on 90 % of the tracks"
    of_maps = {index.column for index in OF_MAPS}
    alone = [i for i in trusted if near.indices[i].column in of_maps]
    if alone and alone[0] != best:
        said += f". Of what a map alone says, the best is {_valued(near, alone[:1])}"
        said += "; it knows no heading"
    return f"{said}."


def beside(near: Ranking) -> str:
    """Say which others are to be trusted, which not, and what differs from roughness."""
    said = []
    if len(near.trusted) > 1:
        said.append(f"Trusted, too: {_valued(near, near.trusted[1:])}")
    others = [index.title for i, index in enumerate(near.indices) if i not in near.trusted]
    if others and near.trusted:
        said.append(f"Do not choose by {words.listed(others, 'or')}")
    differing = {
        what: [x.title for i, x in enumerate(near.indices) if near.beyond(i) == what]
        for what in ("better", "worse", "no")
    }
    for what in ("better", "worse"):
        if differing[what]:
            verb = "is" if len(differing[what]) == 1 else "are"
            said.append(
                f"Distinguishably {what} than roughness {verb} {words.listed(differing[what])}"
            )
    same = [name for name in differing["no"] if name != "roughness"]
    if same:
        said.append(f"Not distinguishable from roughness: {words.listed(same)}")
    return ". ".join(said) + "."


def _valued(ranking: Ranking, which: list[int]) -> str:
    return words.listed(
        [f"{ranking.indices[i].title}, {words.value(ranking.order, i)}" for i in which]
    )


def locking_verdict(found: Found) -> str:
    """Answer which index is to be trusted for locking on."""
    weak, trusted, table = found.weak, found.weak.trusted, found.table
    runs = int(table["wide_runs"].sum())
    predicted = float((table["wide_union"] + table["wide_spill"]).clip(upper=1.0).mean())
    said = (
        f"For locking on from {design.WIDE.sigma_m / 1e3:g} km with "
        f"{words.instrument(design.WIDE.instrument)}: "
        f"{words.share(wilson(int(table['wide_locked'].sum()), runs))} of {runs} fixes were "
        f"accepted and right, {words.percent(table['wide_false'].sum() / runs)} accepted and "
        f"wrong; {words.percent(table['wide_wrong'].sum() / runs)} of the best places were wrong, "
        f"{words.percent(predicted)} had been predicted. Where less is read and known, "
    )
    if not trusted:
        return said + "no index is to be trusted for the share of right fixes."
    named = [trusted[0], weak.at("roughness"), weak.at("weak_ambiguity")]
    others = [i for i in named[1:] if i != trusted[0]]
    return said + (
        f"take the {_valued(weak, named[:1])} with the share of right fixes; to compare: "
        f"{_valued(weak, others)}."
    )
