"""Columns of recorded flights as logs have them: quotes, names behind a #, clocks from 0 on."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from refusals import refused

from ggbench.recorded.columns import read
from ggbench.recorded.time_base import clocked
from ggbench.spec.flight import FlightError

ROWS = [f"{t},{0.1 * t:.1f}" for t in range(6)]


def write(path: Path, names: str, rows: list[str] = ROWS) -> Path:
    path.write_text("\n".join([names, *rows, ""]))
    return path


@pytest.mark.parametrize(
    ("names", "rows"),
    [
        ("time_s,height_m", ROWS),
        ("# time_s,height_m", ROWS),
        ("# made by numpy\n# time_s,height_m", ROWS),
        ("sep=,\ntime_s,height_m", ROWS),
        ("time_s,height_m,place", [f'{row},"48.1,11.5"' for row in ROWS]),
        ('"time_s","height_m","place, deg"', [f'{row},"a ""b"", c"' for row in ROWS]),
    ],
)
def test_one_log_in_many_spellings(names, rows, tmp_path):
    columns = read(write(tmp_path / "a.csv", names, rows), ("height_m",))
    np.testing.assert_array_equal(columns["time_s"], np.arange(6.0))
    np.testing.assert_allclose(columns["height_m"], 0.1 * np.arange(6.0))


@pytest.mark.parametrize(
    "names",
    [
        "% made by a program\ntime_s,height_m",
        "% 5 Hz, at rest\ntime_s,height_m",
        "% time_s,height_m",
    ],
)
def test_comments_of_matlab_are_passed_over(names, tmp_path):
    columns = read(write(tmp_path / "a.csv", names), ("height_m",))
    np.testing.assert_allclose(columns["height_m"], 0.1 * np.arange(6.0))


@pytest.mark.parametrize(
    ("name", "factor"), [("alt_ft", 0.3048), ("Height feet", 0.3048), ("alt_mm", 1e-3)]
)
def test_a_unit_at_the_end_of_a_name_counts(name, factor, tmp_path):
    path = write(tmp_path / "a.csv", f"time_s,{name}")
    columns = read(path, ("height_m",), names={"height_m": name})
    np.testing.assert_allclose(columns["height_m"], 0.1 * factor * np.arange(6.0))
    assert columns.states_unit("height_m")


def timed(*times: float) -> str:
    return "\n".join(["time_s,height_m", *(f"{time:.17g},1.0" for time in times)])


def clock(period: int) -> str:
    """Times that begin at zero again on line 5."""
    return timed(*((period - 3 + t) % period for t in range(6)))


def table(names: str) -> str:
    return "\n".join([names, *ROWS])


RESTART = "line 5: .* the seconds of the {} restart there: add {}"
BAD = {
    "a word below remarks": (
        "\n".join(["# time_s,height_m", "# s,m", *ROWS[:2], "2,high"]),
        {},
        "line 5: height_m is 'high'",
    ),
    "seconds of a week": (clock(604_800), {}, RESTART.format("GPS week", 604_800)),
    "seconds of a day": (clock(86_400), {}, RESTART.format("day", 86_400)),
    "a time twice": (timed(0.0, 0.1 + 0.2, 0.1 + 0.2), {}, "time 0.3 s occurs twice"),
    "a time behind by a microsecond": (
        timed(0.0, 1403636579.758556, 1403636579.758555),
        {},
        "time 1403636579.758555 s is less than",
    ),
    "heights above sea level": (
        table("time_s,alt_msl"),
        {"height_m": "alt_msl"},
        "add the height of the geoid",
    ),
    "depths": (table("time_s,depth"), {"height_m": "depth"}, "positive down"),
    "swapped coordinates": (
        table("time_s,longitude"),
        {"latitude_deg": "longitude"},
        "columns are swapped",
    ),
    "west longitudes": (table("time_s,lon_w"), {"longitude_deg": "lon_w"}, "positive west"),
}
"""Logs, names of their columns, and messages: their lines count from the file's first."""


@pytest.mark.parametrize("kind", BAD)
def test_a_bad_log_is_refused_in_one_sentence(kind, tmp_path):
    text, names, message = BAD[kind]
    path = tmp_path / "a.csv"
    path.write_text(text + "\n")
    with refused(FlightError, message):
        clocked(read(path, tuple(names) or ("height_m",), names=names or None), 0.0)
