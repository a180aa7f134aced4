"""Results folder with atomic writes.

``manifest.json``   what was run: the scenario's text, versions, machine, seed, date, and the keys
                    under which the results are stored.
``records.sqlite``  one record per run and estimator (:mod:`.results.columns`), and what all runs of
                    a case share; each is durable (written through to the disk) when it was added.

The other files of a folder are made from these two. A results folder is data: nothing in it is
ever executed.
"""

from __future__ import annotations

import contextlib
import fcntl
import io
import json
import os
import re
import sqlite3
from collections.abc import Iterable, Iterator, Mapping, Sequence, Set
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from pydantic_core import from_json

from ..errors import GGBenchError, text_of
from ..files import reason_of
from .columns import BLANK, COLUMNS, FIX_COLUMNS, NAMES, SCHEMA, TABLED, Column
from .formats import flaw_of_arrays, flaw_of_manifest

if TYPE_CHECKING:
    import pandas as pd

DETAILED_RUN = 0
"""The run whose errors and claimed deviations are kept component by component, for the figures."""
MOST_KEPT = 400
"""Most epochs of a run whose errors are kept as a time series."""
SERIES_RUNS = 1000
"""Runs of a case whose time series are kept, the first ones: what figures over time are made of."""
_APPLICATION_ID = 0x67676231
"""Says in the header of a database that it is one of ours."""
FORMAT = 6
"""Version of what a folder holds besides the columns of records; another one is refused."""
DATABASE_FILES = (
    "records.sqlite-journal", "records.sqlite-shm", "records.sqlite-wal", "records.sqlite",
)  # fmt: skip
"""The logs first: one that outlives its database would be replayed into the next."""
RESULT_FILES = (
    *DATABASE_FILES, "scenario.toml",
    "metrics.csv", "pairs.csv", "cases.csv", "assumptions.csv", "failures.csv", "fixes.csv",
    "runs.parquet", "runs.csv", "manifest.json",
)  # fmt: skip
"""In the order of removal: as long as there is something of ours, the manifest says whose it is."""
LOCK = ".lock"
_PART = re.compile(rf"\.({'|'.join(map(re.escape, RESULT_FILES))})\.\d+\.part")
_BUSY_S = 60.0
_CHUNK, _PIECE = 1000, 5000
"""Records read at a time, one by one and on their way into a table."""
_TRUTHS = tuple(column.name for column in COLUMNS if column.kind is bool)
_MANIFEST_MARKS = (b'"format"', b'"results_version"', b'"scenario_hash"')


class StoreError(GGBenchError):
    """A results folder cannot be used."""


class Result(NamedTuple):
    """What one run of one estimator leaves behind.

    Attributes
    ----------
    key : hash of all that the result depends on but the number of the run
        (:mod:`.campaign.result_keys`).
    record : what is said of the run, a value for each of :data:`.columns.NAMES`.
    series : (K', 4) float32, position and velocity error [m, m/s], NEES, NIS at the kept epochs; or
        None.
    detail : (K, 18) float32, errors and their σ of a run kept in detail, see :meth:`Store.detail`;
        or None.
    fixes : of a matcher, see :func:`.judging.fix_metrics.judge`.
    retry_above : None if the result is final; else the time limit [s] above which another attempt
        is worth it, of a run that died or was too slow.
    """

    key: str
    record: dict[str, Any]
    series: np.ndarray | None = None
    detail: np.ndarray | None = None
    fixes: Sequence[Mapping[str, Any]] = ()
    retry_above: float | None = None


def kept_epochs(epochs: int) -> np.ndarray:
    """Return which of the epochs are kept as a time series: all, or an even choice of many."""
    kept = np.linspace(0, epochs - 1, min(epochs, MOST_KEPT))
    return np.round(kept).astype(int)


class Store:
    """A results folder; raise StoreError if it does not exist or is damaged.

    ``create`` : make it (and its database) if it does not exist, and keep other processes out.
    ``fresh`` : first remove the files of an earlier campaign, and nothing else.
    """

    def __init__(self, folder: Path, create: bool = False, fresh: bool = False) -> None:
        self.folder = folder
        self._locked: io.BufferedWriter | None = None
        self._database = database = folder / "records.sqlite"
        try:
            if create:
                new = not folder.exists()
                folder.mkdir(parents=True, exist_ok=True)
                if new:
                    _sync(folder.parent)
                self._lock()
                _remove_left(folder, all_of_them=fresh)
            elif not database.exists():
                raise StoreError(f"{folder} holds no results: it has no records.sqlite")
            self._connection = self._connect(create)
            if create:
                # In the file itself, before there is a log that it could be in instead.
                self._connection.execute(f"PRAGMA application_id = {_APPLICATION_ID}")
                self._connection.execute("PRAGMA journal_mode = WAL")
                if not _tables(self._connection):
                    self._connection.executescript(f"BEGIN; {SCHEMA} COMMIT")
            self._connection.execute("PRAGMA synchronous = FULL")
            self._connection.execute("PRAGMA foreign_keys = ON")
            self._require_sound()
        except OSError as error:
            raise StoreError(f"cannot use results folder {folder}: {error.strerror}") from None
        except sqlite3.Error as error:
            raise StoreError(f"{database} is not a usable database: {text_of(error)}") from None

    def _connect(self, write: bool) -> sqlite3.Connection:
        """Open the database; a folder in which nothing may be written is read as it is."""
        name = self._database.absolute().as_uri()
        if write or os.access(self.folder, os.W_OK):
            return sqlite3.connect(name, timeout=_BUSY_S, uri=True)
        log = self.folder / "records.sqlite-wal"
        if log.exists() and log.stat().st_size:
            # What the log holds can be read only where its index can be made.
            raise StoreError(
                f"{self.folder} may not be written to and its campaign was stopped (or is running):"
                " let its owner look at it once with 'ggbench show', or copy it"
            )
        return sqlite3.connect(f"{name}?immutable=1", timeout=_BUSY_S, uri=True)

    def _require_sound(self) -> None:
        """Raise StoreError unless tables and rows are those that the declared columns allow."""
        with contextlib.closing(sqlite3.connect(":memory:")) as blank:
            blank.executescript(SCHEMA)
            if _tables(blank) != _tables(self._connection):
                raise StoreError(
                    f"{self._database} has other columns than this version of ggbench: run the "
                    "scenario again, with --fresh or into another output folder"
                )
        # It checks the constraints of every row, too.
        (flaw,) = self._connection.execute("PRAGMA quick_check(1)").fetchone()
        if flaw != "ok":
            raise StoreError(
                f"{self._database} is damaged ({' '.join(flaw.split())}): run the scenario again, "
                "with --fresh or into another output folder"
            )

    def _lock(self) -> None:
        """Take the folder for this process, until it ends however it ends."""
        self._locked = (self.folder / LOCK).open("wb")
        try:
            fcntl.flock(self._locked, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise StoreError(
                f"another ggbench is running in {self.folder}; wait for it or choose another "
                "output folder"
            ) from None

    def close(self) -> None:
        """Close the database, whose log is merged into it, and leave the folder to others."""
        self._connection.close()
        if self._locked is not None:
            self._locked.close()

    def add(self, results: Iterable[Result]) -> None:
        """Store results in one transaction.

        Raise StoreError if they cannot be written (a full disk): then none of them is.
        """
        records: list[tuple[Any, ...]] = []
        fixes: list[tuple[Any, ...]] = []
        curves: list[tuple[Any, ...]] = []
        for r in results:
            run, info = r.record["run"], json.dumps(r.record["info"], separators=(",", ":"))
            record = r.record | {"info": info}
            records.append((r.key, r.retry_above, *map(record.__getitem__, NAMES)))
            for number, fix in enumerate(r.fixes):
                row = {**fix, "run": run, "number": number}
                fixes.append((r.key, *(row[column.name] for column in FIX_COLUMNS)))
            if r.series is not None:
                curves.append((r.key, run, _pack(r.series), _pack(r.detail)))
        self._write({"records": records, "fixes": fixes, "curves": curves})

    def finished(self, limit: float = np.inf) -> dict[str, np.ndarray]:
        """Return, by key, the runs whose results a time limit [s] leaves as they are."""
        lost: dict[str, list[int]] = {}
        query = "SELECT key, run FROM records WHERE retry_above < ?"
        for key, run in self._select(query, (limit,)):
            lost.setdefault(key, []).append(run)
        found = {}
        for (key,) in self._select("SELECT DISTINCT key FROM records"):
            rows = self._select("SELECT run FROM records WHERE key = ?", (key,))
            runs = np.fromiter((run for (run,) in rows), dtype=np.int64, count=len(rows))
            found[key] = np.setdiff1d(runs, lost.get(key, []))
        return {key: runs for key, runs in found.items() if len(runs)}

    def records(self, key: str, runs: int, first: int = 0) -> Iterator[dict[str, Any]]:
        """Yield the records under a key of the runs from ``first`` to below ``runs``, in order."""
        query = (
            f"SELECT {', '.join(NAMES)} FROM records WHERE key = ? AND run >= ? AND run < ? "
            "ORDER BY run LIMIT ?"
        )
        while rows := self._select(query, (key, first, runs, _CHUNK)):
            for row in rows:
                record = BLANK | {n: v for n, v in zip(NAMES, row, strict=True) if v is not None}
                record |= {name: record[name] == 1 for name in _TRUTHS if record[name] is not None}
                try:
                    record["info"] = from_json(record["info"])
                except ValueError as error:
                    raise StoreError(
                        f"the info of a run in {self._database} is damaged: {error}"
                    ) from None
                yield record
            first = record["run"] + 1

    def runs(self, keys: Set[str], runs: int) -> pd.DataFrame:
        """Return the table of the runs below ``runs`` under some keys, in the order of both.

        ``key``, then the columns of a record that are :data:`.columns.TABLED`, in their order.
        """
        return self._table("records", TABLED, keys, runs, "key, run")

    def fixes(self, keys: Set[str], runs: int) -> dict[str, pd.DataFrame]:
        """Return the fixes of the runs below ``runs``, by the keys of estimators that make fixes.

        Tables of ``run`` and :data:`.judging.fix_metrics.ROWS`, in the order of runs and fixes.
        """
        query = "SELECT DISTINCT key FROM records WHERE fixes IS NOT NULL AND run < ?"
        makers = keys & {key for (key,) in self._select(query, (runs,))}
        columns = [column for column in FIX_COLUMNS if column.tabled]
        table = self._table("fixes", columns, makers, runs, "key, run, number")
        of_key = table.pop("key")
        return {key: table[of_key == key].reset_index(drop=True) for key in makers}

    def _table(
        self, name: str, columns: Sequence[Column], keys: Set[str], runs: int, order: str
    ) -> pd.DataFrame:
        """Return some columns of a table of the database, with the keys before them."""
        import pandas as pd  # not at the top: workers and campaigns make no tables

        query = (
            f"SELECT key, {', '.join(column.selected for column in columns)} FROM {name} "
            f"WHERE key IN ({', '.join('?' * len(keys))}) AND run < ? ORDER BY {order}"
        )
        types = {column.name: column.dtype for column in columns if column.dtype}
        try:
            pieces = pd.read_sql(
                query, self._connection, params=[*keys, runs], dtype=types, chunksize=_PIECE
            )
            return pd.concat(pieces, ignore_index=True)
        except (sqlite3.Error, pd.errors.DatabaseError) as error:
            raise StoreError(f"{self._database} cannot be read: {text_of(error)}") from None

    def series(self, key: str, runs: int) -> np.ndarray:
        """Return (runs, K', 4): position and velocity error [m, m/s], NEES, NIS of finished runs.

        K' are the epochs that ``kept`` of the shared arrays names.
        """
        rows = self._select(
            "SELECT series FROM curves WHERE key = ? AND run < ? ORDER BY run", (key, runs)
        )
        found = [_unpack(blob, 4) for (blob,) in rows]
        if len({len(run) for run in found}) > 1:
            raise StoreError(f"a time series in {self._database} is damaged")
        return np.array(found)

    def series_of(self, key: str, run: int) -> np.ndarray | None:
        """Return (K', 4) of one run, or None if it has none."""
        return self._blob("series", key, run, 4)

    def detail(self, key: str, run: int) -> np.ndarray | None:
        """Return (K, 18) of a run kept in detail.

        Errors of position and velocity, their σ, and those of the gravity disturbance [m/s²], NaN
        where it is no state.
        """
        return self._blob("detail", key, run, 18)

    def _blob(self, column: str, key: str, run: int, width: int) -> np.ndarray | None:
        found = self._select(f"SELECT {column} FROM curves WHERE key = ? AND run = ?", (key, run))
        return None if not found or found[0][0] is None else _unpack(found[0][0], width)

    def write_arrays(self, key: str, arrays: Mapping[str, np.ndarray]) -> None:
        """Store what all runs of a case share."""
        content = io.BytesIO()
        np.savez_compressed(content, allow_pickle=False, **arrays)
        self._write({"shared": [(key, content.getvalue())]})

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
                f"what the runs of case {case} share, in {self._database}, "
                f"cannot be read: {text_of(error)}"
            ) from None
        if flaw := flaw_of_arrays(arrays):
            raise StoreError(
                f"what the runs of case {case} share, in {self._database}, is damaged: {flaw}"
            )
        return arrays

    def _select(self, query: str, values: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
        try:
            return self._connection.execute(query, values).fetchall()
        except sqlite3.Error as error:
            raise StoreError(f"{self._database} cannot be read: {text_of(error)}") from None

    def _write(self, rows: Mapping[str, Sequence[tuple[Any, ...]]]) -> None:
        """Write rows of tables in one transaction, in place of those of the same keys."""
        try:
            with self._connection:
                for table, values in rows.items():
                    if values:
                        marks = ", ".join("?" * len(values[0]))
                        query = f"INSERT OR REPLACE INTO {table} VALUES ({marks})"
                        self._connection.executemany(query, values)
        except (sqlite3.Error, ValueError) as error:  # of a text with half a character
            raise StoreError(
                f"cannot write to {self.folder}: {error}; what it holds is kept, and the same "
                "command goes on from there"
            ) from None

    def write_manifest(self, manifest: Mapping[str, Any]) -> None:
        """Write the manifest, and next to it the scenario's text for a human reader."""
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
            _sync(self.folder)
        except OSError as error:
            temporary.unlink(missing_ok=True)
            raise StoreError(f"cannot write {self.folder / name}: {reason_of(error)}") from None

    def remove(self, name: str) -> None:
        """Take a file out of the folder, if it is there."""
        try:
            (self.folder / name).unlink(missing_ok=True)
        except OSError as error:
            raise StoreError(f"cannot remove {self.folder / name}: {error.strerror}") from None


def require_ours(folder: Path) -> None:
    """Raise StoreError if a folder exists and holds anything but what a campaign left there.

    Ours is one with our database or a manifest of ours (whatever else is next to them),
    or with nothing but what a campaign makes first.
    """
    try:
        names = {path.name for path in folder.iterdir()} if folder.is_dir() else set()
        database, manifest = folder / "records.sqlite", folder / "manifest.json"
        size = database.stat().st_size if database.is_file() else 0
        if size:
            with database.open("rb") as file:
                if file.read(72)[68:] == _APPLICATION_ID.to_bytes(4, "big"):
                    return
        if manifest.is_file() and all(w in manifest.read_bytes() for w in _MANIFEST_MARKS):
            return
    except OSError as error:
        raise StoreError(f"cannot use results folder {folder}: {error.strerror}") from None
    first = {LOCK, *DATABASE_FILES} if size == 0 else {LOCK}
    if any(name not in first and not _PART.fullmatch(name) for name in names):
        raise StoreError(
            f"{folder} is not empty and holds no results; choose another output folder"
        )


def read_manifest(folder: Path) -> dict[str, Any]:
    """Return the manifest of a results folder.

    Raise StoreError if it cannot be read, is damaged or of another format.
    """
    path = folder / "manifest.json"
    try:
        manifest = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise StoreError(f"cannot read {path}: {error.strerror}") from None
    except (ValueError, RecursionError) as error:
        raise StoreError(f"{path} is damaged: {text_of(error)}") from None
    if isinstance(manifest, dict) and manifest.get("format") != FORMAT:
        raise StoreError(
            f"{path} has format {manifest.get('format')!r}, and this version of ggbench reads "
            f"format {FORMAT}: run the scenario again, with --fresh or into another output folder"
        )
    if flaw := flaw_of_manifest(manifest):
        raise StoreError(f"{path} is damaged: {flaw}")
    return manifest


def _remove_left(folder: Path, all_of_them: bool) -> None:
    """Remove what a stopped process left half written, or all files of earlier campaigns."""
    for path in folder.iterdir():
        if _PART.fullmatch(path.name):
            path.unlink()
    for name in RESULT_FILES if all_of_them else ():
        (folder / name).unlink(missing_ok=True)


def _sync(folder: Path) -> None:
    """Write a folder's list of files through to the disk."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _pack(array: np.ndarray | None) -> bytes | None:
    if array is None:
        return None
    return np.ascontiguousarray(array, dtype="<f4").tobytes()


def _unpack(blob: bytes, columns: int) -> np.ndarray:
    return np.frombuffer(blob, dtype="<f4").reshape(-1, columns).astype(float)


def _tables(connection: sqlite3.Connection) -> set[str]:
    """Return the definitions of the tables and indices of a database."""
    found = connection.execute("SELECT sql FROM sqlite_master WHERE sql IS NOT NULL")
    return {sql for (sql,) in found}
