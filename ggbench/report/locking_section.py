"""The section of a report that tells of locking on."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
import pandas as pd

from ..figures.locking import (
    Panels,
    Series,
    Success,
    against_cost,
    against_time,
    over_cases,
    short_km,
)
from ..figures.style import save
from ..judging import convergence
from ..judging.ranking import rows_of
from ..judging.statistics import ALPHA
from ..results.folder import Results
from ..spec.case import CaseSpec
from .families import PARTICLES, families, leaders, of_the_best
from .shares import median_time, percent, share
from .tables import markdown

READING = (
    "A run *locks* at the first epoch from which its spherical position error stays below {limit} "
    "to the end of the flight; that epoch's time is its *time to lock*. A *false lock*: at the end "
    "the error is not below that limit, but the estimator claims it to be: 1.96 √tr P, the radius "
    "within which a claimed covariance P of the position has 95 % or more of its probability, is "
    "below it. Shares are of all runs (a failed one has neither locked nor claimed to) with their "
    "Wilson 95 % interval (*surely*: the intervals of two do not overlap); the median time to lock "
    "is of the runs that locked, with its 95 % interval between order statistics (none below six "
    "runs). A smoother's estimate of the start knows the readings that follow: its time to lock "
    "tells little."
)

_FEW = 2
"""Aided estimators that need no figure to be compared."""


class ConvergenceReport:
    """The parts of the section "Convergence".

    Parameters
    ----------
    results : the folder.
    summary : its summary.
    pictures : folder of the figures.
    """

    def __init__(self, results: Results, summary: pd.DataFrame, pictures: Path) -> None:
        self.results, self.summary, self.pictures = results, summary, pictures
        judged = set(convergence.table(summary)["case"])
        self.cases = [case for case in results.scenario.cases if case.name in judged]
        self.rows = {
            case.name: {
                label: row
                for label, row in rows_of(summary, case, "settled").items()
                if not math.isnan(row["lock_share"])
            }
            for case in self.cases
        }
        self.labels = [
            label for label in results.labels if any(label in r for r in self.rows.values())
        ]

    def sections(self) -> list[str]:
        """Return the parts in their order, and draw their figures; none without a lock judged."""
        if not self.cases:
            return []
        limits = sorted({case.windows.lock_m or math.nan for case in self.cases})
        limit = f"{limits[0]:g} m" if len(limits) == 1 else "the case's limit"
        return [
            "## Convergence",
            "\n".join(self._sentences()),
            self._figures(),
            READING.format(limit=limit),
            self._table(len(limits) > 1),
        ]

    def _sentences(self) -> list[str]:
        """Return for each case which estimators' intervals lie apart from the best one's."""
        lines = []
        for case in self.cases:
            rows = {k: row for k, row in self.rows[case.name].items() if row["causality"] != "none"}
            if not rows:
                continue
            best = max(rows, key=lambda label: rows[label]["lock_share"])
            apart = [k for k in rows if rows[k]["lock_hi"] < rows[best]["lock_lo"]]
            equal = [k for k in rows if k not in apart]
            where = f"- **{case.title}** (σ {self._prior(case)} per axis): "
            if not apart:
                shares = [row["lock_share"] for row in rows.values()]
                between = f"{percent(min(shares))} to " if min(shares) < max(shares) else ""
                what = f"{between}{percent(max(shares))} of the runs locked"
                lines.append(f"{where}{what}; the intervals of all aided estimators overlap")
            else:
                lines.append(
                    f"{where}{self._shares(rows, equal)} locked, and surely more often than "
                    f"{self._shares(rows, apart)}"
                )
            false = [k for k in rows if rows[k]["false_lock_lo"] > ALPHA]
            if false:
                named = _listed([f"`{k}` in {percent(rows[k]['false_lock_share'])}" for k in false])
                lines[-1] += f"; false locks in surely more than 5 % of the runs: {named}"
            lines[-1] += "."
        return lines

    @staticmethod
    def _prior(case: CaseSpec) -> str:
        sigma = case.initial_error.position_m
        return f"{sigma:g} m" if sigma < 1000.0 else f"{short_km(sigma / 1000.0)} km"

    @staticmethod
    def _shares(rows: dict[str, dict[str, Any]], labels: Sequence[str]) -> str:
        groups = itertools.groupby(
            sorted(labels, key=lambda k: -rows[k]["lock_share"]), lambda k: rows[k]["lock_share"]
        )
        parts = []
        for common, held in groups:
            named = list(held)
            row = rows[named[0]]
            interval = f"[{percent(row['lock_lo'])}, {percent(row['lock_hi'])}]"
            parts.append(f"{_listed([f'`{k}`' for k in named])} {percent(common)} {interval}")
        return _listed(parts)

    def _table(self, limits: bool) -> str:
        head = ["case", "σ of the position", "estimator", "runs", "locked", "false locks",
                "median time to lock [s]"]  # fmt: skip
        if limits:
            head.insert(2, "lock below")
        lines = []
        for case in self.cases:
            for label, row in self.rows[case.name].items():
                cells = [case.name, self._prior(case)]
                if limits:
                    cells.append(f"{case.windows.lock_m:g} m")
                cells += [
                    f"`{label}`",
                    str(row["runs"]),
                    share(row, "lock_share", "lock_lo", "lock_hi"),
                    share(row, "false_lock_share", "false_lock_lo", "false_lock_hi"),
                    median_time(row, "lock_time_median_s", "lock_time_lo", "lock_time_hi"),
                ]
                lines.append(cells)
        return markdown(head, lines)

    def _figures(self) -> str:
        name = quote(self.results.scenario.name)
        rows = [self._panels(group) for group in self._groups()]
        save(over_cases(rows, self.labels), self.pictures / "convergence.png")
        curves = []
        for case in self.cases:
            times = np.concatenate([[0.0], self.results.arrays(case.name)["times"]])
            shares = {
                label: convergence.share_by_time(
                    self.results.lock_times(case.name, label),
                    self.rows[case.name][label]["runs"],
                    times,
                )
                for label in leaders(self.results.estimators, self.rows[case.name])
            }
            curves.append((case.title, times, shares))
        save(against_time(curves, self.labels), self.pictures / "locks_over_time.png")
        captions = {
            "convergence.png": "Share of runs that locked, share of false locks, and median time "
            "to lock, with 95 % intervals",
            "locks_over_time.png": "Share of runs that have locked on by each time"
            + of_the_best(self.results.estimators),
        }
        panels = [
            panel for case in self.cases if len((panel := self._success(case)).seconds) > _FEW
        ]
        if panels:
            joined = {
                family.title: {
                    label: f"{value:g}"
                    for label, value in zip(family.labels, family.values, strict=True)
                }
                for family in families(self.results.estimators, PARTICLES)
            }
            save(against_cost(panels, self.labels, joined), self.pictures / "cost.png")
            captions["cost.png"] = (
                "Share of runs that locked, with its 95 % interval, over the time of a run: up and "
                "to the left is better"
            )
            if joined:
                captions["cost.png"] += "; numbers beside marks that a line joins are particles"
        return "\n\n".join(f"![{c}]({name}/{file})\n\n*{c}*" for file, c in captions.items())

    def _success(self, case: CaseSpec) -> Success:
        """Return what aided estimators cost and bring in a case."""
        rows = {
            label: row
            for label, row in self.rows[case.name].items()
            if row["causality"] != "none" and row["seconds_per_run"] > 0.0
        }
        return Success(
            case.title,
            {label: row["seconds_per_run"] for label, row in rows.items()},
            {k: (r["lock_share"], r["lock_lo"], r["lock_hi"]) for k, r in rows.items()},
        )

    def _groups(self) -> list[list[CaseSpec]]:
        """Return cases that differ in their initial errors alone together, the others in one group.

        A group is in the order of its priors, if these are all different.
        """
        found: dict[CaseSpec, list[CaseSpec]] = {}
        for case in self.cases:
            prior = self.cases[0].initial_error
            nameless = {"name": "", "title": "", "reference": None, "initial_error": prior}
            found.setdefault(case.model_copy(update=nameless), []).append(case)
        groups, single = [], []
        for group in found.values():
            if len({case.initial_error.position_m for case in group}) == len(group) > 1:
                groups.append(sorted(group, key=lambda case: case.initial_error.position_m))
            else:
                single += group
        return [*groups, *([single] if single else [])]

    def _panels(self, group: Sequence[CaseSpec]) -> Panels:
        priors = [case.initial_error.position_m / 1000.0 for case in group]
        rising = len(group) > 1 and all(a < b for a, b in itertools.pairwise(priors))
        names = [case.name for case in group]
        title = f"{names[0]} … {names[-1]}" if len(self._groups()) > 1 else ""

        def series(label: str, *columns: str) -> Series:
            nothing: dict[str, Any] = {}
            rows = [self.rows[name].get(label, nothing) for name in names]
            return Series(*(np.array([r.get(c, math.nan) for r in rows]) for c in columns))

        def all_of(*columns: str) -> dict[str, Series]:
            return {label: series(label, *columns) for label in self.labels}

        return Panels(
            title, names, priors if rising else None,
            all_of("lock_share", "lock_lo", "lock_hi"),
            all_of("false_lock_share", "false_lock_lo", "false_lock_hi"),
            all_of("lock_time_median_s", "lock_time_lo", "lock_time_hi"),
        )  # fmt: skip


def _listed(parts: Sequence[str]) -> str:
    return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} and {parts[-1]}"
