"""Where compiled code is kept: apart for every version of its source.

Numba knows that a function's own file has changed, but not that of a function which it inlines
from another one, and would go on with the old formula. So what is compiled from a module is kept
in a folder named after that module's source and all that it imports: a change of one module is
compiled anew where it matters, and every process and checkout that has the same source shares what
is there.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import re
import shutil
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import platformdirs

from .source import COMPILED_ROOMS, PACKAGE, module_hash, source_hash

CACHE_VARIABLE = "GGBENCH_CACHE_DIR"
"""Environment variable that names another cache folder than the user's."""
_VARIABLE = "NUMBA_CACHE_DIR"
_OURS = re.compile(r"(ggbench[\w.]*)-[0-9a-f]{16}")
_MOST_KEPT = 5
"""Folders of a module, of its newest sources."""


def cache_folder() -> Path:
    """Return the folder of everything that can be made again: maps, compiled code."""
    return Path(os.environ.get(CACHE_VARIABLE) or platformdirs.user_cache_path("ggbench"))


@cache
def code_folder(file: Path) -> Path:
    """Return the folder, not yet made, of what is compiled from a module, of its present source."""
    parts = file.relative_to(PACKAGE).with_suffix("").parts if PACKAGE in file.parents else ()
    name = ".".join(("ggbench", *(parts or ("user", re.sub(r"\W", "_", file.stem)))))
    return _base() / f"{name}-{module_hash(file)}"


def make_code_folder(folder: Path) -> None:
    """Make a folder of compiled code, and remove those of its module's former sources.

    Raises OSError if it cannot be made.
    """
    if not folder.exists():
        folder.mkdir(parents=True, exist_ok=True)
        _remove_old(folder)


@contextlib.contextmanager
def alone(file: Path) -> Iterator[None]:
    """Make a file of the cache while no other process makes it: who waited may find it there.

    The lock is a file of its own beside it, and ends with the process. Where there can be no lock,
    work may be done twice.
    """
    with contextlib.ExitStack() as until:
        with contextlib.suppress(OSError):
            file.parent.mkdir(parents=True, exist_ok=True)
            lock = until.enter_context(file.with_name(f"{file.name}.lock").open("w"))
            fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def keep_apart() -> None:
    """Have numba keep what users' files compile by themselves in a folder of this source, too.

    Before anything is compiled. Such functions may inline the package's.
    """
    folder = _base() / f"ggbench-{source_hash(*COMPILED_ROOMS)}"
    os.environ[_VARIABLE] = str(folder)
    if "numba" in sys.modules:
        sys.modules["numba"].config.CACHE_DIR = str(folder)
    with contextlib.suppress(OSError):  # without a folder numba finds another place, or none
        make_code_folder(folder)


def _base() -> Path:
    base = Path(os.environ.get(_VARIABLE) or cache_folder() / "numba")
    # A process that this package started has its folder.
    return base.parent if _OURS.fullmatch(base.name) else base


def _remove_old(folder: Path) -> None:
    """Remove all but the newest folders of other sources of a folder's module."""
    module = folder.name.rpartition("-")[0]
    ours = [
        other
        for other in folder.parent.iterdir()
        if (name := _OURS.fullmatch(other.name)) and name[1] == module and other.is_dir()
    ]
    folders = sorted(ours, key=lambda f: f.stat().st_mtime, reverse=True)
    for other in folders[_MOST_KEPT:]:
        shutil.rmtree(other, ignore_errors=True)
