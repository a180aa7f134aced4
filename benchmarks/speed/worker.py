"""Worker process that solves the problem with one implementation, on request.

The command is ``python -m speed.worker IMPLEMENTATION PROBLEM.npz MEANS.npy``. Requests and answers
are lines of JSON. The worker first solves some runs and writes their means. Its first answer
contains versions, memory and the time of the first call. After a request {"seconds": s} it solves
runs for at least s seconds. The answer contains their number and time.
"""

from __future__ import annotations

import importlib
import importlib.metadata
import json
import os
import platform
import resource
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from . import problem_file

CHECKED_RUNS = 4
"""Number of runs with compared means."""
PACKAGES = ("ggbench", "filterpy", "gtsam", "stonesoup", "dynamax", "jax", "numba", "numpy")


def implementation(name: str, problem: Path) -> Any:
    """Return an object that solves the problem, with ``runs_per_call`` and ``solve(run)``.

    The name ``ggbench:LABEL`` or ``compiled:THREADS:LABEL`` denotes an estimator of ggbench. The
    name ``PACKAGE:CLASS`` denotes a class of the module ``rival_PACKAGE``.
    """
    kind, _, which = name.partition(":")
    if kind == "ggbench":
        from . import rival_ggbench

        return rival_ggbench.Framework(which, CHECKED_RUNS)
    if kind == "compiled":
        from . import rival_ggbench

        threads, _, label = which.partition(":")
        return rival_ggbench.Compiled(label, int(threads))
    module = importlib.import_module(f"{__package__}.rival_{kind}")
    return getattr(module, which)(problem_file.load(problem))


def peak_memory() -> int:
    """Return the peak memory of this process [bytes], without the memory of its parent."""
    status = Path("/proc/self/status")
    if status.exists():
        for line in status.read_text().splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) * 1024
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if platform.system() == "Darwin" else peak * 1024


def versions() -> dict[str, str]:
    """Return the versions of Python and of the installed packages in :data:`PACKAGES`."""
    found = {"python": platform.python_version()}
    for name in PACKAGES:
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    return found


def main(name: str, problem: str, means: str) -> None:
    """Solve some runs, then time runs on request until the input ends."""
    answers = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)  # texts of libraries go to stderr, not to the answers
    solver = implementation(name, Path(problem))
    runs = max(CHECKED_RUNS, solver.runs_per_call)
    start = time.perf_counter()
    solver.solve(0)
    first = time.perf_counter() - start
    found = [solver.solve(run) for run in range(0, runs, solver.runs_per_call)]
    np.save(means, np.concatenate(found)[:CHECKED_RUNS])
    ready = {"first_call": first, "peak": peak_memory(), "versions": versions()}
    print(json.dumps(ready), file=answers)
    turn = 0
    for line in sys.stdin:
        wanted = json.loads(line)["seconds"]
        calls, busy, start = 0, time.process_time(), time.perf_counter()
        while True:
            solver.solve(turn % runs if solver.runs_per_call == 1 else 0)
            calls, turn = calls + 1, turn + 1
            spent = time.perf_counter() - start
            if spent >= wanted:
                break
        answer = {
            "runs": calls * solver.runs_per_call,
            "seconds": spent,
            "cpu_seconds": time.process_time() - busy,
        }
        print(json.dumps(answer), file=answers)


if __name__ == "__main__":
    main(*sys.argv[1:])
