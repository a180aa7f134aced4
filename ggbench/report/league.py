"""The whole library of scenarios beside each other: who does how well, where, at what cost.

Made from results folders alone. Everything is said of the settled window's position error.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from ..errors import GGBenchError
from ..judging.ranking import MOST_FAILED, best_causal, pair_of, rows_of
from ..judging.statistics import BETTER, UNDECIDED
from ..results.folder import Results
from ..spec.case import CaseSpec
from ..spec.scenario import Scenario
from .opening import gain
from .situations import NOTHING, SITUATIONS, situation_of

SMOOTHERS = ("fixed-lag", "batch")
COST_OF = "ekf"
"""The estimator in whose time cost is counted."""
WITHIN = 1.02
"""Ratio of MRSE to the best causal estimator's up to which nobody needs the difference."""
UNCERTAIN = 1.1
"""Ratio up to which an estimator that cannot be told from the best one is as good."""
EXCEPTIONS = 0.05
"""Share of cases in which an estimator that is as good as the best may seem not to be."""


@dataclass(frozen=True, eq=False)
class Flown:
    """A case with what every estimator made of it.

    Attributes
    ----------
    scenario, case : what was flown.
    rows : estimator to its summary row of the settled window.
    best, ins : the rows of the best causal estimator and of the INS, None without.
    situation : key of :data:`SITUATIONS`.
    pairs : paired comparisons of the case.
    """

    scenario: str
    case: CaseSpec
    rows: Mapping[str, Mapping[str, Any]]
    best: Mapping[str, Any] | None
    ins: Mapping[str, Any] | None
    situation: str
    pairs: pd.DataFrame

    def error(self, label: str) -> float:
        """Return an estimator's MRSE [m], its failed runs counted with what was left without it.

        That is the INS's mean squared error; where the INS was not run, failed runs do not count.
        """
        row = self.rows[label]
        own, share = float(row["position_mrse_m"]), row["failed"] / row["runs"]
        if not share or self.ins is None:
            return own
        finished = (1.0 - share) * own**2 if share < 1.0 else 0.0
        return math.sqrt(finished + share * self.ins["position_mrse_m"] ** 2)

    def ratio(self, label: str) -> float:
        """Return an estimator's error over that of the best causal one; NaN without either."""
        if label not in self.rows or self.best is None:
            return math.nan
        least = self.error(self.best["label"])
        return self.error(label) / least if least > 0.0 else math.nan

    def efficiency(self, label: str) -> float:
        """Return an estimator's error over the Cramér–Rao bound of its causality."""
        if label not in self.rows:
            return math.nan
        bound = self.rows[label]["position_bound_m"]
        return self.error(label) / bound if bound > 0.0 else math.nan

    def as_good(self, label: str) -> bool:
        """Return whether an estimator is as good as the best causal one of the case.

        Its MRSE is at most 2 % larger; or at most 10 % larger, and the paired comparison cannot
        tell the two apart. It must not fail in more than 5 % of its runs, and where locks are
        judged not lock surely less often either.
        """
        if self.best is None or label not in self.rows:
            return False
        row, best = self.rows[label], self.best
        if label == best["label"]:
            return True
        if row["lock_hi"] < best["lock_lo"] or row["failed"] > MOST_FAILED * row["runs"]:
            return False
        ratio = self.ratio(label)
        if ratio <= WITHIN:
            return True
        pair = pair_of(self.pairs, self.case.name, best["label"], label)
        verdict = pair["position_verdict"] if pair else UNDECIDED
        return verdict != BETTER and ratio <= UNCERTAIN

    def cost(self, label: str) -> float:
        """Return an estimator's time over that of the EKF in this case; NaN without either."""
        times = [self.rows[k]["seconds_per_run"] for k in (label, COST_OF) if k in self.rows]
        return times[0] / times[1] if len(times) == 2 and times[1] > 0.0 else math.nan


@dataclass(frozen=True, eq=False)
class Entry:
    """A scenario of the league: a results folder that is finished.

    Attributes
    ----------
    folder, scenario, manifest : what was run.
    cases : as they were flown.
    fewer : estimator to its least number of runs in a case, if it is below what was asked for.
    """

    folder: Path
    scenario: Scenario
    manifest: Mapping[str, Any]
    cases: Sequence[Flown]
    fewer: Mapping[str, int] = field(default_factory=dict)


@dataclass(frozen=True)
class Standing:
    """What an estimator did over the library; NaN where there is nothing to say.

    Attributes
    ----------
    label, causality : which.
    by_scenario, efficiency : scenario to the geometric mean over its cases of the ratio of its
        MRSE to the best causal estimator's, and of MRSE over bound.
    score : geometric mean of that ratio over the scenarios. Where it was not run it counts as the
        median of the others of its kind (causal estimators, smoothers) there, so that nobody gains
        by staying away from hard scenarios, or loses by meeting them.
    own : the same over the scenarios that it ran.
    lost : share of its runs that failed or diverged. locked : mean share locked over the cases
        where locks are judged.
    consistent, judged : number of cases whose NEES lies in its band, and of those that have one.
    cost : median over cases of its time over the EKF's. ms : median time of a run [ms].
    ran : number of cases it ran. coverage : their share, scenarios counting equally.
    """

    label: str
    causality: str
    score: float
    own: float
    by_scenario: Mapping[str, float]
    efficiency: Mapping[str, float]
    lost: float
    locked: float
    consistent: int
    judged: int
    cost: float
    ms: float
    ran: int
    coverage: float


@dataclass(frozen=True)
class Advice:
    """Which estimator to take in a situation.

    Attributes
    ----------
    situation : key of :data:`SITUATIONS`. cases, scenarios : in which it was met.
    choice : the cheapest of the causal estimators that are as good as the best, of those that ran
        in all of the cases if there are any; if none is as good, the one of the least score. None
        if there is none to be judged, or aiding gains nothing.
    as_good : whether it is as good as the best in all but one of twenty cases.
    standings : of the causal estimators that ran at least half of it, best first.
    equal : estimator to the number of cases in which it is as good as the best.
    """

    situation: str
    cases: Sequence[Flown]
    scenarios: Sequence[str]
    choice: str | None
    as_good: bool
    standings: Sequence[Standing]
    equal: Mapping[str, int]


class League:
    """The library as it was run.

    Parameters
    ----------
    entries : finished results folders, one for each scenario.
    """

    def __init__(self, entries: Sequence[Entry]) -> None:
        self.entries = entries
        self.cases = [flown for entry in entries for flown in entry.cases]

    @cached_property
    def standings(self) -> list[Standing]:
        """Estimators of two scenarios or more (or of the only one): causal ones, INS, smoothers.

        Within each the best score first; those that ran less than half of the library come last.
        """
        order = {"filter": 0, "none": 1, "smoother": 2}
        found = [s for s in self._all if not self._is_local(s)]
        return sorted(found, key=lambda s: (order[_kind(s.causality)], *self._merit(s)))

    @cached_property
    def local(self) -> dict[str, list[str]]:
        """The other estimators, by the one scenario that ran them: they compare with nobody's."""
        found: dict[str, list[str]] = {}
        for standing in filter(self._is_local, self._all):
            (name,) = standing.by_scenario
            found.setdefault(name, []).append(standing.label)
        return found

    @cached_property
    def _all(self) -> list[Standing]:
        return standings(self.cases)

    def _is_local(self, standing: Standing) -> bool:
        return len(standing.by_scenario) < min(2, len(self.entries))

    def _merit(self, standing: Standing) -> tuple[Any, ...]:
        score = math.inf if math.isnan(standing.score) else standing.score
        return (self.is_partial(standing), float(f"{score:.2e}"), _last(standing.cost))

    def is_partial(self, standing: Standing) -> bool:
        """Return whether an estimator ran less than half of the library."""
        return standing.coverage < 0.5

    def advice(self) -> Iterator[Advice]:
        """Yield the advice for every situation that the library holds."""
        for situation in SITUATIONS:
            cases = [flown for flown in self.cases if flown.situation == situation]
            if cases:
                yield _advice(situation, cases)


def _advice(situation: str, cases: Sequence[Flown]) -> Advice:
    candidates = [
        standing
        for standing in standings(cases)
        if standing.causality == "filter"
        and standing.coverage >= 0.5
        and math.isfinite(standing.score)
    ]
    candidates.sort(key=lambda s: (float(f"{s.score:.2e}"), _last(s.cost)))
    equal = {s.label: sum(flown.as_good(s.label) for flown in cases) for s in candidates}
    good = [s for s in candidates if s.ran - equal[s.label] <= EXCEPTIONS * s.ran]
    choice = None
    if situation != NOTHING and candidates:
        everywhere = [s for s in good if s.ran == len(cases)]
        cheapest = min(everywhere or good, key=lambda s: _last(s.cost), default=candidates[0])
        choice = cheapest.label
    scenarios = list(dict.fromkeys(flown.scenario for flown in cases))
    return Advice(situation, cases, scenarios, choice, bool(good), candidates, equal)


def standings(cases: Sequence[Flown]) -> list[Standing]:
    """Return what every estimator did over some cases, in order of first appearance."""
    labels = dict.fromkeys(label for flown in cases for label in flown.rows)
    sizes = Counter(flown.scenario for flown in cases)
    found = [_standing(label, [f for f in cases if label in f.rows], sizes) for label in labels]
    others = {
        (kind, name): _median(
            s.by_scenario.get(name, math.nan) for s in found if _kind(s.causality) == kind
        )
        for kind in {_kind(s.causality) for s in found}
        for name in sizes
    }
    return [
        replace(
            s,
            score=geometric_mean(
                _or(s.by_scenario.get(name), others[_kind(s.causality), name]) for name in sizes
            ),
        )
        for s in found
    ]


def _or(value: float | None, other: float) -> float:
    return other if value is None or math.isnan(value) else value


def _kind(causality: str) -> str:
    return "smoother" if causality in SMOOTHERS else causality


def _standing(label: str, cases: Sequence[Flown], sizes: Mapping[str, int]) -> Standing:
    rows = [flown.rows[label] for flown in cases]
    held = {
        name: [flown for flown in cases if flown.scenario == name]
        for name in dict.fromkeys(flown.scenario for flown in cases)
    }
    by_scenario = {k: geometric_mean(f.ratio(label) for f in v) for k, v in held.items()}
    lost = sum(row["failed"] + row["diverged"] for row in rows)
    judged = [row for row in rows if math.isfinite(row["nees_mean"])]
    return Standing(
        label=label,
        causality=str(rows[0]["causality"]),
        score=math.nan,
        own=geometric_mean(by_scenario.values()),
        by_scenario=by_scenario,
        efficiency={k: geometric_mean(f.efficiency(label) for f in v) for k, v in held.items()},
        lost=lost / sum(row["runs"] for row in rows),
        locked=_mean(row["lock_share"] for row in rows),
        consistent=sum(row["nees_lo"] <= row["nees_mean"] <= row["nees_hi"] for row in judged),
        judged=len(judged),
        cost=_median(flown.cost(label) for flown in cases),
        ms=1e3 * _median(row["seconds_per_run"] for row in rows),
        ran=len(cases),
        coverage=sum(len(held.get(k, ())) / size for k, size in sizes.items()) / len(sizes),
    )


def geometric_mean(values: Iterable[float]) -> float:
    """Return the geometric mean of the numbers among some values, NaN without any."""
    held = [value for value in values if not math.isnan(value)]
    if not held:
        return math.nan
    with np.errstate(divide="ignore"):
        return float(np.exp(np.mean(np.log(held))))


def _mean(values: Iterable[float]) -> float:
    held = [value for value in values if not math.isnan(value)]
    return sum(held) / len(held) if held else math.nan


def _median(values: Iterable[float]) -> float:
    held = [value for value in values if not math.isnan(value)]
    return float(np.median(held)) if held else math.nan


def _last(value: float) -> float:
    """Return a number by which what has none comes last."""
    return math.inf if math.isnan(value) else value


def read(folders: Iterable[Path]) -> tuple[League, list[str]]:
    """Return the league of the results folders that are finished, and what is left out and why.

    A folder is finished if one estimator at least has all runs that were asked for in all cases.
    There is one folder for each scenario.
    """
    entries = []
    remarks = []
    for folder in folders:
        try:
            entry = read_entry(folder)
        except GGBenchError as error:
            remarks.append(str(error))
            continue
        if isinstance(entry, str):
            remarks.append(entry)
        else:
            entries.append(entry)
    return League(sorted(entries, key=lambda entry: entry.scenario.name)), remarks


def read_entry(folder: Path) -> Entry | str:
    """Return what a results folder adds to the league, or in a sentence why it adds nothing.

    Raises
    ------
    StoreError, ScenarioError
        If the folder is no results folder, is damaged, or of a version that cannot be read.
    """
    results = Results(folder)
    try:
        loaded = results.scenario
        if not loaded.campaign.league:
            return f"{folder} is left out, as its scenario asks: it has a report of its own"
        summary = results.summary()
        if summary.empty:
            return f"{folder} is left out: it holds no finished run"
        counts = summary[summary["window"] == "settled"].groupby(["label", "case"])["runs"].max()
        least = {
            label: min(int(counts.get((label, case.name), 0)) for case in loaded.cases)
            for label in results.labels
        }
        if max(least.values(), default=0) < results.run_count:
            return (
                f"{folder} is left out: it is not finished, of {results.run_count} runs "
                f"{max(least.values(), default=0)} are done in all cases"
            )
        pairs = results.paired()
        rows, beside = (dict(list(table.groupby("case"))) for table in (summary, pairs))
        cases = [
            _flown(loaded.name, case, rows[case.name], beside.get(case.name, pairs[:0]))
            for case in loaded.cases
            if case.name in rows
        ]
        return Entry(
            folder, loaded, results.manifest, [flown for flown in cases if flown.rows],
            {label: runs for label, runs in least.items() if runs < results.run_count},
        )  # fmt: skip
    finally:
        results.store.close()


def _flown(scenario: str, case: CaseSpec, summary: pd.DataFrame, pairs: pd.DataFrame) -> Flown:
    rows = rows_of(summary, case, "settled")
    best = best_causal(rows.values())
    unaided = [r for r in rows.values() if r["causality"] == "none"]
    ins = next((r for r in unaided if math.isfinite(r["position_mrse_m"])), None)
    gained = "gains"
    if best and ins:
        gained = gain(best, ins, pair_of(pairs, case.name, best["label"], ins["label"]))
    return Flown(scenario, case, rows, best, ins, situation_of(case, gained), pairs)
