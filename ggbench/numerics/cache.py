"""Where compiled code is kept: apart for every version of its source.

Numba knows that a function's own file has changed, but not that of a function which it inlines
from another one, and would go on with the old formula. So the folder is named after the source of
the rooms that hold compiled code.
"""

from __future__ import annotations

import contextlib
import os
import re
import shutil
import sys
from pathlib import Path

import platformdirs

from .source import COMPILED_ROOMS, source_hash

CACHE_VARIABLE = "GGBENCH_CACHE_DIR"
"""Environment variable that names another cache folder than the user's."""
_VARIABLE = "NUMBA_CACHE_DIR"
_OURS = re.compile(r"ggbench-[0-9a-f]{16}")
_MOST_KEPT = 5


def cache_folder() -> Path:
    """Return the folder of everything that can be made again: maps, compiled code."""
    return Path(os.environ.get(CACHE_VARIABLE) or platformdirs.user_cache_path("ggbench"))


def keep_apart() -> None:
    """Have numba keep what it compiles in a folder of this source; before anything is compiled."""
    name = f"ggbench-{source_hash(*COMPILED_ROOMS)}"
    base = Path(os.environ.get(_VARIABLE) or cache_folder() / "numba")
    if _OURS.fullmatch(base.name):  # a process that this package started
        base = base.parent
    folder = base / name
    os.environ[_VARIABLE] = str(folder)
    if "numba" in sys.modules:
        sys.modules["numba"].config.CACHE_DIR = str(folder)
    with contextlib.suppress(OSError):  # without a folder numba finds another place, or none
        if not folder.exists():
            folder.mkdir(parents=True)
            _remove_old(base)


def _remove_old(base: Path) -> None:
    """Remove all but the newest folders of other sources."""
    ours = [f for f in base.iterdir() if _OURS.fullmatch(f.name) and f.is_dir()]
    folders = sorted(ours, key=lambda f: f.stat().st_mtime, reverse=True)
    for folder in folders[_MOST_KEPT:]:
        shutil.rmtree(folder, ignore_errors=True)
