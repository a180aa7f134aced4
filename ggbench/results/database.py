"""Database of a results folder: records, fixes, time series, and shared arrays of cases.

Each added result is synchronised to the disk. SQLite refuses rows that violate the declarations of
the columns (:mod:`.results.columns`).
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import sqlite3
from collections.abc import Iterable, Iterator, Mapping, Sequence, Set
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from pydantic_core import from_json

from ..errors import GGBenchError, text_of
from ..files.archives import read_arrays
from .columns import BLANK, COLUMNS, FIX_COLUMNS, NAMES, SCHEMA, TABLED, Column
from .formats import flaw_of_arrays

if TYPE_CHECKING:
    import pandas as pd

APPLICATION_ID = 0x67676231
"""Identifier of ggbench in the header of the database."""
_BUSY_S = 60.0
_PIECE = 5000
"""Number of rows that are read into a table at a time."""
_TRUTHS = tuple(column.name for column in COLUMNS if column.kind is bool)


class StoreError(GGBenchError):
    """A results folder is unusable."""


class Result(NamedTuple):
    """Result of one run of one estimator.

    Attributes
    ----------
    key : hash of all inputs of the result except the run index (:mod:`.campaign.result_keys`).
    record : record of the run, with a value for each of :data:`.columns.NAMES`.
    series : (K', 4) float32: position and velocity error [m, m/s], NEES and NIS at K' of the K
        epochs. None for a failed run, and from run 1000 on.
    detail : (K, 18) float32: errors and their σ (:meth:`Database.detail`). None for a failed run,
        and for all runs except run 0.
    fixes : fixes of a matcher, see :func:`.judging.fix_metrics.judge`.
    retry_above : time limit [s] of a run that died or was too slow; a campaign with a larger limit
        repeats the run. None if the result is final.
    """

    key: str
    record: dict[str, Any]
    series: np.ndarray | None = None
    detail: np.ndarray | None = None
    fixes: Sequence[Mapping[str, Any]] = ()
    retry_above: float | None = None


class Database:
    """Database of a results folder.

    The key of a result is a hash of all its inputs except the run index (:class:`Result`). Key and
    run index together identify a result.

    Parameters
    ----------
    path : path of the database file.
    create : whether to create a missing file, and to open it for writing.

    Raises
    ------
    StoreError
        If the file is damaged, or was written with other columns by another version.
    """

    def __init__(self, path: Path, create: bool = False) -> None:
        self.path = path
        with contextlib.ExitStack() as failure:
            try:
                self._connection = self._connect(create)
                failure.callback(self._connection.close)
                if create:
                    # In the file itself, before there is a log that it could be in instead.
                    self._connection.execute(f"PRAGMA application_id = {APPLICATION_ID}")
                    self._connection.execute("PRAGMA journal_mode = WAL")
                    if not _tables(self._connection):
                        self._connection.executescript(f"BEGIN; {SCHEMA} COMMIT")
                self._connection.execute("PRAGMA synchronous = FULL")
                self._connection.execute("PRAGMA foreign_keys = ON")
                self._require_sound()
            except sqlite3.Error as error:
                raise StoreError(f"{path} is not a usable database: {text_of(error)}") from None
            failure.pop_all()

    def _connect(self, write: bool) -> sqlite3.Connection:
        """Open the database; in a folder without write permission, open it as immutable.

        Raise StoreError if such a folder has a write-ahead log, which cannot be read there.
        """
        name = self.path.absolute().as_uri()
        if write or os.access(self.path.parent, os.W_OK):
            return sqlite3.connect(name, timeout=_BUSY_S, uri=True)
        log = self.path.with_name(f"{self.path.name}-wal")
        if log.exists() and log.stat().st_size:
            # What the log holds can be read only where its index can be made.
            raise StoreError(
                f"{self.path.parent} is read-only and its campaign was interrupted (or is "
                "running): open it once with write permission ('ggbench show'), or copy it"
            )
        return sqlite3.connect(f"{name}?immutable=1", timeout=_BUSY_S, uri=True)

    def _require_sound(self) -> None:
        """Raise StoreError unless the tables and all rows agree with the declared columns."""
        with contextlib.closing(sqlite3.connect(":memory:")) as blank:
            blank.executescript(SCHEMA)
            if _tables(blank) != _tables(self._connection):
                raise StoreError(
                    f"{self.path} comes from another version of ggbench: run the scenario again, "
                    "with --fresh or into another output folder"
                )
        # It checks the constraints of every row, too.
        (flaw,) = self._connection.execute("PRAGMA quick_check(1)").fetchone()
        if flaw != "ok":
            raise StoreError(
                f"{self.path} is damaged ({' '.join(flaw.split())}): run the scenario again, "
                "with --fresh or into another output folder"
            )

    def close(self) -> None:
        """Close the database, and merge its write-ahead log."""
        self._connection.close()

    def add(self, results: Iterable[Result]) -> None:
        """Store results in one transaction.

        Raise StoreError if they cannot be written, for example on a full disk; then none is stored.
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

    def finished(self, limit: float = np.inf, retry_failed: bool = False) -> dict[str, np.ndarray]:
        """Return, by key, the indices (N,) of the runs with a final result.

        A campaign does not repeat these runs. A result is not final if the run failed at a lower
        time limit than ``limit`` [s]. With ``retry_failed`` no failure is final.
        """
        to_repeat: dict[str, list[int]] = {}
        query = "SELECT key, run FROM records WHERE retry_above < ?"
        query += " OR status = 'failed'" if retry_failed else ""
        for key, run in self._select(query, (limit,)):
            to_repeat.setdefault(key, []).append(run)
        by_key = {}
        for (key,) in self._select("SELECT DISTINCT key FROM records"):
            rows = self._select("SELECT run FROM records WHERE key = ?", (key,))
            runs = np.fromiter((run for (run,) in rows), dtype=np.int64, count=len(rows))
            by_key[key] = np.setdiff1d(runs, to_repeat.get(key, []))
        return {key: runs for key, runs in by_key.items() if len(runs)}

    def records(self, key: str, runs: int, first: int = 0) -> Iterator[dict[str, Any]]:
        """Yield the records with a key, for the runs ``first`` to ``runs`` − 1 in order.

        Raise StoreError if a record is damaged.
        """
        query = (
            f"SELECT {', '.join(NAMES)} FROM records WHERE key = ? AND run >= ? AND run < ? "
            "ORDER BY run"
        )
        for row in self._select(query, (key, first, runs)):
            record = BLANK | {n: v for n, v in zip(NAMES, row, strict=True) if v is not None}
            record |= {name: record[name] == 1 for name in _TRUTHS if record[name] is not None}
            yield record | {"info": self._info(record["info"])}

    def infos(self, key: str, runs: int) -> list[dict[str, Any]]:
        """Return ``Estimate.info`` of the finished runs 0 to ``runs`` − 1 with a key.

        Raise StoreError if an ``info`` is damaged.
        """
        query = "SELECT info FROM records WHERE key = ? AND run < ? AND status = 'ok' ORDER BY run"
        return [self._info(text) for (text,) in self._select(query, (key, runs))]

    def _info(self, text: str) -> dict[str, Any]:
        try:
            info: dict[str, Any] = from_json(text)
        except ValueError as error:
            raise StoreError(f"the info of a run in {self.path} is damaged: {error}") from None
        return info

    def runs(self, keys: Set[str], runs: int) -> pd.DataFrame:
        """Return a table of the runs 0 to ``runs`` − 1 with these keys, sorted by key and run.

        The columns are ``key``, then those of :data:`.columns.TABLED`.
        """
        return self._table("records", TABLED, keys, runs, "key, run")

    def fixes(self, keys: Set[str], runs: int) -> dict[str, pd.DataFrame]:
        """Return, by key, tables of the position fixes in the runs 0 to ``runs`` − 1.

        Only keys of matchers have a table.
        The columns are ``run`` and :data:`.judging.fix_metrics.ROWS`, sorted by run and fix.
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
        """Return columns of a database table; the first column of the result is ``key``."""
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
            raise StoreError(f"{self.path} cannot be read: {text_of(error)}") from None

    def series(self, key: str, runs: int) -> np.ndarray:
        """Return time series (S, K', 4): position and velocity error [m, m/s], NEES, NIS.

        S is the number of the runs 0 to ``runs`` − 1 that have a time series. Only finished runs
        among the first 1000 have one (:data:`.store.SERIES_RUNS`). The array ``kept`` of the case
        has the indices of the K' epochs.

        Raise StoreError if a series is damaged.
        """
        rows = self._select(
            "SELECT series FROM curves WHERE key = ? AND run < ? ORDER BY run", (key, runs)
        )
        curves = [_unpack(blob, 4) for (blob,) in rows]
        if len({len(run) for run in curves}) > 1:
            raise StoreError(f"a time series in {self.path} is damaged")
        return np.array(curves)

    def series_of(self, key: str, run: int) -> np.ndarray | None:
        """Return the time series (K', 4) of one run, or None if none is stored.

        :meth:`series` describes the columns and the K' epochs.
        """
        return self._blob("series", key, run, 4)

    def detail(self, key: str, run: int) -> np.ndarray | None:
        """Return the error components (K, 18) of a run, or None if they are not stored.

        The columns are position and velocity errors, their σ, and errors and σ of the gravity
        disturbance [m/s²], all in ENU. The last six are NaN if the gravity disturbance is no state.
        """
        return self._blob("detail", key, run, 18)

    def _blob(self, column: str, key: str, run: int, width: int) -> np.ndarray | None:
        rows = self._select(f"SELECT {column} FROM curves WHERE key = ? AND run = ?", (key, run))
        return None if not rows or rows[0][0] is None else _unpack(rows[0][0], width)

    def write_arrays(self, key: str, arrays: Mapping[str, np.ndarray]) -> None:
        """Store the arrays (K,) or (K, m) that all runs of a case share."""
        content = io.BytesIO()
        np.savez_compressed(content, allow_pickle=False, **arrays)
        self._write({"shared": [(key, content.getvalue())]})

    def has_arrays(self, key: str) -> bool:
        """Return whether the shared arrays of a case are stored."""
        return bool(self._select("SELECT 1 FROM shared WHERE key = ?", (key,)))

    def arrays(self, key: str, case: str) -> dict[str, np.ndarray]:
        """Return the shared arrays (K,) or (K, m); ``case`` is the name of the case in messages.

        Raise StoreError if the arrays are missing or damaged.
        """
        rows = self._select("SELECT arrays FROM shared WHERE key = ?", (key,))
        if not rows:
            raise StoreError(
                f"{self.path.parent} lacks the shared data of case {case}, because the command "
                "was interrupted; the same command resumes"
            )
        what = f"the shared data of case {case} in {self.path}"
        arrays = read_arrays(rows[0][0], StoreError, what)
        if flaw := flaw_of_arrays(arrays):
            raise StoreError(f"{what} is damaged: {flaw}")
        return arrays

    def _select(self, query: str, values: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
        try:
            return self._connection.execute(query, values).fetchall()
        except sqlite3.Error as error:
            raise StoreError(f"{self.path} cannot be read: {text_of(error)}") from None

    def _write(self, rows: Mapping[str, Sequence[tuple[Any, ...]]]) -> None:
        """Write rows of tables in one transaction; rows with equal primary keys are replaced."""
        try:
            with self._connection:
                for table, values in rows.items():
                    if values:
                        marks = ", ".join("?" * len(values[0]))
                        query = f"INSERT OR REPLACE INTO {table} VALUES ({marks})"
                        self._connection.executemany(query, values)
        except (sqlite3.Error, ValueError) as error:  # of a text with half a character
            raise StoreError(
                f"cannot write to {self.path.parent}: {error}; stored runs are kept, and the "
                "same command resumes"
            ) from None


def _pack(array: np.ndarray | None) -> bytes | None:
    if array is None:
        return None
    return np.ascontiguousarray(array, dtype="<f4").tobytes()


def _unpack(blob: bytes, columns: int) -> np.ndarray:
    return np.frombuffer(blob, dtype="<f4").reshape(-1, columns).astype(float)


def _tables(connection: sqlite3.Connection) -> set[str]:
    """Return the definitions of the tables and indices of a database."""
    statements = connection.execute("SELECT sql FROM sqlite_master WHERE sql IS NOT NULL")
    return {sql for (sql,) in statements}
