"""Execution of tasks on a Dask cluster.

Each thread of a Dask worker has a separate worker process (:mod:`.campaign.worker`), which runs the
tasks. Time limits and dead processes are therefore handled as on a single machine.
"""

from __future__ import annotations

import contextlib
import itertools
import logging
import re
import socket
import threading
import time
import uuid
from collections.abc import Callable, Generator, Iterable, Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

from ..errors import GGBenchError, text_of
from ..results.database import Result
from .execution import WorkerSlot, drive
from .runner import OtherSourceError, Task, failure

if TYPE_CHECKING:
    from distributed import Client, Future

_CONNECT_S = 15.0
_PATIENCE_S = 5.0
"""Time [s] without any worker after which a remark is shown."""
_LOOK_EVERY_S = 1.0
_AHEAD = 3
"""Submitted tasks per thread of the cluster, so that no thread is idle between two tasks."""
_mine = threading.local()
Tell = Callable[[int, str], None]
"""Function that receives the number of workers, and a remark or ""."""


class ClusterError(GGBenchError):
    """The cluster cannot be used."""


def on_cluster(
    tasks: Iterable[Task], address: str, limit: float, tell: Tell = lambda workers, remark: None
) -> Generator[list[Result]]:
    """Run tasks on the cluster of a running Dask scheduler.

    ``tell`` is called with the number of workers whenever this number changes, and with a remark if
    there is no worker for five seconds. Workers may join at any time.

    If a Dask worker dies, Dask gives its task to another worker. If too many workers die in a task
    (``distributed.scheduler.allowed-failures``), the runs of this task are repeated one by one. A
    run in which workers still die is recorded as failed.

    Raise ClusterError if Dask is not installed, the scheduler cannot be reached or ends, or a
    worker has another version or source than this process.
    """
    try:
        from distributed import Client
    except ImportError:
        raise ClusterError(
            "--cluster needs Dask, which is not installed: pip install 'ggbench[cluster]'"
        ) from None
    _require_listener(address)
    try:
        client = Client(address, timeout=_CONNECT_S, set_as_default=False)
    except (OSError, ValueError) as error:
        raise ClusterError(f"no Dask scheduler answers at {address}: {text_of(error)}") from None
    with _without_logs(), client:
        yield from _on(client, _Workers(client, address, tell), tasks, limit)


def _require_listener(address: str) -> None:
    """Raise ClusterError unless a connection to the address succeeds.

    The message is one sentence; the error of Dask's client would be much longer.
    """
    parts = re.fullmatch(r"(?:(?:tcp|tls)://)?([^/:]+|\[[^/]+\]):(\d{1,5})", address)
    if not parts or int(parts[2]) > 65535:
        raise ClusterError(
            f"'{address}' is no address of a Dask scheduler; write tcp://HOST:PORT, or "
            "tls://HOST:PORT"
        )
    try:
        socket.create_connection((parts[1].strip("[]"), int(parts[2])), _CONNECT_S).close()
    except OSError as error:
        raise ClusterError(
            f"no Dask scheduler answers at {address}: {error.strerror or error}"
        ) from None


def _on(
    client: Client, workers: _Workers, tasks: Iterable[Task], limit: float
) -> Generator[list[Result]]:
    from distributed import CancelledError, Event, KilledWorker, wait
    from distributed.comm.core import CommClosedError

    queue: Iterator[Task] = iter(tasks)
    handed: dict[Future, Task] = {}
    stopped = Event(f"ggbench-{uuid.uuid4()}", client)

    def hand_over() -> None:
        # As many as keep the cluster busy as it is now: it may grow.
        threads = max(1, workers.threads())
        for task in itertools.islice(queue, max(0, _AHEAD * threads - len(handed))):
            # Not pure: equal calls are not to be taken for one, their results are stored here.
            handed[client.submit(run_here, task, limit, stopped.name, pure=False)] = task

    try:
        hand_over()
        while handed:
            try:
                with client.as_current():
                    finished, _ = wait([*handed], _LOOK_EVERY_S, return_when="FIRST_COMPLETED")
            except TimeoutError:
                hand_over()
                continue
            for future in finished:
                task = handed.pop(future)
                try:
                    results = future.result()
                except KilledWorker:
                    results = []
                    if len(task.runs) > 1:
                        singles = [replace(task, runs=[run]) for run in task.runs]
                        queue = itertools.chain(singles, queue)
                    else:
                        reason = "its Dask workers ended repeatedly"
                        results = [
                            failure(task, task.runs[0], *pair, reason, retry_above=0.0)
                            for pair in task.estimators
                        ]
                hand_over()
                yield results
    except (CancelledError, CommClosedError, OSError):
        raise ClusterError(
            f"the connection to the Dask scheduler at {workers.address} broke; "
            "the same command resumes the campaign"
        ) from None
    except ModuleNotFoundError as error:
        raise ClusterError(f"the cluster cannot run ggbench: {error}") from None
    finally:
        with contextlib.suppress(Exception):  # the scheduler may be gone
            stopped.set()


class _Workers:
    """Number of workers and threads of a cluster, with reports of changes to the user."""

    def __init__(self, client: Client, address: str, tell: Tell) -> None:
        self.address = address
        self._client, self._tell = client, tell
        self._count = -1
        self._since = time.monotonic()
        self._said = False

    def threads(self) -> int:
        """Return the number of threads of all workers.

        A changed number of workers is reported, and also a longer time without any worker.
        """
        threads = self._client.nthreads()
        if len(threads) != self._count:
            self._count, self._since, self._said = len(threads), time.monotonic(), False
            self._tell(self._count, "")
        if not threads and not self._said and time.monotonic() - self._since > _PATIENCE_S:
            self._said = True
            self._tell(
                0,
                f"waiting for workers: the scheduler at {self.address} has none; "
                f"'dask worker {self.address} --nthreads 1' starts one",
            )
        return sum(threads.values())


@contextlib.contextmanager
def _without_logs() -> Iterator[None]:
    """Disable Dask's loggers within the context.

    Dask logs a traceback for errors that this module reports as one sentence.
    """
    loggers = [
        logger
        for name, logger in logging.root.manager.loggerDict.items()
        if name.startswith("distributed")
        and isinstance(logger, logging.Logger)
        and not logger.disabled
    ]
    for logger in loggers:
        logger.disabled = True
    try:
        yield
    finally:
        for logger in loggers:
            logger.disabled = False


def run_here(task: Task, limit: float, stopped: str) -> list[Result]:
    """Run a task on a Dask worker, in the worker process of the calling thread.

    ``limit`` is the time limit of a run [s]. ``stopped`` is the name of the Dask event that is set
    when the result is no longer needed.

    Raise ClusterError if no process can be started.
    """
    from distributed import Event

    event = Event(stopped)
    served = hasattr(_mine, "member")
    if not served:
        try:
            _mine.member = WorkerSlot(limit)
        except OSError as error:
            raise ClusterError(f"a Dask worker cannot start a process: {text_of(error)}") from None
    _mine.member.limit = limit
    try:
        results = list(itertools.chain.from_iterable(drive([task], [_mine.member], event.is_set)))
        if not _mine.member.idle:  # stopped
            _discard_member()
        return results
    except OtherSourceError:
        # It may have loaded what has been edited since: a new process sees what is there now.
        _discard_member()
        if not served:
            raise
        return run_here(task, limit, stopped)
    except BaseException:
        _discard_member()
        raise


def _discard_member() -> None:
    _mine.member.worker.kill()
    del _mine.member
