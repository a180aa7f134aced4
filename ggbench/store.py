"""Where a campaign's results live: a folder whose every write happens whole or not at all.

``manifest.json``   what was run: the scenario's text, versions, machine, seed, date, and the keys
                    under which the results are stored.
``records.sqlite``  one record per run and estimator, and what all runs of a case share; each is
                    durable (written through to the disk) when it has been added.

The other files of a folder are made from these two. A results folder is data: nothing in it is
ever executed.
"""

from __future__ import annotations

import fcntl
import io
import json
import os
import re
import sqlite3
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from .errors import GGBenchError

_SCHEMA = """
CREATE TABLE IF NOT EXISTS records (
    key TEXT NOT NULL,
    run INTEGER NOT NULL,
    retry_above REAL,
    record TEXT NOT NULL,
    series BLOB,
    detail BLOB,
    PRIMARY KEY (key, run)
);
CREATE TABLE IF NOT EXISTS shared (key TEXT PRIMARY KEY, arrays BLOB NOT NULL);
"""


FORMAT = 2
"""Version of what a folder holds; another one is refused."""
DATABASE_FILES = ("records.sqlite-shm", "records.sqlite-wal", "records.sqlite")
"""In the order of removal: a log that outlives its database would be replayed into the next."""
RESULT_FILES = (
    *DATABASE_FILES, "manifest.json", "scenario.toml",
    "summary.csv", "assumptions.csv", "paired.csv", "failures.csv", "runs.parquet",
)  # fmt: skip
LOCK = ".lock"
_PART = re.compile(rf"\.({'|'.join(map(re.escape, RESULT_FILES))})\.\d+\.part")
_MANIFEST_KEYS = (
    "scenario", "scenario_hash", "scenario_text", "argument", "title", "notes", "seed", "runs",
    "estimators", "cases", "assumptions", "cells", "shared", "ggbench", "source_hash", "versions",
    "date", "machine",
)  # fmt: skip
_RECORD_KEYS = ("name", "parameters", "causality", "run", "seed", "status")
_STATUS_KEYS = {
    "failed": ("reason",),
    "ok": ("seconds", "bound", "map_evaluations", "diverged", "windows"),
}
_ARRAYS = ("times", "kept", "track", "bound-filter", "bound-batch", "vertical", "noisy")
_BUSY_S = 60.0


class StoreError(GGBenchError):
    """A results folder cannot be used."""


class Result(NamedTuple):
    """What one run of one estimator leaves behind.

    Attributes
    ----------
    key : hash of all that the result depends on but the number of the run (``ggbench.keys``).
    record : the judgement, as JSON can hold it.
    series : (K', 4) position and velocity error [m, m/s], NEES, NIS at the kept epochs; or None.
    detail : (K, 12) errors of position and velocity and their σ, of a run kept in detail; or None.
    retry_above : None if the result is final; else the time limit [s] above which a run that was
        lost to its surroundings (it died, it was too slow) is worth another attempt.
    """

    key: str
    record: dict[str, Any]
    series: np.ndarray | None = None
    detail: np.ndarray | None = None
    retry_above: float | None = None


class Store:
    """A results folder.

    Parameters
    ----------
    folder : where it is.
    create : make it (and its database) if it does not exist, and keep other processes out.
    fresh : first remove the files of an earlier campaign, and nothing else.

    Raises
    ------
    StoreError
        If it does not exist or is damaged.
    """

    def __init__(self, folder: Path, create: bool = False, fresh: bool = False) -> None:
        self.folder = folder
        self._locked: io.BufferedWriter | None = None
        self._database = database = folder / "records.sqlite"
        try:
            if create:
                folder.mkdir(parents=True, exist_ok=True)
                self._lock()
                _remove_left(folder, all_of_them=fresh)
            elif not database.exists():
                raise StoreError(f"{folder} holds no results: it has no records.sqlite")
            # Where nothing may be written, the log's index cannot be made that a reader needs.
            fixed = not create and not os.access(folder, os.W_OK)
            name = f"{database.absolute().as_uri()}{'?immutable=1' if fixed else ''}"
            self._connection = sqlite3.connect(name, timeout=_BUSY_S, uri=True)
            if create:
                self._connection.execute("PRAGMA journal_mode = WAL")
                self._connection.executescript(_SCHEMA)
            self._connection.execute("PRAGMA synchronous = FULL")
            self._connection.execute("SELECT record, series FROM records LIMIT 1").fetchone()
        except OSError as error:
            raise StoreError(f"cannot use results folder {folder}: {error.strerror}") from None
        except sqlite3.Error as error:
            raise StoreError(f"{database} is not a usable database: {error}") from None

    def _lock(self) -> None:
        """Take the folder for this process, until it ends however it ends."""
        self._locked = (self.folder / LOCK).open("wb")
        try:
            fcntl.flock(self._locked, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise StoreError(
                f"another ggbench is running in {self.folder}; wait for it or choose another -o"
            ) from None

    def close(self) -> None:
        """Close the database, whose log is merged into it, and leave the folder to others."""
        self._connection.close()
        if self._locked is not None:
            self._locked.close()

    def add(self, results: Iterable[Result]) -> None:
        """Store results in one transaction.

        Raises
        ------
        StoreError
            If they cannot be written (a full disk): then none of them is.
        """
        self._write(
            "INSERT OR REPLACE INTO records VALUES (?, ?, ?, ?, ?, ?)",
            [
                (
                    r.key, r.record["run"], r.retry_above, json.dumps(r.record),
                    _pack(r.series), _pack(r.detail),
                )
                for r in results
            ],
        )  # fmt: skip

    def finished(self, limit: float = np.inf) -> set[tuple[str, int]]:
        """Return the (key, run) of the results that a time limit [s] leaves as they are."""
        return set(
            self._select(
                "SELECT key, run FROM records WHERE retry_above IS NULL OR retry_above >= ?",
                (limit,),
            )
        )

    def count(self) -> int:
        """Return how many results are stored, of whatever campaign."""
        return int(self._select("SELECT count(*) FROM records")[0][0])

    def records(self, key: str, runs: int) -> Iterator[dict[str, Any]]:
        """Yield the records under a key of the runs below ``runs``, in their order."""
        rows = self._select(
            "SELECT record FROM records WHERE key = ? AND run < ? ORDER BY run", (key, runs)
        )
        for (text,) in rows:
            try:
                record = json.loads(text)
                keys = (*_RECORD_KEYS, *_STATUS_KEYS[record["status"]])
                whole = all(name in record for name in keys)
            except (ValueError, TypeError, KeyError):
                whole = False
            if not whole:
                raise StoreError(f"a record in {self._database} is damaged: {str(text)[:60]!r}")
            yield record

    def series(self, key: str, runs: int) -> np.ndarray:
        """Return (runs, K', 4): position and velocity error [m, m/s], NEES, NIS of finished runs.

        K' are the epochs that ``kept`` of the shared arrays names.
        """
        rows = self._select(
            "SELECT series FROM records WHERE key = ? AND run < ? AND series IS NOT NULL "
            "ORDER BY run",
            (key, runs),
        )
        found = [self._unpack(blob, 4) for (blob,) in rows]
        if len({len(run) for run in found}) > 1:
            raise StoreError(f"a time series in {self._database} is damaged")
        return np.array(found)

    def series_of(self, key: str, run: int) -> np.ndarray | None:
        """Return (K', 4) of one run, or None if it has none."""
        return self._blob("series", key, run, 4)

    def detail(self, key: str, run: int) -> np.ndarray | None:
        """Return (K, 12) of a run kept in detail: errors of position and velocity, their σ."""
        return self._blob("detail", key, run, 12)

    def _blob(self, column: str, key: str, run: int, width: int) -> np.ndarray | None:
        found = self._select(f"SELECT {column} FROM records WHERE key = ? AND run = ?", (key, run))
        return None if not found or found[0][0] is None else self._unpack(found[0][0], width)

    def write_arrays(self, key: str, arrays: Mapping[str, np.ndarray]) -> None:
        """Store what all runs of a case share."""
        content = io.BytesIO()
        np.savez_compressed(content, allow_pickle=False, **arrays)
        self._write("INSERT OR REPLACE INTO shared VALUES (?, ?)", [(key, content.getvalue())])

    def has_arrays(self, key: str) -> bool:
        """Return whether what all runs of a case share is stored."""
        return bool(self._select("SELECT 1 FROM shared WHERE key = ?", (key,)))

    def arrays(self, key: str, case: str) -> dict[str, np.ndarray]:
        """Return what all runs of a case share; ``case`` names it in messages."""
        found = self._select("SELECT arrays FROM shared WHERE key = ?", (key,))
        if not found:
            raise StoreError(
                f"{self.folder} does not hold what the runs of case {case} share: it was stopped "
                "while it was prepared; the same command goes on from there"
            )
        try:
            with np.load(io.BytesIO(found[0][0]), allow_pickle=False) as archive:
                arrays = {name: archive[name] for name in archive.files}
        except Exception as error:  # NumPy, zipfile and zlib each have their own for damage
            raise StoreError(
                f"what the runs of case {case} share, in {self._database}, cannot be read: {error}"
            ) from None
        missing = [name for name in _ARRAYS if name not in arrays]
        if missing:
            raise StoreError(
                f"what the runs of case {case} share, in {self._database}, is damaged: it has no "
                f"{', '.join(missing)}"
            )
        return arrays

    def _select(self, query: str, values: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
        try:
            return self._connection.execute(query, values).fetchall()
        except sqlite3.Error as error:
            raise StoreError(f"{self._database} cannot be read: {error}") from None

    def _write(self, query: str, rows: list[tuple[Any, ...]]) -> None:
        try:
            with self._connection:
                self._connection.executemany(query, rows)
        except sqlite3.Error as error:
            raise StoreError(
                f"cannot write to {self.folder}: {error}; what it holds is kept, and the same "
                "command goes on from there"
            ) from None

    def _unpack(self, blob: Any, columns: int) -> np.ndarray:
        if not isinstance(blob, bytes) or len(blob) % (4 * columns):
            raise StoreError(f"a time series in {self._database} is damaged")
        return np.frombuffer(blob, dtype="<f4").reshape(-1, columns).astype(float)

    def write_manifest(self, manifest: Mapping[str, Any]) -> None:
        """Write the manifest, and beside it the scenario's text for a human reader."""
        self.write("manifest.json", (json.dumps(manifest, indent=1) + "\n").encode())
        self.write("scenario.toml", manifest["scenario_text"].encode())

    def write(self, name: str, content: bytes) -> None:
        """Write a file of the folder, whole or not at all, and through to the disk."""
        temporary = self.folder / f".{name}.{os.getpid()}.part"
        try:
            with temporary.open("wb") as file:
                file.write(content)
                file.flush()
                os.fsync(file.fileno())
            temporary.replace(self.folder / name)
            folder = os.open(self.folder, os.O_RDONLY)
            try:
                os.fsync(folder)
            finally:
                os.close(folder)
        except OSError as error:
            temporary.unlink(missing_ok=True)
            raise StoreError(f"cannot write {self.folder / name}: {error.strerror}") from None


def is_ours(name: str) -> bool:
    """Return whether a file of this name belongs to a campaign, finished or stopped."""
    return name in RESULT_FILES or name == LOCK or _PART.fullmatch(name) is not None


def read_manifest(folder: Path) -> dict[str, Any]:
    """Return the manifest of a results folder.

    Raises
    ------
    StoreError
        If it cannot be read, is damaged or of another format.
    """
    path = folder / "manifest.json"
    try:
        manifest = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise StoreError(f"cannot read {path}: {error.strerror}") from None
    except (ValueError, RecursionError) as error:
        raise StoreError(f"{path} is damaged: {error}") from None
    if not isinstance(manifest, dict):
        raise StoreError(f"{path} is damaged: not a JSON object")
    if manifest.get("format") != FORMAT:
        raise StoreError(
            f"{path} has format {manifest.get('format')}, and this version of ggbench reads "
            f"format {FORMAT}: run the scenario again, with --fresh or another -o"
        )
    missing = [key for key in _MANIFEST_KEYS if key not in manifest]
    if missing:
        raise StoreError(f"{path} is damaged: it has no {', '.join(missing)}")
    return manifest


def _remove_left(folder: Path, all_of_them: bool) -> None:
    """Remove what a stopped process left half written, or all files of earlier campaigns."""
    for path in folder.iterdir():
        if _PART.fullmatch(path.name):
            path.unlink()
    for name in RESULT_FILES if all_of_them else ():
        (folder / name).unlink(missing_ok=True)


def _pack(array: np.ndarray | None) -> bytes | None:
    return None if array is None else np.ascontiguousarray(array, dtype="<f4").tobytes()
