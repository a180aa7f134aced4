"""Columns of recorded flights as logs have them: quotes, names behind a #, clocks from 0 on."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

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


def test_lines_are_counted_from_the_first_of_the_file(tmp_path):
    """Names behind a # may be followed by further remarks."""
    path = write(tmp_path / "a.csv", "# time_s,height_m\n# s,m", [*ROWS[:2], "2,high"])
    with pytest.raises(FlightError, match="line 5: height_m is 'high'"):
        read(path, ("height_m",))


@pytest.mark.parametrize(("period", "clock"), [(604_800, "GPS week"), (86_400, "day")])
def test_a_clock_that_begins_at_zero_is_named(period, clock, tmp_path):
    rows = [f"{(period - 3 + t) % period},1.0" for t in range(6)]
    columns = read(write(tmp_path / "a.csv", "time_s,height_m", rows), ("height_m",))
    message = f"line 5: .* the seconds of the {clock} restart there: add {period}"
    with pytest.raises(FlightError, match=message):
        clocked(columns, 0.0)


def test_times_in_messages_have_no_digits_of_rounding(tmp_path):
    """0.1 + 0.2 is 0.3 for a reader; microseconds since 1970 are kept."""
    for times, message in (
        ([0.0, 0.1 + 0.2, 0.1 + 0.2], "time 0.3 s is there twice"),
        ([0.0, 1403636579.758556, 1403636579.758555], "time 1403636579.758555 s is behind"),
    ):
        rows = [f"{time:.17g},1.0" for time in times]
        columns = read(write(tmp_path / "a.csv", "time_s,height_m", rows), ("height_m",))
        with pytest.raises(FlightError, match=message):
            clocked(columns, 0.0)


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


@pytest.mark.parametrize(
    ("key", "name", "said"),
    [
        ("height_m", "alt_msl", "add the height of the geoid"),
        ("height_m", "depth", "positive down"),
        ("latitude_deg", "longitude", "columns are swapped"),
        ("longitude_deg", "lon_w", "positive west"),
    ],
)
def test_a_name_that_contradicts_its_key_is_refused(key, name, said, tmp_path):
    path = write(tmp_path / "a.csv", f"time_s,{name}")
    with pytest.raises(FlightError, match=said):
        read(path, (key,), names={key: name})
