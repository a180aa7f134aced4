"""Digests of campaigns whose errors are made up, and the league that is made of them."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import Any

import pandas as pd
from problems import SMALL
from summaries import RUNS, SAME, records, tabled

from ggbench.report import league, league_page
from ggbench.report.league import Entry, League
from ggbench.results.digest import Digest
from ggbench.spec import scenario

INS = records("ins", 1e4 * SAME, "none", seconds=0.001)
EKF = records("ekf", SAME, seconds=0.01)
Groups = list[list[dict[str, Any]]]
"""The records of the estimators of a case."""


def digest_of(
    name: str, *cases: Groups, asked: int = RUNS, campaign: str = "", text: str = "",
    scale_m: float = math.nan, **manifest: Any,
) -> Digest:  # fmt: skip
    """The digest of a campaign with the cases c0, c1, ..., by the records of each.

    ``asked`` are the runs that were asked for, ``campaign`` is set in that table of the scenario,
    ``text`` in each of its cases; ``manifest`` are further keys of it.
    """
    names = [f"c{k}" for k in range(len(cases))]
    source = SMALL[: SMALL.index("[[case]]")].replace("[campaign]", f"[campaign]\n{campaign}")
    source += "".join(f'[[case]]\nname = "{c}"\ntitle = "Case {c}"\n{text}\n' for c in names)
    loaded = scenario.from_text(source, name, "")
    tables = [tabled(*groups) for groups in cases]
    summary, pairs = (
        pd.concat([t[i].assign(case=c) for t, c in zip(tables, names, strict=True)]) for i in (0, 1)
    )
    settled = summary[summary["window"] == "settled"].reset_index(drop=True)
    found = {
        "scenario": name, "scenario_text": source, "scenario_hash": "0123456789abcdef0",
        "notes": "", "seed": 7, "runs": asked, "date": "2026-01-02", "ggbench": "1.0",
        "results_version": 1,
        "versions": {"numpy": "2.0"}, "assumptions": False,
        "machine": {"system": "Linux", "architecture": "x86_64", "processors": 2},
        "cases": names, "left_out": {},
        "done": settled.groupby("label", sort=False)["runs"].min().to_dict(),
        "correlation_m": dict.fromkeys(names),
    }  # fmt: skip
    return Digest(
        loaded, found | manifest, settled,
        pairs[pairs["window"] == "settled"].reset_index(drop=True), dict.fromkeys(names, scale_m),
    )  # fmt: skip


def entry(name: str, *cases: Groups, **options: Any) -> Entry:
    """What such a campaign adds to a league."""
    found = league.entry_of(digest_of(name, *cases, **options))
    assert isinstance(found, Entry), found
    return found


def league_of(**scenarios: list[Groups]) -> League:
    """The league of scenarios of given cases."""
    return League([entry(name, *cases) for name, cases in scenarios.items()])


def page(held: League, output: Path, *remarks: str) -> str:
    """The page of a league."""
    return league_page.LeagueReport(held, output, remarks).text()


def dishonest(group: list[dict[str, Any]], coverage: float = 0.5) -> list[dict[str, Any]]:
    """Records of an estimator whose regions hold the truth too seldom."""
    return [
        record | {"windows": {w: f | {"coverage": coverage} for w, f in record["windows"].items()}}
        for record in group
    ]


def renamed(group: list[dict[str, Any]], label: str) -> list[dict[str, Any]]:
    """The records under another label."""
    return [record | {"estimator": label} for record in group]


def with_cases(held: Digest, **changes: Any) -> Digest:
    """The digest with other keys of its manifest."""
    return dataclasses.replace(held, manifest={**held.manifest, **changes})
