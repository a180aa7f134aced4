"""The league: a cell for each case and estimator, colours by the ratio, and the profile."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from colour_vision import SIGHT, lab
from matplotlib.colors import to_rgba

from ggbench.figures import league
from ggbench.figures.league import SCALE, WORST, League
from ggbench.figures.line_styles import COLOURS

FAMILIES = {"ins": "inertial", "ekf": "kalman", "mine": "own", "batch": "smoother"}
RATIOS = np.array([[3.0, 1.0, np.inf, 1.0], [30.0, 1.1, 2.0, np.nan]])
TEXTS = np.array([["3.00", "1.00", "lost\n94%‡", "1.00"], ["30", "1.10", "2.00", "–"]])
FRAMED = np.array([[False, True, False, False], [False, False, False, False]])
TO_BEST = {"ins": np.array([3.0, 40.0]), "ekf": np.ones(2), "mine": np.array([np.nan, 2.0])}


def drawn(**changes):
    """The figure of two cases and four estimators, the last one a smoother."""
    held = League(
        cases=["narrow (5 m)", "wide (9 m)"],
        estimators=[*FAMILIES],
        smoothers=1,
        ratios=RATIOS,
        texts=TEXTS,
        framed=FRAMED,
        to_best=TO_BEST,
    )
    return league.league(held._replace(**changes), FAMILIES)


def cells(axis) -> dict[tuple[float, float], object]:
    """The colour of the cells by the place of their middle."""
    return {
        (patch.get_x() + 0.5, patch.get_y() + 0.5): patch.get_facecolor()
        for patch in axis.patches
        if patch.get_fill()
    }


def test_cells_have_texts_and_the_colour_of_their_ratio():
    """Smoothers stand apart; lost runs have the last colour; without a ratio a cell is grey."""
    grid, _ = drawn().axes
    texts = {text.get_position(): text.get_text() for text in grid.texts[: TEXTS.size]}
    places = sorted({x for x, _ in texts})
    assert np.diff(places)[:2].tolist() == [1.0, 1.0] and np.diff(places)[2] > 1.2
    shown = [[texts[x, y] for x in places] for y in (0, 1)]
    assert shown == TEXTS.tolist()
    colours = cells(grid)
    wanted = {1.0: SCALE(0.0), WORST: SCALE(1.0), np.inf: SCALE(1.0)}
    for (row, column), ratio in np.ndenumerate(RATIOS):
        found = colours[places[column], row]
        assert ratio not in wanted or found == wanted[ratio]
        if np.isnan(ratio):
            assert found == to_rgba("0.9")
    assert colours[0.0, 0] == pytest.approx(SCALE(np.log(3.0) / np.log(WORST)), abs=0.02)


def test_recommended_cells_have_a_frame_and_own_names_their_colour():
    grid, _ = drawn().axes
    frames = [patch for patch in grid.patches if not patch.get_fill()]
    assert [(round(f.get_x() + 0.44), round(f.get_y() + 0.42)) for f in frames] == [(1, 0)]
    names = ["INS", "ekf", "mine", "batch"]
    assert [label.get_text() for label in grid.get_xticklabels()] == names
    colours = [label.get_color() == COLOURS["own"] for label in grid.get_xticklabels()]
    assert colours == [False, False, True, False]


def test_the_corner_says_what_a_cell_is_and_blocks_have_names():
    """Of flights that are aided in flight alone no block is named."""
    grid, _ = drawn().axes
    key, *blocks = grid.texts[TEXTS.size :]
    assert "RMS error / oracle's error" in key.get_text() and "unsafe" in key.get_text()
    places = {text.get_text(): text.get_position()[0] for text in blocks}
    assert places == pytest.approx({"in flight": 1.0, "after landing": 3.35})
    grid, _ = drawn(smoothers=0).axes
    assert len(grid.texts) == TEXTS.size + 1


def test_the_profile_is_the_share_of_cases_within_a_ratio():
    """The INS is within 3 in one of two cases, and beyond the axis in the other."""
    figure = drawn()
    lines = {name: artists[0] for name, artists in figure.series.items()}
    assert set(lines) == {"INS", "ekf", "mine"}

    def share(name: str, ratio: float) -> float:
        x, y = lines[name].get_data()
        return float(y[np.searchsorted(x, ratio, side="right") - 1])

    assert [share("INS", r) for r in (1.0, 2.9, 3.0, 29.0)] == [0.0, 0.0, 50.0, 50.0]
    assert [share("ekf", r) for r in (1.0, 29.0)] == [100.0, 100.0]
    assert [share("mine", r) for r in (1.9, 2.0, 29.0)] == [0.0, 50.0, 50.0]
    assert lines["mine"].get_linewidth() > lines["ekf"].get_linewidth()


@pytest.mark.parametrize("count", [3, 15])
def test_texts_fit_their_cells_at_800_pixels(count):
    """Fifteen estimators, one in a hundred pixels or in thirty-six."""
    longest = np.full((2, count), "lost\n>99%‡")
    figure = drawn(
        estimators=[f"ekf-{n}" for n in range(count)],
        ratios=np.full((2, count), np.inf),
        texts=longest,
        framed=np.zeros((2, count), dtype=bool),
        to_best={},
    )
    figure.canvas.draw()
    grid, _ = figure.axes
    assert figure.get_figwidth() * 110.0 <= 804.0
    size = (grid.transData.transform((1.0, 1.0)) - grid.transData.transform((0.0, 0.0))) * [1, -1]
    for text in grid.texts[: longest.size]:
        box = text.get_window_extent()
        assert box.width <= size[0] and box.height <= size[1]
        assert text.get_fontsize() >= 5.5


@pytest.mark.parametrize("sight", SIGHT)
def test_the_scale_can_be_read_by_the_colour_blind(sight):
    """Ratios 1, 3, 10 and 30 at least 12 apart in L*a*b*; a green and a brown are not."""
    seen = [lab(SCALE(np.log(r) / np.log(WORST))[:3], sight) for r in (1.0, 3.0, 10.0, WORST)]
    assert min(np.linalg.norm(a - b) for a, b in itertools.combinations(seen, 2)) > 12.0
    if sight == "deuteranopia":
        assert np.linalg.norm(lab("#2ca02c", sight) - lab("#a07a2c", sight)) < 12.0
