"""Grids of a user's own: where their nodes are, what is a gap, how high the land is under them."""

from __future__ import annotations

import math

import netCDF4
import numpy as np
import pytest
import xarray
from grids import write_grid

from ggbench.gravity.gradient_map import MapError
from ggbench.gravity.meridians import Area
from ggbench.gravity.remove_restore import GravityGrid
from ggbench.gravity.terrain import Terrain
from ggbench.maps.gravity_grid import elevation_at, read_grid


@pytest.mark.parametrize(
    ("west", "expected"), [(179.0, 179.0), (180.0, -180.0), (275.0, -85.0), (-85.0, -85.0)]
)
def test_longitudes_from_180_on_are_western(west, expected, tmp_path):
    """Grids say 275° or −85° E; maps and flights say −85°. One across 180° stays in one piece."""
    path = tmp_path / "grid.nc"
    write_grid(path, "geoid", "", np.ones((20, 25)), 30.0, west, 0.1)
    grid = read_grid(path, "geoid")
    assert grid.west_deg == pytest.approx(expected)
    assert grid.longitude_deg[-1] == pytest.approx(expected + 2.4)
    assert grid.south_deg == 30.0


def test_the_value_that_marks_a_gap_is_none(tmp_path):
    """ICGEM's files name it in their header; whatever it is, it is no gravity."""
    for gap, good in (("0.0", False), ("9999999.0", True)):
        head = ["latitude_parallels 16", "longitude_parallels 16", "unit mgal", f"gapvalue {gap}"]
        rows = [
            f"{100 + 0.1 * j:.1f} {20 - 0.1 * i:.1f} {0.0 if i == j == 3 else 5.0}"
            for i in range(16)
            for j in range(16)
        ]
        path = tmp_path / "grid.gdf"
        path.write_text("\n".join([*head, "longitude latitude gravity", "end_of_head ==", *rows]))
        if good:
            assert read_grid(path, "disturbance").values.min() == 0.0
        else:
            with pytest.raises(MapError, match="has gaps"):
                read_grid(path, "disturbance")


def test_nodes_must_be_regular(tmp_path):
    """A node a tenth of a step off its place is no grid."""
    path = tmp_path / "grid.nc"
    write_grid(path, "geoid", "", np.ones((20, 20)), 30.0, 5.0, 0.1)
    read_grid(path, "geoid")
    with netCDF4.Dataset(path, "a") as file:
        file.variables["lon"][7] += 0.01
    with pytest.raises(MapError, match="longitude must be regular"):
        read_grid(path, "geoid")


@pytest.mark.parametrize(("kind", "unit"), [("geoid", 1.0), ("anomaly", 1e-5)])
def test_a_raster_is_in_metres_or_milligal(kind, unit, tmp_path):
    path = tmp_path / "grid.asc"
    head = ["ncols 20", "nrows 20", "xllcorner 5.0", "yllcorner 40.0", "cellsize 0.1"]
    path.write_text("\n".join([*head, *[" ".join(["12.0"] * 20)] * 20, ""]))
    grid = read_grid(path, kind)
    np.testing.assert_allclose(grid.values, 12.0 * unit)
    assert (grid.south_deg, grid.west_deg) == pytest.approx((40.05, 5.05))


STEP = 0.01
"""Of the terrain [deg]; the grid's is ten times that."""


def under_a_grid(heights: np.ndarray) -> np.ndarray:
    """Elevations at 11 by 11 nodes within a terrain of 201 by 201, the tenth of each axis first."""
    terrain = Terrain(40.0, 5.0, STEP, STEP, heights, "made up")
    grid = GravityGrid("geoid", 40.5, 5.5, 10 * STEP, 10 * STEP, np.zeros((11, 11)))
    return elevation_at(grid, terrain)


def test_a_finer_terrain_is_averaged_over_half_a_step_of_the_grid():
    """A single high cell is spread as a Gaussian of five cells: 1/(2π 25) of it, e⁻² a step off."""
    heights = np.zeros((201, 201))
    heights[100, 100] = 8e3
    found = under_a_grid(heights)
    top = 8e3 / (2.0 * math.pi * 5.0**2)
    assert found[5, 5] == pytest.approx(top, rel=1e-3)
    assert found[5, 6] == pytest.approx(top * math.exp(-2.0), rel=1e-2)
    assert found[4, 5] == pytest.approx(top * math.exp(-2.0), rel=1e-2)


def test_the_sea_has_no_height_and_a_slope_stays_one():
    rows = np.arange(201)[:, np.newaxis] * np.ones((1, 201))
    np.testing.assert_allclose(under_a_grid(10.0 * rows)[:, 3], 500.0 + 100.0 * np.arange(11))
    np.testing.assert_array_equal(under_a_grid(-10.0 - rows), 0.0)
    coast = under_a_grid(10.0 * (rows - 100.0))
    assert coast.min() >= 0.0 and coast[0, 0] == pytest.approx(0.0, abs=1e-3)


def test_a_terrain_as_coarse_as_the_grid_is_taken_between_its_nodes():
    terrain = Terrain(40.0, 5.0, 0.1, 0.1, np.add.outer(np.arange(21.0), np.zeros(21)), "coarse")
    grid = GravityGrid("geoid", 40.55, 5.5, 0.1, 0.1, np.zeros((5, 5)))
    np.testing.assert_allclose(elevation_at(grid, terrain)[:, 0], 5.5 + np.arange(5.0))


def wave(longitude: np.ndarray, rows: int = 40) -> np.ndarray:
    """Values that know their meridian."""
    return np.tile(10.0 * np.sin(np.radians(longitude)), (rows, 1))


AREA = Area(31.0, 32.0, 179.0, -179.0)


def test_a_grid_may_cross_the_date_line(tmp_path):
    """Its longitudes may jump there, from 179.9 to -180."""
    longitude = 172.0 + 0.1 * np.arange(160)
    path = tmp_path / "grid.nc"
    values = {"g": (("lat", "lon"), wave(longitude), {"units": "m"})}
    axes = {"lat": 30.0 + 0.1 * np.arange(40), "lon": (longitude + 180.0) % 360.0 - 180.0}
    xarray.Dataset(values, axes).to_netcdf(path)
    grid = read_grid(path, "geoid", area=AREA)
    np.testing.assert_allclose(grid.longitude_deg, longitude)
    np.testing.assert_allclose(grid.values[0], wave(grid.longitude_deg)[0], atol=1e-9)


@pytest.mark.parametrize(("west", "area"), [(0.0, Area(31.0, 32.0, -1.0, 1.0)), (-180.0, AREA)])
def test_a_grid_around_the_earth_is_cut_opposite_to_the_map(west, area, tmp_path):
    longitude = west + 0.5 * np.arange(720)
    path = tmp_path / "grid.nc"
    write_grid(path, "g", "m", wave(longitude), 30.0, west, 0.5)
    grid = read_grid(path, "geoid", area=area)
    here = area.about(float(grid.longitude_deg.mean()))
    assert grid.longitude_deg[0] + 170.0 < here.west < here.east < grid.longitude_deg[-1] - 170.0
    np.testing.assert_allclose(grid.values[0], wave(grid.longitude_deg)[0], atol=1e-9)
    untouched = read_grid(path, "geoid", area=Area(31.0, 32.0, west + 90.0, west + 91.0))
    assert untouched.west_deg == west


def test_gaps_count_only_where_values_are_needed(tmp_path):
    """The grid is cut to what is needed; a gap in that has a place."""
    path = tmp_path / "grid.nc"
    values = np.arange(1600.0).reshape(40, 40) / 100.0
    values[:5] = np.nan
    write_grid(path, "g", "m", values, 30.0, 5.0, 0.1)
    with pytest.raises(MapError, match=r"200 nodes without a value .* the first at 30° N, 5° E"):
        read_grid(path, "geoid")
    grid = read_grid(path, "geoid", area=Area(31.05, 33.0, 365.55, 368.0))
    assert (grid.south_deg, grid.west_deg) == pytest.approx((31.0, 5.5))
    np.testing.assert_array_equal(grid.values, values[10:31, 5:31])
    with pytest.raises(MapError, match=r"the first at 30.2° N, 5.5° E; fill them"):
        read_grid(path, "geoid", area=Area(30.25, 33.0, 5.5, 8.0))
