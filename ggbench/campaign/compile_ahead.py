"""Parallel compilation of estimators at first use, while the main process checks the flights.

The processes share compiled code through the cache on disk. They compile for a small linear
problem, whose arrays have the same types as those of any flight.
"""

from __future__ import annotations

import contextlib
import json
import os
import queue
import subprocess
import sys
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence

_MOST_PROCESSES = 4
"""Largest number of processes; more would wait, because estimators share most of the code."""


@contextlib.contextmanager
def compiling_ahead(
    first: bool, jobs: int | None = None
) -> Iterator[Callable[[Sequence[str]], None]]:
    """Yield a function that starts the compilation of estimators in other processes.

    One process starts at once and compiles the measurement model. The function takes texts of
    estimators, ``NAME[parameter=value,...]``, and ignores estimators from files. The processes end
    with the ``with`` block.

    Parameters
    ----------
    first : whether the cache of compiled code is empty; if it is not, no process is started.
    jobs : largest number of processes, limited to four; None: the number of processors. With 0 or
        1 no process is started.
    """
    processes: list[subprocess.Popen[str]] = []

    def compile_them(names: Sequence[str]) -> None:
        if not processes:
            return
        count = min(jobs or os.cpu_count() or 1, len(names), _MOST_PROCESSES)
        with contextlib.suppress(OSError):  # they are a help, and no more
            while len(processes) < count:
                processes.append(_started())
            for number, process in enumerate(processes):
                print(json.dumps(names[number :: len(processes)]), file=process.stdin, flush=True)

    if first and jobs not in (0, 1):
        with contextlib.suppress(OSError):
            processes.append(_started())
    try:
        yield compile_them
    finally:
        for process in processes:
            process.kill()
            process.communicate()


def _started() -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-P", "-m", __name__],
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        text=True,
        start_new_session=True,  # Ctrl-C reaches it through its parent only
    )


def compile_estimators(names: Iterable[str]) -> None:
    """Compile measurement model, estimators and evaluation by a run on a small linear problem.

    An estimator that refuses this problem is compiled at its first run.
    """
    import numpy as np

    from ..contract.references import linear_sensor_problem
    from ..problem import jacobian_along

    problem = linear_sensor_problem(0, 3)
    states = np.zeros((problem.epochs, problem.dimension))
    # The first process has begun with the error model.
    jacobian_along(problem.model, np.arange(problem.epochs), states)

    from . import registry

    for name in names:
        with contextlib.suppress(Exception):
            registry.choose(name).estimator.estimate(problem, np.random.default_rng(0))

    from ..judging.run_errors import evaluate_block

    cov = np.array(problem.process_cov[np.newaxis])  # an estimator's is its own, and not read-only
    evaluate_block(states[np.newaxis], states[np.newaxis], cov)


def _listen(requests: queue.SimpleQueue[str]) -> None:
    """Put the parent's line of names into the queue; end this process when the parent ends."""
    requests.put(sys.stdin.readline())
    sys.stdin.read()
    os._exit(0)


def _names(requests: queue.SimpleQueue[str]) -> Iterator[str]:
    """Yield the requested names of estimators, after waiting for the parent's request."""
    yield from (name for name in json.loads(requests.get()) if ".py" not in name)


if __name__ == "__main__":
    parent: queue.SimpleQueue[str] = queue.SimpleQueue()
    threading.Thread(target=_listen, args=(parent,), daemon=True).start()
    compile_estimators(_names(parent))
