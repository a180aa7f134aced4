"""The whole library of scenarios beside each other: who does how well, where, at what cost.

Made from digests alone (:mod:`.results.digest`). Everything is said of the settled window's
position error. Every scenario counts as much as any other, however many cases it has.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from ..errors import GGBenchError
from ..estimator_spec import EstimatorSpec
from ..figures.numbers import counted
from ..judging.ranking import consistent
from ..results import digest
from ..results.digest import Digest
from ..spec.rosters import rosters
from .outcome import Outcome, comparable_ratio, outcome
from .situations import NOTHING, SITUATIONS, situation_of

STANDARD = tuple(text for text in rosters()["standard"] if text != "ins")
"""The aided estimators that run in every scenario, or are missed with a reason."""
SMOOTHERS = ("fixed-lag", "batch")
COST_OF = "ekf"
"""The estimator in whose time cost is counted."""
EXCEPTIONS = 0.05
"""Share of cases in which an estimator that is advised may not be as good as the best."""

ABOUT = 1.25
"""Ratio of times up to which one is no reason to advise an estimator with more parameters."""


@dataclass(frozen=True, eq=False)
class Flown:
    """A case with what every estimator made of it.

    Attributes
    ----------
    scenario : its name.
    found : what came out of it, estimators by their :func:`name_of`.
    situation : key of :data:`SITUATIONS`.
    width : σ/ℓ; NaN where ℓ is not known.
    """

    scenario: str
    found: Outcome
    situation: str
    width: float

    @property
    def rows(self) -> Mapping[str, Mapping[str, Any]]:
        """Estimator to its summary row of the settled window."""
        return self.found.rows

    def good(self, label: str) -> bool:
        """Return whether an estimator is good in this case (:meth:`.Outcome.good`)."""
        return self.found.good(label)

    def open(self, label: str) -> bool:
        """Return whether the runs are too few to tell an estimator from the best."""
        return self.found.beside.get(label) == "open"

    def ratio(self, label: str) -> float:
        """Return an estimator's median error over the bound (:func:`.outcome.comparable_ratio`)."""
        found = self.found
        return comparable_ratio(self.rows[label], found.best, found.pairs.get(label))

    def cost(self, label: str) -> float:
        """Return an estimator's time over that of the EKF in this case; NaN without either."""
        times = [self.rows[k]["seconds_per_run"] for k in (label, COST_OF) if k in self.rows]
        return times[0] / times[1] if len(times) == 2 and times[1] > 0.0 else math.nan


@dataclass(frozen=True, eq=False)
class Entry:
    """A scenario of the league: a digest that is finished, and its cases as they were flown."""

    digest: Digest
    cases: Sequence[Flown]

    @property
    def name(self) -> str:
        """The name of the scenario."""
        return self.digest.scenario.name

    @property
    def fewer(self) -> dict[str, int]:
        """Estimators that got fewer runs than were asked for, and how many."""
        done, runs = self.digest.manifest["done"], int(self.digest.manifest["runs"])
        return {label: count for label, count in done.items() if count < runs}


@dataclass(frozen=True)
class Standing:
    """What an estimator did over some cases; NaN where there is nothing to say.

    Attributes
    ----------
    label, causality : which.
    cases, scenarios : number of those that it ran.
    good, open : share of them in which it is honest and as good as the best (or may be), and of
        those in which the runs are too few to tell; scenarios counting equally.
    honest : share of them in which it is honest.
    worst : its row of the case in which it succeeds least.
    success, ratio : scenario to the mean share of success over its cases, and to the geometric
        mean of the median errors over the bound.
    lost : share of its runs that failed or diverged.
    cost : median over cases of its time over the EKF's.
    ms : median time of a run [ms].
    """

    label: str
    causality: str
    cases: int
    scenarios: int
    good: float
    open: float
    honest: float
    worst: Mapping[str, Any]
    success: Mapping[str, float]
    ratio: Mapping[str, float]
    lost: float
    cost: float
    ms: float

    @property
    def mean_success(self) -> float:
        """The share of success, scenarios counting equally."""
        return mean(self.success.values())

    @property
    def mean_ratio(self) -> float:
        """The geometric mean over the scenarios of the median error over the bound."""
        return geometric_mean(self.ratio.values())


@dataclass(frozen=True)
class Advice:
    """Which estimator to take in a situation.

    Attributes
    ----------
    situation : key of :data:`SITUATIONS`.
    cases, scenarios : in which it was met.
    standings : of the causal estimators that ran in all of it, the best first.
    nobody : in how many of the cases no causal estimator is honest.
    choice : of those that are honest and as good as the best in all cases but :data:`EXCEPTIONS`
        of them, and take about the cheapest's time (:data:`ABOUT`), the one with the fewest
        parameters; None if there is none, or aiding gains nothing.
    """

    situation: str
    cases: Sequence[Flown]
    scenarios: Sequence[str]
    standings: Sequence[Standing]
    nobody: int
    choice: Standing | None


class League:
    """The library as it was run.

    Parameters
    ----------
    entries : finished digests, one for each scenario.
    """

    def __init__(self, entries: Sequence[Entry]) -> None:
        self.entries = entries
        self.cases = [flown for entry in entries for flown in entry.cases]

    @cached_property
    def roster(self) -> list[str]:
        """Those of the standard roster that ran anywhere at all."""
        known = {label for flown in self.cases for label in flown.rows}
        return [label for label in STANDARD if label in known]

    @cached_property
    def common(self) -> list[Flown]:
        """The cases that all of the roster ran: those that ranks are of."""
        return [flown for flown in self.cases if all(label in flown.rows for label in self.roster)]

    @cached_property
    def standings(self) -> list[Standing]:
        """The standard roster and the INS over the common cases, the best first in each block."""
        ran = {label for flown in self.common for label in flown.rows}
        labels = [label for label in ("ins", *STANDARD) if label in ran]
        order = {"filter": 0, "none": 1, "fixed-lag": 2, "batch": 2}
        found = [standing(label, self.common) for label in labels]
        return sorted(found, key=lambda s: (order[s.causality], *_merit(s)))

    @cached_property
    def over_all(self) -> list[Standing]:
        """Those of :attr:`standings` that are aided, in that order, over all cases they ran."""
        ranked = [s.label for s in self.standings if s.label != "ins"]
        return [standing(label, self.cases) for label in ranked]

    @cached_property
    def others(self) -> list[Standing]:
        """Estimators beyond the roster, over the cases that they ran: they are not ranked."""
        labels = dict.fromkeys(label for flown in self.cases for label in flown.rows)
        known = {"ins", *STANDARD}
        return [standing(label, self.cases) for label in labels if label not in known]

    def holes(self) -> dict[str, dict[str, str]]:
        """Return scenario to the estimators of the roster that it lacks, each with the reason."""
        found: dict[str, dict[str, str]] = {}
        for entry in self.entries:
            run = {label for flown in entry.cases for label in flown.rows}
            told = {name_of(k): why for k, why in entry.digest.manifest["left_out"].items()}
            for label in STANDARD:
                if label not in run:
                    why = told.get(label, "the scenario does not ask for it")
                    found.setdefault(entry.name, {})[label] = why
        return found

    def advice(self) -> Iterator[Advice]:
        """Yield the advice for every situation that the library holds."""
        for situation in SITUATIONS:
            cases = [flown for flown in self.cases if flown.situation == situation]
            if cases:
                yield _advice(situation, cases)


def _advice(situation: str, cases: Sequence[Flown]) -> Advice:
    labels = dict.fromkeys(
        label
        for flown in cases
        for label, row in flown.rows.items()
        if row["causality"] == "filter" and all(label in other.rows for other in cases)
    )
    found = sorted((standing(label, cases) for label in labels), key=_merit)
    able = [s for s in found if s.good >= 1.0 - EXCEPTIONS]
    choice = None
    if situation != NOTHING and able:
        near = ABOUT * min(_last(s.cost) for s in able)
        cheap = [s for s in able if _last(s.cost) <= near]
        choice = min(
            cheap, key=lambda s: (len(EstimatorSpec.parse(s.label).parameters), _last(s.cost))
        )
    nobody = sum(flown.found.nobody_honest for flown in cases)
    scenarios = list(dict.fromkeys(flown.scenario for flown in cases))
    return Advice(situation, cases, scenarios, found, nobody, choice)


def _merit(standing: Standing) -> tuple[float, ...]:
    """Return by what standings are ordered: as good as the best where, success, error, cost."""
    return (
        -round(standing.good, 2), -round(standing.mean_success, 2),
        round(_last(standing.mean_ratio), 2), _last(standing.cost),
    )  # fmt: skip


def standing(label: str, cases: Iterable[Flown]) -> Standing:
    """Return what an estimator did over those of some cases that it ran."""
    held: dict[str, list[Flown]] = {}
    for flown in cases:
        if label in flown.rows:
            held.setdefault(flown.scenario, []).append(flown)
    ran = [flown for group in held.values() for flown in group]
    rows = [flown.rows[label] for flown in ran]

    def by_scenario(of: Any, over: Any) -> dict[str, float]:
        return {name: over(of(flown) for flown in group) for name, group in held.items()}

    return Standing(
        label=label,
        causality=str(rows[0]["causality"]),
        cases=len(ran),
        scenarios=len(held),
        good=mean(by_scenario(lambda f: float(f.good(label)), mean).values()),
        open=mean(by_scenario(lambda f: float(f.open(label)), mean).values()),
        honest=mean(by_scenario(lambda f: float(consistent(f.rows[label])), mean).values()),
        worst=min(rows, key=lambda row: (row["success_share"], row["success_lo"])),
        success=by_scenario(lambda f: f.rows[label]["success_share"], mean),
        ratio=by_scenario(lambda f: f.ratio(label), geometric_mean),
        lost=sum(row["failed"] + row["diverged"] for row in rows) / sum(r["runs"] for r in rows),
        cost=_median(flown.cost(label) for flown in ran),
        ms=1e3 * _median(row["seconds_per_run"] for row in rows),
    )


def geometric_mean(values: Iterable[float]) -> float:
    """Return the geometric mean of the numbers among some values, NaN without any."""
    held = [value for value in values if not math.isnan(value)]
    if not held:
        return math.nan
    with np.errstate(divide="ignore"):
        return float(np.exp(np.mean(np.log(held))))


def mean(values: Iterable[float]) -> float:
    """Return the mean of the numbers among some values, NaN without any."""
    held = [value for value in values if not math.isnan(value)]
    return sum(held) / len(held) if held else math.nan


def _median(values: Iterable[float]) -> float:
    held = [value for value in values if not math.isnan(value)]
    return float(np.median(held)) if held else math.nan


def _last(value: float) -> float:
    """Return a number by which what has none comes last."""
    return math.inf if math.isnan(value) else value


def name_of(label: str) -> str:
    """Return the name by which the league knows an estimator: its label without the lag.

    A fixed lag is as long as a scenario's measurements need.
    """
    return str(EstimatorSpec.parse(label).without("lag"))


def read(reports: Path) -> tuple[League, list[str]]:
    """Return the league of the digests in a folder of reports, and what is left out and why."""
    entries, remarks = [], []
    for manifest in sorted(reports.glob(f"*/{digest.FOLDER}/manifest.json")):
        try:
            entry = entry_of(digest.read(manifest.parent))
        except GGBenchError as error:
            remarks.append(str(error))
            continue
        if isinstance(entry, str):
            remarks.append(entry)
        else:
            entries.append(entry)
    return League(entries), remarks


def _renamed(held: Digest) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return summary and pairs with estimators by their names; of two of one name the first."""
    labels: dict[str, str] = {}
    for label in held.manifest["done"]:
        labels.setdefault(name_of(label), label)
    names = {label: name for name, label in labels.items()}
    summary = held.summary[held.summary["label"].isin(names)]
    pairs = held.pairs[held.pairs["first"].isin(names) & held.pairs["second"].isin(names)]
    return (
        summary.assign(label=summary["label"].map(names)),
        pairs.assign(first=pairs["first"].map(names), second=pairs["second"].map(names)),
    )


def entry_of(held: Digest) -> Entry | str:
    """Return what a digest adds to the league, or in a sentence why it adds nothing.

    It is finished if one estimator at least has all runs that were asked for in all cases.
    """
    name, manifest = held.scenario.name, held.manifest
    if not held.scenario.campaign.league:
        why = held.scenario.provenance.get("campaign.league", "its scenario asks for it")
        return f"{name} is left out: {why}"
    most = max(manifest["done"].values(), default=0)
    if most < manifest["runs"]:
        return (
            f"{name} is left out: it is not finished, of {counted(manifest['runs'], 'run')} "
            f"{most} {'is' if most == 1 else 'are'} done in all cases"
        )
    summary, pairs = _renamed(held)
    of_case = dict(list(pairs.groupby("case")))
    cases = []
    for case in held.scenario.cases:
        found = outcome(case, summary, of_case.get(case.name, pairs[:0]))
        if found.rows:
            scale = held.correlation_m[case.name]
            situation = situation_of(case, found.gain, scale)
            cases.append(Flown(name, found, situation, case.initial_error.position_m / scale))
    return Entry(held, cases)
