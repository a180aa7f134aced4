"""A process that solves the problem with one implementation, when it is asked to.

``python -m speed.worker IMPLEMENTATION PROBLEM.npz MEANS.npy``; requests and answers are lines of
JSON. Its first answer, with versions and memory, follows when it has solved the first runs and
written their means. It answers {"seconds": s} with the time that some runs took, about s seconds.
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
"""Runs whose means are compared."""
PACKAGES = ("ggbench", "filterpy", "gtsam", "stonesoup", "dynamax", "jax", "numba", "numpy")


def implementation(name: str, problem: Path) -> Any:
    """Return what solves the problem: ``runs_per_call`` and ``solve(run)``.

    ``rival:Class`` is a class of the module ``rival_rival`` that takes the problem.
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
    """Return the most memory [bytes] that this process has had, the parent's left out."""
    status = Path("/proc/self/status")
    if status.exists():
        for line in status.read_text().splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) * 1024
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if platform.system() == "Darwin" else peak * 1024


def versions() -> dict[str, str]:
    """Return the versions of the packages of interest that are installed here."""
    found = {"python": platform.python_version()}
    for name in PACKAGES:
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    return found


def main(name: str, problem: str, means: str) -> None:
    """Solve, answer, and time on request until the input ends."""
    answers = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)  # whatever a library prints is no answer
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
