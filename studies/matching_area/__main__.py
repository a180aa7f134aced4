"""Command ``python -m matching_area``: flights and page of the study, or only the page."""

from __future__ import annotations

import argparse
import multiprocessing
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from ggbench.errors import GGBenchError
from ggbench.files.writing import written_whole

from . import page
from .design import REGIONS, Region
from .flying import Runs, jobs, rows_of_cell

DIGITS = 5


def fly(regions: Sequence[Region], runs: Runs, processes: int) -> pd.DataFrame:
    """Fly the study and return its table, one row per track, in the order of the cells."""
    work = jobs(regions, runs)
    rows: list[dict[str, Any]] = []
    if processes == 1:
        for job in work:
            rows += rows_of_cell(job)
            _say(len(rows), work)
        return pd.DataFrame(rows)
    # Spawned, because forked processes do not inherit the threads of compiled code.
    with multiprocessing.get_context("spawn").Pool(processes) as pool:
        for found in pool.imap(rows_of_cell, work):
            rows += found
            _say(len(rows), work)
    return pd.DataFrame(rows)


def _say(tracks: int, work: Sequence[object]) -> None:
    print(f"tracks flown: {tracks} (cells in total: {len(work)})", file=sys.stderr, flush=True)


def write(table: pd.DataFrame, path: Path) -> None:
    """Write the table as a CSV file, with numbers to five digits."""
    with written_whole(path, GGBenchError) as file:
        table.to_csv(file, index=False, float_format=f"%.{DIGITS}g")


def main() -> int:
    """Run the command and return its exit code."""
    parser = argparse.ArgumentParser(prog="matching_area", description=__doc__)
    parser.add_argument("--report", action="store_true", help="only write the page, from the table")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--output", type=Path, default=Path("reports"))
    options = parser.parse_args()
    path = options.output / page.FOLDER / page.TRACKS
    try:
        if not options.report:
            write(fly(REGIONS, Runs(), options.processes), path)
        print(page.write(pd.read_csv(path), options.output))
    except GGBenchError as error:
        print(f"Error: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
