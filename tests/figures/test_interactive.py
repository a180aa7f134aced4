"""Figures for a browser: the script reads the data of each series from the picture."""

from __future__ import annotations

import re
from xml.etree import ElementTree

import numpy as np
import pytest
from thinning import thinned

from ggbench.figures import answer, interactive
from ggbench.figures.answer import Curve, Panel
from ggbench.figures.errors import Flight, error_over_time

FAMILIES = {"ekf": "kalman", "mine": "own"}
TIMES = np.linspace(1.0, 60.0, 20)
ERRORS = {
    label: np.random.default_rng(seed).uniform(0.1, 50.0, (20, 2))
    for seed, label in enumerate(FAMILIES)
}


def over_time() -> dict:
    """The picture of a flight, with an estimator switched off."""
    figure = error_over_time([Flight("a < b", TIMES, ERRORS, {})], FAMILIES)
    return interactive.picture(figure, {"mine"})


def group(picture: dict, name: str) -> ElementTree.Element:
    """The element of an id."""
    (found,) = [e for e in ElementTree.fromstring(picture["svg"]).iter() if e.get("id") == name]
    return found


def points(element: ElementTree.Element) -> np.ndarray:
    """The coordinates (n, 2) of the paths of a group."""
    text = " ".join(e.get("d", "") for e in element.iter())
    return np.array(re.findall(r"[ML] ([-\d.]+) ([-\d.]+)", text), dtype=float)


def values(share: np.ndarray, scale: dict) -> np.ndarray:
    """The values at shares of an axis, as ``figure.js`` computes them."""
    low, high = scale["limits"]
    return low * (high / low) ** share if scale["log"] else low + (high - low) * share


@pytest.mark.parametrize(("series", "label"), list(enumerate(FAMILIES)))
@thinned("panel", [0, 1])
def test_values_can_be_read_from_the_picture(series, label, panel):
    """Position and velocity over time, within the thickness of a line."""
    picture = over_time()
    assert picture["names"][series] == label
    box = points(group(picture, f"panel-{panel}"))
    (left, top), (right, bottom) = box.min(axis=0), box.max(axis=0)
    drawn = points(group(picture, f"series-{series}-{panel}"))
    scales = picture["panels"][panel]
    times = values((drawn[:, 0] - left) / (right - left), scales["x"])
    errors = values((bottom - drawn[:, 1]) / (bottom - top), scales["y"])
    assert times == pytest.approx(TIMES, rel=2e-3)
    assert errors == pytest.approx(ERRORS[label][:, panel], rel=2e-3)


def test_axes_have_their_labels_even_where_another_one_shows_them():
    """The upper panel shares the times of the lower one."""
    scales = over_time()["panels"]
    assert [scale["x"]["label"] for scale in scales] == ["time [s]", "time [s]"]
    assert [scale["y"]["label"] for scale in scales] == ["RMS position [m]", "RMS velocity [m/s]"]


def test_a_series_can_be_switched_in_the_legend():
    """Its entry has a number; what is off at first is stated."""
    picture = over_time()
    off = picture["names"].index("mine")
    assert picture["hidden"] == [off]
    assert "".join(group(picture, f"legend-{off}-0").itertext()).strip() == "mine"


def test_cases_are_axes_with_names():
    """A row is a case; intervals have no points."""
    curve = Curve(*np.sort(np.random.default_rng(1).uniform(1.0, 9.0, (3, 2)), axis=0), np.ones(2))
    panel = Panel(
        "", np.arange(2.0), {"ekf": curve}, np.ones(2), np.full(2, np.nan), np.full(2, 9.0)
    )
    figure = answer.over_cases(["one", "a case of many words that is wrapped"], panel, FAMILIES)
    picture = interactive.picture(figure)
    (scales,) = picture["panels"]
    assert scales["y"]["names"] == ["one", "a case of many words that is wrapped"]
    assert scales["x"]["names"] == [] and picture["hidden"] == []
    assert group(picture, "series-0-0") is not None and group(picture, "range-0-1") is not None


def test_a_title_stays_text_and_the_picture_is_one_element():
    """It fits any page, and a title cannot add elements."""
    svg = over_time()["svg"]
    assert svg.startswith("<svg") and svg.endswith("</svg>") and "width=" not in svg[:200]
    assert "a &lt; b" in svg and "a < b" not in svg


def test_a_picture_is_the_same_for_the_same_content():
    assert over_time() == over_time()
