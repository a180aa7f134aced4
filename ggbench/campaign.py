"""Many runs: what they are, which of them are stored already, and running the others.

A task is one run of one case, simulated once and given to every estimator, so that differences
between estimators are paired. Results are stored as they arrive, under keys of their content
(:mod:`ggbench.keys`); what a folder already holds is not run again.
"""

from __future__ import annotations

import contextlib
import datetime
import os
import platform
from collections.abc import Callable, Generator, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from . import keys
from .errors import GGBenchError
from .registry import EstimatorError, choose
from .runner import DETAILED_RUN, Task, flight_of, lag_epochs, shared_arrays
from .scenario import Scenario
from .schema import CaseSpec
from .simulation import simulate
from .store import FORMAT, Result, Store, StoreError, is_ours, read_manifest


class CampaignError(GGBenchError):
    """A campaign cannot be run as asked."""


def check(scenario: Scenario, assumptions: bool) -> None:
    """Fly every case (and every assumption's) without errors, before anything is written.

    Raises
    ------
    CampaignError
        If a map cannot be made, a flight leaves it, or a filter cannot be computed.
    """
    for study, case in _cases(scenario, assumptions):
        try:
            simulate(flight_of(case), seed=0, run=0)
        except GGBenchError as error:
            prefix = f"assumption {study}, " if study else ""
            raise CampaignError(f"{scenario.name}, {prefix}case {case.name}: {error}") from None


def _cases(scenario: Scenario, assumptions: bool) -> Iterator[tuple[str, CaseSpec]]:
    """Yield every case with the name of the study it belongs to, "" for the cases themselves."""
    for case in scenario.cases:
        yield "", case
    for study in scenario.assumptions if assumptions else ():
        for case in study.cases:
            yield study.name, case


@dataclass
class Campaign:
    """A campaign on a results folder.

    Parameters
    ----------
    scenario : the whole scenario.
    argument : the text by which the user named it.
    labels : estimators as chosen, ``ukf[points=merwe]``.
    runs, seed : number of runs per case, and the seed from which all randomness comes.
    assumptions : also study the scenario's assumptions.
    folder : where results go.
    cases : names of the cases to run; none: all.
    limit : longest time of one run of one estimator [s].
    fresh : discard what the folder holds of an earlier campaign.
    """

    scenario: Scenario
    argument: str
    labels: tuple[str, ...]
    runs: int
    seed: int
    assumptions: bool
    folder: Path
    cases: tuple[str, ...] = ()
    limit: float = 600.0
    fresh: bool = False

    def open(self) -> tuple[Store, list[str]]:
        """Return the results folder, made or found again, and remarks for the user.

        Raises
        ------
        StoreError
            If the folder holds something else, or results of another scenario.
        CampaignError
            If no estimator can take the scenario.
        """
        self._require_folder()
        remarks = self._leave_out()
        store = Store(self.folder, create=True, fresh=self.fresh)
        whole = self
        if (self.folder / "manifest.json").exists():
            whole = self._joined(store)
        manifest = whole._manifest()
        whole._share(store)
        store.write_manifest(manifest)
        used = {cell["key"] for cell in manifest["cells"]}
        unused = sum(key not in used for key, _ in store.finished())
        if unused:
            remarks.append(
                f"{self.folder} holds {unused} results of other content (seed, scenario, source, "
                "versions): they are kept and not used; --fresh discards them"
            )
        return store, remarks

    def tasks(self, store: Store) -> list[Task]:
        """Return the tasks whose results are not stored yet.

        Run by run, so that an interrupted campaign has runs of all cases.
        """
        finished = store.finished(self.limit)
        cells = self._cells()
        tasks = []
        for run in range(self.runs):
            for study, case, estimators in cells:
                if study and run >= self.scenario.campaign.assumption_runs:
                    continue
                missing = tuple(pair for pair in estimators if (pair[1], run) not in finished)
                if missing:
                    tasks.append(Task(case, study, run, self.seed, missing))
        return tasks

    def check(self) -> None:
        """Fly everything that is to be flown without errors (:func:`check`)."""
        check(self._selected, self.assumptions)

    @property
    def _selected(self) -> Scenario:
        return self.scenario.select(self.cases) if self.cases else self.scenario

    def _cells(self) -> list[tuple[str, CaseSpec, tuple[tuple[str, str], ...]]]:
        """Return every study and case with its estimators and the keys of their runs."""
        choices = [choose(label) for label in self.labels]
        studied = [choose(self.scenario.campaign.assumption_estimator)]
        return [
            (
                study,
                case,
                tuple(
                    (choice.label, keys.run_key(case, choice, self.seed))
                    for choice in (studied if study else choices)
                ),
            )
            for study, case in _cases(self._selected, self.assumptions)
        ]

    def _require_folder(self) -> None:
        """Raise StoreError if the folder holds something that is not ours, or not to be joined."""
        if self.folder.is_dir():
            names = [path.name for path in self.folder.iterdir()]
            if names and not any(map(is_ours, names)):
                raise StoreError(
                    f"{self.folder} is not empty and holds no results; choose another -o"
                )
        if (self.folder / "manifest.json").exists() and not self.fresh:
            held = read_manifest(self.folder)["scenario"]
            if held != self.scenario.name:
                raise StoreError(
                    f"{self.folder} holds results of the scenario {held}, not of "
                    f"{self.scenario.name}; choose another -o, or --fresh to discard them"
                )

    def _leave_out(self) -> list[str]:
        """Leave estimators out that cannot take a problem (``skip``); return why."""
        reasons: dict[str, str] = {}
        for case in self._selected.cases:
            problem, _ = simulate(flight_of(case), self.seed, DETAILED_RUN)
            for label in self.labels:
                try:
                    reason = choose(label).estimator.skip(problem)
                except Exception as error:
                    reason = f"its skip raises {type(error).__name__}: {error}"
                if reason:
                    reasons.setdefault(label, f"{label} is left out: {reason}")
        self.labels = tuple(label for label in self.labels if label not in reasons)
        if not self.labels:
            raise CampaignError(
                "no estimator can take this scenario: " + "; ".join(reasons.values())
            )
        return list(reasons.values())

    def _joined(self, store: Store) -> Campaign:
        """Return this campaign together with what its folder holds of the same content."""
        old = read_manifest(self.folder)
        now = keys.environment() | {"seed": self.seed}
        if any(old[name] != value for name, value in now.items()):
            return self
        known = [case.name for case in self.scenario.cases]
        cases = {*old["cases"], *(self.cases or known)}
        finished = {key for key, _ in store.finished()}
        labels = []
        for label in [*old["estimators"], *self.labels]:
            with contextlib.suppress(EstimatorError):  # its file may be gone
                choice = choose(label)
                held = {keys.run_key(case, choice, self.seed) for case in self.scenario.cases}
                if choice.label not in labels and (choice.label in self.labels or held & finished):
                    labels.append(choice.label)
        return replace(
            self,
            labels=tuple(labels),
            runs=max(old["runs"], self.runs),
            assumptions=old["assumptions"] or self.assumptions,
            cases=tuple(name for name in known if name in cases),
        )

    def _manifest(self) -> dict[str, Any]:
        cases = self._selected.cases
        return {
            "format": FORMAT,
            **keys.environment(),
            "scenario": self.scenario.name,
            "scenario_hash": self.scenario.content_hash,
            "scenario_text": self.scenario.source,
            "argument": self.argument,
            "title": self.scenario.title,
            "notes": self.scenario.notes,
            "seed": self.seed,
            "runs": self.runs,
            "estimators": {label: choose(label).content for label in self.labels},
            "cases": [case.name for case in cases],
            "assumptions": self.assumptions,
            "cells": [
                {
                    "assumption": study,
                    "case": case.name,
                    "case_hash": case.content_hash,
                    "estimator": label,
                    "key": key,
                }
                for study, case, estimators in self._cells()
                for label, key in estimators
            ],
            "shared": {case.name: keys.case_key(case, self.seed) for case in cases},
            "date": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
            "machine": {
                "system": platform.system(),
                "architecture": platform.machine(),
                "processors": os.cpu_count(),
            },
        }

    def _share(self, store: Store) -> None:
        """Store what each case's runs share, unless it is stored: bounds, signals for figures."""
        lagged = [
            estimator
            for label in self.labels
            if (estimator := choose(label).estimator).causality == "fixed-lag"
        ]
        for case in self._selected.cases:
            key = keys.case_key(case, self.seed)
            lags = {lag_epochs(case, vars(estimator)["lag"]) for estimator in lagged}
            if store.has_arrays(key):
                held = store.arrays(key, case.name)
                missing = {lag for lag in lags if f"bound-fixed-lag-{lag}" not in held}
                if not missing:
                    continue
                prefix = "bound-fixed-lag-"
                lags |= {int(n.removeprefix(prefix)) for n in held if n.startswith(prefix)}
            store.write_arrays(key, shared_arrays(flight_of(case), self.seed, sorted(lags)))


def execute(
    results: Generator[list[Result]], store: Store, progress: Callable[[list[Result]], None]
) -> None:
    """Store the results of an engine as they come, and tell ``progress`` of them.

    However it ends, the engine is closed: nothing runs on.
    """
    with contextlib.closing(results):
        for batch in results:
            store.add(batch)
            progress(batch)
