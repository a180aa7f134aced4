"""Processes that compile estimators on a first use, while the first one examines the flights.

What one compiles is found in the cache by all others. They need no flight: compiled estimators have
the same types on a small linear problem.
"""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import threading
from collections.abc import Iterator, Sequence

_MOST_PROCESSES = 4
"""More would wait for each other: estimators share most of what is compiled."""


@contextlib.contextmanager
def compiling_ahead(names: Sequence[str], first: bool, jobs: int | None = None) -> Iterator[None]:
    """Return a context in which registered estimators are compiled by other processes.

    Parameters
    ----------
    names : of estimators, with parameters; those of files are passed over.
    first : whether nothing has been compiled before; else there are no processes.
    jobs : number of processes that the user allows; None: of all processors.
    """
    if not first or jobs in (0, 1):
        yield
        return
    processes = []
    count = min(jobs or os.cpu_count() or 1, len(names), _MOST_PROCESSES)
    with contextlib.suppress(OSError):  # they are a help, and no more
        for number in range(count):
            processes.append(
                subprocess.Popen(
                    [sys.executable, "-P", "-m", __name__, *names[number::count]],
                    stdin=subprocess.PIPE,
                    stdout=subprocess.DEVNULL,
                    stderr=subprocess.DEVNULL,
                    start_new_session=True,  # Ctrl-C reaches it through its parent only
                )
            )
    try:
        yield
    finally:
        for process in processes:
            process.kill()
            process.communicate()


def compile_estimators(names: Sequence[str]) -> None:
    """Compile the measurement model, estimators and judgement by use on a small linear problem.

    An estimator that takes no such problem is compiled when it flies.
    """
    import numpy as np

    from ..campaign import registry
    from ..contract.references import linear_sensor_problem
    from ..judging.run_errors import evaluate_block
    from ..problem import jacobian_along, predict_along

    problem = linear_sensor_problem(0, 3)
    states = np.zeros((problem.epochs, problem.dimension))
    # The first process has begun with the error model.
    epochs = np.arange(problem.epochs)
    jacobian_along(problem.model, epochs, states)
    for name in names:
        with contextlib.suppress(Exception):
            registry.choose(name).estimator.estimate(problem, np.random.default_rng(0))
    predict_along(problem.model, epochs, states)
    cov = np.array(problem.process_cov[np.newaxis])  # an estimator's is its own, and not read-only
    evaluate_block(states[np.newaxis], states[np.newaxis], cov)


def _end_with_parent() -> None:
    """End this process when its parent closes the pipe, as it does when it ends."""

    def watch() -> None:
        sys.stdin.buffer.read()
        os._exit(0)

    threading.Thread(target=watch, daemon=True).start()


if __name__ == "__main__":
    _end_with_parent()
    compile_estimators([name for name in sys.argv[1:] if ".py" not in name])
