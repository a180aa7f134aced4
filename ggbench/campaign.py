"""Many runs: tasks, worker processes, storage, summary.

A task is one run of one case, simulated once and given to every estimator, so that differences
between estimators are paired. Results are stored as they arrive; what a folder already holds of
the same campaign is not run again.
"""

from __future__ import annotations

import contextlib
import datetime
import hashlib
import importlib.metadata
import importlib.resources
import itertools
import os
import platform
import signal
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from . import __version__, metrics
from .errors import GGBenchError
from .registry import choose
from .runner import DETAILED_RUN, Result, Task, flight_of, lag_epochs, run_task, shared_arrays
from .scenario import Scenario
from .simulation import simulate
from .store import FORMAT, RESULT_FILES, Store, StoreError

_PACKAGES = ("numpy", "scipy", "filterpy", "gtsam", "numba")
"""Packages whose version may change a result."""


class CampaignError(GGBenchError):
    """A campaign cannot be run as asked."""


def check(scenario: Scenario, assumptions: bool) -> None:
    """Fly every case (and every assumption's) without errors, before anything is written.

    Raises
    ------
    CampaignError
        If a map cannot be made, a flight leaves it, or a filter cannot be computed.
    """
    studies = scenario.assumptions if assumptions else ()
    named = [("", case) for case in scenario.cases]
    named += [(f"assumption {study.name}, ", case) for study in studies for case in study.cases]
    for prefix, case in named:
        try:
            simulate(flight_of(case), seed=0, run=0)
        except GGBenchError as error:
            raise CampaignError(f"{scenario.name}, {prefix}case {case.name}: {error}") from None


def plan(
    scenario: Scenario, labels: Sequence[str], runs: int, seed: int, assumptions: bool
) -> list[Task]:
    """Return the tasks of a campaign, run by run, so that an interrupted one has all cases."""
    tasks = []
    settings = scenario.campaign
    studied = (choose(settings.assumption_estimator).label,)
    for run in range(runs):
        tasks += [Task(case, "", run, seed, tuple(labels)) for case in scenario.cases]
        if assumptions and run < min(runs, settings.assumption_runs):
            tasks += [
                Task(case, study.name, run, seed, studied)
                for study in scenario.assumptions
                for case in study.cases
            ]
    return tasks


@dataclass
class Campaign:
    """A campaign on a results folder.

    Parameters
    ----------
    scenario : the scenario.
    labels : estimators as chosen, ``ukf[points=merwe]``.
    runs, seed : number of runs per case, and the seed from which all randomness comes.
    assumptions : also study the scenario's assumptions.
    folder : where results go.
    fresh : discard what the folder holds of an earlier campaign.
    """

    scenario: Scenario
    labels: tuple[str, ...]
    runs: int
    seed: int
    assumptions: bool
    folder: Path
    fresh: bool = False

    def open(self) -> Store:
        """Return the results folder, made or found again.

        Raises
        ------
        StoreError
            If the folder holds results of another campaign (and ``fresh`` is not set).
        """
        manifest = self._manifest()
        if (self.folder / "manifest.json").exists():
            if self.fresh:
                _discard(self.folder)
            else:
                manifest = self._joined(manifest)
        elif self.fresh and any((self.folder / name).exists() for name in RESULT_FILES):
            _discard(self.folder)
        elif self.folder.is_dir() and any(self.folder.iterdir()):
            raise StoreError(
                f"{self.folder} is not empty and holds no results; choose another -o, or --fresh "
                "if they are what is left of results"
            )
        store = Store(self.folder, create=True)
        store.write_text("scenario.toml", self.scenario.source)
        store.write_json("manifest.json", manifest)
        return store

    def prepare_cases(self, store: Store) -> list[str]:
        """Store what each case's runs share; return why estimators must be left out, if any are.

        An estimator that cannot take a problem (``skip``) is left out of the whole campaign.
        """
        reasons: dict[str, str] = {}
        for case in self.scenario.cases:
            flight = flight_of(case)
            problem, _ = simulate(flight, self.seed, DETAILED_RUN)
            lags: set[int] = set()
            for label in self.labels:
                estimator = choose(label).estimator
                try:
                    reason = estimator.skip(problem)
                except Exception as error:
                    reason = f"its skip raises {type(error).__name__}: {error}"
                if reason:
                    reasons.setdefault(label, f"{label} is left out: {reason}")
                elif estimator.causality == "fixed-lag":
                    lags.add(lag_epochs(case, vars(estimator)["lag"]))
            lags |= store.stored_lags(case.name)
            store.write_arrays(case.name, shared_arrays(flight, self.seed, sorted(lags)))
        self.labels = tuple(label for label in self.labels if label not in reasons)
        if not self.labels:
            raise CampaignError(
                "no estimator can take this scenario: " + "; ".join(reasons.values())
            )
        return list(reasons.values())

    def tasks(self, store: Store) -> list[Task]:
        """Return the tasks whose results are not stored yet."""
        finished = store.finished()
        open_tasks = []
        for task in plan(self.scenario, self.labels, self.runs, self.seed, self.assumptions):
            missing = tuple(
                label
                for label in task.estimators
                if (task.assumption, task.case.name, label, task.run) not in finished
            )
            if missing:
                open_tasks.append(Task(task.case, task.assumption, task.run, task.seed, missing))
        return open_tasks

    def _identity(self) -> dict[str, Any]:
        """Return what must agree for results to belong to one campaign."""
        maps = {case.field.source for case in self.scenario.cases}
        return {
            "scenario": self.scenario.name,
            "scenario_hash": self.scenario.content_hash,
            "seed": self.seed,
            "ggbench": __version__,
            "source_hash": source_hash(),
            "map_files": _file_hashes(name for name in maps if name.endswith(".npz")),
            "versions": {
                "python": platform.python_version(),
                **{name: importlib.metadata.version(name) for name in _PACKAGES},
            },
        }

    def _joined(self, manifest: dict[str, Any]) -> dict[str, Any]:
        """Return the manifest of this campaign together with what its folder already holds."""
        old = Store(self.folder).manifest()
        files = manifest["estimator_files"]
        same = {name: files.get(name, digest) for name, digest in old["estimator_files"].items()}
        for key, value in {**self._identity(), "estimator_files": same}.items():
            if old.get(key) != value:
                raise StoreError(
                    f"{self.folder} holds results with another {key.replace('_', ' ')} "
                    f"({old.get(key)}, now {value}); choose another -o, or --fresh to discard them"
                )
        return manifest | {
            "runs": max(old["runs"], self.runs),
            "estimators": list(dict.fromkeys([*old["estimators"], *self.labels])),
            "estimator_files": old["estimator_files"] | files,
            "assumptions": old["assumptions"] or self.assumptions,
        }

    def _manifest(self) -> dict[str, Any]:
        return {
            "format": FORMAT,
            **self._identity(),
            "title": self.scenario.title,
            "notes": self.scenario.notes,
            "runs": self.runs,
            "estimators": list(self.labels),
            "estimator_files": _file_hashes(
                name for label in self.labels if (name := label.partition("[")[0]).endswith(".py")
            ),
            "assumptions": self.assumptions,
            "date": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
            "machine": {
                "system": platform.system(),
                "architecture": platform.machine(),
                "processors": os.cpu_count(),
            },
        }


def source_hash() -> str:
    """Return a hash of the package's source."""
    digest = hashlib.sha256()
    for package in ("ggbench", "ggbench.estimators"):
        folder = importlib.resources.files(package)
        for file in sorted(folder.iterdir(), key=lambda f: f.name):
            if file.name.endswith(".py"):
                digest.update(file.name.encode() + file.read_bytes())
    return digest.hexdigest()[:16]


def _file_hashes(names: Iterable[str]) -> dict[str, str]:
    """Return a hash of each of the user's own files, by its name."""
    return {n: hashlib.sha256(Path(n).read_bytes()).hexdigest()[:16] for n in sorted(set(names))}


def _discard(folder: Path) -> None:
    """Remove the files of an earlier campaign, and nothing else."""
    for path in [*(folder / name for name in RESULT_FILES), *folder.glob("case-*.npz")]:
        path.unlink(missing_ok=True)


@contextlib.contextmanager
def _interrupts_held() -> Iterator[None]:
    """Hold Ctrl-C back; processes started meanwhile never receive it.

    The parent decides what an interrupt means; a worker finishes its task.
    """
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def execute(
    tasks: Sequence[Task], store: Store, jobs: int, progress: Callable[[int, int], None]
) -> None:
    """Run tasks in ``jobs`` worker processes (0: in this one) and store results as they arrive.

    ``progress(done, of)`` is called after each task. KeyboardInterrupt passes through after the
    tasks in flight have been stored.

    Raises
    ------
    CampaignError
        If a worker process dies.
    """
    progress(0, len(tasks))
    if jobs == 0:
        for done, task in enumerate(tasks, 1):
            store.add(run_task(task))
            progress(done, len(tasks))
        return
    # Spawned, not forked: the parent has threads and compiled code.
    pool = ProcessPoolExecutor(jobs, get_context("spawn"))
    waiting: set[Future[list[Result]]] = set()
    queue = iter(tasks)
    done = 0
    try:
        while True:
            with _interrupts_held():  # submitting starts the processes
                for task in itertools.islice(queue, 3 * jobs - len(waiting)):
                    waiting.add(pool.submit(run_task, task))
            if not waiting:
                break
            ready, waiting = wait(waiting, return_when=FIRST_COMPLETED)
            for future in ready:
                store.add(future.result())
                done += 1
                progress(done, len(tasks))
    except KeyboardInterrupt:
        for future in waiting:
            future.cancel()
        for future in waiting:
            if not future.cancelled() and future.exception() is None:
                store.add(future.result())
        raise
    except BrokenProcessPool:
        raise CampaignError(
            f"a worker process died (out of memory, or killed); the {done} tasks that finished are "
            f"in {store.folder}, and the same command goes on from there"
        ) from None
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def summarize(store: Store, scenario: Scenario) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Write ``summary.csv`` (and ``assumptions.csv``) from the records; return both tables."""
    references = {
        case.name: (case.reference.position_mrse_m, case.reference.velocity_mrse_mps)
        if case.reference
        else None
        for case in scenario.cases
    }
    records = list(store.records())
    # Rows in the order in which the cases and estimators were asked for.
    bounds: dict[tuple[str, str], dict[str, tuple[float, float]]] = {
        (case.name, label): {}
        for case in scenario.cases
        for label in store.manifest()["estimators"]
    }
    names = {(r["case"], r["estimator"]): r["bound"] for r in records if r["status"] == "ok"}
    for (case_name, label), name in names.items():
        case, arrays = scenario.case(case_name), store.arrays(case_name)
        for window in metrics.WINDOWS:
            mask = metrics.window_mask(arrays["times"], case.windows, window)
            position, velocity = np.sqrt(arrays[f"bound-{name}"][mask].mean(axis=0))
            bounds[case_name, label][window] = (float(position), float(velocity))
    summary = metrics.summarize(records, bounds, references, scenario.name)
    store.write_text("summary.csv", summary[list(metrics.SUMMARY_COLUMNS)].to_csv(index=False))
    return summary, _summarize_studies(store, scenario, records, references)


def _summarize_studies(
    store: Store,
    scenario: Scenario,
    records: list[dict[str, Any]],
    references: Mapping[str, tuple[float, float] | None],
) -> pd.DataFrame:
    """Write ``assumptions.csv``: each assumption's rows, and as ``""`` the same runs without it."""
    groups = {study.name: list(store.records(study.name)) for study in scenario.assumptions}
    runs = {record["run"] for group in groups.values() for record in group}
    if not runs:
        return pd.DataFrame()
    estimator = choose(scenario.campaign.assumption_estimator).label
    groups[""] = [r for r in records if r["run"] in runs and r["estimator"] == estimator]
    frames = [
        metrics.summarize(group, {}, references, scenario.name).assign(assumption=name)
        for name, group in groups.items()
        if group
    ]
    studies = pd.concat(frames, ignore_index=True)
    store.write_text("assumptions.csv", studies.to_csv(index=False))
    return studies
