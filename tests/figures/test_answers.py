"""The figures that reports begin with show the numbers that their axes promise."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.colors import to_rgba

from ggbench.figures import answer, nonlinearity, style
from ggbench.figures.line_styles import line_styles
from ggbench.figures.locking import Series

LABELS = ("ekf", "ukf[points=cubature]")


def ranges(seed: int, count: int) -> Series:
    low, value, high = np.sort(np.random.default_rng(seed).uniform(0.1, 0.9, (3, count)), axis=0)
    return Series(value, low, high)


def test_success_stands_over_errors_case_by_case():
    """Each value at its case with a bar from low to high, each estimator in its look."""
    shares = {label: ranges(k, 3) for k, label in enumerate(LABELS)}
    ratios = {label: ranges(k + 7, 3) for k, label in enumerate(LABELS)}
    ratios["ekf"].value[1] = ratios["ekf"].low[1] = ratios["ekf"].high[1] = np.nan
    figure = answer.over_cases(["a", "b", "c"], shares, ratios)
    top, bottom = figure.axes
    for axis, given in ((top, shares), (bottom, ratios)):
        for container, label in zip(axis.containers, LABELS, strict=True):
            points, _, (bars,) = container
            assert to_rgba(points.get_color()) == to_rgba(line_styles([label])[label].color)
            assert points.get_ydata() == pytest.approx(given[label].value, nan_ok=True)
            assert np.round(points.get_xdata()).tolist() == [0.0, 1.0, 2.0]
            known = np.isfinite(given[label].value)
            ends = np.array([s[:, 1] for s in bars.get_segments() if len(s)])
            assert ends[:, 0] == pytest.approx(given[label].low[known])
            assert ends[:, 1] == pytest.approx(given[label].high[known])
    first, second = (c.lines[0].get_xdata() for c in top.containers)
    assert (first < second).all()
    assert "success" in top.get_ylabel() and top.get_yscale() == "linear"
    assert "error / bound" in bottom.get_ylabel() and bottom.get_yscale() == "log"
    assert [text.get_text() for text in bottom.get_xticklabels()] == ["a", "b", "c"]
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == list(LABELS)


WIDTH = np.array([0.1, 0.4, 1.6])
CURVES = {"ekf": (WIDTH, np.array([1.0, 0.8, 0.1])), "tercom": (WIDTH[:2], np.array([0.9, 0.7]))}
ERRORS = {"ekf": (WIDTH[:2], np.array([2.0, 9.0])), "tercom": (WIDTH[:2], np.array([3.0, 4.0]))}


def curves(axis) -> list[tuple[list[float], list[float], str]]:
    """Points and colour of the curves of an axis, without the line of the bound."""
    return [
        (list(line.get_xdata()), list(line.get_ydata()), line.get_color())
        for line in axis.get_lines()
        if line.get_marker() not in ("None", "")
    ]


def wanted(given) -> list[tuple[list[float], list[float], str]]:
    return [
        (list(x), list(y), line_styles([label])[label].color) for label, (x, y) in given.items()
    ]


def test_success_and_error_stand_against_the_width_of_the_prior():
    """Shares on the left in percent, errors over the bound on the right, with the bound at one."""
    ends = {
        label: np.stack([0.9 * share, 0.5 + 0.5 * share]) for label, (_, share) in CURVES.items()
    }
    figure = nonlinearity.against_width(CURVES, ends, ERRORS)
    left, right = figure.axes
    bars = [np.array(bar.get_segments())[:, :, 1].T for bar in left.collections]
    assert [bar.tolist() for bar in bars] == [ends[label].tolist() for label in CURVES]
    assert curves(left) == wanted(CURVES)
    assert curves(right) == wanted(ERRORS)
    assert (left.get_xscale(), left.get_yscale(), right.get_yscale()) == ("log", "linear", "log")
    assert left.yaxis.get_major_formatter()(0.5, 0) == "50 %"
    assert "share of runs" in left.get_ylabel() and "error / bound" in right.get_ylabel()
    assert [1.0, 1.0] in [list(line.get_ydata()) for line in right.get_lines()]
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == ["ekf", "tercom"]


def test_every_setting_has_its_panel():
    """Under its title, estimators in the same colours; a panel may lack one."""
    panels = [CURVES, {"tercom": ERRORS["tercom"]}, {}]
    figure = nonlinearity.each_setting(["one", "two", "three"], panels, 2)
    assert [axis.get_title() for axis in figure.axes] == ["one", "two", "three", ""]
    for axis, panel in zip(figure.axes, panels, strict=False):
        assert curves(axis) == wanted(panel)
    assert figure.axes[0].get_shared_x_axes().joined(*figure.axes[:2])
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == ["ekf", "tercom"]


def test_where_nobody_succeeds_the_figure_is_drawn_all_the_same(tmp_path):
    """Without a ratio there is no scale to be found, and no warning."""
    nothing = Series(*np.full((3, 1), np.nan))
    none = Series(np.zeros(1), np.zeros(1), np.array([0.5]))
    figure = answer.over_cases(["lost"], {"ekf": none}, {"ekf": nothing})
    style.save(figure, tmp_path / "answer.png")
    assert figure.axes[1].get_ylim() == (0.5, 2.0)
