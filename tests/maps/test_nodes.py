"""The nodes of a map that a user makes: within what all inputs serve, as dense as they need."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from terrain_fields import terrain_field

from ggbench.gravity.ellipsoid import SEMI_MAJOR_AXIS
from ggbench.gravity.field import Field
from ggbench.gravity.gradient_map import GradientMap, MapError
from ggbench.gravity.terrain_files import read_terrain
from ggbench.maps.nodes import GridRequest, SourceExtent, nodes_for
from ggbench.maps.plan import Inputs, plan


def reach(
    bounds: tuple[float, ...], inset: float = 0.0, ground: str = "", **heights: float
) -> SourceExtent:
    """South, north, west and east, of which the edges are poor."""
    given = {"floor_m": 0.0, "lowest_m": 1000.0, "sources_m": 0.0} | heights
    outer = np.array(bounds)
    return SourceExtent(
        outer, outer + inset * np.array([1.0, -1.0, 1.0, -1.0]), ground=ground, **given
    )


def ends(nodes) -> list[float]:
    return [float(axis[i]) for axis in (nodes.latitude_deg, nodes.longitude_deg) for i in (0, -1)]


def test_nodes_lie_within_what_all_inputs_serve():
    """By default within the good parts of all; asked for, up to the bounds of all."""
    one, two = reach((30, 34, 100, 105), 0.5), reach((31, 36, 98, 104), 0.25)
    request = GridRequest(spacing_deg=0.25, height_spacing_m=250.0)
    nodes, _ = nodes_for([one, two], request)
    assert ends(nodes) == pytest.approx([31.25, 33.5, 100.5, 103.75])
    nodes, _ = nodes_for([one, two], GridRequest(31.0, 34.0, 100.0, 104.0, spacing_deg=0.25))
    assert ends(nodes) == pytest.approx([31.0, 34.0, 100.0, 104.0])
    with pytest.raises(MapError, match=r"--south 30.9 lies outside .*: 31° to 34° N, 100° to 104°"):
        nodes_for([one, two], GridRequest(south_deg=30.9))


def test_spacings_are_a_quarter_of_the_distance_to_the_sources():
    """The nearest sources decide, and digits are dropped so that they never grow.

    From sources at -500 m to a map from 1340 m on: a quarter of 1840 m is 460 m; of 3840 m, 960 m.
    """
    for lowest, quarter in ((1340.0, 460.0), (3339.0, 950.0), (9000.0, 1000.0)):
        held = [
            reach((30, 34, 100, 105), sources_m=-500.0, lowest_m=lowest),
            reach((30, 34, 100, 105), sources_m=-2000.0, lowest_m=900.0),
        ]
        nodes, remarks = nodes_for(held, GridRequest())
        assert nodes.height_m[0] == lowest
        assert np.diff(nodes.height_m) == pytest.approx(quarter)
        assert nodes.height_m.size == 9
        widest = 3600.0 * math.degrees(0.25 * (lowest + 500.0) / SEMI_MAJOR_AXIS)
        for axis in (nodes.latitude_deg, nodes.longitude_deg):
            step = 3600.0 * float(np.diff(axis).mean())
            assert 0.9 * widest < step <= widest
        assert remarks == []
    for factor in (1.01, 4.0):
        _, (remark,) = nodes_for(held, GridRequest(spacing_deg=factor * widest / 3600.0))
        assert "a quarter of the distance of 9500 m to the sources" in remark
    assert nodes_for(held, GridRequest(spacing_deg=widest / 3600.0))[1] == []


def test_a_map_begins_above_the_floor_of_every_input():
    """The highest floor counts; at the floor itself nothing is served below it."""
    held = [reach((30, 34, 100, 105), floor_m=700.0), reach((30, 34, 100, 105), floor_m=200.0)]
    with pytest.raises(MapError, match="--lowest 600 lies below the sources: at least 700 m"):
        nodes_for(held, GridRequest(lowest_m=600.0))


def test_a_height_spacing_of_zero_is_refused():
    """By the option that has to be changed: a spacing that is not given follows from --lowest."""
    held = [reach((30, 34, 100, 105), floor_m=700.0, sources_m=700.0)]
    for request, remedy in (
        (GridRequest(lowest_m=700.0), "is 0 m and must be positive: raise --lowest"),
        (GridRequest(height_spacing_m=-5.0), "is -5 m .*: correct --height-spacing"),
    ):
        with pytest.raises(MapError, match=remedy):
            nodes_for(held, request)


def test_longitudes_are_counted_as_the_inputs_count_them():
    """Bounds in another turn, or each in another one; two inputs on either side of a turn."""
    held = [reach((36, 37, -85, -84)), reach((36, 37, 275, 276.5))]
    expected, _ = nodes_for(held, GridRequest(36.2, 36.8, -84.8, -84.2, spacing_deg=0.1))
    for west, east in ((275.2, 275.8), (-84.8, 275.8), (275.2, -84.2)):
        nodes, _ = nodes_for(held, GridRequest(36.2, 36.8, west, east, spacing_deg=0.1))
        assert ends(nodes) == pytest.approx(ends(expected))


def test_more_than_one_turn_is_refused():
    """Of what serves the whole Earth; control: one turn is a map."""
    whole = [reach((-90.0, 90.0, -360.0, 360.0))]
    with pytest.raises(MapError, match="--west -180 to --east 181 span 361 degrees; at most 360"):
        nodes_for(whole, GridRequest(-1.0, 1.0, -180.0, 181.0, spacing_deg=0.5))
    nodes, _ = nodes_for(whole, GridRequest(-1.0, 1.0, -180.0, 180.0, spacing_deg=0.5))
    assert nodes.longitude_deg.size == 721


def test_the_memory_of_a_layer_is_limited_before_the_work():
    """And stated; control: as many nodes in more layers are allowed."""
    whole = [reach((-90.0, 90.0, -360.0, 360.0))]
    bounds = {"south_deg": -20.0, "north_deg": 20.0, "west_deg": 0.0, "east_deg": 40.0}
    heights = {"lowest_m": 1000.0, "highest_m": 2000.0, "height_spacing_m": 200.0}
    with pytest.raises(MapError, match=r"a layer of 4001 x 4001 nodes .* needs 3\.46 GB of memory"):
        nodes_for(whole, GridRequest(**bounds, **heights, spacing_deg=0.01))
    nodes, _ = nodes_for(
        whole, GridRequest(**bounds, **heights | {"height_spacing_m": 50.0}, spacing_deg=0.02)
    )
    assert nodes.latitude_deg.size * nodes.longitude_deg.size * nodes.height_m.size > 4001**2


@pytest.mark.parametrize("around", [(178.0, 182.0), (-182.0, -178.0), (-360.0, 360.0)])
def test_a_map_may_cross_the_date_line(around):
    """Of a region that crosses it, however it is counted, and of what serves the whole Earth."""
    south, north = (-90.0, 90.0) if around[1] == 360.0 else (-20.0, -10.0)
    held = [reach((south, north, *around))]
    nodes, _ = nodes_for(held, GridRequest(-16.0, -15.0, 179.5, -179.5, spacing_deg=0.1))
    assert nodes.longitude_deg.size == 11
    assert nodes.longitude_deg % 360.0 == pytest.approx(179.5 + 0.1 * np.arange(11))


@pytest.mark.parametrize(
    ("bounds", "message"),
    [
        ((36.2, 36.8, -84.2, -84.8), "--west -84.2 must be less than --east -84.8"),
        ((36.8, 36.2, -84.8, -84.2), "--south 36.8 must be less than --north 36.2"),
        ((95.0, 96.0, -84.8, -84.2), "--south 95 is not a latitude: -90 to 90 degrees are allowed"),
        ((36.2, 36.8, 745e3, 760e3), "--west 745000 is not a longitude: .* metres in a projection"),
    ],
)
def test_bounds_that_are_none_are_refused_with_a_sentence(bounds, message):
    with pytest.raises(MapError, match=message):
        nodes_for([reach((36, 37, -85, -84))], GridRequest(*bounds))


def test_near_the_ground_nodes_are_wider_apart_than_a_quarter():
    """Up to 100 m across and 50 m upwards; from 400 m and 200 m on a quarter, as elsewhere."""
    for distance, across, upwards in (
        (50.0, 50.0, 25.0),
        (100.0, 100.0, 50.0),
        (300.0, 100.0, 75.0),
        (800.0, 200.0, 200.0),
    ):
        held = [reach((46, 46.1, 8, 8.1), lowest_m=800.0 + distance, sources_m=800.0, ground="it")]
        nodes, _ = nodes_for(held, GridRequest())
        assert np.diff(nodes.height_m) == pytest.approx(upwards)
        step = math.radians(float(np.diff(nodes.latitude_deg).mean())) * SEMI_MAJOR_AXIS
        assert 0.9 * across < step <= across
        assert nodes.height_m[-1] - nodes.height_m[0] >= 1000.0


def test_a_bound_between_two_nodes_is_covered_if_it_may_be():
    """By one node beyond it, unless that would leave the inputs."""
    held = [reach((30, 34, 100, 105))]
    inner, _ = nodes_for(held, GridRequest(31.0, 33.1, 101.0, 104.1, spacing_deg=0.25))
    assert ends(inner) == pytest.approx([31.0, 33.25, 101.0, 104.25])
    outer, _ = nodes_for(held, GridRequest(31.1, 34.0, 101.1, 105.0, spacing_deg=0.25))
    assert ends(outer) == pytest.approx([31.1, 33.85, 101.1, 104.85])


def hills(path: Path) -> Path:
    """A terrain of 1.2° by 2.4°, up to 800 m high."""
    rows, columns = np.meshgrid(np.arange(61), np.arange(121), indexing="ij")
    heights = 400.0 * (1.0 + np.sin(0.3 * rows) * np.cos(0.2 * columns))
    heights[30, 60] = 800.0
    np.savez(
        path,
        south_deg=47.0,
        west_deg=8.0,
        latitude_step_deg=0.02,
        longitude_step_deg=0.02,
        height_m=heights,
    )
    return path


def test_a_terrain_serves_its_inner_part_above_its_highest_ground(tmp_path):
    """A tenth of its width is left out at every edge; heights are above the ellipsoid.

    The ground reaches 800 m, and its zero level lies 1000 m above the ellipsoid: with a clearance
    of one cell of the terrain, 2226 m, and in tens of metres, the lowest layer is at 4030 m.
    """
    path = hills(tmp_path / "hills.npz")
    for geoid, lowest in ((0.0, 3030.0), (1000.0, 4030.0)):
        made = plan(Inputs(terrain=path, geoid_height_m=geoid), GridRequest(), "test")
        south, north, west, east = ends(made.nodes)
        step = float(made.nodes.latitude_deg[1] - made.nodes.latitude_deg[0])
        assert (south, west) == pytest.approx((47.12, 8.24))
        assert 48.08 <= north + 1e-9 < 48.08 + step and 10.16 <= east + 1e-9 < 10.16 + step
        assert made.nodes.height_m[0] == lowest
        for too_low, where in ((799.0, "1 m below"), (801.0, "only 1 m above")):
            words = (
                rf"{where} the highest ground .* \({800.0 + geoid:g} m at 47.6000° N, 9.2000° E\)"
            )
            with pytest.raises(MapError, match=words):
                request = GridRequest(lowest_m=too_low + geoid)
                plan(Inputs(terrain=path, geoid_height_m=geoid), request, "test")


def low_hills(path: Path) -> Path:
    """Two hills of 120 m on a plain, every 3 arc seconds."""
    step = 3.0 / 3600.0
    rows, columns = np.meshgrid(np.arange(100), np.arange(120), indexing="ij")
    heights = 100.0 + sum(
        top * np.exp(-(((rows - i) / 15.0) ** 2) - ((columns - j) / 15.0) ** 2)
        for top, i, j in ((120.0, 30, 90), (80.0, 70, 30))
    )
    np.savez(
        path,
        south_deg=46.0,
        west_deg=8.0,
        latitude_step_deg=step,
        longitude_step_deg=step,
        height_m=heights,
    )
    return path


def test_a_map_begins_low_enough_for_flights_that_follow_the_ground(tmp_path):
    """One cell of the terrain, 93 m, above its highest ground; where that serves them is said."""
    made = plan(Inputs(terrain=low_hills(tmp_path / "low.npz")), GridRequest(), "test")
    assert made.nodes.height_m[0] == 320.0
    begins = "320 m, lies 100 m above the highest ground of the terrain (220 m at 46.0250° N"
    (remark,) = (remark for remark in made.remarks if begins in remark)
    served = int(remark.rpartition("over ")[2].partition("%")[0])
    assert 5 <= served <= 40  # where the ground is higher than 120 m


@pytest.mark.long
def test_the_field_between_the_default_nodes_is_that_of_the_terrain(tmp_path):
    """Half way up the lowest layer: to 0.02 E rms, of some E."""
    path = low_hills(tmp_path / "low.npz")
    made = plan(Inputs(terrain=path), GridRequest(highest_m=620.0), "test")
    tensor, vector = (np.stack(part, axis=2) for part in zip(*made.layers(), strict=True))
    nodes = made.nodes
    axes = np.radians(nodes.latitude_deg), np.radians(nodes.longitude_deg), nodes.height_m
    steps = [float(axis[1] - axis[0]) for axis in axes]
    field = Field.from_map(
        GradientMap(
            *(float(axis[0]) for axis in axes),
            *steps,
            tensor.astype(float),
            vector.astype(float),
            "test",
        )
    )
    between = [axis[3:-3:4] + 0.45 * step for axis, step in zip(axes[:2], steps[:2], strict=True)]
    at = float(axes[2][0] + 0.5 * steps[2])
    exact, _ = terrain_field(read_terrain(path), *between, [nodes.height_m[0], at])
    found = field.tensor(between[0][:, None], between[1], at)
    found -= Field.normal().tensor(between[0][:, None], between[1], at)
    error = found - exact[:, :, 1]
    assert np.sqrt(np.mean(exact[:, :, 1, 5] ** 2)) > 3.0
    assert np.sqrt(np.mean(error**2)) < 0.02
