"""Command ``python -m recorded_drive``: drift in GNSS outages, table and page."""

from __future__ import annotations

import sys
from pathlib import Path

from ggbench.errors import GGBenchError
from ggbench.results import digest

from . import page
from .outages import fly


def main() -> int:
    """Fly the outages, write the table and the page, and return the exit code."""
    output = Path("reports")
    try:
        table = fly()
        print(page.write(table, output))
        digest.write_csv(table, output / page.FOLDER / page.OUTAGES)
    except GGBenchError as error:
        print(f"Error: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
