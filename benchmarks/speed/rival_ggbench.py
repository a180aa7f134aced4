"""Estimators of ggbench: frameworks run by run, and compiled engines on blocks of runs."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np

from ggbench.campaign.registry import choose
from ggbench.simulation.runs import simulate_block

from . import export

BLOCK = 32
"""Number of runs of a block."""
BLOCKS = 4
"""Number of blocks per call: enough for two threads."""


class Framework:
    """Estimator of ggbench with filterpy or gtsam, h and H compiled, one run per call."""

    runs_per_call = 1

    def __init__(self, label: str, runs: int) -> None:
        self.estimator = choose(label).estimator
        self.problems = export.problems(range(runs))

    def solve(self, run: int) -> np.ndarray:
        """Return the means (1, K, n) of a run."""
        return self.estimator.estimate(self.problems[run], np.random.default_rng(0)).mean[None]


class Compiled:
    """Compiled engine of ggbench, several blocks of runs per call."""

    def __init__(self, label: str, threads: int, blocks: int = BLOCKS) -> None:
        self.runs_per_call = BLOCK * blocks
        self.estimator: Any = choose(label).estimator
        self.blocks = [
            simulate_block(export.flight(), export.seed(), range(start, start + BLOCK))[0]
            for start in range(0, self.runs_per_call, BLOCK)
        ]
        self.threads = threads
        self.pool = ThreadPoolExecutor(threads)

    def solve(self, run: int) -> np.ndarray:
        """Return the means (runs_per_call, K, n) of all blocks."""
        solve = self.estimator.estimate_block
        if self.threads == 1:
            found = [solve(block) for block in self.blocks]
        else:
            found = list(self.pool.map(solve, self.blocks))
        return np.concatenate([estimate.mean for estimate in found])
