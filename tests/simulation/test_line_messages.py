"""Messages of survey lines that are flown."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from small_cases import small_case
from small_noise import SECONDS, keys_of_lines, survey_folder

from ggbench.errors import GGBenchError
from ggbench.simulation.error_free_flight import prepare


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return survey_folder(tmp_path_factory.mktemp("measured"))


def gradients(*cells: str) -> Callable[[list[str]], list[str]]:
    """Other gradients on line 8."""
    return lambda rows: [*rows[:7], ",".join([*rows[7].split(",")[:7], *cells]), *rows[8:]]


def apart(seconds: float) -> Callable[[list[str]], list[str]]:
    """Lines that begin so many seconds after one another."""

    def moved(row: str) -> str:
        cells = row.split(",")
        number, time = divmod(float(cells[3]), 1000.0)
        return ",".join([*cells[:3], str(time + seconds * number), *cells[4:]])

    return lambda rows: [rows[0], *map(moved, rows[1:])]


ONE = {"trajectory.lines": ["10"]}
TURNS = {"trajectory.middle_s": None, "trajectory.made_up_turns": True}
MARK = "line 8: xz is .* leave the cells of missing"
EXCLUDE = "exclude each other"
BAD_KEYS = {
    "an unknown component": ({"gradiometer.components": ["xx", "xy"]}, "has no column xy"),
    "an unknown line": (
        {"trajectory.lines": ["31.1"]},
        "there is no line '31.1'; its lines: 10, 20.1, 30",
    ),
    "a line twice": ({"trajectory.lines": ["10", "10"]}, "lines: names a line twice"),
    "no line": ({"trajectory.lines": []}, "'middle_s' applies to survey lines"),
    "lines of unequal lengths": ({"trajectory.middle_s": None}, "middle_s is missing"),
    "a middle longer than a line": (
        {"trajectory.middle_s": 26.0},
        f"line 10 lasts {SECONDS} s, but middle_s is 26",
    ),
    "a middle between samples": (
        {"trajectory.middle_s": 19.5},
        "must be a multiple of the interval",
    ),
    "another period": (
        {"gradiometer.period_s": 1.5},
        "has a sample every 1 s, but gradiometer.period_s is 1.5",
    ),
    "a platform": (
        {"gradiometer.instrument": "platform"},
        r'\(east, north, up\), found "platform"',
    ),
    "a latency": ({"gradiometer.latency_s": 0.5}, EXCLUDE),
    "noise of the truth": (
        {"truth.gradiometer.noise_eotvos": 1.0},
        "already contain their errors",
    ),
    "no file": ({"trajectory.file": "gone.csv"}, "cannot read"),
    "drawn maps": ({"draw.maps": 2, "model.field.error.white_noise_eotvos": 1.0}, EXCLUDE),
}
"""Changes of keys, and messages."""
BAD_ROWS: dict[str, tuple[Callable[[list[str]], list[str]], dict[str, Any], str]] = {
    "gradients of zero": (
        gradients("0.0", "-0.0", "0"),
        {},
        "line 8: xx, xz, yy are all 0, in 1 of 81 rows; leave the cells of missing",
    ),
    **{
        f"a gradient of {cell}": (gradients("1.0", cell, "2.5"), {}, MARK)
        for cell in ("-9999", "-9999.999", "-1e32", "2e5")
    },
    "lines that overlap": (apart(10.0), TURNS, "sampling intervals of 1 s, at least 2"),
    "lines apart by a fraction of the interval": (
        apart(100.5),
        TURNS,
        "lasts 75.5 s and must last a whole number of sampling intervals of 1 s",
    ),
    "lines too far apart": (apart(30.0), TURNS, "cannot be flown: the vehicle moves"),
    "no kinds of lines": (
        lambda rows: [rows[0].replace("kind", "sort"), *rows[1:]],
        ONE,
        "must name a column kind once",
    ),
    "a line in two parts": (
        lambda rows: [*rows[:9], *rows[30:], *rows[9:30]],
        ONE,
        "are not consecutive",
    ),
    "a gap in a line": (lambda rows: [*rows[:5], *rows[7:]], ONE, "must come every"),
    "a line of three samples": (lambda rows: rows[:4], ONE, "a line needs at least 5"),
    "no measurements": (
        lambda rows: [row.rsplit(",", 3)[0] for row in rows],
        ONE,
        "names no column of measurements",
    ),
    "a word as height": (
        lambda rows: [*rows[:3], rows[3].replace("10000", "high"), *rows[4:]],
        ONE,
        "line 4: height_m",
    ),
}
"""Changes of a file's rows, changes of keys, and messages."""


def is_refused(keys: dict[str, Any], message: str) -> str:
    """Assert that a flight is refused by a message that names a file at most once."""
    kept = {k: v for k, v in keys.items() if k != "trajectory.middle_s" or v is not None}
    with pytest.raises(GGBenchError, match=message) as caught:
        prepare(small_case(kept))
    assert str(caught.value).count("survey lines /") < 2
    return str(caught.value)


@pytest.mark.parametrize("kind", BAD_KEYS)
def test_a_bad_key_of_lines_is_refused(kind, folder):
    changes, message = BAD_KEYS[kind]
    assert not re.search("pydantic", is_refused(keys_of_lines(folder) | changes, message))


@pytest.mark.parametrize("kind", BAD_ROWS)
def test_a_bad_file_of_lines_is_refused_with_its_path(kind, folder, tmp_path):
    change, changes, message = BAD_ROWS[kind]
    path = tmp_path / "bad.csv"
    path.write_text("\n".join(change((folder / "lines.csv").read_text().splitlines())))
    keys = keys_of_lines(folder) | {"trajectory.file": str(path)} | changes
    assert str(path) in is_refused(keys, message)
