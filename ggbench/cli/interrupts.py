"""Interrupts: the first ends the command, the second ends the process at once.

After the first interrupt, ``ggbench run`` still summarises the finished runs.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
from collections.abc import Iterator

from ..files.writing import asked_to_end, remove_temporary

_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_SHOW_CURSOR = b"\x1b[?25h"


@contextlib.contextmanager
def requests_to_end(exit_code: int) -> Iterator[None]:
    """Convert the first of Ctrl-C, SIGTERM and SIGHUP to a KeyboardInterrupt.

    A second signal kills all worker processes and ends the process with ``exit_code``. Stored
    results stay complete. A signal that is already ignored stays ignored (``nohup``).
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    asked_to_end.clear()

    def ask(number: int, frame: object) -> None:
        if asked_to_end.is_set():
            _end_at_once(exit_code)
        asked_to_end.set()
        raise KeyboardInterrupt

    before = {
        each: signal.signal(each, ask)
        for each in _SIGNALS
        if signal.getsignal(each) is not signal.SIG_IGN
    }
    try:
        yield
    finally:
        # Else the process is about to end: it does so as it was asked to.
        if not asked_to_end.is_set():
            for each, handler in before.items():
                signal.signal(each, handler)


def _end_at_once(exit_code: int) -> None:
    worker = sys.modules.get("ggbench.campaign.worker")  # if there can be any
    try:
        remove_temporary()
        if worker is not None:
            worker.kill_all()
        # Not through Python's own streams, in the middle of whose work this may be.
        if os.isatty(1):
            os.write(1, _SHOW_CURSOR)
        os.write(2, b"Ended at once.\n")
    finally:
        os._exit(exit_code)
