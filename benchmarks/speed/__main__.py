"""Command ``python -m speed``: measurements and page, or a check of the ratios."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import pandas as pd

from ggbench.errors import GGBenchError
from ggbench.files.writing import written_whole

from . import check, export, machine, page, problem_file, roster, rounds, streams
from .rounds import Entry, Measured

RUNS = 32
"""Number of runs in the problem file; dynamax can process all of them in one call."""
TOLERANCES = {"ekf": 1e-6, "ukf": 1e-6, "batch": 1e-4}
"""Largest allowed differences of means [prior σ].

Levenberg–Marquardt stops if the relative decrease of the error is below 1e-10. The means are then
up to 1e-4 prior standard deviations from the minimum."""
DIGITS = 4


def entries() -> list[Entry]:
    """Return all implementations; the first of each family is the reference."""
    references = {"ekf": "filterpy-ekf", "ukf": "filterpy-ukf", "batch": "gtsam[mode=batch]"}
    found = [
        Entry(f"ggbench:{label}", page.REFERENCE, family) for family, label in references.items()
    ]
    for family, label in page.LABELS.items():
        for threads, title in page.COMPILED.items():
            found.append(Entry(f"compiled:{threads}:{label}", title, family))
    together = f"dynamax, {RUNS} runs at once"
    for family, solver in (("ekf", "Ekf"), ("ukf", "Ukf")):
        found += [
            Entry(f"filterpy:{solver}", "filterpy", family),
            Entry(f"stonesoup:{solver}", "Stone Soup", family, "stonesoup"),
            Entry(f"dynamax:{solver}", "dynamax", family, "dynamax"),
            Entry(f"dynamax:{solver}Together", together, family, "dynamax"),
        ]
    return [*found, Entry("gtsam:Batch", "gtsam", "batch")]


def bench(options: argparse.Namespace) -> None:
    """Measure all implementations and write the tables."""
    build: Path = options.build
    build.mkdir(parents=True, exist_ok=True)
    before = machine.load()
    arrays = export.arrays(range(RUNS))
    problem_file.save(build / "problem.npz", arrays)
    found = rounds.measure(
        entries=entries(),
        problem=build / "problem.npz",
        folder=build,
        scale=arrays.scale,
        tolerances=TOLERANCES,
        rounds=options.rounds,
        seconds=options.seconds,
    )
    tables = {
        "implementations": pd.DataFrame([item.row() for item in found]),
        "rounds": pd.DataFrame([row for item in found for row in item.rows()]),
        "estimators": roster.measure(options.roster_rounds),
        "streams": streams.measure(options.most),
        "machine": machine.describe(before, versions(found)),
    }
    for name, table in tables.items():
        with written_whole(options.output / page.FOLDER / f"{name}.csv", GGBenchError) as file:
            table.to_csv(file, index=False, float_format=f"%.{DIGITS}g")


def versions(found: list[Measured]) -> dict[str, str]:
    """Return the versions of the measured packages; environments may have different versions."""
    every: dict[str, set[str]] = {}
    for item in found:
        for name, version in item.versions.items():
            every.setdefault(name, set()).add(version)
    return {name: "/".join(sorted(every[name])) for name in sorted(every)}


def main() -> int:
    """Run the command and return its exit code."""
    parser = argparse.ArgumentParser(prog="speed", description=__doc__)
    parser.add_argument("--check", action="store_true", help="only check the ratios")
    parser.add_argument("--report", action="store_true", help="only write the page, from tables")
    parser.add_argument("--rounds", type=int, default=7, help="number of timing rounds")
    parser.add_argument("--seconds", type=float, default=0.5, help="least time in a round [s]")
    parser.add_argument("--roster-rounds", type=int, default=2, help="rounds of all estimators")
    parser.add_argument("--most", type=int, default=10_000, help="most runs of a stream")
    parser.add_argument("--build", type=Path, default=Path("build/speed"))
    parser.add_argument("--output", type=Path, default=Path("reports"))
    options = parser.parse_args()
    try:
        if options.check:
            return 1 if check.run() else 0
        if not options.report:
            bench(options)
        print(page.write(options.output))
    except GGBenchError as error:
        print(f"Error: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
