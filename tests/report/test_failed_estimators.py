"""Reports of campaigns in which an estimator gave nothing, and reports that are not finished."""

from __future__ import annotations

from pathlib import Path

import pytest
from campaigns import ran, small
from problems import SMALL

from ggbench.report import columns, html_page, pictures, render

SOURCE = """
from dataclasses import dataclass
import numpy as np
from ggbench.problem import Estimate, Estimator


@dataclass(frozen=True)
class Fails(Estimator):
    name = "fails"
    causality = "filter"

    def estimate(self, problem, rng):
        raise ValueError("no\\n\\n# answer ![x](http://e) <b>")
"""

FILTER = """
filter = "butterworth"
filter_order = 3
filter_cutoff_hz = 0.2
filter_treatment = "whitened"
whitening_regularization = 1e-2
"""
"""A low-pass, whose effect on the bound a page states."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """A campaign with published numbers whose first estimator fails in all runs."""
    place = tmp_path_factory.mktemp("failed")
    (place / "fails.py").write_text(SOURCE)
    text = SMALL.replace("[gradiometer]\n", f"[gradiometer]\n{FILTER}", 1)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(place)
        loaded = small(place, text)
        ran(place, labels=("fails.py", "ekf"), runs=2, scenario=loaded).store.close()
    return place


@pytest.mark.long
def test_a_page_says_who_failed_in_all_runs(folder):
    """With the reason, as text; the published numbers have the bound of the others."""
    page, *_ = render.write(folder / "out", folder / "reports")
    text = page.read_text(encoding="utf-8")
    assert "`fails` failed in all runs: ValueError: no # answer" in text
    assert "![x]" not in text and "<b>" not in text.replace("\\<b", "")
    assert "## Published numbers" in text
    assert "nan" not in text.lower().replace("dominant", "")


@pytest.mark.long
@pytest.mark.parametrize(("place", "name"), [(pictures, "of_answer"), (html_page, "write")])
def test_a_report_is_written_whole_or_not_at_all(folder, place, name, monkeypatch):
    """What ends it late leaves an older report as it was, and no file beside it."""
    output = folder / f"reports-{name}"
    render.write(folder / "out", output)
    before = {path: path.read_bytes() for path in output.rglob("*") if path.is_file()}
    (output / "small.md").write_text("older")

    def end(*arguments: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(place, name, end)
    with pytest.raises(KeyboardInterrupt):
        render.write(folder / "out", output)
    assert {path for path in output.rglob("*") if path.is_file()} == set(before)
    assert (output / "small.md").read_text() == "older"
    with pytest.raises(KeyboardInterrupt):
        render.write(folder / "out", folder / "none")
    assert not (folder / "none").exists()


@pytest.mark.parametrize("form", ["metres", "ratio", "efficiency", "share"])
def test_no_format_fails_on_what_is_no_number(form):
    shown = getattr(columns, form)
    assert shown(float("nan")) in (columns.NONE, "nan")
    assert shown(float("nan")) == columns.NONE
    assert shown(float("inf")) == "∞"
