"""A campaign without a gradiometer, with a receiver that has an outage: judged and reported."""

from __future__ import annotations

import math

import pytest
from campaigns import ran, small
from problems import SMALL
from small_cases import ON_BOARD

import ggbench as gg
from ggbench.judging.statistics import mean_band
from ggbench.report import render
from ggbench.results.folder import Results

OUTAGE = "[truth.gnss]\ndropouts_s = [[5.0, 12.0]]\n"


def tables(changes: dict[str, object]) -> str:
    """Dotted keys as the text of a scenario file."""
    return "".join(f"{key} = {value!r}\n".replace("'", '"') for key, value in changes.items())


@pytest.fixture(scope="module")
def results(tmp_path_factory) -> Results:
    folder = tmp_path_factory.mktemp("sensors")
    start, end = SMALL.index("[gradiometer]"), SMALL.index("[field]")
    text = SMALL[:start] + OUTAGE + SMALL[end:]
    scenario = small(folder, tables(ON_BOARD) + text[: text.index("[[case]]")] + CASE)
    labels = ("ins", "ekf", "ukf", "factor-graph[mode=fixed-lag,lag=3]")
    return ran(folder, labels=labels, runs=30, scenario=scenario)


CASE = "[[case]]\nname = 'base'\ntitle = 'three sensors'\n"


def test_filters_of_all_engines_are_consistent_and_at_the_bound(results):
    """NEES in its band of 95 %, NIS in its own, error within a quarter of the bound, in 30 runs.

    The seed is fixed; a band is left by one seed in twenty.
    """
    table = results.metrics()
    settled = table[table["window"] == "settled"].set_index("estimator")
    for label in ("ekf", "ukf"):
        row = settled.loc[label]
        assert row["nees_lo"] < row["nees"] < row["nees_hi"]
        assert row["nis_lo"] < row["nis"] < row["nis_hi"]
        assert 0.75 < row["efficiency"] < 1.25
    assert settled.loc["factor-graph[mode=fixed-lag,lag=3]", "efficiency"] < 1.25
    assert settled.loc["ins", "efficiency"] > 1.5


def test_the_band_of_the_nis_counts_the_channels_that_come(results):
    """Of 40 epochs in 20 s: a barometer at each, a log of two in 10, six of the receiver in 12.

    It is read at whole seconds, from 5 to 12 s not.
    """
    table = results.metrics()
    row = table[(table["window"] == "whole") & (table["estimator"] == "ekf")].iloc[0]
    numbers = 40 + 2 * 10 + 6 * 12
    assert (row["nis_lo"], row["nis_hi"]) == pytest.approx(mean_band(30 * 40, numbers / 40))
    assert row["nis"] == pytest.approx(numbers / 40, rel=0.2)


def test_without_a_gradiometer_there_is_no_gradient_along_the_track(results):
    with pytest.raises(gg.GGBenchError, match="case base has no gradiometer"):
        gg.Results(results.folder).plot_track_gradient()


@pytest.mark.long
def test_the_report_draws_what_there_is(results, tmp_path):
    text = render.write(results.folder, tmp_path)[0].read_text()
    assert "|Gradiometer|" not in text and "|Other sensors|" in text
    assert "GNSS" in text and (tmp_path / "small" / "answer.png").exists()


def test_a_lag_is_its_time_whatever_the_epochs(results):
    """The bound of a lag of 3 s is that of six epochs of half a second, everywhere."""
    arrays = results.arrays("base")
    assert "bound-fixed-lag-6" in arrays
    assert (arrays["bound-fixed-lag-6"] <= arrays["bound-filter"] * (1.0 + 1e-9)).all()
    assert math.isclose(arrays["times"][1] - arrays["times"][0], 0.5)
