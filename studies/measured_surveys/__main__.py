"""``python -m measured_surveys ARCHIVE``: write scenarios/data/measured from galileoQC's archive.

ARCHIVE is galileoqc-1.0.16.tar.gz, the source archive on PyPI. Needs the extra ``terrain``.
"""

from __future__ import annotations

import argparse
import hashlib
import tarfile
import tempfile
from pathlib import Path

from .surveys import EAST_VICTORIA, FOSTERVILLE, VINTON, east_victoria, fosterville, vinton
from .writing import write

SHA256 = "b9f0de6f1c086c1d47b02300a67bb9514435f6ed739ec79da217c6d1bdf1ea06"


def main() -> None:
    """Write a table for each survey."""
    parser = argparse.ArgumentParser(prog="measured_surveys", description=__doc__)
    parser.add_argument("archive", type=Path)
    parser.add_argument("--output", type=Path, default=Path("scenarios/data/measured"))
    options = parser.parse_args()
    with options.archive.open("rb") as file:
        if hashlib.file_digest(file, "sha256").hexdigest() != SHA256:
            raise SystemExit(f"{options.archive} is not galileoqc-1.0.16.tar.gz as published")
    surveys = {
        "vinton2008": (VINTON, vinton),
        "fosterville2019": (FOSTERVILLE, fosterville),
        "east_victoria2023": (EAST_VICTORIA, east_victoria),
    }
    with tempfile.TemporaryDirectory() as folder, tarfile.open(options.archive) as archive:
        for name, (member, table) in surveys.items():
            archive.extract(member, folder, filter="data")
            write(options.output / f"{name}.csv.gz", table(Path(folder) / member))


if __name__ == "__main__":
    main()
