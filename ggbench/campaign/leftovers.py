"""Processes that an estimator starts and leaves running: found, and ended.

Children are ended as a group where they stay in it; on Linux those that left it, too: they are
known by a mark in the environment with which they began, and by their parents.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import signal
import sys
import time
from collections.abc import Collection, Iterator
from pathlib import Path

MARK = "GGBENCH_WORKER"
"""Variable of the environment by which a worker's descendants are known."""
_PROCESSES = Path("/proc")
_ROUNDS = 200
_ROUND_S = 0.005
_ADOPT_ORPHANS = 36  # PR_SET_CHILD_SUBREAPER of prctl(2)


def adopt_orphans() -> None:
    """Become the parent of what a child leaves behind when it ends; on Linux only."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_ADOPT_ORPHANS, 1, 0, 0, 0)


def end_marked(marks: Collection[str]) -> None:
    """End all processes but this one whose environment holds one of the marks."""
    wanted = {f"{MARK}={mark}".encode() for mark in marks}

    def marked() -> list[int]:
        return [pid for pid in _pids() if pid != os.getpid() and wanted & set(_environment(pid))]

    for _ in range(_ROUNDS):  # what was just being started is found in the next round
        found = marked()
        if not found:
            return
        _kill(found)
        time.sleep(_ROUND_S)


def end_descendants() -> int:
    """End what was started by this process and runs still; return how many processes that were.

    What multiprocessing keeps for itself is not counted.
    """
    if not _has_children():
        return 0
    ended: set[int] = set()
    for _ in range(_ROUNDS):
        found = _descendants()
        if not found:
            break
        ended |= found
        _kill(found)
        time.sleep(_ROUND_S)
    for pid in ended:
        with contextlib.suppress(ChildProcessError):
            os.waitpid(pid, os.WNOHANG)
    return len(ended)


def _has_children() -> bool:
    """Return whether this process has a child, running or not yet waited for; takes no time."""
    try:
        os.waitid(os.P_ALL, 0, os.WEXITED | os.WNOHANG | os.WNOWAIT)
    except ChildProcessError:
        return False
    return True


def _descendants() -> set[int]:
    """Return the processes below this one that run, but for multiprocessing's own."""
    children: dict[int, list[int]] = {}
    for pid in _pids():
        try:
            told = (_PROCESSES / str(pid) / "stat").read_text()
            state, parent = told.rpartition(")")[2].split()[:2]  # after a name that may be anything
        except (OSError, ValueError):
            continue
        if state not in "ZX":
            children.setdefault(int(parent), []).append(pid)
    found: set[int] = set()
    open_ends = [os.getpid()]
    own = _of_multiprocessing()
    while open_ends:
        new = [pid for pid in children.get(open_ends.pop(), []) if pid not in own]
        found.update(new)
        open_ends += new
    return found


def _of_multiprocessing() -> set[int]:
    """Return the helpers that multiprocessing starts once and keeps."""
    tracker = sys.modules.get("multiprocessing.resource_tracker")
    server = sys.modules.get("multiprocessing.forkserver")
    pids = {
        getattr(getattr(tracker, "_resource_tracker", None), "_pid", None),
        getattr(getattr(server, "_forkserver", None), "_forkserver_pid", None),
    }
    return {pid for pid in pids if pid is not None}


def _pids() -> Iterator[int]:
    """Yield the numbers of all processes, none where there is no /proc."""
    if _PROCESSES.is_dir():
        yield from (int(path.name) for path in _PROCESSES.iterdir() if path.name.isdecimal())


def _environment(pid: int) -> list[bytes]:
    """Return the variables with which a process of ours began; of others' nothing."""
    try:
        return (_PROCESSES / str(pid) / "environ").read_bytes().split(b"\0")
    except OSError:
        return []


def _kill(pids: Collection[int]) -> None:
    for pid in pids:
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.kill(pid, signal.SIGKILL)
