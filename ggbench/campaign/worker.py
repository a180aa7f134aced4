"""Worker process that isolates estimators from the campaign.

The parent gives a :class:`Worker` one task at a time and receives messages about started estimators
and finished runs. The death of a worker affects only the runs in progress. All processes that an
estimator has started end with the worker. A worker ends when its parent ends.
"""

from __future__ import annotations

import contextlib
import ctypes
import io
import os
import signal
import socket
import subprocess
import sys
import threading
import time
import uuid
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import GGBenchError
from . import orphan_processes
from .captured_output import CapturedOutput
from .messages import GarbledError, Inbox, packed

if TYPE_CHECKING:
    from ..results.database import Result

_WATCH_S = 1.0
_PATIENCE_S = 2.0
_PIECE = 1 << 20
_OOM_SCORE = 800
"""Score of a worker, out of 1000, for the kernel's out-of-memory killer (``oom_score_adj``)."""
ONE_THREAD = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")
"""Environment for one BLAS thread: more threads double the processor time of small matrices."""
living_workers: set[Worker] = set()


class Ready:
    """Message: the worker is ready for the next task."""


class WorkerDiedError(Exception):
    """A worker process has ended or is unusable; the message states the cause."""


class Worker:
    """The parent's handle of a worker process; creation starts the process."""

    def __init__(self) -> None:
        self._socket, theirs = socket.socketpair()
        self._inbox = Inbox()
        self._mark = uuid.uuid4().hex
        reading, writing = os.pipe()
        self.output = CapturedOutput(reading, _seam(self._mark))
        try:
            with interrupts_held():
                self._process = subprocess.Popen(
                    # -P: no module of the folder that the user is in can stand in for one of ours.
                    [sys.executable, "-P", "-m", __name__, str(theirs.fileno()), str(os.getpid())],
                    pass_fds=[theirs.fileno()],
                    stdin=subprocess.DEVNULL,
                    stdout=writing,
                    stderr=writing,
                    env=os.environ | ONE_THREAD | {orphan_processes.MARK: self._mark},
                    # So that what an estimator starts ends with it, and reaches no terminal.
                    start_new_session=True,
                )
                living_workers.add(self)
        except BaseException:
            self._socket.close()
            self.output.close()
            raise
        finally:
            theirs.close()
            os.close(writing)

    @property
    def readable(self) -> list[int]:
        """File descriptors of the connections for messages and for printed output."""
        return [self._socket.fileno(), *self.output.readable]

    def give(self, task: Any) -> None:
        """Send a task to the worker; if the process is dead, :meth:`receive` raises an error."""
        with contextlib.suppress(OSError):
            self._socket.sendall(packed(task))

    def receive(self) -> Iterator[Any]:
        """Yield the received messages: output of :func:`.runner.run_task`, ``Ready``, or an error.

        A yielded error is a :class:`GGBenchError` of the worker. Raise WorkerDiedError if the
        process has ended and no message is left, or if it has sent invalid bytes.
        """
        # Asked first. The pipe alone does not say so: a process that it started may still hold it.
        ended = self._process.poll() is not None
        self.output.read()
        try:
            while True:
                piece = self._socket.recv(_PIECE, socket.MSG_DONTWAIT)
                if not piece:
                    raise WorkerDiedError(self._how_it_ended())
                yield from self._inbox.take(piece)
        except BlockingIOError:
            if ended:
                raise WorkerDiedError(self._how_it_ended()) from None
        except GarbledError:
            raise WorkerDiedError(
                "its process sent invalid results: the estimator wrote to the socket for results"
            ) from None
        except OSError:
            raise WorkerDiedError(self._how_it_ended()) from None

    def kill(self) -> None:
        """End the worker process and all processes that it has started."""
        kill([self])

    def _how_it_ended(self) -> str:
        try:
            code = self._process.wait(timeout=_PATIENCE_S)
        except subprocess.TimeoutExpired:  # it closed its pipe, and lives
            return "its process closed the connection"
        if code < 0:
            return f"its process was killed by {signal.Signals(-code).name}"
        return f"its process ended with exit code {code}"

    def _let_go(self) -> None:
        self._process.wait()
        self._socket.close()
        self.output.close()
        living_workers.discard(self)


def kill(workers: Collection[Worker]) -> None:
    """End worker processes and all processes that they have started."""
    _end(workers)
    for worker in workers:
        worker._let_go()


def _end(workers: Collection[Worker]) -> None:
    for worker in workers:
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(worker._process.pid, signal.SIGKILL)
    orphan_processes.kill_marked([worker._mark for worker in workers])


def kill_surely(workers: Collection[Worker]) -> None:
    """End worker processes and all processes that they have started, even if Ctrl-C interrupts.

    If Ctrl-C is pressed during this function, raise KeyboardInterrupt after all have ended.
    """
    interrupt: KeyboardInterrupt | None = None
    while True:
        try:
            kill(workers)
            break
        except KeyboardInterrupt as another:
            interrupt = another
    if interrupt is not None:
        raise interrupt


def kill_all() -> None:
    """End all worker processes of this process, before this process ends."""
    _end(list(living_workers))


@contextlib.contextmanager
def interrupts_held() -> Iterator[None]:
    """Defer Ctrl-C during the ``with`` block; processes started in the block never receive it.

    Only the parent process handles an interrupt.
    """
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _seam(mark: str) -> bytes:
    """Return the bytes that separate the outputs of two runs; the mark is random and unique."""
    return f"\0{mark}\0".encode()


def _end_with_parent(parent: int, mark: str) -> None:
    """End this process when its parent has ended, even in the middle of an endless run."""

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(_WATCH_S)
        orphan_processes.kill_marked([mark])
        os.killpg(0, signal.SIGKILL)

    threading.Thread(target=watch, daemon=True).start()


def _die_before_the_parent() -> None:
    """Make Linux kill this process and its children before the parent if memory runs out."""
    with contextlib.suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text(f"{_OOM_SCORE}\n", encoding="ascii")


def main(descriptor: int, parent: int) -> None:
    """Run received tasks until the parent closes the connection.

    ``descriptor`` is the file descriptor of the connection. ``parent`` is the process id of the
    parent.
    """
    mark = os.environ[orphan_processes.MARK]
    _end_with_parent(parent, mark)
    orphan_processes.adopt_orphans()
    _die_before_the_parent()
    output = os.dup(1)  # an estimator may close its own, or lead it elsewhere
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # so that a process that dies has said it
            stream.reconfigure(line_buffering=True, errors="backslashreplace")
    from .flights import fly_unseen
    from .runner import run_task

    connection, mine = socket.socket(fileno=descriptor), os.getpid()
    connection.set_inheritable(False)

    def tell(message: object) -> None:
        if os.getpid() != mine:  # an estimator forked, and its copy came back, too
            os._exit(1)
        if isinstance(message, list):
            _end_run(message, output, _seam(mark))
        connection.sendall(packed(message))

    inbox = Inbox()
    with contextlib.suppress(ConnectionError):
        tell(Ready())
        while piece := connection.recv(_PIECE):
            for task in inbox.take(piece):
                fly_unseen(task.case)
                try:
                    for message in run_task(task):
                        tell(message)
                except GGBenchError as error:
                    tell(error)
                tell(Ready())


def _end_run(results: list[Result], output: int, seam: bytes) -> None:
    """End the processes that runs have left running, flush the output, and write the seam.

    The records of these runs get a remark on the ended processes.
    """
    if count := orphan_processes.kill_descendants():
        remark = f"left {count} process{'es' * (count > 1)} running; they were ended with the run"
        for result in results:
            earlier = result.record["remark"]
            result.record["remark"] = f"{earlier}; {remark}" if earlier else remark
    for stream in (sys.__stdout__, sys.__stderr__):
        with contextlib.suppress(Exception):  # an estimator may have closed it
            if stream is not None:
                stream.flush()
    ctypes.CDLL(None).fflush(None)  # what C code holds back
    with contextlib.suppress(OSError):
        os.write(output, seam)


if __name__ == "__main__":
    # As the module that the parent knows, so that messages are of the same classes on both sides.
    from . import worker

    worker.main(int(sys.argv[1]), int(sys.argv[2]))
