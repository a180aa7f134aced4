"""An estimator has one colour in every figure, and no two labels of a figure share a style."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from thinning import thinned

from ggbench.campaign import registry
from ggbench.figures import answer
from ggbench.figures.answer import Curve, Panel
from ggbench.figures.errors import component_errors, error_over_time
from ggbench.figures.line_styles import line_styles
from ggbench.figures.style import BOUND, INS
from ggbench.spec import scenario

SHIPPED = {name: scenario.load(name).campaign.estimators for name in scenario.shipped()}
TIMES = np.arange(1.0, 6.0)


def over_time(labels: list[str]) -> Figure:
    lines = {label: np.ones((5, 2)) for label in labels}
    return error_over_time([("a case", TIMES, lines, {"bound": np.ones((5, 2))})])


def panel(labels: list[str]) -> Panel:
    curves = dict.fromkeys(labels, Curve(*np.ones((4, 2))))
    return Panel("a part", np.array([1.0, 2.0]), curves, np.ones(2), np.full(2, 9.0))


def over_cases(labels: list[str]) -> Figure:
    return answer.over_cases(["a", "b"], panel(labels))


def over_an_axis(labels: list[str]) -> Figure:
    return answer.over_axis([panel(labels)], "noise", log=False)


def by_component(labels: list[str]) -> Figure:
    return component_errors(TIMES, np.ones((5, 12)), None, 0, "m", labels[0])


def colours(figure: Figure, labels: list[str]) -> dict[str, tuple[float, ...]]:
    """The colour of each named line, from the legends."""
    legends = [*figure.legends, *(a.get_legend() for a in figure.axes if a.get_legend())]
    found = {}
    for legend in legends:
        for text, handle in zip(legend.get_texts(), legend.legend_handles, strict=True):
            colour = getattr(handle, "get_color", getattr(handle, "get_facecolor", None))()
            if text.get_text() in labels:
                found[text.get_text()] = to_rgba(np.ravel(colour) if len(colour) == 1 else colour)
    return found


@thinned("draw", [over_time, over_cases, over_an_axis, by_component], every=2)
def test_every_figure_draws_an_estimator_in_its_colour(draw):
    for labels in (["ekf", "gauss-newton", "mine"], ["mine", "ukf", "ekf"], ["ekf"]):
        found = colours(draw(labels), labels)
        assert found
        assert found == {label: to_rgba(line_styles([label])[label].color) for label in found}


@pytest.mark.parametrize("name", SHIPPED)
def test_no_two_estimators_of_a_scenario_share_a_style(name):
    """No estimator has the bound's colour, and the INS alone is grey."""
    drawn = line_styles(SHIPPED[name])
    assert len(set(drawn.values())) == len(SHIPPED[name])
    for label, style in drawn.items():
        red, green, blue, _ = to_rgba(style.color)
        assert to_rgba(style.color) != to_rgba(BOUND)
        assert (style.color == INS) == (red == green == blue) == (label == "ins")


def test_registered_names_differ_in_colour_and_marker():
    drawn = line_styles(registry.registered())
    assert len({(style.color, style.marker) for style in drawn.values()}) == len(drawn)


def test_an_unknown_estimator_keeps_its_style_in_other_processes():
    """Ten variants differ; the style does not depend on Python's hash of texts."""
    own = [f"mine[size={size}]" for size in range(10)]
    assert len(set(line_styles(["ekf", *own]).values())) == 11
    code = (
        "from ggbench.figures.line_styles import line_styles\n"
        "print(tuple(line_styles(['mine'])['mine']))"
    )
    seed = "2" if os.environ.get("PYTHONHASHSEED") == "1" else "1"
    printed = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True,
        env=os.environ | {"PYTHONHASHSEED": seed},
    ).stdout  # fmt: skip
    assert printed == f"{tuple(line_styles(['mine'])['mine'])}\n"
