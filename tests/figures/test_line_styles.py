"""A family of estimators has one colour in every figure, and no two estimators share a style."""

from __future__ import annotations

import importlib.metadata
import itertools
from dataclasses import dataclass
from types import SimpleNamespace
from typing import get_args

import numpy as np
import pytest
from colour_vision import SIGHT, lab
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from thinning import thinned

from ggbench.campaign import registry
from ggbench.estimators.ekf import ExtendedKalmanFilter
from ggbench.figures import answer
from ggbench.figures.answer import Curve, Panel
from ggbench.figures.errors import Flight, component_errors, error_over_time
from ggbench.figures.line_styles import COLOURS, line_styles, stacked
from ggbench.figures.style import BOUND, INS
from ggbench.problem import Estimator, Family
from ggbench.spec import scenario

SHIPPED = {name: scenario.load(name).campaign.estimators for name in scenario.shipped()}
TIMES = np.arange(1.0, 6.0)
FAMILIES = {"ins": "inertial", "ekf": "kalman", "ukf": "sigma-point", "mine": "own"}
TWINS = {
    "filterpy-ekf": "ekf",
    "filterpy-ukf": "ukf",
    "gtsam": "factor-graph",
    "tercom-ekf": "tercom",
}


def over_time(labels: list[str]) -> Figure:
    lines = {label: np.ones((5, 2)) for label in labels}
    flight = Flight("a case", TIMES, lines, {"bound": np.ones((5, 2))})
    return error_over_time([flight], FAMILIES)


def panel(labels: list[str]) -> Panel:
    curves = dict.fromkeys(labels, Curve(*np.ones((4, 2))))
    bounds = np.ones(2), np.full(2, np.nan)
    return Panel("a part", np.array([1.0, 2.0]), curves, *bounds, np.full(2, 9.0))


def over_cases(labels: list[str]) -> Figure:
    return answer.over_cases(["a", "b"], panel(labels), FAMILIES)


def over_an_axis(labels: list[str]) -> Figure:
    return answer.over_axis([panel(labels)], "noise", log=False, families=FAMILIES)


def by_component(labels: list[str]) -> Figure:
    return component_errors(TIMES, np.ones((5, 12)), None, 0, "m", labels[0], families=FAMILIES)


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
    styles = line_styles(FAMILIES)
    for labels in (["ekf", "mine"], ["mine", "ukf", "ekf"], ["ekf"]):
        found = colours(draw(labels), labels)
        assert found
        assert found == {label: to_rgba(styles[label].color) for label in found}


def families(labels: list[str]) -> dict[str, str]:
    return {label: registry.choose(label).family for label in labels}


@pytest.mark.parametrize("name", SHIPPED)
def test_no_two_estimators_of_a_scenario_share_a_style(name):
    """No estimator has the bound's colour, and the INS alone is grey."""
    styles = line_styles(families(SHIPPED[name]))
    assert len(set(styles.values())) == len(SHIPPED[name])
    for label, style in styles.items():
        red, green, blue, _ = to_rgba(style.color)
        assert to_rgba(style.color) != to_rgba(BOUND)
        assert (style.color == INS) == (red == green == blue) == (label == "ins")


def test_every_shipped_estimator_has_a_family_with_a_colour_of_its_own():
    """A new entry point needs no entry in a figure's list: its class states the family."""
    assert set(COLOURS) == set(get_args(Family)) and len(set(COLOURS.values())) == len(COLOURS)
    for point in importlib.metadata.entry_points(group=registry.GROUP):
        if point.value.startswith("ggbench."):
            assert point.load().family in set(COLOURS) - {"own"}, point.name


def test_a_twin_shares_the_colour_and_differs_in_line_and_marker():
    styles = line_styles(families([*TWINS.values(), *TWINS]))
    for twin, original in TWINS.items():
        one, other = styles[twin], styles[original]
        assert one.color == other.color and one.ls != other.ls and one.marker != other.marker


@pytest.mark.parametrize("base", ["Estimator", "ExtendedKalmanFilter"])
def test_an_estimator_of_a_file_has_a_colour_that_no_shipped_one_has(tmp_path, base):
    """Even one that derives from a shipped estimator."""
    file = tmp_path / "mine.py"
    file.write_text(
        "from dataclasses import dataclass\n"
        "from ggbench.problem import Estimator\n"
        "from ggbench.estimators.ekf import ExtendedKalmanFilter\n"
        f"@dataclass(frozen=True)\nclass Mine({base}):\n"
        "    name = 'mine'\n    causality = 'filter'\n"
        "    def estimate(self, problem, rng): ...\n"
    )
    labels = [str(file), *registry.registered()]
    styles = line_styles(families(labels))
    own = styles.pop(str(file)).color
    assert own == COLOURS["own"] and own not in {style.color for style in styles.values()}


def test_a_class_without_a_family_is_ones_own():
    assert Estimator.family == "own"
    assert line_styles({"theirs": "of a later version"})["theirs"].color == COLOURS["own"]


def test_many_variants_differ():
    """Fifty variants of one estimator have fifty styles."""
    styles = line_styles({f"ekf[size={size}]": "kalman" for size in range(50)})
    assert len(set(styles.values())) == 50


def test_an_estimator_of_ones_own_is_drawn_on_top():
    """Last, the thickest, and equal curves are seen through it; the INS is drawn first."""
    order = stacked(["mine", "ekf", "ins", "ukf"], FAMILIES)
    assert [layer.label for layer in order] == ["ins", "ekf", "ukf", "mine"]
    *widths, own = [layer.width for layer in order]
    assert widths == sorted(widths, reverse=True) and widths[-1] >= 1.0 and own > max(widths)
    assert [layer.alpha < 1.0 for layer in order] == [False, False, False, True]


@pytest.mark.parametrize("draw", [over_time, over_an_axis])
def test_figures_draw_the_own_line_thickest_and_last(draw):
    axis = draw(["mine", "ekf", "ukf"]).axes[0]
    own = to_rgba(COLOURS["own"])
    curves = [
        line
        for line in axis.get_lines()
        if to_rgba(line.get_color()) not in map(to_rgba, (BOUND, INS))
    ]
    assert to_rgba(curves[-1].get_color()) == own
    assert curves[-1].get_linewidth() == max(line.get_linewidth() for line in curves)
    assert [to_rgba(line.get_color()) == own for line in curves].count(True) == 1


def test_an_own_marker_is_the_largest():
    """Of figures by case."""
    sizes = {
        to_rgba(line.get_color()): line.get_markersize()
        for line in over_cases(["mine", "ekf", "ukf"]).axes[0].get_lines()
        if len(line.get_xdata()) == 2 and line.get_marker() not in ("", "None")
    }
    assert max(sizes, key=sizes.__getitem__) == to_rgba(COLOURS["own"])


def test_an_estimator_of_an_installed_package_is_ones_own(monkeypatch):
    """Whatever family its class states or inherits: it is not shipped."""

    @dataclass(frozen=True)
    class Theirs(ExtendedKalmanFilter):
        name = "theirs"

    point = SimpleNamespace(load=lambda: Theirs, value="theirs.filters:Theirs")
    monkeypatch.setattr(registry, "estimator_points", lambda: {"theirs": point})
    assert Theirs.family == "kalman" and registry.choose("theirs").family == "own"


@pytest.mark.parametrize("sight", SIGHT)
def test_colours_of_families_can_be_told_apart_by_the_colour_blind(sight):
    """At least 12 apart in L*a*b*, where 2.3 is just noticeable; dark yellow and red are not."""
    drawn = [*COLOURS.values(), BOUND]
    distances = [
        np.linalg.norm(lab(one, sight) - lab(other, sight))
        for one, other in itertools.combinations(drawn, 2)
    ]
    assert min(distances) > 12.0
    if sight == "deuteranopia":
        assert np.linalg.norm(lab("#a08a00", sight) - lab("#d55e00", sight)) < 12.0
