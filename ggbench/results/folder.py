"""What a results folder holds, read back: records, tables of them, and files for other tools.

Only what the folder itself holds is read: no estimator is loaded and nothing is simulated.
"""

from __future__ import annotations

import importlib.util
import io
import itertools
import shlex
from collections.abc import Collection, Iterator
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from ..errors import GGBenchError
from ..judging import convergence, fix_metrics
from ..judging.summary import (
    SUMMARY_COLUMNS,
    WINDOWS,
    paired_table,
    runs_table,
    summarize,
    window_mask,
)
from ..spec import scenario
from ..spec.scenario import Scenario
from .store import Store, StoreError, read_manifest

RUN_COLUMNS = (
    "assumption", "case", "problem", "estimator", "name", "parameters", "causality", "seed",
    "run", "status", "reason", "remark", "command", "diverged", "seconds", "cold",
    "map_evaluations", "peak_memory_mb", "final_position_error_m", "final_ins_error_m", "bound",
    "lock_time_s", "false_lock",
)  # fmt: skip
"""Columns of the table of runs, before those of the windows."""
_Bounds = dict[tuple[str, str], dict[str, tuple[float, float]]]
_Readings = dict[str, dict[str, tuple[int, float]]]
_PIECE = 5000
"""Records that are held at a time on their way into a table."""


class ResultsError(GGBenchError):
    """What is asked of a results folder is not in it."""


class Cell(NamedTuple):
    """The runs of one estimator on one case."""

    assumption: str
    case: str
    problem: str
    estimator: str
    key: str


class Results:
    """A results folder, finished or stopped.

    Parameters
    ----------
    folder : where it is.
    store : the open folder, if it is open already.

    Raises
    ------
    StoreError
        If it is no results folder or is damaged.
    """

    def __init__(self, folder: Path | str, store: Store | None = None) -> None:
        self.folder = Path(folder)
        self.store = store or Store(self.folder)
        self.manifest = read_manifest(self.folder)
        self.cells = [Cell(**cell) for cell in self.manifest["cells"]]
        self._arrays: dict[str, dict[str, np.ndarray]] = {}
        self._halves: dict[int, tuple[pd.DataFrame, pd.DataFrame]] = {}
        self._keys = {(*cell[:2], cell.estimator): cell.key for cell in self.cells}

    @cached_property
    def scenario(self) -> Scenario:
        """The scenario with the cases that were run."""
        return self.whole_scenario.select(self.manifest["cases"])

    @cached_property
    def whole_scenario(self) -> Scenario:
        """The scenario from the copy in the folder, with all of its cases.

        Raises
        ------
        ScenarioError, StoreError
            If this version cannot read it, or it is not the one that was run.
        """
        manifest = self.manifest
        loaded = scenario.from_text(
            manifest["scenario_text"], manifest["scenario"], manifest["notes"]
        )
        if loaded.content_hash != manifest["scenario_hash"]:
            raise StoreError(
                f"the scenario in {self.folder / 'manifest.json'} is not the one that was run: "
                "its hash differs"
            )
        return loaded

    @property
    def labels(self) -> list[str]:
        """The labels of the estimators, in the order in which they were asked for."""
        return list(self.estimators)

    @cached_property
    def estimators(self) -> dict[str, dict[str, Any]]:
        """What the results of each estimator depend on: class, parameters, hash of its source."""
        held: dict[str, dict[str, Any]] = self.manifest["estimators"]
        return held

    @property
    def seeking(self) -> dict[str, str]:
        """Estimators whose source looks where truth could be found, each with what it uses."""
        found = {name: held.get("seeks") for name, held in self.estimators.items()}
        return {
            label: ", ".join(map(str, names))
            for label, names in found.items()
            if names and isinstance(names, list)
        }

    @property
    def run_count(self) -> int:
        """How many runs of each case were asked for."""
        return int(self.manifest["runs"])

    def records(self, assumption: str = "") -> Iterator[dict[str, Any]]:
        """Yield the records of the cases ("") or of one assumption, with the names of their cell.

        Case by case, estimator by estimator, run by run.
        """
        for cell in self.cells:
            if cell.assumption == assumption:
                for record in self._records_of(cell):
                    yield record | {"case": cell.case, "estimator": cell.estimator}

    def _records_of(self, cell: Cell) -> Iterator[dict[str, Any]]:
        # A study that changes nothing of a case shares its records, of which there may be more.
        campaign = self.whole_scenario.campaign
        runs = campaign.runs_of(cell.assumption, self.run_count, cell.estimator)
        return self.store.records(cell.key, runs)

    def series(self, case: str, estimator: str) -> np.ndarray:
        """Return (runs, K', 4): position and velocity error [m, m/s], NEES, NIS of finished runs.

        K' are the epochs that ``kept`` of the case's arrays names. Empty if there are none.
        """
        key = self._keys.get(("", case, estimator))
        found = np.empty((0, 0, 4)) if key is None else self.store.series(key, self.run_count)
        return found if not len(found) else self._of_length(found, case, "kept")

    def series_of(self, case: str, estimator: str, run: int) -> np.ndarray | None:
        """Return (K', 4) of one run, or None if it has none."""
        key = self._keys.get(("", case, estimator))
        found = None if key is None else self.store.series_of(key, run)
        return None if found is None else self._of_length(found, case, "kept")

    def detail(self, case: str, estimator: str, run: int) -> np.ndarray | None:
        """Return (K, 18) of a run kept in detail, see :meth:`.store.Store.detail`."""
        key = self._keys.get(("", case, estimator))
        found = None if key is None else self.store.detail(key, run)
        return None if found is None else self._of_length(found, case, "times")

    def _of_length(self, found: np.ndarray, case: str, epochs: str) -> np.ndarray:
        """Return (..., K, columns) as it is if K is the number of a case's epochs."""
        errors = found[..., :2]  # a NEES or NIS may be undefined, an error may not
        if found.shape[-2] != len(self.arrays(case)[epochs]) or not np.isfinite(errors).all():
            raise StoreError(f"a time series of case {case} in {self.folder} is damaged")
        return found

    def lock_times(self, case: str, estimator: str) -> np.ndarray:
        """Return the times to lock [s] (runs,) of finished runs, NaN of those that never did."""
        own = self._runs_of(case, estimator) & (self._runs["status"] == "ok")
        return self._runs.loc[own, "lock_time_s"].to_numpy(dtype=float)

    def _runs_of(self, case: str, estimator: str) -> pd.Series:
        """Return which rows of the table of runs are an estimator's on a case."""
        table = self._runs
        own = (table["assumption"] == "") & (table["case"] == case)
        return own & (table["estimator"] == estimator)

    def counters(self) -> pd.DataFrame:
        """Return what estimators counted of themselves: medians over the runs that finished.

        A row for each case and estimator that left numbers in the ``info`` of its estimates: case,
        estimator, then a column for each counter, NaN where an estimator does not have it.
        """
        rows = []
        for cell in self.cells:
            if cell.assumption == "":
                told = [r["info"] for r in self._records_of(cell) if r["status"] == "ok"]
                counts = pd.DataFrame(told).select_dtypes("number").median()
                if len(counts):
                    rows.append({"case": cell.case, "estimator": cell.estimator, **counts})
        return pd.DataFrame(rows)

    @cached_property
    def fixes(self) -> dict[tuple[str, str], pd.DataFrame]:
        """The fixes of matchers, by case and estimator.

        ``run`` and :data:`.judging.fix_metrics.ROWS` of each that was tried, accepted or not, in
        a run that finished.
        """
        found = {}
        for cell in self.cells:
            told = [r for r in self._records_of(cell) if cell.assumption == "" and "fixes" in r]
            if told:
                rows = [{"run": r["run"]} | fix for r in told for fix in r["fixes"]]
                table = pd.DataFrame(rows, columns=["run", *fix_metrics.ROWS])
                found[cell.case, cell.estimator] = table.astype({"accepted": bool})
        return found

    def fix_figures(self) -> pd.DataFrame:
        """Return the figures of fixes: case, estimator, runs, :data:`.judging.fix_metrics.COLUMNS`.

        A row for each estimator that makes fixes, on each case with a limit ``lock_m``.
        """
        rows = []
        for (case, estimator), tried in self.fixes.items():
            limit = self.scenario.case(case).windows.lock_m
            if limit is not None:
                runs = int(self._runs_of(case, estimator).sum())
                named = {"case": case, "estimator": estimator, "runs": runs}
                rows.append(named | fix_metrics.figures(tried, runs, limit))
        return pd.DataFrame(rows)

    def arrays(self, case: str) -> dict[str, np.ndarray]:
        """Return what all runs of a case share: epochs, track, bounds, signals."""
        if case not in self._arrays:
            key = self.manifest["shared"].get(case, "")
            self._arrays[case] = self.store.arrays(key, case)
        return self._arrays[case]

    def runs(self) -> pd.DataFrame:
        """Return the table of runs: one row per run and estimator, the cases first, then studies.

        :data:`RUN_COLUMNS`, then for each window its mean squared errors, NEES, NIS and coverage.
        The table is the caller's own, to be changed at will.
        """
        return self._runs.copy()

    @cached_property
    def _runs(self) -> pd.DataFrame:
        tables = [table for cell in self.cells for table in self._tables_of(cell)]
        if not tables:
            return runs_table([], RUN_COLUMNS)
        runs = pd.concat(tables, ignore_index=True)
        if runs["reason"].str.startswith(self.store.damaged).all():
            raise StoreError(runs["reason"].iloc[0])
        return runs

    def _tables_of(self, cell: Cell) -> Iterator[pd.DataFrame]:
        """Yield the table of the runs of one estimator on one case, piece by piece."""
        command = self.command(cell, 0).removesuffix("0")
        records = self._records_of(cell)
        while piece := list(itertools.islice(records, _PIECE)):
            common = cell._asdict() | {
                "reason": [record.get("reason", "") for record in piece],
                "remark": [record.get("remark", "") for record in piece],
                "command": [f"{command}{record['run']}" for record in piece],
            }
            yield runs_table(piece, RUN_COLUMNS, common)

    def command(self, cell: Cell, run: int) -> str:
        """Return the command that runs one run again, alone, in one process."""
        case = f"{cell.assumption}/{cell.case}" if cell.assumption else cell.case
        words = [
            "--case",
            case,
            "-e",
            cell.estimator,
            "--seed",
            str(self.manifest["seed"]),
        ]
        name = as_argument(self.manifest["argument"])
        return f"ggbench run {name} {shlex.join([*words, '--run', str(run)])}"

    def summary(self) -> pd.DataFrame:
        """Return one row per case, estimator and window (:func:`.summary.summarize`).

        The table is the caller's own.
        """
        return self._summary.copy()

    @cached_property
    def _summary(self) -> pd.DataFrame:
        return self._summarized(self._runs)

    def halves(self, most: int) -> tuple[pd.DataFrame, pd.DataFrame]:
        """Return the summary of the runs of even and of odd number: to tune on, and to judge on.

        Of the first ``most`` runs.
        """
        if most not in self._halves:
            first = self._runs[self._runs["run"] < most]
            even = first["run"] % 2 == 0
            self._halves[most] = self._summarized(first[even]), self._summarized(first[~even])
        return self._halves[most]

    def judged_pairs(self, case: str, labels: Collection[str], most: int) -> pd.DataFrame:
        """Return the paired comparison of some estimators of a case on the runs that judge.

        Those of odd number, of the first ``most`` (:meth:`halves`).
        """
        table = self._runs
        own = (table["assumption"] == "") & (table["case"] == case) & (table["run"] < most)
        # The INS says what is success.
        asked = table["estimator"].isin([*labels, "ins"])
        return paired_table(table[own & asked & (table["run"] % 2 == 1)], self._bounds[0])

    def _summarized(self, table: pd.DataFrame) -> pd.DataFrame:
        runs = table[table["assumption"] == ""]
        bounds, readings = self._bounds
        return summarize(runs, bounds, self._references(), self.scenario.name, readings)

    @cached_property
    def _bounds(self) -> tuple[_Bounds, _Readings]:
        """The bounds of every case and estimator by window, and the readings of every case.

        In the order in which the cases and estimators were asked for.
        """
        loaded, table = self.scenario, self._runs
        bounds: _Bounds = {(case.name, label): {} for case in loaded.cases for label in self.labels}
        runs = table[table["assumption"] == ""]
        finished = runs[runs["status"] == "ok"].drop_duplicates(["case", "estimator"], keep="last")
        named = finished.set_index(["case", "estimator"])["bound"].to_dict()
        readings: _Readings = {}
        for case in loaded.cases:
            used = [label for label in self.labels if (case.name, label) in named]
            if not used:
                continue
            arrays = self.arrays(case.name)
            readings[case.name] = {}
            for window in WINDOWS:
                mask = window_mask(arrays["times"], case.windows, window)
                some = float(arrays["present"][mask].sum())
                numbers = float(arrays["channels"][mask].sum())
                readings[case.name][window] = round(some), numbers / some if some else 0.0
                for label in used:
                    squared = arrays.get(f"bound-{named[case.name, label]}")
                    if squared is None:
                        raise StoreError(f"{self.folder} does not hold the bound of {label}")
                    position, velocity = np.sqrt(squared[mask].mean(axis=0))
                    bounds[case.name, label][window] = (float(position), float(velocity))
        return bounds, readings

    def studies(self) -> pd.DataFrame:
        """Return each assumption's summary rows, and as ``""`` the same runs without it."""
        loaded = self.scenario
        table = self._runs
        groups = {
            study.name: table[table["assumption"] == study.name] for study in loaded.assumptions
        }
        studied = table[table["assumption"] != ""]
        if studied.empty:
            return pd.DataFrame()
        estimator = next(cell.estimator for cell in self.cells if cell.assumption)
        declared = table[
            (table["assumption"] == "")
            & (table["estimator"] == estimator)
            & table["run"].isin(studied["run"].unique())
        ]
        frames = [
            summarize(group, {}, self._references(), loaded.name).assign(assumption=name)
            for name, group in [*groups.items(), ("", declared)]
            if len(group)
        ]
        return pd.concat(frames, ignore_index=True)

    def paired(self) -> pd.DataFrame:
        """Return the paired comparison of every two estimators, in every case and window.

        The table is the caller's own.
        """
        return self._paired.copy()

    @cached_property
    def _paired(self) -> pd.DataFrame:
        return paired_table(self._runs, self._bounds[0])

    def failures(self) -> pd.DataFrame:
        """Return the runs that failed, each with its reason and the command that repeats it."""
        table = self._runs
        columns = ["assumption", "case", "estimator", "run", "reason", "command"]
        return table.loc[table["status"] != "ok", columns].reset_index(drop=True)

    def _references(self) -> dict[str, tuple[float, float] | None]:
        return {
            case.name: (case.reference.position_mrse_m, case.reference.velocity_mrse_mps)
            if case.reference
            else None
            for case in self.scenario.cases
        }


def as_argument(path: str) -> str:
    """Return a path as it can be pasted into a command: quoted, and not taken for an option."""
    return shlex.quote(f"./{path}" if path.startswith("-") else path)


def write_tables(results: Results) -> pd.DataFrame:
    """Write the tables of a results folder into it; return the summary.

    ``summary.csv`` (:data:`.summary.SUMMARY_COLUMNS`), ``paired.csv``, ``failures.csv``,
    ``runs.parquet`` (the table of runs; without pyarrow ``runs.csv``), if assumptions were studied
    ``assumptions.csv``, if locks were judged ``convergence.csv``, and if matchers made fixes
    ``fixes.csv``.

    Raises
    ------
    StoreError
        If a file cannot be written.
    """
    summary, studies = results.summary(), results.studies()

    def write_csv(name: str, table: pd.DataFrame) -> None:
        results.store.write(name, table.to_csv(index=False).encode())

    write_csv("summary.csv", summary[list(SUMMARY_COLUMNS)])
    write_csv("paired.csv", results.paired())
    write_csv("failures.csv", results.failures())
    if len(studies):
        write_csv("assumptions.csv", studies)
    locks = convergence.table(summary)
    if len(locks):
        write_csv("convergence.csv", locks)
    if results.fixes:
        named = pd.concat(results.fixes, names=["case", "estimator"]).reset_index([0, 1])
        write_csv("fixes.csv", named)
    _write_runs(results)
    return summary


def _write_runs(results: Results) -> None:
    """Write the table of runs in the better of two formats, and leave none in the other."""
    table, content = results.runs(), io.BytesIO()
    if importlib.util.find_spec("pyarrow") is None:
        name, other = "runs.csv", "runs.parquet"
        table.to_csv(content, index=False)
    else:
        name, other = "runs.parquet", "runs.csv"
        table.to_parquet(content, index=False)
    results.store.write(name, content.getvalue())
    results.store.remove(other)
