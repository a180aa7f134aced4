"""What figures show: each curve the numbers that its name promises, in the units of its axis."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from ggbench.figures import answer, errors, field, flights, map_components, stored
from ggbench.figures.answer import Curve, Panel
from ggbench.figures.errors import Flight
from ggbench.figures.numbers import short
from ggbench.figures.style import legend_below, styled, subplots
from ggbench.maps.netcdf import TENSOR, Nodes

TIMES = np.arange(1.0, 9.0)
FAMILIES = {"ins": "inertial", "ekf": "kalman", "ukf": "sigma-point", "mine": "own"}


def lines(axis) -> dict[str, np.ndarray]:
    """Ordinates of the labelled curves of an axis."""
    return {line.get_label(): np.asarray(line.get_ydata()) for line in axis.get_lines()}


def test_errors_over_time_are_root_mean_squares_over_runs():
    """Position above, velocity below; bounds as roots, by their names."""
    series = np.random.default_rng(1).uniform(1.0, 3.0, (5, 4, 4))
    kept = np.array([0, 2, 5, 7])
    bound = np.random.default_rng(2).uniform(1.0, 9.0, (8, 2))
    arrays = {
        "times": TIMES,
        "kept": kept,
        "bound-filter": bound,
        "bound-batch": 2 * bound,
        "bound-unfiltered": bound,
    }
    results = SimpleNamespace(
        series=lambda case, label: series if label == "ekf" else np.empty((0, 0, 4)),
        arrays=lambda case: arrays,
        scenario=SimpleNamespace(case=lambda name: SimpleNamespace(title="A case")),
        families={"ekf": "kalman", "ukf": "sigma-point"},
    )
    figure = stored.error_over_time(results, {"c": ["ekf", "ukf"]})
    for axis, column, unit in zip(figure.axes, (0, 1), ("[m]", "[m/s]"), strict=True):
        shown = lines(axis)
        assert set(shown) == {"ekf", "bound, filter", "bound, smoother"}
        assert shown["ekf"] == pytest.approx(np.sqrt((series[:, :, column] ** 2).mean(axis=0)))
        assert shown["bound, filter"] == pytest.approx(np.sqrt(bound[kept, column]))
        assert shown["bound, smoother"] == pytest.approx(np.sqrt(2 * bound[kept, column]))
        assert axis.get_ylabel().endswith(unit) and axis.get_yscale() == "log"
        assert axis.get_lines()[0].get_xdata() == pytest.approx(TIMES[kept])
    assert figure.axes[0].get_title() == "A case"
    lag = {"bound-fixed-lag-10": "bound, fixed lag"}
    assert stored.drawn_bounds({"bound-unfiltered": bound, **lag}) == lag


def a_curve(seed: int, success: float = 1.0) -> Curve:
    low, rms, high = np.sort(np.random.default_rng(seed).uniform(1.0, 9.0, (3, 2)), axis=0)
    return Curve(rms, low, high, np.full(2, success))


def test_errors_by_case_have_intervals_bound_and_ins():
    """A row for each case, from the top; success has a panel if any run fails."""
    curves = {"ekf": a_curve(1), "ukf": a_curve(2)}
    bounds, ins = (np.array([1.0, 2.0]), np.array([0.5, np.nan])), np.array([50.0, np.nan])
    panel = Panel("", np.arange(2.0), curves, *bounds, ins)
    figure = answer.over_cases(
        ["a case", "a case with a name that is long enough to wrap"], panel, FAMILIES
    )
    (axis,) = figure.axes
    assert [label.get_text() for label in axis.get_yticklabels()] == [
        "a case",
        "a case with a name that is\nlong enough to wrap",
    ]
    drawn = [line.get_xdata() for line in axis.get_lines() if len(line.get_xdata()) == 2]
    assert [list(curve.rms) for curve in curves.values()] == [list(found) for found in drawn[:2]]
    segments = [found.get_segments() for found in axis.collections]
    assert segments[0][0][:, 0] == pytest.approx([curves["ekf"].low[0], curves["ekf"].high[0]])
    assert [text.get_text() for text in figure.legends[0].get_texts()] == [
        "ekf",
        "ukf",
        "bound of filters",
        "bound of smoothers",
        "INS",
    ]
    without = panel._replace(smoothing_bound=np.full(2, np.nan))
    assert "bound of smoothers" not in answer.over_cases(["a", "b"], without, FAMILIES).series
    lost = panel._replace(curves=curves | {"ukf": a_curve(2, 0.5)})
    _, success = answer.over_cases(["a", "b"], lost, FAMILIES).axes
    assert list(success.get_lines()[1].get_xdata()) == [50.0, 50.0]


def test_an_interval_without_end_leaves_the_errors_apart():
    """The axis ends at ten times its largest value; control: a shorter interval is drawn whole."""
    for high, reached in ((1e17, 500.0), (200.0, 200.0)):
        curve = Curve(np.full(2, 5.0), np.full(2, 4.0), np.array([6.0, high]), np.ones(2))
        panel = Panel("", np.arange(2.0), {"ekf": curve}, *np.full((2, 2), 2.0), np.full(2, 50.0))
        by_case = answer.over_cases(["a", "b"], panel, FAMILIES).axes[0].get_xlim()
        over_axis = answer.over_axis([panel], "x", log=False, families=FAMILIES).axes[0].get_ylim()
        for low, end in (by_case, over_axis):
            assert 0.2 <= low < 2.0 and reached <= end <= 500.0


def test_errors_over_an_axis_have_a_panel_for_each_part():
    levels = np.ones(2), np.full(2, 0.5), np.full(2, 9.0)
    panels = [
        Panel(name, np.array([0.1, 1.0]), {"ekf": a_curve(n, 0.5)}, *levels)
        for n, name in enumerate(("one", "other"))
    ]
    figure = answer.over_axis(panels, "noise [E]", log=True, families=FAMILIES)
    assert len(figure.axes) == 4 and figure.axes[0].get_xscale() == "log"
    for axis, panel in zip(figure.axes[:2], panels, strict=True):
        assert axis.get_title() == panel.title
        rms, *drawn = (line.get_ydata() for line in axis.get_lines())
        assert list(rms) == list(panel.curves["ekf"].rms)
        assert [list(values) for values in drawn] == [list(values) for values in levels]


def test_long_titles_of_panels_do_not_collide():
    """They go on in another line."""
    long = "severe turbulence, 16 E for the 1 E that is declared: disks that vibrate"
    curve = {"ekf": np.ones((len(TIMES), 2))}
    figure = errors.error_over_time([Flight(long, TIMES, curve, {})] * 3, FAMILIES)
    boxes = [figure.axes[n].title.get_window_extent() for n in range(3)]
    assert boxes[0].x1 < boxes[1].x0 and boxes[1].x1 < boxes[2].x0
    assert " ".join(figure.axes[0].get_title().split()) == long


def test_a_short_flight_is_not_drawn_at_the_scale_of_a_long_one():
    """Each column has its own time; position and velocity of one flight share it."""
    panels = [
        Flight(name, times, {"ekf": np.ones((8, 2))}, {})
        for name, times in (("short", TIMES), ("long", 100.0 * TIMES))
    ]
    short, long, below, _ = errors.error_over_time(panels, FAMILIES).axes
    assert short.get_xlim()[1] < 0.02 * long.get_xlim()[1]
    assert below.get_xlim() == short.get_xlim()


@pytest.mark.parametrize(
    ("quantity", "first", "unit"), [("position", 0, "m"), ("velocity", 3, "m/s")]
)
def test_components_of_one_run_with_what_it_claims(quantity, first, unit):
    """East, north and up from above; beside the INS on the left, within ±3σ on the right."""
    rng = np.random.default_rng(3)
    details = {"ekf": rng.uniform(1.0, 2.0, (8, 18)), "ins": rng.uniform(5.0, 9.0, (8, 18))}
    results = SimpleNamespace(
        detail=lambda case, label, run: details[label] if run == 0 else None,
        arrays=lambda case: {"times": TIMES},
        folder="out",
        families=FAMILIES,
    )
    figure = stored.component_errors(results, "c", "ekf", quantity)
    for index, name in enumerate(("east", "north", "up")):
        left, right = figure.axes[2 * index : 2 * index + 2]
        assert left.get_ylabel() == f"{name} [{unit}]"
        error, sigma = (details["ekf"][:, column + first + index] for column in (0, 6))
        assert lines(left)["ekf"] == pytest.approx(error)
        assert lines(right)["ekf"] == pytest.approx(error)
        assert lines(left)["INS"] == pytest.approx(details["ins"][:, first + index])
        (region,) = right.collections
        vertices = region.get_paths()[0].vertices
        for time, deviation in zip(TIMES, sigma, strict=True):
            ends = vertices[vertices[:, 0] == time, 1]
            assert (ends.min(), ends.max()) == pytest.approx((-3 * deviation, 3 * deviation))


@pytest.mark.parametrize("size", [0.0, 3.0])
def test_an_estimate_that_claims_nothing_is_drawn_without_a_region(size):
    """No covariance, and perhaps no error: the axes have limits, and nothing speaks of σ."""
    errors = np.hstack([np.full((8, 6), size), np.full((8, 6), np.nan)])
    results = SimpleNamespace(
        detail=lambda case, label, run: errors if label == "mine" else None,
        arrays=lambda case: {"times": TIMES},
        folder="out",
        families=FAMILIES,
    )
    figure = stored.component_errors(results, "c", "mine", "position")
    for axis in figure.axes[1::2]:
        assert not axis.collections
        assert list(lines(axis)) == ["mine"]
        assert np.isfinite(axis.get_ylim()).all()
    assert figure.axes[1].get_title() == "aided, without covariance"


def test_the_map_has_the_track_where_it_was_flown():
    """Longitude across and latitude up, in degrees, with the start of the track marked."""
    latitude, longitude = np.radians(np.linspace(30, 33, 7)), np.radians(np.linspace(100, 105, 11))
    values = np.random.default_rng(4).normal(size=(7, 11))
    track = np.column_stack([*np.radians([[31, 31.5, 32], [101, 102, 104]]), [1e4] * 3])
    arrays = {"map_latitude": latitude, "map_longitude": longitude, "map_vertical": values}
    axis = field.field_map(arrays | {"track": track}).axes[0]
    path, start = axis.get_lines()
    assert path.get_xdata() == pytest.approx([101, 102, 104])
    assert path.get_ydata() == pytest.approx([31, 31.5, 32])
    assert (*start.get_xdata(), *start.get_ydata()) == pytest.approx((101, 31))
    mesh = axis.collections[0]
    assert np.asarray(mesh.get_array()).reshape(7, 11) == pytest.approx(values)
    corners = mesh.get_coordinates()
    assert corners[:, :, 0].mean() == pytest.approx(102.5)
    assert corners[:, :, 1].mean() == pytest.approx(31.5)
    low, high = mesh.get_clim()
    assert -low == high == np.abs(values).max()
    assert axis.get_aspect() == pytest.approx(1.0 / np.cos(np.radians(31.5)))


def test_the_gradient_along_the_track_is_taken_apart():
    """Noise before the filter, noise behind it, and what the filter delays, each by itself."""
    rng = np.random.default_rng(5)
    names = ("vertical", "noisy", "filtered", "filtered_true")
    arrays = {"gradient_times": TIMES} | {name: rng.normal(size=8) for name in names}
    top, middle, bottom = field.gradient_along_track(arrays, "A case").axes
    assert lines(top)["true"] == pytest.approx(arrays["vertical"])
    assert lines(top)["noisy"] == pytest.approx(arrays["noisy"])
    assert lines(top)["filtered"] == pytest.approx(arrays["filtered"])
    delayed = arrays["filtered_true"] - arrays["vertical"]
    assert lines(middle)["delay error of the filter"] == pytest.approx(delayed)
    noise = arrays["noisy"] - arrays["vertical"]
    assert lines(bottom)["noise before the filter"] == pytest.approx(noise)
    behind = arrays["filtered"] - arrays["filtered_true"]
    assert lines(bottom)["noise after the filter"] == pytest.approx(behind)
    assert top.get_title() == "A case"


def test_components_of_a_map_stand_under_their_names():
    """EE to UU, the first row of each in the south, over the cells of its nodes in degrees."""
    nodes = Nodes(np.linspace(30.0, 31.0, 6), np.linspace(100.0, 103.0, 7), np.array([1e4]))
    tensor = np.random.default_rng(6).normal(size=(6, 7, 6))
    figure = map_components.map_components(nodes, tensor, "10000 m", "here")
    for index, (name, axis) in enumerate(zip(TENSOR, figure.axes, strict=False)):
        (image,) = axis.get_images()
        assert axis.get_title() == f"Γ_{name.upper()}"
        assert np.asarray(image.get_array()) == pytest.approx(tensor[:, :, index])
        assert image.origin == "lower"
        assert image.get_extent() == pytest.approx((99.75, 103.25, 29.9, 31.1))
        assert axis.get_aspect() == pytest.approx(1.0 / np.cos(np.radians(30.5)))
        low, high = image.get_clim()
        assert -low == high > 0.9 * np.abs(tensor[:, :, index]).max()


@pytest.mark.parametrize(("longest", "columns"), [(5, 4), (40, 2), (200, 1)])
def test_a_legend_has_as_many_columns_as_there_is_room_for(longest, columns):
    """Seven inches hold four short names in a row, two long ones, and one of any length."""
    figure, axis = subplots(figsize=(7.0, 3.0))
    handles = {f"{i}{'x' * (longest - 1)}": axis.plot([0, 1], [i, i])[0] for i in range(8)}
    legend_below(figure, handles)
    assert figure.legends[0]._ncols == columns
    assert figure.get_size_inches()[1] - 3.0 == pytest.approx(0.19 * 8 / columns)


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.0, "0"),
        (1234.5, "1234"),
        (99_999.0, "99999"),
        (1e5, "1.0e+05"),
        (123.4, "123"),
        (12.34, "12.3"),
        (1.234, "1.23"),
        (-0.1234, "-0.123"),
        (0.001234, "0.00123"),
        (0.000999, "1.0e-03"),
    ],
)
def test_numbers_have_three_digits(value, text):
    """Three significant digits, all digits before the point; powers of ten at both ends."""
    assert short(value) == text


@pytest.mark.parametrize("span", [(12.0, 40.0), (0.5, 4000.0)])
def test_numbers_of_a_logarithmic_axis_are_plain(span):
    """Within a decade, too, where Matplotlib labels in between: no mathematics is printed."""
    values = np.geomspace(*span, 8)
    with styled():
        figures = [
            flights.deviations(TIMES, {"ekf": np.tile(values[:, np.newaxis], (1, 6))}, FAMILIES)
        ]
    for figure in figures:
        figure.canvas.draw()
        shown = [
            label.get_text()
            for axis in figure.axes
            for which in ("major", "minor")
            for label in axis.yaxis.get_ticklabels(which=which)
        ]
        assert any(shown)
        assert not [text for text in shown if "$" in text]
