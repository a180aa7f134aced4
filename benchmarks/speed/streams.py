"""Streams of runs through simulation and all compiled engines, block by block.

``python -m speed.streams RUNS THREADS`` prints one line of JSON. A stream keeps only sums of times.
Its memory therefore does not depend on the number of runs.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pandas as pd

from . import environments

SCALED = 1000
"""Number of runs in the comparison of one thread with two threads."""
COUNTS = (100, SCALED, 10_000)
WINDOW = 64
"""Largest number of blocks in the queue of the threads."""


def stream(runs: int, threads: int) -> list[dict[str, Any]]:
    """Return one row for the simulation and for each engine: times per run and peak memory."""
    from ggbench.campaign.registry import choose
    from ggbench.simulation.runs import simulate_block

    from . import export
    from .page import LABELS
    from .rival_ggbench import BLOCK
    from .worker import peak_memory

    flight, seed = export.flight(), export.seed()
    engines: dict[str, Any] = {label: choose(label).estimator for label in LABELS.values()}

    def solve(start: int) -> dict[str, float]:
        members = range(start, min(start + BLOCK, runs))
        spent, block = timed(lambda: simulate_block(flight, seed, members)[0])
        parts = {"simulation": spent}
        for label, engine in engines.items():
            parts[label], _ = timed(lambda engine=engine: engine.estimate_block(block).mean)
        return parts

    total = dict.fromkeys(solve(0), 0.0)  # compiles the engines
    start = time.perf_counter()
    with ThreadPoolExecutor(threads) as pool:
        for first in range(0, runs, WINDOW * BLOCK):
            window = range(first, min(first + WINDOW * BLOCK, runs), BLOCK)
            for parts in pool.map(solve, window):
                total = {name: total[name] + parts[name] for name in total}
    wall = time.perf_counter() - start
    return [
        {
            "runs": runs,
            "threads": threads,
            "part": part,
            "processor_ms_per_run": 1e3 * seconds / runs,
            "stream_wall_ms_per_run": 1e3 * wall / runs,
            "peak_memory_mb": peak_memory() / 1e6,
        }
        for part, seconds in total.items()
    ]


def timed(work: Callable[[], Any]) -> tuple[float, Any]:
    """Return the processor time of this thread for some work [s], and the result of the work."""
    start = time.thread_time()
    found = work()
    return time.thread_time() - start, found


def measure(most: int) -> pd.DataFrame:
    """Return the rows of :func:`stream` for several numbers of runs, from separate processes."""
    rows = []
    wanted = [(SCALED, 1), *((runs, 2) for runs in COUNTS if runs <= most)]
    for runs, threads in wanted:
        print(f"{runs} runs on {threads} threads", file=sys.stderr)
        command = [sys.executable, "-m", "speed.streams", str(runs), str(threads)]
        done = subprocess.run(
            command, env=environments.variables(), stdout=subprocess.PIPE, text=True, check=True
        )
        rows += json.loads(done.stdout.splitlines()[-1])
    return pd.DataFrame(rows)


if __name__ == "__main__":
    print(json.dumps(stream(int(sys.argv[1]), int(sys.argv[2]))))
