"""What a run costs with every estimator that a user may choose, on two flights.

The paper's, from 5 m off, and the helicopter's over hills, lost by a kilometre. Processor time of
one thread, the best of some rounds in which all are timed in turn.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from oracles import reference

from ggbench.block import ProblemBlock
from ggbench.campaign.registry import choose
from ggbench.figures.numbers import short
from ggbench.report.tables import markdown
from ggbench.simulation.error_free_flight import prepare
from ggbench.simulation.runs import simulate_block
from ggbench.spec import scenario

FLIGHTS = {"wang2013": "0.01E-1Hz", "wide_prior": "1km"}
WITH_ENGINE = (
    "ekf", "ekf[iterations=5]", "ekf[loss=cauchy]", "ekf[noise_memory=20]", "ukf",
    "ukf[loss=cauchy]", "gaussian-sum", "factor-graph", "factor-graph[mode=fixed-lag]",
    "factor-graph[mode=batch]", "factor-graph[mode=batch,loss=cauchy]", "gauss-newton",
)  # fmt: skip
OTHERS = (
    "closed-loop", "rao-blackwellised", "unscented-particle", "gaussian-particle", "particle",
    "tercom", "correlation", "sitan", "sitan[bank=auto,most=1000]", "iccp", "viterbi",
)  # fmt: skip
RUNS = 16
"""Runs of a block: two groups of lanes."""
ALONE = 2
"""Runs that are solved one by one."""


@dataclass
class Cost:
    """An estimator on a flight.

    Attributes
    ----------
    label, flight : which. refusal : why it was not timed; empty if it was.
    seconds : processor time of a run, the best round's.
    engine : ``compiled``, the ``framework`` that it is held to, or empty if it has one way only.
    difference : of the means of run 0 from the framework's, in deviations of the prior.
    """

    label: str
    flight: str
    engine: str
    refusal: str = ""
    seconds: float = float("inf")
    difference: float | None = None


def measure(rounds: int) -> list[Cost]:
    """Time everything, flight by flight."""
    found = []
    for name, case in FLIGHTS.items():
        loaded = scenario.load(name)
        prepared = prepare(loaded.case(case))
        block = simulate_block(prepared, loaded.campaign.seed, range(RUNS))[0]
        found += _on_flight(f"{name}, {case}", block, rounds)
    return found


def _on_flight(flight: str, block: ProblemBlock, rounds: int) -> list[Cost]:
    found, timed = [], []
    sigma = np.sqrt(np.diag(block.prior_cov))
    for label in (*WITH_ENGINE, *OTHERS):
        means = []
        for engine in ("framework", "compiled") if label in WITH_ENGINE else ("",):
            print(f"preparing {label}, {engine} on {flight}", file=sys.stderr)
            estimator: Any = choose(label).estimator
            cost = Cost(label, flight, engine, estimator.skip(block.problem(0)) or "")
            if engine == "framework":
                estimator = reference(label)
            found.append(cost)
            if not cost.refusal:
                work = (
                    _together(estimator, block)
                    if engine == "compiled"
                    else _alone(estimator, block)
                )
                means.append(work()[0])
                timed.append((cost, work))
        if len(means) == 2:
            found[-1].difference = float(np.abs((means[1] - means[0]) / sigma).max())
    for turn in range(rounds):
        print(f"round {turn + 1} of {rounds} on {flight}", file=sys.stderr)
        for cost, work in timed:
            start = time.process_time()
            runs = len(work())
            cost.seconds = min(cost.seconds, (time.process_time() - start) / runs)
    return found


def _alone(estimator: Any, block: ProblemBlock) -> Callable[[], list[np.ndarray]]:
    problems = [block.problem(run) for run in range(ALONE)]

    def work() -> list[np.ndarray]:
        return [estimator.estimate(p, np.random.default_rng(0)).mean for p in problems]

    return work


def _together(estimator: Any, block: ProblemBlock) -> Callable[[], np.ndarray]:
    return lambda: estimator.estimate_block(block).mean


def section(costs: list[Cost]) -> str:
    """Return the report's section."""
    flights = list(dict.fromkeys(cost.flight for cost in costs))
    by = {(c.label, c.flight, c.engine): c for c in costs}
    head, rows = ["estimator"], []
    for flight in flights:
        head += [f"{flight}: framework", "compiled", "times", "apart"]
    for label in WITH_ENGINE:
        row = [f"`{label}`"]
        for flight in flights:
            old, new = (by[label, flight, engine] for engine in ("framework", "compiled"))
            apart = "" if new.difference is None else f"{new.difference:.0e}"
            row += [_ms(old), _ms(new), _times(old, new), apart]
        rows.append(row)
    others = [[f"`{label}`", *(_ms(by[label, f, ""]) for f in flights)] for label in OTHERS]
    refused = [f"* `{c.label}` on {c.flight}: {c.refusal}." for c in costs if c.refusal]
    parts = [
        "Milliseconds of processor time a run, one thread, timed in turn: the estimator on its "
        f"framework (filterpy, NumPy or GTSAM) run by run, and compiled on blocks of {RUNS} "
        "runs. *apart*: the largest difference of their means in run 0, in deviations of the "
        "prior; where updates are searches, or a run has lost its way, it is no rounding.",
        markdown(head, rows),
        "Estimators that have one way, run by run:",
        markdown(["estimator", *flights], others),
    ]
    return "\n\n".join([*parts, *(["Not timed:", "\n".join(refused)] if refused else [])])


def _ms(cost: Cost) -> str:
    return "" if cost.refusal else short(1e3 * cost.seconds)


def _times(old: Cost, new: Cost) -> str:
    return "" if old.refusal or new.refusal else f"{old.seconds / new.seconds:.0f}"
