"""What figures show: each curve the numbers that its name promises, in the units of its axis."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from ggbench.figures import (
    errors,
    field,
    flights,
    gravity,
    locking,
    map_components,
    parameters,
    stored,
    sweeps,
)
from ggbench.figures.locking import Panels, Series
from ggbench.figures.numbers import short
from ggbench.figures.style import legend_below, styled, subplots
from ggbench.maps.netcdf import TENSOR, Nodes
from ggbench.spec.sweep import Axis

TIMES = np.arange(1.0, 9.0)


def lines(axis) -> dict[str, np.ndarray]:
    """Ordinates of the labelled curves of an axis."""
    return {line.get_label(): np.asarray(line.get_ydata()) for line in axis.get_lines()}


def test_errors_over_time_are_medians_over_runs():
    """Position above, velocity below, quartiles of the first; bounds as roots, by their names."""
    series = np.random.default_rng(1).uniform(1.0, 3.0, (5, 4, 4))
    kept = np.array([0, 2, 5, 7])
    bound = np.random.default_rng(2).uniform(1.0, 9.0, (8, 2))
    arrays = {"times": TIMES, "kept": kept, "bound-filter": bound, "bound-fixed-lag-12": 2 * bound}
    results = SimpleNamespace(
        series=lambda case, label: series if label == "ekf" else np.empty((0, 0, 4)),
        arrays=lambda case: arrays,
        scenario=SimpleNamespace(case=lambda name: SimpleNamespace(title="A case")),
    )
    figure = stored.error_over_time(results, {"c": ["ekf", "ukf"]})
    for axis, column, unit in zip(figure.axes, (0, 1), ("[m]", "[m/s]"), strict=True):
        shown = lines(axis)
        assert set(shown) == {"ekf", "bound: filter", "bound: fixed-lag"}
        assert shown["ekf"] == pytest.approx(np.median(series[:, :, column], axis=0))
        (band,) = axis.collections
        edges = np.unique(band.get_paths()[0].vertices[:, 1])
        assert set(np.quantile(series[:, 0, column], [0.25, 0.75])) <= set(edges)
        assert shown["bound: filter"] == pytest.approx(np.sqrt(bound[kept, column]))
        assert shown["bound: fixed-lag"] == pytest.approx(np.sqrt(2 * bound[kept, column]))
        assert axis.get_ylabel().endswith(unit) and axis.get_yscale() == "log"
        assert axis.get_lines()[0].get_xdata() == pytest.approx(TIMES[kept])
    assert figure.axes[0].get_title() == "A case"


def test_long_titles_of_panels_do_not_collide():
    """They go on in another line."""
    long = "severe turbulence, 16 E for the 1 E that is declared: disks that vibrate"
    curve = {"ekf": np.ones((3, len(TIMES), 2))}
    figure = errors.error_over_time([(long, TIMES, curve, {})] * 3)
    boxes = [figure.axes[n].title.get_window_extent() for n in range(3)]
    assert boxes[0].x1 < boxes[1].x0 and boxes[1].x1 < boxes[2].x0
    assert " ".join(figure.axes[0].get_title().split()) == long


def test_a_short_flight_is_not_drawn_at_the_scale_of_a_long_one():
    """Each column has its own time; position and velocity of one flight share it."""
    panels = [
        (name, times, {"ekf": np.ones((3, 8, 2))}, {})
        for name, times in (("short", TIMES), ("long", 100.0 * TIMES))
    ]
    short, long, below, _ = errors.error_over_time(panels).axes
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
    )
    figure = stored.component_errors(results, "c", "ekf", quantity)
    for index, name in enumerate(("east", "north", "up")):
        left, right = figure.axes[2 * index : 2 * index + 2]
        assert left.get_ylabel() == f"{name} [{unit}]"
        error, sigma = (details["ekf"][:, column + first + index] for column in (0, 6))
        assert lines(left)["ekf"] == pytest.approx(error)
        assert lines(right)["ekf"] == pytest.approx(error)
        assert lines(left)["pure INS"] == pytest.approx(details["ins"][:, first + index])
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
    )
    figure = stored.component_errors(results, "c", "mine", "position")
    for axis in figure.axes[1::2]:
        assert not axis.collections
        assert list(lines(axis)) == ["mine"]
        assert np.isfinite(axis.get_ylim()).all()
    assert figure.axes[1].get_title() == "aided; it claims no deviation"


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
    assert lines(middle)["what the filter delays"] == pytest.approx(delayed)
    noise = arrays["noisy"] - arrays["vertical"]
    assert lines(bottom)["noise before the filter"] == pytest.approx(noise)
    behind = arrays["filtered"] - arrays["filtered_true"]
    assert lines(bottom)["behind the filter"] == pytest.approx(behind)
    assert top.get_title() == "A case"


def test_components_of_a_map_stand_under_their_names():
    """EE to UU, the first row of each in the south, over the cells of its nodes in degrees."""
    nodes = Nodes(np.linspace(30.0, 31.0, 6), np.linspace(100.0, 103.0, 7), np.array([1e4]))
    tensor = np.random.default_rng(6).normal(size=(6, 7, 6))
    figure = map_components.map_components(nodes, tensor, 1e4, "here")
    for index, (name, axis) in enumerate(zip(TENSOR, figure.axes, strict=False)):
        (image,) = axis.get_images()
        assert axis.get_title() == f"Γ_{name.upper()}"
        assert np.asarray(image.get_array()) == pytest.approx(tensor[:, :, index])
        assert image.origin == "lower"
        assert image.get_extent() == pytest.approx((99.75, 103.25, 29.9, 31.1))
        assert axis.get_aspect() == pytest.approx(1.0 / np.cos(np.radians(30.5)))
        low, high = image.get_clim()
        assert -low == high > 0.9 * np.abs(tensor[:, :, index]).max()


def series(seed: int, count: int) -> Series:
    low, value, high = np.sort(np.random.default_rng(seed).uniform(0.1, 0.9, (3, count)), axis=0)
    return Series(value, low, high)


def test_locks_over_cases_are_shown_with_their_intervals():
    """Shares, false locks, times; each value over its case's prior, its bar from low to high."""
    given = [{label: series(3 * i + j, 3) for j, label in enumerate(("ins", "ekf"))}
             for i in range(3)]  # fmt: skip
    panels = Panels("", ("a", "b", "c"), (0.5, 1.0, 4.0), *given)
    figure = locking.over_cases([panels], ["ins", "ekf"])
    titles = ("share locked", "share of false locks", "median time to lock [s]")
    for axis, title, wanted in zip(figure.axes, titles, given, strict=True):
        assert axis.get_title() == title
        names = [text.get_text() for text in axis.get_xticklabels()]
        assert (names, axis.get_xticks()) == (
            ["0.5", "1", "4"],
            pytest.approx(np.log10([0.5, 1, 4])),
        )
        for container, label in zip(axis.containers, ("ins", "ekf"), strict=True):
            points, _, (bars,) = container
            assert container.get_label() == label
            assert points.get_ydata() == pytest.approx(wanted[label].value)
            assert points.get_xdata() == pytest.approx(np.log10([0.5, 1, 4]), abs=0.1)
            ends = np.array(bars.get_segments())[:, :, 1]
            assert ends[:, 0] == pytest.approx(wanted[label].low)
            assert ends[:, 1] == pytest.approx(wanted[label].high)


def test_locks_over_time_are_steps():
    """A run counts from its lock on: until the next time the share stays what it was."""
    shares = {"ekf": np.array([0.0, 0.25, 0.5, 1.0]), "ukf": np.array([0.0, 0.0, 0.5, 0.5])}
    times = np.array([0.0, 2.0, 5.0, 9.0])
    figure = locking.against_time([("A case", times, shares)], ["ukf", "ekf"])
    drawn = figure.axes[0].get_lines()
    for line, label in zip(drawn, ("ukf", "ekf"), strict=True):
        assert line.get_drawstyle() == "steps-post"
        assert line.get_ydata() == pytest.approx(shares[label])
        assert line.get_xdata() == pytest.approx(times)
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["ukf", "ekf"]


def test_locks_over_cost_have_their_intervals_and_are_joined():
    """Each mark at its time and share, its bar from low to high; numbers beside joined marks."""
    shares = {"ekf": (0.5, 0.4, 0.7), "ukf": (1.0, 0.9, 1.0), "mine": (0.0, 0.0, 0.1)}
    seconds = {"ekf": 0.02, "ukf": 0.3, "mine": 4.0}
    panel = locking.Success("A case", seconds, shares)
    figure = locking.against_cost([panel], list(shares), {"kf": {"ekf": "100", "ukf": "1000"}})
    (axis,) = figure.axes
    assert (axis.get_xscale(), axis.get_title()) == ("log", "A case")
    for container, label in zip(axis.containers, shares, strict=True):
        mark, _, (bar,) = container
        assert (*mark.get_xdata(), *mark.get_ydata()) == (seconds[label], shares[label][0])
        assert bar.get_segments()[0][:, 1] == pytest.approx(shares[label][1:])
    joint = axis.get_lines()[0]
    assert joint.get_xdata() == pytest.approx([0.02, 0.3])
    assert joint.get_ydata() == pytest.approx([0.5, 1.0])
    assert {text.get_text(): text.xy for text in axis.texts} == {
        "100": (0.02, 0.5), "1000": (0.3, 1.0),
    }  # fmt: skip
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["kf", "mine"]


def test_times_of_a_run_are_labelled_with_plain_numbers():
    """Also between the decades, where Matplotlib would write powers of ten as formulas."""
    panel = locking.Success(
        "A case", {"a": 0.2, "b": 0.4, "c": 0.5}, dict.fromkeys("abc", (1, 1, 1))
    )
    figure = locking.against_cost([panel], list("abc"), {})
    figure.canvas.draw()
    (axis,) = figure.axes
    texts = [t.get_text() for m in (False, True) for t in axis.get_xticklabels(minor=m)]
    assert "0.3" in texts and not [text for text in texts if "$" in text]


def test_errors_over_a_parameter_have_intervals_levels_and_a_bound():
    """Both scales logarithmic; a line for each family, a level for whom it does not concern."""
    ratios = np.array([40.0, 2.0, 1.1])
    interval = np.array([[30.0, 1.5, 0.9], [60.0, 3.0, 1.2]])
    line = parameters.Line("mine", "tab:red", (1e-7, 1e-4, 1e-2), ratios, interval)
    panel = parameters.Panel("A case", [line], {"ins": 90.0, "ekf": 0.8})
    figure = parameters.over_parameter("noise", [panel])
    (axis,) = figure.axes
    assert (axis.get_xscale(), axis.get_yscale(), axis.get_xlabel()) == ("log", "log", "noise")
    ((points, _, (bars,)),) = axis.containers
    assert points.get_xdata() == pytest.approx(line.values)
    assert points.get_ydata() == pytest.approx(ratios)
    ends = np.array(bars.get_segments())[:, :, 1].T
    assert ends == pytest.approx(interval)
    levels = [other.get_ydata()[0] for other in axis.get_lines() if len(other.get_xdata()) == 2]
    assert levels == [90.0, 0.8, 1.0]
    names = [text.get_text() for text in figure.legends[0].get_texts()]
    assert names == ["mine", "ins", "ekf", "Cramér–Rao bound"]
    figure.canvas.draw()
    shown = [label.get_text() for label in axis.get_xticklabels(which="both")]
    assert [text for text in shown if text] == ["1e-07", "0.0001", "0.01"]


@pytest.mark.parametrize(("longest", "columns"), [(5, 4), (40, 2), (200, 1)])
def test_a_legend_has_as_many_columns_as_there_is_room_for(longest, columns):
    """Seven inches hold four short names in a row, two long ones, and one of any length."""
    figure, axis = subplots(figsize=(7.0, 3.0))
    handles = {f"{i}{'x' * (longest - 1)}": axis.plot([0, 1], [i, i])[0] for i in range(8)}
    legend_below(figure, handles)
    assert figure.legends[0]._ncols == columns
    assert figure.get_size_inches()[1] - 3.0 == pytest.approx(0.19 * 8 / columns)


ACROSS = Axis("noise", "noise", "E", "log", (0.01, 0.1, 1.0))
UP = Axis("period", "period", "s", "linear", (1.0, 3.0))


def test_a_heat_map_has_each_number_in_its_cell():
    """The first axis across, the second up; what is framed is framed where it lies."""
    values = np.array([[1.0, 2.0], [3.0, 40.0], [0.5, np.nan]])
    framed = np.zeros((3, 2), dtype=bool)
    framed[1, 0] = True
    figure = sweeps.heat_maps([sweeps.HeatMap("ekf", values, framed)], ACROSS, UP, "MRSE")
    axis = figure.axes[0]
    shown = {text.get_position(): text.get_text() for text in axis.texts}
    assert shown == {
        place: short(value) for place, value in np.ndenumerate(values) if np.isfinite(value)
    }
    (frame,) = axis.patches
    x, y = frame.get_x() + 0.5 * frame.get_width(), frame.get_y() + 0.5 * frame.get_height()
    assert (x, y) == pytest.approx((1.0, 0.0))
    assert [text.get_text() for text in axis.get_xticklabels()] == ["0.01", "0.1", "1"]
    assert [text.get_text() for text in axis.get_yticklabels()] == ["1", "3"]
    (image,) = axis.get_images()
    assert image.origin == "lower" and np.asarray(image.get_array()).shape[:2] == (2, 3)
    scale = sweeps._scale([values], 1.0)
    assert scale.vmin * scale.vmax == pytest.approx(1.0)
    assert scale.vmax == pytest.approx(40.0)
    plain = sweeps._scale([values], None)
    assert (plain.vmin, plain.vmax) == pytest.approx((0.5, 40.0))


def test_a_target_is_reached_where_a_power_law_reaches_it():
    """The contour of an error that grows as the root of the noise; the bound is half of it."""
    errors_of = 100.0 * np.sqrt(np.array(ACROSS.values))[:, None] * np.ones((1, 2))
    figure = sweeps.requirement(errors_of, 0.5 * errors_of, [20.0, 500.0], ACROSS, UP, "ekf")
    axis = figure.axes[0]
    found = [
        path.vertices[:, 0]
        for drawn in axis.collections
        if drawn.get_linestyle() and hasattr(drawn, "levels")
        for path in drawn.get_paths()
        if len(path.vertices)
    ]
    assert len(found) == 2
    assert found[0] == pytest.approx(0.04, rel=1e-3)
    assert found[1] == pytest.approx(0.16, rel=1e-3)
    assert (axis.get_xscale(), axis.get_yscale()) == ("log", "linear")
    assert (axis.get_xlabel(), axis.get_ylabel()) == ("noise [E]", "period [s]")
    assert [text.get_text() for text in axis.texts] == ["20 m"]


def test_curves_of_a_sweep_have_their_bounds_and_the_ins():
    """Each estimator's errors in its interval, its bound dashed, the INS's as a band."""
    values, bound = np.array([1.0, 2.0, 3.0]), np.array([0.5, 0.6, 0.7])
    interval = np.array([[0.9, 1.8, 2.5], [1.2, 2.3, 3.6]])
    unaided = np.array([[9.0, 8.0], [7.0, np.nan], [5.0, 6.0]])
    figure = sweeps.curves({"ekf": [sweeps.Curve("1 s", values, interval, bound)]}, unaided, ACROSS)
    axis = figure.axes[0]
    solid, dashed = axis.get_lines()
    assert solid.get_ydata() == pytest.approx(values) and solid.get_linestyle() == "-"
    assert dashed.get_ydata() == pytest.approx(bound) and dashed.get_linestyle() == "--"
    for region, low, high in zip(
        axis.collections, ([8, 7, 5], interval[0]), ([9, 7, 6], interval[1]), strict=True
    ):
        vertices = region.get_paths()[0].vertices
        for x, least, largest in zip(ACROSS.values, low, high, strict=True):
            ends = vertices[vertices[:, 0] == x, 1]
            assert (ends.min(), ends.max()) == pytest.approx((least, largest))


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.0, "0"), (1234.5, "1234"), (99_999.0, "99999"), (1e5, "1.0e+05"), (123.4, "123"),
        (12.34, "12.3"), (1.234, "1.23"), (-0.1234, "-0.123"), (0.001234, "0.00123"),
        (0.000999, "1.0e-03"),
    ],
)  # fmt: skip
def test_numbers_have_three_digits(value, text):
    """Three significant digits, all digits before the point; powers of ten at both ends."""
    assert short(value) == text


@pytest.mark.parametrize("span", [(12.0, 40.0), (0.5, 4000.0)])
def test_numbers_of_a_logarithmic_axis_are_plain(span):
    """Within a decade, too, where Matplotlib labels in between: no mathematics is printed."""
    values = np.geomspace(*span, 8)
    sigmas = np.tile(1e-5 * values[:, np.newaxis], (1, 8))
    with styled():
        figures = [
            gravity.knowledge(TIMES, {"a case": sigmas, "another": 1.1 * sigmas}),
            flights.deviations(TIMES, {"ekf": np.tile(values[:, np.newaxis], (1, 6))}),
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
