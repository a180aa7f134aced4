"""A process of its own for runs: what an estimator does to it is its own affair.

The parent gives a :class:`Worker` one task at a time and receives, as they come, who has started
and what has finished. A worker that dies or must be killed takes only the runs in flight with it.
It ends by itself when its parent is gone.
"""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from multiprocessing.connection import Connection, Pipe
from typing import Any

from ..errors import GGBenchError

_WATCH_S = 1.0
_PATIENCE_S = 2.0
ONE_THREAD = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")
"""Environment of one BLAS thread: more double the processor time for nothing on small matrices."""


class Ready:
    """Says that the worker can be given a task."""


class WorkerDiedError(Exception):
    """The process has ended; the text says how."""


class Worker:
    """The parent's side of a worker process, which starts with it.

    ``connection`` becomes readable when there is something to receive.
    """

    def __init__(self) -> None:
        self.connection, theirs = Pipe()
        with interrupts_held():
            self._process = subprocess.Popen(
                # -P: no module of the folder that the user is in can stand in for one of ours.
                [sys.executable, "-P", "-m", __name__, str(theirs.fileno())],
                pass_fds=[theirs.fileno()],
                stdin=subprocess.DEVNULL,
                env=os.environ | ONE_THREAD,
                process_group=0,  # so that what an estimator starts ends with it
            )
        theirs.close()

    def give(self, task: Any) -> None:
        """Give the worker a task. That it has died meanwhile is told by ``receive``."""
        with contextlib.suppress(OSError):
            self.connection.send(task)

    def receive(self) -> Any:
        """Return the next message: what ``run_task`` yields, ``Ready``, or an error of the user's.

        Raises
        ------
        WorkerDiedError
            If the process has ended.
        """
        try:
            return self.connection.recv()
        except (EOFError, OSError):
            raise WorkerDiedError(self._how_it_ended()) from None

    def check(self) -> None:
        """Raise WorkerDiedError if the process has ended and nothing is left to receive.

        Its pipe alone does not say so: a process that it has started may still hold it.
        """
        if self._process.poll() is not None and not self.connection.poll():
            raise WorkerDiedError(self._how_it_ended())

    def kill(self) -> None:
        """End the process at once."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()
        self.connection.close()

    def _how_it_ended(self) -> str:
        try:
            code = self._process.wait(timeout=_PATIENCE_S)
        except subprocess.TimeoutExpired:  # it closed its pipe, and lives
            self.kill()
            return "its process broke off the connection"
        if code < 0:
            return f"its process was killed by {signal.Signals(-code).name}"
        return f"its process ended with exit code {code}"


@contextlib.contextmanager
def interrupts_held() -> Iterator[None]:
    """Hold Ctrl-C back; processes started meanwhile never receive it.

    The parent decides what an interrupt means.
    """
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _end_with_parent() -> None:
    """End this process when its parent has ended, even in the middle of an endless run."""
    parent = os.getppid()

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(_WATCH_S)
        os.killpg(0, signal.SIGKILL)

    threading.Thread(target=watch, daemon=True).start()


def main(descriptor: int) -> None:
    """Run the tasks that arrive, until there will be no more."""
    _end_with_parent()
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # stdout is the campaign's own
    from .runner import run_task

    connection, mine = Connection(descriptor), os.getpid()

    def send(message: object) -> None:
        if os.getpid() != mine:  # an estimator forked, and its copy came back, too
            os._exit(1)
        connection.send(message)

    with contextlib.suppress(EOFError, ConnectionError):
        while True:
            send(Ready())
            task = connection.recv()
            try:
                for message in run_task(task):
                    send(message)
            except GGBenchError as error:
                send(error)


if __name__ == "__main__":
    # As the module that the parent knows, so that messages are of the same classes on both sides.
    from . import worker

    worker.main(int(sys.argv[1]))
