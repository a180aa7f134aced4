"""The time of a run, simulated and estimated in blocks, over the number of runs.

``python -m speed.curve RUNS THREADS LABEL...`` streams that many runs through the compiled engines
and prints one line of JSON; nothing but sums is kept, so memory does not depend on the number.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np

from . import environments

SCALED = 3000
"""Number of runs with which one thread is compared with two."""
COUNTS = (100, 300, 1000, 3000, 10_000, 30_000, 100_000)


def stream(runs: int, threads: int, labels: Sequence[str]) -> dict[str, Any]:
    """Simulate and estimate runs block by block on some threads.

    Returns
    -------
    Wall seconds of all; seconds of the threads in the simulation and in each engine; the root mean
    square of each engine's position errors over runs and epochs [m]; the peak of memory [bytes].
    """
    from ggbench.campaign.registry import choose
    from ggbench.simulation.runs import simulate_block

    from . import export
    from .rival_ggbench import BLOCK
    from .worker import peak_memory

    flight, seed = export.flight(), export.seed()
    engines: dict[str, Any] = {label: choose(label).estimator for label in labels}

    def solve(start: int) -> tuple[dict[str, float], dict[str, float]]:
        before = time.perf_counter()
        block, truth = simulate_block(flight, seed, range(start, min(start + BLOCK, runs)))
        spent, squares = {"simulation": time.perf_counter() - before}, {}
        for label, engine in engines.items():
            before = time.perf_counter()
            mean = engine.estimate_block(block).mean
            spent[label] = time.perf_counter() - before
            error = mean[..., :3] - truth.error_state[..., :3]
            squares[label] = float(np.sum(error**2)) / error.shape[1]
        return spent, squares

    solve(0)  # compiled
    total: dict[str, float] = dict.fromkeys(("simulation", *labels), 0.0)
    squared: dict[str, float] = dict.fromkeys(labels, 0.0)
    start = time.perf_counter()
    with ThreadPoolExecutor(threads) as pool:
        # Results are taken as they come, a window of blocks at a time.
        for first in range(0, runs, 64 * BLOCK):
            window = range(first, min(first + 64 * BLOCK, runs), BLOCK)
            for spent, squares in pool.map(solve, window):
                for name, seconds in spent.items():
                    total[name] += seconds
                for name, square in squares.items():
                    squared[name] += square
    return {
        "runs": runs,
        "threads": threads,
        "seconds": time.perf_counter() - start,
        "parts": total,
        "rms_m": {name: (square / runs) ** 0.5 for name, square in squared.items()},
        "peak": peak_memory(),
    }


def measure(counts: Sequence[int], threads: int, labels: Sequence[str]) -> list[dict[str, Any]]:
    """Return :func:`stream` of each number of runs, each in a process of its own."""
    points = []
    for runs in counts:
        print(f"{runs} runs on {threads} threads", file=sys.stderr)
        command = [sys.executable, "-m", "speed.curve", str(runs), str(threads), *labels]
        done = subprocess.run(
            command, env=environments.variables(), stdout=subprocess.PIPE, text=True, check=True
        )
        points.append(json.loads(done.stdout.splitlines()[-1]))
    return points


if __name__ == "__main__":
    print(json.dumps(stream(int(sys.argv[1]), int(sys.argv[2]), sys.argv[3:])))
