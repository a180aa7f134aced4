"""The nodes of a map that a user makes: within what all inputs serve, as dense as they need."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from ggbench.gravity.ellipsoid import SEMI_MAJOR_AXIS
from ggbench.gravity.gradient_map import MapError
from ggbench.maps.nodes import Reach, Wishes, nodes_for
from ggbench.maps.plan import Inputs, plan


def reach(bounds: tuple[float, ...], inset: float = 0.0, **heights: float) -> Reach:
    """South, north, west and east, of which the edges are poor."""
    given = {"floor_m": 0.0, "lowest_m": 1000.0, "sources_m": 0.0} | heights
    outer = np.array(bounds)
    return Reach(outer, outer + inset * np.array([1.0, -1.0, 1.0, -1.0]), **given)


def ends(nodes) -> list[float]:
    return [float(axis[i]) for axis in (nodes.latitude_deg, nodes.longitude_deg) for i in (0, -1)]


def test_nodes_lie_within_what_all_inputs_serve():
    """By default within the good parts of all; asked for, up to the bounds of all."""
    one, two = reach((30, 34, 100, 105), 0.5), reach((31, 36, 98, 104), 0.25)
    wishes = Wishes(spacing_deg=0.25, height_spacing_m=250.0)
    nodes, _ = nodes_for([one, two], wishes)
    assert ends(nodes) == pytest.approx([31.25, 33.5, 100.5, 103.75])
    nodes, _ = nodes_for([one, two], Wishes(31.0, 34.0, 100.0, 104.0, spacing_deg=0.25))
    assert ends(nodes) == pytest.approx([31.0, 34.0, 100.0, 104.0])
    with pytest.raises(MapError, match=r"--south 30.9 lies outside .*: 31° to 34° N, 100° to 104°"):
        nodes_for([one, two], Wishes(south_deg=30.9))


def test_spacings_are_a_quarter_of_the_distance_to_the_sources():
    """The nearest sources decide, and digits are dropped so that they never grow.

    From sources at -500 m to a map from 1340 m on: a quarter of 1840 m is 460 m; of 3840 m, 960 m.
    """
    for lowest, quarter in ((1340.0, 460.0), (3339.0, 950.0), (9000.0, 1000.0)):
        held = [
            reach((30, 34, 100, 105), sources_m=-500.0, lowest_m=lowest),
            reach((30, 34, 100, 105), sources_m=-2000.0, lowest_m=900.0),
        ]
        nodes, remarks = nodes_for(held, Wishes())
        assert nodes.height_m[0] == lowest
        assert np.diff(nodes.height_m) == pytest.approx(quarter)
        assert nodes.height_m.size == 9
        widest = 3600.0 * math.degrees(0.25 * (lowest + 500.0) / SEMI_MAJOR_AXIS)
        for axis in (nodes.latitude_deg, nodes.longitude_deg):
            step = 3600.0 * float(np.diff(axis).mean())
            assert 0.9 * widest < step <= widest
        assert remarks == []
    for factor in (1.01, 4.0):
        _, (remark,) = nodes_for(held, Wishes(spacing_deg=factor * widest / 3600.0))
        assert "a quarter of the 9500 m to the sources" in remark
    assert nodes_for(held, Wishes(spacing_deg=widest / 3600.0))[1] == []


def test_a_map_begins_above_the_floor_of_every_input():
    """The highest floor counts; at the floor itself nothing is served below it."""
    held = [reach((30, 34, 100, 105), floor_m=700.0), reach((30, 34, 100, 105), floor_m=200.0)]
    with pytest.raises(MapError, match="--lowest 600 lies below the sources: at least 700 m"):
        nodes_for(held, Wishes(lowest_m=600.0))


def test_a_bound_between_two_nodes_is_covered_if_it_may_be():
    """By one node beyond it, unless that would leave the inputs."""
    held = [reach((30, 34, 100, 105))]
    inner, _ = nodes_for(held, Wishes(31.0, 33.1, 101.0, 104.1, spacing_deg=0.25))
    assert ends(inner) == pytest.approx([31.0, 33.25, 101.0, 104.25])
    outer, _ = nodes_for(held, Wishes(31.1, 34.0, 101.1, 105.0, spacing_deg=0.25))
    assert ends(outer) == pytest.approx([31.1, 33.85, 101.1, 104.85])


def hills(path: Path) -> Path:
    """A terrain of 1.2° by 2.4°, up to 800 m high."""
    rows, columns = np.meshgrid(np.arange(61), np.arange(121), indexing="ij")
    heights = 400.0 * (1.0 + np.sin(0.3 * rows) * np.cos(0.2 * columns))
    heights[30, 60] = 800.0
    np.savez(
        path, south_deg=47.0, west_deg=8.0, latitude_step_deg=0.02, longitude_step_deg=0.02,
        height_m=heights,
    )  # fmt: skip
    return path


def test_a_terrain_serves_its_inner_part_above_its_highest_ground(tmp_path):
    """A tenth of its width is left out at every edge; heights are above the ellipsoid.

    The ground reaches 800 m, and its zero level lies 1000 m above the ellipsoid: with a clearance
    of one cell of the terrain, 2226 m, the lowest layer is at 4100 m.
    """
    path = hills(tmp_path / "hills.npz")
    for geoid, lowest in ((0.0, 3100.0), (1000.0, 4100.0)):
        made = plan(Inputs(terrain=path, geoid_height_m=geoid), Wishes(), "test")
        south, north, west, east = ends(made.nodes)
        step = float(made.nodes.latitude_deg[1] - made.nodes.latitude_deg[0])
        assert (south, west) == pytest.approx((47.12, 8.24))
        assert 48.08 <= north + 1e-9 < 48.08 + step and 10.16 <= east + 1e-9 < 10.16 + step
        assert made.nodes.height_m[0] == lowest
        with pytest.raises(MapError, match=rf"at least {800.0 + geoid:g} m is allowed"):
            plan(Inputs(terrain=path, geoid_height_m=geoid), Wishes(lowest_m=799.0 + geoid), "test")
