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
import json
import math
import os
import platform
import signal
import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from functools import lru_cache
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from . import __version__, metrics
from .errors import GGBenchError
from .field import Field
from .gradiometer import COMPONENTS
from .problem import Estimate, MeasurementModel, Problem
from .registry import Choice, choose
from .scenario import CaseSpec, Scenario
from .simulation import Flight, Truth, prepare, simulate
from .store import Store, StoreError

DETAILED_RUN = 0
"""The run whose errors and claimed deviations are kept component by component, for the figures."""

Result = tuple[dict[str, Any], np.ndarray | None, np.ndarray | None]


@dataclass(frozen=True)
class Task:
    """One run of one case with the estimators that still miss it."""

    case: CaseSpec
    assumption: str
    run: int
    seed: int
    estimators: tuple[str, ...]


class CampaignError(GGBenchError):
    """A campaign cannot be run as asked."""


class _CountingModel:
    """A measurement model that counts the points at which the map is evaluated."""

    def __init__(self, model: MeasurementModel) -> None:
        self._model = model
        self.evaluations = 0

    def predict(self, k: int, x: np.ndarray) -> np.ndarray:
        self.evaluations += math.prod(np.shape(x)[:-1])
        return self._model.predict(k, x)

    def jacobian(self, k: int, x: np.ndarray) -> np.ndarray:
        self.evaluations += 1
        return self._model.jacobian(k, x)


@lru_cache(maxsize=64)
def _flight(case_json: str) -> Flight:
    return prepare(CaseSpec.model_validate_json(case_json))


@lru_cache(maxsize=256)
def _warm_choice(label: str, case_json: str, seed: int) -> Choice:
    """Return the chosen estimator, after one run that is not timed: it compiles and imports."""
    choice = choose(label)
    problem, _ = simulate(_flight(case_json), seed, 0)
    with contextlib.suppress(Exception):  # its failure is recorded where it counts
        choice.estimator.estimate(problem, _estimator_rng(seed, 0, label))
    return choice


def _estimator_rng(seed: int, run: int, label: str) -> np.random.Generator:
    """Return the estimator's own generator: reproducible, and no key to the simulation's."""
    digest = hashlib.sha256(f"{label}|{seed}|{run}".encode()).digest()
    return np.random.default_rng(int.from_bytes(digest[:16], "little"))


def run_task(task: Task) -> list[Result]:
    """Simulate one run and judge every estimator on it; an estimator's failure is a record."""
    case_json = task.case.model_dump_json()
    flight = _flight(case_json)
    problem, truth = simulate(flight, task.seed, task.run)
    return [
        _judge(task, flight, problem, truth, _warm_choice(label, case_json, task.seed))
        for label in task.estimators
    ]


def _judge(task: Task, flight: Flight, problem: Problem, truth: Truth, choice: Choice) -> Result:
    record: dict[str, Any] = {
        "assumption": task.assumption,
        "case": task.case.name,
        "estimator": choice.label,
        "name": choice.estimator.name,
        "parameters": choice.parameters,
        "causality": choice.estimator.causality,
        "run": task.run,
        "seed": task.seed,
        "status": "failed",
    }
    model = _CountingModel(problem.model)
    given = Problem(**{**vars(problem), "model": model})
    start = time.perf_counter()
    try:
        rng = _estimator_rng(task.seed, task.run, choice.label)
        estimate = choice.estimator.estimate(given, rng)
        record["seconds"] = time.perf_counter() - start
        _require_complete(problem, estimate)
    except Exception as error:
        record["reason"] = f"{type(error).__name__}: {error}"
        return record, None, None
    evaluation = metrics.evaluate(problem, estimate, truth)
    case = task.case
    lag = lag_epochs(case, estimate.lag)
    bound, _ = metrics.squared_bounds(metrics.bound_for(flight.bound, estimate.causality, lag)[-1:])
    ins_error = float(np.linalg.norm(truth.error_state[-1, :3]))
    final_error = float(evaluation.position_error[-1])
    record |= {
        "status": "ok",
        "causality": estimate.causality,
        "lag": estimate.lag,
        "map_evaluations": model.evaluations,
        "final_position_error_m": final_error,
        "diverged": metrics.has_diverged(final_error, math.sqrt(bound[0]), ins_error),
        "windows": metrics.window_figures(evaluation, truth.times, case.windows),
        "info": json.loads(json.dumps(dict(estimate.info), default=float)),
    }
    series = np.column_stack(
        [evaluation.position_error, evaluation.velocity_error, evaluation.nees, evaluation.nis]
    )
    detail = None
    if task.run == DETAILED_RUN and not task.assumption:
        detail = np.column_stack([evaluation.components, evaluation.sigmas])
    return record, series, detail


def _require_complete(problem: Problem, estimate: Estimate) -> None:
    """Raise ValueError unless the estimate has the right shapes and only finite numbers."""
    epochs, n = problem.epochs, problem.dimension
    expected: dict[str, tuple[np.ndarray, tuple[int, ...]]] = {"mean": (estimate.mean, (epochs, n))}
    if estimate.cov is not None:
        expected["cov"] = (estimate.cov, (epochs, n, n))
    for name, (array, shape) in expected.items():
        if np.shape(array) != shape:
            raise ValueError(f"the estimate's {name} has shape {np.shape(array)}, not {shape}")
        finite = np.isfinite(array).reshape(epochs, -1).all(axis=1)
        if not finite.all():
            raise ValueError(f"the estimate's {name} is not finite from epoch {finite.argmin()} on")


def lag_epochs(case: CaseSpec, lag: float | None) -> int | None:
    """Return how many epochs after each one a fixed lag [s] sees."""
    return None if lag is None else math.floor(lag / case.gradiometer.period_s + 1e-9)


def plan(
    scenario: Scenario, labels: Sequence[str], runs: int, seed: int, assumptions: bool
) -> list[Task]:
    """Return the tasks of a campaign, run by run, so that an interrupted one has all cases."""
    tasks = []
    settings = scenario.campaign
    for run in range(runs):
        tasks += [Task(case, "", run, seed, tuple(labels)) for case in scenario.cases]
        if assumptions and run < min(runs, settings.assumption_runs):
            tasks += [
                Task(case, study.name, run, seed, (settings.assumption_estimator,))
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

    def check(self) -> None:
        """Fly every case without errors, before anything is written.

        Raises
        ------
        GGBenchError
            If a map cannot be made or a flight leaves it.
        """
        studied = self.scenario.assumptions if self.assumptions else ()
        for case in (*self.scenario.cases, *(c for study in studied for c in study.cases)):
            try:
                _flight(case.model_dump_json())
            except GGBenchError as error:
                raise CampaignError(f"{self.scenario.name}, case {case.name}: {error}") from None

    def open(self) -> Store:
        """Return the results folder, made or found again.

        Raises
        ------
        StoreError
            If the folder holds results of another campaign (and ``fresh`` is not set).
        """
        if (self.folder / "manifest.json").exists():
            if self.fresh:
                _discard(self.folder)
            else:
                self._require_same(Store(self.folder).manifest())
        elif self.folder.is_dir() and any(self.folder.iterdir()):
            raise StoreError(f"{self.folder} is not empty and holds no results; choose another -o")
        store = Store(self.folder, create=True)
        store.write_text("scenario.toml", self.scenario.source)
        store.write_json("manifest.json", self._manifest())
        return store

    def prepare_cases(self, store: Store) -> list[str]:
        """Store what each case's runs share; return why estimators must be left out, if any are.

        An estimator that cannot take a problem (``skip``) is left out of the whole campaign.
        """
        reasons: dict[str, str] = {}
        for case in self.scenario.cases:
            flight = _flight(case.model_dump_json())
            problem, _ = simulate(flight, self.seed, DETAILED_RUN)
            lags: dict[str, int | None] = {}
            for label in self.labels:
                estimator = choose(label).estimator
                reason = estimator.skip(problem)
                if reason:
                    reasons.setdefault(label, f"{label} is left out: {reason}")
                lags[label] = None
                if estimator.causality == "fixed-lag":
                    lags[label] = lag_epochs(case, vars(estimator)["lag"])
            store.write_arrays(case.name, _shared_arrays(flight, self.seed, self.labels, lags))
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
        return {
            "scenario": self.scenario.name,
            "scenario_hash": self.scenario.content_hash,
            "seed": self.seed,
            "ggbench": __version__,
            "source_hash": source_hash(self.labels, self.scenario.cases),
        }

    def _require_same(self, manifest: dict[str, Any]) -> None:
        for key, value in self._identity().items():
            if manifest.get(key) != value:
                raise StoreError(
                    f"{self.folder} holds results with another {key.replace('_', ' ')} "
                    f"({manifest.get(key)}, now {value}); choose another -o, or --fresh to discard "
                    "them"
                )

    def _manifest(self) -> dict[str, Any]:
        packages = ("numpy", "scipy", "filterpy", "gtsam", "numba", "pandas")
        return {
            **self._identity(),
            "title": self.scenario.title,
            "notes": self.scenario.notes,
            "runs": self.runs,
            "estimators": list(self.labels),
            "assumptions": self.assumptions,
            "date": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
            "versions": {
                "python": platform.python_version(),
                **{name: importlib.metadata.version(name) for name in packages},
            },
            "machine": {
                "system": platform.system(),
                "architecture": platform.machine(),
                "processors": os.cpu_count(),
            },
        }


def source_hash(labels: Iterable[str], cases: Iterable[CaseSpec]) -> str:
    """Return a hash of the package's source and of the user's own estimator and map files."""
    digest = hashlib.sha256()
    for package in ("ggbench", "ggbench.estimators"):
        folder = importlib.resources.files(package)
        for file in sorted(folder.iterdir(), key=lambda f: f.name):
            if file.name.endswith(".py"):
                digest.update(file.name.encode() + file.read_bytes())
    named = {label.partition("[")[0] for label in labels} | {case.field.source for case in cases}
    for name in sorted(named):
        if name.endswith((".py", ".npz")):
            digest.update(Path(name).read_bytes())
    return digest.hexdigest()[:16]


def _discard(folder: Path) -> None:
    """Remove the files of an earlier campaign, and nothing else."""
    names = ["manifest.json", "scenario.toml", "summary.csv", "assumptions.csv", "report.md"]
    names += [f"records.sqlite{suffix}" for suffix in ("", "-wal", "-shm")]
    for path in [*(folder / name for name in names), *folder.glob("case-*.npz")]:
        path.unlink(missing_ok=True)


def _shared_arrays(
    flight: Flight, seed: int, labels: Sequence[str], lags: dict[str, int | None]
) -> dict[str, np.ndarray]:
    """Return the bounds of a case and the signals that its figures show."""
    arrays = {"times": flight.times, "track": flight.trajectory.positions[flight.epochs]}
    bounds = {"filter": flight.bound.filtering, "batch": flight.bound.smoothing}
    for label in labels:
        lag = lags[label]
        if lag is not None:
            bounds[f"fixed-lag-{lag}"] = flight.bound.fixed_lag(lag)
    for name, cov in bounds.items():
        arrays[f"bound-{name}"] = np.stack(metrics.squared_bounds(cov), axis=-1)
    # The zz component of the first run as the instrument delivers it, with and without filter.
    rng = np.random.default_rng(np.random.SeedSequence([seed, DETAILED_RUN]).spawn(4)[3])
    vertical = COMPONENTS.index("zz")
    enu = flight.field.tensor(*arrays["track"].T)
    noise = flight.gradiometer.noise_eotvos * rng.standard_normal(flight.noise_free.shape)
    arrays["vertical"] = enu[:, vertical]
    arrays["noisy"] = arrays["vertical"] + noise[:, vertical]
    if flight.gradiometer.lowpass is not None:
        arrays["filtered"] = flight.gradiometer.lowpass.apply(arrays["noisy"])
        arrays["filtered_true"] = flight.gradiometer.lowpass.apply(arrays["vertical"])
    if flight.field.has_map:
        lower, upper = flight.field.origin, flight.field.upper
        latitude = np.linspace(lower[0], upper[0], 101)
        longitude = np.linspace(lower[1], upper[1], 161)
        height = np.mean(arrays["track"][:, 2])
        full = flight.field.tensor(latitude[:, None], longitude[None, :], height)
        normal = Field.normal().tensor(latitude[:, None], longitude[None, :], height)
        arrays |= {
            "map_latitude": latitude,
            "map_longitude": longitude,
            "map_vertical": full[..., vertical] - normal[..., vertical],
        }
    return arrays


def _start_worker() -> None:
    # The parent decides what an interrupt means; a worker finishes its task.
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def execute(
    tasks: Sequence[Task], store: Store, jobs: int, progress: Callable[[int, int], None]
) -> None:
    """Run tasks in ``jobs`` processes (1: in this one) and store results as they arrive.

    ``progress(done, of)`` is called after each task. KeyboardInterrupt passes through after the
    tasks in flight have been stored.

    Raises
    ------
    CampaignError
        If a worker process dies.
    """
    progress(0, len(tasks))
    if jobs == 1:
        for done, task in enumerate(tasks, 1):
            store.add(run_task(task))
            progress(done, len(tasks))
        return
    # Spawned, not forked: the parent has threads and compiled code.
    pool = ProcessPoolExecutor(jobs, get_context("spawn"), initializer=_start_worker)
    waiting: set[Future[list[Result]]] = set()
    queue = iter(tasks)
    done = 0
    try:
        while True:
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
    labels = store.manifest()["estimators"]
    lags = {(r["case"], r["estimator"]): r.get("lag") for r in records if r["status"] == "ok"}
    causalities = {r["estimator"]: r["causality"] for r in records}
    bounds: dict[tuple[str, str], dict[str, tuple[float, float]]] = {}
    for case in scenario.cases:
        arrays = store.arrays(case.name)
        for label in labels:
            lag = lag_epochs(case, lags.get((case.name, label)))
            squared = arrays[bound_key(causalities.get(label, "filter"), lag)]
            bounds[case.name, label] = {}
            for window in metrics.WINDOWS:
                mask = metrics.window_mask(arrays["times"], case.windows, window)
                position, velocity = np.sqrt(squared[mask].mean(axis=0))
                bounds[case.name, label][window] = (float(position), float(velocity))
    summary = metrics.summarize(records, bounds, references, scenario.name)
    store.write_text("summary.csv", summary[list(metrics.SUMMARY_COLUMNS)].to_csv(index=False))
    studies = []
    for study in scenario.assumptions:
        frame = metrics.summarize(store.records(study.name), {}, references, scenario.name)
        if len(frame):
            studies.append(frame.assign(assumption=study.name))
    study_frame = pd.concat(studies, ignore_index=True) if studies else pd.DataFrame()
    if len(study_frame):
        store.write_text("assumptions.csv", study_frame.to_csv(index=False))
    return summary, study_frame


def bound_key(causality: str, lag: int | None) -> str:
    """Return the name of the stored bound that goes with a causality."""
    if causality == "batch":
        return "bound-batch"
    return "bound-filter" if lag is None else f"bound-fixed-lag-{lag}"
