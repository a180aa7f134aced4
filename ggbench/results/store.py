"""Results folder with atomic writes.

``manifest.json``   text of the scenario, versions, machine, seed, date, and keys of the results.
``records.sqlite``  results (:mod:`.results.database`).

All other files of a folder are derived from these two. No file of a results folder is ever
executed.
"""

from __future__ import annotations

import contextlib
import fcntl
import io
import json
import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import text_of
from ..files.writing import reason_of
from .database import APPLICATION_ID, Database, StoreError
from .formats import flaw_of_manifest

DETAILED_RUN = 0
"""Index of the run whose error components and reported σ are stored for figures."""
MOST_KEPT = 400
"""Most epochs of the stored time series of a run."""
SERIES_RUNS = 1000
"""Number of runs of a case, from run 0, whose time series are stored."""
FORMAT = 6
"""Version of the folder's format, except for the columns of records; others are refused."""
DATABASE_FILES = (
    "records.sqlite-journal",
    "records.sqlite-shm",
    "records.sqlite-wal",
    "records.sqlite",
)
"""Files of the database in the order of removal; a remaining log would alter a new database."""
RESULT_FILES = (
    *DATABASE_FILES,
    "scenario.toml",
    "metrics.csv",
    "pairs.csv",
    "cases.csv",
    "assumptions.csv",
    "failures.csv",
    "fixes.csv",
    "runs.parquet",
    "runs.csv",
    "manifest.json",
)
"""Files of results in the order of removal; the manifest, which identifies a folder, is last."""
LOCK = ".lock"
_PART = re.compile(rf"\.({'|'.join(map(re.escape, RESULT_FILES))})\.\d+\.part")
_MANIFEST_MARKS = (b'"format"', b'"results_version"', b'"scenario_hash"')


def kept_epochs(epochs: int) -> np.ndarray:
    """Return the indices (K',) of the epochs with stored time series.

    If there are at most :data:`MOST_KEPT` epochs, all are stored. Otherwise :data:`MOST_KEPT`
    evenly spread epochs are stored.
    """
    numbers = np.linspace(0, epochs - 1, min(epochs, MOST_KEPT))
    return np.round(numbers).astype(int)


class Store(Database):
    """A results folder: the database and the other files.

    Parameters
    ----------
    folder : path of the results folder.
    create : whether to create a missing folder and database, and to lock the folder against other
        processes.
    fresh : whether to remove the result files of an earlier campaign first.

    Raises
    ------
    StoreError
        If the folder does not exist, is in use by another process, or is damaged.
    """

    def __init__(self, folder: Path, create: bool = False, fresh: bool = False) -> None:
        self.folder = folder
        self._locked: io.BufferedWriter | None = None
        # An exception keeps this object, and with it the lock, until it is collected.
        with contextlib.ExitStack() as failure:
            failure.callback(self._leave)
            try:
                if create:
                    new = not folder.exists()
                    folder.mkdir(parents=True, exist_ok=True)
                    if new:
                        _sync(folder.parent)
                    self._lock()
                    _remove_left(folder, all_of_them=fresh)
                elif not (folder / "records.sqlite").exists():
                    raise StoreError(f"{folder} holds no results: it has no records.sqlite")
                super().__init__(folder / "records.sqlite", create)
            except OSError as error:
                raise StoreError(f"cannot use results folder {folder}: {error.strerror}") from None
            failure.pop_all()

    def _lock(self) -> None:
        """Lock the folder for this process; the lock ends with the process at the latest.

        Raise StoreError if another process has locked the folder.
        """
        self._locked = (self.folder / LOCK).open("wb")
        try:
            fcntl.flock(self._locked, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise StoreError(
                f"another ggbench is running in {self.folder}; wait for it or choose another "
                "output folder"
            ) from None

    def close(self) -> None:
        """Close the database and unlock the folder."""
        super().close()
        self._leave()

    def _leave(self) -> None:
        """Unlock the folder for other processes."""
        if self._locked is not None:
            self._locked.close()

    def write_manifest(self, manifest: Mapping[str, Any]) -> None:
        """Write the manifest, and the scenario file for human readers."""
        self.write("manifest.json", (json.dumps(manifest, indent=1) + "\n").encode())
        self.write("scenario.toml", manifest["scenario_text"].encode())

    def write(self, name: str, content: bytes) -> None:
        """Write a file into the folder atomically, and synchronise it to the disk.

        Raise StoreError if the file cannot be written.
        """
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
        """Remove a file from the folder if it exists.

        Raise StoreError if the file cannot be removed.
        """
        try:
            (self.folder / name).unlink(missing_ok=True)
        except OSError as error:
            raise StoreError(f"cannot remove {self.folder / name}: {error.strerror}") from None


def require_ours(folder: Path) -> None:
    """Raise StoreError if the folder exists and is no results folder.

    A results folder contains the database or a ggbench manifest, and possibly other files. An empty
    folder passes too, and so does a folder with only the first files of a campaign: the lock, an
    empty database, or partly written files.
    """
    try:
        names = {path.name for path in folder.iterdir()} if folder.is_dir() else set()
        database, manifest = folder / "records.sqlite", folder / "manifest.json"
        size = database.stat().st_size if database.is_file() else 0
        if size:
            with database.open("rb") as file:
                if file.read(72)[68:] == APPLICATION_ID.to_bytes(4, "big"):
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

    Raise StoreError if the manifest cannot be read, is damaged or has another format.
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
            f"{path} has format {manifest.get('format')!r}, but this version of ggbench reads "
            f"format {FORMAT}: run the scenario again, with --fresh or into another output folder"
        )
    if flaw := flaw_of_manifest(manifest):
        raise StoreError(f"{path} is damaged: {flaw}")
    return manifest


def _remove_left(folder: Path, all_of_them: bool) -> None:
    """Remove partly written files; with ``all_of_them``, also the files of earlier campaigns."""
    for path in folder.iterdir():
        if _PART.fullmatch(path.name):
            path.unlink()
    for name in RESULT_FILES if all_of_them else ():
        (folder / name).unlink(missing_ok=True)


def _sync(folder: Path) -> None:
    """Synchronise the directory entries of a folder to the disk."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
