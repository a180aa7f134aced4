"""The registry of columns: every column of the tables has a heading, and numbers their digits."""

from __future__ import annotations

import math

import numpy as np
import pytest

from ggbench.judging import fix_metrics
from ggbench.judging.cases import CASES
from ggbench.judging.pairs import PAIRS
from ggbench.judging.summary import METRICS
from ggbench.report import columns


@pytest.mark.parametrize("key", sorted({*METRICS, *CASES, *PAIRS, *fix_metrics.COLUMNS}))
def test_every_column_of_the_tables_is_registered(key):
    assert key in columns.COLUMNS


def test_every_defined_column_has_a_definition():
    assert [key for key in columns.DEFINED if not columns.COLUMNS[key].definition] == []


@pytest.mark.parametrize(
    ("key", "value", "text"),
    [
        ("rms_m", 3.3249, "3.32"),
        ("rms_m", 0.0099999, "0.0100"),
        ("rms_m", 12345.6, "12300"),
        ("rms_m", 2.5e7, "2.50e+07"),
        ("rms_m", 0.0, "0"),
        ("rms_m", math.nan, "–"),
        ("rms_m", math.inf, "∞"),
        ("efficiency", 1.004, "1.00"),
        ("efficiency", 17.24, "17"),
        ("success", 1.0, "100%"),
        ("success", 0.999, ">99%"),
        ("success", 0.05, "5.0%"),
        ("seconds_per_run", 0.0123, "10 ms"),
        ("seconds_per_run", 14.0, "10 s"),
        ("runs", 40, "40"),
        ("right_model", np.True_, "yes"),
        ("case", "null", "null"),
        ("p", 1e-5, "< 0.001"),
        ("a_counter", 12.34, "12.3"),
    ],
)
def test_numbers_have_their_digits(key, value, text):
    """Metres three, ratios and shares two, times one; no value is a dash."""
    assert columns.cell(key, value) == text


def test_a_heading_has_the_unit_of_numbers_without_one():
    """A time of a run is written as 10 ms."""
    heads = [columns.COLUMNS[key].head for key in ("rms_m", "efficiency", "seconds_per_run")]
    assert heads == ["RMS error [m]", "× oracle", "time a run"]


@pytest.mark.parametrize("form", ["metres", "ratio", "efficiency", "share"])
def test_sentences_have_a_dash_for_a_failed_estimator(form):
    """Templates write numbers without the check of a cell."""
    write = getattr(columns, form)
    assert write(math.nan) == "–" and write(1.0) != "–"
