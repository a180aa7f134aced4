"""Reader of results folders: records and tables.

The reader uses only the files of the folder. It loads no estimator and simulates nothing.
"""

from __future__ import annotations

import importlib.util
import io
import os
import shlex
from collections.abc import Iterator, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from ..errors import GGBenchError
from ..judging import cases, fix_metrics, pairs, summary
from ..judging.run_errors import WINDOWS, window_mask
from ..judging.verdicts import Verdict
from ..spec import scenario
from ..spec.scenario import Scenario
from .columns import TABLED
from .csv_cells import csv_text
from .database import StoreError
from .store import Store, read_manifest

_Measurements = dict[str, dict[str, tuple[int, float]]]


class ResultsError(GGBenchError):
    """A results folder does not contain the requested item."""


class Cell(NamedTuple):
    """The runs of one estimator on one case."""

    assumption: str
    case: str
    problem: str
    estimator: str
    key: str


RUN_COLUMNS = (
    "assumption",
    "case",
    "problem",
    "estimator",
    "command",
    "draw",
    *(column.name for column in TABLED),
)
"""Columns of the table of runs."""


class Results:
    """Content of a results folder, also of an interrupted campaign.

    Tables are copies, which callers may change. ``store`` is the opened folder; by default it is
    opened for reading. Raise StoreError if the folder is no results folder or is damaged.
    """

    def __init__(self, folder: Path | str, store: Store | None = None) -> None:
        self.folder = Path(folder)
        self.store = store or Store(self.folder)
        self.manifest = read_manifest(self.folder)
        self.cells = [Cell(**cell) for cell in self.manifest["cells"]]
        self._arrays: dict[str, dict[str, np.ndarray]] = {}
        self._keys = {(*cell[:2], cell.estimator): cell.key for cell in self.cells}

    @cached_property
    def scenario(self) -> Scenario:
        """Scenario with only the cases that were run."""
        return self.whole_scenario.select(self.manifest["cases"])

    @cached_property
    def whole_scenario(self) -> Scenario:
        """Scenario with all of its cases, read from the copy in the folder.

        Raises
        ------
        ScenarioError, StoreError
            If this version cannot read the copy, or the copy differs from the scenario that was
            run.
        """
        manifest = self.manifest
        loaded = scenario.from_text(
            manifest["scenario_text"], manifest["scenario"], manifest["notes"]
        )
        if loaded.content_hash != manifest["scenario_hash"]:
            raise StoreError(
                f"the scenario in {self.folder / 'manifest.json'} has changed since the run: its "
                "hash differs"
            )
        return loaded

    @property
    def labels(self) -> list[str]:
        """Labels of the estimators, in the order of the user's command."""
        return list(self.estimators)

    @cached_property
    def estimators(self) -> dict[str, dict[str, Any]]:
        """Class, parameters and source hash of each estimator, by label."""
        return dict(self.manifest["estimators"])

    @property
    def families(self) -> dict[str, str]:
        """Family (:data:`ggbench.problem.Family`) of each estimator, by label."""
        return dict(self.manifest["families"])

    @property
    def seeking(self) -> dict[str, str]:
        """Names in an estimator's source code that give access to the truth, by label."""
        names_used = {name: estimator.get("seeks") for name, estimator in self.estimators.items()}
        return {
            label: ", ".join(map(str, names))
            for label, names in names_used.items()
            if names and isinstance(names, list)
        }

    @property
    def run_count(self) -> int:
        """Requested number of runs of each case."""
        return int(self.manifest["runs"])

    def records(self, assumption: str = "") -> Iterator[dict[str, Any]]:
        """Yield the records of the runs with the named ``assumption``; "" stands for none.

        Each record includes its case and estimator. The order is case, estimator, run.
        """
        for cell in self.cells:
            if cell.assumption == assumption:
                for record in self._records_of(cell):
                    yield record | {"case": cell.case, "estimator": cell.estimator}

    def _records_of(self, cell: Cell) -> Iterator[dict[str, Any]]:
        # A study that changes nothing of a case shares its records, of which there may be more.
        campaign = self.whole_scenario.campaign
        runs = campaign.runs_of(cell.assumption, self.run_count)
        return self.store.records(cell.key, runs)

    def series(self, case: str, estimator: str) -> np.ndarray:
        """Return the time series (S, K', 4) of the finished runs of an estimator.

        The columns are position error [m], velocity error [m/s], NEES and NIS. S is the number of
        finished runs among the first 1000; no other run has a time series
        (:data:`.store.SERIES_RUNS`). The result may be empty. The array ``kept`` of the case has
        the indices of the K' epochs.
        """
        key = self._keys.get(("", case, estimator))
        curves = np.empty((0, 0, 4)) if key is None else self.store.series(key, self.run_count)
        return curves if not len(curves) else self._of_length(curves, case, "kept")

    def series_of(self, case: str, estimator: str, run: int) -> np.ndarray | None:
        """Return the time series (K', 4) of one run, or None if none is stored.

        :meth:`series` describes the columns and the K' epochs.
        """
        key = self._keys.get(("", case, estimator))
        curve = None if key is None else self.store.series_of(key, run)
        return None if curve is None else self._of_length(curve, case, "kept")

    def detail(self, case: str, estimator: str, run: int) -> np.ndarray | None:
        """Return the error components (K, 18) of a run, see :meth:`.database.Database.detail`."""
        key = self._keys.get(("", case, estimator))
        curve = None if key is None else self.store.detail(key, run)
        return None if curve is None else self._of_length(curve, case, "times")

    def _of_length(self, curves: np.ndarray, case: str, epochs: str) -> np.ndarray:
        """Return time series (..., K, columns) unchanged.

        Raise StoreError unless K is the length of the array ``epochs`` of the case, and all errors
        are finite.
        """
        errors = curves[..., :2]  # a NEES or NIS may be undefined, an error may not
        if curves.shape[-2] != len(self.arrays(case)[epochs]) or not np.isfinite(errors).all():
            raise StoreError(f"a time series of case {case} in {self.folder} is damaged")
        return curves

    def counters(self) -> pd.DataFrame:
        """Return the counters in ``Estimate.info`` as medians over the finished runs.

        There is a row for each case and estimator with counters, and a column for each counter. A
        counter that an estimator does not have is NaN.
        """
        return self._counters.copy()

    @cached_property
    def _counters(self) -> pd.DataFrame:
        rows = []
        for (case, estimator), infos in self.infos.items():
            counts = pd.DataFrame(infos).select_dtypes("number").median()
            if len(counts):
                rows.append({"case": case, "estimator": estimator, **counts})
        return pd.DataFrame(rows)

    @cached_property
    def infos(self) -> dict[tuple[str, str], list[dict[str, Any]]]:
        """``Estimate.info`` of the finished runs, by case and estimator."""
        return {
            (cell.case, cell.estimator): self.store.infos(cell.key, self.run_count)
            for cell in self.cells
            if cell.assumption == ""
        }

    @cached_property
    def fixes(self) -> dict[tuple[str, str], pd.DataFrame]:
        """Tables of the position fixes of matchers, by case and estimator.

        The columns are ``run`` and :data:`.judging.fix_metrics.ROWS`. A row is an accepted or
        rejected fix in a finished run.
        """
        by_key = self.store.fixes({cell.key for cell in self.cells}, self.run_count)
        return {
            (cell.case, cell.estimator): by_key[cell.key]
            for cell in self.cells
            if cell.assumption == "" and cell.key in by_key
        }

    def fix_metrics(self) -> pd.DataFrame:
        """Return the metrics of position fixes, with a row for each matcher and case.

        The columns are case, estimator, runs and :data:`.judging.fix_metrics.COLUMNS`.
        """
        rows, table = [], self._cases_runs
        for (case, estimator), fixes in self.fixes.items():
            own = table[(table["case"] == case) & (table["estimator"] == estimator)]
            named = {"case": case, "estimator": estimator, "runs": len(own)}
            limit = float(own["required_m"].median())
            rows.append(named | fix_metrics.metrics(fixes, len(own), limit))
        return pd.DataFrame(rows)

    def arrays(self, case: str) -> dict[str, np.ndarray]:
        """Return the arrays that all runs share: epochs (K,), track (K, 3), bounds, signals."""
        if case not in self._arrays:
            key = self.manifest["shared"].get(case, "")
            self._arrays[case] = self.store.arrays(key, case)
        return self._arrays[case]

    def runs(self) -> pd.DataFrame:
        """Return a table with a row for each run of each estimator, with and without assumptions.

        The columns are :data:`RUN_COLUMNS`; missing numbers are NaN.
        """
        return self._runs.copy()

    @cached_property
    def _runs(self) -> pd.DataFrame:
        campaign, cases = self.whole_scenario.campaign, self.whole_scenario.cases
        cells = pd.DataFrame(self.cells, columns=Cell._fields)
        # A study that changes nothing of a case shares its records, of which there may be more.
        cells["most"] = [campaign.runs_of(cell.assumption, self.run_count) for cell in self.cells]
        cells["command"] = [self.command(cell, 0).removesuffix("0") for cell in self.cells]
        most = int(cells["most"].max()) if len(cells) else 0
        table = cells.merge(self.store.runs(set(cells["key"]), most), on="key")
        table = table[table["run"] < table["most"]].reset_index(drop=True)
        table["command"] += table["run"].astype(str)
        cluster = {case.name: case.cluster for case in cases}
        runs = zip(table["case"], table["run"].tolist(), strict=True)
        table["draw"] = np.array([cluster[case](run) for case, run in runs], dtype=int)
        return table[[*RUN_COLUMNS]]

    def command(self, cell: Cell, run: int) -> str:
        """Return the command that repeats a single run of a cell in one process."""
        case = f"{cell.assumption}/{cell.case}" if cell.assumption else cell.case
        options = {"--case": case, "-e": cell.estimator, "--seed": self.manifest["seed"]}
        words = [f"{option} {shlex.quote(str(value))}" for option, value in options.items()]
        return f"ggbench run {as_argument(self.manifest['argument'])} {' '.join(words)} --run {run}"

    def metrics(self) -> pd.DataFrame:
        """Return metrics by case, estimator and window (:func:`.summary.metrics`)."""
        return self._metrics.copy()

    @cached_property
    def _metrics(self) -> pd.DataFrame:
        table = self._unjudged.copy()
        for verdicts in self._verdicts.values():
            for case, verdict in verdicts.items():
                chosen = (table["case"] == case) & table["estimator"].isin(verdict.recommended)
                table.loc[chosen & (table["window"] == "settled"), "recommended"] = True
        return table

    @cached_property
    def _unjudged(self) -> pd.DataFrame:
        """Metrics of the cases, without recommendations."""
        return self.metrics_of(self._cases_runs)

    def metrics_of(self, runs: pd.DataFrame) -> pd.DataFrame:
        """Return the metrics of some rows of the table :meth:`runs`, without recommendations."""
        published = {
            case.name: (case.reference.position_mrse_m, case.reference.velocity_mrse_mps)
            for case in self.scenario.cases
            if case.reference
        }
        return summary.metrics(runs, published, self._measurements)

    @property
    def _cases_runs(self) -> pd.DataFrame:
        return self._runs[self._runs["assumption"] == ""]

    @cached_property
    def _verdicts(self) -> dict[str, dict[str, Verdict]]:
        """Verdicts by kind of estimators and by case."""
        return cases.verdicts(self._cases_runs, self._unjudged)

    def pairs(self) -> pd.DataFrame:
        """Return a table of comparisons between two estimators of a case (:func:`.pairs.pairs`)."""
        return self._pairs.copy()

    @cached_property
    def _pairs(self) -> pd.DataFrame:
        return pairs.pairs(self._cases_runs)

    def pairs_of(self, requested: Sequence[tuple[str, str, str]]) -> pd.DataFrame:
        """Return comparisons of requested pairs, as one family of tests (:func:`.pairs.family`).

        Each item of ``requested`` consists of a case and the labels of two estimators.
        """
        return pairs.family(self._cases_runs, requested)

    def cases(self) -> pd.DataFrame:
        """Return set-up, bounds and verdicts: a row for each case (:func:`.cases.cases`)."""
        return self._cases.copy()

    @cached_property
    def _cases(self) -> pd.DataFrame:
        arrays = {case.name: self.arrays(case.name) for case in self.scenario.cases}
        return cases.cases(self.scenario.cases, arrays, self._metrics, self._verdicts)

    @cached_property
    def _measurements(self) -> _Measurements:
        """Number of epochs with a measurement, and mean number of channels at these epochs.

        They are ordered by case and window.
        """
        counts: _Measurements = {}
        for case in self.scenario.cases:
            arrays = self.arrays(case.name)
            counts[case.name] = {}
            for window in WINDOWS:
                mask = window_mask(arrays["times"], case.windows, window)
                some = float(arrays["present"][mask].sum())
                numbers = float(arrays["channels"][mask].sum())
                counts[case.name][window] = round(some), numbers / some if some else 0.0
        return counts

    def studies(self) -> pd.DataFrame:
        """Return metrics with a column ``assumption``; empty if no runs have an assumption.

        For comparison, rows with "" in this column are metrics of runs without an assumption. These
        runs have the same run indices and the same estimator as the runs with an assumption.
        """
        table = self._runs
        studied = table[table["assumption"] != ""]
        if studied.empty:
            return pd.DataFrame()
        estimator = next(cell.estimator for cell in self.cells if cell.assumption)
        same = table["run"].isin(studied["run"].unique()) & (table["estimator"] == estimator)
        declared = table[(table["assumption"] == "") & same]
        groups = {study.name: studied for study in self.scenario.assumptions} | {"": declared}
        frames = [
            self.metrics_of(group[group["assumption"] == name]).assign(assumption=name)
            for name, group in groups.items()
            if (group["assumption"] == name).any()
        ]
        return pd.concat(frames, ignore_index=True)

    def failures(self) -> pd.DataFrame:
        """Return a table of the failed runs, with reasons and commands that repeat them."""
        table = self._runs
        columns = ["assumption", "case", "estimator", "run", "reason", "command"]
        return table.loc[table["status"] != "ok", columns].reset_index(drop=True)


def as_argument(path: str) -> str:
    """Return a path quoted for a command line, where it is never taken as an option.

    Bytes that are no valid UTF-8 become escapes within ``$'...'``, which shells convert back.
    """
    try:
        path.encode()
    except UnicodeEncodeError:
        escaped = os.fsencode(path).decode("latin-1").encode("unicode_escape").decode()
        return "$'" + escaped.replace("'", "\\'") + "'"
    return shlex.quote(f"./{path}" if path.startswith("-") else path)


def write_tables(results: Results) -> pd.DataFrame:
    """Write the tables of a results folder into the folder, and return the metrics.

    The files are ``metrics.csv``, ``pairs.csv``, ``cases.csv``, ``failures.csv`` and
    ``runs.parquet`` (``runs.csv`` without pyarrow). Runs of assumptions add ``assumptions.csv``,
    and fixes of matchers add ``fixes.csv``. Raise StoreError if a file cannot be written.
    """
    metrics = results.metrics()
    tables = {
        "metrics": metrics,
        "pairs": results.pairs(),
        "cases": results.cases(),
        "failures": results.failures(),
        "assumptions": results.studies(),
    }
    if results.fixes:
        tables["fixes"] = pd.concat(results.fixes, names=["case", "estimator"]).reset_index([0, 1])
    for name, table in tables.items():
        if len(table) or name not in ("assumptions", "fixes"):
            results.store.write(f"{name}.csv", csv_text(table).encode())
    _write_runs(results)
    return metrics


def _write_runs(results: Results) -> None:
    """Write the table of runs as Parquet, or as CSV without pyarrow; remove the other file."""
    table, content = results.runs(), io.BytesIO()
    if importlib.util.find_spec("pyarrow") is None:
        name, other = "runs.csv", "runs.parquet"
        content.write(csv_text(table).encode())
    else:
        name, other = "runs.parquet", "runs.csv"
        table.to_parquet(content, index=False)
    results.store.write(name, content.getvalue())
    results.store.remove(other)
