"""An estimator looks the same in every figure, whoever stands beside it."""

from __future__ import annotations

import re
import subprocess
import sys

import numpy as np
import pytest
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure

from ggbench.figures.errors import component_errors, error_over_time
from ggbench.figures.locking import Panels, Series, against_time, over_cases
from ggbench.figures.looks import looks
from ggbench.figures.style import BOUND, INS
from ggbench.figures.sweeps import Curve, curves
from ggbench.results.names import shown_names
from ggbench.spec import scenario
from ggbench.spec.sweep import Axis

SHIPPED = {
    name: list(shown_names(scenario.load(name).campaign.estimators).values())
    for name in scenario.shipped()
}
DEFAULT = {"factor-graph": "factor-graph[mode=isam2]"} | {
    label: re.sub(r",lag=\d+", "", label)
    for labels in SHIPPED.values()
    for label in labels
    if ",lag=" in label
}
"""One estimator under two labels: what is so without being said, and the length of a lag."""
EVERY = sorted({DEFAULT.get(label, label) for labels in SHIPPED.values() for label in labels})
TIMES = np.arange(1.0, 6.0)
SWEPT = ("noise", "noise_scale", "particles", "window", "alpha", "spacing_m", "starts",
         "relinearize_threshold")  # fmt: skip
"""Numbers in which variants differ by line and marker, and not by colour."""
TUNED = {
    "ekf[iterations=2]", "ekf[gate=0.99]", "ekf[underweighting=1]", "tercom[window=10,longest=60]",
    "tercom[window=40,longest=120]",
}  # fmt: skip
"""And variants of a study that have a number beside one that has a colour."""


def family_of(label: str) -> str:
    """What a label says beside numbers of particles or readings, and which noise is told."""
    name, _, variant = label.rstrip("]").partition("[")
    parts = variant.split(",")
    own = [p for p in parts if p and p.partition("=")[0] not in SWEPT and label not in TUNED]
    return family_of(DEFAULT[name]) if not own and name in DEFAULT else f"{name} {own}"


def over_time(labels: list[str]) -> Figure:
    lines = {label: np.ones((3, 5, 2)) for label in labels}
    return error_over_time([("a case", TIMES, lines, {"bound": np.ones((5, 2))})])


def locked_over_time(labels: list[str]) -> Figure:
    return against_time([("a case", TIMES, dict.fromkeys(labels, TIMES / 5))], labels)


def locked_over_cases(labels: list[str]) -> Figure:
    series = {label: Series(*np.full((3, 2), 0.5)) for label in labels}
    return over_cases([Panels("", ["a", "b"], None, series, series, series)], labels)


def over_an_axis(labels: list[str]) -> Figure:
    axis = Axis("noise", "noise", "E", "log", (1.0, 2.0))
    lines = [Curve(label, np.ones(2), np.ones((2, 2)), np.ones(2)) for label in labels]
    return curves({"": lines}, None, axis)


def by_component(labels: list[str]) -> Figure:
    errors = np.ones((5, 12))
    return component_errors(TIMES, errors, None, 0, "m", labels[0])


def colours(figure: Figure) -> dict[str, tuple[float, ...]]:
    """The colour of each line that has a name, from the legends."""
    legends = [*figure.legends, *(a.get_legend() for a in figure.axes if a.get_legend())]
    found = {}
    for legend in legends:
        for text, handle in zip(legend.get_texts(), legend.legend_handles, strict=True):
            colour = getattr(handle, "get_color", getattr(handle, "get_facecolor", None))()
            if text.get_text() in {*EVERY, "mine"}:
                found[text.get_text()] = to_rgba(np.ravel(colour) if len(colour) == 1 else colour)
    return found


@pytest.mark.parametrize(
    "draw", [over_time, locked_over_time, locked_over_cases, over_an_axis, by_component]
)
def test_the_figures_take_their_colours_from_one_table(draw):
    """First or last, alone or among others."""
    for labels in (["ekf", "gauss-newton", "mine"], ["mine", "ukf[points=julier]", "ekf"], ["ekf"]):
        found = colours(draw(labels))
        assert found
        assert found == {label: to_rgba(looks([label])[label].color) for label in found}


def test_an_estimator_of_the_library_looks_the_same_beside_any_others():
    together = looks(EVERY)
    assert together == looks(reversed(EVERY))
    for labels in (*SHIPPED.values(), *([label] for label in EVERY)):
        assert looks(labels) == {label: together[DEFAULT.get(label, label)] for label in labels}


def test_no_two_of_the_library_look_alike():
    """No two have one colour, or the bound's; all but the INS are not grey.

    But for those that differ in a number alone, as of particles or of readings in a window, or in
    the noise that they are told: line and marker differ, the colour does not.
    """
    drawn = looks(EVERY)
    assert len(set(drawn.values())) == len(EVERY)
    names = [to_rgba(look.color) for look in drawn.values()]
    families = {family_of(label): to_rgba(look.color) for label, look in drawn.items()}
    assert len({family_of(label) for label in EVERY}) < len(EVERY)
    assert len(set(names)) == len(set(families.values())) == len(families)
    assert to_rgba(BOUND) not in names
    for label, look in drawn.items():
        red, green, blue, _ = to_rgba(look.color)
        assert (look.color == INS) == (red == green == blue) == (label == "ins")


def test_estimators_of_ones_own_are_told_apart_and_keep_their_look():
    """Ten variants of one that is unknown differ; in another process the look is the same."""
    own = [f"mine[size={size}]" for size in range(10)]
    drawn = looks([*EVERY, *own])
    assert len(set(drawn.values())) == len(drawn)
    assert {label: drawn[label] for label in EVERY} == looks(EVERY)
    code = "from ggbench.figures.looks import looks; print(tuple(looks(['mine'])['mine']))"
    told = [
        subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, check=True,
            env={"PYTHONHASHSEED": seed},
        ).stdout
        for seed in ("1", "2")
    ]  # fmt: skip
    assert told[0] == told[1] == f"{tuple(looks(['mine'])['mine'])}\n"
