"""Cache folders of compiled code, one for each version of a module's source.

Numba detects a change in the file of a function, but not in the file of an inlined function, and
would use outdated code. Therefore the name of a module's folder is a hash of the source of the
module and of all its imports. A change recompiles only affected modules. All processes and
checkouts with equal source share a folder.
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

from .source import COMPILED_ROOMS, PACKAGE, module_hash, rooms_hash

CACHE_VARIABLE = "GGBENCH_CACHE_DIR"
"""Environment variable with the path of a cache folder to use instead of the user's."""
_VARIABLE = "NUMBA_CACHE_DIR"
_OURS = re.compile(r"(ggbench[\w.]*)-[0-9a-f]{16}")
MOST_KEPT = 5
"""Number of folders that are kept for each module; older ones are removed."""


def cache_folder() -> Path:
    """Return the cache folder, which contains maps and compiled code."""
    return Path(os.environ.get(CACHE_VARIABLE) or platformdirs.user_cache_path("ggbench"))


@cache
def code_folder(file: Path) -> Path:
    """Return the folder of the compiled code of a module; the folder may not exist yet."""
    parts = file.relative_to(PACKAGE).with_suffix("").parts if PACKAGE in file.parents else ()
    name = ".".join(("ggbench", *(parts or ("user", re.sub(r"\W", "_", file.stem)))))
    return _base() / f"{name}-{module_hash(file)}"


def make_code_folder(folder: Path) -> None:
    """Create a folder of compiled code, and remove the oldest folders of the same module.

    Raises
    ------
    OSError
        If the folder cannot be created.
    """
    if not folder.exists():
        folder.mkdir(parents=True, exist_ok=True)
        _remove_old(folder)


@contextlib.contextmanager
def exclusive_lock(file: Path) -> Iterator[None]:
    """Lock a file of the cache: within this context no other process writes it.

    Another process may have written the file while this process waited. The lock is a file in the
    same folder. It is released at the end of the context, or if the process ends earlier. If the
    folder is not writable there is no lock, and two processes may do the same work.
    """
    with contextlib.ExitStack() as until:
        with contextlib.suppress(OSError):
            file.parent.mkdir(parents=True, exist_ok=True)
            lock = until.enter_context(file.with_name(f"{file.name}.lock").open("w"))
            fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def use_versioned_numba_cache() -> None:
    """Set numba's cache folder to a folder for the present source of the package.

    Call this function before any compilation. Numba stores the functions that users compile in this
    folder. Such a function may inline functions of the package, so it must be compiled again if
    their source changes.
    """
    folder = _base() / f"ggbench-{rooms_hash(*COMPILED_ROOMS)}"
    os.environ[_VARIABLE] = str(folder)
    if "numba" in sys.modules:
        sys.modules["numba"].config.CACHE_DIR = str(folder)
    with contextlib.suppress(OSError):  # without a folder numba finds another place, or none
        make_code_folder(folder)


def _base() -> Path:
    base = Path(os.environ.get(_VARIABLE) or cache_folder() / "numba")
    # A process that this package started has inherited its folder.
    return base.parent if _OURS.fullmatch(base.name) else base


def _remove_old(folder: Path) -> None:
    """Remove all but the newest folders of the same module."""
    module = folder.name.rpartition("-")[0]
    ours = [
        other
        for other in folder.parent.iterdir()
        if (name := _OURS.fullmatch(other.name)) and name[1] == module and other.is_dir()
    ]
    folders = sorted(ours, key=lambda f: f.stat().st_mtime, reverse=True)
    for other in folders[MOST_KEPT:]:
        shutil.rmtree(other, ignore_errors=True)
