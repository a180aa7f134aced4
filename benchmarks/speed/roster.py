"""Time of a run for every estimator, on two flights.

The position prior of the first flight is 5 m. The second flight, over hills, has a prior of one
kilometre. Times are processor times of one thread. Each round times all estimators, and the best
round counts.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import pandas as pd
from oracles import reference

from ggbench.block import ProblemBlock
from ggbench.campaign.registry import choose
from ggbench.simulation.error_free_flight import prepare
from ggbench.simulation.runs import simulate_block
from ggbench.spec import scenario

FLIGHTS = {"wang2013": "0.01E-1Hz", "wide_prior": "1km"}
WITH_ENGINE = (
    "ekf",
    "ekf[iterations=5]",
    "ekf[loss=cauchy]",
    "ekf[noise_memory=20]",
    "ukf",
    "ukf[loss=cauchy]",
    "gaussian-sum",
    "factor-graph",
    "factor-graph[mode=fixed-lag]",
    "factor-graph[mode=batch]",
    "factor-graph[mode=batch,loss=cauchy]",
    "gauss-newton",
)
OTHERS = (
    "closed-loop",
    "rao-blackwellised",
    "unscented-particle",
    "gaussian-particle",
    "particle",
    "tercom",
    "correlation",
    "sitan",
    "sitan[bank=auto,most=1000]",
    "iccp",
    "viterbi",
)
RUNS = 16
"""Number of runs of a block: two groups of lanes."""


@dataclass
class Cost:
    """Time of an estimator on a flight: a row of the table of estimators.

    Attributes
    ----------
    flight : scenario and case.
    estimator : label of the estimator.
    engine : ``compiled``, its ``reference``, or ``only`` for the only implementation.
    processor_ms_per_run : time per run in the best round [ms].
    largest_difference_prior_sd : largest difference of the means of run 0 from the reference
        [prior σ].
    not_timed_because : reason for not timing the estimator; empty if it was timed.
    """

    flight: str
    estimator: str
    engine: str
    processor_ms_per_run: float = float("nan")
    largest_difference_prior_sd: float = float("nan")
    not_timed_because: str = ""


def measure(rounds: int) -> pd.DataFrame:
    """Measure all estimators on all flights and return their table."""
    found = []
    for name, case in FLIGHTS.items():
        loaded = scenario.load(name)
        prepared = prepare(loaded.case(case))
        block = simulate_block(prepared, loaded.campaign.seed, range(RUNS))[0]
        found += _on_flight(f"{name}, {case}", block, rounds)
    return pd.DataFrame([asdict(cost) for cost in found])


def _on_flight(flight: str, block: ProblemBlock, rounds: int) -> list[Cost]:
    found, timed = [], []
    sigma = np.sqrt(np.diag(block.prior_cov))
    for label in (*WITH_ENGINE, *OTHERS):
        means = []
        for engine in ("reference", "compiled") if label in WITH_ENGINE else ("only",):
            print(f"preparing {label}, {engine} on {flight}", file=sys.stderr)
            chosen = choose(label).estimator
            cost = Cost(flight, label, engine)
            cost.not_timed_because = chosen.skip(block.problem(0)) or ""
            found.append(cost)
            if not cost.not_timed_because:
                work = _work(label, engine, block)
                means.append(work()[0])
                timed.append((cost, work))
        if len(means) == 2:
            found[-1].largest_difference_prior_sd = np.abs((means[1] - means[0]) / sigma).max()
    for turn in range(rounds):
        print(f"round {turn + 1} of {rounds} on {flight}", file=sys.stderr)
        for cost, work in timed:
            start = time.process_time()
            runs = len(work())
            spent = 1e3 * (time.process_time() - start) / runs
            cost.processor_ms_per_run = np.fmin(cost.processor_ms_per_run, spent)
    return found


def _work(label: str, engine: str, block: ProblemBlock) -> Callable[[], Any]:
    """Return a function that solves the block with a compiled engine, or else one run."""
    if engine == "compiled":
        compiled: Any = choose(label).estimator
        return lambda: compiled.estimate_block(block).mean
    alone: Any = reference(label) if engine == "reference" else choose(label).estimator
    problem = block.problem(0)
    return lambda: alone.estimate(problem, np.random.default_rng(0)).mean[np.newaxis]
