"""Campaigns: requested runs of a scenario in a results folder.

Each result is stored at once, under a hash of its inputs (:mod:`ggbench.campaign.result_keys`). A
run with a stored result is not repeated.
"""

from __future__ import annotations

import contextlib
import datetime
import math
import os
import platform
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import GGBenchError
from ..figures.numbers import some
from ..problem import Problem
from ..results.database import StoreError
from ..results.store import FORMAT, Store, read_manifest, require_ours
from ..spec.case import CaseSpec
from ..spec.limits import MOST_RUNS, MOST_SEED
from ..spec.scenario import Scenario
from ..spec.unusual_values import unusual_values
from . import result_keys
from .flights import first_problem, flight_of
from .plan import PendingCell, Plan, Tasks
from .records import lag_epochs, shared_arrays
from .registry import choose, choose_all
from .texts import refusal

_NAMED_CASES = 3


class CampaignError(GGBenchError):
    """A campaign cannot be run with the given arguments."""


def check(scenario: Scenario, seed: int = 0) -> Iterator[tuple[str, CaseSpec, Problem]]:
    """Yield (study, case, problem of run 0) for all cases of a scenario.

    Assumptions of the scenario have cases, too. The study of such a case is the name of the
    assumption; the study of other cases is "".

    Raise CampaignError if a map cannot be made, a flight leaves the map, or an instrument's filter
    cannot be computed.
    """
    for study, case in scenario.every_case():
        with case_named(scenario, study, case):
            problem = first_problem(case, seed)
        yield study, case, problem


@contextlib.contextmanager
def case_named(scenario: Scenario, study: str, case: CaseSpec) -> Iterator[None]:
    """Raise CampaignError that names the case, for a user error in the ``with`` block."""
    try:
        yield
    except GGBenchError as error:
        prefix = f"assumption {study}, " if study else ""
        raise CampaignError(f"{scenario.name}, {prefix}case {case.name}: {error}") from None


@dataclass
class Campaign:
    """A campaign that stores its results in a folder.

    Parameters
    ----------
    scenario : scenario with all of its cases.
    argument : name or path of the scenario, as the user wrote it.
    labels : texts of the chosen estimators, for example ``ukf[points=merwe]``.
    runs, seed : number of runs per case, and the seed of all random numbers.
    assumptions : whether to run the cases in the scenario's assumption tables too.
    folder : results folder.
    cases : names of the cases to run; ``()``: all.
    limit : time limit of one run of one estimator [s].
    fresh : whether to discard the results of an earlier campaign in the folder.
    retry_failed : whether to repeat failed runs; the new result replaces the failure.
    plan : attribute, not a parameter: planned runs, computed from the parameters.
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
    retry_failed: bool = False
    plan: Plan = field(init=False)

    def __post_init__(self) -> None:
        for name, value, least, most in (
            ("runs", self.runs, 1, MOST_RUNS),
            ("seed", self.seed, 0, MOST_SEED),
        ):
            if not least <= value <= most:
                raise CampaignError(f"{name} is {value} and must be from {least} to {most}")
        # Once: a file that is edited later changes nothing of what is run and how it is stored.
        scenario = self.scenario.select(self.cases) if self.cases else self.scenario
        choices = {label: choose(label) for label in self.labels}
        contents = {label: choice.content for label, choice in choices.items()}
        self.families: dict[str, str] = {k: choice.family for k, choice in choices.items()}
        studied = choose(self.scenario.campaign.assumption_estimator)
        label = next((k for k, v in contents.items() if v == studied.content), studied.label)
        self.plan = Plan(
            scenario if self.assumptions else replace(scenario, assumptions=()),
            contents,
            {label: studied.content},
            self.runs,
            self.seed,
        )

    def open(self) -> tuple[Store, list[str]]:
        """Open or create the results folder; return it and remarks for the user.

        Raise StoreError if the folder contains other files, or results of another scenario. Raise
        CampaignError if a case cannot be flown, or no estimator can process the scenario.
        """
        self._require_folder()
        left_out = self._leave_out()
        remarks = [*unusual_values(self.plan.scenario), *left_out, *self._seeking()]
        store = Store(self.folder, create=True, fresh=self.fresh)
        try:
            return store, [*remarks, *self._joined_to(store)]
        except BaseException:
            store.close()  # or the folder would be locked as long as this process lives
            raise

    def _joined_to(self, store: Store) -> list[str]:
        """Write the manifest of this campaign and of earlier runs in its folder; return remarks."""
        # Again: another campaign may have finished here before the folder was locked.
        self._require_folder()
        plan = self.plan
        if (self.folder / "manifest.json").exists():
            finished, manifest_before = store.finished().keys(), read_manifest(self.folder)
            self.families = manifest_before["families"] | self.families
            plan = plan.joined(manifest_before, self.scenario, finished)
        self._share(store, plan)
        manifest = self._manifest(plan)
        store.write_manifest(manifest)
        used_keys = {cell["key"] for cell in manifest["cells"]}
        unused = sum(len(runs) for key, runs in store.finished().items() if key not in used_keys)
        if not unused:
            return []
        return [
            f"{self.folder} contains {unused} results of another seed, source, version, case or "
            "estimator: they are kept but not used; --fresh discards them"
        ]

    def tasks(self, store: Store) -> Tasks:
        """Return the tasks of all runs without a final result.

        A failure is not final if ``retry_failed`` is true, or if the run failed under a time
        limit that is lower than ``limit``.
        """
        return self._tasks(store.finished(self.limit, self.retry_failed))

    def missing(self, store: Store) -> int:
        """Return the number of requested runs with neither a result nor a recorded failure."""
        return self._tasks(store.finished(-math.inf)).results

    def _tasks(self, finished: Mapping[str, np.ndarray]) -> Tasks:
        cells = []
        distinct_keys: set[str] = set()
        for study, case, estimators in self.plan.cells():
            # Two names of one content are run once.
            pairs = tuple(pair for pair in estimators if pair[1] not in distinct_keys)
            distinct_keys.update(key for _, key in pairs)
            runs = self.scenario.campaign.runs_of(study, self.runs)
            missing = np.ones((len(pairs), runs), dtype=bool)
            for row, (_, key) in zip(missing, pairs, strict=True):
                finished_runs = finished.get(key, np.empty(0, dtype=np.int64))
                row[finished_runs[finished_runs < runs]] = False
            cells.append(PendingCell(study, case, pairs, missing))
        return Tasks(cells, self.seed)

    def _require_folder(self) -> None:
        """Raise StoreError if the results folder cannot be used for this campaign.

        The folder must not contain other files, the user's scenario file, or results of another
        scenario.
        """
        require_ours(self.folder)
        if Path(self.argument).absolute() == (self.folder / "scenario.toml").absolute():
            raise StoreError(
                f"{self.folder} is the folder of the scenario, whose file would be overwritten; "
                "choose another output folder"
            )
        if (self.folder / "manifest.json").exists() and not self.fresh:
            stored_name = read_manifest(self.folder)["scenario"]
            if stored_name != self.scenario.name:
                raise StoreError(
                    f"{self.folder} contains results of the scenario {stored_name}, not of "
                    f"{self.scenario.name}; choose another output folder, or discard them "
                    "(--fresh)"
                )

    def _leave_out(self) -> list[str]:
        """Leave each estimator out of the cases that it refuses (``skip``); return remarks.

        An estimator that refuses all cases is removed from the plan. Raise CampaignError if no
        estimator remains.
        """
        left_out: dict[str, dict[str, str]] = {}
        estimators = {label: choose(label).estimator for label in self.labels}
        for study, case, problem in check(self.plan.scenario, self.seed):
            for label, estimator in estimators.items() if not study else ():
                if reason := refusal(estimator, problem):
                    left_out.setdefault(label, {})[case.name] = reason
        cases = [case.name for case in self.plan.scenario.cases]
        remarks = left_out_remarks(left_out, cases)
        remaining = {
            label: content
            for label, content in self.plan.estimators.items()
            if len(left_out.get(label, ())) < len(cases)
        }
        self.plan = replace(self.plan, estimators=remaining, left_out=left_out)
        if not remaining:
            raise CampaignError("all estimators refuse this scenario: " + "; ".join(remarks))
        return remarks

    def _seeking(self) -> list[str]:
        """Return remarks on estimators whose source has names that give access to the truth."""
        return [
            (
                f"{label} uses {', '.join(content['seeks'])}, which give access to the truth; the "
                "report contains this warning"
            )
            for label, content in self.plan.estimators.items()
            if "seeks" in content
        ]

    def _share(self, store: Store, plan: Plan) -> None:
        """Store the arrays that all runs of a case share, unless they are already stored.

        The arrays contain bounds, and signals for figures.
        """
        # Of those asked for now: what others needed has been stored when they were.
        estimators = [choose(label).estimator for label in self.plan.estimators]
        lagged = [vars(e)["lag"] for e in estimators if e.causality == "fixed-lag"]
        for case in plan.scenario.cases:
            key = result_keys.case_key(case, self.seed)
            lags = {lag_epochs(case, lag) for lag in lagged}
            if store.has_arrays(key):
                prefix = "bound-fixed-lag-"
                names = [n for n in store.arrays(key, case.name) if n.startswith(prefix)]
                stored_lags = {int(name.removeprefix(prefix)) for name in names}
                if lags <= stored_lags:
                    continue
                lags |= stored_lags
            store.write_arrays(key, shared_arrays(flight_of(case), self.seed, sorted(lags)))

    def _manifest(self, plan: Plan) -> dict[str, Any]:
        return {
            "format": FORMAT,
            **result_keys.environment(),
            "scenario": self.scenario.name,
            "scenario_hash": self.scenario.content_hash,
            "scenario_text": self.scenario.source,
            "argument": self.argument,
            "title": self.scenario.title,
            "notes": self.scenario.notes,
            "seed": self.seed,
            "runs": plan.runs,
            "estimators": dict(plan.estimators),
            "families": {label: self.families[label] for label in plan.estimators},
            "left_out": {label: dict(of) for label, of in plan.left_out.items()},
            "cases": [case.name for case in plan.scenario.cases],
            "assumptions": bool(plan.scenario.assumptions),
            "cells": [
                {
                    "assumption": study,
                    "case": case.name,
                    "problem": result_keys.problem_key(case, plan.seed),
                    "estimator": label,
                    "key": key,
                }
                for study, case, estimators in plan.cells()
                for label, key in estimators
            ],
            "shared": {
                case.name: result_keys.case_key(case, self.seed) for case in plan.scenario.cases
            },
            "inputs": result_keys.input_files(case for _, case in plan.scenario.every_case()),
            "date": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
            "machine": {
                "system": platform.system(),
                "architecture": platform.machine(),
                "processors": os.cpu_count(),
            },
        }


def left_out_remarks(left_out: Mapping[str, Mapping[str, str]], cases: Sequence[str]) -> list[str]:
    """Return remarks on estimators left out of cases, one for each estimator and reason.

    Parameters
    ----------
    left_out : reason by label and case, ``{label: {case: reason}}``.
    cases : names of all cases of the campaign.
    """
    remarks = []
    for label, reasons in left_out.items():
        for reason in dict.fromkeys(reasons.values()):
            of = [case for case in cases if reasons.get(case) == reason]
            where = "" if len(of) == len(cases) else f" of {some(of, most=_NAMED_CASES)}"
            if of:
                remarks.append(f"{label} is left out{where}: {reason}")
    return remarks


def planned(
    scenario: Scenario,
    folder: Path,
    estimators: Sequence[str] = (),
    runs: int | None = None,
    seed: int | None = None,
    cases: Sequence[str] = (),
    assumptions: bool = False,
    time_limit: float | None = None,
    fresh: bool = False,
    retry_failed: bool = False,
) -> Campaign:
    """Return a campaign that stores its results in ``folder``.

    If ``estimators``, ``runs``, ``seed`` or ``time_limit`` are omitted, the scenario supplies them.
    Raise EstimatorError or ScenarioError if an estimator or a case does not exist.
    """
    settings = scenario.campaign
    texts = [*(estimators or settings.estimators)]
    if assumptions:  # its runs without the change are what the study is compared with
        texts.append(settings.assumption_estimator)
    return Campaign(
        scenario=scenario,
        argument=scenario.argument or scenario.name,
        labels=tuple(choice.label for choice in choose_all(texts)),
        runs=settings.runs if runs is None else runs,
        seed=settings.seed if seed is None else seed,
        assumptions=assumptions,
        folder=folder,
        cases=tuple(cases),
        limit=settings.time_limit_s if time_limit is None else time_limit,
        fresh=fresh,
        retry_failed=retry_failed,
    )
