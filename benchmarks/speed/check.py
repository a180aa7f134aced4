"""Guards against slower engines: ratios of times, never absolute times."""

from __future__ import annotations

import statistics
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from . import export
from .calls import Calls, FieldCalls


@dataclass(frozen=True)
class Guard:
    """Comparison of two implementations, with the least speed ratio per run.

    Attributes
    ----------
    name : description of the comparison.
    floor : least ratio of the slow and the fast time. For draped layers it is a requirement; else
        it is about half of the ratio at the time of its choice.
    slow, fast : functions that return the timed objects with ``runs_per_call`` and ``solve(run)``.
    """

    name: str
    floor: float
    slow: Callable[[], Any]
    fast: Callable[[], Any]


class _Product:
    """Product of large matrices: the highest speed of the BLAS on one thread."""

    runs_per_call = 1

    def __init__(self) -> None:
        self.matrix = np.random.default_rng(0).standard_normal((768, 768))

    def solve(self, run: int) -> object:
        return self.matrix @ self.matrix


class _Framework:
    runs_per_call = 1

    def __init__(self, label: str) -> None:
        from oracles import reference

        self.oracle, (self.problem,) = reference(label), export.problems([0])

    def solve(self, run: int) -> object:
        return self.oracle.estimate(self.problem)


def _compiled(label: str) -> Any:
    from .rival_ggbench import Compiled

    return Compiled(label, threads=1, blocks=1)


class _Simulation:
    """Simulation of a block of runs."""

    def __init__(self) -> None:
        from .rival_ggbench import BLOCK

        self.runs_per_call = BLOCK

    def solve(self, run: int) -> object:
        from ggbench.simulation.runs import simulate_block

        return simulate_block(export.flight(), export.seed(), range(self.runs_per_call))


_ENGINES = ("ekf", "ukf", "factor-graph[mode=batch]")
"""Engines of the guarded campaign."""


class _Engines:
    """Engines without a campaign, one after the other on a block of runs."""

    def __init__(self) -> None:
        self.engines = [_compiled(label) for label in _ENGINES]
        self.runs_per_call = self.engines[0].runs_per_call

    def solve(self, run: int) -> object:
        return [engine.solve(run) for engine in self.engines]


class _Campaign:
    """Complete campaign in this process: simulation, estimates, judgement, storage and tables."""

    runs_per_call = 128

    def solve(self, run: int) -> object:
        from ggbench.campaign import campaign, running
        from ggbench.spec import scenario

        with tempfile.TemporaryDirectory() as folder:
            work = campaign.planned(
                scenario.load(export.SCENARIO),
                Path(folder, "results"),
                _ENGINES,
                runs=self.runs_per_call,
                cases=[export.CASE],
            )
            return running.fly(work, jobs=0)


def guards() -> list[Guard]:
    """Return all guards."""
    engines = [
        ("ekf", 20.0),
        ("ekf[iterations=5]", 20.0),
        ("ekf[noise_memory=20]", 35.0),
        ("ukf", 20.0),
        ("ukf[loss=cauchy]", 25.0),
        ("gaussian-sum", 10.0),
        ("factor-graph", 9.0),
        ("factor-graph[mode=fixed-lag]", 14.0),
        ("factor-graph[mode=batch]", 40.0),
        ("gauss-newton", 2.0),
    ]
    return [
        Guard(
            "h of one state: compiled, compared with NumPy",
            1.5,
            lambda: Calls("numpy-h"),
            lambda: Calls("compiled-h"),
        ),
        Guard(
            "h of 31 states: compiled, compared with NumPy",
            6.0,
            lambda: Calls("numpy-h31"),
            lambda: Calls("compiled-h31"),
        ),
        Guard(
            "H: compiled, compared with NumPy",
            5.0,
            lambda: Calls("numpy-H"),
            lambda: Calls("compiled-H"),
        ),
        Guard(
            "h: draped layers, compared with level layers",
            1.0 / 1.3,
            lambda: FieldCalls("level-tensor"),
            lambda: FieldCalls("draped-tensor"),
        ),
        Guard(
            "H: draped layers, compared with level layers",
            1.0 / 1.3,
            lambda: FieldCalls("level-slopes"),
            lambda: FieldCalls("draped-slopes"),
        ),
        *(
            Guard(
                f"{label}: compiled, compared with its framework or NumPy",
                floor,
                lambda label=label: _Framework(label),
                lambda label=label: _compiled(label),
            )
            for label, floor in engines
        ),
        Guard(
            "simulation of a run, compared with a product of 768 x 768 matrices",
            3.5,
            _Product,
            _Simulation,
        ),
        Guard(
            "campaign of three engines, compared with the engines alone",
            0.2,
            _Engines,
            _Campaign,
        ),
    ]


def ratio(slow: Any, fast: Any, rounds: int, seconds: float) -> float:
    """Return the ratio of the times per run, as the median over rounds.

    Each round times both implementations. The times are processor times, which exclude other work
    on the machine.
    """

    def per_run(solver: Any) -> float:
        calls, start = 0, time.process_time()
        while True:
            solver.solve(0)
            calls += 1
            spent = time.process_time() - start
            if spent >= seconds:
                return spent / (calls * solver.runs_per_call)

    for solver in (slow, fast):
        solver.solve(0)  # compiles, and loads arrays into memory
    return statistics.median(per_run(slow) / per_run(fast) for _ in range(rounds))


def run(rounds: int = 7, seconds: float = 0.15) -> int:
    """Measure all guards and print the ratios; return the number of ratios below their floors."""
    low = 0
    for guard in guards():
        found = ratio(guard.slow(), guard.fast(), rounds, seconds)
        verdict = "at least the floor of" if found >= guard.floor else "BELOW the floor of"
        print(f"{guard.name}: {found:.3g} times as fast, {verdict} {guard.floor:g}")
        low += found < guard.floor
    if low:
        print(f"ratios below their floors: {low}; a change has made code slower.")
    return low
