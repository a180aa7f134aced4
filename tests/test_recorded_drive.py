"""The study of a recorded INS during GNSS outages, and its page."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from recorded_drive import outages, page

from ggbench.recorded.flight import read_flight

REPORTS = Path(__file__).parents[1] / "reports"


@pytest.fixture(scope="module")
def committed():
    return pd.read_csv(REPORTS / page.FOLDER / page.OUTAGES)


def test_an_outage_removes_its_velocities_and_nothing_else():
    """The reference stays, and the inertial record too."""
    whole = read_flight(outages.DRIVE / "flight.toml")
    cut = outages.with_outage(whole.start, 20.0, 10.0)
    times, left = whole.problem.times, cut.problem.times
    removed = np.setdiff1d(times, left)
    assert 20.0 < removed.min() < 20.2
    assert 29.9 < removed.max() <= 30.0
    np.testing.assert_array_equal(cut.sample_times, whole.sample_times)
    kept = np.isin(times, left)
    np.testing.assert_allclose(
        cut.reference.error_state[:, :2], whole.reference.error_state[kept, :2], atol=1e-9
    )


def test_a_flown_outage_is_that_of_the_table(committed):
    flown = outages.fly([10.0], ["ekf"], step_s=20.0)
    held = committed[(committed["estimator"] == "ekf") & (committed["length_s"] == 10.0)]
    held = held.set_index("start_s").loc[flown["start_s"]]
    assert len(flown) == 2
    for name in ("drift_m", "sigma_m"):
        np.testing.assert_allclose(flown[name], held[name], rtol=1e-4)


def test_the_page_is_that_of_the_table(committed):
    assert (REPORTS / f"{page.FOLDER}.md").read_text(encoding="utf-8") == page.page(committed)


def test_a_larger_drift_than_predicted_is_called_larger(committed):
    """The answer follows the table: one length above its deviation suffices."""
    assert "drifts less than predicted" in page.page(committed)
    worse = committed.copy()
    worse.loc[worse["length_s"] == 5.0, "drift_m"] *= 3.0
    assert "drifts more than predicted" in page.page(worse)


def test_rms_and_disjoint_outages_are_those_of_the_rows():
    table = pd.DataFrame(
        {
            "estimator": ["ekf", "ekf", page.SMOOTHER, page.SMOOTHER],
            "length_s": 10.0,
            "start_s": [15.0, 25.0, 15.0, 25.0],
            "drift_m": [3.0, 4.0, 1.0, 1.0],
            "sigma_m": [2.0, 2.0, np.nan, np.nan],
        }
    )
    row = page.summary(table).loc[10.0]
    assert row["drift_m"] == pytest.approx(np.sqrt(12.5))
    assert (row["outages"], row["disjoint"], row["sigma_m"], row["smoother_m"]) == (2, 2, 2.0, 1.0)
