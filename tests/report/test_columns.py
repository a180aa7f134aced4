"""The registry of columns: every column of the tables has a heading, and numbers their digits."""

from __future__ import annotations

import math
import re
from io import StringIO
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from reporting import metric
from rich.console import Console

from ggbench.cli import terminal
from ggbench.judging import fix_metrics
from ggbench.judging.cases import CASES
from ggbench.judging.pairs import PAIRS
from ggbench.judging.summary import METRICS
from ggbench.report import columns, render, tables


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
        ("rms_m", 2.5e6, "2.50e+06"),
        ("rms_m", 1e7, "1.00e+07"),
        ("rms_m", 1.001e7, ">1e7"),
        ("rms_hi", 3.4e17, ">1e7"),
        ("bound_m", 1e8, ">1e7"),
        ("error_ratio", 4.2e15, ">1e7"),
        ("efficiency", 2.6e10, ">1e7"),
        ("map_evaluations", 2.5e7, "2.50e+07"),
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


def test_ends_of_intervals_beyond_the_earth_are_limits_wherever_they_are_printed():
    """In a cell, in a sentence, in the terminal; the page of definitions states the rule."""
    row = metric("c0", "ekf", "settled", 3e17) | {"rms_hi": 2e18, "consistency": "unsafe"}
    assert tables.error_cell(row | {"efficiency": 1e14}) == ">1e7 (×>1e7) ‡"
    windows = SimpleNamespace(settled_from_s=100.0)
    case = SimpleNamespace(name="c0", title="A case", windows=windows, reference=None)
    runs = pd.DataFrame([{"status": "ok", "cold": False, "case": "c0", "estimator": "ekf"}])
    console = Console(width=200, record=True, file=StringIO())
    settled = pd.DataFrame([row | {"noise_fit": ""}])
    terminal.print_metrics(settled, runs, SimpleNamespace(cases=[case]), console)
    assert re.search(r">1e7 +[\d.]*[^\n]*-?>1e7", console.export_text())
    assert "Numbers beyond 10⁷: >1e7." in render.definitions()


def test_a_heading_has_the_unit_of_numbers_without_one():
    """A time of a run is written as 10 ms."""
    heads = [columns.COLUMNS[key].head for key in ("rms_m", "efficiency", "seconds_per_run")]
    assert heads == ["RMS error [m]", "× oracle", "median time per run"]


@pytest.mark.parametrize("form", ["metres", "ratio", "efficiency", "share"])
def test_sentences_have_a_dash_for_a_failed_estimator(form):
    """Templates write numbers without the check of a cell."""
    write = getattr(columns, form)
    assert write(math.nan) == "–" and write(1.0) != "–"
