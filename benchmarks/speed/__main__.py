"""``python -m speed``: measure and write the report, or check the ratios."""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from ggbench.campaign.registry import choose
from ggbench.errors import GGBenchError
from ggbench.simulation.runs import simulate_block

from . import (
    check,
    clouds,
    clouds_report,
    curve,
    export,
    kernels,
    long_flights,
    machine,
    model_cost,
    problem_file,
    report,
    roster,
    rounds,
    startup,
)
from .rival_ggbench import BLOCK
from .rounds import Entry, Measured

RAW = "speed.json"
RUNS = 32
"""Runs in the problem's file: what dynamax takes at once."""
ROSTER_ROUNDS = 3
"""In which every estimator is timed."""
TOLERANCES = {"ekf": 1e-6, "ukf": 1e-6, "batch": 1e-4}
"""Allowed differences of means, in deviations of the prior. Levenberg–Marquardt stops where the
error falls by less than 1e-10 of itself, up to 1e-4 deviations from the minimum."""
LABELS = {"ekf": "ekf", "ukf": "ukf", "batch": "factor-graph[mode=batch]"}
FRAMEWORKS = {"ekf": "filterpy-ekf", "ukf": "filterpy-ukf", "batch": "gtsam[mode=batch]"}


def entries() -> list[Entry]:
    """Return all that is measured; ggbench's framework engines first, as references."""
    found = [
        Entry(f"ggbench:{label}", f"ggbench `{label}`, compiled h and H", family)
        for family, label in FRAMEWORKS.items()
    ]
    found += [
        Entry("filterpy:Ekf", "filterpy EKF, NumPy h and H", "ekf"),
        Entry("stonesoup:Ekf", "Stone Soup EKF, NumPy h and H", "ekf", "stonesoup"),
        Entry("dynamax:Ekf", "dynamax EKF, JAX", "ekf", "dynamax"),
        Entry("dynamax:EkfTogether", f"dynamax EKF, JAX, {RUNS} runs vmapped", "ekf", "dynamax"),
        Entry("filterpy:Ukf", "filterpy UKF, NumPy h", "ukf"),
        Entry("stonesoup:Ukf", "Stone Soup UKF, NumPy h", "ukf", "stonesoup"),
        Entry("dynamax:Ukf", "dynamax UKF, JAX", "ukf", "dynamax"),
        Entry("dynamax:UkfTogether", f"dynamax UKF, JAX, {RUNS} runs vmapped", "ukf", "dynamax"),
        Entry("gtsam:Batch", "gtsam batch graph, NumPy h and H", "batch"),
    ]
    for family, label in LABELS.items():
        for threads, how in ((1, "one thread"), (2, "two threads")):
            found.append(Entry(f"compiled:{threads}:{label}", f"ggbench `{label}`, {how}", family))
    found += [
        Entry(f"calls:{maker}-{function}", f"{maker} {function}", "")
        for maker in ("numpy", "compiled")
        for function in ("h", "h31", "H")
    ]
    return [*found, Entry("dgemm:", "product of matrices", "")]


def iterations() -> float:
    """Return the mean number of iterations of the batch graph over the runs that are compared."""
    estimator, rng = choose(FRAMEWORKS["batch"]).estimator, np.random.default_rng(0)
    found = [estimator.estimate(p, rng).info["iterations"] for p in export.problems(range(4))]
    return float(np.mean(found))


def profiles(times: int) -> tuple[dict[str, dict[str, float]], dict[str, float]]:
    """Return the seconds per run of the kernels of simulation and engines, on a block.

    And at how many points a run of each engine evaluates the map.
    """
    counted: dict[str, float] = {}
    flight, seed, runs = export.flight(), export.seed(), range(BLOCK)
    block = simulate_block(flight, seed, runs)[0]
    found = {
        "simulation": kernels.profile(lambda: simulate_block(flight, seed, runs), BLOCK, times)
    }
    for label in LABELS.values():
        estimator: Any = choose(label).estimator
        work = lambda estimator=estimator: estimator.estimate_block(block)  # noqa: E731
        found[label] = kernels.profile(work, BLOCK, times)
        counted[label] = float(np.mean(work().info["map_evaluations"]))
    return found, counted


def bench(options: argparse.Namespace) -> None:
    """Measure everything and keep the raw numbers."""
    folder: Path = options.build
    folder.mkdir(parents=True, exist_ok=True)
    arrays = export.arrays(range(RUNS))
    problem = folder / "problem.npz"
    problem_file.save(problem, arrays)
    found: list[Measured] = rounds.measure(
        entries(), problem, folder, rounds.within(arrays.scale, TOLERANCES),
        options.rounds, options.seconds,
    )  # fmt: skip
    raw: dict[str, Any] = {
        "machine": machine.describe(),
        "rounds": options.rounds,
        "seconds": options.seconds,
        "iterations": iterations(),
        "tolerances": TOLERANCES,
        "entries": [asdict(item) for item in found],
        "roster": [asdict(cost) for cost in roster.measure(ROSTER_ROUNDS)],
        "clouds": clouds.measure(folder, options.rounds, options.seconds),
        "startup": startup.measure(options.rounds),
    }
    try:
        raw["profiles"], raw["map_evaluations"] = profiles(options.rounds)
        raw["model_cost"] = model_cost.measure((1, 12, 31), 3 * options.rounds)
        labels = list(LABELS.values())
        counts = [n for n in curve.COUNTS if n <= options.most] or [options.most]
        raw["curve"] = curve.measure(counts, 2, labels)
        raw["one_thread"] = curve.measure([min(curve.SCALED, options.most)], 1, labels)[0]
        raw["long_flights"] = long_flights.measure(labels, options.seconds)
        raw["campaign"] = startup.campaign(min(startup.CAMPAIGN_RUNS, options.most), labels)
    except GGBenchError as error:
        raw["not_streamed"] = rounds.plain(error)
    (folder / RAW).write_text(json.dumps(raw, indent=1))


def tell(options: argparse.Namespace) -> None:
    """Write the report from the raw numbers."""
    raw = json.loads((options.build / RAW).read_text())
    found, of_clouds = measured(raw["entries"]), measured(raw["clouds"]["entries"])
    for path in report.write(found, of_clouds, raw, options.output):
        print(path)


def particles(options: argparse.Namespace) -> None:
    """Measure the particle filters alone, and print their section of the report."""
    options.build.mkdir(parents=True, exist_ok=True)
    raw = clouds.measure(options.build, options.rounds, options.seconds)
    print(clouds_report.section(measured(raw["entries"]), raw))


def long(options: argparse.Namespace) -> None:
    """Measure flights of several lengths and numbers of states alone, and print their section."""
    labels = list(LABELS.values())
    print(long_flights.section(long_flights.measure(labels, options.seconds)))


def measured(entries: list[dict[str, Any]]) -> list[Measured]:
    """Return what the raw numbers of entries say."""
    return [Measured(**item | {"entry": Entry(**item["entry"])}) for item in entries]


def main() -> int:
    """Read the command line."""
    parser = argparse.ArgumentParser(prog="speed", description=__doc__)
    parser.add_argument("--check", action="store_true", help="only the guard of the ratios")
    parser.add_argument(
        "--particles", action="store_true", help="only the particle filters; prints their section"
    )
    parser.add_argument(
        "--long", action="store_true", help="only flights of several lengths; prints their section"
    )
    parser.add_argument(
        "--rewrite", action="store_true", help="only write the report, from the last raw numbers"
    )
    parser.add_argument("--rounds", type=int, default=7, help="how often each is timed, in turn")
    parser.add_argument("--seconds", type=float, default=0.5, help="for how long each time")
    parser.add_argument("--most", type=int, default=100_000, help="most runs that are streamed")
    parser.add_argument("--build", type=Path, default=Path("build/speed"))
    parser.add_argument("--output", type=Path, default=Path("reports"))
    options = parser.parse_args()
    try:
        if options.check:
            return 1 if check.run() else 0
        if options.particles:
            particles(options)
            return 0
        if options.long:
            long(options)
            return 0
        if not options.rewrite:
            bench(options)
        tell(options)
    except GGBenchError as error:
        print(f"Error: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
