"""Plan of a campaign: runs, keys of results, and tasks.

A task consists of runs of one case. Each run is simulated once per task and given to all estimators
of the task. All estimators receive equal problems, so their differences can be compared run by run.
Estimators that process many runs at once have separate tasks with the same runs.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from ..spec.case import CaseSpec
from ..spec.scenario import Scenario
from . import result_keys
from .registry import own_file
from .runner import EstimatorKeys, Task, by_block_size

TASK_RUNS = 128
"""Most runs of a task."""


@dataclass(frozen=True)
class Plan:
    """The runs of a campaign, and the keys of their results.

    Attributes
    ----------
    scenario : scenario with the selected cases; its assumptions are removed unless they are run.
    estimators : estimators of the scenario's cases: content (:attr:`.Choice.content`) by label.
    studied : estimators of the assumptions: content by label.
    runs, seed : number of runs per case, and the seed.
    left_out : reason why an estimator cannot process a case, by label and case.
    """

    scenario: Scenario
    estimators: Mapping[str, Mapping[str, Any]]
    studied: Mapping[str, Mapping[str, Any]]
    runs: int
    seed: int
    left_out: Mapping[str, Mapping[str, str]] = field(default_factory=dict)

    def cells(self) -> list[tuple[str, CaseSpec, EstimatorKeys]]:
        """Return (study, case, estimators with keys) for all cases.

        The study is the name of an assumption, or "" for the cases themselves.
        """
        return [
            (study, case, self._pairs(case, self.studied if study else self._taking(case.name)))
            for study, case in self.scenario.every_case()
        ]

    def _taking(self, case: str) -> dict[str, Mapping[str, Any]]:
        """Return the contents of the estimators that do not refuse a case, by label."""
        refused = {label for label, reasons in self.left_out.items() if case in reasons}
        return {k: content for k, content in self.estimators.items() if k not in refused}

    def _pairs(self, case: CaseSpec, contents: Mapping[str, Mapping[str, Any]]) -> EstimatorKeys:
        return tuple(
            (label, result_keys.run_key(case, content, self.seed))
            for label, content in contents.items()
        )

    def joined(self, old: Mapping[str, Any], whole: Scenario, finished: Set[str]) -> Plan:
        """Return this plan extended by the stored runs of the results folder.

        If the folder has another seed, or other versions of package, results or libraries, its
        runs cannot be used. The plan is then returned unchanged.

        Parameters
        ----------
        old : manifest of the folder.
        whole : scenario with all of its cases.
        finished : keys of all stored results.
        """
        now = result_keys.environment() | {"seed": self.seed}
        if any(old[name] != value for name, value in now.items()):
            return self
        # By the contents that the manifest states: what it names is not to be loaded.
        earlier_estimators: dict[str, Mapping[str, Any]] = {}
        names = {case.name for case in self.scenario.cases}
        for label, content in old["estimators"].items():
            earlier_cases = {
                case.name
                for case in whole.cases
                if result_keys.run_key(case, content, self.seed) in finished
            }
            names |= earlier_cases
            if earlier_cases and content not in self.estimators.values():
                earlier_estimators[label] = content
        joined_scenario = whole.select([case.name for case in whole.cases if case.name in names])
        if not (old["assumptions"] or self.scenario.assumptions):
            joined_scenario = replace(joined_scenario, assumptions=())
        # What an earlier campaign found of further cases holds as long as the source is the same.
        same = {k for k, content in self.estimators.items() if old["estimators"].get(k) == content}
        left_out = {
            k: v for k, v in old.get("left_out", {}).items() if k in earlier_estimators or k in same
        }
        for label, reasons in self.left_out.items():
            left_out[label] = left_out.get(label, {}) | dict(reasons)
        joined = replace(
            self,
            scenario=joined_scenario,
            estimators=earlier_estimators | dict(self.estimators),
            left_out=left_out,
        )
        stored = {key for _, _, pairs in joined.cells() for _, key in pairs} & finished
        return replace(joined, runs=max(old["runs"], self.runs)) if stored else joined


class PendingCell(NamedTuple):
    """A case with its estimators, and a mask (estimators, runs) of the missing runs."""

    assumption: str
    case: CaseSpec
    pairs: EstimatorKeys
    missing: np.ndarray


class Tasks:
    """Remaining tasks of a campaign, created on demand.

    A range of runs is executed in all cases before the next range, so that an interrupted campaign
    has runs of all cases. Estimators that do not process blocks have a task for each run. If each
    run has a different flight, all estimators share the tasks of a range, so that each flight is
    created once. Users' files have separate tasks after those of the installed estimators. If a
    file changes the process, no other estimator is affected.
    """

    def __init__(self, cells: Sequence[PendingCell], seed: int) -> None:
        self._seed = seed
        self.results = sum(int(cell.missing.sum()) for cell in cells)
        """Number of missing results."""
        self._groups: dict[str, tuple[list[PendingCell], list[PendingCell]]] = {"": ([], [])}
        """Cells by user file ("": installed estimators): in blocks, and run by run."""
        for cell in cells:
            for file in dict.fromkeys(own_file(label) for label, _ in cell.pairs):
                own = tuple(pair for pair in cell.pairs if own_file(pair[0]) == file)
                sides = (own, ()) if cell.case.drawn else by_block_size(own)
                group = self._groups.setdefault(file, ([], []))
                for cells_of, pairs in zip(group, sides, strict=True):
                    where = [cell.pairs.index(pair) for pair in pairs]
                    cells_of.append(cell._replace(pairs=pairs, missing=cell.missing[where]))

    def __iter__(self) -> Iterator[Task]:
        sides = itertools.chain.from_iterable(self._groups.values())
        most = max((cell.missing.shape[1] for cells in sides for cell in cells), default=0)
        for start in range(0, most, TASK_RUNS):
            stop = min(start + TASK_RUNS, most)
            for at_once, one_by_one in self._groups.values():
                for cell in at_once:
                    yield from self._blocks(cell, start, stop)
                for run in range(start, stop):
                    for cell in one_by_one:
                        yield from self._blocks(cell, run, run + 1)

    def _blocks(self, cell: PendingCell, start: int, stop: int) -> Iterator[Task]:
        """Yield tasks of a range of runs: one for each set of estimators lacking the same runs."""
        patterns: dict[bytes, list[int]] = {}
        for run in range(start, min(stop, cell.missing.shape[1])):
            if cell.missing[:, run].any():
                patterns.setdefault(cell.missing[:, run].tobytes(), []).append(run)
        for runs in patterns.values():
            lacking = cell.missing[:, runs[0]]
            pairs = tuple(pair for pair, lacks in zip(cell.pairs, lacking, strict=True) if lacks)
            yield Task(cell.case, cell.assumption, runs, self._seed, pairs)
