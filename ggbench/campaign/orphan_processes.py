"""Termination of processes that an estimator has started and left running.

Processes that have left their process group are identified by a mark in their initial environment,
or by their parent processes.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import sys
import time
from collections.abc import Callable, Collection, Iterable

import psutil

MARK = "GGBENCH_WORKER"
"""Environment variable that identifies the descendants of a worker."""
_ROUNDS = 200
_ROUND_S = 0.005
_DEAD = (psutil.STATUS_ZOMBIE, psutil.STATUS_DEAD)
_ADOPT_ORPHANS = 36  # PR_SET_CHILD_SUBREAPER of prctl(2)


def adopt_orphans() -> None:
    """Make this process the parent of orphaned descendants; Linux only."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_ADOPT_ORPHANS, 1, 0, 0, 0)


def kill_marked(marks: Collection[str]) -> None:
    """Kill all other processes whose initial environment contains one of ``marks``."""
    _kill(psutil.process_iter, lambda process: process.environ().get(MARK) in marks)


def kill_descendants() -> int:
    """Kill all running descendants of this process, and return the number of killed processes.

    The permanent helper processes of ``multiprocessing`` are spared.
    """
    try:  # which takes no time if there is no child, running or not yet waited for
        os.waitid(os.P_ALL, 0, os.WEXITED | os.WNOHANG | os.WNOWAIT)
    except ChildProcessError:
        return 0
    tracker = sys.modules.get("multiprocessing.resource_tracker")
    server = sys.modules.get("multiprocessing.forkserver")
    helpers = {
        getattr(getattr(tracker, "_resource_tracker", None), "_pid", None),
        getattr(getattr(server, "_forkserver", None), "_forkserver_pid", None),
    }
    ended = _kill(
        lambda: psutil.Process().children(recursive=True),
        lambda process: process.pid not in helpers and process.status() not in _DEAD,
    )
    for pid in ended:
        with contextlib.suppress(ChildProcessError):
            os.waitpid(pid, os.WNOHANG)
    return len(ended)


def _kill(
    processes: Callable[[], Iterable[psutil.Process]], chosen: Callable[[psutil.Process], bool]
) -> set[int]:
    """Kill the chosen processes, repeatedly until none is found; return their identifiers."""
    ended: set[int] = set()
    for _ in range(_ROUNDS):  # a process that is just being started is found in the next round
        any_killed = False
        for process in processes():
            with contextlib.suppress(psutil.Error):  # it has ended, or is another user's
                if process.pid != os.getpid() and chosen(process):
                    any_killed = True
                    ended.add(process.pid)
                    process.kill()
        if not any_killed:
            break
        time.sleep(_ROUND_S)
    return ended
