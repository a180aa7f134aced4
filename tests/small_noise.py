"""Coloured noise of two channels, and survey lines with readings: small ones for tests."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from small_cases import blank_map

from ggbench.gravity.coloured_noise import VectorAutoregression
from ggbench.maps.recipe import write

NOISE = VectorAutoregression(
    ("xx", "xz"),
    1.0,
    np.array([[[0.9, 0.3], [-0.2, 0.6]], [[-0.3, 0.0], [0.1, -0.1]]]),
    np.array([[2.0, 0.5], [0.5, 1.0]]),
    "of no instrument",
)
"""Of two channels, of second order; each tells of the other."""
LINES = ("10", "20.1", "30")
SECONDS = 25
"""Samples of a line less one."""


def survey(path: Path) -> str:
    """Write three lines of readings that are noise, northward 40 m apart, and return the path."""
    rng = np.random.default_rng(2)
    rows = ["line,kind,date,time_s,latitude_deg,longitude_deg,height_m,xx,xz_eotvos,yy"]
    for number, name in enumerate(LINES):
        for second in range(SECONDS + 1 + number):
            latitude = 33.5 + math.degrees(60.0 * second / 6.37e6)
            place = f"{latitude:.9f},{108.0 + 0.0004 * number:.9f},{10000.0 + 0.1 * second:.2f}"
            read = ",".join(f"{value:.3f}" for value in rng.normal(0.0, 10.0, 3))
            rows.append(f"{name},repeat,2008-07-06,{1000.0 * number + second:.2f},{place},{read}")
    path.write_text("\n".join(rows) + "\n")
    return str(path)


MIDDLE = 20.0
"""Seconds of each line that are flown."""


def survey_folder(folder: Path) -> Path:
    """Survey lines, a noise model and a map of nothing, by which readings are not touched."""
    survey(folder / "lines.csv")
    NOISE.write(folder / "noise.json")
    write(folder / "map.nc", blank_map())
    return folder


def keys_of_lines(folder: Path) -> dict[str, Any]:
    """Changes of the small scenario that fly the lines of such a folder."""
    start = dict.fromkeys(
        f"trajectory.{key}"
        for key in ("latitude_deg", "longitude_deg", "height_m", "speed_mps", "heading_deg")
    )
    return start | {
        "trajectory.segment": None,
        "trajectory.file": str(folder / "lines.csv"),
        "trajectory.lines": list(LINES),
        "trajectory.middle_s": MIDDLE,
        "gradiometer.readings": "measured",
        "gradiometer.instrument": "local-level",
        "gradiometer.components": ["xx", "xz"],
        "field.source": str(folder / "map.nc"),
    }
