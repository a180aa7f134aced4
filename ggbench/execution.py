"""Running tasks on this machine: in this process, or in worker processes with one BLAS thread.

Each engine yields results as they come, in whatever order; what a result is does not depend on it.
"""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Generator, Iterable, Sequence
from dataclasses import dataclass, replace
from multiprocessing.connection import wait

from .errors import GGBenchError
from .runner import Started, Task, failure, run_task
from .store import Result
from .worker import Ready, Worker, WorkerDiedError

_MOST_FALSE_STARTS = 3
"""Processes that may end before they are ready, one after the other."""
_WAKE_S = 1.0


class ExecutionError(GGBenchError):
    """Tasks cannot be run at all."""


def in_process(tasks: Iterable[Task]) -> Generator[list[Result]]:
    """Run tasks in this process, where a debugger reaches them; no time limit applies."""
    for task in tasks:
        for message in run_task(task):
            if isinstance(message, Result):
                yield [message]


def in_processes(tasks: Sequence[Task], jobs: int, limit: float) -> Generator[list[Result]]:
    """Run tasks in up to ``jobs`` worker processes.

    A run whose process dies is tried once more, alone; if that process dies too, the death is its
    result. A run of more than ``limit`` seconds is killed, and that is its result.

    Raises
    ------
    ExecutionError
        If processes die before they are ready.
    GGBenchError
        If a worker finds that it would run something else than was planned.
    """
    crew: list[Member] = []
    try:
        while len(crew) < min(jobs, len(tasks)):
            crew.append(Member(limit))
        yield from drive(tasks, crew)
    except OSError as error:
        raise ExecutionError(f"worker processes cannot be started: {error.strerror}") from None
    finally:
        for member in crew:
            member.worker.kill()


def drive(
    tasks: Iterable[Task], crew: Sequence[Member], stop: Callable[[], bool] = lambda: False
) -> Generator[list[Result]]:
    """Let a crew run tasks to their end, after which all of it is idle again.

    Or until ``stop``, asked about once a second, says so.
    """
    queue = deque(Attempt(task) for task in tasks)
    results: list[Result] = []
    asked = time.monotonic()
    while True:
        for member in crew:
            if queue and member.idle:
                member.begin(queue.popleft())
        if results:  # stored while the crew is at work again
            yield results
        if not queue and not any(member.attempt for member in crew):
            return
        start = time.monotonic()
        if start - asked > _WAKE_S:
            asked = start
            if stop():
                return
        patience = max(0.0, min([_WAKE_S, *(m.deadline - start for m in crew)]))
        wait([m.worker.connection for m in crew if not m.idle], patience)
        asleep = time.monotonic() - start - patience
        if asleep > _WAKE_S:  # Ctrl-Z, a closed laptop: no run's time
            for member in crew:
                member.deadline += asleep
        results = []
        for member in crew:
            finished, again = member.attend()
            results += finished
            queue.extendleft(again)


@dataclass(frozen=True)
class Attempt:
    """A task, and whether a process has died of it before."""

    task: Task
    second: bool = False


class Member:
    """A worker with what it is at; what becomes of it when it dies or takes too long."""

    def __init__(self, limit: float) -> None:
        self.limit = limit
        self._false_starts = 0
        self._start()

    def _start(self) -> None:
        self.worker = Worker()
        self.idle = False
        self.attempt: Attempt | None = None
        self.deadline = math.inf
        self._label: str | None = None
        self._left: dict[str, str] = {}

    def begin(self, attempt: Attempt) -> None:
        """Give the worker something to do."""
        self.idle, self.attempt = False, attempt
        self._left = dict(attempt.task.estimators)
        self.worker.give(attempt.task)

    def attend(self) -> tuple[list[Result], list[Attempt]]:
        """Return the results that have come, and what must be tried again."""
        results: list[Result] = []
        again: list[Attempt] = []
        try:
            while self.worker.connection.poll():
                self._take(self.worker.receive(), results)
            self.worker.check()
        except WorkerDiedError as death:
            self._bury(str(death), results, again)
        if time.monotonic() > self.deadline:
            self._stop(results, again)
        return results, again

    def _take(self, message: object, results: list[Result]) -> None:
        if isinstance(message, Started) and message.label in self._left:
            self._label, self.deadline = message.label, time.monotonic() + self.limit
        elif (
            isinstance(message, Result)
            and self._label is not None
            and message.key == self._left[self._label]
        ):
            results.append(message)
            del self._left[self._label]
            self._label, self.deadline = None, math.inf
        elif isinstance(message, Ready) and not self._left:
            self.idle, self.attempt, self._false_starts = True, None, 0
        elif isinstance(message, GGBenchError):
            raise message
        else:
            raise WorkerDiedError("its process said what was not asked")

    def _bury(self, death: str, results: list[Result], again: list[Attempt]) -> None:
        """See to what a worker that died was at, and start another one."""
        if self.attempt is None:
            self._false_starts += 1
            if self._false_starts == _MOST_FALSE_STARTS:
                raise ExecutionError(
                    f"worker processes end before they are ready: {death}; what they printed may "
                    "say why"
                )
        else:
            # Between two runs it died of nobody's fault, or of what all of them share.
            blamed = [*self._left] if self._label is None else [self._label]
            again += self._retry([label for label in self._left if label not in blamed])
            if self.attempt.second:
                results += [self._lost(label, f"{death}, twice", 0.0) for label in blamed]
            else:
                again += self._retry(blamed, second=True)
        self._restart()

    def _stop(self, results: list[Result], again: list[Attempt]) -> None:
        """Kill a worker that is over its time limit, which is the run's result."""
        assert self._label is not None  # the clock runs in a run only
        reason = f"over its time limit of {self.limit:g} s"
        results.append(self._lost(self._label, reason, self.limit))
        again += self._retry([label for label in self._left if label != self._label])
        self._restart()

    def _retry(self, labels: list[str], second: bool = False) -> list[Attempt]:
        """Return the attempt at some of the task's estimators, if they are any."""
        assert self.attempt is not None
        pairs = tuple((label, self._left[label]) for label in labels)
        return [Attempt(replace(self.attempt.task, estimators=pairs), second)] if pairs else []

    def _lost(self, label: str, reason: str, retry_above: float) -> Result:
        assert self.attempt is not None
        key = self._left[label]
        return failure(self.attempt.task, label, key, reason, retry_above=retry_above)

    def _restart(self) -> None:
        self.worker.kill()
        self._start()
