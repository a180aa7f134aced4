"""Execution of tasks on this machine: in this process, or in single-threaded worker processes.

Each function yields results in the order of completion. The results do not depend on this order.
"""

from __future__ import annotations

import itertools
import math
import time
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from multiprocessing.connection import wait

from ..errors import GGBenchError
from ..results.database import Result
from .runner import Started, Task, failure, run_task
from .worker import Ready, Worker, WorkerDiedError, kill_surely

_MOST_FALSE_STARTS = 3
"""Number of consecutive processes that end before they are ready, at which a campaign fails."""
_WAKE_S = 1.0
_BATCH, _BATCH_S = 500, 0.2
"""Number of results, and time [s], after which results are stored together in one write."""


class ExecutionError(GGBenchError):
    """Worker processes end before they are ready, so no task can be run."""


def in_process(tasks: Iterable[Task]) -> Generator[list[Result]]:
    """Run tasks in this process, for example for a debugger; no time limit applies.

    A user's file that has run in this process may cause a later failure of another estimator. Such
    a failure is not final: the next campaign in the same folder repeats the run.
    """
    guests: frozenset[str] = frozenset()
    for task in tasks:
        guests |= task.guests
        for message in run_task(task):
            if isinstance(message, list):
                yield [_not_final(r) for r in message] if guests - task.guests else message


def _not_final(result: Result) -> Result:
    failed = result.record["status"] != "ok"
    return result._replace(retry_above=0.0) if failed else result


def in_processes(tasks: Iterable[Task], jobs: int, limit: float) -> Generator[list[Result]]:
    """Run tasks in up to ``jobs`` worker processes.

    A run whose process dies is repeated once, alone. If the second process dies too, the run is
    recorded as failed. A process is killed if a run takes more than ``limit`` seconds, and the run
    is recorded as failed. The time limit of a block is also ``limit``. If a block takes longer, its
    runs are repeated singly.

    Raise ExecutionError if processes die before they are ready. Raise GGBenchError if a worker has
    other versions or sources than the campaign.
    """
    pool: list[WorkerSlot] = []
    source = iter(tasks)
    first = list(itertools.islice(source, jobs))
    try:
        while len(pool) < len(first):
            pool.append(WorkerSlot(limit))
        yield from drive(itertools.chain(first, source), pool)
    except OSError as error:
        raise ExecutionError(f"worker processes cannot be started: {error.strerror}") from None
    finally:
        kill_surely([member.worker for member in pool])


def drive(
    tasks: Iterable[Task], pool: Sequence[WorkerSlot], stop: Callable[[], bool] = lambda: False
) -> Generator[list[Result]]:
    """Run tasks in a pool of workers until all are done or ``stop`` returns true.

    At the end no worker has a task, unless ``stop`` has returned true. ``stop`` is called about
    once a second. Tasks are taken from the iterable on demand.
    """
    queue = _Queue(tasks)
    results: list[Result] = []
    last_check = stored = time.monotonic()
    while True:
        for member in pool:
            if member.idle and queue:
                if member.guests <= queue.first.task.guests:
                    member.begin(queue.pop())
                else:  # code of another estimator's file has run in its process
                    member.renew()
        finished = not queue and not any(member.attempt for member in pool)
        start = time.monotonic()
        if results and (finished or len(results) >= _BATCH or start - stored >= _BATCH_S):
            yield results  # stored while the pool is at work again
            results = []
            stored = start = time.monotonic()
        if finished:
            return
        if start - last_check > _WAKE_S:
            last_check = start
            if stop():
                return
        patience = max(0.0, min([_WAKE_S, *(m.deadline - start for m in pool)]))
        if results:
            patience = min(patience, _BATCH_S)
        wait([end for m in pool if not m.idle for end in m.worker.readable], patience)
        asleep = time.monotonic() - start - patience
        if asleep > _WAKE_S:  # Ctrl-Z, a closed laptop: no run's time
            for member in pool:
                member.deadline += asleep
        for member in pool:
            come, again = member.poll()
            results += come
            queue.again(again)


@dataclass(frozen=True)
class Attempt:
    """A task, with a flag for the second attempt after the death of a process."""

    task: Task
    second: bool = False


class _Queue:
    """Remaining attempts: repetitions first, then new tasks, which are created on demand."""

    def __init__(self, tasks: Iterable[Task]) -> None:
        self._tasks: Iterator[Task] = iter(tasks)
        self._next: deque[Attempt] = deque()

    def __bool__(self) -> bool:
        if not self._next:
            self._next += [Attempt(task) for task in itertools.islice(self._tasks, 1)]
        return bool(self._next)

    @property
    def first(self) -> Attempt:
        """The attempt that is next."""
        return self._next[0]

    def pop(self) -> Attempt:
        return self._next.popleft()

    def again(self, attempts: Sequence[Attempt]) -> None:
        self._next.extendleft(reversed(attempts))


def _group_by_missing(missing: Mapping[str, set[int]]) -> dict[tuple[str, ...], list[int]]:
    """Group runs by the estimators that lack a result of them.

    Each run is then simulated only once for all of these estimators.
    """
    groups: dict[tuple[str, ...], list[int]] = {}
    for run in sorted(set().union(*missing.values())):
        labels = tuple(label for label, runs in missing.items() if run in runs)
        groups.setdefault(labels, []).append(run)
    return groups


class WorkerSlot:
    """A worker process with its current task; handles deaths and exceeded time limits."""

    def __init__(self, limit: float) -> None:
        self.limit = limit
        self._false_starts = 0
        self._start()

    def _start(self) -> None:
        self.worker = Worker()
        self.guests: frozenset[str] = frozenset()
        """Paths of users' files whose code has run in the process."""
        self.idle = False
        self.attempt: Attempt | None = None
        self.deadline = math.inf
        self._current: Started | None = None
        self._keys: dict[str, str] = {}
        self._left: dict[str, set[int]] = {}

    def begin(self, attempt: Attempt) -> None:
        """Give the worker a task."""
        self.idle, self.attempt = False, attempt
        self.guests |= attempt.task.guests
        self._keys = dict(attempt.task.estimators)
        self._left = {label: set(attempt.task.runs) for label in self._keys}
        self.worker.give(attempt.task)

    def poll(self) -> tuple[list[Result], list[Attempt]]:
        """Return the results received so far, and the attempts that must be repeated."""
        results: list[Result] = []
        again: list[Attempt] = []
        try:
            for message in self.worker.receive():
                self._take(message, results)
        except WorkerDiedError as death:
            self._handle_death(str(death), results, again)
        if time.monotonic() > self.deadline:
            self._stop(results, again)
        return results, again

    def _take(self, message: object, results: list[Result]) -> None:
        if isinstance(message, Started) and self._left.get(message.label, set()).issuperset(
            message.runs
        ):
            self._current, self.deadline = message, time.monotonic() + self.limit
        elif isinstance(message, list) and self._current and self._is_of(message, self._current):
            results += self._with_output(message)
            self._taken_out(self._current)
            self._current, self.deadline = None, math.inf
        elif isinstance(message, Ready) and not self._left:
            self.idle, self.attempt, self._false_starts = True, None, 0
        elif isinstance(message, GGBenchError):
            raise message
        else:
            raise WorkerDiedError("its process sent an unexpected message")

    def _is_of(self, message: list[object], started: Started) -> bool:
        """Return whether a message contains exactly the results of the started runs."""
        runs = [
            r.record["run"]
            for r in message
            if isinstance(r, Result) and r.key == self._keys[started.label]
        ]
        return len(runs) == len(message) and runs == list(started.runs)

    def _taken_out(self, part: Started) -> dict[str, set[int]]:
        """Remove started runs from the remaining runs of the task; return them by label."""
        self._left[part.label] -= set(part.runs)
        if not self._left[part.label]:
            del self._left[part.label]
        return {part.label: set(part.runs)}

    def _handle_death(self, death: str, results: list[Result], again: list[Attempt]) -> None:
        """Fail or repeat the runs that a dead worker has left, and start another worker.

        Failed runs are appended to ``results``, attempts to repeat runs to ``again``. Raise
        ExecutionError if several workers in succession died before they were ready.
        """
        if self.attempt is None:
            self._false_starts += 1
            if self._false_starts == _MOST_FALSE_STARTS:
                last = self.worker.output.of_run().rpartition("\n")[2]
                raise ExecutionError(
                    f"worker processes end during their start: {death}"
                    + (f"; last output: {last}" if last else "")
                )
        else:
            if self._current is not None:
                blamed = self._taken_out(self._current)
            else:  # between two runs it died by chance, or of what all of them share
                blamed, self._left = self._left, {}
            if self.attempt.second:
                results += self._lost(blamed, f"{death}, twice", 0.0)
            else:
                again += self._retry(blamed, one_by_one=True, second=True)
            again += self._retry(self._left)
        self.renew()

    def _stop(self, results: list[Result], again: list[Attempt]) -> None:
        """Kill a worker that exceeds its time limit.

        A single run is appended to ``results`` as failed; the runs of a block are repeated singly.
        """
        assert self._current is not None  # the clock runs in a run only
        blamed = self._taken_out(self._current)
        if len(self._current.runs) > 1:
            again += self._retry(blamed, one_by_one=True)
        else:
            reason = f"over its time limit of {self.limit:g} s"
            results += self._lost(blamed, reason, self.limit)
        again += self._retry(self._left)
        self.renew()

    def _retry(
        self, missing: Mapping[str, set[int]], one_by_one: bool = False, second: bool = False
    ) -> list[Attempt]:
        """Return attempts that repeat the missing runs of the task."""
        assert self.attempt is not None
        attempts = []
        for labels, runs in _group_by_missing(missing).items():
            pairs = tuple((label, self._keys[label]) for label in labels)
            for some in ([run] for run in runs) if one_by_one else [runs]:
                task = replace(self.attempt.task, runs=some, estimators=pairs)
                attempts.append(Attempt(task, second))
        return attempts

    def _lost(
        self, blamed: Mapping[str, set[int]], reason: str, retry_above: float
    ) -> list[Result]:
        assert self.attempt is not None
        return self._with_output(
            [
                failure(
                    task=self.attempt.task,
                    run=run,
                    label=label,
                    key=self._keys[label],
                    reason=reason,
                    trace="",
                    retry_above=retry_above,
                )
                for label, runs in blamed.items()
                for run in sorted(runs)
            ]
        )

    def _with_output(self, results: list[Result]) -> list[Result]:
        """Return the results of the latest runs; failed runs also get the captured output."""
        output = self.worker.output.of_run()
        for result in results:
            if output and result.record["status"] != "ok":
                result.record["output"] = output
        return results

    def renew(self) -> None:
        """End the worker process, and start a new one in its place."""
        self.worker.kill()
        self._start()
