"""Command ``python -m turbulence``: tracks of the scenario ``turbulence`` as CSV files."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from . import INTENSITIES
from .flying import COLUMNS, track


def main() -> None:
    """Simulate a flight for each intensity and write its track as a CSV file."""
    parser = argparse.ArgumentParser(prog="turbulence", description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("scenarios/data"))
    options = parser.parse_args()
    for intensity in INTENSITIES:
        np.savetxt(
            options.output / f"turbulence_{intensity}.csv",
            track(intensity),
            fmt=[f"%.{decimals}f" for decimals in COLUMNS.values()],
            delimiter=",",
            header=",".join(COLUMNS),
            comments="",
            encoding="ascii",
        )


if __name__ == "__main__":
    main()
