"""Where a campaign's results live: a folder with a manifest, a database of records and arrays.

``manifest.json``  what was run: scenario hash, versions, machine, seed, date.
``scenario.toml``  the scenario file itself.
``records.sqlite`` one record per run and estimator, each durable when its transaction ends.
``case-NAME.npz``  what all runs of a case share: bounds and signals for the figures.
``summary.csv``, ``assumptions.csv``  made from the records.

A results folder is data: nothing in it is ever executed.
"""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from .errors import GGBenchError

_SCHEMA = """
CREATE TABLE IF NOT EXISTS records (
    assumption TEXT NOT NULL,
    "case" TEXT NOT NULL,
    estimator TEXT NOT NULL,
    run INTEGER NOT NULL,
    record TEXT NOT NULL,
    series BLOB,
    detail BLOB,
    PRIMARY KEY (assumption, "case", estimator, run)
) WITHOUT ROWID
"""


FORMAT = 1
"""Version of what a folder holds; another one is refused."""
RESULT_FILES = (
    "manifest.json", "scenario.toml", "summary.csv", "assumptions.csv",
    "records.sqlite", "records.sqlite-wal", "records.sqlite-shm",
)  # fmt: skip
_MANIFEST_KEYS = (
    "scenario", "scenario_hash", "seed", "ggbench", "source_hash", "notes", "runs", "estimators",
    "estimator_files", "assumptions", "date", "versions", "machine",
)  # fmt: skip
_RECORD_KEYS = ("assumption", "case", "estimator", "name", "parameters", "causality", "run", "seed")
_STATUS_KEYS = {
    "failed": ("reason",),
    "ok": ("seconds", "bound", "map_evaluations", "diverged", "windows"),
}
_ARRAYS = ("times", "track", "bound-filter", "bound-batch", "vertical", "noisy")


class StoreError(GGBenchError):
    """A results folder cannot be used."""


class Store:
    """A results folder.

    Parameters
    ----------
    folder : where it is.
    create : make it (and its database) if it does not exist.

    Raises
    ------
    StoreError
        If it does not exist or is damaged.
    """

    def __init__(self, folder: Path, create: bool = False) -> None:
        self.folder = folder
        self._database = database = folder / "records.sqlite"
        try:
            if create:
                folder.mkdir(parents=True, exist_ok=True)
            elif not database.exists():
                raise StoreError(f"{folder} holds no results: it has no records.sqlite")
            self._connection = sqlite3.connect(database)
            if create:
                self._connection.execute("PRAGMA journal_mode = WAL")
                self._connection.execute(_SCHEMA)
            self._connection.execute("SELECT record, series FROM records LIMIT 1").fetchone()
        except OSError as error:
            raise StoreError(f"cannot use results folder {folder}: {error.strerror}") from None
        except sqlite3.Error as error:
            raise StoreError(f"{database} is not a usable database: {error}") from None

    def close(self) -> None:
        """Close the database; the folder then has no files beside the documented ones."""
        self._connection.close()

    def add(
        self, results: list[tuple[dict[str, Any], np.ndarray | None, np.ndarray | None]]
    ) -> None:
        """Store records with their series (K, 4) and details (K, 12) in one transaction."""
        rows = [
            (
                record["assumption"], record["case"], record["estimator"], record["run"],
                json.dumps(record), _pack(series), _pack(detail),
            )
            for record, series, detail in results
        ]  # fmt: skip
        try:
            with self._connection:
                self._connection.executemany(
                    "INSERT OR REPLACE INTO records VALUES (?, ?, ?, ?, ?, ?, ?)", rows
                )
        except sqlite3.Error as error:
            raise StoreError(f"cannot write to {self.folder}: {error}") from None

    def finished(self) -> set[tuple[str, str, str, int]]:
        """Return the (assumption, case, estimator, run) of every stored record."""
        rows = self._select('SELECT assumption, "case", estimator, run FROM records')
        return set(rows)

    def records(self, assumption: str = "") -> Iterator[dict[str, Any]]:
        """Yield the records of the cases ("") or of one assumption, ordered by run."""
        rows = self._select(
            'SELECT record FROM records WHERE assumption = ? ORDER BY run, "case", estimator',
            (assumption,),
        )
        for (text,) in rows:
            try:
                record = json.loads(text)
                keys = (*_RECORD_KEYS, *_STATUS_KEYS[record["status"]])
                whole = all(key in record for key in keys)
            except (ValueError, TypeError, KeyError):
                whole = False
            if not whole:
                raise StoreError(f"a record in {self._database} is damaged: {str(text)[:60]!r}")
            yield record

    def series(self, case: str, estimator: str) -> np.ndarray:
        """Return (runs, K, 4): position and velocity error [m, m/s], NEES, NIS of finished runs."""
        rows = self._select(
            "SELECT series FROM records WHERE assumption = '' AND \"case\" = ? AND estimator = ? "
            "AND series IS NOT NULL ORDER BY run",
            (case, estimator),
        )
        runs = [self._unpack(blob, 4) for (blob,) in rows]
        if len({len(run) for run in runs}) > 1:
            raise StoreError(f"a time series in {self._database} is damaged")
        return np.array(runs)

    def detail(self, case: str, estimator: str, run: int) -> np.ndarray | None:
        """Return (K, 12) of a run kept in detail: errors of position and velocity, their σ."""
        found = self._select(
            "SELECT detail FROM records WHERE assumption = '' AND \"case\" = ? AND estimator = ? "
            "AND run = ?",
            (case, estimator, run),
        )
        return None if not found or found[0][0] is None else self._unpack(found[0][0], 12)

    def _select(self, query: str, values: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
        try:
            return self._connection.execute(query, values).fetchall()
        except sqlite3.Error as error:
            raise StoreError(f"{self._database} cannot be read: {error}") from None

    def _unpack(self, blob: Any, columns: int) -> np.ndarray:
        if not isinstance(blob, bytes) or len(blob) % (4 * columns):
            raise StoreError(f"a time series in {self._database} is damaged")
        return np.frombuffer(blob, dtype="<f4").reshape(-1, columns).astype(float)

    def write_json(self, name: str, content: Mapping[str, Any]) -> None:
        """Write a JSON file of the folder, whole or not at all."""
        self.write_text(name, json.dumps(content, indent=2) + "\n")

    def write_text(self, name: str, text: str) -> None:
        """Write a text file of the folder, whole or not at all."""
        temporary = self.folder / f".{name}.part"
        try:
            temporary.write_text(text, encoding="utf-8")
            temporary.replace(self.folder / name)
        except OSError as error:
            raise StoreError(f"cannot write {self.folder / name}: {error.strerror}") from None

    def read_text(self, name: str) -> str:
        """Read a text file of the folder."""
        try:
            return (self.folder / name).read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            raise StoreError(f"cannot read {self.folder / name}: {error}") from None

    def manifest(self) -> dict[str, Any]:
        """Return the manifest."""
        try:
            manifest = json.loads(self.read_text("manifest.json"))
        except json.JSONDecodeError as error:
            raise StoreError(f"{self.folder / 'manifest.json'} is damaged: {error}") from None
        path = self.folder / "manifest.json"
        if not isinstance(manifest, dict):
            raise StoreError(f"{path} is damaged: not a JSON object")
        if manifest.get("format") != FORMAT:
            raise StoreError(
                f"{path} has format {manifest.get('format')}, and this version of ggbench reads "
                f"format {FORMAT}: run the scenario again"
            )
        missing = [key for key in _MANIFEST_KEYS if key not in manifest]
        if missing:
            raise StoreError(f"{path} is damaged: it has no {', '.join(missing)}")
        return manifest

    def write_arrays(self, case: str, arrays: Mapping[str, np.ndarray]) -> None:
        """Write what all runs of a case share, whole or not at all."""
        temporary = self.folder / f".case-{case}.npz"
        try:
            with temporary.open("wb") as file:
                np.savez_compressed(file, allow_pickle=False, **arrays)
            temporary.replace(self.folder / f"case-{case}.npz")
        except OSError as error:
            raise StoreError(f"cannot write to {self.folder}: {error.strerror}") from None

    def stored_lags(self, case: str) -> set[int]:
        """Return the fixed lags [epochs] whose bounds are stored for a case."""
        if not (self.folder / f"case-{case}.npz").exists():
            return set()
        prefix = "bound-fixed-lag-"
        return {int(k.removeprefix(prefix)) for k in self.arrays(case) if k.startswith(prefix)}

    def arrays(self, case: str) -> dict[str, np.ndarray]:
        """Return what all runs of a case share."""
        path = self.folder / f"case-{case}.npz"
        try:
            with np.load(path, allow_pickle=False) as archive:
                arrays = {name: archive[name] for name in archive.files}
        except Exception as error:  # NumPy, zipfile and zlib each have their own for damage
            raise StoreError(f"{path} cannot be read: {error}") from None
        missing = [name for name in _ARRAYS if name not in arrays]
        if missing:
            raise StoreError(f"{path} is damaged: it has no {', '.join(missing)}")
        return arrays


def _pack(array: np.ndarray | None) -> bytes | None:
    return None if array is None else np.ascontiguousarray(array, dtype="<f4").tobytes()
