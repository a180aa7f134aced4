"""Command ``python -m measured_surveys [ARCHIVE]``: files of scenarios/data/measured.

ARCHIVE is galileoqc-1.0.16.tar.gz, the source archive on PyPI, with the survey lines. Without
ARCHIVE the command writes only maps and noise models, from the shipped lines. The command needs the
extra ``terrain``.

``--navigate 320,190,1 500,300,0.2`` writes no files. It compares maps of Vinton Dome by navigation
over held-back lines. Each map is given by depth [m], spacing [m] and damping, and takes some
minutes.
"""

from __future__ import annotations

import argparse
import hashlib
import tarfile
import tempfile
from pathlib import Path

from ggbench.maps.equivalent_sources import Settings
from ggbench.maps.survey_files import read_lines
from ggbench.maps.survey_fit import FitOptions
from ggbench.maps.surveyed import surveyed

from .navigating import print_table
from .surveys import EAST_VICTORIA, FOSTERVILLE, VINTON, east_victoria, fosterville, vinton
from .writing import write, write_map

SHA256 = "b9f0de6f1c086c1d47b02300a67bb9514435f6ed739ec79da217c6d1bdf1ea06"


SURVEYS = {
    "vinton2008": (VINTON, vinton),
    "fosterville2019": (FOSTERVILLE, fosterville),
    "east_victoria2023": (EAST_VICTORIA, east_victoria),
}
_DOME = FitOptions(320.0, 190.0, 1.0)
SETTINGS = {
    "vinton2008": _DOME,
    "vinton2008_fold1": _DOME,
    "vinton2008_fold2": _DOME,
    "fosterville2019": FitOptions(640.0, 530.0, 0.3),
    "east_victoria2023": FitOptions(2500.0, 1000.0, 0.3),
}
"""Settings of the maps.

The settings of Vinton Dome give the best navigation over held-back lines, see the README of the
data. ``--choose`` finds the settings of Fosterville, in a quarter of an hour. The passes of East
Victoria cover no area; depths of 1.5, 2.5, 4 and 6 km were tried."""
MAPS = {
    name: (lines.survey, lines.leave_out, SETTINGS[name], lines.quantity)
    for name, lines in surveyed().items()
}
"""Survey, excluded lines, settings and measured quantity of each map."""


def main() -> None:
    """Write the tables of the surveys, the maps and the noise models, or compare settings."""
    parser = argparse.ArgumentParser(prog="measured_surveys", description=__doc__)
    parser.add_argument("archive", type=Path, nargs="?")
    parser.add_argument("--output", type=Path, default=Path("scenarios/data/measured"))
    parser.add_argument("--choose", action="store_true", help="choose new settings of the maps")
    parser.add_argument("--navigate", type=_settings, nargs="+", metavar="DEPTH,SPACING,DAMPING")
    options = parser.parse_args()
    if options.navigate:
        lines = read_lines(options.output / "vinton2008.csv.gz")
        print_table(lines.without(MAPS["vinton2008"][1]), options.navigate)
        return
    if options.archive is not None:
        _write_lines(options.archive, options.output)
    for name, (survey, leave_out, wanted, quantity) in MAPS.items():
        chosen = FitOptions() if options.choose and quantity == "gradient" else wanted
        write_map(options.output, name, survey, leave_out, chosen, quantity)


def _settings(text: str) -> Settings:
    try:
        depth, spacing, damping = map(float, text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} must have the form 320,190,1") from None
    return Settings(depth, spacing, damping)


def _write_lines(published: Path, folder: Path) -> None:
    with published.open("rb") as file:
        if hashlib.file_digest(file, "sha256").hexdigest() != SHA256:
            raise SystemExit(f"{published} is not the published galileoqc-1.0.16.tar.gz")
    with tempfile.TemporaryDirectory() as unpacked, tarfile.open(published) as archive:
        for name, (member, table) in SURVEYS.items():
            archive.extract(member, unpacked, filter="data")
            write(folder / f"{name}.csv.gz", table(Path(unpacked) / member))


if __name__ == "__main__":
    main()
